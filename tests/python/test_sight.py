"""Agents that see pictures: what they see, online and in recordings."""

import hashlib
import json
import subprocess
from pathlib import Path
from typing import Any

import gymnasium
import h5py
import numpy as np
import onnx
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from onnx.reference import ReferenceEvaluator

import palr_gym
from palr_gym import errors
from support import extractors
from support.server_process import ROOT, ServerProcess, binary, running_server

EXTRACTOR = ROOT / "scenes" / "features" / "lane-compact-resnet.onnx"
STEPS = 12


@pytest.fixture(scope="module", autouse=True)
def opengl(shared_server: ServerProcess) -> None:
    """Skips, saying so, where the server has nothing to draw with."""
    with palr_gym.make("lane-pixels-w1", server=shared_server.address) as env:
        try:
            env.reset(seed=0)
        except errors.FailedPrecondition as error:
            pytest.skip(f"SKIPPED: {error}")


def actions(num_envs: int, steps: int = STEPS) -> NDArray[np.float32]:
    """[steps, num_envs, 2]: the same for an environment whatever stands beside it."""
    rngs = [np.random.default_rng(seed) for seed in range(num_envs)]
    return np.stack([rng.uniform(-1, 1, (steps, 2)) for rng in rngs], 1).astype(np.float32)


