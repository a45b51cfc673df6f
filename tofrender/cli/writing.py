"""The files of a render: the transient image, its sum over time, a video and a figure."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import options as opt
from .streaming import placed

if TYPE_CHECKING:
    import xarray as xr


def write(
    dataset: xr.Dataset,
    out: Path,
    format: str,
    precision: str,
    video: bool,
    figure: str,
    dpi: int | None,
) -> list[str]:
    """Write all files into `out`, which appears whole; returns their names.

    Pictures are of S0 where there are Stokes vectors, which have a figure of their own.
    """
    from tofrender import io, vis
    from tofrender.io.files import run_concurrently
    from tofrender.io.output import stack_bytes
    from tofrender.rendering.dataset import components_of, in_channels

    seen, *others = components_of(dataset)

    def summary() -> None:
        page = vis.summary_figure(seen)
        io.save_figure(page, folder / f"summary.{figure}", **opt.dots(dpi))
        if others:
            page = vis.polarisation_figure(dataset["steady"])
            io.save_figure(page, folder / f"polarisation.{figure}", **opt.dots(dpi))

    def transient() -> None:
        _transient(dataset, folder, format, precision, progress=not video)

    def film() -> None:
        io.save_video(seen, folder / "video.mp4")

    needed = stack_bytes(in_channels(dataset)["transient"].shape, precision)
    with io.output_folder(out, overwrite=True, needed_bytes=needed) as folder:
        run_concurrently(summary, transient, *[film] * video)
        if format == "zarr":  # Last, as the film would be lost with the folder if others fail
            placed(dataset, folder / opt.FILES[format])
        return sorted(path.name for path in folder.iterdir())


def _transient(
    dataset: xr.Dataset, folder: Path, format: str, precision: str, progress: bool
) -> None:
    """Write bins and their sum; of bins that stay in Zarr, the sum alone."""
    from tofrender import io, vis
    from tofrender.io.pictures import write_png
    from tofrender.rendering.dataset import components_of

    seen, *others = components_of(dataset)
    bar: Any = {"progress": progress}
    if format == "npz":
        io.save_npz(dataset, folder / opt.FILES[format])
    elif format == "zarr":
        layers = {"": seen["steady"].values}
        if others:
            each = zip(dataset["stokes"].values, components_of(dataset), strict=True)
            layers = {str(name): component["steady"].values for name, component in each}
        io.save_exr_layers(folder / "steady.exr", layers, dataset.attrs)
    elif format == "multipart":
        stack = folder / opt.FILES[format]
        io.save_exr_stack(dataset, stack, layout=format, precision=precision, **bar)
    elif format == "png":
        _move_up(io.save_png_frames(seen, folder / "frames", **bar))
        write_png(vis.tonemap(seen["steady"].values), folder / "steady.png")
    else:
        _move_up(io.save_exr_stack(dataset, folder / "frames", precision=precision, **bar))


def _move_up(folder: Path) -> None:
    """Put what is in a folder beside it."""
    for each in list(folder.iterdir()):
        each.rename(folder.parent / each.name)
    folder.rmdir()
