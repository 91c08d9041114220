"""Everything that a server offers."""

from collections.abc import Callable
from typing import Self, SupportsIndex

from gymnasium.vector import AutoresetMode

from palr_gym import specs
from palr_gym._proto.palr_gym.v1 import environment_service_pb2, server_service_pb2
from palr_gym.address import DEFAULT_SERVER, SERVER_VARIABLE, server_or_default
from palr_gym.collection import CollectedEpisode, Dataset, run_collection
from palr_gym.connection import (
    DEFAULT_DEADLINE_S,
    GET_ENVIRONMENT_SPEC,
    GET_SERVER_INFO,
    LIST_TASKS,
    Connection,
)
from palr_gym.evaluation import (
    DEFAULT_STALL_TIMEOUT_S,
    EpisodeResult,
    Evaluation,
    run_evaluation,
)
from palr_gym.policies import PolicySource
from palr_gym.results import RestoredState
from palr_gym.scene_options import SceneOptions
from palr_gym.session import ObservationDtype, OutOfBounds, Session

__all__ = ["DEFAULT_SERVER", "SERVER_VARIABLE", "Client"]


class Client:
    """A connection to one server.

    Every call raises a `PalrGymError` of the fitting kind if it fails, and none waits for longer
    than its deadline. Thread-safe; the sessions it opens are not.

    Example:
        >>> with Client("localhost:7257") as client:
        ...     print([task.name for task in client.tasks()])
        ['ant', 'halfcheetah', 'hopper', 'lane', 'toy', 'walker2d']
    """

    def __init__(
        self, server: str | None = None, *, deadline_s: float = DEFAULT_DEADLINE_S
    ) -> None:
        """Opens no connection yet.

        Args:
            server: `host:port` or `unix:/path`; None: $PALR_GYM_SERVER, else localhost:7257.
            deadline_s: Seconds that a call waits for its answer. `evaluate` and `collect` have
                their own limits.

        Raises:
            InvalidArgument: `server` is no address, or `deadline_s` no positive number.
        """
        self._connection = Connection(server_or_default(server), deadline_s)

    @property
    def server(self) -> str:
        """Address of the server."""
        return self._connection.server

    @property
    def deadline_s(self) -> float:
        """Seconds that a call waits for its answer."""
        return self._connection.deadline_s

    def server_info(self) -> specs.ServerInfo:
        """Versions and limits of the server."""
        request = server_service_pb2.GetServerInfoRequest()
        response = self._connection.unary(
            GET_SERVER_INFO, request, asked="asking for versions and limits"
        )
        return specs.server_info(response)

    def tasks(self) -> tuple[specs.Task, ...]:
        """Every task that the server hosts, in alphabetical order."""
        request = environment_service_pb2.ListTasksRequest()
        return specs.tasks(self._connection.unary(LIST_TASKS, request, asked="listing the tasks"))

    def spec(self, env_id: str) -> specs.EnvironmentSpec:
        """Spaces and constants of an environment, without opening it.

        Args:
            env_id: TASK[-full|-paper|-strict|-pixels][-gym5][-wN][-v0].
        """
        request = environment_service_pb2.GetEnvironmentSpecRequest(env_id=env_id)
        response = self._connection.unary(
            GET_ENVIRONMENT_SPEC, request, asked=f"describing {env_id}"
        )
        return specs.environment_spec(response.spec)

    def open_session(
        self,
        env_id: str,
        *,
        num_envs: SupportsIndex = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        out_of_bounds: OutOfBounds = "reject",
        observation_dtype: ObservationDtype = "float64",
        scene_options: SceneOptions | None = None,
    ) -> Session:
        """Opens environments to step; `RemoteEnv` and `RemoteVectorEnv` give them Gymnasium's face.

        Args:
            env_id: TASK[-full|-paper|-strict|-pixels][-gym5][-wN][-v0].
            num_envs: How many.
            autoreset_mode: What happens to an environment whose episode has ended.
            out_of_bounds: What happens to an action outside the action space.
            observation_dtype: Element type of observations on the wire and in arrays.
            scene_options: Of a driving task; None: the defaults.
        """
        return Session(
            self._connection,
            env_id,
            num_envs=num_envs,
            autoreset_mode=autoreset_mode,
            out_of_bounds=out_of_bounds,
            observation_dtype=observation_dtype,
            scene_options=scene_options,
        )

    def open_snapshot(self, snapshot: bytes) -> tuple[Session, RestoredState]:
        """Opens a session in the state of a snapshot, which may come from another server.

        Args:
            snapshot: From `snapshot` of a session or environment.
        """
        return Session.from_snapshot(self._connection, snapshot)

    def evaluate(
        self,
        env_id: str,
        policy: PolicySource,
        *,
        episodes: SupportsIndex = 20,
        seed: SupportsIndex = 0,
        sampled: bool = False,
        num_envs: SupportsIndex | None = None,
        scene_options: SceneOptions | None = None,
        on_episode: Callable[[EpisodeResult], None] | None = None,
        timeout_s: float | None = None,
        stall_timeout_s: float = DEFAULT_STALL_TIMEOUT_S,
    ) -> Evaluation:
        """Like `palr_gym.evaluate`, on this client's server."""
        return run_evaluation(
            self._connection,
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

    def collect(
        self,
        env_id: str,
        policy: PolicySource,
        *,
        transitions: SupportsIndex | None = None,
        episodes: SupportsIndex | None = None,
        seed: SupportsIndex = 0,
        sampled: bool = False,
        num_envs: SupportsIndex | None = None,
        scene_options: SceneOptions | None = None,
        on_episode: Callable[[CollectedEpisode], None] | None = None,
        timeout_s: float | None = None,
        stall_timeout_s: float = DEFAULT_STALL_TIMEOUT_S,
    ) -> Dataset:
        """Like `palr_gym.collect`, on this client's server."""
        return run_collection(
            self._connection,
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

    def close(self) -> None:
        """Closes the connection. Sessions are not closed by this. May be repeated."""
        self._connection.close()

    def __enter__(self) -> Self:
        """Returns itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Closes the connection."""
        self.close()
