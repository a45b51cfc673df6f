"""Commands that serve a page, started as a user does."""

import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field


@dataclass
class Served:
    """A command that serves."""

    process: subprocess.Popen  # the command
    url: str  # where its page is
    line: str  # what it has said
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
        self.errors += self.process.communicate()[1]
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
    environment = os.environ | {"TOFRENDER_DEBUG": "0"} | environment
    pipes: dict = dict.fromkeys(("stdout", "stderr"), subprocess.PIPE)
    process = subprocess.Popen(command, text=True, env=environment, **pipes)
    try:
        line = next((line for line in process.stdout if "http" in line), "")
        found = re.search(r"http://\S+", line)
        assert found, process.stderr.read()
        yield Served(process, found[0], line)
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()
