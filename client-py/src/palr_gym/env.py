"""One remote environment with Gymnasium's interface."""

from typing import Any, cast

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
from palr_gym.session import OutOfBounds, Session
from palr_gym.specs import EnvironmentSpec


class RemoteEnv(gymnasium.Env[NDArray[np.float64], NDArray[np.float32]]):
    """An environment that a palr-gym server runs.

    `reset(seed=...)` seeds the server's generator exactly as it seeds Gymnasium's own environment;
    without a seed that generator goes on. The server has its own: `np_random` is seeded along with
    it, but draws from it change nothing.

    Observations are float64 arrays of the caller's own. Actions are converted to float32. The
    infos of `step` are Python floats by the names in `remote_spec.info_names`; those of `reset`
    are empty.

    Attributes:
        remote_spec: The environment as the server describes it.
    """

    def __init__(
        self,
        env_id: str,
        *,
        server: str | None = None,
        out_of_bounds: OutOfBounds = "reject",
        deadline_s: float = DEFAULT_DEADLINE_S,
        render_mode: str | None = None,
    ) -> None:
        """Opens a session of one environment.

        Args:
            env_id: TASK[-full|-paper|-strict][-gym5][-wN][-v0].
            server: `host:port` or `unix:/path`; None: $PALR_GYM_SERVER, else localhost:7257.
            out_of_bounds: What happens to an action outside the action space: "reject", "clip",
                or "raw" (used as it is, as Gymnasium does).
            deadline_s: Seconds that a call waits for its answer.
            render_mode: Only None: this server renders nothing.

        Raises:
            PalrGymError: The kind that fits.
        """
        refuse_render_mode(render_mode)
        self.render_mode = None
        self._connection = Connection(server_or_default(server), deadline_s)
        try:
            self._session = Session(
                self._connection,
                env_id,
                autoreset_mode=AutoresetMode.DISABLED,
                out_of_bounds=out_of_bounds,
            )
        except BaseException:
            self._connection.close()
            raise
        self.remote_spec: EnvironmentSpec = self._session.spec
        self.observation_space = self.remote_spec.observation_space
        self.action_space = self.remote_spec.action_space
        self._is_playing = False
        self._is_closed = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
        """Starts an episode.

        Args:
            seed: 0 to 2**64 - 1; None: the server's generator goes on.
            options: Ignored, as by Gymnasium's own environments.

        Returns:
            The observation, shape (observation size,), and an empty info.

        Raises:
            PalrGymError: The kind that fits.
        """
        self._refuse_if_closed("reset")
        seed = None if seed is None else unsigned("seed", seed, 64)
        try:
            observations = self._session.reset(seeds=() if seed is None else (seed,))
        except BaseException as error:
            self._note_failure(error)
            raise
        self._is_playing = True
        super().reset(seed=seed)
        return observations[0], {}

    def step(
        self, action: ArrayLike
    ) -> tuple[NDArray[np.float64], float, bool, bool, dict[str, Any]]:
        """Steps the environment.

        Args:
            action: Shape (action size,).

        Returns:
            Observation of shape (observation size,), reward, terminated, truncated, info.

        Raises:
            ResetNeeded: There is no episode, it has ended, or an earlier step got no answer.
            PalrGymError: The kind that fits.
        """
        if not self._is_playing:
            self._refuse_if_closed("step")
            raise ResetNeeded(
                f"{self.remote_spec.env_id}: no episode is under way (it ended, never began, or a "
                "call got no answer); call reset() before step()"
            )
        try:
            result = self._session.step(cast("ArrayLike", [action]))
        except BaseException as error:
            self._note_failure(error)
            raise
        terminated = bool(result.terminated[0])
        truncated = bool(result.truncated[0])
        self._is_playing = not (terminated or truncated)
        info = dict(zip(self.remote_spec.info_names, result.info[:, 0].tolist(), strict=True))
        return result.observations[0], float(result.rewards[0]), terminated, truncated, info

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

    def _refuse_if_closed(self, what: str) -> None:
        if self._is_closed:
            raise ClosedEnvironmentError(f"{what}() of {self.remote_spec.env_id} after close()")


def refuse_render_mode(render_mode: str | None) -> None:
    """Raises `InvalidArgument` for anything but None."""
    if render_mode is not None:
        raise InvalidArgument(f"render_mode is {render_mode!r}; expected None: nothing is rendered")
