"""A policy that torch exports is a policy that the server evaluates."""

from pathlib import Path

import numpy as np
import torch

import palr_gym


class Policy(torch.nn.Module):
    """A tanh-Gaussian MLP with the outputs of the policy contract."""

    def __init__(self, observation_size: int, action_size: int) -> None:
        """Random weights."""
        super().__init__()
        self.body = torch.nn.Sequential(
            torch.nn.Linear(observation_size, 64), torch.nn.ReLU(), torch.nn.Linear(64, 64)
        )
        self.mean = torch.nn.Linear(64, action_size)
        self.log_std = torch.nn.Linear(64, action_size)

    def forward(self, observation: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """`[N, observation_size]` -> action, mean, log_std, each `[N, action_size]`."""
        hidden = self.body(observation)
        mean = self.mean(hidden)
        return torch.tanh(mean), mean, self.log_std(hidden).clamp(-20, 2)


def export(policy: Policy, observation_size: int, path: Path) -> None:
    """Writes the policy as ONNX with a dynamic batch."""
    torch.onnx.export(
        policy,
        (torch.zeros(2, observation_size),),
        path,
        input_names=["observation"],
        output_names=["action", "mean", "log_std"],
        dynamic_shapes={"observation": {0: torch.export.Dim("N")}},
        external_data=False,
    )


def test_a_policy_exported_by_torch_acts_on_the_server_as_in_torch(
    server: str, tmp_path: Path
) -> None:
    torch.manual_seed(0)
    policy = Policy(10, 3).eval()
    path = tmp_path / "policy.onnx"
    export(policy, 10, path)
    data = palr_gym.collect("hopper-w2", path, episodes=5, seed=3, server=server)
    with torch.no_grad():
        expected = policy(torch.from_numpy(np.asarray(data.observations)))[0].numpy()
    np.testing.assert_allclose(data.actions, expected, atol=1e-5)
    sampled = palr_gym.evaluate("hopper-w2", path, episodes=5, sampled=True, server=server)
    assert len(sampled.episodes) == 5


def test_a_recording_is_a_torch_data_set() -> None:
    recorded = palr_gym.Recording(
        path="here",
        env_id=None,
        observations=np.arange(8, dtype=np.float32).reshape(4, 2),
        actions=np.array([[0.1], [0.2], [0.3], [0.4]], np.float32),
        rewards=np.zeros(4, np.float32),
        terminals=np.array([False, True, False, False]),
        timeouts=np.zeros(4, bool),
        next_observations=None,
    )
    dataset = recorded.torch()
    assert len(dataset) == 4
    loader = torch.utils.data.DataLoader(dataset, batch_size=4)
    observations, actions, past_actions = next(iter(loader))
    assert torch.equal(observations, torch.arange(8.0).reshape(4, 2))
    assert torch.equal(actions[:, 0], torch.tensor([0.1, 0.2, 0.3, 0.4]))
    assert torch.equal(past_actions[:, 0], torch.tensor([0.0, 0.1, 0.0, 0.3]))
