"""Wrong input gets one clear, typed error, and harms nobody else."""

import contextlib
import re
from collections.abc import Callable, Generator
from typing import Any

import grpc
import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import palr_gym
from palr_gym import Client, errors
from palr_gym._proto.palr_gym.v1 import environment_service_pb2, tensor_pb2
from support import onnx_policies
from support.reference import assert_same_bits, gymnasium_vector_env, random_actions

pytestmark = pytest.mark.filterwarnings("ignore:.*is out of date:DeprecationWarning")


@contextlib.contextmanager
def unharmed_bystander(server: str) -> Generator[None]:
    """Another session of the same server, which goes on as if nothing had happened."""
    actions = random_actions(1, 60, 3, 3)
    theirs = gymnasium_vector_env("hopper", 3)
    with palr_gym.make_vec("hopper", 3, server=server) as ours:
        assert_same_bits(ours.reset(seed=1)[0], theirs.reset(seed=1)[0])
        for step, action in enumerate(actions):
            if step == len(actions) // 2:
                yield
            got, expected = ours.step(action), theirs.step(action)
            for ours_array, theirs_array in zip(got[:4], expected[:4], strict=True):
                assert_same_bits(ours_array, theirs_array)


def check(
    server: str,
    wrong: Callable[[Client], object],
    expected: type[errors.PalrGymError],
    reason: str,
    *texts: str,
) -> errors.PalrGymError:
    """`wrong` raises exactly `expected` for `reason`, and its message holds every one of `texts`.

    Afterwards the server answers, and another session is where it was.
    """
    with unharmed_bystander(server), Client(server, deadline_s=20) as client:
        with pytest.raises(errors.PalrGymError) as caught:
            wrong(client)
        assert client.server_info().version
    error = caught.value
    assert type(error) is expected, f"{error!r}"
    assert error.reason == reason, f"{error!r}"
    for text in (*texts, server):
        assert text in str(error), f"{text!r} is not in {error}"
    return error


@pytest.mark.parametrize("use", ["spec", "open_session", "evaluate", "collect"])
@pytest.mark.parametrize(
    ("env_id", "expected", "reason", "texts"),
    [
        ("hoper", errors.NotFound, "UNKNOWN_TASK", ["'hoper'", "hopper", "walker2d"]),
        ("humanoid-w2", errors.NotFound, "UNKNOWN_TASK", ["humanoid", "halfcheetah", "ant"]),
        ("hopper-blurred", errors.InvalidArgument, "INVALID_ENV_ID", ["blurred", "-strict"]),
        ("hopper-w2-v7", errors.InvalidArgument, "INVALID_ENV_ID", ["v7", "v0"]),
        ("hopper-w0", errors.InvalidArgument, "INVALID_ENV_ID", ["of 0", "1 to 64"]),
        ("hopper-w10000", errors.InvalidArgument, "INVALID_ENV_ID", ["10000", "1 to 64"]),
        ("", errors.InvalidArgument, "INVALID_ENV_ID", ["no task", "hopper-w2"]),
    ],
)
def test_an_unknown_task_mask_version_or_stack_is_refused(
    env_id: str,
    expected: type[errors.PalrGymError],
    reason: str,
    texts: list[str],
    use: str,
    server: str,
) -> None:
    def wrong(client: Client) -> object:
        match use:
            case "evaluate":
                return client.evaluate(env_id, "random", episodes=1)
            case "collect":
                return client.collect(env_id, "random", episodes=1)
            case _:
                return getattr(client, use)(env_id)

    # Rust and Python quote differently.
    plain_texts = [text.replace("'", "") for text in texts]
    check(server, wrong, expected, reason, *plain_texts)


@pytest.mark.parametrize("num_envs", [0, 1_000_000])
def test_too_few_or_too_many_environments_are_refused(num_envs: int, server: str) -> None:
    check(
        server,
        lambda client: client.open_session("hopper", num_envs=num_envs),
        errors.InvalidArgument,
        "NUM_ENVS",
        str(num_envs),
        "expected 1 to",
    )


