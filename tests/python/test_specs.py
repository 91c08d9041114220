"""What the server says about tasks and environments is what the field knows about them."""

import hashlib
import importlib.metadata
from dataclasses import dataclass

import numpy as np
import pytest

import palr_gym
from palr_gym import Client, InvalidArgument
from support.reference import GYM5_IDS, GYMNASIUM_IDS, MASKS, PROFILES, TASKS, gymnasium_env
from support.server_process import ROOT

pytestmark = pytest.mark.filterwarnings("ignore:.*is out of date:DeprecationWarning")


@dataclass(frozen=True)
class Facts:
    """Gymnasium's documentation of a task."""

    observation_size: int
    action_size: int
    frame_skip: int
    physics_timestep_s: float


FACTS = {
    "hopper": Facts(11, 3, 4, 0.002),
    "walker2d": Facts(17, 6, 4, 0.002),
    "halfcheetah": Facts(17, 6, 5, 0.01),
    "ant": Facts(27, 8, 5, 0.01),
}


def test_every_task_is_listed_with_its_facts(client: Client) -> None:
    tasks = {task.name: task for task in client.tasks()}
    assert list(tasks) == sorted([*TASKS, "lane", "town", "toy"])
    assert [profile.name for profile in tasks["toy"].fidelity_profiles] == ["gym4"]
    for name, facts in FACTS.items():
        task = tasks[name]
        assert task.equals.endswith(GYMNASIUM_IDS[name])
        profiles = {profile.name: profile for profile in task.fidelity_profiles}
        assert list(profiles) == ["gym4", "gym5"]
        assert profiles["gym4"].equals == task.equals
        assert profiles["gym4"].full_observation_size == facts.observation_size
        assert profiles["gym5"].equals.endswith(GYM5_IDS[f"{name}-gym5"])
        assert (profiles["gym4"].id_suffix, profiles["gym5"].id_suffix) == ("", "-gym5")
        assert task.description
        assert task.full_observation_size == facts.observation_size
        assert task.action_size == facts.action_size
        assert task.max_episode_steps == 1000
        assert task.masks == {
            "full": tuple(range(facts.observation_size)),
            "paper": tuple(MASKS[name]["paper"]),
            "strict": tuple(MASKS[name]["strict"]),
        }


@pytest.mark.parametrize("task", TASKS)
def test_experts_are_the_files_that_ship(task: str, client: Client) -> None:
    [expert] = [listed.expert for listed in client.tasks() if listed.name == task]
    path = ROOT / "scenes" / "experts" / f"{task}.onnx"
    assert (expert is not None) == path.exists() == client.spec(task).has_expert
    if expert is not None:
        assert expert.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
        assert (ROOT / expert.model_card).is_file()
        assert expert.card_return > 1000


@pytest.mark.parametrize(
    ("env_id", "canonical", "mask", "frame_stack"),
    [
        ("{}", "{}-v0", "full", 1),
        ("{}-v0", "{}-v0", "full", 1),
        ("{}-w1", "{}-w1-v0", "paper", 1),
        ("{}-paper", "{}-w1-v0", "paper", 1),
        ("{}-strict-w3-v0", "{}-strict-w3-v0", "strict", 3),
        ("{}-full-w64", "{}-full-w64-v0", "full", 64),
        ("{}-gym5-w2", "{}-gym5-w2-v0", "paper", 2),
        ("{}-strict-gym5", "{}-strict-gym5-w1-v0", "strict", 1),
    ],
)
@pytest.mark.parametrize("task", TASKS)
def test_a_spec_resolves_an_id(
    task: str, env_id: str, canonical: str, mask: str, frame_stack: int, client: Client
) -> None:
    spec = client.spec(env_id.format(task))
    facts = FACTS[task]
    assert spec.env_id == canonical.format(task)
    assert (spec.task, spec.mask, spec.frame_stack) == (task, mask, frame_stack)
    indices = {**MASKS[task], "full": list(range(facts.observation_size))}[mask]
    assert spec.mask_indices == tuple(indices)
    assert spec.max_episode_steps == 1000
    assert spec.frame_skip == facts.frame_skip
    assert spec.physics_timestep_s == facts.physics_timestep_s
    assert spec.control_timestep_s == pytest.approx(facts.frame_skip * facts.physics_timestep_s)

    for space, names in (
        (spec.observation_space, spec.observation_names),
        (spec.action_space, spec.action_names),
    ):
        assert space.shape == (len(names),)
        assert len(set(names)) == len(names)
    newest = spec.observation_names[-len(indices) :]
    full_names = client.spec(task).observation_names
    assert newest == tuple(full_names[index] for index in indices)
    for age in range(1, frame_stack):
        end = len(spec.observation_names) - age * len(indices)
        older = spec.observation_names[end - len(indices) : end]
        assert older == tuple(f"{name}[t-{age}]" for name in newest)


