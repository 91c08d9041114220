"""The geometry that the shipped extractor was taught, against the simulation's own."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

import palr_gym
from features.geometry import AHEAD_M, NAMES, Bends, geometry, lane_ahead

WHEELBASE_M = 2.6
NUM_ENVS = 64
RESETS = 10


def shown(server: str) -> dict[str, NDArray[np.float32]]:
    """The full observation at starts all over the track, some of them driven on from: [N] each."""
    rng = np.random.default_rng(0)
    rows: list[NDArray[np.float64]] = []
    with palr_gym.make_vec("lane", NUM_ENVS, server=server) as envs:
        for i in range(RESETS):
            observations, _ = envs.reset(seed=i * NUM_ENVS)
            rows.append(np.array(observations, np.float64))
            for _ in range(3):
                actions = rng.uniform(-1, 1, (NUM_ENVS, 2)).astype(np.float32)
                rows.append(np.array(envs.step(actions)[0], np.float64))
        names = envs.remote_spec.observation_names
    columns = np.concatenate(rows).T.astype(np.float32)
    return dict(zip(names, columns, strict=True))


def test_the_lane_lies_ahead_where_the_simulation_says(server: str) -> None:
    states = shown(server)
    ahead_m, left_m = lane_ahead(states, Bends(states))
    # The simulation looks from the rear axle, so far ahead along the road as speed asks for.
    speed = np.hypot(states["velocity_along_mps"], states["velocity_across_mps"])
    column = np.linspace(0.0, 32.0, ahead_m.shape[1])
    found: Any = [
        (np.interp(reach, column, x) + WHEELBASE_M / 2, np.interp(reach, column, y))
        for reach, x, y in zip(3.0 + 0.5 * speed, ahead_m, left_m, strict=True)
    ]
    expected = np.stack([states["look_ahead_x_m"], states["look_ahead_y_m"]], 1)
    np.testing.assert_allclose(found, expected, atol=0.1)


def test_what_is_taught_says_nothing_of_speeds_and_actions(server: str) -> None:
    states = shown(server)
    bends = Bends(states)
    table = geometry(states, bends)
    assert table.shape == (NUM_ENVS * RESETS * 4, len(NAMES))
    other = dict(states)
    for name, values in states.items():
        if any(word in name for word in ("speed", "velocity", "rate", "steering", "look_ahead")):
            other[name] = values + 1
    np.testing.assert_array_equal(geometry(other, bends), table)
    # Where there is no car ahead, there is nothing to say of it.
    is_near = table[:, NAMES.index("lead is near")] == 1
    np.testing.assert_array_equal(is_near, states["lead_gap_m"] < 25)
    assert np.isfinite(table[:, : 4 + len(AHEAD_M)]).all()
    assert (np.isfinite(table).all(1) == is_near).all()
    gap = table[is_near, NAMES.index("lead_gap_m")]
    np.testing.assert_array_equal(gap, states["lead_gap_m"][is_near])
