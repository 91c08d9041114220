"""Soft actor-critic, written down a second time: float64, plain JAX, Gymnasium's own environments.

From the seed to the optimiser's moments: which random numbers are drawn for what, what the replay
holds, the losses of Haarnoja et al. (2018) and Kuznetsov et al. (2020), their gradients by
autodiff, and Adam.
"""

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from support.methods_parts import (
    Array,
    Normals,
    Numbers,
    Parameters,
    flat,
    jax,
    jnp,
    stream,
    uniform_layers,
)
from support.reference import gymnasium_env

BATCH, NOISE, EXPLORATION, PERTURBATION = 2, 4, 7, 8
LARGEST_ACTION = np.float32(1 - 2.0**-24)


@dataclass
class Recipe:
    """What decides a run."""

    task: str
    critic: str
    seed: int
    num_envs: int
    updates: int
    learning_starts: int
    batch: int
    hidden: int
    quantiles: int
    dropped: int
    rate: float = 3e-4
    discount: float = 0.99
    polyak: float = 0.005
    actor_every: int = 1
    actor_average: float = 1.0
    reward_cap: float | None = None
    healthy_z_range: tuple[float, float] | None = None
    perturbation: float = 0.0
    perturbation_duration: float = 1.0
    episode_steps: int | None = None


@dataclass
class Adam:
    """Parameters and moments of one network."""

    parameters: Any
    first: Any = None
    second: Any = None
    steps: int = 0

    def __post_init__(self) -> None:
        zeros = jax.tree.map(jnp.zeros_like, self.parameters)
        self.first, self.second = zeros, zeros

    def descend(self, gradient: Any, rate: float) -> None:
        """A step of Kingma and Ba's algorithm 1."""
        self.steps += 1
        first, second = 1 - 0.9**self.steps, 1 - 0.999**self.steps

        def mean(m: Array, g: Array) -> Array:
            return 0.9 * m + 0.1 * g

        def mean_square(v: Array, g: Array) -> Array:
            return 0.999 * v + 0.001 * g * g

        def stepped(p: Array, m: Array, v: Array) -> Array:
            return p - rate * (m / first) / (jnp.sqrt(v / second) + 1e-8)

        self.first = jax.tree.map(mean, self.first, gradient)
        self.second = jax.tree.map(mean_square, self.second, gradient)
        self.parameters = jax.tree.map(stepped, self.parameters, self.first, self.second)


def mlp(layers: Parameters, x: Array) -> Array:
    """ReLU between layers."""
    for layer in layers[:-1]:
        x = jnp.maximum(x @ layer["w"] + layer["b"], 0)
    return x @ layers[-1]["w"] + layers[-1]["b"]


def act(actor: Parameters, observations: Array, noise: Array) -> tuple[Array, Array]:
    """Sampled actions and their log densities."""
    mean, log_std = jnp.split(mlp(actor, observations), 2, axis=1)
    log_std = jnp.clip(log_std, -20, 2)
    action = jnp.tanh(mean + jnp.exp(log_std) * noise)
    gaussian = -0.5 * noise**2 - log_std - 0.5 * jnp.log(2 * jnp.pi)
    return action, jnp.sum(gaussian - jnp.log(1 - action**2), axis=1)


def critic_loss(recipe: Recipe, critic: Parameters, inputs: Array, targets: Array) -> Array:
    """Of one critic; `targets` `[n, targets]`."""
    values = mlp(critic, inputs)
    if recipe.critic == "sac":
        return 0.5 * jnp.mean((values - targets) ** 2)
    errors = targets[:, None, :] - values[:, :, None]
    huber = jnp.where(jnp.abs(errors) > 1, jnp.abs(errors) - 0.5, 0.5 * errors**2)
    levels = (jnp.arange(recipe.quantiles) + 0.5) / recipe.quantiles
    return jnp.mean(jnp.abs(levels[None, :, None] - (errors < 0)) * huber)


def nearer(share: float, slow: Array, parameter: Array) -> Array:
    """What a slow copy becomes."""
    return slow + share * (parameter - slow)


