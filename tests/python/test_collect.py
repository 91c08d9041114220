"""Demonstrations: arrays that agree with each other, with Gymnasium and with the policy."""

import hashlib
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import palr_gym
from palr_gym import Client, Dataset
from palr_gym._proto.palr_gym.v1 import collection_service_pb2, environment_pb2, tensor_pb2
from palr_gym.collection import CollectedEpisode
from support import onnx_policies
from support.fake_server import fake_server
from support.onnx_policies import NumpyPolicy
from support.reference import MASKS, gymnasium_env
from support.server_process import ROOT

pytestmark = pytest.mark.filterwarnings("ignore:.*is out of date:DeprecationWarning")

HOPPER_EXPERT = ROOT / "scenes" / "experts" / "hopper.onnx"


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def episode_slices(dataset: Dataset) -> list[slice]:
    """Episodes as D4RL finds them: each ends where `terminals | timeouts` is true."""
    ends = np.flatnonzero(dataset.terminals | dataset.timeouts) + 1
    starts = [0, *ends[:-1].tolist()]
    assert ends[-1] == dataset.transitions
    return [slice(start, end) for start, end in zip(starts, ends.tolist(), strict=True)]


def check_consistent(dataset: Dataset, seed: int) -> None:
    """Shapes and types are D4RL's, and arrays agree with each other."""
    n = dataset.transitions
    observation_size = len(dataset.spec.observation_names)
    expected: dict[str, tuple[tuple[int, ...], type[np.generic]]] = {
        "observations": ((n, observation_size), np.float32),
        "actions": ((n, len(dataset.spec.action_names)), np.float32),
        "next_observations": ((n, observation_size), np.float32),
        "rewards": ((n,), np.float32),
        "terminals": ((n,), np.bool_),
        "timeouts": ((n,), np.bool_),
        "episode_seeds": ((dataset.episodes,), np.uint64),
        "episode_lengths": ((dataset.episodes,), np.int64),
    }
    for name, (shape, dtype) in expected.items():
        array: NDArray[Any] = getattr(dataset, name)
        assert (array.shape, array.dtype) == (shape, dtype), name
    assert not (dataset.terminals & dataset.timeouts).any()
    assert np.abs(dataset.actions).max() <= 1

    slices = episode_slices(dataset)
    assert dataset.episode_lengths.tolist() == [part.stop - part.start for part in slices]
    assert dataset.episode_seeds.tolist() == list(range(seed, seed + len(slices)))
    for part in slices:
        np.testing.assert_array_equal(
            dataset.next_observations[part][:-1], dataset.observations[part][1:]
        )


def check_replay(dataset: Dataset, task: str, indices: list[int]) -> None:
    """Gymnasium, given the recorded seeds and actions, gives the recorded data, bit for bit."""
    with gymnasium_env(task) as env:
        simulation: Any = env.unwrapped
        for part, seed in zip(episode_slices(dataset), dataset.episode_seeds, strict=True):
            observation, _ = env.reset(seed=int(seed))
            for t in range(part.start, part.stop):
                np.testing.assert_array_equal(dataset.infos_qpos[t], simulation.data.qpos)
                np.testing.assert_array_equal(dataset.infos_qvel[t], simulation.data.qvel)
                seen = observation[indices].astype(np.float32)
                np.testing.assert_array_equal(dataset.observations[t], seen)
                observation, reward, terminated, truncated, _ = env.step(dataset.actions[t])
                seen = observation[indices].astype(np.float32)
                np.testing.assert_array_equal(dataset.next_observations[t], seen)
                assert dataset.rewards[t] == np.float32(reward)
                assert dataset.terminals[t] == terminated
                is_last = t == dataset.transitions - 1
                assert dataset.timeouts[t] == ((truncated or is_last) and not terminated)


