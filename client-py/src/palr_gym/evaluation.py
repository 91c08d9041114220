"""Evaluation at simulator speed: the server runs policy and environments itself."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from typing import SupportsIndex

from palr_gym._proto.palr_gym.v1 import evaluation_service_pb2
from palr_gym.address import server_or_default
from palr_gym.arguments import unsigned
from palr_gym.connection import DEFAULT_DEADLINE_S, EVALUATE, Connection
from palr_gym.errors import ServerError
from palr_gym.policies import PolicySource, action_mode, policy_message, policy_name
from palr_gym.scene_options import SceneOptions, scene_options_message

DEFAULT_STALL_TIMEOUT_S = 120.0
"""Seconds to wait for each message of a stream."""


@dataclass(frozen=True)
class EpisodeResult:
    """One finished episode."""

    index: int
    """0 to episodes - 1."""
    seed: int
    """The environment's seed."""
    episode_return: float
    """Undiscounted sum of rewards."""
    normalized_score: float
    """0: the random policy's return, 100: the expert's, after D4RL."""
    length: int
    """Steps."""
    terminated: bool
    """The task ended the episode."""
    truncated: bool
    """The time limit ended the episode."""


@dataclass(frozen=True)
class Evaluation:
    """What the episodes say, one by one and together.

    Standard errors use the sample deviation (n - 1); they are NaN for a single episode.
    """

    env_id: str
    """As it was asked for."""
    episodes: tuple[EpisodeResult, ...]
    """In the order of their indices."""
    return_mean: float
    return_standard_error: float
    score_mean: float
    score_standard_error: float
    score_interquartile_mean: float
    """Mean of the middle half of the normalised scores."""
    score_interquartile_mean_low: float
    """Lower end of the 95 % bootstrap interval of the interquartile mean over episodes."""
    score_interquartile_mean_high: float
    length_mean: float
    steps: int
    """Environment steps, all episodes together."""
    wall_time_s: float
    """On the server, from the first reset to the end of the last episode."""
    num_envs: int
    """Environments that ran side by side."""

    @property
    def steps_per_s(self) -> float:
        """Environment steps per second of wall time."""
        return self.steps / self.wall_time_s

    def __str__(self) -> str:
        """The summary in a line."""
        return (
            f"{self.env_id}: normalised score {self.score_mean:.1f} ± "
            f"{self.score_standard_error:.1f}, return {self.return_mean:.1f} ± "
            f"{self.return_standard_error:.1f} (mean ± standard error of {len(self.episodes)} "
            f"episodes), mean length {self.length_mean:.0f}, {self.steps_per_s:.0f} steps/s"
        )


def evaluate(
    env_id: str,
    policy: PolicySource,
    *,
    episodes: SupportsIndex = 20,
    seed: SupportsIndex = 0,
    sampled: bool = False,
    num_envs: SupportsIndex | None = None,
    scene_options: SceneOptions | None = None,
    server: str | None = None,
    on_episode: Callable[[EpisodeResult], None] | None = None,
    timeout_s: float | None = None,
    stall_timeout_s: float = DEFAULT_STALL_TIMEOUT_S,
) -> Evaluation:
    """Plays whole episodes on a server. Actions outside the action space are clipped.

    Args:
        env_id: TASK[-full|-paper|-strict|-pixels][-gym5][-wN][-v0].
        policy: "random", "expert", the path of an ONNX file, or the bytes of one.
        episodes: How many.
        seed: Episode i is reset with seed + i.
        sampled: Whether actions are sampled from the policy (which then needs the outputs `mean`
            and `log_std`) instead of its `action` output.
        num_envs: Environments that run side by side; None: the server chooses.
        scene_options: Of a driving task; None: the defaults.
        server: `host:port` or `unix:/path`; None: $PALR_GYM_SERVER, else localhost:7257.
        on_episode: Called with each episode as it ends, not in the order of their indices.
        timeout_s: Seconds for everything; None: no limit.
        stall_timeout_s: Seconds to wait for the end of the next episode.

    Raises:
        PalrGymError: The kind that fits.
    """
    with closing(Connection(server_or_default(server), DEFAULT_DEADLINE_S)) as connection:
        return run_evaluation(
            connection,
            env_id,
            policy,
            episodes=episodes,
            seed=seed,
            sampled=sampled,
            num_envs=num_envs,
            scene_options=scene_options,
            on_episode=on_episode,
            timeout_s=timeout_s,
            stall_timeout_s=stall_timeout_s,
        )