@pytest.mark.parametrize("num_envs", [-1, 2**32, 1.5, "four", None])
def test_numbers_that_the_wire_cannot_carry_are_refused_by_the_client(
    num_envs: Any, client: Client
) -> None:
    with pytest.raises(errors.InvalidArgument, match=re.escape(f"num_envs is {num_envs!r}")):
        client.open_session("hopper", num_envs=num_envs)


def step_with(actions: Any, **options: Any) -> Callable[[Client], object]:
    """Opens two hoppers and steps them with `actions`."""

    def wrong(client: Client) -> object:
        with client.open_session("hopper", num_envs=2, **options) as session:
            session.reset(seeds=[0])
            return session.step(actions)

    return wrong


@pytest.mark.parametrize("shape", [(3,), (2, 4), (3, 3), (2, 3, 1), (0, 3), ()])
def test_actions_of_the_wrong_shape_are_refused(shape: tuple[int, ...], server: str) -> None:
    found = str(list(shape))
    wrong = step_with(np.zeros(shape))
    check(server, wrong, errors.InvalidArgument, "ACTION_SHAPE", found, "[2, 3]")


def test_actions_beyond_the_limit_of_a_message_are_refused(server: str) -> None:
    with Client(server) as client:
        limit = client.server_info().limits.max_message_bytes
    check(server, step_with(np.zeros((limit, 3))), errors.InvalidArgument, "", str(limit))


def test_an_action_with_nan_is_refused_whatever_the_session_allows(server: str) -> None:
    actions = np.zeros((2, 3))
    actions[1, 2] = np.nan
    for out_of_bounds in ("reject", "clip", "raw"):
        wrong = step_with(actions, out_of_bounds=out_of_bounds)
        texts = ("environment 1", "NaN", "index 2")
        check(server, wrong, errors.InvalidArgument, "ACTION_NAN", *texts)


@pytest.mark.parametrize("value", [1.5, -1.0000001, np.inf])
def test_an_action_out_of_bounds_is_refused(value: float, server: str) -> None:
    actions = np.zeros((2, 3))
    actions[1, 0] = value
    texts = ("environment 1", f"{value}".removesuffix(".0"), "index 0", "[-1, 1]")
    check(server, step_with(actions), errors.InvalidArgument, "ACTION_OUT_OF_BOUNDS", *texts)


def test_actions_that_are_no_numbers_are_refused_by_the_client(client: Client) -> None:
    for actions in ("left", [[1, 2, 3], [1, 2]], {"a": 1}):
        with pytest.raises(errors.InvalidArgument, match=re.escape("shape [2, 3]")):
            step_with(actions)(client)


def raw_step(server: str, session_id: str, **tensor: Any) -> None:
    """Sends a step as any client in any language could."""
    with grpc.insecure_channel(server) as channel:
        call = channel.unary_unary(
            "/palr_gym.v1.EnvironmentService/Step",
            request_serializer=environment_service_pb2.StepRequest.SerializeToString,
            response_deserializer=environment_service_pb2.StepResponse.FromString,
        )
        actions = tensor_pb2.Tensor(**tensor)
        request = environment_service_pb2.StepRequest(session_id=session_id, actions=actions)
        try:
            call(request, timeout=20)
        except grpc.RpcError as error:
            raise errors.from_rpc_error(error, asked="stepping", server=server) from None


