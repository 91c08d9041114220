"""Through a real server, the tasks are Gymnasium's `-v4` and `-v5` environments, bit for bit."""

import itertools
import re
from typing import Any, cast

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import palr_gym
from palr_gym.session import OutOfBounds
from support.reference import (
    MASKS,
    PROFILES,
    MaskedStack,
    assert_same_bits,
    assert_same_info,
    assert_same_infos,
    gymnasium_env,
    gymnasium_vector_env,
    random_actions,
)

# Gymnasium calls its -v4 environments out of date. They are what D4RL's data came from.
pytestmark = pytest.mark.filterwarnings("ignore:.*is out of date:DeprecationWarning")


def check_episodes(
    task: str,
    server: str,
    *,
    seed: int,
    episodes: int,
    bound: float = 1.0,
    out_of_bounds: OutOfBounds = "reject",
) -> None:
    """Plays the same random actions here and there and compares everything that comes back."""
    with (
        gymnasium_env(task) as theirs,
        palr_gym.make(task, server=server, out_of_bounds=out_of_bounds) as ours,
    ):
        for episode in range(episodes):
            # Without a seed, an episode starts from the generator as the last one left it.
            episode_seed = seed if episode == 0 else None
            got = ours.reset(seed=episode_seed)
            expected = theirs.reset(seed=episode_seed)
            where = f"{task}, seed {seed}, episode {episode}, reset"
            assert_same_bits(got[0], expected[0], where)
            check_info(got[1], expected[1], where)

            actions = random_actions(
                seed + episode, 1000, ours.remote_spec.action_space.shape[0], bound=bound
            )
            for step, action in enumerate(actions):
                got = ours.step(action)
                sent = np.clip(action, -1, 1) if out_of_bounds == "clip" else action
                expected = theirs.step(sent)
                where = f"{task}, seed {seed}, episode {episode}, step {step}"
                check_step(got, expected, where)
                if got[2] or got[3]:
                    break
            else:
                pytest.fail(f"{where}: no end after 1000 steps")


def check_step(got: tuple[Any, ...], expected: tuple[Any, ...], where: str) -> None:
    """Compares the five values of a step."""
    assert_same_bits(got[0], expected[0], f"{where}, observation")
    assert_same_bits(got[1], np.float64(expected[1]), f"{where}, reward")
    assert got[2:4] == (bool(expected[2]), bool(expected[3])), where
    assert [type(flag) for flag in got[2:4]] == [bool, bool], where
    check_info(got[4], expected[4], where)


def check_info(got: dict[str, Any], expected: dict[str, Any], where: str) -> None:
    """Compares the infos of single environments."""
    assert set(got) == set(expected), where
    for name, value in got.items():
        assert type(value) is float, where
        assert_same_info(name, value, np.float64(expected[name]), f"{where}, info {name}")


@pytest.mark.timeout(240)
@pytest.mark.parametrize("seed", [0, 7, 2**40 + 1])
@pytest.mark.parametrize("task", PROFILES)
def test_whole_episodes_equal_gymnasium_bit_for_bit(task: str, seed: int, server: str) -> None:
    is_long = task.startswith(("halfcheetah", "ant"))
    check_episodes(task, server, seed=seed, episodes=2 if is_long else 5)


@pytest.mark.timeout(240)
@pytest.mark.parametrize("out_of_bounds", ["raw", "clip"])
@pytest.mark.parametrize("task", PROFILES)
def test_actions_out_of_bounds_are_used_as_gymnasium_does_or_clipped(
    task: str, out_of_bounds: OutOfBounds, server: str
) -> None:
    check_episodes(task, server, seed=3, episodes=1, bound=3.0, out_of_bounds=out_of_bounds)


def test_an_episode_is_truncated_after_a_thousand_steps(server: str) -> None:
    with palr_gym.make("halfcheetah", server=server) as env:
        env.reset(seed=0)
        flags = [env.step(np.zeros(6))[2:4] for _ in range(1000)]
        assert flags == [(False, False)] * 999 + [(False, True)]


