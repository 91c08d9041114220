"""Truth from outside: Gymnasium's own environments, and facts written down a second time.

Nothing here comes from the package under test or from its server.
"""

from collections import deque
from collections.abc import Callable
from typing import Any, cast

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from numpy.typing import NDArray

GYMNASIUM_IDS = {
    "hopper": "Hopper-v4",
    "walker2d": "Walker2d-v4",
    "halfcheetah": "HalfCheetah-v4",
    "ant": "Ant-v4",
}
TASKS = list(GYMNASIUM_IDS)

# The same tasks as Gymnasium's -v5 defines them.
GYM5_IDS = {
    "hopper-gym5": "Hopper-v5",
    "walker2d-gym5": "Walker2d-v5",
    "halfcheetah-gym5": "HalfCheetah-v5",
    "ant-gym5": "Ant-v5",
}
PROFILES = [*GYMNASIUM_IDS, *GYM5_IDS]

# PALR, section C.1, and the same without any velocity.
MASKS: dict[str, dict[str, list[int]]] = {
    "hopper": {"paper": [0, 1, 2, 3, 4], "strict": [0, 1, 2, 3, 4]},
    "walker2d": {"paper": [0, 1, 2, 3, 4, 5, 6, 7], "strict": [0, 1, 2, 3, 4, 5, 6, 7]},
    "halfcheetah": {
        "paper": [0, 1, 2, 3, 8, 9, 10, 11, 12],
        "strict": [0, 1, 2, 3, 4, 5, 6, 7],
    },
    "ant": {"paper": list(range(13)), "strict": list(range(13))},
}

# D4RL's reference scores: minimum (random policy) and maximum (expert).
D4RL_RETURNS = {
    "hopper": (-20.272305, 3234.3),
    "walker2d": (1.629008, 4592.3),
    "halfcheetah": (-280.178953, 12135.0),
    "ant": (-325.6, 3879.7),
}

Env = gymnasium.Env[NDArray[np.float64], NDArray[np.float32]]


def gymnasium_env(profile: str) -> Env:
    """Gymnasium's environment with its time limit, without its checks.

    Args:
        profile: A task, with `-gym5` or without.
    """
    ids = GYMNASIUM_IDS | GYM5_IDS
    return gymnasium.make(ids[profile], disable_env_checker=True)


def gymnasium_vector_env(
    task: str, num_envs: int, autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP
) -> "SyncVectorEnv[Any, Any]":
    """Gymnasium's environments one after the other."""
    make: Callable[[], Env] = lambda: gymnasium_env(task)  # noqa: E731
    return SyncVectorEnv([make] * num_envs, autoreset_mode=autoreset_mode)


def normalized_score(task: str, episode_return: float) -> float:
    """D4RL's score."""
    low, high = D4RL_RETURNS[task]
    return 100 * (episode_return - low) / (high - low)


class MaskedStack:
    """Picks entries of full observations and stacks them, oldest first, after zeros."""

    def __init__(self, indices: list[int], frame_stack: int) -> None:
        self._indices = indices
        self._frames = deque[NDArray[np.float64]](maxlen=frame_stack)

    def reset(self, observation: NDArray[np.float64]) -> NDArray[np.float64]:
        """The stack with the first observation of an episode."""
        zeros = np.zeros(len(self._indices))
        self._frames.extend([zeros] * cast("int", self._frames.maxlen))
        return self.push(observation)

    def push(self, observation: NDArray[np.float64]) -> NDArray[np.float64]:
        """The stack with one more observation."""
        self._frames.append(observation[self._indices])
        return np.concatenate(list(self._frames))


def random_actions(seed: int, *shape: int, bound: float = 1.0) -> NDArray[np.float32]:
    """Uniform float32 actions within ± bound."""
    actions = np.random.default_rng(seed).uniform(-bound, bound, shape)
    # Rounding to float32 can step over the bound.
    return np.clip(actions.astype(np.float32), -bound, bound)


def assert_same_bits(ours: object, theirs: object, what: str = "") -> None:
    """Equal type of number, shape and bits, or an error that shows the first difference."""
    left, right = np.asarray(ours), np.asarray(theirs)
    assert (left.dtype, left.shape) == (right.dtype, right.shape), what
    if left.tobytes() != right.tobytes():
        np.testing.assert_array_equal(left, right, err_msg=what)
        raise AssertionError(f"{what}: equal, but for the sign of a zero")


def assert_same_info(name: str, ours: object, theirs: object, what: str = "") -> None:
    """Equal bits; but for what the last bit depends on the machine in Gymnasium itself.

    `distance_from_origin` is NumPy's norm, a dot product of BLAS, which fuses multiplication and
    addition on some processors (and with some settings of OpenBLAS) and not on others.
    """
    if name != "distance_from_origin":
        assert_same_bits(ours, theirs, what)
        return
    left, right = np.asarray(ours), np.asarray(theirs)
    assert (left.dtype, left.shape) == (right.dtype, right.shape), what
    is_there = ~np.isnan(right)
    assert (np.isnan(left) == ~is_there).all(), what
    np.testing.assert_array_max_ulp(left[is_there], right[is_there], maxulp=1)


def assert_same_infos(ours: dict[str, Any], theirs: dict[str, Any], what: str = "") -> None:
    """Equal infos of vector environments: keys, masks, values.

    Values are compared as float64: Gymnasium's are of whatever type the task computes in.
    """
    assert set(ours) == set(theirs), what
    for key, expected in theirs.items():
        got: Any = ours[key]
        where = f"{what}, infos[{key!r}]"
        if isinstance(expected, dict):
            assert_same_infos(got, cast("dict[str, Any]", expected), where)
        elif key.startswith("_"):
            assert_same_bits(got, expected, where)
        elif expected.dtype == object:
            assert got.dtype == object, where
            for index, value in enumerate(expected):
                if value is None:
                    assert got[index] is None, where
                else:
                    assert_same_bits(got[index], value, where)
        else:
            assert got.dtype == np.float64, where
            assert_same_info(key, got, expected.astype(np.float64), where)