@pytest.mark.parametrize(
    ("tensor", "reason", "texts"),
    [
        ({"dtype": 2, "shape": [2, 3], "data": bytes(48)}, "ACTION_DTYPE", ["64", "float32"]),
        ({"dtype": 0, "shape": [2, 3], "data": bytes(24)}, "ACTION_DTYPE", ["float32"]),
        ({"dtype": 99, "shape": [2, 3], "data": bytes(24)}, "ACTION_DTYPE", ["99", "float32"]),
        ({"dtype": 1, "shape": [2, 3], "data": bytes(23)}, "ACTION_SHAPE", ["23", "24"]),
        ({"dtype": 1, "shape": [2, 3], "data": b""}, "ACTION_SHAPE", ["[2, 3]"]),
        ({"dtype": 1, "shape": [-2, -3], "data": bytes(24)}, "ACTION_SHAPE", ["[-2, -3]"]),
        ({"dtype": 1, "shape": [2**62, 4], "data": bytes(24)}, "ACTION_SHAPE", [str(2**62)]),
        ({"dtype": 1, "shape": [], "data": bytes(24)}, "ACTION_SHAPE", ["[]"]),
    ],
)
def test_a_malformed_tensor_is_refused(
    tensor: dict[str, Any], reason: str, texts: list[str], server: str
) -> None:
    def wrong(client: Client) -> None:
        with client.open_session("hopper", num_envs=2) as session:
            session.reset(seeds=[0])
            raw_step(server, session.session_id, **tensor)

    check(server, wrong, errors.InvalidArgument, reason, *texts)


def test_a_refused_step_changes_nothing(server: str) -> None:
    theirs = gymnasium_vector_env("hopper", 2)
    with palr_gym.make_vec("hopper", 2, server=server) as ours:
        ours.reset(seed=0)
        theirs.reset(seed=0)
        for action in random_actions(0, 60, 2, 3):
            for wrong in (action * np.nan, action + 2, action[:1]):
                with pytest.raises(errors.InvalidArgument):
                    ours.step(wrong)
            got, expected = ours.step(action), theirs.step(action)
            for ours_array, theirs_array in zip(got[:4], expected[:4], strict=True):
                assert_same_bits(ours_array, theirs_array)


@pytest.mark.parametrize("seeds", [[1, 2], [1, 2, 3, 4]])
def test_seeds_of_the_wrong_count_are_refused(seeds: list[int], server: str) -> None:
    def by_session(client: Client) -> object:
        return client.open_session("hopper", num_envs=3).reset(seeds=seeds)

    check(server, by_session, errors.InvalidArgument, "SEED_COUNT", str(len(seeds)), "3")
    with (
        palr_gym.make_vec("hopper", 3, server=server) as envs,
        pytest.raises(errors.InvalidArgument, match=f"{len(seeds)} seeds"),
    ):
        envs.reset(seed=seeds)


def test_one_seed_in_a_list_is_not_taken_for_a_first_seed(server: str) -> None:
    with (
        palr_gym.make_vec("hopper", 3, server=server) as envs,
        pytest.raises(errors.InvalidArgument, match="1 seeds"),
    ):
        envs.reset(seed=[1])


@pytest.mark.parametrize("seed", [-1, 2**64, 0.5, "zero"])
def test_a_seed_that_is_none_is_refused(seed: Any, server: str) -> None:
    with (
        palr_gym.make("hopper", server=server) as env,
        pytest.raises(errors.InvalidArgument, match=re.escape(f"seed is {seed!r}")),
    ):
        env.reset(seed=seed)


@pytest.mark.parametrize("indices", [[3], [1, 1], [2, 0]])
def test_indices_of_environments_that_are_wrong_are_refused(
    indices: list[int], server: str
) -> None:
    def wrong(client: Client) -> object:
        return client.open_session("hopper", num_envs=3).reset(env_indices=indices)

    check(server, wrong, errors.InvalidArgument, "ENV_INDEX", str(indices[-1]), "3")


@pytest.mark.parametrize(
    ("mask", "expected"),
    [
        ([True, False], TypeError),
        (np.array([1, 0]), TypeError),
        (np.array([True]), ValueError),
        (np.array([False, False]), ValueError),
    ],
)
def test_a_wrong_reset_mask_is_refused_as_gymnasium_refuses_it(
    mask: Any, expected: type[Exception], server: str
) -> None:
    theirs = gymnasium_vector_env("hopper", 2, AutoresetMode.DISABLED)
    with palr_gym.make_vec("hopper", 2, server=server, autoreset_mode="Disabled") as ours:
        for envs in (ours, theirs):
            envs.reset(seed=0)
            with pytest.raises(expected, match="reset_mask"):
                envs.reset(options={"reset_mask": mask})


