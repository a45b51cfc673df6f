"""What commands that take long share: they can be stopped, killed, and go on."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
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

NEVER_S = 1e9
AGAIN = "the same command with --resume goes on"


@contextmanager
def keeping(out: Path, seconds: float, resume: bool) -> Iterator[Checkpoint | None]:
    """The checkpoint of a command that writes `out`, as nobody else may meanwhile.

    What a killed run has left beside `out` is removed; so is the checkpoint when the block ends
    without an error or `typer.Exit`.
    """
    from tofrender.runtime.atomic import DISK_FULL, locked, remove, remove_leftovers, sibling
    from tofrender.runtime.checkpoints import Checkpoint

    with locked(out, "--out"):
        path = sibling(out, ".checkpoint.npz")
        for each in (out, path):
            remove_leftovers(each)
        left = left_work(out)
        if left is not None and not resume:
            raise ValueError(f"--out = {out}: {left} is of a stopped run; {AGAIN}, or remove it")
        checkpoint = None
        if seconds or (resume and path.exists()):
            checkpoint = Checkpoint(path, seconds or NEVER_S, opt.note, AGAIN, resume)
        try:
            yield checkpoint
        except OSError as error:
            if error.errno not in DISK_FULL or not is_begun(path, on_disk(out)):
                raise
            raise OSError(f"{error}; with more room, {AGAIN}") from None
        path.unlink(missing_ok=True)
        remove(on_disk(out))


@contextmanager
def alone(out: Path) -> Iterator[None]:
    """Be the only one that writes `out`, without what killed runs have left beside it."""
    from tofrender.runtime.atomic import locked, remove_leftovers

    with locked(out, "--out"):
        remove_leftovers(out)
        yield


def tell(stop: Stop) -> None:
    """End the command if it was stopped while its files were written."""
    if stop.requested:
        raise KeyboardInterrupt("interrupted while files were written, which are whole")


def require_something(resume: bool, kept: Path | None, out: Path) -> None:
    """Refuse to go on where there is nothing to go on from."""
    if resume and (kept is None or not is_begun(kept)):
        raise ValueError(f"--resume: no run that writes {out} was stopped; must be left out")


def on_disk(out: Path) -> Path:
    """Where the film of `out` is on the disk, beside it."""
    from tofrender.runtime.atomic import sibling

    return sibling(out, ".zarr")


def left_work(out: Path) -> Path | None:
    """Checkpoint or tiles that a stopped or killed run has left of `out`, None without."""
    from tofrender.runtime.atomic import sibling

    film = on_disk(out)
    folder = sibling(film, ".film")
    if any(folder.glob("receipts/tile *")):
        return folder
    return next((e for e in (sibling(out, ".checkpoint.npz"), film) if e.exists()), None)


def is_begun(*kept: Path) -> bool:
    """Whether there is a checkpoint, or a film on the disk, finished or not."""
    from tofrender.runtime.atomic import sibling

    return any(each.exists() or sibling(each, ".film").exists() for each in kept)
