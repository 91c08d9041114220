"""The methods of the PALR paper, transcribed to float64 JAX: one step from the first parameters.

Written from the papers and recipes, sharing nothing with the trainer but the meaning of a seed:
batches, permutations, initial parameters and noise follow from NumPy's own generators.
"""

from collections.abc import Callable, Sequence
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


@dataclass
class Step:
    """What the first step sees, and the networks after it."""

    networks: dict[str, Network]
    terms: dict[str, float]


Settings = dict[str, Any]
Method = Callable[[Rows, int, Settings], Step]


class Run:
    """Batches of the first step, as the trainer draws them."""

    def __init__(self, data: Rows, seed: int, settings: Settings) -> None:
        self.data, self.seed, self.settings = data, seed, settings
        self.size = settings["batch"]
        self.actions = data.actions.shape[1]
        self.width = data.observations.shape[1]

    def rows(self, purpose: int, index: int = 0) -> NDArray[np.int64]:
        return draw_rows(stream(self.seed, purpose, index), len(self.data.actions), self.size)

    @property
    def batch(self) -> Rows:
        return self.data.take(self.rows(BATCH))

    def inner_batch(self, update: int) -> Rows:
        return self.data.take(self.rows(INNER_BATCH + update))

    def hscic_actions(self, rows: NDArray[np.int64]) -> tuple[Numbers, Numbers]:
        past, given = self.data.past_actions, self.data.actions
        if self.settings.get("standardize_actions", True):
            past, given = standardize(past), standardize(given)
        return past[rows], given[rows]


def plain_nll(policy: Parameters, batch: Rows) -> Array:
    return nll_rows(*decode(policy, encode(policy, batch.observations)), batch.actions).mean()


def one_policy(
    run: Run, loss: Callable[[Parameters], tuple[Array, dict[str, Array]]], **shape: int
) -> Step:
    """A step of a method with the policy network alone."""
    policy = Network(policy_layers(run.width, run.actions, run.seed, **shape))
    (_, terms), gradient = jax.value_and_grad(loss, has_aux=True)(policy.parameters)
    policy.descend(gradient, 3e-4)
    return Step({"policy": policy}, {name: float(value) for name, value in terms.items()})


def bc(data: Rows, seed: int, settings: Settings) -> Step:
    run = Run(data, seed, settings)

    def loss(policy: Parameters) -> tuple[Array, dict[str, Array]]:
        nll = plain_nll(policy, run.batch)
        return nll, {"nll": nll}

    return one_policy(run, loss)


def palr(data: Rows, seed: int, settings: Settings) -> Step:
    """HSCIC(φ; a[t-1] | a[t]) added; with a pool, it is of other rows than the likelihood."""
    run = Run(data, seed, settings)
    rows = run.rows(POOL if settings.get("pool", False) else BATCH)

    def loss(policy: Parameters) -> tuple[Array, dict[str, Array]]:
        nll = plain_nll(policy, run.batch)
        value = hscic(encode(policy, data.observations[rows]), *run.hscic_actions(rows))
        return nll + settings["alpha"] * value, {"nll": nll, "hscic": value}

    return one_policy(run, loss)


def palr_act(data: Rows, seed: int, settings: Settings) -> Step:
    """HSCIC(a^I; a[t-1] | a[t]) added, a^I reparameterised."""
    run = Run(data, seed, settings)
    noise = Normals(stream(seed, NOISE, 0)).draw(run.size, run.actions)
    noise = noise if settings.get("sampled", True) else 0 * noise
    rows = run.rows(BATCH)

    def loss(policy: Parameters) -> tuple[Array, dict[str, Array]]:
        mean, log_std = decode(policy, encode(policy, run.batch.observations))
        nll = nll_rows(mean, log_std, run.batch.actions).mean()
        value = hscic(jnp.tanh(mean + jnp.exp(log_std) * noise), *run.hscic_actions(rows))
        return nll + settings["alpha"] * value, {"nll": nll, "hscic": value}

    return one_policy(run, loss)


def vib(data: Rows, seed: int, settings: Settings) -> Step:
    run = Run(data, seed, settings)
    noise = Normals(stream(seed, NOISE, 0)).draw(run.size, 64)

    def loss(policy: Parameters) -> tuple[Array, dict[str, Array]]:
        encoded = encode(policy, run.batch.observations)
        mean, std = encoded[:, :64], jnp.logaddexp(encoded[:, 64:] - 5, 0)
        nll = nll_rows(*decode(policy, mean + std * noise), run.batch.actions).mean()
        divergence = 0.5 * (mean**2 + std**2 - 1 - jnp.log(std**2)).sum(axis=1).mean()
        return nll + settings["beta"] * divergence, {"nll": nll, "divergence": divergence}

    return one_policy(run, loss, phi=128)


