"""Many remote environments with Gymnasium's vector interface."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Self, SupportsIndex

import gymnasium
import numpy as np
from gymnasium.error import AlreadyPendingCallError, ClosedEnvironmentError, NoAsyncCallError
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from palr_gym import errors
from palr_gym.address import server_or_default
from palr_gym.arguments import reset_mask, unsigned
from palr_gym.connection import DEFAULT_DEADLINE_S, Connection
from palr_gym.env import restore_or_reopen
from palr_gym.errors import InvalidArgument, ResetNeeded
from palr_gym.rendering import RENDER_MODES, Picture, checked_render_mode, render
from palr_gym.results import ResetResult, RestoredState, StepResult, single_steps
from palr_gym.scene_options import SceneOptions
from palr_gym.session import ObservationDtype, OutOfBounds, Session
from palr_gym.specs import EnvironmentSpec

VectorStep = tuple[
    NDArray[np.floating[Any]],
    NDArray[np.float64],
    NDArray[np.bool_],
    NDArray[np.bool_],
    dict[str, Any],
]


class VectorOpenLoop(NamedTuple):
    """What k steps of N environments returned. Every array is the caller's own."""

    observations: NDArray[np.floating[Any]]
    """[k, N, observation size]"""
    rewards: NDArray[np.float64]
    """[k, N]"""
    terminated: NDArray[np.bool_]
    """[k, N]"""
    truncated: NDArray[np.bool_]
    """[k, N]"""
    infos: list[dict[str, Any]]
    """One for each step, as `step` returns it."""


