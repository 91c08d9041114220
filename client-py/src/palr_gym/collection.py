"""Demonstrations: whole episodes that a server plays and records, in D4RL's layout."""

import os
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from typing import Any, SupportsIndex

import numpy as np
from numpy.typing import NDArray

from palr_gym import d4rl
from palr_gym._proto.palr_gym.v1 import collection_service_pb2, tensor_pb2
from palr_gym.address import server_or_default
from palr_gym.arguments import unsigned
from palr_gym.connection import COLLECT, DEFAULT_DEADLINE_S, Connection
from palr_gym.errors import InvalidArgument, ServerError
from palr_gym.evaluation import DEFAULT_STALL_TIMEOUT_S
from palr_gym.policies import PolicySource, action_mode, policy_message, policy_name
from palr_gym.scene_options import SceneOptions, scene_options_message
from palr_gym.specs import EnvironmentSpec, environment_spec
from palr_gym.tensors import FLOAT32, FLOAT64, UINT8, to_array


@dataclass(frozen=True)
class CollectedEpisode:
    """What `on_episode` is told about an episode."""

    index: int
    seed: int
    """The environment's seed."""
    episode_return: float
    """Undiscounted sum of the rewards that were recorded."""
    length: int
    """Transitions that were recorded."""
    terminated: bool
    """The task ended the episode."""
    truncated: bool
    """The time limit ended the episode."""
    cut: bool
    """The requested number of transitions was reached before the episode ended."""


