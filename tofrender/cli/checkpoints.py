"""Checkpoints of commands that take long: they can be stopped, killed, and go on."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from . import options as opt

if TYPE_CHECKING:
    from tofrender.runtime.checkpoints import Checkpoint
    from tofrender.runtime.progress import Stop

Seconds = Annotated[
    float, opt.real(0, "Keep what is done at least so often, seconds of work; 0: never.")
]
Resume = Annotated[
    bool, opt.switch("--resume", "Go on where a run was stopped or killed, up to --spp.")
]

NEVER_S = 1e9
AGAIN = "the same command with --resume goes on"


@contextmanager
def checkpointed(out: Path, seconds: float, resume: bool) -> Iterator[Checkpoint | None]:
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
        left = unfinished_work(out)
        if left is not None and not resume:
            raise ValueError(f"--out = {out}: {left} is of a stopped run; {AGAIN}, or remove it")
        checkpoint = None
        if seconds or (resume and path.exists()):
            checkpoint = Checkpoint(path, seconds or NEVER_S, opt.note, AGAIN, resume)
        try:
            yield checkpoint
        except OSError as error:
            if error.errno not in DISK_FULL or not is_begun(path, film_path(out)):
                raise
            raise OSError(f"{error}; with more room, {AGAIN}") from None
        path.unlink(missing_ok=True)
        remove(film_path(out))


@contextmanager
def exclusively(out: Path) -> Iterator[None]:
    """Be the only one that writes `out`, without what killed runs have left beside it."""
    from tofrender.runtime.atomic import locked, remove_leftovers

    with locked(out, "--out"):
        remove_leftovers(out)
        yield


def end_if_incomplete(attrs: Mapping[str, Any]) -> None:
    """End the command, which has written a render or a capture, if that was stopped."""
    if not attrs.get("complete", 1):
        opt.note(f"error: interrupted after {attrs['spp']} samples per pixel; {AGAIN}")
        raise typer.Exit(opt.INTERRUPTED)


def end_if_stopped(stop: Stop) -> None:
    """End the command if it was stopped while its files were written."""
    if stop.requested:
        raise KeyboardInterrupt("interrupted while files were written, which are whole")


def require_begun(resume: bool, begun: Path | None, out: Path) -> None:
    """Refuse to go on where there is nothing to go on from."""
    if resume and (begun is None or not is_begun(begun)):
        raise ValueError(f"--resume: no run that writes {out} was stopped; must be left out")


def film_path(out: Path) -> Path:
    """Name of the film of `out` on the disk, beside it."""
    from tofrender.runtime.atomic import sibling

    return sibling(out, ".zarr")


def unfinished_work(out: Path) -> Path | None:
    """Checkpoint or tiles that a stopped or killed run has left of `out`, None without."""
    from tofrender.runtime.atomic import sibling

    film = film_path(out)
    folder = sibling(film, ".film")
    if any(folder.glob("receipts/tile *")):
        return folder
    return next((e for e in (sibling(out, ".checkpoint.npz"), film) if e.exists()), None)


def is_begun(*begun: Path) -> bool:
    """Whether there is a checkpoint, or a film on the disk, finished or not."""
    from tofrender.runtime.atomic import sibling

    return any(each.exists() or sibling(each, ".film").exists() for each in begun)
