"""Checkpoints for resuming a stopped or killed command."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..runtime.atomic import DISK_FULL, locked, part_path, remove, remove_leftovers, sibling
from ..runtime.progress import EVERY_S, Stop
from . import options as opt
from .answers import answer

if TYPE_CHECKING:
    from ..runtime.checkpoints import Checkpoint

Seconds = Annotated[float, opt.real(0, "Time between checkpoints [s], 0 for no checkpoints")]
Resume = Annotated[bool, opt.switch("--resume", "Continue a stopped or killed run, up to --spp.")]


@dataclass(frozen=True)
class Stopping:
    """Options of commands that can be stopped and continued."""

    checkpoint: Seconds = EVERY_S
    resume: Resume = False


NEVER_S = 1e9
"""Time between checkpoints if there are none [s]."""

PARTS = 2
"""Number of parts of `tofrender doppler`, each with a checkpoint."""

AGAIN = "run the same command with --resume to continue"
"""Remedy in messages of stopped runs."""

RUN = "run"
"""Attribute of a written file: recipe and facts of the run as JSON."""


@contextmanager
def checkpointed(out: Path, seconds: float, resume: bool) -> "Iterator[Checkpoint | None]":
    """Lock `out`, and yield the checkpoint of the command that writes it.

    Temporary files of killed runs are removed. The checkpoint is removed when the block ends
    without an error and without `typer.Exit`.

    Args:
        out: Folder or file that the command writes.
        seconds: Time between checkpoints [s]; 0 for none.
        resume: Whether to continue a stopped run.

    Yields:
        The checkpoint, or None if `seconds` is 0 and no run is continued.

    Raises:
        ValueError: A stopped run has left a checkpoint, and `resume` is False.
        OSError: The disk is full.
    """
    from ..runtime.checkpoints import Checkpoint

    with exclusively(out):
        path = checkpoint_path(out)
        for each in _files(out):
            remove_leftovers(each)
        unfinished = unfinished_work(out)
        if unfinished is not None and not resume:
            raise ValueError(
                f"--out = {out}: a stopped run has left {unfinished}. Either {AGAIN}, or remove it"
            )
        checkpoint = None
        if seconds or (resume and unfinished is not None):
            checkpoint = Checkpoint(path, seconds or NEVER_S, opt.note, AGAIN, resume)
        try:
            yield checkpoint
        except OSError as error:
            if error.errno not in DISK_FULL or not is_begun(path, film_path(out)):
                raise
            raise OSError(f"{error}. Free space on the disk, then {AGAIN}") from None
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
        raise KeyboardInterrupt("interrupted after all files were written completely")


def require_begun(resume: bool, begun: Path | None, out: Path) -> None:
    """Raise a ValueError if `resume` is set and no run was stopped."""
    if resume and (begun is None or not is_begun(begun)):
        raise ValueError(f"--resume: no run that writes {out} was stopped. Remove the option")


def recipe_of(scene: Any, sensor: Any, **options: Any) -> dict[str, Any]:
    """Return everything that the result of a command depends on, as values of JSON."""
    import mitsuba as mi

    from ..integrators.render_loop import made_with

    more = {"variant": mi.variant(), "film": str(sensor.film()), **options}
    recipe = made_with(scene, sensor, scene.integrator(), more)
    return json.loads(json.dumps(recipe, default=str))


def run_attribute(recipe: Mapping[str, Any], facts: Mapping[str, Any]) -> dict[str, str]:
    """Return the attribute that `finished_facts` reads from a file of a finished run."""
    return {RUN: json.dumps({"recipe": recipe, "facts": facts})}


def answer_if_finished(
    command: str, out: Path, name: str, recipe: Mapping[str, Any], as_json: bool
) -> bool:
    """Print the result of a run that is finished already, and return whether there is one.

    Args:
        command: Name of the command.
        out: Folder of the command.
        name: File with the attribute of `run_attribute`, or a pattern of such files.
        recipe: Recipe of this run.
        as_json: Whether to print JSON.

    Raises:
        ValueError: `out` is the result of a run with another recipe.
    """
    if unfinished_work(out) is not None:
        return False
    found = _run_of(out, name)
    if found is None:
        return False
    for key in recipe | found["recipe"]:
        before = found["recipe"].get(key)
        now = recipe.get(key)
        if before != now:
            raise ValueError(
                f"--resume: {out} was made with {key} = {opt.checks.quote(before)} instead of "
                f"{opt.checks.quote(now)}. Remove --resume to replace the folder"
            )
    facts = found["facts"] | {"out": str(out)}
    lines = [f"{out}: already complete, {recipe['spp']} samples per pixel"]
    answer(command, as_json, facts, lines)
    return True


def _run_of(out: Path, name: str) -> dict[str, Any] | None:
    """Read the attribute of `run_attribute`; return None if files of the run are missing."""
    import xarray as xr

    from ..io.exr import load_exr_layers

    path = next(iter(sorted(out.glob(name))), None) if out.is_dir() else None
    if path is None:
        return None
    try:
        if path.suffix == ".exr":
            attrs: Mapping[Any, Any] = load_exr_layers(path)[1]
        else:
            with xr.open_dataset(path, engine="scipy") as file:
                attrs = file.attrs
        found = json.loads(attrs[RUN])
        whole = all((out / each).is_file() for each in found["facts"]["files"])
    except (OSError, ValueError, KeyError, TypeError):
        # The file is damaged, or another program has written it
        return None
    return found if whole else None


def checkpoint_path(out: Path) -> Path:
    """Return the path of the hidden checkpoint next to `out`."""
    return sibling(out, ".checkpoint.npz")


def _files(out: Path) -> list[Path]:
    """Return the paths of all checkpoints that belong to `out`: one, or one for each part."""
    path = checkpoint_path(out)
    return [path, *(part_path(path, number) for number in range(PARTS))]


def film_path(out: Path) -> Path:
    """Return the path of the hidden film on the disk next to `out`."""
    return sibling(out, ".zarr")


def unfinished_work(out: Path) -> Path | None:
    """Return the checkpoint or the tiles of a stopped or killed run; None without one."""
    film = film_path(out)
    folder = sibling(film, ".film")
    if any(folder.glob("receipts/tile *")):
        return folder
    return next((each for each in (*_files(out), film) if each.exists()), None)


def is_begun(*begun: Path) -> bool:
    """Return whether a checkpoint exists, or a film on the disk, finished or not."""
    return any(each.exists() or sibling(each, ".film").exists() for each in begun)
