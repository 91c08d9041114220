"""What the transcribed methods share: streams of random numbers, layers, the policy, HSCIC, rows.

Float64 JAX. Written from the papers and recipes, sharing nothing with the trainer but the meaning
of a seed: batches, permutations, initial parameters and noise follow from NumPy's own generators.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import jax as _jax
import jax.numpy as _jnp
import numpy as np
from numpy.typing import NDArray

# Their annotations are partial.
jax: Any = _jax
jnp: Any = _jnp
jax.config.update("jax_enable_x64", True)

Array = Any
Parameters = list[dict[str, Array]]
Numbers = NDArray[np.float64]

# What streams of random numbers are for.
INITIAL, BATCH, POOL, NOISE, INNER_BATCH, INNER_NOISE = 1, 2, 3, 4, 1000, 2000


def stream(seed: int, purpose: int, index: int) -> np.random.Generator:
    return np.random.default_rng([seed, (purpose << 32) | index])


def draw_rows(rng: np.random.Generator, n: int, count: int) -> NDArray[np.int64]:
    return np.floor(rng.random(count) * n).astype(np.int64)


def permutation(rng: np.random.Generator, n: int) -> NDArray[np.int64]:
    """Fisher and Yates, from the end."""
    order = np.arange(n)
    for last in range(n - 1, 0, -1):
        other = int(rng.random() * (last + 1))
        order[last], order[other] = order[other], order[last]
    return order


class Normals:
    """Sixteen xoshiro128++ side by side, then Box and Muller."""

    def __init__(self, rng: np.random.Generator) -> None:
        words = rng.integers(0, 1 << 64, size=32, dtype=np.uint64)
        halves = np.stack([words & np.uint64(0xFFFFFFFF), words >> np.uint64(32)], axis=1)
        self._state = halves.astype(np.uint32).reshape(4, 16)

    def _round(self) -> NDArray[np.uint32]:
        def rotate(x: NDArray[np.uint32], bits: int) -> NDArray[np.uint32]:
            return (x << np.uint32(bits)) | (x >> np.uint32(32 - bits))

        s0, s1, s2, s3 = self._state
        result = rotate(s0 + s3, 7) + s0
        shifted = s1 << np.uint32(9)
        s2 = s2 ^ s0
        s3 = s3 ^ s1
        s1 = s1 ^ s2
        s0 = s0 ^ s3
        self._state = np.stack([s0, s1, s2 ^ shifted, rotate(s3, 11)])
        return result

    def draw(self, rows: int, columns: int) -> Numbers:
        """`[rows, columns]`, in whole blocks of 32 of the stream."""
        blocks: list[Numbers] = []
        for _ in range(-(-rows * columns // 32)):
            x, y = self._round(), self._round()
            u = ((x >> np.uint32(8)).astype(np.float64) + 1) / 2**24
            turn = 2 * np.pi * (y >> np.uint32(8)).astype(np.float64) / 2**24
            radius = np.sqrt(-2 * np.log(u))
            blocks += [radius * np.cos(turn), radius * np.sin(turn)]
        return np.concatenate(blocks)[: rows * columns].reshape(rows, columns)


# ---------------------------------------------------------------------------------------- networks


def uniform_layers(sizes: Sequence[tuple[int, int, bool]], seed: int, number: int) -> Parameters:
    """The default of torch: uniform within ±1/√inputs."""
    rng = stream(seed, INITIAL, number)
    layers: Parameters = []
    for inputs, outputs, has_bias in sizes:
        bound = 1 / np.sqrt(inputs)
        layer = {"w": rng.uniform(-bound, bound, size=(inputs, outputs))}
        if has_bias:
            layer["b"] = rng.uniform(-bound, bound, size=outputs)
        layers.append(layer)
    return layers


def kaiming_layers(sizes: Sequence[tuple[int, int]], seed: int, number: int) -> Parameters:
    rng = stream(seed, INITIAL, number)
    layers: Parameters = []
    for at, (inputs, outputs) in enumerate(sizes):
        gain = 1.0 if at + 1 == len(sizes) else np.sqrt(2.0)
        weight = rng.standard_normal((inputs, outputs)) * gain / np.sqrt(inputs)
        layers.append({"w": weight, "b": np.zeros(outputs)})
    return layers


def policy_layers(
    inputs: int, actions: int, seed: int, number: int = 0, *, phi: int = 64, joined: int = 0
) -> Parameters:
    """Hidden units [128, 64, 128]; `joined` more beside φ."""
    sizes = [
        (inputs, 128, False),
        (128, phi, True),
        (64 + joined, 128, True),
        (128, actions, True),
        (128, actions, True),
    ]
    return uniform_layers(sizes, seed, number)


def linear(layer: dict[str, Array], x: Array) -> Array:
    y = x @ layer["w"]
    return y + layer["b"] if "b" in layer else y


def leaky(x: Array) -> Array:
    return jnp.where(x > 0, x, 0.2 * x)


def leaky_mlp(layers: Parameters, x: Array) -> Array:
    for layer in layers[:-1]:
        x = leaky(linear(layer, x))
    return linear(layers[-1], x)


def encode(policy: Parameters, x: Array) -> Array:
    return linear(policy[1], leaky(linear(policy[0], x)))


def decode(policy: Parameters, phi: Array) -> tuple[Array, Array]:
    hidden = leaky(linear(policy[2], leaky(phi)))
    return linear(policy[3], hidden), jnp.clip(linear(policy[4], hidden), -20, 2)


def nll_rows(mean: Array, log_std: Array, actions: Array) -> Array:
    """-log density of the squashed action, by the change of variables, for each row."""
    clipped = jnp.clip(actions, -0.999999, 0.999999)
    u = jnp.arctanh(clipped)
    std = jnp.exp(log_std)
    log_normal = -0.5 * ((u - mean) / std) ** 2 - log_std - 0.5 * jnp.log(2 * jnp.pi)
    return -(log_normal - jnp.log1p(-(clipped**2))).sum(axis=1)


def hscic(x: Array, y: Array, z: Array, ridge: float = 1e-5) -> Array:
    """Equation (7) of the paper, literally."""

    def kernel(rows: Array) -> Array:
        squares = (rows[:, None, :] - rows[None, :, :]) ** 2
        return jnp.exp(-squares.sum(axis=-1))

    n = len(x)
    kx, ky, kz = kernel(x), kernel(y), kernel(z)
    w = jnp.linalg.inv(kz + n * ridge * jnp.eye(n))
    first = kz.T @ w @ (kx * ky) @ w.T @ kz
    second = kz.T @ w @ ((kx @ w.T @ kz) * (ky @ w.T @ kz))
    third = (kz.T @ w @ kx @ w.T @ kz) * (kz.T @ w @ ky @ w.T @ kz)
    return jnp.trace(first - 2 * second + third) / n


# ------------------------------------------------------------------------------------------- data


@dataclass
class Rows:
    """What a method learns from; `observations` are standardised stacks, oldest frame first."""

    observations: Numbers
    frame_size: int
    actions: Numbers
    past_actions: Numbers

    def take(self, rows: NDArray[np.int64]) -> "Rows":
        return Rows(
            self.observations[rows], self.frame_size, self.actions[rows], self.past_actions[rows]
        )

    @property
    def last_frame(self) -> Numbers:
        return self.observations[:, -self.frame_size :]


def standardize(values: Numbers) -> Numbers:
    std = values.std(axis=0)
    return (values - values.mean(axis=0)) / np.where(std == 0, 1, std)


def prepare(
    frames: NDArray[np.float32], actions: NDArray[np.float32], lengths: Sequence[int], stack: int
) -> Rows:
    """Stacks with zeros before an episode's start, standardises them; past actions begin at 0."""
    observations = np.zeros((len(frames), stack * frames.shape[1]))
    past = np.zeros(actions.shape)
    start = 0
    for length in lengths:
        for t in range(length):
            stacked = np.zeros((stack, frames.shape[1]))
            known = min(stack, t + 1)
            stacked[stack - known :] = frames[start + t + 1 - known : start + t + 1]
            observations[start + t] = stacked.ravel()
            if t > 0:
                past[start + t] = actions[start + t - 1]
        start += length
    return Rows(standardize(observations), frames.shape[1], actions.astype(np.float64), past)