def played(
    env_id: str, server: str, num_envs: int = 3, **kwargs: Any
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Observations of a reset, [N, ...], and of the steps after it, [STEPS, N, ...]."""
    with palr_gym.make_vec(env_id, num_envs, server=server, **kwargs) as envs:
        first, _ = envs.reset(seed=5)
        later = np.stack([envs.step(row)[0] for row in actions(num_envs)])
        for observations in (first, later[-1]):
            assert observations in envs.observation_space
        return first, later


def test_pixels_are_the_drivers_picture(server: str) -> None:
    with palr_gym.make_vec(
        "lane-pixels-w1",
        2,
        server=server,
        render_mode="rgb_array",
        camera="driver",
        render_size=(48, 48),
        scene_options=palr_gym.SceneOptions(weather="random"),
    ) as envs:
        observations, _ = envs.reset(seed=3)
        for row in actions(2):
            assert observations.dtype == np.uint8
            np.testing.assert_array_equal(observations, np.stack(envs.render() or ()))
            observations = envs.step(row)[0]


@pytest.mark.parametrize("kind", ["", "-pixels"])
def test_stacks_hold_the_last_frames_with_zeros_before_the_first(kind: str, server: str) -> None:
    first, later = played(f"lane{kind}-w1", server)
    frames = np.stack([first, *later])
    first, later = played(f"lane{kind}-w3", server)
    stacks = np.stack([first, *later]).reshape(STEPS + 1, 3, 3, *frames.shape[2:])
    for age in range(3):
        for t in range(STEPS + 1):
            expected = frames[t - age] if t >= age else np.zeros_like(frames[0])
            np.testing.assert_array_equal(stacks[t, :, 2 - age], expected)


def test_features_are_what_the_reference_makes_of_the_pixels(server: str) -> None:
    pixels, _ = played("lane-pixels-w1", server)
    features, _ = played("lane-w1", server)
    model: Any = onnx.load_from_string(EXTRACTOR.read_bytes())
    said = {entry.key: entry.value for entry in model.metadata_props}
    mean, std = (
        np.array(said[f"palr_gym.{name}"].split(), np.float64)[:, None, None]
        for name in ("mean", "std")
    )
    image = np.moveaxis(pixels, -1, 1) * float(said["palr_gym.scale"])
    image = ((image - mean) / std).astype(np.float32)
    reference: Any = ReferenceEvaluator(model)
    expected = reference.run(None, {model.graph.input[0].name: image})
    np.testing.assert_allclose(features, expected[0], atol=1e-4)


@pytest.mark.parametrize("env_id", ["lane-w2", "lane-pixels-w2"])
def test_neither_neighbours_nor_threads_nor_open_loops_show_in_what_is_seen(
    env_id: str, server: str
) -> None:
    first, later = played(env_id, server, num_envs=5)
    with running_server("--threads", "1") as other:
        alone_first, alone_later = played(env_id, other.address, num_envs=1)
    np.testing.assert_array_equal(first[:1], alone_first)
    np.testing.assert_array_equal(later[:, :1], alone_later)
    with palr_gym.make_vec(env_id, 5, server=server) as envs:
        envs.reset(seed=5)
        np.testing.assert_array_equal(envs.step_open_loop(actions(5)).observations, later)


def test_what_rollouts_see_does_not_depend_on_how_many_are_played_together(server: str) -> None:
    """Features are made of several pictures at once, where several episodes are played."""
    played_together = [
        palr_gym.collect("lane-w2", "random", episodes=5, seed=7, num_envs=num_envs, server=server)
        for num_envs in (1, 2, 5)
    ]
    first = played_together[0]
    assert len(np.unique(first.observations, axis=0)) > len(first.observations) // 2
    for other in played_together[1:]:
        np.testing.assert_array_equal(other.observations, first.observations)
        np.testing.assert_array_equal(other.next_observations, first.next_observations)
        np.testing.assert_array_equal(other.rewards, first.rewards)


def test_the_last_picture_of_an_episode_comes_beside_the_first_of_the_next(server: str) -> None:
    row = np.ones((3, 2), np.float32)
    with (
        palr_gym.make_vec(
            "lane-w2", 3, server=server, autoreset_mode=AutoresetMode.SAME_STEP
        ) as ours,
        palr_gym.make_vec("lane-w2", 3, server=server) as next_step,
    ):
        ours.reset(seed=1)
        next_step.reset(seed=1)
        for _ in range(250):
            observations, _, terminated, truncated, infos = ours.step(row)
            expected, *_ = next_step.step(row)
            ended = terminated | truncated
            if ended.any():
                index = int(np.flatnonzero(ended)[0])
                np.testing.assert_array_equal(infos["final_obs"][index], expected[index])
                # The frame before the first is zeros.
                half = observations.shape[1] // 2
                assert not observations[index, :half].any()
                assert observations[index, half:].any()
                return
            np.testing.assert_array_equal(observations, expected)
    pytest.fail("full throttle to the right never left the lane")


@pytest.mark.filterwarnings("ignore:.*A Box observation space m.*imum value is -?infinity")
@pytest.mark.parametrize("env_id", ["lane-w1", "lane-w3", "lane-pixels-w1", "lane-pixels-w3"])
def test_gymnasiums_checker_is_content_with_what_is_seen(env_id: str, server: str) -> None:
    env = gymnasium.make(f"palr_gym/{env_id}-v0", server=server)
    check_env(env.unwrapped, skip_render_check=True)
    env.close()
    envs: Any = gymnasium.make_vec(f"palr_gym/{env_id}-v0", num_envs=2, server=server)
    observations, _ = envs.reset(seed=0)
    assert observations in envs.observation_space
    envs.close()


def test_a_snapshot_goes_on_to_the_same_pictures(server: str) -> None:
    rows = actions(1, 6)[:, 0]
    with palr_gym.make("lane-pixels-w2", server=server) as env:
        env.reset(seed=2)
        for row in rows[:3]:
            env.step(row)
        with env.fork() as fork:
            for row in rows[3:]:
                np.testing.assert_array_equal(env.step(row)[0], fork.step(row)[0])


def test_the_shipped_extractor_is_the_one_that_its_card_describes(server: str) -> None:
    card = json.loads(EXTRACTOR.with_suffix(".json").read_text())
    sha256 = hashlib.sha256(EXTRACTOR.read_bytes()).hexdigest()
    with palr_gym.Client(server) as client:
        extractor = client.spec("lane-w1").feature_extractor
    assert extractor is not None
    assert card["sha256"] == sha256 == extractor.sha256
    assert (card["name"], card["features"]) == (extractor.name, extractor.size)


def test_an_extractor_of_ones_own_serves_its_features(tmp_path: Path) -> None:
    path = tmp_path / "mine.onnx"
    path.write_bytes(extractors.mean_colours())
    with running_server("--extractor", str(path)) as server:
        pixels, _ = played("lane-pixels-w1", server.address)
        features, _ = played("lane-w1", server.address)
        with palr_gym.Client(server.address) as client:
            extractor = client.spec("lane-w1").feature_extractor
    np.testing.assert_allclose(features, pixels.mean((1, 2)) / 255, atol=1e-5)
    assert extractor is not None
    assert (extractor.name, extractor.size) == ("mean-colours", 3)


def test_features_that_are_no_numbers_are_an_error(tmp_path: Path) -> None:
    path = tmp_path / "nan.onnx"
    path.write_bytes(extractors.nan_for_colour())
    with running_server("--extractor", str(path)) as server:
        with (
            palr_gym.make_vec("lane-w1", 3, server=server.address) as envs,
            pytest.raises(errors.FailedPrecondition, match="expected finite numbers"),
        ):
            envs.reset(seed=0)
        with pytest.raises(errors.FailedPrecondition, match="expected finite numbers"):
            palr_gym.evaluate("lane-w1", "random", episodes=1, server=server.address)
        assert server.is_alive


@pytest.mark.parametrize(
    ("model", "expected"),
    [
        (extractors.mean_colours()[:200], "no ONNX model"),
        (extractors.external_data(), "external file"),
        (extractors.mean_colours(size="0 48"), "0 x 48 pixels"),
        (extractors.mean_colours(size="10000 10000"), "10000 x 10000 pixels"),
        (extractors.mean_colours(size="64 64"), "expected float32 [N, 3, 64, 64]"),
    ],
    ids=["truncated", "external", "empty", "huge", "shape"],
)
def test_extractors_outside_the_contract_are_refused_at_once(
    model: bytes, expected: str, tmp_path: Path
) -> None:
    path = tmp_path / "wrong.onnx"
    path.write_bytes(model)
    command = [str(binary()), "serve", "--listen", "127.0.0.1:0", "--extractor", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode != 0
    assert expected in done.stderr
    assert str(path) in done.stderr


def run(*arguments: str) -> str:
    """What the program prints."""
    done = subprocess.run(
        [str(binary()), *arguments], capture_output=True, text=True, timeout=55, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_where_nothing_is_drawn_agents_that_see_pictures_are_refused_and_others_are_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    library = tmp_path / "libOSMesa.so.8"
    library.write_bytes(b"no library at all")
    monkeypatch.setenv("PALR_GYM_OSMESA", str(library))
    for arguments, expected in [
        (("--gl", "none"), "--gl auto"),
        (("--gl", "osmesa"), "no OpenGL to draw with"),
    ]:
        with running_server(*arguments) as server:
            with palr_gym.make("lane-w1", server=server.address) as env:
                with pytest.raises(errors.FailedPrecondition, match=expected):
                    env.reset(seed=0)
                with pytest.raises(errors.FailedPrecondition, match=expected):
                    palr_gym.collect(
                        "lane-pixels-w1", "expert", transitions=1, server=server.address
                    )
            with palr_gym.make("lane", server=server.address) as env:
                env.reset(seed=0)


@pytest.mark.parametrize(
    ("variable", "value", "expected"),
    [
        ("MESA_GL_VERSION_OVERRIDE", "1.4", "OpenGL version 1.5 or higher required"),
        ("MESA_EXTENSION_OVERRIDE", "-GL_ARB_framebuffer_object", "ARB_framebuffer_object"),
    ],
)
def test_an_opengl_that_is_too_old_is_an_error_that_says_what_it_lacks(
    variable: str, value: str, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(variable, value)
    with running_server() as server:
        for env_id in ("lane-w1", "lane-pixels-w1"):
            with (
                palr_gym.make(env_id, server=server.address) as env,
                pytest.raises(errors.FailedPrecondition, match=expected),
            ):
                env.reset(seed=0)
        with palr_gym.make("lane", server=server.address) as env:
            env.reset(seed=0)


def text(file: h5py.File, name: str) -> str:
    """An entry of a recording's metadata."""
    value: Any = file[f"metadata/{name}"]
    return value[()].decode()


def test_recordings_hold_what_was_seen_and_by_whom(server: str, tmp_path: Path) -> None:
    common = ["--transitions", "40", "--num-envs", "1", "--server", server]
    for env_id in ("lane-w1", "lane-w3", "lane-pixels-w1"):
        run("collect", "--env", env_id, "--out", str(tmp_path / f"{env_id}.hdf5"), *common)
    with h5py.File(tmp_path / "lane-pixels-w1.hdf5") as pictures:
        pixels: Any = pictures["observations"]
        assert pixels.dtype == np.uint8
        assert pixels.shape == (40, 48, 48, 3)
        assert "Mesa" in text(pictures, "gl_version")
        with palr_gym.make("lane-pixels-w1", server=server) as env:
            np.testing.assert_array_equal(pixels[0], env.reset(seed=0)[0])
    with palr_gym.Client(server) as client:
        extractor = client.spec("lane-w1").feature_extractor
    assert extractor is not None
    with (
        h5py.File(tmp_path / "lane-w1.hdf5") as single,
        h5py.File(tmp_path / "lane-w3.hdf5") as stacked,
    ):
        features: Any = single["observations"]
        stacks: Any = stacked["observations"]
        assert features.shape == (40, extractor.size)
        np.testing.assert_array_equal(stacks[:, -extractor.size :], features)
        assert text(single, "extractor_sha256") == extractor.sha256


@pytest.mark.timeout(180)
def test_policies_are_trained_on_recorded_features_of_any_stack(
    server: str, tmp_path: Path
) -> None:
    policies: list[bytes] = []
    for recorded in ("lane-w1", "lane-w3"):
        data, out = tmp_path / f"{recorded}.hdf5", tmp_path / recorded
        run(
            *["collect", "--env", recorded, "--transitions", "120", "--num-envs", "1"],
            *["--out", str(data), "--server", server],
        )
        run(
            *["train", "--env", "lane-w3", "--algorithm", "bc", "--data", str(data)],
            *["--steps", "20", "--batch", "16", "--training-rows", "110", "--held-out-rows", "0"],
            *["--evaluate-every", "0", "--out", str(out), "--server", server],
        )
        policies.append((out / "001" / "policy.onnx").read_bytes())
    # A recorded stack holds what a stack of recorded frames holds.
    assert policies[0] == policies[1]
    policy = tmp_path / "lane-w1" / "001" / "policy.onnx"
    result = palr_gym.evaluate("lane-w3", policy, episodes=1, server=server)
    assert len(result.episodes) == 1