WIDTH, DEPTH = 128, 3


def dt_layers(frame: int, stack: int, actions: int, seed: int) -> Parameters:
    """Return, state, positions and norm; three blocks of six; norm and heads."""
    rng = stream(seed, INITIAL, 0)

    def normal(inputs: int, outputs: int, *, has_bias: bool = True) -> dict[str, Array]:
        layer = {"w": 0.02 * rng.standard_normal((inputs, outputs))}
        return {**layer, "b": np.zeros(outputs)} if has_bias else layer

    def norm() -> dict[str, Array]:
        return {"w": np.ones((1, WIDTH)), "b": np.zeros(WIDTH)}

    layers = [normal(1, WIDTH), normal(frame, WIDTH), normal(stack, WIDTH, has_bias=False), norm()]
    for _ in range(DEPTH):
        layers += [norm(), normal(WIDTH, 3 * WIDTH), normal(WIDTH, WIDTH)]
        layers += [norm(), normal(WIDTH, 4 * WIDTH), normal(4 * WIDTH, WIDTH)]
    return [*layers, norm(), normal(WIDTH, actions), normal(WIDTH, actions)]


def dt_hidden(layers: Parameters, observations: Array, frame: int) -> Array:
    """The last hidden state of the newest observation's token."""

    def norm(layer: dict[str, Array], x: Array) -> Array:
        centered = x - x.mean(axis=-1, keepdims=True)
        variance = (centered**2).mean(axis=-1, keepdims=True)
        return centered / jnp.sqrt(variance + 1e-5) * layer["w"][0] + layer["b"]

    frames = observations.reshape(len(observations), -1, frame)
    tokens: list[Array] = []
    for i in range(frames.shape[1]):
        position = layers[2]["w"][i]
        returned = jnp.zeros((len(frames), 1))
        tokens += [linear(layers[0], returned) + position]
        tokens += [linear(layers[1], frames[:, i]) + position]
    x = norm(layers[3], jnp.stack(tokens, axis=1))
    causal = jnp.tril(jnp.ones((len(tokens), len(tokens)), bool))
    for block in range(DEPTH):
        before, attend, project, between, inner, outer = layers[4 + 6 * block : 10 + 6 * block]
        q, k, v = jnp.split(linear(attend, norm(before, x)), 3, axis=-1)
        scores = jnp.einsum("nid,njd->nij", q, k) / np.sqrt(WIDTH)
        weights = jax.nn.softmax(jnp.where(causal, scores, -jnp.inf), axis=-1)
        x = x + linear(project, weights @ v)
        x = x + linear(outer, jnp.maximum(linear(inner, norm(between, x)), 0))
    return norm(layers[-3], x[:, -1])


def dt_step(run: Run, alpha: float) -> Step:
    """AdamW with warm-up and clipping; with alpha, HSCIC of the last hidden state is added."""
    data, settings = run.data, run.settings
    stack = run.width // data.frame_size
    rows = run.rows(BATCH)

    def loss(layers: Parameters) -> tuple[Array, dict[str, Array]]:
        hidden = dt_hidden(layers, run.batch.observations, data.frame_size)
        log_std = jnp.clip(linear(layers[-1], hidden), -20, 2)
        nll = nll_rows(linear(layers[-2], hidden), log_std, run.batch.actions).mean()
        if alpha == 0:
            return nll, {"nll": nll}
        value = hscic(hidden, *run.hscic_actions(rows))
        return nll + alpha * value, {"nll": nll, "hscic": value}

    policy = Network(dt_layers(data.frame_size, stack, run.actions, run.seed))
    (_, terms), gradient = jax.jit(jax.value_and_grad(loss, has_aux=True))(policy.parameters)
    length = np.linalg.norm(flat(gradient))
    scale = min(1.0, settings.get("clip_norm", 0.25) / (length + 1e-6))
    rate = 1e-4 / settings.get("warmup", 1)
    kept = 1 - rate * settings.get("weight_decay", 1e-4)

    def times(factor: float, tree: Parameters) -> Parameters:
        def product(array: Array) -> Array:
            return array * factor

        return jax.tree.map(product, tree)

    policy.parameters = times(kept, policy.parameters)
    policy.descend(times(scale, gradient), rate)
    return Step({"policy": policy}, {name: float(value) for name, value in terms.items()})


def dt(data: Rows, seed: int, settings: Settings) -> Step:
    return dt_step(Run(data, seed, settings), 0.0)


def dt_palr(data: Rows, seed: int, settings: Settings) -> Step:
    return dt_step(Run(data, seed, settings), settings["alpha"])


