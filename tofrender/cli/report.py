"""The command `tofrender report`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any
from zipfile import ZipFile

from ..runtime import backend, checks
from . import options as opt

if TYPE_CHECKING:
    import xarray as xr

SUFFIXES = (".html", ".htm")
VOLUME = "volume.npz"  # As `tofrender reconstruct` writes it


def report(
    source: Annotated[
        Path,
        opt.argument(
            "DIR|FILE",
            "What `render`, `capture` or `reconstruct` has written, or an .npz, .exr, .zarr.",
        ),
    ],
    out: Annotated[Path, opt.named("FILE", "HTML file to write.", "--out", "-o")],
    capture: Annotated[
        Path | None, opt.named("FILE", "What a reconstruction was made from: 3D with its wall.")
    ] = None,
    title: Annotated[str | None, opt.named("TEXT", "Title of the page.")] = None,
    megabytes: Annotated[float, opt.positive("megabytes", "Maximum file size [MB].")] = 10.0,
) -> None:
    """One page to explore a render, a capture or a reconstruction.

    FILE opens from disk, without a server or a network: light in time, responses of pixels,
    gates, phasors. The page states how it was reduced, and the accuracy of its values.
    """
    opt.check_file_out(out, *SUFFIXES, overwrite=True)
    backend.activate()
    data = load_intensity(checks.path("DIR|FILE", source))

    from tofrender import io
    from tofrender.apps.explorer.page import report as write

    title = str(title or data.attrs.get("scene") or source.resolve().name)
    captured = None if capture is None else io.load_capture(capture)
    write(data, out, capture=captured, title=title, megabytes=megabytes, overwrite=True)
    opt.say(f"{out}: {out.stat().st_size / 1e6:.1f} MB")


def load_intensity(source: Path) -> xr.Dataset:
    """Load the Dataset of a folder or a file; of Stokes vectors S0."""
    from tofrender.rendering.dataset import components_of

    return components_of(_load(source))[0]


def _load(source: Path) -> xr.Dataset:
    """Load the Dataset of a folder or a file, with Stokes vectors if it has them."""
    from tofrender import io
    from tofrender.rendering.films_on_disk import load_zarr

    loaders: dict[str, Any] = {".npz": io.load_npz, ".exr": io.load_exr_stack}
    loaders |= dict.fromkeys((".h5", ".hdf5"), io.load_capture)
    suffix = source.suffix.lower()
    if source.suffix == ".zarr":
        return load_zarr(source)
    volume = source / VOLUME if source.is_dir() else source
    if volume.name == VOLUME and volume.is_file():
        return _load_volume(volume)
    if source.is_dir():
        return opt.load_render(source, "DIR|FILE")
    if source.is_file() and suffix in loaders:
        return loaders[suffix](source)
    allowed = "a folder of `render` or `reconstruct`, or an .npz, .exr, .zarr, .h5 or .hdf5"
    problem = "is none of these" if source.exists() else "does not exist"
    raise ValueError(f"DIR|FILE = {checks.quote(str(source))}: {problem}; must be {allowed}")


def _load_volume(path: Path) -> xr.Dataset:
    """Load the arrays that `tofrender reconstruct` writes of a volume."""
    import xarray as xr

    from tofrender.runtime.archives import read_array

    try:
        with ZipFile(path) as archive:
            axes = {axis: read_array(archive, axis) for axis in "zyx"}
            shape = tuple(axis.size for axis in axes.values())
            intensity = read_array(archive, "intensity", shape)
            volume = xr.Dataset({"intensity": (("z", "y", "x"), intensity)}, axes)
            for name, axes in (("frame_origin", ("xyz",)), ("frame_axes", ("axis", "xyz"))):
                if f"{name}.npy" in archive.namelist():
                    volume[name] = axes, read_array(archive, name)
    except MemoryError as error:
        raise MemoryError(f"DIR|FILE = {path}: {error}") from None
    except Exception as error:  # Whatever a damaged file makes zipfile, zlib and NumPy raise
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise ValueError(
            f"DIR|FILE = {path}: must be a volume that `tofrender reconstruct` wrote ({reason})"
        ) from None
    return volume
