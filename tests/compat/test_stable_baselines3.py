"""stable-baselines3 takes the environments as they are."""

import gymnasium
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor

import palr_gym  # noqa: F401  (registers the environments)


def test_its_checker_accepts_the_environment(server: str) -> None:
    env = gymnasium.make("palr_gym/hopper-w2-v0", server=server)
    check_env(env, skip_render_check=True)
    env.close()


def test_ppo_trains_on_a_remote_environment_and_is_evaluated_on_one(server: str) -> None:
    env = gymnasium.make("palr_gym/hopper-v0", server=server, out_of_bounds="clip")
    model = PPO("MlpPolicy", env, n_steps=256, batch_size=64, seed=0, device="cpu")
    before = [parameter.detach().clone() for parameter in model.policy.parameters()]
    model.learn(4096)
    after = list(model.policy.parameters())
    assert any(not a.equal(b) for a, b in zip(after, before, strict=True))
    env.close()

    def evaluated() -> tuple[list[float], list[int]]:
        held_out = Monitor(
            gymnasium.make("palr_gym/hopper-v0", server=server, out_of_bounds="clip")
        )
        held_out.reset(seed=7)
        results = evaluate_policy(model, held_out, n_eval_episodes=5, return_episode_rewards=True)
        held_out.close()
        return results

    returns, lengths = evaluated()
    assert len(returns) == 5
    assert all(1 <= length <= 1000 for length in lengths)
    assert min(returns) > 0
    # The policy is deterministic, and so are the environments.
    assert evaluated()[0][0] == returns[0]
