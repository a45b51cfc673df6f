"""Animations: `tofrender render --frames`."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

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


def check(options: dict[str, Any]) -> None:
    """Refuse options that cannot be combined with --frames, and options that require it."""
    of_frames = {"frame_time": None, "exposure": 0.0, "poses": None, "row_time": 0.0}
    if options["frames"] is None:
        for name, default in of_frames.items():
            if options[name] != default:
                raise ValueError(f"--{name.replace('_', '-')} requires --frames")
        return
    if options["frame_time"] is None:
        raise ValueError("--frame-time is missing. Add the time between two frames in seconds")
    wrong = [name for name in ONE_FRAME if options[name]]
    wrong += ["checkpoint"] * (options["checkpoint"] != EVERY_S)
    if wrong:
        raise ValueError(f"--{wrong[0]} cannot be combined with --frames. Remove one of them")
    if options["format"] == "zarr":
        raise ValueError("--format = zarr cannot be combined with --frames. Use another format")
    out = options["out"]
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


def render_frames(job: Job, times: list[float], shutter: Shutter, options: dict[str, Any]) -> None:
    """Render the frames of an animation that are missing in `out`.

    If `out` contains the finished frames of another run, the new frames are written into a hidden
    folder next to `out`. They replace the old frames when all new frames are finished.

    Args:
        job: The render of one frame.
        times: Start of each frame [s].
        shutter: Exposure of a frame.
        options: Options of the command by parameter.
    """
    import numpy as np

    from ..integrators.render_loop import interrupted
    from ..motion.frames import TOTALS, render_frame
    from ..rendering.dataset import components_of
    from ..rendering.job import whole

    out: Path = options["out"]
    files = {k: options[k] for k in ("format", "precision", "video", "figure", "dpi")}
    recipe = job.full_recipe | {"spp": whole(job).count, "times_s": times, **vars(shutter)}
    recipe = json.loads(json.dumps(recipe | files, default=str))
    with exclusively(out):
        folder, listed = _begin(out, recipe, options["resume"])
        if "facts" in listed:
            lines = [f"{out}: already complete, {len(times)} frames"]
            answer("render", options["as_json"], listed["facts"], lines)
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
                    write(frame, folder / f"frame_{k:04d}", **files)
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
        if options["video"]:
            save_video(np.asarray(steady), folder / VIDEO)
        if folder != out:
            atomic.move_into_place(folder, out)
            atomic.remove(folder)
        facts = listed["so_far"] | {"files": sorted(path.name for path in out.iterdir())}
        _store(out / FRAMES_LIST, {"recipe": recipe, "facts": facts})
    frames = f"frame_0000 ... frame_{len(times) - 1:04d}"
    lines = [f"{out}: {frames}" + f", {VIDEO}" * options["video"]]
    answer("render", options["as_json"], facts, lines)


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
    """Refuse to continue frames that were rendered with other settings."""
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
