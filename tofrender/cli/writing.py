"""Files of a render (transient, sum, video, figures), and the command `tofrender merge`."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ..io.command_files import FORMATS
from ..runtime import backend
from ..runtime.progress import deferred_stop
from . import options as opt
from .checkpoints import exclusively

if TYPE_CHECKING:
    import xarray as xr


@opt.with_groups
def merge(
    sources: Annotated[list[Path], opt.argument("DIR...", "Folders of `tofrender render`.")],
    out: opt.Out,
    files: opt.Files,
) -> None:
    """Join renders of one scene with different seeds.

    The renders may come from several machines. Each render is weighted by its samples per pixel.
    Error bars are joined if all renders contain them. They are estimated from the differences of
    the renders if there are four or more.

    Examples:
        tofrender merge seed_1 seed_2 --out joined
        tofrender merge seed_1 seed_2 seed_3 seed_4 --out joined --format npz
    """
    opt.check_out(out)
    backend.activate()

    from tofrender.rendering.dataset import in_channels
    from tofrender.rendering.merging import merge as join

    renders = []
    for source in sources:
        if source.resolve() == out.resolve():
            raise ValueError(f"--out = {out} is one of the joined folders. Choose another folder")
        renders.append(opt.load_render(source, "DIR"))
    merged = join(renders)
    height, width, bins, channels = in_channels(merged)["transient"].shape
    opt.check_out(out, (height, width, bins, channels), files.precision)
    with exclusively(out), deferred_stop():
        written = write(merged, out, files)
    names = [name for name in written if not name.startswith("frame_")]
    opt.say(f"{out}: {merged.attrs['spp']} samples per pixel, {', '.join(names)}")


def write(dataset: xr.Dataset, out: Path, files: opt.Files) -> list[str]:
    """Write all files of a render into the folder `out`, and return their names.

    The folder appears when all files are complete. Pictures of polarized renders show S0, and
    another figure shows the polarization.
    """
    from tofrender import io, vis
    from tofrender.io.files import run_concurrently
    from tofrender.io.output import stack_bytes
    from tofrender.rendering.dataset import in_channels
    from tofrender.rendering.stored_film import save_zarr

    def write_figures() -> None:
        page = vis.summary_figure(dataset)
        io.save_figure(page, folder / f"summary.{files.figure}", **opt.dots(files.dpi))
        if "stokes" in dataset.dims:
            page = vis.polarization_figure(dataset["steady"])
            io.save_figure(page, folder / f"polarization.{files.figure}", **opt.dots(files.dpi))

    needed = stack_bytes(in_channels(dataset)["transient"].shape, files.precision)
    with io.output_folder(out, overwrite=True, needed_bytes=needed) as folder:
        write_transient = partial(_write_transient, dataset, folder, files)
        write_video = partial(io.save_video, dataset, folder / "video.mp4")
        run_concurrently(write_figures, write_transient, *[write_video] * files.video)
        if files.format == "zarr":
            # The film moves last. If another file failed, the film would be lost with the folder.
            film = dataset.encoding.get("source")
            target = folder / FORMATS[files.format]
            if film is None:
                save_zarr(dataset, target)
            else:
                os.rename(film, target)
        return sorted(path.name for path in folder.iterdir())


def _write_transient(dataset: xr.Dataset, folder: Path, files: opt.Files) -> None:
    """Write the time bins and their sum. For Zarr, write the sum only."""
    from tofrender import io, vis
    from tofrender.io.pictures import write_png
    from tofrender.rendering.dataset import components_of

    components = components_of(dataset)
    format = files.format
    bar: Any = {"progress": not files.video}
    if format == "npz":
        io.save_npz(dataset, folder / FORMATS[format])
    elif format == "zarr":
        names = dataset["stokes"].values if len(components) > 1 else [""]
        each = zip(names, components, strict=True)
        layers = {str(name): component["steady"].values for name, component in each}
        first = int(dataset["x"][0]), int(dataset["y"][0])
        io.save_exr_layers(folder / "steady.exr", layers, dataset.attrs, first_pixel=first)
    elif format == "multipart":
        stack = folder / FORMATS[format]
        io.save_exr_stack(dataset, stack, layout=format, precision=files.precision, **bar)
    elif format == "png":
        _move_up(io.save_png_frames(dataset, folder / "frames", **bar))
        write_png(vis.tonemap(components[0]["steady"].values), folder / "steady.png")
    else:
        _move_up(io.save_exr_stack(dataset, folder / "frames", precision=files.precision, **bar))


def _move_up(folder: Path) -> None:
    """Move the content of a folder to its parent."""
    for each in list(folder.iterdir()):
        each.rename(folder.parent / each.name)
    folder.rmdir()
