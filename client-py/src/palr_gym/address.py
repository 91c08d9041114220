"""Where a server listens: `host:port` or `unix:/path`."""

import os
import re
from dataclasses import dataclass

from palr_gym.errors import InvalidArgument

SERVER_VARIABLE = "PALR_GYM_SERVER"
"""Environment variable with the address of the server to use when none is named."""

DEFAULT_SERVER = "localhost:7257"
"""The server to use when neither an argument nor the variable names one."""

_HOST_AND_PORT = re.compile(r"(?P<host>\[[0-9a-fA-F:.%]+\]|[^\s:/\[\]]+):(?P<port>[0-9]{1,5})")
_LOOPBACK = ("localhost", "127.0.0.1", "[::1]")

ChannelOptions = list[tuple[str, str | int]]


@dataclass(frozen=True)
class Address:
    """A server's address and the channel options that go with it."""

    target: str
    options: ChannelOptions


def server_or_default(server: str | None) -> str:
    """`server`, or what the environment variable says, or the default."""
    return server or os.environ.get(SERVER_VARIABLE) or DEFAULT_SERVER


def parse_address(server: str) -> Address:
    """Checks an address before gRPC's resolver gives it some other meaning.

    Raises:
        InvalidArgument: `server` is neither `host:port` nor `unix:/path`.
    """
    if server.startswith("unix:"):
        if not server.removeprefix("unix:"):
            raise InvalidArgument(f"server address {server!r} has no path; expected unix:/path")
        # gRPC would send the escaped path as :authority, which HTTP/2 servers such as tonic's
        # refuse as malformed.
        return Address(server, [("grpc.default_authority", "localhost")])
    match = _HOST_AND_PORT.fullmatch(server)
    if match is None or not 1 <= int(match["port"]) <= 65535:
        raise InvalidArgument(
            f"server address {server!r} is not understood; expected host:port (such as "
            "localhost:7257, port 1 to 65535) or unix:/path"
        )
    # A proxy for the Internet (http_proxy) does not lead to this machine.
    return Address(server, [("grpc.enable_http_proxy", 0)] if match["host"] in _LOOPBACK else [])
