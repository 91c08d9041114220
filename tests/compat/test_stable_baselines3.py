"""stable-baselines3 takes the environments as they are."""

import gymnasium
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env

import palr_gym  # noqa: F401  (registers the environments)


def test_its_checker_accepts_the_environment(server: str) -> None:
    env = gymnasium.make("palr_gym/hopper-w2-v0", server=server)
    check_env(env, skip_render_check=True)
    env.close()


def test_ppo_learns_on_a_remote_environment(server: str) -> None:
    env = gymnasium.make("palr_gym/hopper-v0", server=server, out_of_bounds="clip")
    model = PPO("MlpPolicy", env, n_steps=256, batch_size=64, seed=0, device="cpu")
    before = [parameter.detach().clone() for parameter in model.policy.parameters()]
    model.learn(1024)
    after = list(model.policy.parameters())
    assert any(not a.equal(b) for a, b in zip(after, before, strict=True))
    env.close()