@pytest.mark.parametrize("task", ["hopper", "walker2d", "halfcheetah", "ant"])
def test_random_transitions_replay_in_gymnasium(task: str, client: Client) -> None:
    dataset = client.collect(f"{task}-strict", "random", transitions=1100, seed=5)
    assert dataset.transitions == 1100
    check_consistent(dataset, 5)
    check_replay(dataset, task, MASKS[task]["strict"])
    assert dataset.infos_action_log_probs is None
    assert dataset.policy_sha256 == ""


@pytest.mark.parametrize("transitions", [1, 999, 1000, 1001, 2500])
def test_exactly_the_number_of_transitions_asked_for_is_collected(
    transitions: int, client: Client
) -> None:
    dataset = client.collect("halfcheetah", "random", transitions=transitions, num_envs=2)
    assert dataset.transitions == transitions
    check_consistent(dataset, 0)
    # A cheetah never falls: it runs a thousand steps or is cut.
    whole, rest = divmod(transitions, 1000)
    assert dataset.episode_lengths.tolist() == [1000] * whole + [rest] * (rest > 0)
    assert not dataset.terminals.any()


def test_whole_episodes_are_collected_if_episodes_are_asked_for(client: Client) -> None:
    told: list[CollectedEpisode] = []
    dataset = client.collect("hopper", "random", episodes=25, seed=1, on_episode=told.append)
    assert dataset.episodes == 25
    check_consistent(dataset, 1)
    assert dataset.terminals.sum() == 25
    assert [episode.index for episode in told] == list(range(25))
    assert [episode.length for episode in told] == dataset.episode_lengths.tolist()
    assert not any(episode.cut for episode in told)
    for episode, part in zip(told, episode_slices(dataset), strict=True):
        assert episode.episode_return == pytest.approx(dataset.rewards[part].sum(), rel=1e-5)


def test_a_cut_episode_is_a_timeout(client: Client) -> None:
    told: list[CollectedEpisode] = []
    dataset = client.collect("hopper", "random", transitions=5, on_episode=told.append)
    assert dataset.timeouts.tolist() == [False] * 4 + [True]
    assert [(episode.cut, episode.length) for episode in told] == [(True, 5)]


@pytest.mark.parametrize("num_envs", [1, 3, 16])
def test_random_data_does_not_depend_on_how_many_run_side_by_side(
    num_envs: int, client: Client
) -> None:
    expected = client.collect("hopper-w2", "random", transitions=400, seed=2, num_envs=7)
    got = client.collect("hopper-w2", "random", transitions=400, seed=2, num_envs=num_envs)
    for name in ("observations", "actions", "next_observations", "rewards", "infos_qvel"):
        np.testing.assert_array_equal(getattr(got, name), getattr(expected, name), name)


def test_stacks_are_recorded_as_the_policy_sees_them(client: Client) -> None:
    stacked = client.collect("walker2d-w3", "random", transitions=300, seed=4)
    full = client.collect("walker2d", "random", transitions=300, seed=4)
    indices = MASKS["walker2d"]["paper"]
    for part in episode_slices(full):
        frames = full.observations[part][:, indices]
        padded = np.concatenate([np.zeros((2, len(indices)), dtype=np.float32), frames])
        expected = np.hstack([padded[:-2], padded[1:-1], padded[2:]])
        np.testing.assert_array_equal(stacked.observations[part], expected)


