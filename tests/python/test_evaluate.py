"""Server-side evaluation: the episodes are real, and the summary says what they say."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import palr_gym
from palr_gym import Client, EpisodeResult, Evaluation
from support import onnx_policies
from support.reference import TASKS, gymnasium_env, normalized_score

pytestmark = pytest.mark.filterwarnings("ignore:.*is out of date:DeprecationWarning")


def check_summary(evaluation: Evaluation, task: str, episodes: int, seed: int) -> None:
    """Every number of the summary follows from the episodes, by formulas of the test's own."""
    results = evaluation.episodes
    assert [result.index for result in results] == list(range(episodes))
    assert [result.seed for result in results] == list(range(seed, seed + episodes))
    for result in results:
        expected = normalized_score(task, result.episode_return)
        assert result.normalized_score == pytest.approx(expected, rel=1e-12)
        assert 1 <= result.length <= 1000
        assert result.terminated or result.truncated
        assert result.truncated == (result.length == 1000)

    returns = np.array([result.episode_return for result in results])
    scores = np.array([result.normalized_score for result in results])
    lengths = np.array([result.length for result in results])
    # Each value four times, so that a quarter of them is a whole number.
    middle = np.sort(np.repeat(scores, 4))[episodes : 3 * episodes]
    expected_summary = {
        "return_mean": returns.mean(),
        "return_standard_error": returns.std(ddof=1) / math.sqrt(episodes),
        "score_mean": scores.mean(),
        "score_standard_error": scores.std(ddof=1) / math.sqrt(episodes),
        "score_interquartile_mean": middle.mean(),
        "length_mean": lengths.mean(),
    }
    for name, expected in expected_summary.items():
        assert getattr(evaluation, name) == pytest.approx(expected, rel=1e-9), name
    low, high = evaluation.score_interquartile_mean_low, evaluation.score_interquartile_mean_high
    assert scores.min() <= low <= evaluation.score_interquartile_mean <= high <= scores.max()
    assert evaluation.steps == lengths.sum()
    assert evaluation.wall_time_s > 0
    assert evaluation.steps_per_s == evaluation.steps / evaluation.wall_time_s


def test_the_expert_scores_about_100_on_hopper(client: Client) -> None:
    evaluation = client.evaluate("hopper", "expert", episodes=5)
    assert evaluation.score_mean > 90
    check_summary(evaluation, "hopper", 5, 0)


def test_the_expert_sees_the_full_observation_whatever_the_environment_shows(
    client: Client,
) -> None:
    seen, hidden = (
        client.evaluate(env_id, "expert", episodes=3, seed=7, num_envs=3)
        for env_id in ("hopper", "hopper-strict-w3")
    )
    assert seen.episodes == hidden.episodes


@pytest.mark.parametrize("task", TASKS)
def test_the_random_policy_scores_about_0(task: str, client: Client) -> None:
    evaluation = client.evaluate(task, "random", episodes=40, seed=1000)
    check_summary(evaluation, task, 40, 1000)
    # D4RL's random returns are means over episodes of the same policy; one episode deviates from
    # them by much less than a tenth of the way to the expert (ant's by more: its random returns
    # are those of an older MuJoCo).
    assert abs(evaluation.score_mean) < (10 if task == "ant" else 4)
    assert len({result.episode_return for result in evaluation.episodes}) == 40


def gymnasium_return(
    task: str, indices: list[int], weights: NDArray[np.float32], seed: int
) -> tuple[float, int]:
    """Return and length of an episode of action = tanh(observation @ weights) in Gymnasium."""
    episode_return, length, has_ended = 0.0, 0, False
    with gymnasium_env(task) as env:
        observation, _ = env.reset(seed=seed)
        while not has_ended:
            seen = observation[indices].astype(np.float32)
            observation, reward, terminated, truncated, _ = env.step(np.tanh(seen @ weights))
            episode_return += float(reward)
            length += 1
            has_ended = terminated or truncated
    return episode_return, length


def test_a_policy_of_our_own_returns_what_it_returns_in_gymnasium(client: Client) -> None:
    # Weights so large that tanh gives -1, 0 or 1 exactly: no rounding of float32 can tell two
    # implementations of the product apart, and a chaotic task cannot blow a difference up.
    weights = np.zeros((10, 3), dtype=np.float32)
    weights[[5, 6, 7], [0, 1, 2]] = [1e6, -1e6, 1e6]
    evaluation = client.evaluate(
        "hopper-w2", onnx_policies.linear_policy(weights), episodes=6, seed=50
    )
    check_summary(evaluation, "hopper", 6, 50)
    for result in evaluation.episodes:
        # The newer half of the stack is the present observation.
        expected_return, length = gymnasium_return(
            "hopper", [0, 1, 2, 3, 4], weights[5:], result.seed
        )
        assert result.length == length
        assert result.episode_return == pytest.approx(expected_return, rel=1e-12)


@pytest.mark.parametrize("policy", ["random", "expert"])
def test_equal_requests_give_equal_episodes(policy: str, client: Client) -> None:
    first, second = (
        client.evaluate(
            "hopper", policy, episodes=6, seed=3, num_envs=4, sampled=policy != "random"
        )
        for _ in range(2)
    )
    assert replace(first, wall_time_s=0) == replace(second, wall_time_s=0)


def test_random_episodes_do_not_depend_on_how_many_run_side_by_side(client: Client) -> None:
    evaluations = [
        client.evaluate("walker2d", "random", episodes=12, seed=9, num_envs=num_envs)
        for num_envs in (1, 5, 12)
    ]
    assert [evaluation.num_envs for evaluation in evaluations] == [1, 5, 12]
    assert evaluations[0].episodes == evaluations[1].episodes == evaluations[2].episodes


def test_sampled_actions_differ_from_deterministic_ones_and_still_score(client: Client) -> None:
    deterministic, sampled = (
        client.evaluate("hopper", "expert", episodes=5, sampled=is_sampled)
        for is_sampled in (False, True)
    )
    assert deterministic.episodes != sampled.episodes
    assert sampled.score_mean > 60


def test_episodes_are_reported_as_they_end(client: Client) -> None:
    reported: list[EpisodeResult] = []
    evaluation = client.evaluate("hopper", "random", episodes=30, on_episode=reported.append)
    assert sorted(reported, key=lambda result: result.index) == list(evaluation.episodes)


def test_an_evaluation_prints_as_a_line(client: Client) -> None:
    evaluation = client.evaluate("hopper-w2", "random", episodes=3)
    line = str(evaluation)
    assert "\n" not in line
    for part in ("hopper-w2: ", f"{evaluation.score_mean:.1f} ± ", "of 3 episodes"):
        assert part in line


def test_the_standard_error_of_a_single_episode_is_nan(client: Client) -> None:
    evaluation = client.evaluate("hopper", "random", episodes=1)
    assert math.isnan(evaluation.return_standard_error)
    assert math.isnan(evaluation.score_standard_error)


def test_the_function_without_a_client_does_the_same(server: str, client: Client) -> None:
    by_function = palr_gym.evaluate("hopper", "random", episodes=4, seed=2, server=server)
    by_client = client.evaluate("hopper", "random", episodes=4, seed=2)
    assert by_function.episodes == by_client.episodes


def test_tasks_and_specs_state_the_reference_returns_of_d4rl(client: Client) -> None:
    tasks = {task.name: task for task in client.tasks()}
    for name in TASKS:
        task = tasks[name]
        for returns in (task.reference_returns, client.spec(task.name).reference_returns):
            assert returns.normalized_score(123.0) == normalized_score(task.name, 123.0)