@pytest.mark.parametrize(
    "env_id",
    [
        "hopper-w1",
        "hopper-paper",
        "hopper-w3",
        "hopper-strict-w2-v0",
        "walker2d-w2",
        "walker2d-strict",
        "halfcheetah-w5",
        "halfcheetah-strict-w2",
        "halfcheetah-full-w3",
        "ant-w4",
        "ant-strict-w5",
        "ant-full-w64",
        "hopper-gym5-w3",
        "walker2d-strict-gym5-w2-v0",
        "halfcheetah-paper-gym5",
        "ant-gym5-w4",
        "ant-full-gym5-w2",
    ],
)
def test_masks_and_stacks_equal_a_transcription_in_numpy(env_id: str, server: str) -> None:
    match = re.fullmatch(r"(\w+?)(?:-(full|paper|strict))?(-gym5)?(?:-w(\d+))?(?:-v0)?", env_id)
    assert match is not None
    task, frame_stack = match[1], int(match[4] or 1)
    theirs = gymnasium_env(task + (match[3] or ""))
    size = theirs.observation_space.shape or (0,)
    mask = match[2] or "paper"
    stack = MaskedStack(list(range(size[0])) if mask == "full" else MASKS[task][mask], frame_stack)
    with palr_gym.make(env_id, server=server) as ours:
        # Two episodes, the first one given up: the second must start with zeros again.
        expected = np.zeros(0)
        for episode, steps in enumerate([5, 12]):
            expected = stack.reset(theirs.reset(seed=episode)[0])
            assert_same_bits(ours.reset(seed=episode)[0], expected, f"{env_id}, reset {episode}")
            for action in random_actions(episode, steps, ours.remote_spec.action_space.shape[0]):
                expected = stack.push(theirs.step(action)[0])
                assert_same_bits(ours.step(action)[0], expected, env_id)
        assert len(expected) == len(ours.remote_spec.observation_names)


def check_vector_steps(
    ours: palr_gym.RemoteVectorEnv, theirs: Any, *, steps: int, where: str, reset_ended: bool
) -> int:
    """Steps both with equal actions; returns the number of episodes that ended."""
    ends = 0
    actions = random_actions(1, steps, *(ours.num_envs, *ours.remote_spec.action_space.shape))
    for step, action in enumerate(actions):
        got, expected = ours.step(action), theirs.step(action)
        here = f"{where}, step {step}"
        for ours_array, theirs_array in zip(got[:4], expected[:4], strict=True):
            assert_same_bits(ours_array, theirs_array, here)
        assert_same_infos(got[4], expected[4], here)
        ended = got[2] | got[3]
        ends += int(ended.sum())
        if reset_ended and ended.any():
            got_reset = ours.reset(options={"reset_mask": ended})
            expected_reset = theirs.reset(options={"reset_mask": ended.copy()})
            assert_same_bits(got_reset[0], expected_reset[0], f"{here}, reset")
            assert_same_infos(got_reset[1], expected_reset[1], f"{here}, reset")
    return ends


@pytest.mark.timeout(240)
@pytest.mark.parametrize("num_envs", [1, 2, 7])
@pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.name)
@pytest.mark.parametrize("task", ["hopper", "walker2d", "hopper-gym5", "walker2d-gym5"])
def test_vector_env_equals_sync_vector_env(
    task: str, mode: AutoresetMode, num_envs: int, server: str
) -> None:
    theirs = gymnasium_vector_env(task, num_envs, mode)
    with palr_gym.make_vec(task, num_envs, server=server, autoreset_mode=mode) as ours:
        where = f"{task}, {mode.name}, {num_envs} environments"
        got, expected = ours.reset(seed=11), theirs.reset(seed=11)
        assert_same_bits(got[0], expected[0], where)
        assert_same_infos(got[1], expected[1], where)
        ends = check_vector_steps(
            ours, theirs, steps=200, where=where, reset_ended=mode is AutoresetMode.DISABLED
        )
        # Random hoppers and walkers fall after about twenty steps.
        assert ends >= 3 * num_envs


@pytest.mark.timeout(240)
@pytest.mark.parametrize("task", ["halfcheetah", "ant", "halfcheetah-gym5", "ant-gym5"])
@pytest.mark.parametrize(
    "mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP], ids=lambda mode: mode.name
)
def test_vector_env_equals_sync_vector_env_beyond_the_time_limit(
    task: str, mode: AutoresetMode, server: str
) -> None:
    theirs = gymnasium_vector_env(task, 2, mode)
    with palr_gym.make_vec(task, 2, server=server, autoreset_mode=mode) as ours:
        assert_same_bits(ours.reset(seed=5)[0], theirs.reset(seed=5)[0])
        assert check_vector_steps(ours, theirs, steps=1005, where=task, reset_ended=False) >= 2


def test_seeds_of_a_vector_env_mean_what_they_mean_to_gymnasium(server: str) -> None:
    seeds: list[int | list[int | None] | None] = [4, [9, 8, 7], None, [5, None, 6]]
    theirs = gymnasium_vector_env("ant-gym5", 3)
    theirs.reset(seed=0)
    with palr_gym.make_vec("ant-gym5", 3, server=server) as ours:
        ours.reset(seed=0)
        for seed in seeds:
            got, expected = ours.reset(seed=seed), theirs.reset(seed=seed)
            assert_same_bits(got[0], expected[0], f"{seed}")
            assert_same_infos(got[1], expected[1], f"{seed}")


