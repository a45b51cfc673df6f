"""Options that several commands share, and the checks of their values.

The options of `render` come from the fields of `RenderSettings` in `rendering/settings.py`. Options
that several commands share are the fields of dataclasses, see `with_groups`. Typer prints the help,
but its messages for bad values do not contain the value. Therefore each option here has a check
that refuses a bad value in one line: `--option = value: must be ...`. This module does not import
Mitsuba, so that `--help` answers at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import partial, wraps
from inspect import Parameter, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, get_type_hints

import typer

from ..io.command_files import FORMATS
from ..rendering.settings import SETTINGS
from ..runtime import backend, checks, variants
from ..runtime.atomic import check_file, check_writable
from ..runtime.progress import bars_cleared
from ..signals.units import check_frequency
from . import completion

if TYPE_CHECKING:
    import xarray as xr
    from distributed import Client

# Exit statuses
FAILURE = 1
BAD_INPUT = 2
INTERRUPTED = 130

FIGURE_BYTES = 1 << 20
"""Space on the disk that a figure and a few headers need."""

SCENE_TIME = "scene"
"""Value of --window and --pulse-width that keeps what the scene defines."""

LEAST_HERTZ = 1000.0
"""Frequency [Hz] from which a number without a unit is accepted."""

FROM_SCENE = "from the scene"
"""Default of options that change a scene."""


class Size(NamedTuple):
    """Width and height in pixels or points."""

    width: int
    height: int

    def __str__(self) -> str:
        return f"{self.width}x{self.height}"


class BadValue(typer.BadParameter):
    """Error of a bad value. Its message begins after the name of the option."""

    def format_message(self) -> str:
        """Return the message with the name of the option in front."""
        name = self.param.opts[0] if self.param else ""
        return f"{name if name.startswith('-') else name.upper()}{self.message}"


# ---------------------------------------------------------------------- kinds of options
def checked(
    check: Callable[[str, Any], Any], help: str, *names: str, kind: Any = typer.Option, **info: Any
) -> Any:
    """Declare an option or an argument with a check of its value.

    Args:
        check: Called with an empty name, and with the text or the number that the text contains.
            The check returns the value, or raises a ValueError. The option's name is put in front
            of its message.
        help: One sentence for `--help`.
        *names: Names of the option; by default the name of the parameter.
        kind: `typer.Option` or `typer.Argument`.
        **info: Further arguments of `kind`.
    """

    def parse(text: Any) -> Any:
        try:
            return check("", number(text))
        except ValueError as error:
            raise BadValue(str(error)) from None

    return kind(*names, parser=parse, help=help, **info)


def integer(low: int, high: int, help: str, **info: Any) -> Any:
    """Declare an option that is an integer from `low` to `high`."""
    check = partial(checks.integer, low=low, high=high)
    return checked(check, f"{help} ({low} to {high}).", metavar="N", **info)


def real(low: float, help: str) -> Any:
    """Declare an option that is a finite number from `low`."""

    def check(name: str, value: Any) -> float:
        if isinstance(value, str) or not low <= value < math.inf:
            raise ValueError(f"{name} = {value}: must be a number from {low:g}")
        return value

    return checked(check, f"{help} (from {low:g}).", metavar="NUMBER")


def positive(unit: str, help: str, **info: Any) -> Any:
    """Declare an option that is a finite number above 0, in `unit`."""
    check = partial(checks.number, positive=True, unit=unit)
    return checked(check, f"{help} (above 0).", metavar="NUMBER", **info)


def frequency(help: str) -> Any:
    """Declare an option that is a frequency."""
    return checked(hertz, f"{help} [Hz], for example 20MHz.", metavar="FREQUENCY")


def choice(names: Iterable[str], help: str, **info: Any) -> Any:
    """Declare an option that is one of several names."""
    allowed = tuple(names)
    options = {"metavar": "NAME", "autocompletion": completion.among(allowed)} | info
    return checked(
        partial(checks.one_of, allowed=allowed), f"{help}: {', '.join(allowed)}.", **options
    )


def setting(
    name: str,
    parse: Callable[[str, Any], Any] | None = None,
    note: str = "",
    default: str | None = FROM_SCENE,
) -> Any:
    """Declare an option for a setting of `render`, as the table of settings describes it.

    Args:
        name: Name of the setting.
        parse: Check of values that are not plain numbers.
        note: Second sentence of the help.
        default: Text that `--help` shows as the default if the parameter's default is None.
    """
    described = SETTINGS[name]
    info = dict(METAVARS.get(name, {}))
    if default is not None:
        info["show_default"] = default
    if described.check is checks.boolean:
        return switch(f"--{name}", f"{described.help}.")
    if described.choices:
        return choice(described.choices, described.help, **info)

    help = f"{described.help}."
    if described.low is not None and described.high is not None and parse is None:
        help = f"{described.help} ({described.low} to {described.high})."
        info.setdefault("metavar", "N")
    info.setdefault("metavar", "NUMBER")
    return checked(parse or described.check, f"{help} {note}".strip(), **info)


def named(metavar: str, help: str, *names: str, complete: Any = None) -> Any:
    """Declare an option that is text or a path, with the name of its value."""
    return typer.Option(*names, metavar=metavar, help=help, autocompletion=complete)


def argument(metavar: str, help: str, complete: Any = None) -> Any:
    """Declare an argument that is text or a path, with the name of its value."""
    return typer.Argument(metavar=metavar, help=help, autocompletion=complete)


def switch(name: str, help: str) -> Any:
    """Declare an option without a value, which cannot be negated."""
    return typer.Option(name, help=help)


def size(example: str, help: str, **info: Any) -> Any:
    """Declare an option that is a width and a height in whole numbers."""

    def check(name: str, value: Any) -> Size:
        try:
            width, height = (number(side) for side in str(value).lower().split("x"))
            width = checks.integer(name, width, 1, checks.MAX_SIZE)
            height = checks.integer(name, height, 1, checks.MAX_SIZE)
        except ValueError:
            allowed = f"like {example}, of integers from 1 to {checks.MAX_SIZE}"
            raise ValueError(f"{name} = {value}: must be width x height, {allowed}") from None
        return Size(width, height)

    return checked(check, help, metavar="WxH", **info)


# ---------------------------------------------------------------------- checks of values
def pulse(name: str, value: Any) -> str | float:
    """Check the width of a pulse: auto, scene, or a length [m]."""
    if value in ("auto", SCENE_TIME):
        return value
    width = number(value)
    checks.require(name, value, not isinstance(width, str), "auto, scene, or meters above 0")
    return checks.width(name, width)


def span(name: str, value: Any) -> str | tuple[float, float]:
    """Check a window: auto, scene, or its start and stop [m]."""
    ends = [number(end) for end in str(value).split(",")]
    if value in ("auto", SCENE_TIME):
        return value
    if any(isinstance(end, str) for end in ends) or len(ends) != 2:
        allowed = "auto, scene, or start,stop in meters of path, like 3.5,15"
        raise ValueError(f"{name} = {checks.quote(value)}: must be {allowed}")
    return checks.interval(name, ends)


def sides(name: str, value: Any) -> tuple[float, float]:
    """Check the sides of a wall [m]: one number for a square, or width and height."""
    found = [number(side) for side in str(value).split(",")]
    if any(isinstance(side, str) for side in found) or len(found) > 2:
        allowed = "meters, or width,height in meters, like 0.7,0.5"
        raise ValueError(f"{name} = {checks.quote(value)}: must be {allowed}")
    width = checks.meters(name, found[0], positive=True)
    height = checks.meters(name, found[-1], positive=True)
    return width, height


def hertz(name: str, value: Any) -> float:
    """Check a frequency with or without a unit, and return it in hertz.

    A small number without a unit is refused, because it is probably meant in megahertz.
    """
    text = str(value)
    factor = 1.0
    for unit, size in (("GHz", 1e9), ("MHz", 1e6), ("kHz", 1e3), ("Hz", 1.0)):
        if text.endswith(unit):
            text = text.removesuffix(unit).strip()
            factor = size
            break
    found = number(text)
    checks.require(name, value, not isinstance(found, str), "hertz, or like 20MHz")
    frequency_hz = check_frequency(name, found * factor)
    if text == str(value) and frequency_hz < LEAST_HERTZ:
        raise ValueError(f"{name} = {value} needs a unit. Write {value}MHz or {value}Hz")
    return frequency_hz


def definition(name: str, value: Any) -> tuple[str, str]:
    """Split text of the form name=value."""
    key, separator, text = str(value).partition("=")
    if not separator or not key:
        raise ValueError(f"{name} {value}: must be name=value, like spp=64")
    return key, text


def number(text: Any) -> Any:
    """Convert ASCII text to an int or a float, also NaN and infinities; return other text as is."""
    if not isinstance(text, str) or not text.isascii() or "_" in text or text != text.strip():
        return text
    for kind in (int, float):
        with suppress(ValueError):
            return kind(text)
    return text


# ---------------------------------------------------------------------- shared options
METAVARS: dict[str, dict[str, Any]] = {
    "scheduler": {"metavar": "ADDRESS"},
    "window": {
        "metavar": "auto|scene|START,STOP",
        "autocompletion": completion.among(["auto", SCENE_TIME]),
    },
    "pulse_width": {
        "metavar": "auto|scene|NUMBER",
        "autocompletion": completion.among(["auto", SCENE_TIME]),
    },
}
"""Settings whose values are not plain numbers, as `--help` and completion show them."""

Scene = Annotated[
    str,
    argument(
        "SCENE",
        f"{SETTINGS['scene'].help}. `tofrender scenes` lists the built-in names.",
        completion.scene,
    ),
]
Out = Annotated[Path, named("DIR", "Folder to write. An earlier result there is replaced.")]
Spp = Annotated[int | None, setting("spp")]
Pixels = Annotated[
    Size | None, size("256x256", f"{SETTINGS['size'].help}.", show_default=FROM_SCENE)
]
MaxDepth = Annotated[int | None, setting("max_depth")]
Seed = Annotated[int, setting("seed", default=None)]
Variant = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Mitsuba variant, for example llvm_ad_rgb.",
        autocompletion=completion.variant,
        show_default="cuda_ad_rgb where it works, otherwise llvm_ad_rgb",
    ),
]
Workers = Annotated[int | None, setting("workers", default="no workers")]
Scheduler = Annotated[str | None, setting("scheduler", default=None)]
FORMAT = (
    "File format of the transient (one EXR per bin, one PNG per bin, one EXR of all bins, NPZ, "
    "Zarr)"
)
Format = Annotated[str, choice(FORMATS, FORMAT)]
Precision = Annotated[str, choice(("half", "float"), "Precision of EXR files")]
Video = Annotated[bool, typer.Option(help="Write video.mp4.")]
Figure = Annotated[str, choice(("png", "pdf", "svg"), "File type of figures")]
Dpi = Annotated[
    int | None,
    integer(20, 2400, "Resolution of figures in dots per inch", show_default="each figure's own"),
]


# ---------------------------------------------------------------------- groups of options
@dataclass(frozen=True)
class Picture:
    """Options of commands that render a picture of a scene."""

    spp: Spp = None
    size: Pixels = None
    max_depth: MaxDepth = None
    seed: Seed = 0
    variant: Variant = None


@dataclass(frozen=True)
class Drawing:
    """Options of commands that draw a figure."""

    figure: Figure = "png"
    dpi: Dpi = None


@dataclass(frozen=True)
class Files:
    """Options of commands that write all files of a render."""

    format: Format = "frames"
    precision: Precision = "float"
    video: Video = True
    figure: Figure = "png"
    dpi: Dpi = None

    def __post_init__(self) -> None:
        # Some formats do not support half precision
        if self.format in ("npz", "zarr", "png") and self.precision != "float":
            raise ValueError(
                f"--precision = {self.precision}: must be float with --format {self.format}"
            )


@dataclass(frozen=True)
class Processes:
    """Options of commands that can use several processes."""

    workers: Workers = None
    scheduler: Scheduler = None

    def __post_init__(self) -> None:
        if self.workers is not None and self.scheduler is not None:
            raise ValueError("--scheduler and --workers cannot be combined. Use one of them")

    @property
    def are_given(self) -> bool:
        """Whether the user has given one of the options."""
        return self.workers is not None or self.scheduler is not None

    def client(self) -> AbstractContextManager[Client | None]:
        """Open a Dask client of the processes; None without an option."""
        from tofrender.rendering.workers import workers_for

        return workers_for(self.workers, self.scheduler)


@dataclass(frozen=True)
class Group:
    """Options that become one argument of a command.

    Attributes:
        make: Function that returns the argument. It is called with the values of all options.
        options: The options, as parameters of a function.
    """

    make: Callable[..., Any]
    options: tuple[Parameter, ...]

    @classmethod
    def of_record(cls, record: type) -> Group:
        """Return the group of a dataclass, with an option for each field."""
        hints = get_type_hints(record, include_extras=True)
        defaults = {
            each.name: Parameter.empty if each.default is MISSING else each.default
            for each in fields(record)
        }
        options = [
            Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=hints[name])
            for name, default in defaults.items()
        ]
        return cls(record, tuple(options))

    @classmethod
    def of_settings(cls, defaults: Mapping[str, Any], special: Mapping[str, Any]) -> Group:
        """Return a group of settings of a render, which become a dict.

        Args:
            defaults: Default of each setting by name.
            special: Annotations of options that the table of settings does not describe.
        """
        options = []
        for name, default in defaults.items():
            is_switch = SETTINGS[name].check is checks.boolean
            shown = FROM_SCENE if default is None else None
            kind = Annotated[bool if is_switch else Any, setting(name, default=shown)]
            annotation = special.get(name, kind)
            options.append(
                Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
            )
        return cls(dict, tuple(options))


def with_groups(command: Callable[..., None]) -> Callable[..., None]:
    """Let a command have the options of its groups.

    A group is a parameter whose type is a dataclass of options, or is annotated by a `Group`.
    """
    groups: dict[str, Group] = {}
    parameters = []
    old = signature(command, eval_str=True)
    for each in old.parameters.values():
        metadata = getattr(each.annotation, "__metadata__", ())
        if isinstance(each.annotation, type) and is_dataclass(each.annotation):
            groups[each.name] = Group.of_record(each.annotation)
        elif metadata and isinstance(metadata[0], Group):
            groups[each.name] = metadata[0]

        # Replace a group by its options
        if each.name in groups:
            parameters += groups[each.name].options
        else:
            parameters.append(each.replace(kind=Parameter.KEYWORD_ONLY))

    @wraps(command)
    def call(**values: Any) -> None:
        for name, group in groups.items():
            of_group = {each.name: values.pop(each.name) for each in group.options}
            values[name] = group.make(**of_group)
        command(**values)

    call.__signature__ = old.replace(parameters=parameters)  # type: ignore
    return call


# ---------------------------------------------------------------------- parts of commands
def with_progress(command: Callable[..., None]) -> Callable[..., None]:
    """Add the option --no-progress to a command. `app.Command` reads the option."""

    @wraps(command)
    def call(progress: bool, **options: Any) -> None:
        command(**options)

    is_shown = Annotated[bool, typer.Option(help=f"{SETTINGS['progress'].help}.")]
    progress = Parameter("progress", Parameter.KEYWORD_ONLY, default=True, annotation=is_shown)
    old = signature(command, eval_str=True)
    new = old.replace(parameters=[*old.parameters.values(), progress])
    call.__signature__ = new  # type: ignore
    return call


def activate(variant: str | None = None, polarized: bool = False) -> None:
    """Activate a Mitsuba variant that can render; `polarized` variants only where allowed."""
    backend.activate(variant)
    variants.require_vectorized()
    if not polarized:
        variants.require_unpolarized()


def say(*lines: str, err: bool = False) -> None:
    """Print lines on stdout or stderr, above progress bars."""
    with bars_cleared():
        for line in lines:
            typer.echo(checks.printable(line), err=err)


def note(line: str) -> None:
    """Print a line on stderr."""
    say(line, err=True)


def dots(dpi: int | None) -> dict[str, Any]:
    """Return the argument `dpi` of `save_figure`, or no argument if `dpi` is None."""
    return {} if dpi is None else {"dpi": dpi}


@contextmanager
def _naming_out() -> Iterator[None]:
    """Let errors of the block name --out instead of `path`."""
    try:
        yield
    except (ValueError, OSError) as error:
        raise ValueError(str(error).replace("path =", "--out =", 1)) from None


def check_out(
    out: Path, shape: tuple[int, int, int, int] | None = None, precision: str = "float"
) -> None:
    """Raise an error if a folder cannot be written, or a disk is too small for this transient."""
    from tofrender.io import check_output

    with _naming_out():
        check_output(out, shape, precision=precision, overwrite=True)
    check_disk_space(out)


def check_file_out(out: Path, *suffixes: str, overwrite: bool = False) -> None:
    """Raise an error if a file cannot be written, or has none of the suffixes."""
    with _naming_out():
        check_file(out, *suffixes, overwrite=overwrite, needed_bytes=FIGURE_BYTES)


def check_disk_space(out: Path, *counts: int) -> None:
    """Raise an OSError if the disk is too small for float32 arrays with these numbers of values."""
    with _naming_out():
        check_writable(out, 4 * sum(counts) + FIGURE_BYTES)


def check_apart(out: Path, source: Path) -> None:
    """Raise a ValueError if an output is the source, inside the source, or a parent of the source.

    The command would replace its own input.
    """
    written = out.resolve()
    read = source.resolve()
    if written == read or written in read.parents or read in written.parents:
        raise ValueError(f"--out = {out}: must be outside of {source}, which is read")


def load_render(out: Path, option: str) -> xr.Dataset:
    """Load a render from a folder that `tofrender render` wrote.

    Args:
        out: The folder.
        option: Name of the option or argument with the folder, for messages.

    Raises:
        ValueError: The folder does not contain a render, or only pictures.
    """
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
    if (out / "steady.png").exists():
        raise ValueError(
            f"{option}: {name} contains PNG pictures only, which cannot be read back. Use a folder "
            "that `tofrender render` wrote with another --format"
        )
    raise ValueError(
        f"{option}: {name} does not contain a render. Use a folder that `tofrender render` wrote"
    )
