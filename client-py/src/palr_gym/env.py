"""One remote environment with Gymnasium's interface."""

import contextlib
from collections.abc import Callable
from typing import Any, NamedTuple, Self, SupportsIndex, cast

import gymnasium
import numpy as np
from gymnasium.error import ClosedEnvironmentError
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from palr_gym import errors
from palr_gym.address import server_or_default
from palr_gym.arguments import unsigned
from palr_gym.connection import DEFAULT_DEADLINE_S, Connection
from palr_gym.errors import InvalidArgument, ResetNeeded
from palr_gym.rendering import RENDER_MODES, Picture, checked_render_mode, render
from palr_gym.results import RestoredState
from palr_gym.scene_options import SceneOptions
from palr_gym.session import ObservationDtype, OutOfBounds, Session
from palr_gym.specs import EnvironmentSpec


class OpenLoop(NamedTuple):
    """What k steps of one environment returned. Every array is the caller's own."""

    observations: NDArray[np.floating[Any]]
    """[k, observation size]"""
    rewards: NDArray[np.float64]
    """[k]"""
    terminated: NDArray[np.bool_]
    """[k]: true in the last place at most."""
    truncated: NDArray[np.bool_]
    """[k]: true in the last place at most."""
    infos: list[dict[str, Any]]
    """One for each step."""


