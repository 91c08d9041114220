"""The methods of the PALR paper, transcribed to float64 JAX: one step from the first parameters."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from support.methods_parts import (
    BATCH,
    INITIAL,
    INNER_BATCH,
    INNER_NOISE,
    NOISE,
    POOL,
    Array,
    Network,
    Normals,
    Numbers,
    Parameters,
    Rows,
    decode,
    draw_rows,
    encode,
    flat,
    hscic,
    jax,
    jnp,
    kaiming_layers,
    leaky_mlp,
    linear,
    nll_rows,
    permutation,
    policy_layers,
    standardize,
    stream,
    uniform_layers,
)


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
