"""The geometry that a single frame shows: what the compact network learns to read.

Positions only. Nothing here says how fast the car is or what its driver did: the same place gives
the same numbers at any speed.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

SEEN_GAP_M: Final = 25.0
"""Up to here a car ahead is a thing to be seen; further away it has three pixels."""
AHEAD_M: Final = (3.0, 6.0, 10.0, 15.0, 22.0)
"""Along the track from the car: where the lane's middle is looked for."""
NAMES: Final = (
    "lateral_error_m",
    "heading_error_rad",
    "curvature_per_m",
    *(f"lane_bearing_rad at {ahead:g} m" for ahead in AHEAD_M),
    "lead is near",
    "lead_gap_m",
    "log of lead_gap_m",
    "lead_bearing_rad",
)
"""What the columns of `geometry` are."""

# Of the lane scene: its loop, its lane's middle to the right of the road's, half of two cars.
_TRACK_M = 253.93
_LANE_OFFSET_M = -1.75
_CAR_M = 3.8
_STEP_M = 0.25
_STEPS = 128
_LEAST_GAP_M = 0.5


class Bends:
    """The track's curvature, as frames from all over it tell."""

    def __init__(self, shown: dict[str, NDArray[np.float32]]) -> None:
        """Of many frames: `progress_m` and `curvature_per_m`, [N] each."""
        order = np.argsort(shown["progress_m"])
        self._progress_m = shown["progress_m"][order].astype(float)
        self._curvature_per_m = shown["curvature_per_m"][order].astype(float)

    def at(self, progress_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """The same shape, 1/m; positive to the left."""
        return np.interp(progress_m, self._progress_m, self._curvature_per_m, period=_TRACK_M)


def lane_ahead(
    shown: dict[str, NDArray[np.float32]], bends: Bends
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The lane's middle as seen from the car: metres ahead and to the left, [N, 129] each.

    Column i is of the place i quarters of a metre further along the middle of the road.
    """
    progress_m = shown["progress_m"].astype(np.float64)[:, None]
    curvature = bends.at(progress_m + np.arange(0.5, _STEPS) * _STEP_M)
    zero = np.zeros_like(progress_m)
    heading = np.concatenate([zero, np.cumsum(curvature * _STEP_M, 1)], 1)
    between = (heading[:, 1:] + heading[:, :-1]) / 2
    along = np.concatenate([zero, np.cumsum(np.cos(between) * _STEP_M, 1)], 1)
    across = np.concatenate([zero, np.cumsum(np.sin(between) * _STEP_M, 1)], 1)
    # From the middle of the road to that of the lane, and from below the car to the car.
    along -= _LANE_OFFSET_M * np.sin(heading)
    across += _LANE_OFFSET_M * (np.cos(heading) - 1) - shown["lateral_error_m"][:, None]
    error = shown["heading_error_rad"].astype(float)[:, None]
    sin, cos = np.sin(error), np.cos(error)
    return cos * along + sin * across, cos * across - sin * along


def geometry(shown: dict[str, NDArray[np.float32]], bends: Bends) -> NDArray[np.float32]:
    """`[N, len(NAMES)]`; NaN of a car ahead that is not near."""
    ahead_m, left_m = lane_ahead(shown, bends)
    bearing = np.arctan2(left_m, ahead_m)
    gap_m = shown["lead_gap_m"].astype(float)
    is_near = gap_m < SEEN_GAP_M
    place = np.minimum((np.where(is_near, gap_m, 0) + _CAR_M) / _STEP_M, _STEPS).astype(int)
    lead_bearing = np.take_along_axis(bearing, place[:, None], 1)[:, 0]
    columns = [
        shown["lateral_error_m"],
        shown["heading_error_rad"],
        shown["curvature_per_m"],
        *(bearing[:, round(ahead / _STEP_M)] for ahead in AHEAD_M),
        is_near,
        np.where(is_near, gap_m, np.nan),
        np.where(is_near, np.log(np.maximum(gap_m, _LEAST_GAP_M)), np.nan),
        np.where(is_near, lead_bearing, np.nan),
    ]
    return np.stack([np.asarray(column, np.float32) for column in columns], 1)
