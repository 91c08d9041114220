"""What goes wrong on the wire, by a small server that does whatever a test asks of it."""

import pickle
from collections.abc import Iterator

import grpc
import numpy as np
import pytest
from google.protobuf.any_pb2 import Any as AnyMessage
from google.protobuf.duration_pb2 import Duration
from google.rpc.error_details_pb2 import BadRequest, ErrorInfo, RetryInfo
from google.rpc.status_pb2 import Status

import palr_gym
from palr_gym import Client, errors
from palr_gym._proto.palr_gym.v1 import (
    collection_service_pb2,
    environment_pb2,
    environment_service_pb2,
    evaluation_service_pb2,
    tensor_pb2,
)
from support.fake_server import Behaviour, answering, fake_server


def pack(*details: ErrorInfo | RetryInfo | BadRequest) -> list[AnyMessage]:
    packed: list[AnyMessage] = []
    for detail in details:
        packed.append(AnyMessage())
        packed[-1].Pack(detail)
    return packed


def failing_with(code: grpc.StatusCode, trailer: bytes | None) -> Behaviour:
    def fail(_: bytes, context: grpc.ServicerContext) -> bytes:
        if trailer is not None:
            context.set_trailing_metadata(((errors.STATUS_TRAILER, trailer),))
        context.abort(code, "what the server said")

    return fail


def error_of(behaviour: Behaviour) -> errors.PalrGymError:
    """What a client makes of it."""
    with (
        fake_server("EnvironmentService", {"ListTasks": behaviour}) as address,
        Client(address, deadline_s=5) as client,
        pytest.raises(errors.PalrGymError) as caught,
    ):
        client.tasks()
    assert address in str(caught.value)
    assert "listing the tasks" in str(caught.value)
    return caught.value


@pytest.mark.parametrize(
    ("code", "expected", "builtin"),
    [
        (grpc.StatusCode.INVALID_ARGUMENT, errors.InvalidArgument, ValueError),
        (grpc.StatusCode.OUT_OF_RANGE, errors.InvalidArgument, ValueError),
        (grpc.StatusCode.NOT_FOUND, errors.NotFound, LookupError),
        (grpc.StatusCode.FAILED_PRECONDITION, errors.FailedPrecondition, RuntimeError),
        (grpc.StatusCode.RESOURCE_EXHAUSTED, errors.ResourceExhausted, RuntimeError),
        (grpc.StatusCode.DEADLINE_EXCEEDED, errors.DeadlineExceeded, TimeoutError),
        (grpc.StatusCode.UNAVAILABLE, errors.ServerUnavailable, ConnectionError),
        (grpc.StatusCode.INTERNAL, errors.ServerError, RuntimeError),
        (grpc.StatusCode.UNKNOWN, errors.ServerError, RuntimeError),
        (grpc.StatusCode.DATA_LOSS, errors.ServerError, RuntimeError),
        (grpc.StatusCode.UNIMPLEMENTED, errors.Unimplemented, NotImplementedError),
        (grpc.StatusCode.CANCELLED, errors.Cancelled, RuntimeError),
        (grpc.StatusCode.PERMISSION_DENIED, errors.PalrGymError, Exception),
        (grpc.StatusCode.UNAUTHENTICATED, errors.PalrGymError, Exception),
        (grpc.StatusCode.ABORTED, errors.PalrGymError, Exception),
        (grpc.StatusCode.ALREADY_EXISTS, errors.PalrGymError, Exception),
    ],
)
def test_every_status_becomes_its_exception_with_all_details(
    code: grpc.StatusCode, expected: type[errors.PalrGymError], builtin: type[Exception]
) -> None:
    status = Status(
        code=code.value[0],
        message="what the server said",
        details=pack(
            BadRequest(field_violations=[BadRequest.FieldViolation(field="env_id")]),
            RetryInfo(retry_delay=Duration(seconds=2, nanos=500_000_000)),
            ErrorInfo(reason="SOME_REASON", domain="palr_gym", metadata={"got": "7"}),
        ),
    )
    error = error_of(failing_with(code, status.SerializeToString()))
    assert type(error) is expected
    assert isinstance(error, builtin)
    assert error.code is code
    assert error.reason == "SOME_REASON"
    assert error.metadata == {"got": "7"}
    assert error.retry_after_s == 2.5
    assert "what the server said" in str(error)

    # Workers of an AsyncVectorEnv send their exceptions as pickles.
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is expected
    assert str(copy) == str(error)
    assert vars(copy) == vars(error)


def test_a_step_that_needs_a_reset_is_gymnasiums_error_as_well() -> None:
    status = Status(details=pack(ErrorInfo(reason="RESET_NEEDED")))
    error = error_of(failing_with(grpc.StatusCode.FAILED_PRECONDITION, status.SerializeToString()))
    assert type(error) is errors.ResetNeeded


@pytest.mark.parametrize("trailer", [None, b"", b"\xff\xff no message"])
def test_a_status_without_readable_details_is_enough(trailer: bytes | None) -> None:
    error = error_of(failing_with(grpc.StatusCode.NOT_FOUND, trailer))
    assert type(error) is errors.NotFound
    assert (error.reason, error.metadata, error.retry_after_s) == ("", {}, None)
    assert "what the server said" in str(error)


def test_an_answer_that_is_no_message_is_the_servers_error() -> None:
    assert type(error_of(answering(b"\xff\xff no message"))) is errors.ServerError


