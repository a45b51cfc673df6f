"""Animations: `tofrender render --frames`."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ..io.command_files import FRAMES_LIST, FRAMES_STEADY, VIDEO, is_listed
from ..runtime import atomic
from ..runtime.progress import EVERY_S, ProgressBar, deferred_stop
from . import options as opt
from .answers import answer, render_facts
from .checkpoints import AGAIN, end_if_stopped, exclusively
from .writing import write

if TYPE_CHECKING:
    import numpy as np

    from ..motion.frames import Shutter
    from ..rendering.job import Job

COMMAND = "render --frames"
ONE_FRAME = ("workers", "scheduler", "errors", "denoise")
"""Options that cannot be combined with --frames."""

FPS = 10
"""Frames per second of the video."""


@dataclass(frozen=True)
class Animation:
    """Options of an animation."""

    frames: Annotated[
        int | None,
        opt.integer(1, 10_000, "Number of frames of an animation", show_default="a single render"),
    ] = None
    frame_time: Annotated[
        float | None,
        opt.positive("seconds", "Time between two frames [s], required with --frames"),
    ] = None
    exposure: Annotated[
        float, opt.real(0, "With --frames, exposure time of each row of pixels [s]")
    ] = 0.0
    poses: Annotated[
        int | None,
        opt.integer(
            1, 4096, "With --frames, poses of the scene in each exposure", show_default="8"
        ),
    ] = None
    row_time: Annotated[
        float, opt.real(0, "With --frames, delay from one row of pixels to the next [s]")
    ] = 0.0

    def __post_init__(self) -> None:
        # The other options require --frames, and --frames requires --frame-time
        if self.frames is None:
            for each in fields(self):
                if getattr(self, each.name) != each.default:
                    raise ValueError(f"--{each.name.replace('_', '-')} requires --frames")
        elif self.frame_time is None:
            raise ValueError("--frame-time is missing. Add the time between two frames in seconds")

    @property
    def times(self) -> list[float]:
        """Start of each frame [s]; empty for a single render."""
        return [k * (self.frame_time or 0.0) for k in range(self.frames or 0)]


def check_single(out: Path, files: opt.Files, options: Mapping[str, Any]) -> None:
    """Raise a ValueError for options that cannot be combined with --frames.

    Args:
        out: Folder to write.
        files: Options of the files.
        options: Values of other options by name.
    """
    wrong = [name for name in ONE_FRAME if options[name]]
    wrong += ["checkpoint"] * (options["checkpoint"] != EVERY_S)
    if wrong:
        raise ValueError(f"--{wrong[0]} cannot be combined with --frames. Remove one of them")
    if files.format == "zarr":
        raise ValueError("--format = zarr cannot be combined with --frames. Use another format")
    foreign = _foreign(out)
    if foreign or out.is_file():
        what = f"contains other files ({foreign[0]})" if foreign else "is a file"
        raise ValueError(f"--out = {out} {what}. Use a new folder, or a folder of frames")
    opt.check_out(out / "frame_0000")


def _foreign(out: Path) -> list[str]:
    """Return the names of files in a folder that this command did not write.

    Temporary files of a killed run count as files of the command.
    """
    if not out.is_dir():
        return []
    names = [path.name for path in out.iterdir()]
    names = [name for name in names if not name.startswith(atomic.TEMPORARY_PREFIX)]
    if (out / FRAMES_LIST).exists():
        names = [name for name in names if not is_listed(name, commands=(COMMAND,))]
    return sorted(names)


def render_frames(
    job: Job,
    times: list[float],
    shutter: Shutter,
    *,
    out: Path,
    files: opt.Files,
    resume: bool,
    as_json: bool,
) -> None:
    """Render the frames of an animation that are missing in `out`.

    If `out` contains the finished frames of another run, the new frames are written into a hidden
    folder next to `out`. They replace the old frames when all new frames are finished.

    Args:
        job: The render of one frame.
        times: Start of each frame [s].
        shutter: Exposure of a frame.
        out: Folder to write.
        files: Options of the files of each frame.
        resume: Whether to continue a stopped run.
        as_json: Whether to print the result as a JSON object.
    """
    import numpy as np

    from ..integrators.render_loop import interrupted
    from ..motion.frames import TOTALS, render_frame
    from ..rendering.dataset import components_of
    from ..rendering.job import whole

    recipe = job.full_recipe | {"spp": whole(job).count, "times_s": times, **vars(shutter)}
    recipe = json.loads(json.dumps(recipe | vars(files), default=str))
    with exclusively(out):
        folder, listed = _begin(out, recipe, resume)
        if "facts" in listed:
            lines = [f"{out}: already complete, {len(times)} frames"]
            answer("render", as_json, listed["facts"], lines)
            return
        if not (folder / FRAMES_STEADY).exists():
            shape = (len(times), *job.film.shape[:2], job.film.base_channels_count())
            with atomic.replacing(folder / FRAMES_STEADY) as temporary:
                np.lib.format.open_memmap(temporary, "w+", np.float32, shape)[:] = np.nan
        steady = np.lib.format.open_memmap(folder / FRAMES_STEADY, mode="r+")
        left = [k for k in range(len(times)) if np.isnan(steady[k]).any()]
        with ProgressBar("Rendering", len(times)) as bar:
            bar.update(len(times) - len(left))
            for k in left:
                try:
                    frame = render_frame(job, times[k], shutter)
                except KeyboardInterrupt:
                    done = interrupted(bar.n, len(times), "frames", AGAIN)
                    raise KeyboardInterrupt(done) from None
                with deferred_stop() as stop:
                    write(frame, folder / f"frame_{k:04d}", files)
                    facts = render_facts(frame, out, [])
                    so_far = listed["so_far"]
                    for name, total in TOTALS.items():
                        facts[name] = total([facts[name], so_far.get(name, 0.0)])
                    listed["so_far"] = facts
                    _store(folder / FRAMES_LIST, listed)
                    steady[k] = components_of(frame)[0]["steady"].values
                    steady.flush()
                if k != left[-1]:
                    end_if_stopped(stop)
                bar.update()
        if files.video:
            save_video(np.asarray(steady), folder / VIDEO)
        if folder != out:
            atomic.move_into_place(folder, out)
            atomic.remove(folder)
        facts = listed["so_far"] | {"files": sorted(path.name for path in out.iterdir())}
        _store(out / FRAMES_LIST, {"recipe": recipe, "facts": facts})
    frames = f"frame_0000 ... frame_{len(times) - 1:04d}"
    lines = [f"{out}: {frames}" + f", {VIDEO}" * files.video]
    answer("render", as_json, facts, lines)


def _begin(out: Path, recipe: dict[str, Any], resume: bool) -> tuple[Path, dict[str, Any]]:
    """Begin or resume a run.

    Returns:
        The folder of the frames, and the content of its list.
    """
    folder = out
    earlier = _listed(out)
    hidden = atomic.sibling(out, ".frames")

    # Remove a hidden folder without frames, or with finished frames that were moved already
    listed = _listed(hidden)
    if "facts" in listed or not listed:
        atomic.remove(hidden)
    for each in (out, hidden):
        _remove_temporary_files(each)

    # Choose the folder of the frames
    if hidden.exists() or ("facts" in earlier and not resume):
        folder = hidden
        earlier = _listed(hidden)
    if resume and not earlier:
        raise ValueError(f"--resume: {out} does not contain frames. Remove the option")
    if earlier and not resume:
        raise ValueError(
            f"--out = {out}: a stopped run has left frames in {folder}. Either {AGAIN}, or remove "
            "the folder"
        )

    # Begin a list of frames, or compare the existing list
    if earlier:
        _require_same(folder, earlier["recipe"], recipe)
    else:
        folder.mkdir(parents=True, exist_ok=True)
        _store(folder / FRAMES_LIST, {"recipe": recipe})
    return folder, {"recipe": recipe, "so_far": {}} | earlier


def _remove_temporary_files(folder: Path) -> None:
    """Remove the temporary files of a killed run from a folder of frames."""
    if not (folder / FRAMES_LIST).exists():
        return
    for path in folder.glob(f"{atomic.TEMPORARY_PREFIX}*"):
        atomic.remove(path)


def _listed(folder: Path) -> dict[str, Any]:
    """Return the content of a folder's list of frames; an empty one without a list."""
    path = folder / FRAMES_LIST
    return json.loads(path.read_text()) if path.exists() else {}


