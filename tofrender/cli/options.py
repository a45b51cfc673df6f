"""Options that commands share, and what turns the text of each into a value.

Types, ranges and choices are Typer's, which shows them in `--help`. Only its words for a bad value
are replaced, as they do not say the value: each is refused in one line, `--option = value: must be
...`. Nothing here imports Mitsuba.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, get_args

import typer

from ..runtime import checks
from ..runtime.progress import bars_cleared
from . import completion

if TYPE_CHECKING:
    import xarray as xr

BAD_INPUT, FAILURE, INTERRUPTED = 2, 1, 130
"""What the command's exit status is, if not 0."""

MAX_SENSOR = 1 << 16

LEAST_ROOM = 1 << 20
"""What a figure and a few headers take on a disk [bytes]."""

FILES = {
    "frames": "",
    "png": "",
    "multipart": "stack.exr",
    "npz": "transient.npz",
    "zarr": "transient.zarr",
}
"""What holds the transient in the output folder, by --format."""


class Size(NamedTuple):
    """Width and height, of pixels or points."""

    width: int
    height: int

    def __str__(self) -> str:
        return f"{self.width}x{self.height}"


# ------------------------------------------------------------------------------ kinds of options


class Refused(typer.BadParameter):
    """A bad value, with all that is said of it behind the option's name."""

    def format_message(self) -> str:
        """The whole line."""
        name = self.param.opts[0] if self.param else ""
        return f"{name if name.startswith('-') else name.upper()}{self.message}"


def checked(
    check: Callable[[str, Any], Any], help: str, *names: str, kind: Any = typer.Option, **info: Any
) -> Any:
    """An option whose value is `check("", text)`, where text that spells a number is one.

    Args:
        check: Returns the value, or raises ValueError with what is to be said behind the name.
        help: What `--help` says.
        *names: The option's names, if they are not the parameter's.
        kind: `typer.Option` or `typer.Argument`.
        **info: More for `kind`.
    """

    def parse(text: Any) -> Any:
        try:
            return check("", number(text))
        except ValueError as error:
            raise Refused(str(error)) from None

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


def choice(names: Any, help: str, **info: Any) -> Any:
    """An option that is one of the names of a `Literal`."""
    allowed = get_args(names)
    complete = completion.among(allowed)
    return checked(partial(checks.one_of, allowed=allowed), help, autocompletion=complete, **info)


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
    """The check of an option that is a pulse's width: auto, none, or metres.

    Example:
        >>> pulse("", "0.05")
        0.05
    """
    if value in ("auto", "none"):
        return value
    width = number(value)
    if isinstance(width, str):
        raise ValueError(f"{name} = {checks.quote(value)}: must be auto, none, or metres above 0")
    return checks.width(name, width)


def span(name: str, value: Any) -> str | tuple[float, float]:
    """The check of an option that is a window: auto, scene, or where it starts and stops.

    Example:
        >>> span("", "3.5,15")
        (3.5, 15.0)
    """
    ends = [number(end) for end in str(value).split(",")]
    if value in ("auto", "scene"):
        return value
    if any(isinstance(end, str) for end in ends) or len(ends) != 2:
        allowed = "auto, scene, or start,stop in metres of path, like 3.5,15"
        raise ValueError(f"{name} = {checks.quote(value)}: must be {allowed}")
    start, stop = (checks.metres(name, end) for end in ends)
    if not start < stop < start + checks.MAX_OPL:
        raise ValueError(f"{name} = {value}: must end after it starts, and not at infinity")
    return start, stop


def definition(name: str, value: Any) -> tuple[str, str]:
    """The check of an option that is a name and a value."""
    key, separator, text = str(value).partition("=")
    if not separator or not key:
        raise ValueError(f"{name} {value}: must be name=value, like spp=64")
    return key, text


def number(text: Any) -> Any:
    """The number that a text spells, NaN and infinities too; any other text for a check to refuse.

    Example:
        >>> number("64"), number("2e7"), number("1_000"), number("\u0663")
        (64, 20000000.0, '1_000', '\u0663')
    """
    if not isinstance(text, str) or not text.isascii() or "_" in text or text != text.strip():
        return text
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text


# ---------------------------------------------------------------------------------- shared options

