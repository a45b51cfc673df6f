"""The command `tofrender warp`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from ..runtime import checks
from ..runtime.canvas import FIGURE_SUFFIXES
from .options import (
    Dpi,
    Seed,
    Variant,
    check_apart,
    check_file_out,
    choice,
    dots,
    integer,
    real,
    say,
)

Warp = Literal[
    "tent",
    "uniform_disk",
    "uniform_sphere",
    "uniform_hemisphere",
    "cosine_hemisphere",
    "beckmann",
    "hierarchical",
]
PointSet = Literal["independent", "grid", "stratified"]


def warp(
    name: Annotated[Warp, choice(Warp, "What to draw.", kind=typer.Argument)],
    out: Annotated[Path, typer.Option(metavar="FIG", help="Figure to write: png, pdf, svg.")],
    alpha: Annotated[float | None, real(0, "Roughness of beckmann.")] = None,
    image: Annotated[
        str | None, typer.Option(metavar="FILE", help="Image of hierarchical.")
    ] = None,
    points: Annotated[PointSet, choice(PointSet, "Point set to draw.")] = "independent",
    count: Annotated[int, integer(1, checks.MAX_SPP, "Points to draw.")] = 1024,
    dpi: Dpi = None,
    seed: Seed = 0,
    variant: Variant = None,
) -> None:
    """Warp points of the unit square, draw them and their density, and test one against the other.

    The chi-square test takes a million independent points, whichever are drawn. If the warp fails
    it, the exit status is 1.
    """
    from tofrender.runtime import backend

    check_file_out(out, *FIGURE_SUFFIXES, overwrite=True)
    if image is not None:
        check_apart(out, Path(image))
    backend.activate(variant)
    backend.require_vectorised()

    from tofrender.sampling.cases import warp_case
    from tofrender.sampling.domains import to_numpy
    from tofrender.sampling.points import point_set
    from tofrender.sampling.warps import WARPS

    wanted = WARPS[name].parameter
    given = {"alpha": alpha, "image": image}
    for option, value in given.items():
        if option == wanted and value is None:
            raise ValueError(f"--{option}: must be given, {name} needs it")
        if option != wanted and value is not None:
            raise ValueError(f"--{option} = {value}: must be left out, {name} has none")
    case = warp_case(name, **({wanted: given[wanted]} if wanted else {}))

    from tofrender.runtime.canvas import save_figure
    from tofrender.vis.warps import warp_figure

    verdict = case.test(seed=seed)
    drawn = to_numpy(case.sample(point_set(points, count, seed)), count)
    figure = warp_figure(drawn, verdict, f"{count} {points} points")
    save_figure(figure, out, **dots(dpi))
    say(str(verdict), str(out))
    if not verdict.passed:
        raise typer.Exit(1)