def _require_same(out: Path, earlier: dict[str, Any], recipe: dict[str, Any]) -> None:
    """Raise a ValueError if the frames to continue were rendered with other settings."""
    for name, value in recipe.items():
        if earlier.get(name) != value:
            raise ValueError(
                f"--resume: the frames in {out} have {name} = "
                f"{opt.checks.quote(earlier.get(name))} instead of {opt.checks.quote(value)}. "
                "Use the same options, or another folder"
            )


def _store(path: Path, content: dict[str, Any]) -> None:
    with atomic.replacing(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1))


def save_video(steady: np.ndarray, path: Path) -> None:
    """Write a video of pictures with one exposure for all.

    Args:
        steady: Pictures (frame, height, width, channel).
        path: File to write. Its suffix chooses the format.
    """
    from PIL import Image

    from ..io.pictures import encode_video
    from ..vis import tonemap

    count, height, width, channels = steady.shape
    pictures = tonemap(steady.reshape(count * height, width, channels))
    scale = 2 * math.ceil(192 / min(height, width))  # Even sides of at least 384 pixels
    size = scale * width, scale * height
    enlarged = (
        Image.fromarray(each).resize(size, Image.Resampling.NEAREST)
        for each in pictures.reshape(count, height, width, 3)
    )
    with atomic.replacing(path) as temporary:
        encode_video(enlarged, count, size, temporary, path.suffix, FPS)