def next_values(recipe: Recipe, slow: list[Parameters], inputs: Array) -> Array:
    """What the target critics leave of their values, `[n, targets]`."""
    values = [mlp(critic, inputs) for critic in slow]
    if recipe.critic == "sac":
        return jnp.minimum(values[0], values[1])
    ascending = jnp.sort(jnp.concatenate(values, axis=1), axis=1)
    return ascending[:, : 2 * (recipe.quantiles - recipe.dropped)]


def policy_value(recipe: Recipe, critics: list[Parameters], inputs: Array) -> Array:
    """What the actor maximises, mean over rows."""
    values = [mlp(critic, inputs) for critic in critics]
    if recipe.critic == "sac":
        return jnp.mean(jnp.minimum(values[0], values[1]))
    return jnp.mean(jnp.concatenate(values, axis=1))


@dataclass
class Replay:
    """All transitions, in the order of steps and environments."""

    rows: list[tuple[Any, ...]] = field(default_factory=list[tuple[Any, ...]])

    def draw(self, rng: np.random.Generator, n: int) -> list[Array]:
        """With replacement."""
        chosen = [self.rows[int(rng.random() * len(self.rows))] for _ in range(n)]
        return [
            jnp.asarray(np.stack(column).astype(np.float64)) for column in zip(*chosen, strict=True)
        ]


