"""A small server that does whatever a test asks of it, for what the real one never does."""

import contextlib
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import ThreadPoolExecutor

import grpc

Behaviour = Callable[[bytes, grpc.ServicerContext], bytes]
StreamBehaviour = Callable[[bytes, grpc.ServicerContext], Iterator[bytes]]


def one_by_one(
    behaviour: Behaviour,
) -> Callable[[Iterator[bytes], grpc.ServicerContext], Iterator[bytes]]:
    return lambda requests, context: (behaviour(request, context) for request in requests)


@contextlib.contextmanager
def fake_server(
    service: str,
    methods: dict[str, Behaviour],
    streams: dict[str, StreamBehaviour] | None = None,
    exchanges: dict[str, Behaviour] | None = None,
) -> Generator[str]:
    """A server of one service that answers serialised messages; yields its address."""
    handlers: dict[str, grpc.RpcMethodHandler[bytes, bytes]] = {
        name: grpc.unary_unary_rpc_method_handler(behaviour) for name, behaviour in methods.items()
    }
    for name, behaviour in (streams or {}).items():
        handlers[name] = grpc.unary_stream_rpc_method_handler(behaviour)
    for name, behaviour in (exchanges or {}).items():
        handlers[name] = grpc.stream_stream_rpc_method_handler(one_by_one(behaviour))
    server = grpc.server(ThreadPoolExecutor(2))
    server.add_generic_rpc_handlers(
        (grpc.method_handlers_generic_handler(f"palr_gym.v1.{service}", handlers),)
    )
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    try:
        yield f"127.0.0.1:{port}"
    finally:
        server.stop(None).wait()


def answering(response: bytes) -> Behaviour:
    return lambda _request, _context: response
