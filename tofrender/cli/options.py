"""Options that commands share, with the checks of their values.

Options of `render`'s settings come from the table in `rendering/settings.py`. Typer shows types,
ranges and choices in `--help`, but its messages for bad values lack the value: here each is refused
in one line, `--option = value: must be ...`. Nothing here imports Mitsuba.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import partial, wraps
from inspect import Parameter, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from ..io.contents import FORMATS
from ..rendering.settings import SETTINGS
from ..runtime import backend, checks
from ..runtime.atomic import check_file, check_writable
from ..runtime.progress import bars_cleared
from ..signals.units import check_frequency
from . import completion

if TYPE_CHECKING:
    import xarray as xr
    from distributed import Client

BAD_INPUT, FAILURE, INTERRUPTED = 2, 1, 130  # Exit statuses
FIGURE_BYTES = 1 << 20  # Size of a figure and a few headers on a disk

SCENE_TIME = "scene"  # --window and --pulse-width: as the scene has them


class Size(NamedTuple):
    """Width and height, of pixels or points."""

    width: int
    height: int

    def __str__(self) -> str:
        return f"{self.width}x{self.height}"


class BadValue(typer.BadParameter):
    """A bad value; the message is what follows the option's name."""

    def format_message(self) -> str:
        """Format the whole line."""
        name = self.param.opts[0] if self.param else ""
        return f"{name if name.startswith('-') else name.upper()}{self.message}"


def checked(
    check: Callable[[str, Any], Any], help: str, *names: str, kind: Any = typer.Option, **info: Any
) -> Any:
    """An option or argument whose value is `check("", text)`, where numbers are no text.

    For a bad value `check` raises a ValueError, whose message follows the option's name.
    """

    def parse(text: Any) -> Any:
        try:
            return check("", number(text))
        except ValueError as error:
            raise BadValue(str(error)) from None

    return kind(*names, parser=parse, help=help, **info)


def integer(low: int, high: int, help: str) -> Any:
    """An option that is an integer from `low` to `high`."""
    return checked(partial(checks.integer, low=low, high=high), help, min=low, max=high)


def real(low: float, help: str) -> Any:
    """An option that is a finite number from `low`."""

    def check(name: str, value: Any) -> float:
        if isinstance(value, str) or not low <= value < math.inf:
            raise ValueError(f"{name} = {value}: must be a number from {low:g}")
        return value

    return checked(check, help, min=low)


def positive(unit: str, help: str) -> Any:
    """An option that is a finite number of some unit above 0."""
    check = partial(checks.number, positive=True, unit=unit)
    return checked(check, help, metavar="<float above 0>")


def frequency(help: str) -> Any:
    """An option that is a frequency."""
    return checked(hertz, f"{help}, hertz or like 20MHz.", metavar="FREQUENCY")


def choice(names: Iterable[str], help: str, **info: Any) -> Any:
    """An option that is one of some names."""
    allowed = tuple(names)
    info = {"metavar": f"<{'|'.join(allowed)}>"} | info
    info |= {"autocompletion": completion.among(allowed)}
    return checked(partial(checks.one_of, allowed=allowed), help, **info)


def setting(name: str, parse: Callable[[str, Any], Any] | None = None, more: str = "") -> Any:
    """An option of a setting of `render`, by the table; `parse` checks what is no plain number."""
    described = SETTINGS[name]
    help = f"{described.help}{more}."
    if described.choices:
        return choice(described.choices, help)
    if described.check is checks.boolean:
        return switch(f"--{name}", help)
    if parse is None and described.low is not None and described.high is not None:
        return checked(described.check, help, min=described.low, max=described.high)
    return checked(parse or described.check, help, **METAVARS.get(name, {}))


def named(metavar: str, help: str, *names: str, complete: Any = None) -> Any:
    """An option that is text or a path, with the name of its value."""
    return typer.Option(*names, metavar=metavar, help=help, autocompletion=complete)


def argument(metavar: str, help: str, complete: Any = None) -> Any:
    """An argument that is text or a path, with the name of its value."""
    return typer.Argument(metavar=metavar, help=help, autocompletion=complete)


def switch(name: str, help: str) -> Any:
    """An option without a value, which cannot be negated."""
    return typer.Option(name, help=help)


