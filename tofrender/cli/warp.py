"""The command `tofrender warp`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .options import number

SUFFIXES = (".png", ".pdf", ".svg")

Text = str | None
_option = typer.Option


def warp(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="For example beckmann; a wrong one lists all.")
    ],
    out: Annotated[Path, _option("--out", metavar="FIG", help="Figure to write: png, pdf, svg.")],
    alpha: Annotated[Text, _option("--alpha", metavar="A", help="Roughness of beckmann.")] = None,
    image: Annotated[
        Text, _option("--image", metavar="FILE", help="Image of hierarchical.")
    ] = None,
    points: Annotated[
        str,
        _option("--points", metavar="independent|grid|stratified", help="Point set to draw."),
    ] = "independent",
    count: Annotated[str, _option("--count", metavar="N", help="Points to draw.")] = "1024",
    seed: Annotated[str, _option("--seed", metavar="N", help="Random seed.")] = "0",
    variant: Annotated[Text, _option("--variant", metavar="NAME", help="Mitsuba variant.")] = None,
) -> None:
    """Warp points of the unit square, draw them and their density, and test one against the other.

    The chi-square test takes a million independent points, whichever are drawn. If the warp fails
    it, the exit status is 1.
    """
    from tofrender.runtime import backend, checks

    check_figure(out)
    seed_number = checks.integer("--seed", number(seed), 0, checks.MAX_SEED)
    backend.activate(variant)
    backend.require_vectorised()

    from tofrender.sampling.cases import warp_case
    from tofrender.sampling.domains import to_numpy
    from tofrender.sampling.points import MAX_COUNT, POINT_SETS, point_set
    from tofrender.sampling.warps import WARPS

    checks.one_of("--points", points, POINT_SETS)
    total = checks.integer("--count", number(count), 1, MAX_COUNT)
    wanted = WARPS[checks.one_of("NAME", name, WARPS)].parameter
    given = {"alpha": None if alpha is None else number(alpha), "image": image}
    for option, value in given.items():
        if option == wanted and value is None:
            raise ValueError(f"--{option}: must be given, {name} needs it")
        if option != wanted and value is not None:
            raise ValueError(f"--{option} = {value}: must be left out, {name} has none")
    case = warp_case(name, **({wanted: given[wanted]} if wanted else {}))

    from tofrender.io.atomic import replacing
    from tofrender.vis.warps import warp_figure

    verdict = case.test(seed=seed_number)
    drawn = to_numpy(case.sample(point_set(points, total, seed_number)), total)
    figure = warp_figure(drawn, verdict, f"{total} {points} points")
    with replacing(out) as temporary:
        figure.savefig(temporary)
    typer.echo(str(verdict))
    typer.echo(f"{out}")
    if not verdict.passed:
        raise typer.Exit(1)


def check_figure(out: Path) -> None:
    """Refuse a figure that cannot be written."""
    from tofrender.io.output import check_file, check_writable

    try:
        check_file(out, *SUFFIXES, overwrite=True)
        check_writable(out)
    except (ValueError, OSError) as error:
        raise ValueError(str(error).replace("path =", "--out =", 1)) from None
