"""dm_env_rpc: the protocol's own compliance suite, and dm_env's, against the real server.

Both are the authors' test classes, which only want to be told where the server is.
"""
# The packages of the protocol have no types, so everything of theirs is Any.
# pyright: basic

import contextlib
import json
import unittest
from collections.abc import Callable, Generator, Iterator
from typing import Any

import dm_env
import dm_env.specs
import grpc
import numpy as np
import pytest
from absl.testing import absltest
from dm_env.test_utils import EnvironmentTestMixin
from dm_env_rpc.v1 import dm_env_adaptor, dm_env_rpc_pb2, error, tensor_utils
from dm_env_rpc.v1.compliance import (
    create_destroy_world,
    join_leave_world,
    reset,
    reset_world,
    step,
)
from dm_env_rpc.v1.connection import Connection as _Connection

from support.reference import TASKS, assert_same_bits, gymnasium_env, random_actions

wire: Any = dm_env_rpc_pb2
Connection = Any

# The environments are held against -v4 on purpose.
pytestmark = pytest.mark.filterwarnings("ignore:.*is out of date:DeprecationWarning")


@contextlib.contextmanager
def connected(server: str) -> Generator[Any]:
    with grpc.insecure_channel(server) as channel, _Connection(channel) as connection:
        yield connection


def settings(**values: Any) -> dict[str, Any]:
    return {name: tensor_utils.pack_tensor(value) for name, value in values.items()}


def create(connection: Connection, **values: Any) -> str:
    request = wire.CreateWorldRequest(settings=settings(**values))
    return connection.send(request).world_name


def join(connection: Connection, world_name: str) -> Any:
    return connection.send(wire.JoinWorldRequest(world_name=world_name)).specs


class _Base(absltest.TestCase):
    """A connection of its own, and a world on request, for each test of a suite."""

    # Pytest shall take them from CASES, once for each task.
    __test__ = False
    server: str
    env_id: str

    def setUp(self) -> None:
        super().setUp()
        self._cleanup = contextlib.ExitStack()
        self._connection = self._cleanup.enter_context(connected(self.server))
        self._world_name: str | None = None

    def tearDown(self) -> None:
        super().tearDown()
        self._connection.send(wire.LeaveWorldRequest())
        if self._world_name is not None:
            request = wire.DestroyWorldRequest(world_name=self._world_name)
            self._connection.send(request)
        self._cleanup.close()

    @property
    def connection(self) -> Connection:
        return self._connection

    @property
    def world_name(self) -> str:
        if self._world_name is None:
            self._world_name = create(self._connection, env_id=self.env_id)
        return self._world_name


class CreateDestroyWorld(_Base, create_destroy_world.CreateDestroyWorld):
    """Worlds come and go."""

    @property
    def required_world_settings(self) -> Any:
        return settings(env_id=self.env_id)

    @property
    def invalid_world_settings(self) -> Any:
        return settings(players=2, seed=-1, args="no JSON")

    @property
    def has_multiple_world_support(self) -> bool:
        return True


class JoinLeaveWorld(_Base, join_leave_world.JoinLeaveWorld):
    """Connections come and go."""

    @property
    def invalid_join_settings(self) -> Any:
        return settings(players=2, seed="zero")

    def tearDown(self) -> None:
        # The suite leaves the world itself, but only with a connection that still works.
        join_leave_world.JoinLeaveWorld.tearDown(self)


class Reset(_Base, reset.Reset):
    """A connection starts anew."""

    def join_world(self) -> Any:
        return join(self.connection, self.world_name)


class ResetWorld(_Base, reset_world.ResetWorld):
    """A world starts anew."""


class Step(_Base, step.Step):
    """Actions and observations."""

    def setUp(self) -> None:
        super().setUp()
        self._specs = join(self.connection, self.world_name)

    @property
    def specs(self) -> Any:
        return self._specs


class DmEnv(EnvironmentTestMixin, _Base):
    """dm_env's contract of an environment, over the adaptor."""

    def make_object_under_test(self) -> Any:
        return dm_env_adaptor.join_world(self.connection, self.world_name, {})

    def make_action_sequence(self) -> Iterator[Any]:
        # Hoppers and walkers fall, many times over.
        generator = np.random.default_rng(0)
        spec = self.environment.action_spec()["action"]
        for _ in range(150):
            yield {"action": generator.uniform(-1, 1, spec.shape).astype(np.float32)}


SUITES = (CreateDestroyWorld, JoinLeaveWorld, Reset, ResetWorld, Step, DmEnv)
CASES = [
    (suite, name) for suite in SUITES for name in unittest.TestLoader().getTestCaseNames(suite)
]