@pytest.mark.parametrize("profile", PROFILES)
def test_spaces_hold_what_gymnasiums_spaces_hold(profile: str, client: Client) -> None:
    spec = client.spec(profile)
    task = spec.task
    assert spec.fidelity == ("gym5" if profile.endswith("-gym5") else "gym4")
    assert spec.equals.endswith((GYMNASIUM_IDS | GYM5_IDS)[profile])
    theirs = gymnasium_env(profile)
    assert spec.action_space == theirs.action_space
    assert spec.observation_space.dtype == theirs.observation_space.dtype
    assert spec.observation_space.shape == theirs.observation_space.shape
    assert sorted(spec.reset_info_names) == sorted(theirs.reset(seed=0)[1])
    info = theirs.step(np.zeros(FACTS[task].action_size, dtype=np.float32))[4]
    assert sorted(spec.info_names) == sorted(info)
    # Gymnasium bounds nothing in the space, but clips these two tasks' velocities in fact, and
    # contact forces.
    is_velocity = np.array(["qvel" in name for name in spec.observation_names])
    bound = np.where(is_velocity & (task in ("hopper", "walker2d")), 10.0, np.inf)
    bound[["cfrc_ext" in name for name in spec.observation_names]] = 1.0
    np.testing.assert_array_equal(spec.observation_space.high, bound)
    np.testing.assert_array_equal(spec.observation_space.low, -bound)


def test_the_server_says_what_it_is_and_allows(client: Client) -> None:
    info = client.server_info()
    assert info.version == palr_gym.__version__
    assert info.mujoco_version == importlib.metadata.version("mujoco")
    assert info.simulation_threads >= 1
    limits = info.limits
    assert limits.max_frame_stack == 64
    for value in vars(limits).values():
        assert value >= 1
    assert limits.max_envs >= limits.max_envs_per_session


def test_the_lane_task_is_listed_with_its_own_facts(client: Client) -> None:
    [task] = [task for task in client.tasks() if task.name == "lane"]
    assert (task.equals, task.action_size, task.max_episode_steps) == ("", 2, 250)
    assert {mask: len(indices) for mask, indices in task.masks.items()} == {
        "full": 12,
        "paper": 0,
        "pixels": 0,
    }
    assert [profile.name for profile in task.fidelity_profiles] == ["gym4"]
    assert task.expert is not None
    assert task.expert.sha256 == ""
    assert task.expert.card_return == task.reference_returns.expert
    assert (ROOT / task.expert.model_card).is_file()
    spec = client.spec("lane")
    assert spec.has_expert
    assert spec.control_timestep_s == pytest.approx(0.05)
    assert spec.observation_space.shape == (task.full_observation_size,)
    for env_id in ("lane-strict", "lane-gym5", "hopper-pixels"):
        with pytest.raises(InvalidArgument, match=r"has no .* variant"):
            client.spec(env_id)
