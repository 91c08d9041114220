"""A loop in CleanRL's manner (one file, one function, Gymnasium's vector interface) as it is.

Nothing in it knows of palr-gym but the id and the `server` argument.
"""

import gymnasium
import numpy as np
import torch
from torch import nn
from torch.distributions.normal import Normal

import palr_gym  # noqa: F401  (registers the environments)

NUM_ENVS, NUM_STEPS, ITERATIONS = 8, 128, 8
EPOCHS, MINIBATCHES = 4, 4
GAMMA, GAE_LAMBDA, CLIP = 0.99, 0.95, 0.2


def layer(inputs: int, outputs: int, gain: float = 2**0.5) -> nn.Linear:
    linear = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(linear.weight, gain)
    nn.init.constant_(linear.bias, 0.0)
    return linear


class Agent(nn.Module):
    """Actor and critic."""

    def __init__(self, observation_size: int, action_size: int) -> None:
        """Orthogonal weights."""
        super().__init__()
        self.critic = nn.Sequential(
            layer(observation_size, 64), nn.Tanh(), layer(64, 64), nn.Tanh(), layer(64, 1, 1.0)
        )
        self.mean = nn.Sequential(
            layer(observation_size, 64),
            nn.Tanh(),
            layer(64, 64),
            nn.Tanh(),
            layer(64, action_size, 0.01),
        )
        self.log_std = nn.Parameter(torch.zeros(action_size))

    def act(
        self, observation: torch.Tensor, action: torch.Tensor | None = None
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Action, log-probability, value."""
        mean = self.mean(observation)
        distribution = Normal(mean, self.log_std.exp().expand_as(mean))
        action = distribution.sample() if action is None else action
        return action, distribution.log_prob(action).sum(1), self.critic(observation).flatten()


def train(envs: gymnasium.vector.VectorEnv, agent: Agent) -> list[float]:
    """PPO; returns of the finished episodes, in order."""
    optimizer = torch.optim.Adam(agent.parameters(), lr=1e-3, eps=1e-5)
    returns: list[float] = []
    observation = torch.from_numpy(envs.reset(seed=1)[0]).float()
    is_done = torch.zeros(NUM_ENVS)
    shape = (NUM_STEPS, NUM_ENVS)
    observations = torch.zeros(*shape, *envs.single_observation_space.shape)
    actions = torch.zeros(*shape, *envs.single_action_space.shape)
    log_probs, rewards, dones, values = (torch.zeros(shape) for _ in range(4))
    for _ in range(ITERATIONS):
        for step in range(NUM_STEPS):
            observations[step], dones[step] = observation, is_done
            with torch.no_grad():
                actions[step], log_probs[step], values[step] = agent.act(observation)
            result = envs.step(actions[step].numpy())
            rewards[step] = torch.from_numpy(result[1])
            observation = torch.from_numpy(result[0]).float()
            is_done = torch.from_numpy(np.logical_or(result[2], result[3])).float()
            if "episode" in result[4]:
                finished = result[4]["_episode"]
                returns += [float(r) for r in result[4]["episode"]["r"][finished]]
        with torch.no_grad():
            next_value = agent.critic(observation).flatten()
            advantages = torch.zeros(shape)
            last = torch.zeros(NUM_ENVS)
            for step in reversed(range(NUM_STEPS)):
                after = step + 1
                alive = 1 - (is_done if after == NUM_STEPS else dones[after])
                value = next_value if after == NUM_STEPS else values[after]
                delta = rewards[step] + GAMMA * value * alive - values[step]
                last = delta + GAMMA * GAE_LAMBDA * alive * last
                advantages[step] = last
            targets = advantages + values
        flat = [t.flatten(0, 1) for t in (observations, actions, log_probs, advantages, targets)]
        for _ in range(EPOCHS):
            for rows in torch.randperm(NUM_STEPS * NUM_ENVS).chunk(MINIBATCHES):
                obs, act, old, advantage, target = (t[rows] for t in flat)
                _, new, value = agent.act(obs, act)
                ratio = (new - old).exp()
                advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
                clipped = ratio.clamp(1 - CLIP, 1 + CLIP)
                policy_loss = -torch.min(advantage * ratio, advantage * clipped).mean()
                loss = policy_loss + 0.25 * ((value - target) ** 2).mean()
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
                optimizer.step()
    return returns


def test_a_single_file_ppo_trains_on_remote_vector_environments(server: str) -> None:
    torch.manual_seed(1)
    envs = gymnasium.make_vec(
        "palr_gym/hopper-v0", num_envs=NUM_ENVS, server=server, out_of_bounds="clip"
    )
    envs = gymnasium.wrappers.vector.RecordEpisodeStatistics(envs)
    agent = Agent(11, 3)
    returns = train(envs, agent)
    envs.close()
    assert len(returns) > 100
    # Same seeds, same bits: this is no matter of luck.
    early, late = np.mean(returns[:50]), np.mean(returns[-50:])
    assert late > 1.3 * early, f"returns went from {early:.1f} to {late:.1f}"
