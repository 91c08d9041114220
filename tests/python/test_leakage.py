"""`palr_gym.hscic` against equation (7) of the PALR paper, term by term in NumPy."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import palr_gym

Matrix = NDArray[np.float64]


def kernel(rows: Matrix) -> Matrix:
    """exp(-|x - y|²) between all rows, `[n, d]` -> `[n, n]`."""
    differences = rows[:, np.newaxis, :] - rows[np.newaxis, :, :]
    return np.exp(-np.square(differences).sum(axis=-1))


def equation_7(x: Matrix, y: Matrix, z: Matrix, ridge: float) -> float:
    """The estimator as the paper prints it: a trace of three matrix products."""
    n = len(x)
    kx, ky, kz = kernel(x), kernel(y), kernel(z)
    w = np.linalg.inv(kz + n * ridge * np.eye(n))
    first = kz.T @ w @ (kx * ky) @ w.T @ kz
    second = kz.T @ w @ ((kx @ w.T @ kz) * (ky @ w.T @ kz))
    third = (kz.T @ w @ kx @ w.T @ kz) * (kz.T @ w @ ky @ w.T @ kz)
    return float(np.trace(first - 2 * second + third)) / n


def samples(n: int, actions: int, seed: int) -> tuple[Matrix, Matrix, Matrix]:
    """A representation that sees both actions, past actions, and given actions."""
    rng = np.random.default_rng(seed)
    z = np.tanh(rng.normal(size=(n, actions)))
    y = np.tanh(0.9 * z + 0.3 * rng.normal(size=(n, actions)))
    x = np.hstack([0.4 * y, 0.2 * z]) + 0.1 * rng.normal(size=(n, 2 * actions))
    return x, y, z


@pytest.mark.parametrize("actions", [1, 3, 6, 8])
def test_the_estimate_is_the_papers_equation(server: str, actions: int) -> None:
    x, y, z = samples(150, actions, seed=actions)
    got = palr_gym.hscic(x, y, z, server=server)
    expected = equation_7(x, y, z, ridge=1e-5)
    assert got.value == pytest.approx(expected, rel=1e-8)
    assert got.per_point.mean() == pytest.approx(got.value, rel=1e-12)
    assert got.per_point.shape == (150,)
    assert got.low <= got.value <= got.high
    assert not got.is_by_episode
    other = palr_gym.hscic(x, y, z, ridge=1e-3, server=server)
    assert other.value == pytest.approx(equation_7(x, y, z, ridge=1e-3), rel=1e-8)


def test_whole_episodes_are_resampled_where_there_are_twenty(server: str) -> None:
    x, y, z = samples(100, 2, seed=0)
    got = palr_gym.hscic(x, y, z, episode_lengths=[5] * 20, server=server)
    assert got.is_by_episode
    again = palr_gym.hscic(x, y, z, episode_lengths=[5] * 20, server=server)
    assert (got.low, got.high) == (again.low, again.high)
    assert str(got).startswith("HSCIC ")


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"past_action": np.eye(9, 2)}, "past_action has 9 rows"),
        ({"representation": np.full((10, 4), np.nan)}, "NaN at row 0, column 0"),
        ({"representation": np.zeros((10, 2, 2))}, r"\(10, 2, 2\)"),
        ({"past_action": np.zeros((10, 2))}, "column 0 of past_action is 0 in all 10 samples"),
        ({"ridge": -1.0}, "ridge is -1"),
        ({"episode_lengths": [3, 4]}, "blocks hold 7 samples; expected 10"),
    ],
)
def test_wrong_arrays_are_refused(server: str, change: dict[str, Any], text: str) -> None:
    x, y, z = samples(10, 2, seed=0)
    arguments: dict[str, Any] = {"representation": x, "past_action": y, "given_action": z}
    with pytest.raises(palr_gym.InvalidArgument, match=text):
        palr_gym.hscic(**{**arguments, **change}, server=server)