class RemoteVectorEnv(VectorEnv[NDArray[np.floating[Any]], NDArray[np.float32], NDArray[Any]]):
    """Environments that a palr-gym server steps side by side, in one call.

    Behaves as `gymnasium.vector.SyncVectorEnv` around the same environments does: seeding,
    autoreset modes, `reset(options={"reset_mask": ...})`, layout of `infos`. Every array that is
    returned is new and the caller's own. Infos are always float64. If a simulation diverges, its
    episode is truncated, and `infos["truncation_reason"]` says why.

    `step_async` sends a step and `step_wait` takes its result, so that the client can work (or
    step another vector environment) while the server does.

    Attributes:
        remote_spec: The environment as the server describes it.
    """

    # Gymnasium declares spaces of anything.
    single_observation_space: "gymnasium.Space[NDArray[np.floating[Any]]]"
    single_action_space: "gymnasium.Space[NDArray[np.float32]]"
    observation_space: "gymnasium.Space[NDArray[np.floating[Any]]]"
    action_space: "gymnasium.Space[NDArray[np.float32]]"

    def __init__(
        self,
        env_id: str,
        num_envs: SupportsIndex = 1,
        *,
        server: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        out_of_bounds: OutOfBounds = "reject",
        observation_dtype: ObservationDtype = "float64",
        deadline_s: float = DEFAULT_DEADLINE_S,
        render_mode: str | None = None,
        camera: str = "",
        render_size: tuple[SupportsIndex, SupportsIndex] = (480, 480),
        scene_options: SceneOptions | None = None,
    ) -> None:
        """Opens a session of `num_envs` environments.

        Args:
            env_id: TASK[-full|-paper|-strict|-pixels][-gym5][-wN][-v0].
            num_envs: N.
            server: `host:port` or `unix:/path`; None: $PALR_GYM_SERVER, else localhost:7257.
            autoreset_mode: What happens to an environment whose episode has ended.
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
        super().__init__()
        # Until there is a session, there is nothing to close.
        self.closed = True
        self._picture = Picture.of(camera, render_size)
        mode = checked_render_mode(render_mode)
        self._connection = Connection(server_or_default(server), deadline_s)
        try:
            self._session = Session(
                self._connection,
                env_id,
                num_envs=num_envs,
                autoreset_mode=autoreset_mode,
                out_of_bounds=out_of_bounds,
                observation_dtype=observation_dtype,
                scene_options=scene_options,
            )
        except BaseException:
            self._connection.close()
            raise
        self._become_ready()
        self.render_mode = mode

    @classmethod
    def from_snapshot(
        cls,
        snapshot: bytes,
        *,
        server: str | None = None,
        deadline_s: float = DEFAULT_DEADLINE_S,
    ) -> Self:
        """Environments in the state of a snapshot, which may come from another server.

        Args:
            snapshot: From `snapshot`.
            server: As for new environments.
            deadline_s: As for new environments.

        Raises:
            PalrGymError: The kind that fits.
        """
        connection = Connection(server_or_default(server), deadline_s)
        return cls._around(connection, lambda: Session.from_snapshot(connection, snapshot))

    @classmethod
    def _around(
        cls, connection: Connection, open_session: Callable[[], tuple[Session, RestoredState]]
    ) -> Self:
        """Environments around a session that stands somewhere already."""
        try:
            session, state = open_session()
        except BaseException:
            connection.close()
            raise
        envs = cls.__new__(cls)
        envs._connection = connection
        envs._session = session
        envs._picture = Picture()
        envs._become_ready()
        envs._stand(state)
        return envs

    def _become_ready(self) -> None:
        """Sets everything that follows from the session."""
        self.closed = False
        self.remote_spec: EnvironmentSpec = self._session.spec
        self.num_envs = self._session.num_envs
        self.metadata = {
            "render_modes": list(RENDER_MODES),
            "render_fps": round(1 / self.remote_spec.control_timestep_s),
            "autoreset_mode": self._session.autoreset_mode,
        }
        self.render_mode = None
        self.single_observation_space = self.remote_spec.observation_space
        self.single_action_space = self.remote_spec.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._mask_names = tuple(f"_{name}" for name in self.remote_spec.info_names)
        # Environments that the next step will reset; only ever set in NEXT_STEP.
        self._resets_next: NDArray[np.bool_] | None = None
        self._is_playing = False
        self._is_step_pending = False

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[NDArray[np.floating[Any]], dict[str, Any]]:
        """Starts episodes.

        Args:
            seed: None: the server's generators go on. One number: environment i is seeded with
                seed + i. A list: one each, where None leaves a generator as it is.
            options: `{"reset_mask": mask}` with a boolean array of shape (N,) resets only the
                environments where it is true. Anything else in it is ignored.

        Returns:
            The current observations of all environments, shape (N, observation size), and the
            infos of those that were reset.

        Raises:
            PalrGymError: The kind that fits.
        """
        self._refuse_if_busy("reset")
        mask = reset_mask(options, self.num_envs)
        try:
            result = self._reset(seed, mask)
        except BaseException as error:
            self._note_failure(error)
            raise
        if mask is None:
            self._is_playing = True
            self._resets_next = None
        elif self._resets_next is not None:
            self._resets_next[mask] = False
        was_reset = np.ones(self.num_envs, dtype=np.bool_) if mask is None else mask.copy()
        return result.observations, self._infos(result.info, was_reset)

    def step(self, actions: ArrayLike) -> VectorStep:
        """Steps every environment once.

        Args:
            actions: Shape (N, action size), converted to float32.

        Returns:
            Observations of shape (N, observation size); rewards, terminated and truncated of
            shape (N,); infos.

        Raises:
            ResetNeeded: There was no reset yet, an earlier step got no answer, or (DISABLED) an
                episode has ended.
            PalrGymError: The kind that fits.
        """
        self._refuse_unless_playing("step")
        try:
            return self._returned(self._session.step(actions))
        except BaseException as error:
            self._note_failure(error)
            raise

    def step_async(self, actions: ArrayLike) -> None:
        """Sends a step; `step_wait` takes its result.

        Args:
            actions: Shape (N, action size), converted to float32.

        Raises:
            ResetNeeded: As by `step`.
            AlreadyPendingCallError: The last step was not waited for.
            PalrGymError: The kind that fits.
        """
        self._refuse_unless_playing("step_async")
        try:
            self._session.step_async(actions)
        except BaseException as error:
            self._note_failure(error)
            raise
        self._is_step_pending = True

    def step_wait(self) -> VectorStep:
        """Waits for the step that `step_async` sent; returns and raises as `step` does.

        Raises:
            NoAsyncCallError: There is none.
        """
        if not self._is_step_pending:
            raise NoAsyncCallError("step_wait() without step_async()", "step")
        self._is_step_pending = False
        try:
            return self._returned(self._session.step_wait())
        except BaseException as error:
            self._note_failure(error)
            raise

    def step_open_loop(self, actions: ArrayLike) -> VectorOpenLoop:
        """Takes K steps in one message, as K calls of `step` would, with one round trip.

        With DISABLED, the first step that ends an episode is the last one that is taken.

        Args:
            actions: Shape (K, N, action size), converted to float32; K within the limits.

        Returns:
            What the k steps returned; k is K unless an episode ended (DISABLED).

        Raises:
            ResetNeeded: As by `step`.
            PalrGymError: The kind that fits; if the server refused, no step was taken.
        """
        self._refuse_unless_playing("step_open_loop")
        try:
            result = self._session.step_open_loop(actions)
            infos = [self._returned(step)[4] for step in single_steps(result)]
        except BaseException as error:
            self._note_failure(error)
            raise
        return VectorOpenLoop(
            result.observations, result.rewards, result.terminated, result.truncated, infos
        )

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """A picture of each environment as it stands, [height, width, 3]; None without a mode.

        Raises:
            PalrGymError: The kind that fits; `FailedPrecondition` if the server cannot draw.
        """
        self._refuse_if_busy("render")
        if self.render_mode is None:
            return None
        return tuple(render(self._connection, self._session.session_id, self._picture))

    def snapshot(self) -> bytes:
        """Everything that decides what comes next, for `restore` and `from_snapshot`.

        Raises:
            AlreadyPendingCallError: The last step was not waited for.
            PalrGymError: The kind that fits.
        """
        self._refuse_if_busy("snapshot")
        return self._session.snapshot()

    def restore(self, snapshot: bytes) -> NDArray[np.floating[Any]]:
        """Goes on from a snapshot of these environments or of others like them.

        If the server has forgotten these environments (it was restarted, say), others take their
        place there, so that a program can go on after a crash of its server.

        Returns:
            The observations, shape (N, observation size).

        Raises:
            PalrGymError: The kind that fits; after `InvalidArgument` nothing has changed.
        """
        self._is_step_pending = False
        self._refuse_if_busy("restore")
        try:
            self._connection, self._session, state = restore_or_reopen(
                self._connection, self._session, snapshot
            )
        except BaseException as error:
            self._note_failure(error)
            raise
        return self._stand(state)

    def fork(self) -> Self:
        """More environments that go on from where these stand, with the same generators.

        Raises:
            AlreadyPendingCallError: The last step was not waited for.
            PalrGymError: The kind that fits.
        """
        self._refuse_if_busy("fork")
        connection = Connection(self._connection.server, self._connection.deadline_s)
        envs = self._around(connection, lambda: self._session.fork(connection))
        envs.render_mode, envs._picture = self.render_mode, self._picture
        return envs

    def close_extras(self, **kwargs: Any) -> None:
        """Closes the session, if the server is still there."""
        self._is_playing = False
        self._is_step_pending = False
        self._session.close()
        self._connection.close()

    def __enter__(self) -> Self:
        """Returns itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Closes the environments."""
        self.close()

    def _stand(self, state: RestoredState) -> NDArray[np.floating[Any]]:
        self._is_playing = state.was_reset
        resets_next = self._session.autoreset_mode is AutoresetMode.NEXT_STEP
        self._resets_next = state.is_over if resets_next and state.is_over.any() else None
        return state.observations

    def _returned(self, result: StepResult) -> VectorStep:
        """The five values of `step`, infos laid out as `VectorEnv._add_info` does it."""
        ended = result.terminated | result.truncated
        infos: dict[str, Any] = {}
        if self._session.autoreset_mode is AutoresetMode.SAME_STEP and ended.any():
            # What the server reports is of the last step; of the new episode there is only what
            # its reset reports.
            final = np.full(self.num_envs, None, dtype=object)
            if result.final_observations is not None:
                for index, observation in zip(
                    np.flatnonzero(ended), result.final_observations, strict=True
                ):
                    final[index] = observation
            infos["final_obs"] = final
            infos["_final_obs"] = ended.copy()
            infos["final_info"] = self._infos(result.info.copy(), ended) | self._reasons(result)
            infos["_final_info"] = ended.copy()
            if result.reset_info is not None:
                result.info[: len(result.reset_info), ended] = result.reset_info
            infos |= self._infos(result.info, ~ended, ended)
        elif self._resets_next is not None:
            infos = self._infos(result.info, ~self._resets_next, self._resets_next)
            infos |= self._reasons(result)
        else:
            masks = np.ones(result.info.shape, dtype=np.bool_)
            infos = dict(zip(self.remote_spec.info_names, result.info, strict=True))
            infos.update(zip(self._mask_names, masks, strict=True))
            infos |= self._reasons(result)
        if self._session.autoreset_mode is AutoresetMode.NEXT_STEP:
            self._resets_next = ended if ended.any() else None
        return result.observations, result.rewards, result.terminated, result.truncated, infos

    def _reasons(self, result: StepResult) -> dict[str, Any]:
        """Why simulations diverged; hardly ever anything."""
        if not result.diverged:
            return {}
        reasons = np.full(self.num_envs, None, dtype=object)
        for diverged in result.diverged:
            reasons[diverged.env_index] = diverged.reason
        has_reason = np.array([reason is not None for reason in reasons])
        return {"truncation_reason": reasons, "_truncation_reason": has_reason}

    def _infos(
        self,
        info: NDArray[np.float64],
        has_info: NDArray[np.bool_],
        was_reset: NDArray[np.bool_] | None = None,
    ) -> dict[str, Any]:
        """Infos of those environments that have any: zeros elsewhere, left out if none has.

        Args:
            info: [info names or reset info names, N]. Written to.
            has_info: [N].
            was_reset: [N]: has what a reset reports, and nothing else. None: none.
        """
        infos: dict[str, Any] = {}
        for row, (name, values) in enumerate(zip(self.remote_spec.info_names, info, strict=False)):
            has_value = has_info
            if was_reset is not None and row < len(self.remote_spec.reset_info_names):
                has_value = has_info | was_reset
            if has_value.any():
                values[~has_value] = 0.0
                infos[name] = values
                infos[self._mask_names[row]] = has_value.copy()
        return infos

    def _reset(
        self, seed: int | Sequence[int | None] | None, mask: NDArray[np.bool_] | None
    ) -> ResetResult:
        """Resets the environments in `mask` (None: all)."""
        chosen = [] if mask is None else np.flatnonzero(mask).tolist()
        if seed is None or isinstance(seed, SupportsIndex):
            seeds = [] if seed is None else [unsigned("seed", seed, 64)]
            result = self._session.reset_with_info(seeds=seeds, env_indices=chosen)
            super().reset(seed=seeds[0] if seeds else None)
            return result
        if len(seed) != self.num_envs:
            raise InvalidArgument(
                f"resetting {self.num_envs} environment(s) of {self.remote_spec.env_id}: "
                f"{len(seed)} seeds; expected one, or as many as environments",
                reason="SEED_COUNT",
            )
        seeds = [0 if entry is None else unsigned("seed", entry, 64) for entry in seed]
        chosen = chosen or range(self.num_envs)
        seeded = [index for index in chosen if seed[index] is not None]
        unseeded = [index for index in chosen if seed[index] is None]
        # The protocol seeds all or none of the environments that one request resets.
        if not seeded:
            return self._session.reset_with_info(env_indices=unseeded)
        result = self._session.reset_with_info(seeds=seeds, env_indices=seeded)
        if unseeded:
            first = result.info[:, seeded]
            result = self._session.reset_with_info(env_indices=unseeded)
            result.info[:, seeded] = first
        return result

    def _note_failure(self, error: BaseException) -> None:
        """Unless the server refused a call, nobody knows where the episodes are now."""
        if not errors.is_refusal(error):
            self._is_playing = False
            self._session.abandon_steps()

    def _refuse_unless_playing(self, what: str) -> None:
        if self._is_step_pending or not self._is_playing:
            self._refuse_if_busy(what)
            raise ResetNeeded(
                f"{self.remote_spec.env_id}: no episodes are under way (there was no reset, or a "
                f"call got no answer); call reset() before {what}()"
            )

    def _refuse_if_busy(self, what: str) -> None:
        if self.closed:
            raise ClosedEnvironmentError(f"{what}() of {self.remote_spec.env_id} after close()")
        if self._is_step_pending:
            raise AlreadyPendingCallError(
                f"{what}() of {self.remote_spec.env_id} before step_wait()", "step"
            )