# ---------------------------------------------------------------------------------- a step of Adam


@dataclass
class Network:
    """Parameters and moments, as Kingma and Ba write them."""

    parameters: Parameters
    first: Parameters = field(default_factory=list[dict[str, Array]])
    second: Parameters = field(default_factory=list[dict[str, Array]])
    steps: int = 0

    def descend(self, gradient: Parameters, rate: float) -> None:
        if not self.first:
            self.first = jax.tree.map(jnp.zeros_like, gradient)
            self.second = jax.tree.map(jnp.zeros_like, gradient)
        self.steps += 1

        def mean(m: Array, g: Array) -> Array:
            return 0.9 * m + 0.1 * g

        def mean_square(v: Array, g: Array) -> Array:
            return 0.999 * v + 0.001 * g * g

        self.first = jax.tree.map(mean, self.first, gradient)
        self.second = jax.tree.map(mean_square, self.second, gradient)

        def update(p: Array, m: Array, v: Array) -> Array:
            m_hat, v_hat = m / (1 - 0.9**self.steps), v / (1 - 0.999**self.steps)
            return p - rate * m_hat / (jnp.sqrt(v_hat) + 1e-8)

        self.parameters = jax.tree.map(update, self.parameters, self.first, self.second)


def flat(layers: Parameters) -> Numbers:
    """The order of files: each layer's weight, row by row, then its bias."""
    parts: list[Numbers] = []
    for layer in layers:
        parts += [np.asarray(layer[key]).ravel() for key in ("w", "b") if key in layer]
    return np.concatenate(parts)


# ------------------------------------------------------------------------------------- the methods
