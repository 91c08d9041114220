"""The server of the compatibility tests."""

from collections.abc import Generator

import pytest

from support.server_process import running_server


@pytest.fixture(scope="session")
def server() -> Generator[str]:
    """Its address."""
    with running_server() as process:
        yield process.address
