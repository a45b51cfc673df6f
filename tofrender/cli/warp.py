"""The commands `tofrender warptest` and `tofrender warp`."""

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from ..runtime import checks
from ..runtime.canvas import FIGURE_SUFFIXES
from . import options as opt

WARPS = (
    "tent",
    "uniform_disk",
    "uniform_sphere",
    "uniform_hemisphere",
    "cosine_hemisphere",
    "beckmann",
    "hierarchical",
    "no_op",
    "triangle",
    "sphere_cap",
    "quad_light",
    "triangle_light",
    "sphere_light",
    "two_lights",
)
POINT_SETS = ("independent", "grid", "stratified", "sobol")
TEST_SAMPLES = 1_000_000

Alpha = Annotated[float | None, opt.real(0, "Roughness of the warp beckmann, required by warp")]
Image = Annotated[
    str | None,
    opt.named("FILE", "Image whose luminance is the density of the warp `hierarchical`."),
]
Points = Annotated[str, opt.choice(POINT_SETS, "Point set to draw")]
Count = Annotated[int, opt.integer(1, checks.MAX_SPP, "Number of points to draw")]
Samples = Annotated[int, opt.integer(1000, 1 << 24, "Number of samples of the chi-square test")]
Module = Annotated[
    Path | None, opt.named("FILE|DIR", "Python file, or folder of Python files, to test.")
]
Parameters = Annotated[
    list[str] | None,
    opt.checked(
        opt.definition,
        "Parameter of the warp, for example distance=2. Repeat the option for more parameters.",
        "-D",
        metavar="NAME=VALUE",
    ),
]
Host = Annotated[str, opt.named("ADDRESS", "Address to listen on.")]
Port = Annotated[int | None, opt.integer(1, 65535, "Port to listen on", show_default="a free port")]
Browser = Annotated[bool, typer.Option(help="Open the page if the machine has a screen.")]


@dataclass(frozen=True)
class Drawn:
    """Options of a warp and of its points."""

    alpha: Alpha = None
    image: Image = None
    parameters: Parameters = None
    points: Points = "independent"
    count: Count = 1024


@dataclass(frozen=True)
class Page:
    """Options of commands that serve a page."""

    host: Host = "127.0.0.1"
    port: Port = None
    browser: Browser = True
    variant: opt.Variant = None

    @property
    def address(self) -> dict[str, Any]:
        """Arguments of `serve`."""
        return {"host": self.host, "port": self.port, "browser": self.browser}


@opt.with_groups
def warptest(
    name: Annotated[
        str | None,
        opt.choice(WARPS, "Warp to show first, or to test", kind=typer.Argument),
    ] = None,
    module: Module = None,
    headless: Annotated[
        bool,
        opt.switch("--headless", "Test without a window. The exit status is 1 if a test fails."),
    ] = False,
    out: Annotated[
        Path | None, opt.named("FIGURE", "With --headless and NAME, figure to write.")
    ] = None,
    *,
    drawn: Drawn,
    samples: Samples = TEST_SAMPLES,
    dpi: opt.Dpi = None,
    seed: opt.Seed = 0,
    page: Page,
) -> None:
    """Explore and test warps in the browser.

    The page shows points, a grid, and a chi-square test for warps, shapes and lights of
    the package, or of the file in --module. The file runs in a separate process that cannot
    write files and has a time limit. It is loaded again when it changes.
    With --headless, all warps are tested, or only NAME.

    Examples:
        tofrender warptest cosine_hemisphere
        tofrender warptest --module warps.py --headless
    """
    given = _parameters(name if headless else name or "tent", drawn)
    if headless:
        figure = _Figure(out=out, points=drawn.points, count=drawn.count, dpi=dpi)
        _headless(name, module, given, figure, samples, seed, page.variant)
        return
    if out is not None:
        raise ValueError(f"--out = {out} requires --headless")

    from tofrender.apps.ui.serving import prepare, serve

    prepare(page.host, page.port)
    opt.activate(page.variant, polarized=True)

    from tofrender.apps.warptest import application

    make, engine = application(name or "tent", module=module, **given)
    with closing(engine):
        serve(make, "Warp tester", **page.address, tell=opt.say)


