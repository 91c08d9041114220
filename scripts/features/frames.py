"""Single frames of the lane scene, drawn by a palr-gym server, with what they show.

The car is driven by a noisy driver, so that frames show more than an expert meets: far from the
lane's middle, askew, close behind the car ahead. Weather, scenery in sight and the car ahead differ
from episode to episode. Of what is kept beside a frame training sees the geometry alone
(`geometry.py`); speeds and actions are for probes.
"""

# torch is not installed where types are checked.
# pyright: basic, reportMissingImports=false

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from palr_gym import RemoteVectorEnv

SIDE_PX = 48
CARS = 64
"""Cars that drive side by side."""
STEPS = 120
"""Steps of each before all of them start anew."""
SHOT_EVERY = 6
"""Steps from one frame of a car to the next: half a car's length and more."""
LANE_KEPT_M = 2.0


@dataclass(frozen=True)
class Frames:
    """Frames and what they show."""

    pixels: NDArray[np.uint8]
    """[N, 48, 48, 3]"""
    shown: dict[str, NDArray[np.float32]]
    """[N] each, by their names in the full observation; and `past_throttle`, `past_steer`."""

    def save(self, path: Path) -> None:
        """Writes them as one file."""
        np.savez(path, pixels=self.pixels, **self.shown)  # pyright: ignore[reportArgumentType]

    @staticmethod
    def load(path: Path) -> "Frames":
        """Reads what `save` wrote."""
        with np.load(path) as file:
            shown = {name: file[name] for name in file.files if name != "pixels"}
            return Frames(file["pixels"], shown)


class _Driver:
    """Follows the lane and the car ahead, with errors that wander: one for each car."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._steer = np.zeros(CARS)
        self._throttle = np.zeros(CARS)
        # How boldly each car strays, and how close it follows.
        self._wander = rng.uniform(0.05, 0.5, CARS)
        self._gap_m = rng.uniform(0.5, 6.0, CARS)
        self._cruise = rng.uniform(2.0, 7.0, CARS)

    def act(self, state: dict[str, NDArray[np.float64]]) -> NDArray[np.float32]:
        """[CARS, 2]: throttle and steering."""
        self._steer += 0.12 * (-self._steer + self._wander * 4 * self._rng.normal(size=CARS))
        self._throttle += 0.1 * (-self._throttle + 2 * self._rng.normal(size=CARS))
        x, y = state["look_ahead_x_m"], state["look_ahead_y_m"]
        curvature = 2 * np.sin(np.arctan2(y, x)) / np.hypot(x, y)
        steer = -np.arctan(2.6 * curvature) / 0.61 + self._steer
        gap = state["lead_gap_m"] - self._gap_m
        speed = np.minimum(self._cruise, np.maximum(0, 0.6 * gap + state["lead_speed_mps"]))
        throttle = 0.5 * (speed - state["velocity_along_mps"]) + 0.3 * self._throttle
        return np.clip(np.stack([throttle, steer], 1), -1, 1).astype(np.float32)


def draw(server: str, count: int, seed: int) -> Frames:
    """Drives until there are `count` frames. Equal arguments give equal frames on equal servers.

    Args:
        server: `host:port` or `unix:/path`.
        count: N.
        seed: Of episodes and driver; the episodes' seeds are `seed` and those that follow.
    """
    rng = np.random.default_rng(seed)
    pixels: list[NDArray[np.uint8]] = []
    rows: dict[str, list[NDArray[np.float64]]] = {}
    found = 0
    with RemoteVectorEnv(
        "lane",
        CARS,
        server=server,
        autoreset_mode=AutoresetMode.NEXT_STEP,
        scene_options={"weather": "random", "lead_car_probability": 0.8},
        render_mode="rgb_array",
        camera="driver",
        render_size=(SIDE_PX, SIDE_PX),
    ) as cars:
        names = cars.remote_spec.observation_names
        while found < count:
            observations, _ = cars.reset(seed=seed)
            seed += CARS
            driver = _Driver(rng)
            phase = int(rng.integers(SHOT_EVERY))
            past = np.zeros((CARS, 2), np.float32)
            for step in range(STEPS):
                state = dict(zip(names, observations.T, strict=True))
                if step % SHOT_EVERY == phase:
                    shots = cars.render() or ()
                    # One off its lane shows the end of an episode, on which no agent acts.
                    is_fit = np.abs(state["lateral_error_m"]) < LANE_KEPT_M
                    pixels.append(np.stack(shots)[is_fit])
                    for name, values in state.items():
                        rows.setdefault(name, []).append(values[is_fit])
                    rows.setdefault("past_throttle", []).append(past[is_fit, 0])
                    rows.setdefault("past_steer", []).append(past[is_fit, 1])
                    found += int(is_fit.sum())
                past = driver.act(state)
                observations, _, terminated, truncated, _ = cars.step(past)
                past[terminated | truncated] = 0
    return Frames(
        np.concatenate(pixels)[:count],
        {name: np.concatenate(values)[:count].astype(np.float32) for name, values in rows.items()},
    )