class RemoteEnv(gymnasium.Env[NDArray[np.floating[Any]], NDArray[np.float32]]):
    """An environment that a palr-gym server runs.

    `reset(seed=...)` seeds the server's generator exactly as it seeds Gymnasium's own environment;
    without a seed that generator goes on. The server has its own: `np_random` is seeded along with
    it, but draws from it change nothing.

    Observations are arrays of the caller's own. Actions are converted to float32. The infos of
    `step` are Python floats by the names in `remote_spec.info_names`; those of `reset` by the names
    in `remote_spec.reset_info_names` (none, but for `-gym5`). If the simulation diverges, the
    episode is truncated, and `info["truncation_reason"]` says why.

    Attributes:
        remote_spec: The environment as the server describes it.
    """

    metadata = {"render_modes": list(RENDER_MODES)}  # noqa: RUF012 - as Gymnasium declares it

    def __init__(
        self,
        env_id: str,
        *,
        server: str | None = None,
        out_of_bounds: OutOfBounds = "reject",
        observation_dtype: ObservationDtype = "float64",
        deadline_s: float = DEFAULT_DEADLINE_S,
        render_mode: str | None = None,
        camera: str = "",
        render_size: tuple[SupportsIndex, SupportsIndex] = (480, 480),
        scene_options: SceneOptions | None = None,
    ) -> None:
        """Opens a session of one environment.

        Args:
            env_id: TASK[-full|-paper|-strict|-pixels][-gym5][-wN][-v0].
            server: `host:port` or `unix:/path`; None: $PALR_GYM_SERVER, else localhost:7257.
            out_of_bounds: What happens to an action outside the action space: "reject", "clip",
                or "raw" (used as it is, as Gymnasium does).
            observation_dtype: Element type of observations; the server simulates in float64.
            deadline_s: Seconds that a call waits for its answer.
            render_mode: "rgb_array": `render` returns pictures that the server draws.
            camera: One of `remote_spec.camera_names`; empty: the first of them.
            render_size: Width and height of a picture, in pixels.
            scene_options: For driving tasks, such as {"weather": "random"}.

        Raises:
            PalrGymError: The kind that fits.
        """
        self.render_mode = checked_render_mode(render_mode)
        self._picture = Picture.of(camera, render_size)
        self._connection = Connection(server_or_default(server), deadline_s)
        try:
            self._session = Session(
                self._connection,
                env_id,
                autoreset_mode=AutoresetMode.DISABLED,
                out_of_bounds=out_of_bounds,
                observation_dtype=observation_dtype,
                scene_options=scene_options,
            )
        except BaseException:
            self._connection.close()
            raise
        self._become_ready()

    @classmethod
    def from_snapshot(
        cls,
        snapshot: bytes,
        *,
        server: str | None = None,
        deadline_s: float = DEFAULT_DEADLINE_S,
    ) -> Self:
        """An environment in the state of a snapshot, which may come from another server.

        Args:
            snapshot: From `snapshot` of an environment like this.
            server: As for a new environment.
            deadline_s: As for a new environment.

        Raises:
            PalrGymError: The kind that fits; `InvalidArgument` for a snapshot of a vector too.
        """
        connection = Connection(server_or_default(server), deadline_s)
        return cls._around(connection, lambda: Session.from_snapshot(connection, snapshot))

    @classmethod
    def _around(
        cls, connection: Connection, open_session: Callable[[], tuple[Session, RestoredState]]
    ) -> Self:
        """An environment around a session that stands somewhere already."""
        try:
            session, state = open_session()
            refuse_unless_single(session)
        except BaseException:
            connection.close()
            raise
        env = cls.__new__(cls)
        env.render_mode = None
        env._picture = Picture()
        env._connection = connection
        env._session = session
        env._become_ready()
        env._stand(state)
        return env

    def _become_ready(self) -> None:
        """Sets everything that follows from the session."""
        self.remote_spec: EnvironmentSpec = self._session.spec
        self.observation_space = self.remote_spec.observation_space
        self.action_space = self.remote_spec.action_space
        self.metadata = {
            "render_modes": list(RENDER_MODES),
            "render_fps": round(1 / self.remote_spec.control_timestep_s),
        }
        self._is_playing = False
        self._is_closed = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.floating[Any]], dict[str, Any]]:
        """Starts an episode.

        Args:
            seed: 0 to 2**64 - 1; None: the server's generator goes on.
            options: Ignored, as by Gymnasium's own environments.

        Returns:
            The observation, shape (observation size,), and the info.

        Raises:
            PalrGymError: The kind that fits.
        """
        self._refuse_if_closed("reset")
        seed = None if seed is None else unsigned("seed", seed, 64)
        try:
            result = self._session.reset_with_info(seeds=() if seed is None else (seed,))
        except BaseException as error:
            self._note_failure(error)
            raise
        self._is_playing = True
        super().reset(seed=seed)
        names = self.remote_spec.reset_info_names
        return result.observations[0], dict(zip(names, result.info[:, 0].tolist(), strict=True))

    def step(
        self, action: ArrayLike
    ) -> tuple[NDArray[np.floating[Any]], float, bool, bool, dict[str, Any]]:
        """Steps the environment.

        Args:
            action: Shape (action size,).

        Returns:
            Observation of shape (observation size,), reward, terminated, truncated, info.

        Raises:
            ResetNeeded: There is no episode, it has ended, or an earlier step got no answer.
            PalrGymError: The kind that fits.
        """
        self._refuse_unless_playing("step")
        try:
            result = self._session.step(cast("ArrayLike", [action]))
        except BaseException as error:
            self._note_failure(error)
            raise
        terminated = bool(result.terminated[0])
        truncated = bool(result.truncated[0])
        self._is_playing = not (terminated or truncated)
        info: dict[str, Any] = dict(
            zip(self.remote_spec.info_names, result.info[:, 0].tolist(), strict=True)
        )
        for diverged in result.diverged:
            info["truncation_reason"] = diverged.reason
        return result.observations[0], float(result.rewards[0]), terminated, truncated, info

    def step_open_loop(self, actions: ArrayLike) -> OpenLoop:
        """Takes up to K steps in one message, as K calls of `step` would, with one round trip.

        The step that ends the episode is the last one that is taken.

        Args:
            actions: Shape (K, action size).

        Returns:
            What the k steps returned, k <= K.

        Raises:
            ResetNeeded: As by `step`.
            PalrGymError: The kind that fits; if the server refused, no step was taken.
        """
        self._refuse_unless_playing("step_open_loop")
        try:
            rows = np.asarray(actions, dtype=np.float32)
            result = self._session.step_open_loop(rows[:, None] if rows.ndim == 2 else rows)
        except BaseException as error:
            self._note_failure(error)
            raise
        self._is_playing = not bool(result.terminated[-1, 0] or result.truncated[-1, 0])
        infos: list[dict[str, Any]] = [
            dict(zip(self.remote_spec.info_names, row, strict=True))
            for row in result.info[:, :, 0].T.tolist()
        ]
        for diverged in result.diverged:
            infos[diverged.step]["truncation_reason"] = diverged.reason
        return OpenLoop(
            result.observations[:, 0],
            result.rewards[:, 0],
            result.terminated[:, 0],
            result.truncated[:, 0],
            infos,
        )

    def snapshot(self) -> bytes:
        """Everything that decides what comes next, for `restore` and `from_snapshot`.

        Raises:
            PalrGymError: The kind that fits.
        """
        self._refuse_if_closed("snapshot")
        return self._session.snapshot()

    def restore(self, snapshot: bytes) -> NDArray[np.floating[Any]]:
        """Goes on from a snapshot of this environment or one of its kind.

        If the server has forgotten this environment (it was restarted, say), another one takes its
        place there, so that a program can go on after a crash of its server.

        Returns:
            The observation, shape (observation size,).

        Raises:
            PalrGymError: The kind that fits; after `InvalidArgument` nothing has changed.
        """
        self._refuse_if_closed("restore")
        try:
            self._connection, self._session, state = restore_or_reopen(
                self._connection, self._session, snapshot
            )
        except BaseException as error:
            self._note_failure(error)
            raise
        return self._stand(state)

    def fork(self) -> Self:
        """A second environment that goes on from where this one stands, with the same generator.

        Raises:
            PalrGymError: The kind that fits.
        """
        self._refuse_if_closed("fork")
        connection = Connection(self._connection.server, self._connection.deadline_s)
        env = self._around(connection, lambda: self._session.fork(connection))
        env.render_mode, env._picture = self.render_mode, self._picture
        return env

    def render(self) -> NDArray[np.uint8] | None:  # pyright: ignore[reportIncompatibleMethodOverride] - Gymnasium's type is open
        """A picture of the environment as it stands, [height, width, 3]; None without a mode.

        Raises:
            PalrGymError: The kind that fits; `FailedPrecondition` if the server cannot draw.
        """
        self._refuse_if_closed("render")
        if self.render_mode is None:
            return None
        return render(self._connection, self._session.session_id, self._picture)[0]

    def _stand(self, state: RestoredState) -> NDArray[np.floating[Any]]:
        self._is_playing = state.was_reset and not bool(state.is_over[0])
        return state.observations[0]

    def close(self) -> None:
        """Closes the session, if the server is still there. May be repeated."""
        if self._is_closed:
            return
        self._is_closed = True
        self._is_playing = False
        self._session.close()
        self._connection.close()
        super().close()

    def _note_failure(self, error: BaseException) -> None:
        """Unless the server refused a call, nobody knows where the episode is now."""
        if not errors.is_refusal(error):
            self._is_playing = False
            self._session.abandon_steps()

    def _refuse_unless_playing(self, what: str) -> None:
        if not self._is_playing:
            self._refuse_if_closed(what)
            raise ResetNeeded(
                f"{self.remote_spec.env_id}: no episode is under way (it ended, never began, or a "
                f"call got no answer); call reset() before {what}()"
            )

    def _refuse_if_closed(self, what: str) -> None:
        if self._is_closed:
            raise ClosedEnvironmentError(f"{what}() of {self.remote_spec.env_id} after close()")