Scene = Annotated[
    str,
    typer.Argument(
        metavar="SCENE",
        help="Built-in name (see `tofrender scenes`) or Mitsuba XML file.",
        autocompletion=completion.scene,
    ),
]
Out = Annotated[Path, typer.Option(metavar="DIR", help="Folder to write, made whole.")]
Spp = Annotated[int | None, integer(1, checks.MAX_SPP, "Samples per pixel.")]
Pixels = Annotated[Size | None, size("256x256", "Picture's size, pixels.")]
MaxDepth = Annotated[
    int | None, checked(checks.depth, "Longest path, in segments; -1: any.", min=-1)
]
Seed = Annotated[int, integer(0, checks.MAX_SEED, "Random seed.")]
Variant = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Mitsuba variant, e.g. llvm_ad_rgb.",
        autocompletion=completion.among(completion.VARIANTS),
    ),
]
Workers = Annotated[int | None, integer(1, 1024, "Render by so many processes here.")]
Progress = Annotated[bool, typer.Option(help="Show a bar for work that takes long.")]
Drawing = Literal["png", "pdf", "svg"]
Figure = Annotated[Drawing, choice(Drawing, "File of the figure; pdf and svg are vectors.")]
Dpi = Annotated[int | None, integer(20, 2400, "Dots per inch of the figure's pixels.")]
Scheduler = Annotated[
    str | None,
    checked(checks.address, "Render by the workers of a Dask scheduler.", metavar="ADDRESS"),
]


def say(*lines: str, err: bool = False) -> None:
    """Say something on stdout, or on stderr."""
    with bars_cleared():
        for line in lines:
            typer.echo(checks.printable(line), err=err)


def note(line: str) -> None:
    """Say something on stderr."""
    say(line, err=True)


def dots(dpi: int | None) -> dict[str, Any]:
    """What `save_figure` is told, if anything."""
    return {} if dpi is None else {"dpi": dpi}


def check_client(workers: int | None, scheduler: str | None) -> None:
    """Refuse workers that are asked for in two ways."""
    if workers is not None and scheduler is not None:
        raise ValueError("--scheduler: must be left out with --workers")


@contextmanager
def client_of(workers: int | None, scheduler: str | None) -> Iterator[Any]:
    """The workers that are asked for, None if none are."""
    if workers is None and scheduler is None:
        yield None
        return
    from tofrender.rendering.workers import workers_for

    check_client(workers, scheduler)
    with workers_for(workers, scheduler) as client:
        yield client


# ------------------------------------------------------------------------------------- the folder


def check_out(
    out: Path, shape: tuple[int, int, int, int] | None = None, precision: str = "float"
) -> None:
    """Refuse a folder that cannot be written, or a disk too small for a transient of `shape`."""
    from tofrender.io import check_output

    try:
        check_output(out, shape, precision=precision, overwrite=True)
    except (ValueError, OSError) as error:
        raise ValueError(_of_out(error)) from None
    check_room(out)


def check_file_out(out: Path, *suffixes: str, overwrite: bool = False) -> None:
    """Refuse a file that cannot be written."""
    from tofrender.runtime.atomic import check_file

    try:
        check_file(out, *suffixes, overwrite=overwrite, needed_bytes=LEAST_ROOM)
    except (ValueError, OSError) as error:
        raise ValueError(_of_out(error)) from None


def check_room(out: Path, *arrays: int) -> None:
    """Refuse a disk too small for arrays of floats, each of so many values."""
    from tofrender.runtime.atomic import check_writable

    try:
        check_writable(out, 4 * sum(arrays) + LEAST_ROOM)
    except OSError as error:
        raise ValueError(_of_out(error)) from None


def check_apart(out: Path, source: Path) -> None:
    """Refuse a folder to write that is the source, in it or above it: it would be replaced."""
    here, there = out.resolve(), source.resolve()
    if here == there or here in there.parents or there in here.parents:
        raise ValueError(f"--out = {out}: must be apart from {source}, which is read")


def _of_out(error: Exception) -> str:
    return str(error).replace("path =", "--out =", 1)


def check_format(format: str, precision: str) -> None:
    """Refuse half precision where files hold single."""
    if format in ("npz", "zarr", "png") and precision != "float":
        raise ValueError(f"--precision = {precision}: must be float with --format {format}")


def load_render(out: Path, option: str) -> xr.Dataset:
    """What `tofrender render` has left in `out`; `option` is what asks for it."""
    from tofrender import io
    from tofrender.rendering.films_on_disk import load_zarr

    out = checks.path(option, out)
    for path, load in (
        (out / FILES["npz"], io.load_npz),
        (out / FILES["zarr"], load_zarr),
        (out / FILES["multipart"], io.load_exr_stack),
        (out / "steady.exr", lambda _: io.load_exr_stack(out)),
    ):
        if path.exists():
            return load(path)
    name = checks.quote(str(out))
    what = "pictures, which cannot be read back" if (out / "steady.png").exists() else "no render"
    raise ValueError(f"{option}: {name} holds {what}; must be what `tofrender render` has written")