@pytest.mark.parametrize("seed", [None, 100, [5, None, 6, None]])
def test_a_partial_reset_leaves_the_other_environments_alone(
    seed: int | list[int | None] | None, server: str
) -> None:
    theirs = gymnasium_vector_env("walker2d-gym5", 4, AutoresetMode.NEXT_STEP)
    with palr_gym.make_vec("walker2d-gym5", 4, server=server) as ours:
        ours.reset(seed=2)
        theirs.reset(seed=2)
        masks = 0
        for step, action in enumerate(random_actions(0, 150, 4, 6)):
            got, expected = ours.step(action), theirs.step(action)
            assert_same_bits(got[0], expected[0], f"step {step}")
            assert_same_infos(got[4], expected[4], f"step {step}")
            ended = got[2] | got[3]
            if ended.any():
                # Those that ended, which would be reset by the next step, and one more.
                mask = ended.copy()
                mask[step % 4] = True
                masks += int(not mask.all())
                got = ours.reset(seed=seed, options={"reset_mask": mask})
                expected = theirs.reset(seed=seed, options={"reset_mask": mask.copy()})
                assert_same_bits(got[0], expected[0], f"reset after step {step}")
                assert_same_infos(got[1], expected[1], f"reset after step {step}")
        assert masks > 5


def test_sending_and_waiting_is_the_same_as_stepping(server: str) -> None:
    actions = random_actions(0, 60, 3, 3)
    with (
        palr_gym.make_vec("hopper", 3, server=server) as stepped,
        palr_gym.make_vec("hopper", 3, server=server) as sent,
    ):
        stepped.reset(seed=0)
        sent.reset(seed=0)
        for step, action in enumerate(actions):
            sent.step_async(action)
            expected = stepped.step(action)
            got = sent.step_wait()
            for ours_array, theirs_array in zip(got[:4], expected[:4], strict=True):
                assert_same_bits(ours_array, theirs_array, f"step {step}")
            assert_same_infos(got[4], expected[4], f"step {step}")


def arrays_in(value: Any) -> list[np.ndarray[Any, Any]]:
    """Every array in what a step or reset returned."""
    entries: list[Any] = []
    if isinstance(value, np.ndarray):
        array = cast("np.ndarray[Any, Any]", value)
        if array.dtype != object:
            return [array]
        # final_obs holds None or an array for each environment.
        entries = list(array)
    elif isinstance(value, dict):
        entries = list(cast("dict[str, Any]", value).values())
    elif isinstance(value, tuple):
        entries = list(cast("tuple[Any, ...]", value))
    return [array for entry in entries for array in arrays_in(entry)]


@pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.name)
def test_returned_arrays_are_the_callers_own(mode: AutoresetMode, server: str) -> None:
    kept: list[np.ndarray[Any, Any]] = []
    with palr_gym.make_vec("hopper", 2, server=server, autoreset_mode=mode) as env:
        kept += arrays_in(env.reset(seed=0))
        ends = 0
        for action in random_actions(0, 400, 2, 3):
            values = env.step(action)
            ended = values[2] | values[3]
            # Around the end of an episode the infos are made in other ways.
            ends += int(ended.any())
            if len(kept) < 20 or ends:
                kept += arrays_in(values)
            if mode is AutoresetMode.DISABLED and ended.any():
                kept += arrays_in(env.reset(options={"reset_mask": ended}))
            if ends == 3:
                break
        assert ends == 3
        copies = [array.copy() for array in kept]
        env.reset()
        for action in random_actions(1, 3, 2, 3):
            env.step(action)
    for array, copy in zip(kept, copies, strict=True):
        assert array.flags.writeable
        np.testing.assert_array_equal(array, copy)
    for array, other in itertools.combinations(kept, 2):
        assert not np.shares_memory(array, other)


def test_gymnasiums_own_wrappers_work_on_remote_environments(server: str) -> None:
    env = gymnasium.wrappers.vector.RecordEpisodeStatistics(
        gymnasium.make_vec("palr_gym/hopper-v0", num_envs=3, server=server)
    )
    theirs = gymnasium.wrappers.vector.RecordEpisodeStatistics(gymnasium_vector_env("hopper", 3))
    env.reset(seed=0)
    theirs.reset(seed=0)
    returns: list[list[float]] = [[], []]
    for action in random_actions(0, 200, 3, 3):
        for index, wrapped in enumerate((env, theirs)):
            infos = wrapped.step(action)[4]
            if "episode" in infos:
                returns[index] += infos["episode"]["r"][infos["_episode"]].tolist()
    env.close()
    assert len(returns[0]) >= 9
    assert returns[0] == returns[1]
