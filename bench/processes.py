"""Contenders as processes: started, waited for, and believed only if they end well."""

import contextlib
import json
import os
import selectors
import subprocess
import sys
import tempfile
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any

from bench.plan import ROOT, ContenderError, Settings

_TIMEOUT_S = 600.0
_START_TIMEOUT_S = 30.0
_STOP_TIMEOUT_S = 20.0
_LOG_TAIL_CHARACTERS = 2000


def environment() -> dict[str, str]:
    """The environment of every contender, ours and peers alike."""
    # A forced kernel would slow NumPy's users; a server that is named is not the one to measure.
    unwanted = ("OPENBLAS_CORETYPE", "PALR_GYM_SERVER", "PALR_GYM_LOG")
    kept = {key: value for key, value in os.environ.items() if key not in unwanted}
    return kept | {"PYTHONPATH": str(ROOT), "PYTHONWARNINGS": "ignore"}


def ran(command: Sequence[str], timeout_s: float = _TIMEOUT_S) -> str:
    """Runs `command` and returns what it printed.

    Raises:
        ContenderError: It failed or took too long.
    """
    # In a folder of its own: MuJoCo leaves MUJOCO_LOG.TXT where it runs.
    with tempfile.TemporaryDirectory(prefix="palr-bench-") as folder:
        try:
            done = subprocess.run(
                command,
                cwd=folder,
                env=environment(),
                capture_output=True,
                text=True,
                timeout=timeout_s,
                check=False,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise ContenderError(str(error)) from error
    if done.returncode != 0:
        tail = done.stderr[-_LOG_TAIL_CHARACTERS:]
        raise ContenderError(f"`{' '.join(command)}` ended with {done.returncode}:\n{tail}")
    return done.stdout


def measured(command: Sequence[str], timeout_s: float = _TIMEOUT_S) -> dict[str, Any]:
    """Runs `command` and returns the JSON on the last line of its standard output.

    Raises:
        ContenderError: It failed, took too long, or printed something else.
    """
    output = ran(command, timeout_s)
    try:
        return json.loads(output.splitlines()[-1])
    except (IndexError, json.JSONDecodeError):
        text = " ".join(command)
        raise ContenderError(f"`{text}` printed no line of JSON: {output!r}") from None


def python(settings: Settings, module: str, *arguments: str) -> list[str]:
    """The command that runs a module of this package where the peers are installed."""
    return [str(settings.python), "-m", f"bench.{module}", *arguments]


@contextlib.contextmanager
def listening(*command: str) -> Generator[str]:
    """A program that listens on the Unix socket named after `--unix` and says so in JSON.

    Yields:
        Its address.

    Raises:
        ContenderError: It did not get that far.
    """
    with started(*command) as (address, _):
        yield address


@contextlib.contextmanager
def started(*command: str) -> Generator[tuple[str, int]]:
    """Like `listening`.

    Yields:
        Its address and its process.

    Raises:
        ContenderError: It did not get that far.
    """
    with tempfile.TemporaryDirectory(prefix="palr-bench-") as folder:
        socket = Path(folder) / "server.sock"
        log = Path(folder) / "log"
        with log.open("wb") as stderr:
            process = subprocess.Popen(
                [*command, "--unix", str(socket)],
                cwd=folder,
                env=environment(),
                stdout=subprocess.PIPE,
                stderr=stderr,
            )
        try:
            if not _says_something(process):
                tail = log.read_text(encoding="utf-8", errors="replace")[-_LOG_TAIL_CHARACTERS:]
                raise ContenderError(f"`{' '.join(command)}` does not listen:\n{tail}")
            yield f"unix:{socket}", process.pid
        finally:
            process.terminate()
            try:
                process.wait(_STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                print(f"bench: {command[0]} did not stop; killed", file=sys.stderr)
                process.kill()
                process.wait()
            if process.stdout is not None:
                process.stdout.close()


def _says_something(process: subprocess.Popen[bytes]) -> bool:
    """True once the process has printed a line; false if it ended or stayed silent."""
    assert process.stdout is not None
    with selectors.DefaultSelector() as selector:
        selector.register(process.stdout, selectors.EVENT_READ)
        return bool(selector.select(_START_TIMEOUT_S)) and bool(process.stdout.readline())
