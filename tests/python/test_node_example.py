"""The Node.js example: type-checked, and to the bit what Gymnasium and the Python client say."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import palr_gym
from support.reference import MASKS, MaskedStack, assert_same_bits, gymnasium_env
from support.server_process import ROOT, running_server

EXAMPLE = ROOT / "examples" / "node"

# The environments are held against -v4 on purpose.
pytestmark = pytest.mark.filterwarnings("ignore:.*is out of date:DeprecationWarning")


def node_path() -> str:
    """PATH with a Node.js >= 20: the machine's, or the one in .venv, as in scripts/setup.sh."""
    found = shutil.which("node")
    if found and shutil.which("npm"):
        version = subprocess.run([found, "--version"], capture_output=True, text=True, check=True)
        if int(version.stdout.strip().removeprefix("v").partition(".")[0]) >= 20:
            return os.environ["PATH"]
    return f"{Path(sys.executable).parent}:{os.environ['PATH']}"


def run(*command: str, timeout: float = 50) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PATH": node_path()}
    return subprocess.run(
        command,
        cwd=EXAMPLE,
        env=environment,
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
    )


@pytest.fixture(scope="module")
def built() -> None:
    assert (EXAMPLE / "node_modules").is_dir(), (
        f"{EXAMPLE} has no node_modules; scripts/setup.sh test installs them"
    )
    built = run("npm", "run", "build")
    assert built.returncode == 0, built.stdout + built.stderr


def wave(step: int, size: int) -> np.ndarray[Any, np.dtype[np.float32]]:
    values = [((step * 31 + i * 7) % 21) / 10 - 1 for i in range(size)]
    return np.array(values, dtype=np.float32)


@pytest.mark.usefixtures("built")
def test_it_steps_as_gymnasium_does_and_evaluates_as_the_python_client_does(server: str) -> None:
    done = run("node", "dist/main.js", "--server", server, "--num-envs", "3", "--steps", "120")
    assert done.returncode == 0, done.stderr
    got = json.loads(done.stdout)

    observations: list[Any] = []
    ended = 0
    for index in range(3):
        env, stack = gymnasium_env("hopper"), MaskedStack(MASKS["hopper"]["paper"], 2)
        observation = stack.reset(env.reset(seed=index)[0])
        total, is_over = 0.0, False
        for step in range(120):
            if is_over:
                observation, is_over = stack.reset(env.reset()[0]), False
                continue
            action = wave(step, 9)[3 * index : 3 * index + 3]
            full, reward, terminated, truncated, _ = env.step(action)
            observation, is_over = stack.push(full), terminated or truncated
            total, ended = total + float(reward), ended + is_over
        observations += list(observation)
        assert got["rewards"][index] == total
    assert_same_bits(np.array(got["observations"]), np.array(observations))
    assert got["ended"] == ended > 0

    evaluation = palr_gym.evaluate("hopper-w2", "random", episodes=5, server=server)
    assert got["returns"] == [episode.episode_return for episode in evaluation.episodes]
    assert got["scoreMean"] == evaluation.score_mean
    assert got["tasks"] == ["ant", "halfcheetah", "hopper", "lane", "town", "toy", "walker2d"]


@pytest.mark.usefixtures("built")
def test_it_fails_with_the_servers_words(server: str) -> None:
    done = run("node", "dist/main.js", "--server", server, "--env", "hoper")
    assert done.returncode == 1
    assert 'error: NOT_FOUND: unknown task "hoper" (did you mean "hopper"?)' in done.stderr
    with running_server() as gone:
        address = gone.address
    done = run("node", "dist/main.js", "--server", address)
    assert done.returncode == 1
    assert "error: UNAVAILABLE" in done.stderr
