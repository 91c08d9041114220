"""Opens many sessions and leaves them alone; measures what they cost their server."""

import argparse
import contextlib
import json
import os
import resource
import time
from pathlib import Path

from palr_gym import Client

_SETTLE_S = 3.0


def _cpu_s(pid: int) -> float:
    """CPU seconds of a process so far."""
    stat = Path(f"/proc/{pid}/stat").read_text(encoding="ascii")
    # After the name, which may hold blanks: utime and stime are fields 14 and 15.
    fields = stat.rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    """Measures once."""
    parser = argparse.ArgumentParser(description="Measures a server with idle sessions.")
    parser.add_argument("--server", required=True, help="host:port or unix:/path")
    parser.add_argument("--pid", type=int, required=True, help="of the server")
    parser.add_argument("--sessions", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=10.0)
    options = parser.parse_args()
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    with contextlib.ExitStack() as stack:
        client = stack.enter_context(Client(options.server))
        for seed in range(options.sessions):
            session = stack.enter_context(client.open_session("hopper"))
            session.reset(seeds=[seed])
        time.sleep(_SETTLE_S)
        started, before_s = time.monotonic(), _cpu_s(options.pid)
        time.sleep(options.seconds)
        wall_s, cpu_s = time.monotonic() - started, _cpu_s(options.pid) - before_s
    print(json.dumps({"wall_s": wall_s, "cpu_s": cpu_s, "cpu_percent": 100 * cpu_s / wall_s}))


if __name__ == "__main__":
    main()