def test_a_step_before_the_first_reset_is_refused(server: str) -> None:
    def by_session(client: Client) -> object:
        return client.open_session("hopper").step(np.zeros((1, 3)))

    check(server, by_session, errors.ResetNeeded, "RESET_NEEDED", "reset")
    with (
        palr_gym.make("hopper", server=server) as env,
        palr_gym.make_vec("hopper", 2, server=server) as envs,
    ):
        for step in (lambda: env.step(np.zeros(3)), lambda: envs.step(np.zeros((2, 3)))):
            with pytest.raises(gymnasium.error.ResetNeeded):
                step()


def test_a_step_after_the_end_of_an_episode_is_refused(server: str) -> None:
    with palr_gym.make("hopper", server=server) as env:
        env.reset(seed=0)
        while not env.step(np.ones(3))[2]:
            pass
        # The client knows it without asking the server.
        with pytest.raises(gymnasium.error.ResetNeeded, match="no episode is under way"):
            env.step(np.ones(3))
        env.reset()
        env.step(np.ones(3))


def test_a_step_with_an_ended_environment_is_refused_without_autoreset(server: str) -> None:
    with palr_gym.make_vec("hopper", 2, server=server, autoreset_mode="Disabled") as envs:
        envs.reset(seed=0)
        actions = np.array([[1.0, 1, 1], [0, 0, 0]])
        ended = np.zeros(2, dtype=bool)
        while not ended.any():
            ended = envs.step(actions)[2]
        with pytest.raises(errors.ResetNeeded, match=f"environment {np.argmax(ended)}"):
            envs.step(actions)
        envs.reset(options={"reset_mask": ended})
        envs.step(actions)


def test_an_unknown_session_is_not_found(server: str) -> None:
    for session_id in ("", "nonsense", "00000000-0000-4000-8000-000000000000"):
        tensor = {"dtype": 1, "shape": [1, 3], "data": bytes(12)}

        def wrong(_: Client, session_id: str = session_id, tensor: Any = tensor) -> None:
            raw_step(server, session_id, **tensor)

        check(server, wrong, errors.NotFound, "SESSION_NOT_FOUND", f'"{session_id}"')


def test_a_closed_session_is_not_found(server: str) -> None:
    def wrong(client: Client) -> object:
        session = client.open_session("hopper")
        session.reset()
        session.close()
        session.close()
        return session.step(np.zeros((1, 3)))

    check(server, wrong, errors.NotFound, "SESSION_NOT_FOUND", "closed")


@pytest.mark.parametrize("options", [{"out_of_bounds": "wrap"}, {"autoreset_mode": "Sometimes"}])
def test_options_that_do_not_exist_are_refused_by_the_client(
    options: dict[str, Any], client: Client
) -> None:
    [(name, value)] = options.items()
    with pytest.raises(errors.InvalidArgument, match=f"{name} is {value!r}; expected one of"):
        client.open_session("hopper", **options)


BAD_POLICIES: list[tuple[str, bytes, str, list[str]]] = [
    ("not ONNX", b"import os", "POLICY_NOT_ONNX", ["ONNX"]),
    ("empty", b"", "POLICY_NOT_ONNX", ["ONNX"]),
    (
        "wrong input size",
        onnx_policies.linear_policy(np.zeros((7, 3), dtype=np.float32)),
        "POLICY_SHAPE",
        ["7", "10"],
    ),
    (
        "wrong output size",
        onnx_policies.linear_policy(np.zeros((10, 4), dtype=np.float32)),
        "POLICY_SHAPE",
        ["4", "3"],
    ),
    (
        "external data",
        onnx_policies.policy_with_external_data(10, 3),
        "POLICY_EXTERNAL_DATA",
        ["weights", "external"],
    ),
    ("NaN", onnx_policies.policy_that_emits_nan(10, 3), "POLICY_NOT_FINITE", ["NaN", "action"]),
]


