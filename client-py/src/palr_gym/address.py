"""Where a server listens: `host:port` or `unix:/path`."""

import os
import re
from dataclasses import dataclass

from palr_gym.errors import InvalidArgument

SERVER_VARIABLE = "PALR_GYM_SERVER"
"""Environment variable with the address of the server to use when none is named."""

DEFAULT_SERVER = "localhost:7257"
"""The server to use when neither an argument nor the variable names one."""

_HOST_AND_PORT = re.compile(
    r"(?:\[(?P<ipv6>[0-9a-fA-F:.%]+)\]|(?P<name>[^\s:/\[\]]{1,240})):(?P<port>[0-9]{1,5})"
)


@dataclass(frozen=True)
class Address:
    """A server's address, taken apart."""

    target: str
    """For grpc."""
    authority: str
    """For HTTP/2."""
    host: str
    """Name or number; empty for a Unix socket."""
    port: int
    unix_path: str | None


def server_or_default(server: str | None) -> str:
    """`server`, or what the environment variable says, or the default."""
    return server or os.environ.get(SERVER_VARIABLE) or DEFAULT_SERVER


def parse_address(server: str) -> Address:
    """Checks an address before gRPC's resolver gives it some other meaning.

    Raises:
        InvalidArgument: `server` is neither `host:port` nor `unix:/path`.
    """
    if server.startswith("unix:"):
        path = server.removeprefix("unix:").removeprefix("//")
        if not path:
            raise InvalidArgument(f"server address {server!r} has no path; expected unix:/path")
        # grpc would send the escaped path as authority, which servers refuse as malformed.
        return Address(f"unix:{path}", "localhost", host="", port=0, unix_path=path)
    match = _HOST_AND_PORT.fullmatch(server)
    if match is None or not 1 <= int(match["port"]) <= 65535:
        raise InvalidArgument(
            f"server address {server!r} is not understood; expected host:port (such as "
            "localhost:7257, port 1 to 65535) or unix:/path"
        )
    host = match["ipv6"] or match["name"]
    return Address(server, server, host=host, port=int(match["port"]), unix_path=None)