def kf(data: Rows, seed: int, settings: Settings) -> Step:
    """Weights from the predictor before its update, constants to the policy."""
    run = Run(data, seed, settings)
    batch = run.batch
    sizes = [(run.actions, 128, True), (128, 128, True), (128, run.actions, True)]
    predictor = Network(uniform_layers(sizes, seed, 1))

    def errors(layers: Parameters) -> Array:
        return ((leaky_mlp(layers, batch.past_actions) - batch.actions) ** 2).mean(axis=1)

    now = errors(predictor.parameters)
    if settings.get("weighting", "softmax") == "softmax":
        weights = jax.nn.softmax(settings["temperature"] * now)
    else:
        keyframes = now > jnp.sort(now)[-1 - int(0.1 * run.size)]
        weights = jnp.where(keyframes, 5.0, 1.0) / run.size

    def loss(policy: Parameters) -> tuple[Array, dict[str, Array]]:
        each = nll_rows(*decode(policy, encode(policy, batch.observations)), batch.actions)
        return (weights * each).sum(), {"nll": each.mean(), "prediction_error": now.mean()}

    step = one_policy(run, loss)

    def predictor_loss(layers: Parameters) -> Array:
        return errors(layers).mean()

    predictor.descend(jax.grad(predictor_loss)(predictor.parameters), 3e-4)
    step.networks["predictor"] = predictor
    return step


def primenet(data: Rows, seed: int, settings: Settings) -> Step:
    run = Run(data, seed, settings)
    batch = run.batch
    prime = Network(policy_layers(data.frame_size, run.actions, seed, 1))
    policy = Network(policy_layers(run.width, run.actions, seed, joined=run.actions))

    def loss(both: tuple[Parameters, Parameters]) -> tuple[Array, dict[str, Array]]:
        policy, prime = both
        mean, log_std = decode(prime, encode(prime, batch.last_frame))
        prime_nll = nll_rows(mean, log_std, batch.actions).mean()
        guess = jnp.tanh(mean)
        if settings.get("detach", False):
            guess = jax.lax.stop_gradient(guess)
        phi = jnp.hstack([guess, encode(policy, batch.observations)])
        nll = nll_rows(*decode(policy, phi), batch.actions).mean()
        return nll + prime_nll, {"nll": nll, "prime_nll": prime_nll}

    both = (policy.parameters, prime.parameters)
    (_, terms), gradients = jax.value_and_grad(loss, has_aux=True)(both)
    policy.descend(gradients[0], 3e-4)
    prime.descend(gradients[1], 3e-4)
    return Step(
        {"policy": policy, "prime": prime}, {name: float(value) for name, value in terms.items()}
    )


def rap(data: Rows, seed: int, settings: Settings) -> Step:
    """Memory and residual head first; then the policy, on the memory that they left."""
    run = Run(data, seed, settings)
    batch = run.batch
    policy = Network(policy_layers(data.frame_size, run.actions, seed, joined=64))
    memory = Network(uniform_layers([(run.width, 128, False), (128, 64, True)], seed, 1))
    residual = Network(uniform_layers([(64, 300, True), (300, run.actions, True)], seed, 2))

    def residual_error(both: tuple[Parameters, Parameters]) -> Array:
        memory, residual = both
        predicted = leaky_mlp(residual, leaky_mlp(memory, batch.observations))
        return ((predicted - (batch.actions - batch.past_actions)) ** 2).mean()

    both = (memory.parameters, residual.parameters)
    error, gradients = jax.value_and_grad(residual_error)(both)
    memory.descend(gradients[0], 3e-4)
    residual.descend(gradients[1], 3e-4)
    remembered = leaky_mlp(memory.parameters, batch.observations)

    def loss(policy: Parameters) -> Array:
        phi = jnp.hstack([remembered, encode(policy, batch.last_frame)])
        return nll_rows(*decode(policy, phi), batch.actions).mean()

    nll, gradient = jax.value_and_grad(loss)(policy.parameters)
    policy.descend(gradient, 3e-4)
    networks = {"policy": policy, "memory": memory, "residual": residual}
    return Step(networks, {"nll": float(nll), "residual_error": float(error)})


def frozen(gradient: Parameters, settings: Settings) -> Parameters:
    """Without the gradient of the layer after φ, if that is to keep its first parameters."""
    if not settings.get("freeze_hidden", False):
        return gradient
    still = jax.tree.map(jnp.zeros_like, gradient[2])
    return [*gradient[:2], still, *gradient[3:]]