@pytest.mark.parametrize("use", ["evaluate", "collect"])
@pytest.mark.parametrize(
    ("policy", "reason", "texts"),
    [policy[1:] for policy in BAD_POLICIES],
    ids=[policy[0] for policy in BAD_POLICIES],
)
def test_a_bad_policy_is_refused(
    policy: bytes, reason: str, texts: list[str], use: str, server: str
) -> None:
    def wrong(client: Client) -> object:
        return getattr(client, use)("hopper-w2", policy, episodes=2)

    check(server, wrong, errors.InvalidArgument, reason, *texts)


def test_actions_cannot_be_sampled_from_a_policy_without_mean_and_log_std(server: str) -> None:
    policy = onnx_policies.linear_policy(np.zeros((10, 3), dtype=np.float32))
    check(
        server,
        lambda client: client.evaluate("hopper-w2", policy, episodes=1, sampled=True),
        errors.InvalidArgument,
        "POLICY_NOT_STOCHASTIC",
        "mean",
        "log_std",
    )


def test_a_policy_above_the_limit_is_refused(server: str) -> None:
    with Client(server) as client:
        limit = client.server_info().limits.max_policy_bytes
    wrong: Callable[[Client], object] = lambda client: client.evaluate(  # noqa: E731
        "hopper", bytes(limit + 1), episodes=1
    )
    check(server, wrong, errors.InvalidArgument, "POLICY_TOO_LARGE", str(limit + 1), str(limit))


def test_a_policy_file_that_does_not_exist_is_named(client: Client) -> None:
    with pytest.raises(errors.InvalidArgument, match=r"'exprt' cannot be read.*expected 'random'"):
        client.evaluate("hopper", "exprt")


def test_every_task_has_an_expert(client: Client) -> None:
    assert [task.name for task in client.tasks() if task.expert is None] == []


WRONG_AMOUNTS: list[Callable[[Client], object]] = [
    lambda client: client.evaluate("hopper", "random", episodes=0),
    lambda client: client.evaluate("hopper", "random", num_envs=0),
    lambda client: client.collect("hopper", "random", episodes=0),
    lambda client: client.collect("hopper", "random", transitions=0),
]


@pytest.mark.parametrize("wrong", WRONG_AMOUNTS)
def test_an_amount_of_zero_is_refused(wrong: Callable[[Client], object], client: Client) -> None:
    with pytest.raises(errors.InvalidArgument, match="is 0; expected 1 to"):
        wrong(client)


def test_an_amount_must_be_named_once(client: Client) -> None:
    with pytest.raises(errors.InvalidArgument, match="expected one of the two"):
        client.collect("hopper", "random")
    with pytest.raises(errors.InvalidArgument, match="expected one of the two"):
        client.collect("hopper", "random", episodes=1, transitions=1)


@pytest.mark.parametrize(
    "server_address",
    ["localhost", "localhost:", "localhost:0", "localhost:70000", "http://localhost:1", "unix:"],
)
def test_an_address_that_is_none_is_refused(server_address: str) -> None:
    with pytest.raises(errors.InvalidArgument, match=re.escape(f"{server_address!r}")):
        Client(server_address)


@pytest.mark.parametrize("deadline_s", [0, -1, float("nan"), float("inf")])
def test_a_deadline_that_is_none_is_refused(deadline_s: float) -> None:
    with pytest.raises(errors.InvalidArgument, match="deadline_s is"):
        Client("localhost:1", deadline_s=deadline_s)


def test_a_render_mode_that_there_is_not_is_refused(server: str) -> None:
    for make in (palr_gym.make, palr_gym.make_vec):
        with pytest.raises(errors.InvalidArgument, match="render_mode is 'human'"):
            make("hopper", server=server, render_mode="human")
