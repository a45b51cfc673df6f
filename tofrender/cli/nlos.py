"""The commands `tofrender capture` and `tofrender reconstruct`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ..io.contents import VOLUME
from ..runtime import backend, checks
from ..runtime.progress import EVERY_S, deferred_stop
from . import checkpoints, completion, options as opt
from .answers import Json, answer, dataset_facts

if TYPE_CHECKING:
    import xarray as xr

MODES = ("confocal", "single", "exhaustive")
METHODS = ("lct", "fk", "bp", "fbp", "phasor")


def capture(
    scene: Annotated[str, opt.argument("SCENE", "A scene with a relay wall.", completion.scene)],
    out: Annotated[Path, opt.named("FILE", "HDF5 file to write.")],
    mode: Annotated[
        str | None,
        opt.choice(MODES, "Capture mode.", show_default="the scene's, otherwise confocal"),
    ] = None,
    grid: Annotated[opt.Size | None, opt.size("64x64", "Points on the wall.")] = None,
    wall: Annotated[
        str | None, opt.named("ID", "Shape that is the wall, if not relay_wall.")
    ] = None,
    spp: opt.Spp = None,
    seed: opt.Seed = 0,
    variant: opt.Variant = None,
    workers: opt.Workers = None,
    scheduler: opt.Scheduler = None,
    checkpoint: checkpoints.Seconds = EVERY_S,
    resume: checkpoints.Resume = False,
    as_json: Json = False,
) -> None:
    """Capture a hidden scene by its relay wall.

    FILE holds the transient of every point, with all geometry, as reconstruction tools read it.
    A checkpoint is kept beside it; Ctrl-C, SIGTERM and SIGHUP also write a confocal or single
    capture so far. --resume continues a stopped capture; a complete one is not changed.
    """
    opt.check_client(workers, scheduler)
    opt.check_file_out(out, ".h5", ".hdf5", overwrite=True)
    if out.exists() and not resume:
        raise ValueError(f"--out = {out}: exists already; must be a new file")
    if not out.absolute().parent.is_dir():
        raise ValueError(f"--out = {out}: its folder does not exist; must be in one that does")
    opt.activate(variant)

    from tofrender import io
    from tofrender.nlos import capture as render_capture
    from tofrender.nlos.capturing import require_same_capture
    from tofrender.nlos.setup import capture_mode
    from tofrender.scenes.loading import find_scene, load_scene, require_sensor

    source = find_scene(scene)
    names = None if wall is None else [each.strip() for each in wall.split(",")]
    columns, rows = grid or (None, None)
    loaded = load_scene(source, optimize=False, width=columns, height=rows)
    camera: Any = require_sensor(loaded)
    mode = capture_mode(loaded, camera, mode)
    sampling: dict[str, Any] = {"mode": mode, "spp": spp, "seed": seed}
    shape = getattr(camera.film(), "shape", None)
    if shape is not None:
        lasers = shape[0] * shape[1] if mode == "exhaustive" else 1
        opt.check_disk_space(out, math.prod(shape) * lasers)
    if resume and out.exists() and checkpoints.unfinished_work(out) is None:
        found = io.load_capture(out)
        if found.attrs.get("complete", 1):
            require_same_capture(found, loaded, grid=None, sensor=0, wall=names, **sampling)
            line = f"{out}: already complete, {found.attrs['spp']} samples per pixel"
            answer("capture", as_json, _facts(found, out), [line])
            return
    with (
        checkpoints.checkpointed(out, checkpoint, resume) as file,
        opt.client_of(workers, scheduler) as client,
    ):
        checkpoints.require_begun(resume, file and file.path, out)
        given, points = (loaded, None) if client is None else (source, grid)
        captured = render_capture(
            given, grid=points, relay_wall=names, checkpoint=file, client=client, **sampling
        )
        captured.attrs["scene"] = str(source)
        with deferred_stop() as stop:
            io.save_capture(captured, out, overwrite=resume)
        facts = _facts(captured, out)
        step = f"{facts['bins']} bins of {1000 * facts['bin_width']:g} mm"
        line = f"{out}: {mode}, {facts['columns']}x{facts['rows']} points, {step}"
        if facts["complete"] or as_json:
            answer("capture", as_json, facts, [line])
        checkpoints.end_if_incomplete(captured.attrs)
    checkpoints.end_if_stopped(stop)


def _facts(captured: xr.Dataset, out: Path) -> dict[str, Any]:
    rows, columns = captured["sensor_grid"].shape[:2]
    return dataset_facts("capture", captured, {"out": out, "rows": rows, "columns": columns})


def reconstruct(
    source: Annotated[Path, opt.argument("FILE", "What `capture` wrote, or measured data.")],
    out: opt.Out,
    method: Annotated[str, opt.choice(METHODS, "How to reconstruct.")] = "lct",
    wall_size: Annotated[
        Any, opt.checked(opt.sides, "Sides of the scanned wall [m].", metavar="SIDE|WIDTH,HEIGHT")
    ] = None,
    bin_width_s: Annotated[float | None, opt.positive("s", "Width of a bin [s].")] = None,
    start_s: Annotated[
        float | None, opt.checked(checks.number, "Start of the first bin [s].", metavar="<float>")
    ] = None,
    figure: opt.Figure = "png",
    dpi: opt.Dpi = 150,
    workers: opt.Workers = None,
    scheduler: opt.Scheduler = None,
    as_json: Json = False,
) -> None:
    """Reconstruct the hidden scene of a capture.

    DIR gets volume.npz, brightness and depth as EXR files, and a picture of the volume. Of measured
    data whose files do not state them, the options say the sides of the wall, from the first to the
    last point, and times, which begin when light has met the wall.
    """
    opt.check_client(workers, scheduler)
    opt.check_out(out)
    opt.check_apart(out, source)
    for name, value in (("workers", workers), ("scheduler", scheduler)):
        if value is not None and method not in ("bp", "fbp"):
            raise ValueError(f"{name} = {value}: must be left out with `method={method}`")
    backend.activate()

    import numpy as np

    from tofrender import io, nlos, vis

    captured = io.load_capture(
        source, wall_size=wall_size, bin_width_s=bin_width_s, start_s=start_s
    )
    opt.check_disk_space(out, captured["transient"].size)
    with opt.client_of(workers, scheduler) as client:
        volume = nlos.reconstruct(captured, method, client=client)
    brightness, depth = nlos.max_projection(volume), nlos.depth_map(volume)
    with checkpoints.exclusively(out), io.output_folder(out, overwrite=True) as folder:
        arrays: dict[str, Any] = {str(name): v.values for name, v in volume.variables.items()}
        np.savez_compressed(folder / VOLUME, **arrays)
        images = (("brightness", brightness, "arbitrary"), ("depth", depth, "m"))
        for name, image, units in images:
            values = np.asarray(image.values, np.float32)[..., None]
            attrs = {"method": method, "units": units}
            io.save_exr_layers(folder / f"{name}.exr", {"": values}, attrs)
        drawn = vis.reconstruction_figure(volume)
        io.save_figure(drawn, folder / f"volume.{figure}", **opt.dots(dpi))
    seen = depth.values[np.isfinite(depth.values)]
    median = float(np.median(seen)) if seen.size else None
    where = "nothing found" if median is None else f"median depth {median:.3f} m"
    files = [VOLUME, "brightness.exr", "depth.exr", f"volume.{figure}"]
    facts = {"out": str(out), "files": files, "source": str(source), "method": method}
    facts |= {"median_depth": median}
    answer("reconstruct", as_json, facts, [f"{out}: {', '.join(files)}; {where}"])