def test_the_suites_are_whole() -> None:
    counts = {suite.__name__: sum(owner is suite for owner, _ in CASES) for suite in SUITES}
    assert counts == {
        "CreateDestroyWorld": 5,
        "JoinLeaveWorld": 11,
        "Reset": 3,
        "ResetWorld": 3,
        "Step": 18,
        "DmEnv": 4,
    }


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize(
    ("suite", "name"), CASES, ids=lambda value: getattr(value, "__name__", value)
)
def test_compliance(suite: type[_Base], name: str, task: str, server: str) -> None:
    bound = type(suite.__name__, (suite,), {"server": server, "env_id": f"{task}-w2"})
    result = unittest.TestResult()
    bound(name).run(result)
    assert result.testsRun == 1
    problems = [text for _, text in [*result.errors, *result.failures]]
    assert not problems, problems[0]


@pytest.mark.parametrize("task", TASKS)
def test_an_episode_equals_gymnasiums_to_the_bit(task: str, server: str) -> None:
    reference: Any = gymnasium_env(task).unwrapped
    size = reference.action_space.shape[0]
    with connected(server) as connection:
        world = create(connection, env_id=task, seed=11)
        env = dm_env_adaptor.join_world(connection, world, {})
        first = env.reset()
        assert first.first()
        assert_same_bits(first.observation["observation"], reference.reset(seed=11)[0])
        for action in random_actions(0, 300, 1, size)[:, 0]:
            timestep = env.step({"action": action})
            observation, reward, terminated, _, _ = reference.step(action)
            assert_same_bits(timestep.observation["observation"], observation)
            assert timestep.reward == reward
            assert timestep.last() == terminated
            assert timestep.discount == (0.0 if terminated else 1.0)
            if terminated:
                assert env.step({"action": action}).first()
                assert_same_bits(
                    env.step({"action": action}).observation["observation"],
                    (reference.reset(), reference.step(action))[1][0],
                )
                break
        env.close()
        connection.send(wire.DestroyWorldRequest(world_name=world))
    reference.close()


def test_the_time_limit_interrupts_and_the_next_step_begins_anew(server: str) -> None:
    with connected(server) as connection:
        env, _ = dm_env_adaptor.create_and_join_world(connection, {"env_id": "halfcheetah"}, {})
        env.reset()
        action = {"action": np.zeros(6, dtype=np.float32)}
        steps = [env.step(action) for _ in range(1000)]
        assert [timestep.last() for timestep in steps] == [False] * 999 + [True]
        assert steps[-1].discount == 1.0
        assert env.step(action).step_type is dm_env.StepType.FIRST
        env.close()


def test_seeds_are_those_of_the_world_the_join_or_the_reset(server: str) -> None:
    def first(connection: Connection) -> Any:
        request = wire.StepRequest(requested_observations=[1])
        return tensor_utils.unpack_tensor(connection.send(request).observations[1])

    def reference(seed: int) -> Any:
        with gymnasium_env("hopper") as env:
            return env.reset(seed=seed)[0]

    with connected(server) as connection:
        world = create(connection, env_id="hopper", seed=1)
        join(connection, world)
        assert_same_bits(first(connection), reference(1))
        connection.send(wire.ResetRequest(settings=settings(seed=2)))
        assert_same_bits(first(connection), reference(2))
        connection.send(wire.ResetWorldRequest(world_name=world, settings=settings(seed=3)))
        state = connection.send(wire.StepRequest()).state
        assert state == wire.EnvironmentStateType.INTERRUPTED
        assert_same_bits(first(connection), reference(3))
        connection.send(wire.LeaveWorldRequest())
        connection.send(wire.JoinWorldRequest(world_name=world, settings=settings(seed=4)))
        assert_same_bits(first(connection), reference(4))


def test_remote_gyms_settings_are_taken(server: str) -> None:
    # What remote_gym.RemoteEnvironment sends (0.7.3): its arguments as JSON in one setting.
    arguments = {"entrypoint": "hopper-w2", "entrypoint_kwargs": {"seed": 7}}
    with connected(server) as connection:
        env, _ = dm_env_adaptor.create_and_join_world(
            connection, {"args": json.dumps(arguments)}, {}
        )
        # It makes spaces from bounded specs only.
        observation_spec = env.observation_spec()["observation"]
        assert isinstance(observation_spec, dm_env.specs.BoundedArray)
        assert observation_spec.shape == (10,)
        assert env.reset().observation["observation"].shape == (10,)
        env.close()


Call = Callable[[Connection], Any]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda c: create(c, env_id="hoper"), "did you mean"),
        (
            lambda c: create(c, args='{"repo": "https://example.org/x.git"}'),
            "runs no code of yours",
        ),
        (lambda c: join(c, "nowhere"), "not found: it was destroyed"),
        (lambda c: c.send(wire.StepRequest()), "join one before step"),
    ],
)
def test_errors_say_what_is_wrong(call: Call, message: str, server: str) -> None:
    with connected(server) as connection:
        with pytest.raises(error.DmEnvRpcError, match=message):
            call(connection)
        # The stream goes on.
        assert create(connection, env_id="hopper")
