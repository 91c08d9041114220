"""How much one variable repeats the past: HSCIC, estimated by the server."""

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import SupportsIndex

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palr_gym._proto.palr_gym.v1 import leakage_service_pb2, tensor_pb2
from palr_gym.address import server_or_default
from palr_gym.arguments import unsigned
from palr_gym.connection import ESTIMATE_LEAKAGE, Connection
from palr_gym.errors import InvalidArgument
from palr_gym.tensors import FLOAT64, float64_tensor, to_array

DEFAULT_TIMEOUT_S = 300.0
"""Seconds to wait for an estimate: the work grows with the cube of the samples."""


@dataclass(frozen=True, eq=False)
class Hscic:
    """An estimate of HSCIC(representation; past action | given action)."""

    value: float
    """The criterion, >= 0 up to rounding."""
    low: float
    """Lower end of its 95 % block-bootstrap interval, with the embedding held fixed."""
    high: float
    """Upper end."""
    is_by_episode: bool
    """Whether whole episodes were resampled (from 20 on), not blocks of consecutive samples."""
    per_point: NDArray[np.float64]
    """[n]: the terms that `value` is the mean of."""

    def __str__(self) -> str:
        """The estimate in a line."""
        return f"HSCIC {self.value:.3e} [{self.low:.3e}, {self.high:.3e}]"


def hscic(
    representation: ArrayLike,
    past_action: ArrayLike,
    given_action: ArrayLike,
    *,
    ridge: float | None = None,
    bandwidth_sq: float | None = None,
    episode_lengths: Sequence[SupportsIndex] = (),
    resamples: SupportsIndex | None = None,
    seed: SupportsIndex = 0,
    server: str | None = None,
    timeout_s: float = DEFAULT_TIMEOUT_S,
) -> Hscic:
    """How much `representation` depends on `past_action` given `given_action`.

    Equation (7) of the PALR paper, exact and in double precision, computed by a server.

    Args:
        representation: [n, d], or [n] for a single column.
        past_action: [n, action size]: the expert's action one step before each sample.
        given_action: [n, action size]: the expert's action at each sample.
        ridge: λ, which enters the kernel matrix as n * λ; None: 1e-5.
        bandwidth_sq: σ² of all kernels, exp(-d² / σ²); None: 1.
        episode_lengths: Samples of each episode, in order; empty: one episode.
        resamples: Of the bootstrap; None: 2000.
        seed: Of the bootstrap.
        server: `host:port` or `unix:/path`; None: $PALR_GYM_SERVER, else localhost:7257.
        timeout_s: Seconds to wait.

    Raises:
        PalrGymError: The kind that fits.
    """
    request = leakage_service_pb2.EstimateLeakageRequest(
        representation=_matrix("representation", representation),
        past_actions=_matrix("past_action", past_action),
        given_actions=_matrix("given_action", given_action),
        ridge=ridge,
        bandwidth_sq=bandwidth_sq,
        episode_lengths=[unsigned("episode_lengths", length, 32) for length in episode_lengths],
        resamples=None if resamples is None else unsigned("resamples", resamples, 32),
        seed=unsigned("seed", seed, 64),
    )
    with closing(Connection(server_or_default(server), timeout_s)) as connection:
        answer = connection.unary(ESTIMATE_LEAKAGE, request, asked="estimating HSCIC")
    return Hscic(
        value=answer.hscic,
        low=answer.hscic_low,
        high=answer.hscic_high,
        is_by_episode=answer.is_by_episode,
        per_point=to_array(answer.per_point, FLOAT64, (-1,)),
    )


def _matrix(name: str, values: ArrayLike) -> tensor_pb2.Tensor:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim == 1:
        array = array[:, np.newaxis]
    if array.ndim != 2:
        raise InvalidArgument(f"{name} has shape {array.shape}; expected [n, columns] or [n]")
    return float64_tensor(array)