def size(example: str, help: str) -> Any:
    """An option that is a width and a height."""

    def check(name: str, value: Any) -> Size:
        try:
            width, height = (number(side) for side in str(value).lower().split("x"))
            return Size(*(checks.integer(name, n, 1, checks.MAX_SIZE) for n in (width, height)))
        except ValueError:
            allowed = f"like {example}, of integers from 1 to {checks.MAX_SIZE}"
            raise ValueError(f"{name} = {value}: must be width x height, {allowed}") from None

    return checked(check, help, metavar="WxH")


def pulse(name: str, value: Any) -> str | float:
    """Check a pulse's width: auto, scene, or metres."""
    if value in ("auto", SCENE_TIME):
        return value
    width = number(value)
    checks.require(name, value, not isinstance(width, str), "auto, scene, or metres above 0")
    return checks.width(name, width)


def span(name: str, value: Any) -> str | tuple[float, float]:
    """Check a window: auto, scene, or where it starts and stops."""
    ends = [number(end) for end in str(value).split(",")]
    if value in ("auto", SCENE_TIME):
        return value
    if any(isinstance(end, str) for end in ends) or len(ends) != 2:
        allowed = "auto, scene, or start,stop in metres of path, like 3.5,15"
        raise ValueError(f"{name} = {checks.quote(value)}: must be {allowed}")
    return checks.interval(name, ends)


def sides(name: str, value: Any) -> tuple[float, float]:
    """Check the sides of a wall [m]: one of a square, or width and height."""
    found = [number(side) for side in str(value).split(",")]
    if any(isinstance(side, str) for side in found) or len(found) > 2:
        allowed = "metres, or width,height in metres, like 0.7,0.5"
        raise ValueError(f"{name} = {checks.quote(value)}: must be {allowed}")
    width, height = found[0], found[-1]
    return checks.metres(name, width, positive=True), checks.metres(name, height, positive=True)


def hertz(name: str, value: Any) -> float:
    """Check a frequency, in hertz or with a unit [Hz]."""
    text, factor = str(value), 1.0
    for unit, size in (("GHz", 1e9), ("MHz", 1e6), ("kHz", 1e3), ("Hz", 1.0)):
        if text.endswith(unit):
            text, factor = text.removesuffix(unit).strip(), size
            break
    found = number(text)
    checks.require(name, value, not isinstance(found, str), "hertz, or like 20MHz")
    return check_frequency(name, found * factor)


def definition(name: str, value: Any) -> tuple[str, str]:
    """Split a name and its value."""
    key, separator, text = str(value).partition("=")
    if not separator or not key:
        raise ValueError(f"{name} {value}: must be name=value, like spp=64")
    return key, text


def number(text: Any) -> Any:
    """Convert text of ASCII digits to a number, NaN and infinities too; return other text as is."""
    if not isinstance(text, str) or not text.isascii() or "_" in text or text != text.strip():
        return text
    for kind in (int, float):
        with suppress(ValueError):
            return kind(text)
    return text


METAVARS: dict[str, dict[str, Any]] = {
    "bin_width": {"metavar": "<float above 0>"},
    "max_depth": {"min": -1},
    "scheduler": {"metavar": "ADDRESS"},
    "window": {
        "metavar": "auto|scene|START,STOP",
        "autocompletion": completion.among(["auto", SCENE_TIME]),
    },
    "pulse_width": {
        "metavar": "auto|scene|METRES",
        "autocompletion": completion.among(["auto", SCENE_TIME]),
    },
}
"""Values of settings as `--help` and completion show them, where these are no plain numbers."""

Scene = Annotated[
    str,
    argument(
        "SCENE", f"{SETTINGS['scene'].help}; `tofrender scenes` lists the names.", completion.scene
    ),
]
Out = Annotated[Path, named("DIR", "Folder to write atomically.")]
Spp = Annotated[int | None, setting("spp")]
Pixels = Annotated[Size | None, size("256x256", f"{SETTINGS['size'].help}.")]
MaxDepth = Annotated[int | None, setting("max_depth")]
Seed = Annotated[int, setting("seed")]
Variant = Annotated[
    str | None, named("NAME", "Mitsuba variant, e.g. llvm_ad_rgb.", complete=completion.variant)
]
Workers = Annotated[int | None, setting("workers")]
Scheduler = Annotated[str | None, setting("scheduler")]
Format = Annotated[str, choice(FORMATS, "How to store the transient.")]
Precision = Annotated[str, choice(("half", "float"), "Numbers in the EXR files.")]
Video = Annotated[bool, typer.Option(help="Write video.mp4 as well.")]
Figure = Annotated[
    str, choice(("png", "pdf", "svg"), "File of the figure; pdf and svg are vectors.")
]
Dpi = Annotated[int | None, integer(20, 2400, "Dots per inch of the figure's pixels.")]