def fca(data: Rows, seed: int, settings: Settings) -> Step:
    run = Run(data, seed, settings)
    sizes = [(run.actions + 64, 300, True), (300, run.actions, True)]
    adversary = Network(uniform_layers(sizes, seed, 1))
    policy = Network(policy_layers(run.width, run.actions, seed))

    def error(layers: Parameters, phi: Array, batch: Rows) -> Array:
        predicted = leaky_mlp(layers, jnp.hstack([batch.actions, phi]))
        return ((predicted - batch.past_actions) ** 2).mean()

    def loss(layers: Parameters) -> tuple[Array, dict[str, Array]]:
        batch = run.batch
        phi = encode(layers, batch.observations)
        nll = plain_nll(layers, batch)
        fooled = error(adversary.parameters, phi, batch)
        bottleneck = 0.01 * 0.5 * (phi**2).sum()
        terms = {"nll": nll, "adversary_error": fooled}
        return nll - settings["alpha"] * fooled + bottleneck, terms

    (_, terms), gradient = jax.value_and_grad(loss, has_aux=True)(policy.parameters)
    policy.descend(frozen(gradient, settings), 3e-4)
    for update in range(5):
        batch = run.inner_batch(update)
        phi = encode(policy.parameters, batch.observations)
        adversary.descend(jax.grad(error)(adversary.parameters, phi, batch), 1e-4)
    return Step(
        {"policy": policy, "adversary": adversary},
        {name: float(value) for name, value in terms.items()},
    )


def mine(data: Rows, seed: int, settings: Settings) -> Step:
    run = Run(data, seed, settings)
    width = 2 * run.actions + 64
    estimator = Network(kaiming_layers([(width, 100), (100, 100), (100, 1)], seed, 1))
    policy = Network(policy_layers(run.width, run.actions, seed))
    average: list[float] = []

    def outputs(
        layers: Parameters, phi: Array, batch: Rows, rng: np.random.Generator
    ) -> tuple[Array, Array]:
        """Of the joint samples, and of those with permuted past actions."""
        order = permutation(rng, run.size)
        noise = Normals(rng)
        joint = jnp.hstack([batch.past_actions, batch.actions, phi])
        marginal = jnp.hstack([batch.past_actions[order], batch.actions, phi])
        x = jnp.vstack([joint, marginal])
        x = x + 0.3 * noise.draw(*x.shape)
        for layer in layers[:-1]:
            x = jax.nn.elu(linear(layer, x))
            x = x + 0.5 * noise.draw(*x.shape)
        out = linear(layers[-1], x)[:, 0]
        return out[: run.size], out[run.size :]

    def bound(joint: Array, marginal: Array) -> Array:
        return joint.mean() - jnp.log(jnp.exp(marginal).mean())

    def loss(layers: Parameters) -> tuple[Array, dict[str, Array]]:
        batch = run.batch
        phi = encode(layers, batch.observations)
        nll = plain_nll(layers, batch)
        information = bound(*outputs(estimator.parameters, phi, batch, stream(seed, NOISE, 0)))
        terms = {"nll": nll, "mutual_information": information}
        return nll + settings["alpha"] * information, terms

    (_, terms), gradient = jax.value_and_grad(loss, has_aux=True)(policy.parameters)
    policy.descend(frozen(gradient, settings), 3e-4)

    def inner_loss(layers: Parameters, phi: Array, batch: Rows, update: int) -> Array:
        rng = stream(seed, INNER_NOISE + update, 0)
        joint, marginal = outputs(layers, phi, batch, rng)
        if "ema_decay" not in settings:
            return -bound(joint, marginal)
        return -(joint.mean() - jnp.exp(marginal).mean() / (average[-1] + 1e-6))

    def remember(phi: Array, batch: Rows, update: int) -> None:
        """Adds the moving average of the marginals' mean of exp; the first is the mean itself."""
        rng = stream(seed, INNER_NOISE + update, 0)
        now = float(jnp.exp(outputs(estimator.parameters, phi, batch, rng)[1]).mean())
        decay = settings["ema_decay"] if average else 0.0
        average.append(decay * (average or [0.0])[-1] + (1 - decay) * now)

    for update in range(5):
        batch = run.inner_batch(update)
        phi = encode(policy.parameters, batch.observations)
        if "ema_decay" in settings:
            remember(phi, batch, update)
        gradient = jax.grad(inner_loss)(estimator.parameters, phi, batch, update)
        estimator.descend(gradient, 1e-4)
    return Step(
        {"policy": policy, "estimator": estimator},
        {name: float(value) for name, value in terms.items()},
    )


METHODS: dict[str, Method] = {
    "bc": bc,
    "kf": kf,
    "primenet": primenet,
    "rap": rap,
    "fca": fca,
    "mine": mine,
    "palr": palr,
    "palr_act": palr_act,
    "vib": vib,
    "dt": dt,
    "dt_palr": dt_palr,
}