@dataclass(frozen=True, eq=False)
class Dataset:
    """N transitions of E episodes, one after the other, as D4RL lays them out.

    An episode ends where `terminals | timeouts` is true, and only there.
    """

    spec: EnvironmentSpec
    """The environment whose observations were recorded."""
    policy: str
    """Name or path of the policy; "onnx" if only its bytes were given."""
    policy_sha256: str
    """SHA-256 of the policy's ONNX file; empty for the random policy."""
    sampled: bool
    """Whether actions were sampled from the policy."""
    observations: NDArray[np.float32]
    """[N, observation size]: what the policy saw before each action."""
    actions: NDArray[np.float32]
    """[N, action size]"""
    next_observations: NDArray[np.float32]
    """[N, observation size]: what followed each action, the last of an episode included."""
    rewards: NDArray[np.float32]
    """[N]"""
    terminals: NDArray[np.bool_]
    """[N]: the task ended the episode here."""
    timeouts: NDArray[np.bool_]
    """[N]: the episode ended here, but not by the task: its time was up, or the requested number
    of transitions was reached."""
    infos_qpos: NDArray[np.float64]
    """[N, nq]: generalised positions before each action."""
    infos_qvel: NDArray[np.float64]
    """[N, nv]: generalised velocities before each action."""
    infos_action_log_probs: NDArray[np.float32] | None
    """[N]: log density of each action; None if the policy states none."""
    episode_seeds: NDArray[np.uint64]
    """[E]: the environment's seed in each episode."""
    episode_lengths: NDArray[np.int64]
    """[E]: transitions of each episode."""

    @property
    def transitions(self) -> int:
        """N."""
        return len(self.rewards)

    @property
    def episodes(self) -> int:
        """E."""
        return len(self.episode_lengths)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes D4RL's HDF5 file: all of it or, after an error, nothing.

        Raises:
            ImportError: h5py is not installed (`pip install palr-gym[hdf5]`).
            OSError: The file cannot be written.
        """
        arrays: dict[str, NDArray[Any]] = {
            "observations": self.observations,
            "actions": self.actions,
            "next_observations": self.next_observations,
            "rewards": self.rewards,
            "terminals": self.terminals,
            "timeouts": self.timeouts,
            "infos/qpos": self.infos_qpos,
            "infos/qvel": self.infos_qvel,
            "metadata/episode_seeds": self.episode_seeds,
        }
        if self.infos_action_log_probs is not None:
            arrays["infos/action_log_probs"] = self.infos_action_log_probs
        texts = {
            "metadata/env_id": self.spec.env_id,
            "metadata/policy": self.policy,
            "metadata/policy_sha256": self.policy_sha256,
            "metadata/action_mode": "sampled" if self.sampled else "deterministic",
        }
        d4rl.write_hdf5(path, arrays, texts)


def collect(
    env_id: str,
    policy: PolicySource,
    *,
    transitions: SupportsIndex | None = None,
    episodes: SupportsIndex | None = None,
    seed: SupportsIndex = 0,
    sampled: bool = False,
    num_envs: SupportsIndex | None = None,
    scene_options: SceneOptions | None = None,
    server: str | None = None,
    on_episode: Callable[[CollectedEpisode], None] | None = None,
    timeout_s: float | None = None,
    stall_timeout_s: float = DEFAULT_STALL_TIMEOUT_S,
) -> Dataset:
    """Records demonstrations on a server. Actions outside the action space are clipped.

    Args:
        env_id: TASK[-full|-paper|-strict|-pixels][-gym5][-wN][-v0], whose observations are kept.
        policy: "random", "expert", the path of an ONNX file, or the bytes of one.
        transitions: Exactly this many; the last episode is cut where they are reached.
        episodes: This many whole episodes. Name either `transitions` or `episodes`.
        seed: Episode i is reset with seed + i.
        sampled: Whether actions are sampled from the policy (which then needs the outputs `mean`
            and `log_std`) instead of its `action` output.
        num_envs: Environments that run side by side; None: the server chooses.
        scene_options: Of a driving task; None: the defaults.
        server: `host:port` or `unix:/path`; None: $PALR_GYM_SERVER, else localhost:7257.
        on_episode: Called with each episode, in the order of their indices.
        timeout_s: Seconds for everything; None: no limit.
        stall_timeout_s: Seconds to wait for the next episode.

    Raises:
        PalrGymError: The kind that fits.
    """
    with closing(Connection(server_or_default(server), DEFAULT_DEADLINE_S)) as connection:
        return run_collection(
            connection,
            env_id,
            policy,
            transitions=transitions,
            episodes=episodes,
            seed=seed,
            sampled=sampled,
            num_envs=num_envs,
            scene_options=scene_options,
            on_episode=on_episode,
            timeout_s=timeout_s,
            stall_timeout_s=stall_timeout_s,
        )


def run_collection(
    connection: Connection,
    env_id: str,
    policy: PolicySource,
    *,
    transitions: SupportsIndex | None,
    episodes: SupportsIndex | None,
    seed: SupportsIndex,
    sampled: bool,
    num_envs: SupportsIndex | None,
    scene_options: SceneOptions | None,
    on_episode: Callable[[CollectedEpisode], None] | None,
    timeout_s: float | None,
    stall_timeout_s: float,
) -> Dataset:
    """`collect` over a connection that exists."""
    asked = f"collecting {policy_name(policy)} on {env_id}"
    if (transitions is None) == (episodes is None):
        raise InvalidArgument(
            f"{asked}: transitions is {transitions!r} and episodes is {episodes!r}; expected one "
            "of the two"
        )
    request = collection_service_pb2.CollectRequest(
        env_id=env_id,
        policy=policy_message(policy),
        transitions=None if transitions is None else unsigned("transitions", transitions, 64),
        episodes=None if episodes is None else unsigned("episodes", episodes, 32),
        seed=unsigned("seed", seed, 64),
        action_mode=action_mode(sampled=sampled),
        num_envs=None if num_envs is None else unsigned("num_envs", num_envs, 32),
        scene_options=scene_options_message(scene_options),
    )
    recorder: _Recorder | None = None
    stream = connection.server_stream(
        COLLECT, request, asked=asked, timeout_s=timeout_s, stall_timeout_s=stall_timeout_s
    )
    with closing(stream):
        for message in stream:
            if message.HasField("started"):
                recorder = _Recorder(message.started)
            elif message.HasField("episode") and recorder is not None:
                episode = recorder.add(message.episode)
                if on_episode is not None:
                    on_episode(episode)
    if recorder is None or not recorder.rewards:
        raise ServerError(f"{asked} on {connection.server}: the server sent no episodes")
    return recorder.dataset(policy=policy_name(policy), sampled=sampled)


class _Recorder:
    """Episodes as they come, in the types in which they are kept."""

    def __init__(self, started: collection_service_pb2.CollectionStarted) -> None:
        self._spec = environment_spec(started.spec)
        self._policy_sha256 = started.policy_sha256
        self._observations: list[NDArray[np.float32]] = []
        self._actions: list[NDArray[np.float32]] = []
        self._next_observations: list[NDArray[np.float32]] = []
        self.rewards: list[NDArray[np.float32]] = []
        self._terminals: list[NDArray[np.bool_]] = []
        self._timeouts: list[NDArray[np.bool_]] = []
        self._qpos: list[NDArray[np.float64]] = []
        self._qvel: list[NDArray[np.float64]] = []
        self._action_log_probs: list[NDArray[np.float32]] = []
        self._seeds: list[int] = []

    def add(self, message: collection_service_pb2.EpisodeTransitions) -> CollectedEpisode:
        """Takes one episode in."""
        rewards: NDArray[np.float64] = to_array(message.rewards, FLOAT64, [-1])
        length = len(rewards)
        observations_shape = [length, *self._spec.observation_space.shape]
        actions_shape = [length, *self._spec.action_space.shape]

        def observations(tensor: tensor_pb2.Tensor) -> NDArray[Any]:
            if self._spec.observation_space.dtype == UINT8:
                return to_array(tensor, UINT8, observations_shape)
            return to_array(tensor, FLOAT64, observations_shape).astype(np.float32)

        self._observations.append(observations(message.observations))
        self._actions.append(to_array(message.actions, FLOAT32, actions_shape))
        self._next_observations.append(observations(message.next_observations))
        self.rewards.append(rewards.astype(np.float32))
        self._terminals.append(_flag_at_end(length, message.terminated))
        self._timeouts.append(
            _flag_at_end(length, (message.truncated or message.cut) and not message.terminated)
        )
        self._qpos.append(to_array(message.qpos, FLOAT64, [length, -1]))
        self._qvel.append(to_array(message.qvel, FLOAT64, [length, -1]))
        if message.HasField("action_log_probs"):
            log_probs = to_array(message.action_log_probs, FLOAT64, [length])
            self._action_log_probs.append(log_probs.astype(np.float32))
        self._seeds.append(message.seed)
        return CollectedEpisode(
            index=message.index,
            seed=message.seed,
            episode_return=float(rewards.sum()),
            length=length,
            terminated=message.terminated,
            truncated=message.truncated,
            cut=message.cut,
        )

    def dataset(self, *, policy: str, sampled: bool) -> Dataset:
        """Everything so far, in one piece."""
        has_log_probs = len(self._action_log_probs) == len(self.rewards)
        return Dataset(
            spec=self._spec,
            policy=policy,
            policy_sha256=self._policy_sha256,
            sampled=sampled,
            observations=np.concatenate(self._observations),
            actions=np.concatenate(self._actions),
            next_observations=np.concatenate(self._next_observations),
            rewards=np.concatenate(self.rewards),
            terminals=np.concatenate(self._terminals),
            timeouts=np.concatenate(self._timeouts),
            infos_qpos=np.concatenate(self._qpos),
            infos_qvel=np.concatenate(self._qvel),
            infos_action_log_probs=(
                np.concatenate(self._action_log_probs) if has_log_probs else None
            ),
            episode_seeds=np.array(self._seeds, dtype=np.uint64),
            episode_lengths=np.array([len(rewards) for rewards in self.rewards], dtype=np.int64),
        )


def _flag_at_end(length: int, flag: bool) -> NDArray[np.bool_]:
    flags = np.zeros(length, dtype=np.bool_)
    flags[-1:] = flag
    return flags
