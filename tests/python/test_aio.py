"""The asyncio client: the same values and errors as the other one, and nothing that blocks."""

import asyncio
import contextlib
import time
from collections.abc import Callable, Coroutine, Generator
from typing import Any

import numpy as np
import pytest

import palr_gym
from palr_gym import aio, errors
from support.reference import assert_same_bits, random_actions
from support.server_process import running_server


@contextlib.contextmanager
def within(seconds: float) -> Generator[None]:
    start = time.monotonic()
    yield
    elapsed = time.monotonic() - start
    assert elapsed < seconds, f"took {elapsed:.1f} s; expected less than {seconds} s"


async def episode(client: aio.Client, seed: int) -> list[Any]:
    async with await client.open_session("hopper-w2", num_envs=3) as session:
        arrays: list[Any] = [await session.reset(seeds=[seed])]
        for actions in random_actions(0, 60, 3, 3):
            arrays += (await session.step(actions))[:5]
        return arrays


def test_values_are_those_of_the_other_client_even_with_sessions_side_by_side(server: str) -> None:
    async def side_by_side() -> list[list[Any]]:
        async with aio.Client(server) as client:
            return await asyncio.gather(*(episode(client, seed) for seed in range(4)))

    episodes = asyncio.run(side_by_side())
    with palr_gym.Client(server) as client:
        for seed, arrays in enumerate(episodes):
            with client.open_session("hopper-w2", num_envs=3) as session:
                expected: list[Any] = [session.reset(seeds=[seed])]
                for actions in random_actions(0, 60, 3, 3):
                    expected += session.step(actions)[:5]
            for got, want in zip(arrays, expected, strict=True):
                assert_same_bits(got, want)


def test_a_server_describes_itself_and_evaluates_the_same(server: str) -> None:
    async def ask() -> tuple[Any, ...]:
        async with aio.Client(server) as client:
            return (
                await client.server_info(),
                await client.tasks(),
                (await client.spec("ant-w4")).observation_names,
                await client.evaluate("hopper", "random", episodes=7, on_episode=seen.append),
            )

    seen: list[palr_gym.EpisodeResult] = []
    info, tasks, names, evaluation = asyncio.run(ask())
    with palr_gym.Client(server) as client:
        assert info == client.server_info()
        assert tasks == client.tasks()
        assert names == client.spec("ant-w4").observation_names
        assert evaluation.episodes == client.evaluate("hopper", "random", episodes=7).episodes
    assert sorted(seen, key=lambda result: result.index) == list(evaluation.episodes)


def test_steps_of_one_session_from_several_tasks_take_turns(server: str) -> None:
    async def run() -> list[palr_gym.StepResult]:
        async with aio.Client(server) as client, await client.open_session("hopper") as session:
            await session.reset(seeds=[0])
            actions = [np.full((1, 3), value) for value in (0.1, 0.2, 0.3, 0.4)]
            return await asyncio.gather(*(session.step(action) for action in actions))

    results = asyncio.run(run())
    with palr_gym.Client(server).open_session("hopper") as session:
        session.reset(seeds=[0])
        for value, got in zip((0.1, 0.2, 0.3, 0.4), results, strict=True):
            assert_same_bits(got.observations, session.step(np.full((1, 3), value)).observations)


def test_a_final_observation_comes_with_same_step(server: str) -> None:
    async def run() -> Any:
        async with aio.Client(server) as client:
            session = await client.open_session("hopper", autoreset_mode="SameStep")
            await session.reset(seeds=[0])
            while True:
                result = await session.step(np.zeros((1, 3)))
                if result.terminated[0]:
                    await session.close()
                    return result

    result = asyncio.run(run())
    assert result.final_observations.shape == result.observations.shape
    assert not np.array_equal(result.final_observations, result.observations)


def test_snapshots_forks_and_open_loops_are_those_of_the_other_client(server: str) -> None:
    actions = random_actions(3, 24, 2, 3)

    async def run() -> list[Any]:
        async with aio.Client(server) as client:
            session = await client.open_session("hopper-w2", num_envs=2)
            await session.reset(seeds=[5])
            first = await session.step_open_loop(actions[:8])
            snapshot = await session.snapshot()
            fork, standing = await session.fork()
            second = await session.step_open_loop(actions[8:])
            reopened, _ = await client.open_snapshot(snapshot)
            await session.restore(snapshot)
            others = [await one.step_open_loop(actions[8:]) for one in (session, fork, reopened)]
            return [first, standing, second, *others]

    first, standing, second, *others = asyncio.run(run())
    with palr_gym.Client(server).open_session("hopper-w2", num_envs=2) as session:
        session.reset(seeds=[5])
        assert_same_bits(first.observations, session.step_open_loop(actions[:8]).observations)
        assert_same_bits(standing.observations, first.observations[-1])
        expected = session.step_open_loop(actions[8:])
    for result in (second, *others):
        for got, want in zip(result[:5], expected[:5], strict=True):
            assert_same_bits(got, want)


def test_pictures_are_those_of_an_environment(server: str) -> None:
    async def run() -> Any:
        async with aio.Client(server) as client:
            session = await client.open_session(
                "lane", num_envs=2, scene_options={"lead_car_probability": 1.0}
            )
            await session.reset(seeds=[0])
            return await session.render(size=(64, 48))

    frames = asyncio.run(run())
    assert frames.shape == (2, 48, 64, 3)
    env = palr_gym.RemoteEnv(
        "lane",
        server=server,
        render_mode="rgb_array",
        render_size=(64, 48),
        scene_options={"lead_car_probability": 1.0},
    )
    env.reset(seed=1)
    np.testing.assert_array_equal(frames[1], env.render())
    env.close()


