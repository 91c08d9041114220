"""The package as its users get it."""

import os
import shutil
import subprocess
import sys
import tomllib
import venv
import zipfile
from email.parser import Parser
from pathlib import Path

import gymnasium
import pytest

import palr_gym
from support.server_process import ROOT

CLIENT = ROOT / "client-py"


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel, built without a network from a copy: a build leaves files in its source tree."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "client-py"
    shutil.copytree(CLIENT, source, ignore=shutil.ignore_patterns("build", "*.egg-info"))
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*command, "--wheel-dir", str(folder), str(source)], check=True)
    [path] = folder.glob("*.whl")
    return path


def test_the_wheel_is_pure_python_and_typed(wheel: Path) -> None:
    assert wheel.name == f"palr_gym-{palr_gym.__version__}-py3-none-any.whl"
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    source = CLIENT / "src"
    expected = {
        path.relative_to(source).as_posix()
        for path in (source / "palr_gym").rglob("*")
        if path.suffix in (".py", ".pyi", ".typed")
    }
    assert "palr_gym/py.typed" in expected
    assert expected == {name for name in names if not name.startswith("palr_gym-")}


def test_no_dependency_is_pinned_or_bounded_from_above(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        [name] = [name for name in archive.namelist() if name.endswith(".dist-info/METADATA")]
        metadata = Parser().parsestr(archive.read(name).decode())
    requirements: list[str] = metadata.get_all("Requires-Dist") or []
    assert len(requirements) >= 5
    for requirement in requirements:
        assert not any(sign in requirement for sign in ("<", "~=", "!=")), requirement
        assert "==" not in requirement.partition(";")[0], requirement


def test_the_wheel_works_in_a_fresh_environment(wheel: Path, tmp_path: Path, server: str) -> None:
    fresh = tmp_path / "fresh"
    venv.create(fresh, with_pip=False, symlinks=True)
    python = fresh / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet"]
    subprocess.run([*pip, "--no-deps", "--no-index", str(wheel)], check=True)
    # The dependencies come from where these tests have them; palr_gym itself must not.
    dependencies = Path(gymnasium.__file__).parents[1]
    program = (
        "import sys, gymnasium, palr_gym\n"
        "assert palr_gym.__file__.startswith(sys.prefix), palr_gym.__file__\n"
        "env = gymnasium.make('palr_gym/hopper-w2-v0', server=sys.argv[1])\n"
        "print(env.reset(seed=0)[0].shape)\n"
        "env.close()\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(dependencies)}
    output = subprocess.run(
        [str(python), "-c", program, server],
        env=environment,
        cwd=tmp_path,
        check=True,
        capture_output=True,
        text=True,
    )
    assert output.stdout == "(10,)\n"


def run_python(program: str, *arguments: str) -> str:
    """The output of a program in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(CLIENT / "src")}
    output = subprocess.run(
        [sys.executable, "-c", program, *arguments],
        env=environment,
        check=True,
        capture_output=True,
        text=True,
        timeout=30,
    )
    assert output.stderr == ""
    return output.stdout


def test_importing_the_package_opens_no_socket_and_starts_no_thread() -> None:
    program = (
        "import os, palr_gym\n"
        "files = [os.readlink(f'/proc/self/fd/{n}') for n in os.listdir('/proc/self/fd')\n"
        "         if os.path.exists(f'/proc/self/fd/{n}')]\n"
        "print(sum(name.startswith(('socket:', 'anon_inode:')) for name in files))\n"
        "print(len(os.listdir('/proc/self/task')))\n"
    )
    baseline = program.replace("palr_gym", "gymnasium, grpc")
    assert run_python(program) == run_python(baseline)


def test_optional_dependencies_are_not_imported() -> None:
    program = "import sys, palr_gym; print('h5py' in sys.modules, 'torch' in sys.modules)"
    assert run_python(program) == "False False\n"


def test_a_program_that_forgets_to_close_ends_quietly_and_frees_its_session(server: str) -> None:
    program = (
        "import sys, numpy, palr_gym\n"
        "env = palr_gym.make('hopper', server=sys.argv[1])\n"
        "envs = palr_gym.make_vec('hopper', 3, server=sys.argv[1])\n"
        "envs.reset(seed=0)\n"
        "envs.step(numpy.zeros((3, 3)))\n"
        "print(env._session.session_id, envs._session.session_id)\n"
    )
    session_ids = run_python(program, server).split()
    assert len(session_ids) == 2
    with palr_gym.Client(server) as client:
        for session_id in session_ids:
            session = client.open_session("hopper")
            session.session_id = session_id
            with pytest.raises(palr_gym.NotFound, match=session_id):
                session.reset()


def test_a_forked_child_steps_on_its_own_and_does_not_close_its_parents_session(
    server: str,
) -> None:
    program = (
        "import os, sys, numpy, palr_gym\n"
        "env = palr_gym.make('hopper', server=sys.argv[1])\n"
        "env.reset(seed=0)\n"
        "child = os.fork()\n"
        "if child == 0:\n"
        "    assert env.step(numpy.zeros(3))[0].shape == (11,)\n"
        "    env._session.close()\n"
        "    os._exit(0)\n"
        "assert os.waitpid(child, 0)[1] == 0\n"
        "print(env.step(numpy.zeros(3))[0].shape)\n"
        "env.close()\n"
    )
    assert run_python(program, server) == "(11,)\n"


def test_the_package_has_the_version_of_the_server(server: str) -> None:
    manifest = tomllib.loads((ROOT / "Cargo.toml").read_text())
    assert palr_gym.__version__ == manifest["workspace"]["package"]["version"]
    with palr_gym.Client(server) as client:
        assert client.server_info().version == palr_gym.__version__
