"""The commands `tofrender capture` and `tofrender reconstruct`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..io.command_files import VOLUME
from ..runtime import backend, checks
from ..runtime.progress import deferred_stop
from . import checkpoints, completion, options as opt
from .answers import Json, answer, dataset_facts

if TYPE_CHECKING:
    import xarray as xr

MODES = ("confocal", "single", "exhaustive")
METHODS = ("lct", "fk", "bp", "fbp", "phasor")
WALL_SCENES = (
    "nlos_z",
    "nlos_bunny",
    "nlos_patch",
    "nlos_plane",
    "nlos_behind_fog",
    "wall_box_sphere_nlos",
    "wall_box_spheres_nlos",
    "wall_box_hi_nlos",
    "wall_box_behind",
    "ourbox_confocal",
)
"""Built-in scenes that can be captured at a relay wall."""

FROM_FILE = "from the file"
"""Default of options that describe measured data."""


@dataclass(frozen=True)
class Points:
    """Options of the points of the wall that are captured, and of their time bins."""

    mode: Annotated[
        str | None,
        opt.choice(MODES, "Capture mode", show_default="from the scene, otherwise confocal"),
    ] = None
    grid: Annotated[
        opt.Size | None,
        opt.size("64x64", "Columns and rows of points on the wall.", show_default=opt.FROM_SCENE),
    ] = None
    wall: Annotated[
        str | None,
        typer.Option(
            metavar="ID",
            help="Shape that is the relay wall; separate several shapes by commas.",
            show_default="from the scene, otherwise the only shape that the sensor sees",
        ),
    ] = None
    bins: Annotated[
        int | None,
        opt.integer(1, checks.MAX_BINS, "Number of time bins", show_default=opt.FROM_SCENE),
    ] = None


@opt.with_groups
def capture(
    scene: Annotated[str, opt.argument("SCENE", "A scene with a relay wall.", completion.scene)],
    out: Annotated[Path, opt.named("FILE", "HDF5 file to write.")],
    *,
    points: Points,
    spp: opt.Spp = None,
    seed: opt.Seed = 0,
    variant: opt.Variant = None,
    processes: opt.Processes,
    stopping: checkpoints.Stopping,
    as_json: Json = False,
) -> None:
    """Capture a hidden scene through its relay wall.

    FILE contains the transient of each point on the wall, and the geometry that reconstruction
    tools need. Until FILE is complete, a checkpoint is kept next to it. Ctrl-C, SIGTERM and SIGHUP
    also write the result so far of a confocal or single capture. With --resume the command
    continues a stopped capture. A complete capture is not changed.

    Examples:
        tofrender capture nlos_z --bins 500 --out wall.h5
        tofrender capture scene.xml --mode single --grid 32x32 --spp 4096 --out wall.h5
    """
    resume = stopping.resume
    if points.bins is not None and processes.are_given:
        raise ValueError(
            f"--bins = {points.bins} is not supported with --workers or --scheduler. Set "
            "temporal_bins in the film of the scene file, or omit --bins"
        )
    opt.check_file_out(out, ".h5", ".hdf5", overwrite=True)
    if out.exists() and not resume:
        raise ValueError(f"--out = {out} exists already. Choose a new file, or add --resume")
    if not out.absolute().parent.is_dir():
        raise ValueError(f"--out = {out}: the folder of the file does not exist. Make it first")
    opt.activate(variant)

    from tofrender import io
    from tofrender.nlos import capture as render_capture
    from tofrender.nlos.capturing import require_same_capture
    from tofrender.nlos.setup import capture_mode
    from tofrender.scenes import BUILT_IN
    from tofrender.scenes.loading import find_scene, load_scene, require_sensor

    source = find_scene(scene)
    wall = points.wall
    names = None if wall is None else [each.strip() for each in wall.split(",")]
    columns, rows = points.grid or (None, None)
    loaded = load_scene(
        source, optimize=False, width=columns, height=rows, temporal_bins=points.bins
    )
    camera: Any = require_sensor(loaded)
    if source in BUILT_IN and source not in WALL_SCENES:
        raise ValueError(
            f"scene = {scene} has no relay wall. Built-in scenes with a relay wall are "
            f"{', '.join(WALL_SCENES)}"
        )
    mode = capture_mode(loaded, camera, points.mode)
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
        checkpoints.checkpointed(out, stopping.checkpoint, resume) as file,
        processes.client() as client,
    ):
        checkpoints.require_begun(resume, file and file.path, out)
        given, grid = (loaded, None) if client is None else (source, points.grid)
        captured = render_capture(
            given, grid=grid, relay_wall=names, checkpoint=file, client=client, **sampling
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
    facts = {"out": out, "mode": captured.attrs["capture_mode"], "rows": rows, "columns": columns}
    return dataset_facts("capture", captured, facts)


@dataclass(frozen=True)
class Measured:
    """Options of measured data in files that do not contain the size of the wall or the times."""

    wall_size: Annotated[
        Any,
        opt.checked(
            opt.sides,
            "Sides of the scanned wall between the first and the last point [m].",
            metavar="SIDE|WIDTH,HEIGHT",
            show_default=FROM_FILE,
        ),
    ] = None
    bin_width_s: Annotated[
        float | None, opt.positive("s", "Width of a time bin [s]", show_default=FROM_FILE)
    ] = None
    start_s: Annotated[
        float | None,
        opt.checked(
            checks.number,
            "Start of the first bin, measured from the time when light leaves the wall [s].",
            metavar="NUMBER",
            show_default=FROM_FILE,
        ),
    ] = None


@opt.with_groups
def reconstruct(
    source: Annotated[
        Path, opt.argument("FILE", "File of `tofrender capture`, or of measured data.")
    ],
    out: opt.Out,
    method: Annotated[str, opt.choice(METHODS, "Reconstruction method")] = "lct",
    *,
    measured: Measured,
    figure: opt.Figure = "png",
    dpi: opt.Dpi = 150,
    processes: opt.Processes,
    as_json: Json = False,
) -> None:
    """Reconstruct the hidden scene of a capture.

    The command writes volume.npz, the brightness and the depth as EXR files, and a picture of the
    volume. Some files of measured data do not contain the size of the wall or the times. Use
    --wall-size, --bin-width-s and --start-s for such files.

    Examples:
        tofrender reconstruct wall.h5 --out hidden
        tofrender reconstruct measured.mat --method fk --wall-size 2 --out hidden
    """
    opt.check_out(out)
    opt.check_apart(out, source)
    for name, value in vars(processes).items():
        if value is not None and method not in ("bp", "fbp"):
            raise ValueError(
                f"--{name} = {value} requires --method bp or fbp, but the method is {method}. "
                "Remove the option, or change the method"
            )
    backend.activate()

    import numpy as np

    from tofrender import io, nlos, vis
    from tofrender.io.npz import save_arrays

    captured = io.load_capture(source, **vars(measured))
    opt.check_disk_space(out, captured["transient"].size)
    with processes.client() as client:
        volume = nlos.reconstruct(captured, method, client=client)
    brightness = nlos.max_projection(volume)
    depth = nlos.depth_map(volume)
    with checkpoints.exclusively(out), io.output_folder(out, overwrite=True) as folder:
        save_arrays(volume, folder / VOLUME)
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
    facts = {
        "out": str(out),
        "files": files,
        "source": str(source),
        "method": method,
        "median_depth": median,
    }
    answer("reconstruct", as_json, facts, [f"{out}: {', '.join(files)}; {where}"])