class Run:
    """The whole run; its attributes are where it ends."""

    def __init__(self, recipe: Recipe) -> None:
        """Collects and learns."""
        self.recipe = recipe
        self._envs = [gymnasium_env(recipe.task) for _ in range(recipe.num_envs)]
        seeded = [env.reset(seed=recipe.seed + i)[0] for i, env in enumerate(self._envs)]
        self._observations = [observation.astype(np.float32) for observation in seeded]
        size = self._observations[0].size
        space: Any = self._envs[0].action_space
        self._action_size = int(space.shape[0])
        self.actor = Adam(self._network(0, size, 2 * self._action_size))
        outputs = 1 if recipe.critic == "sac" else recipe.quantiles
        inputs = size + self._action_size
        self.critics = [Adam(self._network(number, inputs, outputs)) for number in (1, 2)]
        self.slow = [critic.parameters for critic in self.critics]
        self.averaged_actor = self.actor.parameters
        self.log_temperature = Adam(jnp.zeros(1))
        self.losses: list[dict[str, float]] = []
        self._replay = Replay()
        self._lengths = [0] * recipe.num_envs
        self._pushes = np.zeros((recipe.num_envs, self._action_size), np.float32)
        self._collect()

    def _network(self, number: int, inputs: int, outputs: int) -> Parameters:
        hidden = self.recipe.hidden
        sizes = [(inputs, hidden, True), (hidden, hidden, True), (hidden, outputs, True)]
        return jax.tree.map(jnp.asarray, uniform_layers(sizes, self.recipe.seed, number))

    def _collect(self) -> None:
        recipe = self.recipe
        rounds = 0
        # One update beside each round but the first of the policy's own.
        while True:
            rng = stream(recipe.seed, EXPLORATION, rounds)
            shape = (recipe.num_envs, self._action_size)
            if len(self._replay.rows) < recipe.learning_starts:
                actions = rng.uniform(-1, 1, size=shape).astype(np.float32)
                is_learning = False
            else:
                observations = jnp.asarray(np.stack(self._observations).astype(np.float64))
                noise = jnp.asarray(Normals(rng).draw(*shape))
                actions = np.asarray(act(self.actor.parameters, observations, noise)[0])
                actions = actions.astype(np.float32).clip(-LARGEST_ACTION, LARGEST_ACTION)
                is_learning = len(self._replay.rows) > recipe.learning_starts
            if is_learning:
                self._update()
            self._push(rounds)
            self._step(actions)
            rounds += 1
            if len(self.losses) == recipe.updates:
                return

    def _push(self, number: int) -> None:
        std, duration = self.recipe.perturbation, self.recipe.perturbation_duration
        if std == 0:
            return
        memory = np.float32(1 - 1 / duration)
        normals = Normals(stream(self.recipe.seed, PERTURBATION, number)).draw(*self._pushes.shape)
        fresh = np.float32(std) * np.sqrt(1 - memory * memory)
        self._pushes = memory * self._pushes + fresh * np.asarray(normals, np.float32)

    def _step(self, actions: Any) -> None:
        for i, (env, action) in enumerate(zip(self._envs, actions, strict=True)):
            pushed = action
            if self.recipe.perturbation:
                pushed = (action + self._pushes[i]).clip(-LARGEST_ACTION, LARGEST_ACTION)
            observation, reward, terminated, truncated, _ = env.step(pushed)
            after = observation.astype(np.float32)
            row = (self._observations[i], action, np.float32(reward), after, 1.0 - terminated)
            self._replay.rows.append(row)
            self._lengths[i] += 1
            if terminated or truncated or self._lengths[i] == self.recipe.episode_steps:
                self._lengths[i] = 0
                after = env.reset()[0].astype(np.float32)
            self._observations[i] = after

    def _update(self) -> None:
        recipe = self.recipe
        number = len(self.losses)
        rows = self._replay.draw(stream(recipe.seed, BATCH, number), recipe.batch)
        observations, actions, rewards, after, continues = rows
        if recipe.reward_cap is not None:
            rewards = jnp.minimum(rewards, recipe.reward_cap)
        if recipe.healthy_z_range is not None:
            least, greatest = recipe.healthy_z_range
            height = after[:, 0]
            continues = jnp.where((height < least) | (height > greatest), 0, continues)
        normals = Normals(stream(recipe.seed, NOISE, number))
        noise = jnp.asarray(normals.draw(recipe.batch, self._action_size))
        next_noise = jnp.asarray(normals.draw(recipe.batch, self._action_size))

        actor = self.actor.parameters
        alpha = jnp.exp(self.log_temperature.parameters[0])
        _, log_density = act(actor, observations, noise)
        next_actions, next_log_density = act(actor, after, next_noise)
        target_entropy = -self._action_size

        def temperature_loss(log_alpha: Array) -> Array:
            return -(log_alpha * (log_density + target_entropy)).mean()

        self.log_temperature.descend(
            jax.grad(temperature_loss)(self.log_temperature.parameters), recipe.rate
        )

        inputs = jnp.concatenate([after, next_actions], axis=1)
        values = next_values(recipe, self.slow, inputs) - alpha * next_log_density[:, None]
        targets = rewards[:, None] + recipe.discount * continues[:, None] * values
        inputs = jnp.concatenate([observations, actions], axis=1)
        total = 0.0

        def loss(layers: Parameters) -> Array:
            return critic_loss(recipe, layers, inputs, targets)

        for critic in self.critics:
            value, gradient = jax.value_and_grad(loss)(critic.parameters)
            total += float(value)
            critic.descend(gradient, recipe.rate)

        critics = [critic.parameters for critic in self.critics]

        def actor_loss(layers: Parameters) -> Array:
            own_actions, own_log_density = act(layers, observations, noise)
            inputs = jnp.concatenate([observations, own_actions], axis=1)
            return jnp.mean(alpha * own_log_density) - policy_value(recipe, critics, inputs)

        losses = {"critic_loss": total, "entropy": float(-log_density.mean())}
        if (number + 1) % recipe.actor_every == 0:
            value, gradient = jax.value_and_grad(actor_loss)(actor)
            self.actor.descend(gradient, recipe.rate)
            losses["actor_loss"] = float(value)
            self.averaged_actor = jax.tree.map(
                partial(nearer, recipe.actor_average), self.averaged_actor, self.actor.parameters
            )
        self.slow = [
            jax.tree.map(partial(nearer, recipe.polyak), slow, critic)
            for slow, critic in zip(self.slow, critics, strict=True)
        ]
        self.losses.append({**losses, "temperature": float(alpha)})

    def networks(self) -> dict[str, tuple[Numbers, Numbers, Numbers]]:
        """Parameters, first and second moments, flat, by the names in checkpoints."""
        first, second = self.critics
        named = {"actor": self.actor, "critic_1": first, "critic_2": second}
        state = {
            name: (flat(adam.parameters), flat(adam.first), flat(adam.second))
            for name, adam in named.items()
        }
        log = self.log_temperature
        alone = [np.asarray(array) for array in (log.parameters, log.first, log.second)]
        return state | {"temperature": (alone[0], alone[1], alone[2])}
