"""What commands that take long share: they can be stopped, killed, and go on."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import options as opt

if TYPE_CHECKING:
    from tofrender.runtime.checkpoints import Checkpoint
    from tofrender.runtime.progress import Stop

Seconds = Annotated[
    float, opt.real(0, "Keep what is done at least so often, seconds of work; 0: never.")
]
Resume = Annotated[
    bool, typer.Option("--resume", help="Go on where a run was stopped or killed, up to --spp.")
]

EVERY_S, NEVER_S = 30.0, 1e9
AGAIN = "the same command with --resume goes on"


@contextmanager
def keeping(out: Path, seconds: float, resume: bool) -> Iterator[Checkpoint | None]:
    """The checkpoint of a command that writes `out`, as nobody else may meanwhile.

    What a killed run has left beside `out` is removed; so is the checkpoint when the block ends
    without an error or `typer.Exit`.
    """
    from tofrender.runtime.atomic import hidden, locked, remove_leftovers
    from tofrender.runtime.checkpoints import Checkpoint
    from tofrender.runtime.progress import ended_by_signals

    with locked(out, "--out"), ended_by_signals():
        path = hidden(out, ".checkpoint.npz")
        for each in (out, path):
            remove_leftovers(each)
        if path.exists() and not resume:
            typer.echo(f"note: {AGAIN} from where an earlier one was stopped", err=True)
        if seconds or (resume and path.exists()):
            tell = partial(typer.echo, err=True)
            yield Checkpoint(path, seconds or NEVER_S, tell, AGAIN, resume)
        else:
            yield None
        path.unlink(missing_ok=True)


def tell(stop: Stop) -> None:
    """End the command if it was stopped while its files were written."""
    if stop.requested:
        raise KeyboardInterrupt("interrupted while files were written, which are whole")


def require_something(resume: bool, checkpoint: Checkpoint | None, out: Path) -> None:
    """Refuse to go on where there is nothing to go on from."""
    if resume and (checkpoint is None or not checkpoint.path.exists()):
        raise ValueError(f"--resume: no run that writes {out} was stopped; must be left out")
