"""The command `tofrender merge`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from . import options as opt
from .keeping import alone
from .writing import write


def merge(
    sources: Annotated[
        list[Path], typer.Argument(metavar="DIR...", help="What `tofrender render` has written.")
    ],
    out: opt.Out,
    format: opt.Format = "frames",
    precision: opt.Precision = "float",
    video: opt.Video = True,
    figure: opt.Figure = "png",
    dpi: opt.Dpi = None,
) -> None:
    """Join renders of one scene with other seeds, from any machines.

    Each counts by its samples per pixel. Error bars are joined where all have them, and measured
    where there are four renders or more.
    """
    opt.check_format(format, precision)
    opt.check_out(out)
    from tofrender.runtime import backend

    backend.activate()
    from tofrender.rendering.dataset import in_channels
    from tofrender.rendering.merging import merge as join
    from tofrender.runtime.progress import deferred_stop

    renders = []
    for source in sources:
        if source.resolve() == out.resolve():
            raise ValueError(f"--out = {out}: is among what is joined; must be another folder")
        renders.append(opt.load_render(source, "DIR"))
    merged = join(renders)
    height, width, bins, channels = in_channels(merged)["transient"].shape
    opt.check_out(out, (height, width, bins, channels), precision)
    with alone(out), deferred_stop():
        files = write(merged, out, format, precision, video, figure, dpi)
    names = [name for name in files if not name.startswith("frame_")]
    opt.say(f"{out}: {merged.attrs['spp']} samples per pixel, {', '.join(names)}")