Call = Callable[[aio.Client], Coroutine[Any, Any, Any]]


async def step_without_reset(client: aio.Client) -> Any:
    async with await client.open_session("hopper") as session:
        await session.step(np.zeros((1, 3)))


async def step_out_of_bounds(client: aio.Client) -> Any:
    async with await client.open_session("hopper") as session:
        await session.reset(seeds=[0])
        await session.step(np.full((1, 3), 2.0))


async def step_of_another_shape(client: aio.Client) -> Any:
    async with await client.open_session("hopper") as session:
        await session.step(np.zeros((2, 3)))


WRONG: list[tuple[Call, type[Exception], str]] = [
    (lambda client: client.spec("hoper"), errors.NotFound, "did you mean"),
    (lambda client: client.open_session("hopper", num_envs=0), ValueError, "num_envs is 0"),
    (lambda client: client.evaluate("hopper", "gone.onnx"), ValueError, "cannot be read"),
    (step_without_reset, errors.ResetNeeded, "reset them before the first step"),
    (step_out_of_bounds, errors.InvalidArgument, "environment 0 has 2 at index 0"),
    (step_of_another_shape, errors.InvalidArgument, r"shape \[2, 3\]; expected \[1, 3\]"),
]


@pytest.mark.parametrize(("call", "error", "message"), WRONG)
def test_wrong_requests_raise_what_the_other_client_raises(
    call: Call, error: type[Exception], message: str, server: str
) -> None:
    async def run() -> None:
        async with aio.Client(server) as client:
            with pytest.raises(error, match=message):
                await call(client)
            # The client goes on.
            assert await client.tasks()

    asyncio.run(run())


def test_a_refused_step_changes_nothing(server: str) -> None:
    async def run() -> None:
        async with aio.Client(server) as client, await client.open_session("hopper") as session:
            await session.reset(seeds=[0])
            with pytest.raises(errors.InvalidArgument):
                await session.step(np.full((1, 3), 2.0))
            after = await session.step(np.zeros((1, 3)))
            await session.reset(seeds=[0])
            assert_same_bits(after.observations, (await session.step(np.zeros((1, 3))))[0])

    asyncio.run(run())


def test_a_closed_client_or_session_refuses(server: str) -> None:
    async def run() -> None:
        client = aio.Client(server)
        session = await client.open_session("hopper")
        await session.close()
        await session.close()
        with pytest.raises(errors.FailedPrecondition, match="session has been closed"):
            await session.reset()
        await client.close()
        await client.close()
        with pytest.raises(errors.FailedPrecondition, match="client has been closed"):
            await client.tasks()

    asyncio.run(run())


def test_a_killed_server_is_unavailable_in_time_and_a_loop_goes_on_meanwhile() -> None:
    async def run() -> None:
        with running_server() as server:
            async with aio.Client(server.address, deadline_s=20) as client:
                session = await client.open_session("hopper")
                await session.reset(seeds=[0])
                evaluation = asyncio.create_task(
                    client.evaluate("halfcheetah", "random", episodes=100_000, num_envs=64)
                )
                await asyncio.sleep(0.2)
                server.kill()
                with within(5):
                    with pytest.raises(errors.ServerUnavailable, match=server.address):
                        await session.step(np.zeros((1, 3)))
                    with pytest.raises(errors.ServerUnavailable):
                        await evaluation
                    # What became of the step is unknown.
                    with pytest.raises(errors.ResetNeeded):
                        await session.step(np.zeros((1, 3)))
                    with pytest.raises(errors.ServerUnavailable):
                        await session.reset()
                    with pytest.raises(errors.ServerUnavailable, match="palr-gym serve --listen"):
                        await client.tasks()
                    await session.close()

    asyncio.run(run())


def test_a_frozen_server_runs_into_the_deadline_and_recovers() -> None:
    async def run() -> None:
        with running_server() as server:
            async with aio.Client(server.address, deadline_s=1) as client:
                session = await client.open_session("hopper")
                first = await session.reset(seeds=[0])
                server.freeze()
                calls = [session.step(np.zeros((1, 3))), client.tasks(), client.spec("hopper")]
                with within(2.5):
                    for result in await asyncio.gather(*calls, return_exceptions=True):
                        assert isinstance(result, errors.DeadlineExceeded), result
                        assert "within 1 s" in str(result)
                evaluation = client.evaluate("hopper", "random", stall_timeout_s=0.5)
                with within(2.5), pytest.raises(errors.DeadlineExceeded, match=r"within 0\.5 s"):
                    await evaluation
                server.thaw()
                with pytest.raises(errors.ResetNeeded, match="no answer"):
                    await session.step(np.zeros((1, 3)))
                assert_same_bits(await session.reset(seeds=[0]), first)
                await session.step(np.zeros((1, 3)))

    asyncio.run(run())


def test_a_cancelled_step_leaves_a_session_that_wants_a_reset(server: str) -> None:
    async def run() -> None:
        async with (
            aio.Client(server) as client,
            await client.open_session("ant", num_envs=2048) as session,
        ):
            await session.reset(seeds=[0])
            step = asyncio.create_task(session.step(np.zeros((2048, 8))))
            await asyncio.sleep(0)
            await asyncio.sleep(0)
            step.cancel()
            with pytest.raises(asyncio.CancelledError):
                await step
            with pytest.raises(errors.ResetNeeded):
                await session.step(np.zeros((2048, 8)))
            await session.reset(seeds=[0])
            await session.step(np.zeros((2048, 8)))

    asyncio.run(run())