@opt.with_groups
def warp(
    name: Annotated[str, opt.choice(WARPS, "Warp to draw", kind=typer.Argument)],
    out: Annotated[Path, opt.named("FIGURE", "Figure to write: .png, .pdf or .svg.")],
    *,
    drawn: Drawn,
    dpi: opt.Dpi = None,
    seed: opt.Seed = 0,
    variant: opt.Variant = None,
) -> None:
    """Draw warped points and their density.

    The command also tests the points against the density. It is equivalent to
    `tofrender warptest NAME --headless --out FIGURE`. The chi-square test always uses a million
    independent points. If the test fails, the exit status is 1.

    Examples:
        tofrender warp cosine_hemisphere --out warp.png
        tofrender warp beckmann --alpha 0.3 --points sobol --out beckmann.pdf
    """
    given = _parameters(name, drawn, complete=True)
    figure = _Figure(out=out, points=drawn.points, count=drawn.count, dpi=dpi)
    _headless(name, None, given, figure, TEST_SAMPLES, seed, variant)


def _parameters(name: str | None, drawn: Drawn, complete: bool = False) -> dict[str, Any]:
    """Return the parameters of a warp.

    Raises:
        ValueError: A parameter does not belong to the warp, or is missing although the parameters
            must be `complete`.
    """
    given = {key: opt.number(text) for key, text in drawn.parameters or ()}
    if name is None and (given or drawn.alpha is not None or drawn.image is not None):
        raise ValueError("--alpha, --image and -D require the argument NAME")
    of_one_warp = (
        ("alpha", drawn.alpha, "beckmann"),
        ("image", drawn.image, "hierarchical"),
    )
    for option, value, owner in of_one_warp:
        if value is None and name == owner and complete:
            raise ValueError(f"--{option} is missing, but {name} needs it")
        if value is not None and name != owner:
            raise ValueError(
                f"--{option} = {value} does not belong to the warp {name}. Remove the option"
            )
        if value is not None:
            given[option] = value
    return given


@dataclass(frozen=True, kw_only=True)
class _Figure:
    """Figure of warped points."""

    out: Path | None  # file to write, None to draw nothing
    points: str  # name of the point set
    count: int  # number of points
    dpi: int | None  # resolution, None for the default


def _headless(
    name: str | None,
    module: Path | None,
    given: dict[str, Any],
    figure: _Figure,
    samples: int,
    seed: int,
    variant: str | None,
) -> None:
    """Test warps, print the verdicts, and exit with status 1 if a test has failed."""
    out = figure.out
    if out is not None and name is None:
        raise ValueError(f"--out = {out} requires the argument NAME")
    if out is not None:
        opt.check_file_out(out, *FIGURE_SUFFIXES, overwrite=True)
        if "image" in given:
            opt.check_apart(out, Path(given["image"]))

    opt.activate(variant, polarized=True)

    from tofrender.apps.warptest import engine as engines
    from tofrender.runtime.canvas import save_figure

    passed = 0
    with closing(engines.Engine(module)) as engine:
        source = [*engine.sources.values()][-1]
        names = [name] if name else source.names()
        for index, tested in enumerate(names):
            try:
                case = source.case(tested, given)
                # All tests together have the probability of a false alarm of a single test
                own_seed = (seed + index) % (checks.MAX_SEED + 1)
                verdict = case.test(samples=samples, seed=own_seed, tests=len(names))
                drawn = None
                if out is not None:
                    drawn = engines.draw(case, figure.points, figure.count, seed)
            except engines.NoAnswer as error:
                opt.say(f"{tested}: FAILED, {error}")
                continue
            opt.say(str(verdict))
            passed += verdict.passed
            if out is not None and drawn is not None:
                caption = f"{figure.count} {figure.points} points"
                save_figure(engines.figure(drawn, verdict, caption), out, **opt.dots(figure.dpi))
                opt.say(str(out))
    if len(names) > 1:
        opt.say(f"{passed} of {len(names)} passed")
    if passed < len(names):
        raise typer.Exit(1)
