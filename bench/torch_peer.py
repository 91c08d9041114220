"""Plain torch transcriptions of the training steps, as a researcher would write them.

    python -m bench.torch_peer --method bc --setting hopper-w2 --steps 300

Eager float32, one thread, torch's own Adam, no logging, no evaluation; batches are drawn with
torch's generator and sliced from tensors in memory. The recipes are those of the paper and its
public code (sizes, learning rates, inner updates); each step does what that code does, in words of
our own.

Prints a line of JSON: CPU seconds of all threads per step.
"""

# torch is not installed where types are checked.
# pyright: basic, reportMissingImports=false

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor, nn

_ROWS = 30_000
_BATCH = 1024
_PHI = 64
_HIDDEN = 128
_SIZES = {"hopper-w2": (5, 2, 3), "ant-w4": (13, 4, 8)}
_LARGEST_ACTION = 0.999_999


@dataclass(frozen=True)
class Data:
    """Standardised stacks `[n, w d]`, actions and past actions `[n, A]`."""

    observations: Tensor
    actions: Tensor
    past_actions: Tensor
    frame: int

    def batch(self) -> tuple[Tensor, Tensor, Tensor]:
        """Rows drawn with replacement."""
        rows = torch.randint(len(self.actions), (_BATCH,))
        return self.observations[rows], self.actions[rows], self.past_actions[rows]


def synthetic(setting: str) -> Data:
    """Numbers of the right sizes: what a step costs does not depend on them."""
    frame, stack, action_size = _SIZES[setting]
    torch.manual_seed(0)
    observations = torch.randn(_ROWS, frame * stack)
    actions = torch.tanh(0.7 * torch.randn(_ROWS, action_size))
    return Data(observations, actions, actions.roll(1, 0), frame)