def tanh_gaussian_log_prob(
    actions: NDArray[np.float64], mean: NDArray[np.float64], log_std: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Log density of tanh(z), z Gaussian: that of z minus log |d tanh / dz|, each summed."""
    z = np.arctanh(actions)
    standard = (z - mean) / np.exp(log_std)
    log_density = -0.5 * standard**2 - log_std - 0.5 * math.log(2 * math.pi)
    # log(1 - tanh(z)²) = 2 (log 2 - z - softplus(-2z))
    log_slope = 2 * (math.log(2) - z - np.logaddexp(0, -2 * z))
    return (log_density - log_slope).sum(axis=1)


def test_the_experts_actions_are_those_of_its_onnx_file(client: Client) -> None:
    dataset = client.collect("hopper", "expert", transitions=1500, seed=3)
    check_consistent(dataset, 3)
    check_replay(dataset, "hopper", list(range(11)))
    expected = NumpyPolicy(HOPPER_EXPERT)(dataset.observations).action
    # Products are summed in another order than ONNX Runtime's. One step at a time, from recorded
    # observations, that stays a matter of the last digits; played freely it would not.
    np.testing.assert_allclose(dataset.actions, expected, atol=2e-5)
    assert dataset.policy_sha256 == sha256(HOPPER_EXPERT)


def test_log_probs_of_sampled_actions_are_those_of_a_tanh_gaussian(client: Client) -> None:
    dataset = client.collect("hopper", "expert", transitions=4000, seed=3, sampled=True)
    check_consistent(dataset, 3)
    check_replay(dataset, "hopper", list(range(11)))
    assert dataset.infos_action_log_probs is not None
    output = NumpyPolicy(HOPPER_EXPERT)(dataset.observations)
    mean, log_std = output.mean.astype(np.float64), output.log_std.astype(np.float64)
    actions = dataset.actions.astype(np.float64)
    # Near ±1 the action's 24 bits say too little about z.
    is_inside = (np.abs(actions) < 0.99).all(axis=1)
    assert is_inside.mean() > 0.5
    expected = tanh_gaussian_log_prob(actions[is_inside], mean[is_inside], log_std[is_inside])
    got = dataset.infos_action_log_probs[is_inside]
    np.testing.assert_allclose(got, expected, atol=2e-2)
    assert np.abs(got - expected).mean() < 1e-3

    # And the noise is standard normal.
    noise = ((np.arctanh(actions) - mean) / np.exp(log_std))[is_inside].ravel()
    # (Leaving out actions near ±1 leaves out some large noise.)
    assert abs(noise.mean()) < 0.1
    assert 0.8 < noise.std() < 1.05


def test_the_file_is_d4rls(client: Client, tmp_path: Path) -> None:
    h5py: Any = pytest.importorskip("h5py")
    dataset = client.collect("hopper", "expert", transitions=150, seed=1, sampled=True)
    path = tmp_path / "hopper.hdf5"
    dataset.save(path)
    dataset.save(path)
    assert [entry.name for entry in tmp_path.iterdir()] == ["hopper.hdf5"]

    # As d4rl.offline_env reads it.
    read: dict[str, Any] = {}
    with h5py.File(path, "r") as file:

        def visit(name: str, item: Any) -> None:
            if isinstance(item, h5py.Dataset):
                read[name] = item[()]

        file.visititems(visit)
    arrays = {
        "observations": dataset.observations,
        "actions": dataset.actions,
        "next_observations": dataset.next_observations,
        "rewards": dataset.rewards,
        "terminals": dataset.terminals,
        "timeouts": dataset.timeouts,
        "infos/qpos": dataset.infos_qpos,
        "infos/qvel": dataset.infos_qvel,
        "infos/action_log_probs": dataset.infos_action_log_probs,
        "metadata/episode_seeds": dataset.episode_seeds,
    }
    for name, array in arrays.items():
        assert array is not None
        assert read[name].dtype == array.dtype, name
        np.testing.assert_array_equal(read[name], array, name)
    texts = {name: value.decode() for name, value in read.items() if isinstance(value, bytes)}
    assert texts == {
        "metadata/env_id": "hopper-v0",
        "metadata/policy": "expert",
        "metadata/policy_sha256": sha256(HOPPER_EXPERT),
        "metadata/action_mode": "sampled",
    }
    assert set(read) == set(arrays) | set(texts)


def test_a_file_that_cannot_be_written_leaves_nothing_behind(
    client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    h5py: Any = pytest.importorskip("h5py")
    dataset = client.collect("hopper", "random", transitions=5)
    path = tmp_path / "hopper.hdf5"
    path.write_text("what was there before")

    def fail(*_: object, **__: object) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr(h5py.Group, "create_dataset", fail)
    with pytest.raises(OSError, match="no space left"):
        dataset.save(path)
    assert path.read_text() == "what was there before"
    assert [entry.name for entry in tmp_path.iterdir()] == ["hopper.hdf5"]


def test_saving_without_h5py_says_what_to_install(
    client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset = client.collect("hopper", "random", transitions=5)
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(ImportError, match=r"pip install palr-gym\[hdf5\]"):
        dataset.save(tmp_path / "hopper.hdf5")


def test_a_policy_of_our_own_can_be_given_as_bytes_or_as_a_file(
    server: str, tmp_path: Path
) -> None:
    policy = onnx_policies.linear_policy(np.eye(10, 3, dtype=np.float32))
    path = tmp_path / "policy.onnx"
    path.write_bytes(policy)
    datasets = [
        palr_gym.collect("hopper-w2", given, episodes=3, server=server)
        for given in (policy, path, str(path))
    ]
    assert [dataset.policy for dataset in datasets] == ["onnx", str(path), str(path)]
    for dataset in datasets:
        check_consistent(dataset, 0)
        assert dataset.policy_sha256 == sha256(path)
        np.testing.assert_array_equal(dataset.actions, datasets[0].actions)
        expected = np.tanh(dataset.observations[:, :3])
        np.testing.assert_allclose(dataset.actions, expected, atol=1e-6)


def test_episodes_of_many_megabytes_arrive(client: Client) -> None:
    # A thousand observations of 64 * 17 numbers: twice grpc's usual limit for a message.
    dataset = client.collect("halfcheetah-full-w64", "random", episodes=1)
    assert dataset.observations.shape == (1000, 64 * 17)
    check_consistent(dataset, 0)


@pytest.mark.parametrize(
    ("terminated", "truncated", "cut", "terminal", "timeout"),
    [
        (True, False, False, True, False),
        (False, True, False, False, True),
        (False, False, True, False, True),
        # In the last step that its time allows, a walker may fall.
        (True, True, False, True, False),
        (True, False, True, True, False),
    ],
)
def test_an_episode_ends_at_a_terminal_or_at_a_timeout_and_never_at_both(
    terminated: bool, truncated: bool, cut: bool, terminal: bool, timeout: bool
) -> None:
    def tensor(*shape: int, dtype: str = "FLOAT64") -> tensor_pb2.Tensor:
        size = math.prod(shape) * (4 if dtype == "FLOAT32" else 8)
        return tensor_pb2.Tensor(dtype=f"DATA_TYPE_{dtype}", shape=shape, data=bytes(size))

    box = environment_pb2.BoxSpace(shape=[1], low=[-1], high=[1], names=["a"])
    spec = environment_pb2.EnvironmentSpec(observation_space=box, action_space=box)
    started = collection_service_pb2.CollectionStarted(spec=spec)
    episode = collection_service_pb2.EpisodeTransitions(
        observations=tensor(2, 1),
        actions=tensor(2, 1, dtype="FLOAT32"),
        rewards=tensor(2),
        next_observations=tensor(2, 1),
        terminated=terminated,
        truncated=truncated,
        cut=cut,
        qpos=tensor(2, 3),
        qvel=tensor(2, 3),
    )

    def collect(_request: bytes, _context: object) -> Iterator[bytes]:
        for message in (
            collection_service_pb2.CollectResponse(started=started),
            collection_service_pb2.CollectResponse(episode=episode),
        ):
            yield message.SerializeToString()

    with fake_server("CollectionService", {}, {"Collect": collect}) as address:
        dataset = palr_gym.collect("tiny", "random", episodes=1, server=address)
    assert dataset.terminals.tolist() == [False, terminal]
    assert dataset.timeouts.tolist() == [False, timeout]
