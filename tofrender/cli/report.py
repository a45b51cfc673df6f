"""The command `tofrender report`."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any
from zipfile import ZipFile

import typer

from ..io.command_files import FRAMES_LIST, GATE, PHASORS, RANGE_RATE, SENSED, VOLUME
from ..runtime import backend, checks
from . import options as opt

if TYPE_CHECKING:
    import xarray as xr

SUFFIXES = (".html", ".htm")
MEGABYTES = partial(checks.number, low=0.1, high=1000)


def report(
    source: Annotated[
        Path,
        opt.argument(
            "DIR|FILE",
            "Folder or file of `render`, `capture`, `reconstruct`, `phasor`, `gate`, `fmcw` or "
            "`sense`. Suffixes of files are .npz, .exr, .zarr, .h5 and .nc.",
        ),
    ],
    out: Annotated[Path, opt.named("FILE", "HTML file to write.", "--out", "-o")],
    capture: Annotated[
        Path | None,
        opt.named("FILE", "Capture of a reconstruction, to show its relay wall in 3D."),
    ] = None,
    title: Annotated[
        str | None,
        typer.Option(
            metavar="TEXT",
            help="Title of the page.",
            show_default="name of the scene or of the source",
        ),
    ] = None,
    megabytes: Annotated[
        float,
        opt.checked(MEGABYTES, "Largest size of the page [MB] (0.1 to 1000).", metavar="NUMBER"),
    ] = 10.0,
) -> None:
    """Make an HTML page to explore a result.

    The page shows light in time, responses of pixels, gates and phasors. It opens from the disk
    without a server or a network. If the data are too large, they are reduced, and the page states
    how, and the accuracy of its values.

    Examples:
        tofrender report box -o box.html
        tofrender report hidden --capture wall.h5 -o hidden.html
    """
    opt.check_file_out(out, *SUFFIXES, overwrite=True)
    backend.activate()
    data = load_result(checks.path("DIR|FILE", source))

    from tofrender import io
    from tofrender.apps.explorer.single_page import report as write

    title = str(title or data.attrs.get("scene") or source.resolve().name)
    captured = None if capture is None else io.load_capture(capture)
    write(data, out, capture=captured, title=title, megabytes=megabytes, overwrite=True)
    opt.say(f"{out}: {out.stat().st_size / 1e6:.1f} MB")


def load_result(source: Path) -> xr.Dataset:
    """Load the Dataset of a folder or a file, with all Stokes components."""
    from tofrender import io
    from tofrender.io.netcdf import load_measurement
    from tofrender.rendering.films_on_disk import load_zarr

    loaders: dict[str, Any] = {
        ".npz": io.load_npz,
        ".exr": io.load_exr_stack,
        ".h5": io.load_capture,
        ".hdf5": io.load_capture,
        ".nc": load_measurement,
    }
    suffix = source.suffix.lower()
    if source.suffix == ".zarr":
        return load_zarr(source)
    volume = source / VOLUME if source.is_dir() else source
    if volume.name == VOLUME and volume.is_file():
        return _load_volume(volume)
    if source.is_dir():
        if (source / FRAMES_LIST).is_file():
            return _load_frames(source)
        for name in (SENSED, RANGE_RATE):
            if (source / name).is_file():
                return load_measurement(source / name)
        if (source / GATE).is_file():
            return _load_gate(source / GATE)
        if phasors := sorted(source.glob(PHASORS)):
            return _load_phasors(phasors)
        return opt.load_render(source, "DIR|FILE")
    if source.is_file() and suffix in loaders:
        return loaders[suffix](source)
    problem = "does not contain a result" if source.exists() else "does not exist"
    raise ValueError(
        f"DIR|FILE = {checks.quote(str(source))} {problem}. Use a folder of `render`, "
        "`reconstruct`, `phasor`, `gate`, `fmcw` or `sense`, or a file .npz, .exr, .zarr, .h5, "
        ".hdf5 or .nc"
    )


def _load_frames(folder: Path) -> xr.Dataset:
    """Load the finished frames of `tofrender render --frames` along an axis `frame`."""
    from tofrender.motion.frames import join_frames
    from tofrender.runtime import memory

    folders = sorted(each for each in folder.glob("frame_*") if each.is_dir())
    if not folders:
        raise ValueError(
            f"DIR|FILE = {checks.quote(str(folder))} does not contain finished frames. Continue "
            "the render with --resume"
        )
    first = opt.load_render(folders[0], "DIR|FILE")
    memory.require_free(f"DIR|FILE = {folder}", 2 * first.nbytes * len(folders))
    frames = [first, *(opt.load_render(each, "DIR|FILE") for each in folders[1:])]
    shapes = {tuple(each["transient"].shape) for each in frames}
    timed = all("time_s" in each.attrs for each in frames)
    checks.require("DIR|FILE", str(folder), timed and len(shapes) == 1, "frames of one animation")
    return join_frames(frames, complete=all(each.attrs["complete"] for each in frames))


def _load_gate(path: Path) -> xr.Dataset:
    """Load the picture of `tofrender gate` as a transient with one bin.

    The bin has the area and the height of the Gaussian gate.
    """
    import numpy as np
    import xarray as xr

    from tofrender.io.exr import load_exr_layers

    layers, attrs, (x0, y0) = load_exr_layers(path)
    image = layers[""][:, :, None]
    center = float(attrs["opl"])
    width = math.sqrt(2 * math.pi) * float(attrs["pulse_width_opl"])
    height, columns, _, channels = image.shape
    axes = {
        "y": y0 + np.arange(height),
        "x": x0 + np.arange(columns),
        "opl": [center],
        "channel": list("RGB" if channels == 3 else "L"),
    }
    attributes = {
        "quantity": "radiance per meter",
        "start_opl": center - width / 2,
        "bin_width_opl": width,
        "units": attrs["units"],
        "spp": attrs["spp"],
        "pulse": f"Gaussian gate, standard deviation {attrs['pulse_width_opl']} m",
    }
    return xr.Dataset({"transient": (tuple(axes), image)}, axes, attributes)


def _load_phasors(paths: list[Path]) -> xr.Dataset:
    """Load I and Q from the files that `tofrender phasor` wrote."""
    import numpy as np
    import xarray as xr

    from tofrender.io.exr import load_exr_layers

    files = [load_exr_layers(path) for path in paths]
    files.sort(key=lambda file: float(file[1]["frequency_hz"]))
    shapes = {(layers["I"].shape, first) for layers, _, first in files}
    if len(shapes) > 1:
        raise ValueError(
            f"the phasor files have different shapes or first pixels, {sorted(shapes)}. Pass files "
            "of one render"
        )
    (((height, width, channels), (x0, y0)),) = shapes
    dims = ("frequency", "y", "x", "channel")
    parts = {k: (dims, np.stack([layers[k] for layers, *_ in files])) for k in "IQ"}
    axes = {
        "frequency": [float(attrs["frequency_hz"]) for _, attrs, _ in files],
        "y": y0 + np.arange(height),
        "x": x0 + np.arange(width),
        "channel": list("RGB" if channels == 3 else "L"),
    }
    return xr.Dataset(parts, axes)


def _load_volume(path: Path) -> xr.Dataset:
    """Load the volume that `tofrender reconstruct` has written."""
    import xarray as xr

    from tofrender.runtime.archives import read_array

    try:
        with ZipFile(path) as archive:
            axes = {axis: read_array(archive, axis) for axis in "zyx"}
            shape = tuple(axis.size for axis in axes.values())
            intensity = read_array(archive, "intensity", shape)
            names = {"xyz": list("xyz"), "axis": list("xyz")}
            volume = xr.Dataset({"intensity": (("z", "y", "x"), intensity)}, axes | names)
            for name, axes in (("frame_origin", ("xyz",)), ("frame_axes", ("axis", "xyz"))):
                if f"{name}.npy" in archive.namelist():
                    volume[name] = axes, read_array(archive, name)
    except MemoryError as error:
        raise MemoryError(f"DIR|FILE = {path}: {error}") from None
    except Exception as error:
        # A damaged file can make zipfile, zlib and NumPy raise many kinds of errors
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise ValueError(
            f"DIR|FILE = {path}: must be a volume that `tofrender reconstruct` wrote ({reason})"
        ) from None
    return volume