def test_a_server_of_something_else_is_unimplemented() -> None:
    with (
        fake_server("SomethingElse", {}) as address,
        Client(address, deadline_s=5) as client,
        pytest.raises(errors.Unimplemented),
    ):
        client.open_session("hopper")


def test_a_call_on_a_closed_client_says_so() -> None:
    client = Client("localhost:1")
    client.close()
    client.close()
    with pytest.raises(errors.FailedPrecondition, match="has been closed"):
        client.tasks()
    with pytest.raises(errors.FailedPrecondition, match="has been closed"):
        client.evaluate("hopper", "random")


def float64(*values: float) -> tensor_pb2.Tensor:
    data = np.array(values, dtype=np.float64).tobytes()
    return tensor_pb2.Tensor(dtype=tensor_pb2.DATA_TYPE_FLOAT64, shape=[len(values)], data=data)


SPEC = environment_pb2.EnvironmentSpec(
    env_id="tiny-v0",
    observation_space=environment_pb2.BoxSpace(
        shape=[2], low=[-1, -1], high=[1, 1], names=["a", "b"]
    ),
    action_space=environment_pb2.BoxSpace(shape=[1], low=[-1], high=[1], names=["push"]),
    info_names=["x"],
)


def step_of(
    response: environment_service_pb2.StepResponse | bytes,
) -> palr_gym.StepResult:
    """What `Session.step` makes of a response, in a session of one tiny environment."""
    opened = environment_service_pb2.OpenSessionResponse(session_id="s", spec=SPEC, num_envs=1)
    methods: dict[str, Behaviour] = {
        "OpenSession": answering(opened.SerializeToString()),
        "CloseSession": answering(b""),
    }
    if not isinstance(response, bytes):
        message = environment_service_pb2.StepStreamResponse(step=response)
        response = message.SerializeToString()
    exchanges = {"StepStream": answering(response)}
    with (
        fake_server("EnvironmentService", methods, exchanges=exchanges) as address,
        Client(address, deadline_s=5) as client,
        client.open_session("tiny") as session,
    ):
        return session.step([[0.0]])


def good_step() -> environment_service_pb2.StepResponse:
    flag = tensor_pb2.Tensor(dtype=tensor_pb2.DATA_TYPE_BOOL, shape=[1], data=b"\1")
    return environment_service_pb2.StepResponse(
        observations=float64(0.25, 0.5),
        rewards=float64(3),
        terminated=flag,
        truncated=flag,
        info=float64(7),
    )


def test_a_good_step_is_read() -> None:
    result = step_of(good_step())
    assert result.observations.tolist() == [[0.25, 0.5]]
    assert result.rewards.tolist() == [3]
    assert result.terminated.tolist() == result.truncated.tolist() == [True]
    assert result.info.tolist() == [[7]]
    assert result.final_observations is None


@pytest.mark.parametrize("field", ["observations", "rewards", "terminated", "truncated", "info"])
@pytest.mark.parametrize("data", [b"", b"123", bytes(1000)])
def test_a_step_of_the_wrong_size_is_the_servers_error(field: str, data: bytes) -> None:
    response = good_step()
    getattr(response, field).data = data
    with pytest.raises(errors.ServerError, match=f"sent {len(data)} bytes; expected"):
        step_of(response)


def test_a_step_that_is_no_message_is_the_servers_error() -> None:
    with pytest.raises(errors.ServerError, match="the answer is no message"):
        step_of(b"\xff\xff no message")


def test_a_final_observation_of_the_wrong_shape_is_the_servers_error() -> None:
    response = good_step()
    response.final_observations.CopyFrom(float64(1, 2))
    with pytest.raises(errors.ServerError, match=r"shape \[2\]; expected float64 and \[-1, 2\]"):
        step_of(response)


def test_an_evaluation_that_ends_too_early_is_the_servers_error() -> None:
    def evaluate(*_: object) -> Iterator[bytes]:
        episode = evaluation_service_pb2.EpisodeResult(index=0, length=1)
        message = evaluation_service_pb2.EvaluateResponse(episode=episode)
        yield message.SerializeToString()

    with (
        fake_server("EvaluationService", {}, {"Evaluate": evaluate}) as address,
        pytest.raises(errors.ServerError, match="1 of 2 episodes and no summary"),
    ):
        palr_gym.evaluate("hopper", "random", episodes=2, server=address)


def test_a_collection_without_episodes_is_the_servers_error() -> None:
    def collect(*_: object) -> Iterator[bytes]:
        started = collection_service_pb2.CollectionStarted(spec=SPEC)
        yield collection_service_pb2.CollectResponse(started=started).SerializeToString()

    with (
        fake_server("CollectionService", {}, {"Collect": collect}) as address,
        pytest.raises(errors.ServerError, match="sent no episodes"),
    ):
        palr_gym.collect("hopper", "random", episodes=2, server=address)


def test_messages_beyond_grpcs_usual_limit_arrive(server: str) -> None:
    with palr_gym.make_vec("ant-full-w64", 512, server=server) as envs:
        observations, _ = envs.reset(seed=0)
        assert observations.nbytes > 1.5 * (4 << 20)
        observations = envs.step(np.zeros((512, 8)))[0]
        assert observations.nbytes > 1.5 * (4 << 20)
        assert np.isfinite(observations).all()
