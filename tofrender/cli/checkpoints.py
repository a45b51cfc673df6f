"""Checkpoints of commands that take long: they can be stopped, killed, and go on."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..runtime.atomic import DISK_FULL, locked, part_path, remove, remove_leftovers, sibling
from ..runtime.progress import Stop
from . import options as opt

if TYPE_CHECKING:
    from ..runtime.checkpoints import Checkpoint

Seconds = Annotated[float, opt.real(0, "Seconds of work between checkpoints; 0: never.")]
Resume = Annotated[bool, opt.switch("--resume", "Continue a stopped or killed run, up to --spp.")]

NEVER_S = 1e9
PARTS = 2  # Poses of `tofrender doppler`
AGAIN = "the same command with --resume goes on"


@contextmanager
def checkpointed(out: Path, seconds: float, resume: bool) -> "Iterator[Checkpoint | None]":
    """Lock `out`, and yield the checkpoint of the command that writes it, if there is to be one.

    Temporary files of killed runs are removed; so is the checkpoint when the block ends without an
    error or `typer.Exit`.
    """
    from ..runtime.checkpoints import Checkpoint

    with exclusively(out):
        path = checkpoint_path(out)
        for each in _files(out):
            remove_leftovers(each)
        unfinished = unfinished_work(out)
        if unfinished is not None and not resume:
            raise ValueError(
                f"--out = {out}: {unfinished} is of a stopped run; {AGAIN}, or remove it"
            )
        checkpoint = None
        if seconds or (resume and unfinished is not None):
            checkpoint = Checkpoint(path, seconds or NEVER_S, opt.note, AGAIN, resume)
        try:
            yield checkpoint
        except OSError as error:
            if error.errno not in DISK_FULL or not is_begun(path, film_path(out)):
                raise
            raise OSError(f"{error}; with more room, {AGAIN}") from None
        for each in _files(out):
            each.unlink(missing_ok=True)
        remove(film_path(out))


@contextmanager
def exclusively(out: Path) -> Iterator[None]:
    """Lock `out` for the block, and remove temporary files of killed runs."""
    with locked(out, "--out"):
        remove_leftovers(out)
        yield


def end_if_incomplete(attrs: Mapping[str, Any]) -> None:
    """End the command if the render or capture that it has written was stopped."""
    if not attrs.get("complete", 1):
        opt.note(f"error: interrupted after {attrs['spp']} samples per pixel; {AGAIN}")
        raise typer.Exit(opt.INTERRUPTED)


def end_if_stopped(stop: Stop) -> None:
    """End the command if it was stopped while its files were written."""
    if stop.requested:
        raise KeyboardInterrupt("interrupted while files were written, which are whole")


def require_begun(resume: bool, begun: Path | None, out: Path) -> None:
    """Raise a ValueError if there is nothing that `resume` could go on from."""
    if resume and (begun is None or not is_begun(begun)):
        raise ValueError(f"--resume: no run that writes {out} was stopped; must be left out")


def checkpoint_path(out: Path) -> Path:
    """Hidden checkpoint beside `out`."""
    return sibling(out, ".checkpoint.npz")


def _files(out: Path) -> list[Path]:
    """Checkpoints that a command that writes `out` may have: one, or one of each pose."""
    path = checkpoint_path(out)
    return [path, *(part_path(path, number) for number in range(PARTS))]


def film_path(out: Path) -> Path:
    """Hidden film on the disk, beside `out`."""
    return sibling(out, ".zarr")


def unfinished_work(out: Path) -> Path | None:
    """Checkpoint or tiles of `out` by a stopped or killed run, if there are any."""
    film = film_path(out)
    folder = sibling(film, ".film")
    if any(folder.glob("receipts/tile *")):
        return folder
    return next((each for each in (*_files(out), film) if each.exists()), None)


def is_begun(*begun: Path) -> bool:
    """Whether there is a checkpoint, or a film on the disk, finished or not."""
    return any(each.exists() or sibling(each, ".film").exists() for each in begun)
