"""Call the command, in this process and in another one."""

import contextlib
import os
import subprocess
import sys
from pathlib import Path

from tofrender.cli.app import main

ROOT = Path(__file__).parents[2]

TINY = ["--size", "8x6", "--bins", "20", "--bin-width", "0.3", "--spp", "4"]

COMMAND = [sys.executable, "-m", "tofrender"]

HEAVY = ("mitsuba", "drjit", "numpy", "xarray", "matplotlib", "OpenEXR")


def run(capsys, *arguments: object) -> tuple[int, str, str]:
    """Exit status, stdout and stderr of the command, in this process."""
    status = main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def done(capsys, *arguments: object) -> tuple[str, str]:
    """What a command that succeeds says on stdout and stderr."""
    status, out, err = run(capsys, *arguments)
    assert status == 0, err
    return out, err


def refused(capsys, *arguments: object) -> str:
    """The one line with which bad input is refused."""
    status, out, err = run(capsys, *arguments)
    assert (status, out) == (2, "")
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    return err[len("error: ") : -1]


def imported_by(arguments: list[str], **environment: str) -> tuple[set[str], str]:
    """What a process of the command imports, and what it says."""
    command = [COMMAND[0], "-X", "importtime", *COMMAND[1:], *arguments]
    options: dict = {"capture_output": True, "text": True, "check": True, "cwd": ROOT}
    done = subprocess.run(command, env=os.environ | environment, **options)
    return {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()}, done.stdout


def rest_of(screen: int) -> str:
    """What is still written to a terminal until its program ends."""
    text = b""
    with contextlib.suppress(OSError):  # How Linux says that it is closed
        while part := os.read(screen, 1 << 12):
            text += part
    return text.decode()
