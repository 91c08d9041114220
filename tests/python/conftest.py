"""Fixtures: one server that most tests share."""

from collections.abc import Generator

import pytest

from palr_gym import Client
from support.server_process import ServerProcess, running_server


@pytest.fixture(scope="session")
def shared_server() -> Generator[ServerProcess]:
    with running_server() as server:
        yield server


@pytest.fixture
def server(shared_server: ServerProcess) -> Generator[str]:
    """The address of a server that must survive the test."""
    yield shared_server.address
    assert shared_server.is_alive, "the test took the server down"


@pytest.fixture
def client(server: str) -> Generator[Client]:
    with Client(server, deadline_s=20) as client:
        yield client