class Policy(nn.Module):
    """The paper's tanh-Gaussian policy; phi is linear."""

    def __init__(self, inputs: int, action_size: int, extra: int = 0) -> None:
        """`extra` features join phi."""
        super().__init__()
        self.encoder = nn.Sequential(
            nn.Linear(inputs, _HIDDEN, bias=False), nn.LeakyReLU(0.2), nn.Linear(_HIDDEN, _PHI)
        )
        self.decoder = nn.Sequential(
            nn.LeakyReLU(0.2), nn.Linear(_PHI + extra, _HIDDEN), nn.LeakyReLU(0.2)
        )
        self.mean = nn.Linear(_HIDDEN, action_size)
        self.log_std = nn.Linear(_HIDDEN, action_size)

    def heads(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log standard deviation from phi and what joins it."""
        hidden = self.decoder(features)
        return self.mean(hidden), self.log_std(hidden).clamp(-20, 2)

    def forward(self, observations: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Phi, mean, log standard deviation."""
        phi = self.encoder(observations)
        return phi, *self.heads(phi)


def negative_log_likelihood(mean: Tensor, log_std: Tensor, actions: Tensor) -> Tensor:
    """Of a tanh-Gaussian, for each row."""
    before = torch.atanh(actions.clamp(-_LARGEST_ACTION, _LARGEST_ACTION))
    normal = torch.distributions.Normal(mean, log_std.exp())
    slope = 2 * (0.693_147_18 - before - nn.functional.softplus(-2 * before))
    return -(normal.log_prob(before) - slope).sum(-1)


def kernel(values: Tensor) -> Tensor:
    """The Gaussian kernel with bandwidth 1, its distances from products of matrices."""
    squares = values.square().sum(-1)
    distances = squares[:, None] + squares[None] - 2 * values @ values.T
    return torch.exp(-distances.clamp(min=0))


def hscic(phi: Tensor, past: Tensor, given: Tensor, ridge: float = 1e-5) -> Tensor:
    """Equation (7): gradients flow through the kernel of phi alone."""
    n = len(phi)
    with torch.no_grad():
        kernel_z = kernel(given)
        kernel_y = kernel(past)
        inverse = torch.linalg.inv(kernel_z + n * ridge * torch.eye(n))
        weights = inverse @ kernel_z
    kernel_x = kernel(phi)
    first = weights.T @ (kernel_x * kernel_y) @ weights
    second = weights.T @ ((kernel_x @ weights) * (kernel_y @ weights))
    third = (weights.T @ kernel_x @ weights) * (weights.T @ kernel_y @ weights)
    return (torch.trace(first) - 2 * torch.trace(second) + torch.trace(third)) / n


def standardised(values: Tensor) -> Tensor:
    """Mean 0, deviation 1, in each column."""
    return (values - values.mean(0)) / values.std(0, unbiased=False)


def adam(*modules: nn.Module, rate: float = 3e-4) -> torch.optim.Adam:
    """Over all parameters."""
    return torch.optim.Adam([p for module in modules for p in module.parameters()], lr=rate)


def update(optimizer: torch.optim.Optimizer, loss: Tensor) -> None:
    """One step."""
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()


Step = Callable[[], None]


def bc(data: Data) -> Step:
    """Behaviour cloning."""
    policy = Policy(data.observations.shape[1], data.actions.shape[1])
    optimizer = adam(policy)

    def step() -> None:
        observations, actions, _ = data.batch()
        _, mean, log_std = policy(observations)
        update(optimizer, negative_log_likelihood(mean, log_std, actions).mean())

    return step


def palr(data: Data) -> Step:
    """PALR, exact."""
    policy = Policy(data.observations.shape[1], data.actions.shape[1])
    optimizer = adam(policy)
    given, past = standardised(data.actions), standardised(data.past_actions)

    def step() -> None:
        rows = torch.randint(len(given), (_BATCH,))
        phi, mean, log_std = policy(data.observations[rows])
        loss = negative_log_likelihood(mean, log_std, data.actions[rows]).mean()
        update(optimizer, loss + 10 * hscic(phi, past[rows], given[rows]))

    return step


def kf(data: Data) -> Step:
    """Keyframe-focused: softmax weights, the predictor trained jointly."""
    action_size = data.actions.shape[1]
    policy = Policy(data.observations.shape[1], action_size)
    predictor = nn.Sequential(
        nn.Linear(action_size, 128),
        nn.LeakyReLU(0.2),
        nn.Linear(128, 128),
        nn.LeakyReLU(0.2),
        nn.Linear(128, action_size),
    )
    optimizer, inner = adam(policy), adam(predictor)

    def step() -> None:
        observations, actions, past = data.batch()
        error = (predictor(past) - actions).square().mean(-1)
        weights = torch.softmax(0.01 * error.detach(), 0)
        _, mean, log_std = policy(observations)
        update(optimizer, (weights * negative_log_likelihood(mean, log_std, actions)).sum())
        update(inner, error.mean())

    return step


def primenet(data: Data) -> Step:
    """A policy on the last frame primes the one on the stack."""
    action_size = data.actions.shape[1]
    policy = Policy(data.observations.shape[1], action_size, extra=action_size)
    prime = Policy(data.frame, action_size)
    optimizer = adam(policy, prime)

    def step() -> None:
        observations, actions, _ = data.batch()
        _, prime_mean, prime_log_std = prime(observations[:, -data.frame :])
        phi = policy.encoder(observations)
        mean, log_std = policy.heads(torch.cat([phi, torch.tanh(prime_mean)], -1))
        loss = negative_log_likelihood(mean, log_std, actions).mean()
        update(
            optimizer,
            loss + negative_log_likelihood(prime_mean, prime_log_std, actions).mean(),
        )

    return step


def rap(data: Data) -> Step:
    """Memory from residuals, policy from the last frame and the memory."""
    action_size = data.actions.shape[1]
    memory = Policy(data.observations.shape[1], 1).encoder
    residual = nn.Sequential(nn.Linear(_PHI, 300), nn.LeakyReLU(0.2), nn.Linear(300, action_size))
    policy = Policy(data.frame, action_size, extra=_PHI)
    memory_optimizer, optimizer = adam(memory, residual), adam(policy)

    def step() -> None:
        observations, actions, past = data.batch()
        error = (residual(memory(observations)) - (actions - past)).square().mean()
        update(memory_optimizer, error)
        m = memory(observations).detach()
        h = policy.encoder(observations[:, -data.frame :])
        mean, log_std = policy.heads(torch.cat([m, h], -1))
        update(optimizer, negative_log_likelihood(mean, log_std, actions).mean())

    return step


def fca(data: Data) -> Step:
    """An adversary with five updates a step."""
    action_size = data.actions.shape[1]
    policy = Policy(data.observations.shape[1], action_size)
    adversary = nn.Sequential(
        nn.Linear(_PHI + action_size, 300), nn.LeakyReLU(0.2), nn.Linear(300, action_size)
    )
    optimizer, inner = adam(policy), adam(adversary, rate=1e-4)

    def error(phi: Tensor, actions: Tensor, past: Tensor) -> Tensor:
        return (adversary(torch.cat([actions, phi], -1)) - past).square().mean()

    def step() -> None:
        observations, actions, past = data.batch()
        phi, mean, log_std = policy(observations)
        loss = negative_log_likelihood(mean, log_std, actions).mean()
        bottleneck = 0.01 * 0.5 * phi.square().sum()
        update(optimizer, loss - 0.1 * error(phi, actions, past) + bottleneck)
        for _ in range(5):
            observations, actions, past = data.batch()
            with torch.no_grad():
                phi = policy.encoder(observations)
            update(inner, error(phi, actions, past))

    return step


class Estimator(nn.Module):
    """MINE's network, with the noise that its public code always adds."""

    def __init__(self, inputs: int) -> None:
        """Two hidden layers of 100."""
        super().__init__()
        self.first, self.second = nn.Linear(inputs, 100), nn.Linear(100, 100)
        self.last = nn.Linear(100, 1)

    def forward(self, values: Tensor) -> Tensor:
        """`[n, 1]`."""
        values = values + 0.3 * torch.randn_like(values)
        values = nn.functional.elu(self.first(values))
        values = nn.functional.elu(self.second(values + 0.5 * torch.randn_like(values)))
        return self.last(values + 0.5 * torch.randn_like(values))


def mine(data: Data) -> Step:
    """A neural estimate of mutual information with five updates a step."""
    action_size = data.actions.shape[1]
    policy = Policy(data.observations.shape[1], action_size)
    estimator = Estimator(2 * action_size + _PHI)
    optimizer, inner = adam(policy), adam(estimator, rate=1e-4)

    def bound(phi: Tensor, actions: Tensor, past: Tensor) -> Tensor:
        joint = torch.cat([actions, phi], -1)
        shuffled = joint[torch.randperm(_BATCH)]
        together = estimator(torch.cat([past, joint], -1)).mean()
        apart = estimator(torch.cat([past, shuffled], -1))
        return together - (torch.logsumexp(apart, 0).squeeze() - torch.log(torch.tensor(_BATCH)))

    def step() -> None:
        observations, actions, past = data.batch()
        phi, mean, log_std = policy(observations)
        loss = negative_log_likelihood(mean, log_std, actions).mean()
        update(optimizer, loss + bound(phi, actions, past))
        for _ in range(5):
            observations, actions, past = data.batch()
            with torch.no_grad():
                phi = policy.encoder(observations)
            update(inner, -bound(phi, actions, past))

    return step


_METHODS: dict[str, Callable[[Data], Step]] = {
    "bc": bc,
    "palr": palr,
    "kf": kf,
    "primenet": primenet,
    "rap": rap,
    "fca": fca,
    "mine": mine,
}


def main() -> None:
    """Measures a method."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--method", choices=sorted(_METHODS), required=True)
    parser.add_argument("--setting", choices=sorted(_SIZES), required=True)
    parser.add_argument("--steps", type=int, required=True)
    options = parser.parse_args()
    torch.set_num_threads(1)
    torch.set_num_interop_threads(1)
    step = _METHODS[options.method](synthetic(options.setting))
    for _ in range(max(2, options.steps // 10)):
        step()
    started = time.process_time()
    for _ in range(options.steps):
        step()
    spent = time.process_time() - started
    print(json.dumps({"cpu_s_per_step": spent / options.steps, "steps": options.steps}))


if __name__ == "__main__":
    main()