def refuse_unless_single(session: Session) -> None:
    """Closes a session of something else than one environment that its caller resets."""
    if session.num_envs != 1 or session.autoreset_mode is not AutoresetMode.DISABLED:
        session.close()
        raise InvalidArgument(
            f"the snapshot is of {session.num_envs} environment(s) of a RemoteVectorEnv; expected "
            "one of a RemoteEnv",
            reason="SNAPSHOT_MISMATCH",
        )


def restore_or_reopen(
    connection: Connection, session: Session, snapshot: bytes
) -> tuple[Connection, Session, RestoredState]:
    """Restores the session, or opens another one like it in its place, on a connection of its own.

    That is done if the server does not know the session any more; and if requests of it got no
    answer, because they might still arrive after the snapshot.
    """
    session.abandon_steps()
    if not session.has_lost_requests:
        with contextlib.suppress(errors.NotFound):
            return connection, session, session.restore(snapshot)
    # A channel that has lost its server looks for it again only after a while; a new one at once.
    fresh = Connection(connection.server, connection.deadline_s)
    try:
        reopened, state = Session.from_snapshot(fresh, snapshot)
        _refuse_unless_alike(reopened, session)
    except BaseException:
        fresh.close()
        raise
    session.close()
    connection.close()
    return fresh, reopened, state


def _refuse_unless_alike(reopened: Session, session: Session) -> None:
    """Closes `reopened` if it cannot take the place of `session`."""
    theirs = (reopened.spec.env_id, reopened.num_envs, reopened.autoreset_mode)
    ours = (session.spec.env_id, session.num_envs, session.autoreset_mode)
    if theirs != ours or reopened.spec.observation_space != session.spec.observation_space:
        reopened.close()
        raise InvalidArgument(
            f"the snapshot is of {theirs[1]} environment(s) of {theirs[0]} ({theirs[2].value}); "
            f"expected {ours[1]} of {ours[0]} ({ours[2].value})",
            reason="SNAPSHOT_MISMATCH",
        )
