"""Pictures: equal to MuJoCo's own renderer, and delivered as Gymnasium expects them."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from numpy.typing import NDArray

import palr_gym
from palr_gym import Client, errors
from support.server_process import ROOT, ServerProcess, running_server

# Draws a driving scene with MuJoCo's own renderer, at twice the size and averaged, from a state in
# its arguments. In a process of its own: MuJoCo for Python chooses its OpenGL when it is imported.
PEER = """
import json, sys
import mujoco, numpy as np
scene, qpos, out = sys.argv[1], json.loads(sys.argv[2]), sys.argv[3]
model = mujoco.MjModel.from_xml_path(scene)
data = mujoco.MjData(model)
data.qpos[:] = qpos
mujoco.mj_forward(model, data)
renderer = mujoco.Renderer(model, 96, 96)
for camera in ("driver", "top"):
    renderer.update_scene(data, camera=camera)
    renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
    renderer.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
    frame = renderer.render().reshape(48, 2, 48, 2, 3).astype(np.uint16).sum((1, 3))
    np.save(f"{out}/{camera}.npy", ((frame + 2) // 4).astype(np.uint8))
"""


@pytest.fixture(scope="module")
def opengl(shared_server: ServerProcess) -> str:
    """What the server draws with; skips, saying so, where it has nothing."""
    address = shared_server.address
    with palr_gym.make("hopper", server=address, render_mode="rgb_array") as env:
        env.reset(seed=0)
        try:
            env.render()
        except errors.FailedPrecondition as error:
            pytest.skip(f"SKIPPED: {error}")
    with Client(address) as client:
        info = client.server_info().opengl
    assert info is not None
    assert "Mesa" in info.version
    return info.library


@pytest.mark.parametrize(
    ("task", "seed", "scene_options"),
    # The file of the town shows the map of seed 0 to those who know of no other.
    [("lane", 4, {"lead_car_probability": 0.0}), ("town", 0, {"vehicles": 0})],
)
def test_frames_are_those_of_mujocos_own_renderer(
    task: str,
    seed: int,
    scene_options: palr_gym.SceneOptions,
    opengl: str,
    server: str,
    tmp_path: Path,
) -> None:
    frames: dict[str, NDArray[np.uint8]] = {}
    for camera in ("driver", "top"):
        with palr_gym.make(
            task,
            server=server,
            render_mode="rgb_array",
            camera=camera,
            render_size=(48, 48),
            scene_options=scene_options,
        ) as env:
            env.reset(seed=seed)
            frame = env.render()
            assert frame is not None
            frames[camera] = frame
    with Client(server) as client:
        dataset = client.collect(
            task, "expert", transitions=1, seed=seed, scene_options=scene_options
        )
    qpos: list[float] = dataset.infos_qpos[0].tolist()
    subprocess.run(
        [
            sys.executable,
            "-c",
            PEER,
            str(ROOT / "scenes" / f"{task}.xml"),
            json.dumps(qpos),
            str(tmp_path),
        ],
        env={**os.environ, "MUJOCO_GL": opengl, "PYOPENGL_PLATFORM": opengl},
        check=True,
    )
    for camera, frame in frames.items():
        theirs = np.load(tmp_path / f"{camera}.npy")
        assert frame.shape == theirs.shape
        difference = np.abs(frame.astype(int) - theirs.astype(int))
        # The same OpenGL, flags and scene: the same bytes, but for where doubles become floats.
        assert (difference > 2).mean() < 0.002, (camera, difference.max())


@pytest.mark.usefixtures("opengl")
def test_an_environment_renders_as_gymnasium_expects(server: str) -> None:
    with palr_gym.make(
        "hopper", server=server, render_mode="rgb_array", render_size=(64, 40)
    ) as env:
        assert env.metadata["render_modes"] == ["rgb_array"]
        assert env.metadata["render_fps"] == 125
        env.reset(seed=0)
        first = env.render()
        assert first is not None
        assert (first.shape, first.dtype) == ((40, 64, 3), np.uint8)
        np.testing.assert_array_equal(first, env.render())
        for _ in range(20):
            env.step(np.ones(3, dtype=np.float32))
        assert (env.render() != first).any()
        with env.fork() as fork:
            np.testing.assert_array_equal(fork.render(), env.render())
    wrapped = gymnasium.make(
        "palr_gym/lane-v0", server=server, render_mode="rgb_array", render_size=(32, 32)
    )
    wrapped.reset(seed=0)
    frame = wrapped.render()
    assert isinstance(frame, np.ndarray)
    assert frame.shape == (32, 32, 3)
    wrapped.close()
    with palr_gym.make("hopper", server=server) as env:
        env.reset(seed=0)
        assert env.render() is None


@pytest.mark.usefixtures("opengl")
def test_a_vector_renders_every_environment(server: str) -> None:
    size = (48, 48)
    with palr_gym.make_vec(
        "lane", 3, server=server, render_mode="rgb_array", render_size=size
    ) as envs:
        envs.reset(seed=5)
        frames = envs.render()
        assert frames is not None
        assert [frame.shape for frame in frames] == [(48, 48, 3)] * 3
    for index, frame in enumerate(frames):
        with palr_gym.make("lane", server=server, render_mode="rgb_array", render_size=size) as env:
            env.reset(seed=5 + index)
            np.testing.assert_array_equal(env.render(), frame)


@pytest.mark.usefixtures("opengl")
def test_weather_is_seen_and_not_felt(server: str) -> None:
    seen: dict[str, tuple[Any, ...]] = {}
    for weather in ("fixed", "random"):
        with palr_gym.make(
            "lane",
            server=server,
            render_mode="rgb_array",
            render_size=(32, 32),
            scene_options={"weather": weather},
        ) as env:
            observation, _ = env.reset(seed=1)
            seen[weather] = (env.render(), observation, env.step(np.zeros(2, np.float32))[0])
    np.testing.assert_array_equal(seen["fixed"][1], seen["random"][1])
    np.testing.assert_array_equal(seen["fixed"][2], seen["random"][2])
    assert (seen["fixed"][0] != seen["random"][0]).any()


@pytest.mark.usefixtures("opengl")
@pytest.mark.parametrize(
    ("arguments", "reason", "words"),
    [
        ({"camera": "drone"}, "UNKNOWN_CAMERA", "expected .*driver"),
        ({"render_size": (0, 48)}, "IMAGE_SIZE", "0 x 48 pixels; expected 1 to 2048"),
        ({"render_size": (48, 10_000)}, "IMAGE_SIZE", "48 x 10000 pixels"),
    ],
)
def test_an_impossible_picture_is_refused(
    arguments: dict[str, Any], reason: str, words: str, server: str
) -> None:
    with palr_gym.make("lane", server=server, render_mode="rgb_array", **arguments) as env:
        env.reset(seed=0)
        with pytest.raises(errors.InvalidArgument, match=words) as caught:
            env.render()
        assert caught.value.reason == reason


@pytest.mark.parametrize(
    ("env_id", "scene_options", "words"),
    [
        ("lane", {"lead_car_probability": 1.5}, "lead_car_probability is 1.5; expected .*0, 1"),
        ("lane", {"weather": "snow"}, "'snow'; expected one of"),
        ("lane", {"traffic": 3}, "'traffic'; expected some of"),
        ("lane", {"vehicles": 3}, 'task "lane" has no scene option "vehicles"; expected some of'),
        ("town", {"vehicles": 9}, "vehicles is 9; expected 0 to 8"),
        ("town", {"vehicles": -1}, "vehicles is -1; expected an integer"),
        ("town", {"lead_car_probability": 0.5}, 'task "town" has no scene option "lead_car_prob'),
        ("hopper", {"weather": "random"}, 'task "hopper" has no scene options'),
    ],
)
def test_scene_options_are_checked(
    env_id: str, scene_options: palr_gym.SceneOptions, words: str, server: str
) -> None:
    with pytest.raises(errors.InvalidArgument, match=words):
        palr_gym.make(env_id, server=server, scene_options=scene_options)
    with pytest.raises(errors.InvalidArgument, match=words):
        palr_gym.evaluate(env_id, "random", server=server, scene_options=scene_options)
    with pytest.raises(errors.InvalidArgument, match=words):
        palr_gym.collect(env_id, "random", episodes=1, server=server, scene_options=scene_options)


def test_a_server_without_opengl_says_what_to_do() -> None:
    with (
        running_server("--gl", "none") as server,
        palr_gym.make("lane", server=server.address, render_mode="rgb_array") as env,
    ):
        env.reset(seed=0)
        with pytest.raises(errors.FailedPrecondition, match="--gl auto"):
            env.render()
        env.step(np.zeros(2, np.float32))
