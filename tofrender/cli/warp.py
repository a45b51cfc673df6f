"""The commands `tofrender warptest` and `tofrender warp`."""

from contextlib import closing
from pathlib import Path
from typing import Annotated, Any

import typer

from ..runtime import checks
from ..runtime.canvas import FIGURE_SUFFIXES
from . import options as opt

WARPS = (
    *("tent", "uniform_disk", "uniform_sphere", "uniform_hemisphere", "cosine_hemisphere"),
    *("beckmann", "hierarchical", "no_op", "triangle", "sphere_cap", "quad_light"),
    *("triangle_light", "sphere_light", "two_lights"),
)
NAMED: dict[str, Any] = {"kind": typer.Argument, "metavar": "NAME"}
POINT_SETS = ("independent", "grid", "stratified", "sobol")
TEST_SAMPLES = 1_000_000

Alpha = Annotated[float | None, opt.real(0, "Roughness of beckmann.")]
Image = Annotated[str | None, opt.named("FILE", "Image of hierarchical.")]
Points = Annotated[str, opt.choice(POINT_SETS, "Point set to draw.")]
Count = Annotated[int, opt.integer(1, checks.MAX_SPP, "Points to draw.")]
Samples = Annotated[int, opt.integer(1000, 1 << 24, "Samples of the chi-square test.")]
Module = Annotated[
    Path | None, opt.named("FILE|DIR", "A student's Python file, or folder of files.")
]
Parameters = Annotated[
    list[str] | None,
    opt.checked(opt.definition, "Parameter of NAME, like distance=2.", "-D", metavar="NAME=VALUE"),
]
Host = Annotated[str, opt.named("ADDRESS", "Address to listen on.")]
Port = Annotated[int | None, opt.integer(1, 65535, "Port to listen on; by default a free one.")]
Browser = Annotated[bool, typer.Option(help="Open the page, if there is a screen.")]


def warptest(
    name: Annotated[
        str | None,
        opt.choice(WARPS, f"What to show first, or to test: {', '.join(WARPS)}.", **NAMED),
    ] = None,
    module: Module = None,
    headless: Annotated[
        bool, opt.switch("--headless", "Test without a window; exit status 1 if any fails.")
    ] = False,
    out: Annotated[
        Path | None, opt.named("FIG", "With --headless and NAME: figure to write.")
    ] = None,
    alpha: Alpha = None,
    image: Image = None,
    parameters: Parameters = None,
    points: Points = "independent",
    count: Count = 1024,
    samples: Samples = TEST_SAMPLES,
    dpi: opt.Dpi = None,
    seed: opt.Seed = 0,
    host: Host = "127.0.0.1",
    port: Port = None,
    browser: Browser = True,
    variant: opt.Variant = None,
) -> None:
    """Look at warps, shapes and lights in the browser: points, grid, and chi-square tests.

    Without --module they are this package's own. A student's module runs in a process of its own,
    which writes nowhere and is ended when it takes too long; its files are looked at again when
    they change. With --headless all warps are tested, or only NAME.
    """
    given = _parameters(name if headless else name or "tent", alpha, image, parameters)
    if headless:
        _headless(name, module, given, out, points, count, samples, dpi, seed, variant)
        return
    if out is not None:
        raise ValueError(f"--out = {out}: must be left out without --headless")

    from tofrender.apps.ui.serving import prepare, serve

    prepare(host, port)
    opt.activate(variant, polarised=True)

    from tofrender.apps.warptest import application

    make, engine = application(name or "tent", module=module, **given)
    with closing(engine):
        serve(make, "Warp tester", host=host, port=port, browser=browser, tell=opt.say)


def warp(
    name: Annotated[str, opt.choice(WARPS, f"What to draw: {', '.join(WARPS)}.", **NAMED)],
    out: Annotated[Path, opt.named("FIG", "Figure to write: png, pdf, svg.")],
    alpha: Alpha = None,
    image: Image = None,
    parameters: Parameters = None,
    points: Points = "independent",
    count: Count = 1024,
    dpi: opt.Dpi = None,
    seed: opt.Seed = 0,
    variant: opt.Variant = None,
) -> None:
    """Warp points of the unit square, draw them and their density, and test one against the other.

    Equivalent to `tofrender warptest NAME --headless --out FIG`. The chi-square test uses a million
    independent points, whichever are drawn. If the warp fails it, the exit status is 1.
    """
    given = _parameters(name, alpha, image, parameters, complete=True)
    _headless(name, None, given, out, points, count, TEST_SAMPLES, dpi, seed, variant)


def _parameters(
    name: str | None, alpha: Any, image: Any, parameters: Any, complete: bool = False
) -> dict[str, Any]:
    """Parameters of a subject; refuses those that it does not have, or lacks if `complete`."""
    given = {key: opt.number(text) for key, text in parameters or ()}
    if name is None and (given or alpha is not None or image is not None):
        raise ValueError("NAME: must be given with --alpha, --image or -D")
    for option, value, owner in (("alpha", alpha, "beckmann"), ("image", image, "hierarchical")):
        if value is None and name == owner and complete:
            raise ValueError(f"--{option}: must be given, {name} needs it")
        if value is not None and name != owner:
            raise ValueError(f"--{option} = {value}: must be left out, {name} has none")
        if value is not None:
            given[option] = value
    return given


def _headless(
    name: str | None,
    module: Path | None,
    given: dict[str, Any],
    out: Path | None,
    points: str,
    count: int,
    samples: int,
    dpi: int | None,
    seed: int,
    variant: str | None,
) -> None:
    """Test, print the verdicts, and exit with status 1 if any test failed."""
    if out is not None and name is None:
        raise ValueError(f"--out = {out}: must be left out without NAME")
    if out is not None:
        opt.check_file_out(out, *FIGURE_SUFFIXES, overwrite=True)
        if "image" in given:
            opt.check_apart(out, Path(given["image"]))

    opt.activate(variant, polarised=True)

    from tofrender.apps.warptest import engine as engines
    from tofrender.runtime.canvas import save_figure

    passed = 0
    with closing(engines.Engine(module)) as engine:
        source = [*engine.sources.values()][-1]
        names = [name] if name else source.names()
        for index, tested in enumerate(names):
            try:
                case = source.case(tested, given)
                # The chance of a false alarm is that of one test, for all of them together
                own_seed = (seed + index) % (checks.MAX_SEED + 1)
                verdict = case.test(samples=samples, seed=own_seed, tests=len(names))
                drawn = None if out is None else engines.draw(case, points, count, seed)
            except engines.NoAnswer as error:
                opt.say(f"{tested}: FAILED, {error}")
                continue
            opt.say(str(verdict))
            passed += verdict.passed
            if out is not None and drawn is not None:
                figure = engines.figure(drawn, verdict, f"{count} {points} points")
                save_figure(figure, out, **opt.dots(dpi))
                opt.say(str(out))
    if len(names) > 1:
        opt.say(f"{passed} of {len(names)} passed")
    if passed < len(names):
        raise typer.Exit(1)
