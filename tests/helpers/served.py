"""Commands that serve a page, started as a user does."""

import os
import re
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

START_S = 60.0


@dataclass
class Served:
    """A command that serves.

    Attributes:
        process: The command.
        url: Where its page is.
        line: What it has said.
    """

    process: subprocess.Popen
    url: str
    line: str
    errors: str = field(default="", init=False)

    @property
    def port(self) -> int:
        return int(re.search(r":(\d+)/", self.url)[1])

    @property
    def site(self) -> str:
        return self.url.partition("?")[0]

    def stop(self) -> int:
        """Ctrl-C; returns the exit status."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        self.errors += self.process.communicate(timeout=30)[1]
        return self.process.returncode


def is_free(port: int) -> bool:
    with socket.socket() as there:
        there.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            there.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True


@contextmanager
def served(*arguments: object, **environment: str) -> Iterator[Served]:
    """`tofrender` with these arguments, until the block ends."""
    command = [sys.executable, "-m", "tofrender", *map(str, arguments)]
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"TOFRENDER_DEBUG": "0"} | environment,
    )
    try:
        line, deadline = "", time.monotonic() + START_S
        while "http" not in line and time.monotonic() < deadline and process.poll() is None:
            if select.select([process.stdout], [], [], 0.2)[0]:
                line = process.stdout.readline()
        found = re.search(r"http://\S+", line)
        assert found, f"{line} {process.stderr.read() if process.poll() is not None else ''}"
        yield Served(process, found[0], line)
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()