def with_progress(command: Callable[..., None]) -> Callable[..., None]:
    """A command that also has --no-progress, which `app.Command` obeys."""

    @wraps(command)
    def call(progress: bool, **options: Any) -> None:
        command(**options)

    shown = Annotated[bool, typer.Option(help=f"{SETTINGS['progress'].help}.")]
    last = Parameter("progress", Parameter.KEYWORD_ONLY, default=True, annotation=shown)
    own = signature(command, eval_str=True)
    call.__signature__ = own.replace(parameters=[*own.parameters.values(), last])  # type: ignore
    return call


def activate(variant: str | None = None, polarised: bool = False) -> None:
    """Activate a Mitsuba variant that can render."""
    backend.activate(variant)
    backend.require_vectorised()
    if not polarised:
        backend.require_unpolarised()


def say(*lines: str, err: bool = False) -> None:
    """Print lines on stdout or stderr, above progress bars."""
    with bars_cleared():
        for line in lines:
            typer.echo(checks.printable(line), err=err)


def note(line: str) -> None:
    """Print a line on stderr."""
    say(line, err=True)


def dots(dpi: int | None) -> dict[str, Any]:
    """The argument `dpi` of `save_figure`, if it is given."""
    return {} if dpi is None else {"dpi": dpi}


def check_client(workers: int | None, scheduler: str | None) -> None:
    """Refuse --workers together with --scheduler."""
    if workers is not None and scheduler is not None:
        raise ValueError("--scheduler: must be left out with --workers")


def client_of(workers: int | None, scheduler: str | None) -> AbstractContextManager[Client | None]:
    """Client of local workers or of a scheduler's, None without either option."""
    from tofrender.rendering.workers import workers_for

    check_client(workers, scheduler)
    return workers_for(workers, scheduler)


@contextmanager
def _naming_out() -> Iterator[None]:
    """Turn errors of a path into errors of --out."""
    try:
        yield
    except (ValueError, OSError) as error:
        raise ValueError(str(error).replace("path =", "--out =", 1)) from None


def check_out(
    out: Path, shape: tuple[int, int, int, int] | None = None, precision: str = "float"
) -> None:
    """Refuse a folder that cannot be written, or a disk too small for a transient of `shape`."""
    from tofrender.io import check_output

    with _naming_out():
        check_output(out, shape, precision=precision, overwrite=True)
    check_disk_space(out)


def check_file_out(out: Path, *suffixes: str, overwrite: bool = False) -> None:
    """Refuse a file that cannot be written."""
    with _naming_out():
        check_file(out, *suffixes, overwrite=overwrite, needed_bytes=FIGURE_BYTES)


def check_disk_space(out: Path, *arrays: int) -> None:
    """Refuse a disk too small for arrays of floats with these numbers of values."""
    with _naming_out():
        check_writable(out, 4 * sum(arrays) + FIGURE_BYTES)


def check_apart(out: Path, source: Path) -> None:
    """Refuse a folder to write that is the source, in it or above it: it would be replaced."""
    here, there = out.resolve(), source.resolve()
    if here == there or here in there.parents or there in here.parents:
        raise ValueError(f"--out = {out}: must be apart from {source}, which is read")


def check_format(format: str, precision: str) -> None:
    """Refuse half precision where files hold single."""
    if format in ("npz", "zarr", "png") and precision != "float":
        raise ValueError(f"--precision = {precision}: must be float with --format {format}")


def load_render(out: Path, option: str) -> xr.Dataset:
    """Load the render that `tofrender render` wrote to `out`, the value of `option`."""
    from tofrender import io
    from tofrender.rendering.films_on_disk import load_zarr

    out = checks.path(option, out)
    for path, load in (
        (out / FORMATS["npz"], io.load_npz),
        (out / FORMATS["zarr"], load_zarr),
        (out / FORMATS["multipart"], io.load_exr_stack),
        (out / "steady.exr", lambda _: io.load_exr_stack(out)),
    ):
        if path.exists():
            return load(path)
    name = checks.quote(str(out))
    found = "pictures, which cannot be read back" if (out / "steady.png").exists() else "no render"
    raise ValueError(f"{option}: {name} holds {found}; must be what `tofrender render` has written")
