"""The commands `tofrender capture` and `tofrender reconstruct`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .options import check_out, number, settings_of, split_size
from .time import Out, Seed, Spp, Variant

MODES = ("confocal", "single", "exhaustive")
METHODS = ("lct", "fk", "bp", "fbp", "phasor")


def capture(
    scene: Annotated[str, typer.Argument(metavar="SCENE", help="A scene with a relay wall.")],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="HDF5 file to write.")],
    mode: Annotated[
        str, typer.Option("--mode", metavar="MODE", help=f"One of {', '.join(MODES)}.")
    ] = "confocal",
    grid: Annotated[
        str | None, typer.Option("--grid", metavar="WxH", help="Points on the wall.")
    ] = None,
    wall: Annotated[
        str | None,
        typer.Option("--wall", metavar="ID", help="Shape that is the wall, if not relay_wall."),
    ] = None,
    spp: Spp = None,
    seed: Seed = "0",
    variant: Variant = None,
) -> None:
    """Capture a hidden scene by its relay wall.

    FILE holds the transient of every point, with all geometry, as reconstruction tools read it.
    """
    from tofrender.runtime import backend, checks

    checks.one_of("--mode", mode, MODES)
    given = settings_of(spp=spp)
    size = None
    if grid is not None:
        sides = (number(text) for text in split_size(grid, "--grid", "64x64"))
        width, height = (checks.integer("--grid", side, 1, checks.MAX_SIZE) for side in sides)
        size = (width, height)
    seed_number = checks.integer("--seed", number(seed), 0, checks.MAX_SEED)
    if out.exists():
        raise ValueError(f"--out = {out}: exists already; must be a new file")
    if out.suffix.lower() not in (".h5", ".hdf5"):
        raise ValueError(f"--out = {out}: must end in .h5 or .hdf5")
    if not out.absolute().parent.is_dir():
        raise ValueError(f"--out = {out}: its folder does not exist; must be in one that does")
    backend.activate(variant)
    backend.require_vectorised()

    from tofrender import io
    from tofrender.nlos import capture as render_capture
    from tofrender.scenes.loading import find_scene

    source = find_scene(scene)
    names = None if wall is None else [each.strip() for each in wall.split(",")]
    captured = render_capture(
        source, mode=mode, grid=size, spp=given.get("spp"), seed=seed_number, relay_wall=names
    )
    io.save_capture(captured, out)
    rows, columns = captured["sensor_grid"].shape[:2]
    bins, step = captured.sizes["opl"], captured.attrs["bin_width_opl"]
    typer.echo(f"{out}: {mode}, {columns}x{rows} points, {bins} bins of {1000 * step:g} mm")


def reconstruct(
    source: Annotated[Path, typer.Argument(metavar="FILE", help="What `capture` has written.")],
    out: Out,
    method: Annotated[
        str,
        typer.Option("--method", metavar="NAME", help=f"One of {', '.join(METHODS)}."),
    ] = "lct",
) -> None:
    """Reconstruct the hidden scene of a capture.

    DIR gets volume.npz, brightness and depth as EXR files, and a picture of the volume.
    """
    from tofrender.runtime import checks

    checks.one_of("--method", method, METHODS)
    check_out(out)
    import numpy as np

    from tofrender import io, nlos, vis
    from tofrender.runtime import backend

    captured = io.load_capture(source)
    backend.activate()
    volume = nlos.reconstruct(captured, method)
    brightness, depth = nlos.max_projection(volume), nlos.depth_map(volume)
    with io.output_folder(out, overwrite=True) as folder:
        arrays = {name: volume[name].values for name in (*volume.data_vars, *volume.coords)}
        np.savez_compressed(folder / "volume.npz", **arrays)
        attrs = {"method": method, "units": "m"}
        for name, image in (("brightness", brightness), ("depth", depth)):
            values = np.asarray(image.values, np.float32)[..., None]
            io.save_exr_layers(folder / f"{name}.exr", {"": values}, attrs)
        vis.reconstruction_figure(volume).savefig(folder / "volume.png", dpi=150)
    seen = depth.values[np.isfinite(depth.values)]
    where = f"median depth {np.median(seen):.3f} m" if seen.size else "nothing found"
    typer.echo(f"{out}: volume.npz, brightness.exr, depth.exr, volume.png; {where}")
