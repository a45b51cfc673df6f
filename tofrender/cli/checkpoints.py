"""Checkpoints of commands that take long: they can be stopped, killed, and go on."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..runtime.atomic import DISK_FULL, locked, part_path, remove, remove_leftovers, sibling
from ..runtime.progress import Stop
from . import options as opt
from .answers import answer

if TYPE_CHECKING:
    from ..runtime.checkpoints import Checkpoint

Seconds = Annotated[float, opt.real(0, "Seconds of work between checkpoints; 0: never.")]
Resume = Annotated[bool, opt.switch("--resume", "Continue a stopped or killed run, up to --spp.")]

NEVER_S = 1e9
PARTS = 2  # Poses of `tofrender doppler`
AGAIN = "the same command with --resume goes on"
RUN = "run"  # Attribute of a written file: recipe and facts of the run, as JSON


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


def recipe_of(scene: Any, sensor: Any, **options: Any) -> dict[str, Any]:
    """Return everything that the result of a command depends on, as JSON can hold it."""
    import mitsuba as mi

    from ..integrators.running import made_with

    more = {"variant": mi.variant(), "film": str(sensor.film()), **options}
    recipe = made_with(scene, sensor, scene.integrator(), more)
    return json.loads(json.dumps(recipe, default=str))


def run_attribute(recipe: Mapping[str, Any], facts: Mapping[str, Any]) -> dict[str, str]:
    """Return the attribute that `finished_facts` reads from a file of a finished run."""
    return {RUN: json.dumps({"recipe": recipe, "facts": facts})}


def answer_if_finished(
    command: str, out: Path, name: str, recipe: Mapping[str, Any], as_json: bool
) -> bool:
    """Answer for a run that `--resume` finds finished; return whether there is one.

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
                f"--resume: {out} was made with {key} = {opt.checks.quote(before)}; must be "
                f"{opt.checks.quote(now)}. Leave out --resume to replace the folder"
            )
    facts = found["facts"] | {"out": str(out)}
    lines = [f"{out}: already complete, {recipe['spp']} samples per pixel"]
    answer(command, as_json, facts, lines)
    return True


def _run_of(out: Path, name: str) -> dict[str, Any] | None:
    """Read the attribute of `run_attribute`; None if no finished run has written all its files."""
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
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
    ):  # The file is damaged, or another program wrote it
        return None
    return found if whole else None


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