def run_evaluation(
    connection: Connection,
    env_id: str,
    policy: PolicySource,
    *,
    episodes: SupportsIndex,
    seed: SupportsIndex,
    sampled: bool,
    num_envs: SupportsIndex | None,
    scene_options: SceneOptions | None,
    on_episode: Callable[[EpisodeResult], None] | None,
    timeout_s: float | None,
    stall_timeout_s: float,
) -> Evaluation:
    """`evaluate` over a connection that exists."""
    request = evaluation_request(
        env_id,
        policy,
        episodes=episodes,
        seed=seed,
        sampled=sampled,
        num_envs=num_envs,
        scene_options=scene_options,
    )
    results = EvaluationResults(policy, request, connection.server, on_episode)
    stream = connection.server_stream(
        EVALUATE,
        request,
        asked=results.asked,
        timeout_s=timeout_s,
        stall_timeout_s=stall_timeout_s,
    )
    with closing(stream):
        for message in stream:
            results.take(message)
    return results.evaluation()


def evaluation_request(
    env_id: str,
    policy: PolicySource,
    *,
    episodes: SupportsIndex,
    seed: SupportsIndex,
    sampled: bool,
    num_envs: SupportsIndex | None,
    scene_options: SceneOptions | None,
) -> evaluation_service_pb2.EvaluateRequest:
    """The message for the arguments of `evaluate`."""
    return evaluation_service_pb2.EvaluateRequest(
        env_id=env_id,
        policy=policy_message(policy),
        episodes=unsigned("episodes", episodes, 32),
        seed=unsigned("seed", seed, 64),
        action_mode=action_mode(sampled=sampled),
        num_envs=None if num_envs is None else unsigned("num_envs", num_envs, 32),
        scene_options=scene_options_message(scene_options),
    )


class EvaluationResults:
    """What a server sends in the course of an evaluation."""

    def __init__(
        self,
        policy: PolicySource,
        request: evaluation_service_pb2.EvaluateRequest,
        server: str,
        on_episode: Callable[[EpisodeResult], None] | None,
    ) -> None:
        """Nothing yet."""
        self.asked = f"evaluating {policy_name(policy)} on {request.env_id}"
        """What was asked, for errors."""
        self._request = request
        self._server = server
        self._on_episode = on_episode
        self._episodes: list[EpisodeResult] = []
        self._summary: evaluation_service_pb2.EvaluationSummary | None = None

    def take(self, message: evaluation_service_pb2.EvaluateResponse) -> None:
        """Takes the next message."""
        if message.HasField("episode"):
            result = _episode_result(message.episode)
            self._episodes.append(result)
            if self._on_episode is not None:
                self._on_episode(result)
        elif message.HasField("summary"):
            self._summary = message.summary

    def evaluation(self) -> Evaluation:
        """What they come to, at the end.

        Raises:
            ServerError: Some are missing.
        """
        summary, episodes = self._summary, self._episodes
        if summary is None or summary.episodes != len(episodes):
            raise ServerError(
                f"{self.asked} on {self._server}: the server sent {len(episodes)} of "
                f"{self._request.episodes} episodes and {'no' if summary is None else 'a'} summary"
            )
        return _evaluation(self._request.env_id, episodes, summary)


def _episode_result(message: evaluation_service_pb2.EpisodeResult) -> EpisodeResult:
    return EpisodeResult(
        index=message.index,
        seed=message.seed,
        episode_return=message.episode_return,
        normalized_score=message.normalized_score,
        length=message.length,
        terminated=message.terminated,
        truncated=message.truncated,
    )


def _evaluation(
    env_id: str, results: list[EpisodeResult], summary: evaluation_service_pb2.EvaluationSummary
) -> Evaluation:
    return Evaluation(
        env_id=env_id,
        episodes=tuple(sorted(results, key=lambda result: result.index)),
        return_mean=summary.return_mean,
        return_standard_error=summary.return_standard_error,
        score_mean=summary.score_mean,
        score_standard_error=summary.score_standard_error,
        score_interquartile_mean=summary.score_interquartile_mean,
        score_interquartile_mean_low=summary.score_interquartile_mean_low,
        score_interquartile_mean_high=summary.score_interquartile_mean_high,
        length_mean=summary.length_mean,
        steps=summary.steps,
        wall_time_s=summary.wall_time_s,
        num_envs=summary.num_envs,
    )
