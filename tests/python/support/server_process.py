"""The real binary, started and stopped by tests."""

import contextlib
import json
import os
import queue
import signal
import subprocess
import threading
from collections.abc import Generator
from pathlib import Path
from typing import IO, Any

ROOT = Path(__file__).resolve().parents[3]
BINARY_VARIABLE = "PALR_GYM_BIN"
START_TIMEOUT_S = 20.0
STOP_TIMEOUT_S = 20.0


def binary() -> Path:
    """The server that is tested.

    Raises:
        FileNotFoundError: It has not been built.
    """
    path = Path(os.environ.get(BINARY_VARIABLE, ROOT / "target" / "debug" / "palr-gym"))
    if not path.is_file():
        raise FileNotFoundError(
            f"{path} does not exist; these tests need the server: build it with `cargo build`, or "
            f"set {BINARY_VARIABLE} to where it is"
        )
    return path


class ServerProcess:
    """A running `palr-gym serve`."""

    def __init__(self, *arguments: str) -> None:
        """Starts a server on a free port and waits until it is ready."""
        self._process = subprocess.Popen(
            [str(binary()), "serve", "--listen", "127.0.0.1:0", "--json", *arguments],
            stdout=subprocess.PIPE,
            text=True,
        )
        self.ready: dict[str, Any] = self._wait_until_ready()
        self.address: str = self.ready["address"]

    @property
    def is_alive(self) -> bool:
        """Whether the process has not ended."""
        return self._process.poll() is None

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._process.pid

    def send(self, number: signal.Signals) -> None:
        """Sends a signal."""
        self._process.send_signal(number)

    def freeze(self) -> None:
        """Stops every thread of the server where it is, and waits until they have stopped."""
        self.send(signal.SIGSTOP)
        os.waitid(os.P_PID, self._process.pid, os.WSTOPPED)

    def thaw(self) -> None:
        """Lets a frozen server go on."""
        self.send(signal.SIGCONT)

    def wait(self) -> int:
        """Waits for the end and returns the exit code; negative: ended by that signal."""
        return self._process.wait(STOP_TIMEOUT_S)

    def kill(self) -> None:
        """Ends the process at once, as a crash would. May be repeated."""
        # A stopped process dies of SIGKILL as well.
        self._process.kill()
        self.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def _wait_until_ready(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        lines: queue.Queue[str] = queue.Queue()
        threading.Thread(
            target=_first_line, args=(self._process.stdout, lines), daemon=True
        ).start()
        try:
            line = lines.get(timeout=START_TIMEOUT_S)
            return json.loads(line)
        except (queue.Empty, json.JSONDecodeError) as error:
            self.kill()
            raise RuntimeError(
                f"{binary()} serve printed no line of JSON within {START_TIMEOUT_S} s; see its log "
                "above"
            ) from error


def _first_line(stream: IO[str], lines: "queue.Queue[str]") -> None:
    # A closed stream means that the process was killed meanwhile.
    with contextlib.suppress(ValueError):
        lines.put(stream.readline())


@contextlib.contextmanager
def running_server(*arguments: str) -> Generator[ServerProcess]:
    """A server for one test, which may do to it whatever it likes."""
    server = ServerProcess(*arguments)
    try:
        yield server
    finally:
        server.kill()
