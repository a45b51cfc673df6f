"""What the commands of `tofrender` have in common: options as text, and the folder they write."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import xarray as xr

FILES = {"frames": "", "multipart": "stack.exr", "npz": "transient.npz"}
"""What holds the transient in the output folder, by --format."""


def number(text: str) -> int | float | str:
    """The number that `text` spells, NaN and infinities too, or `text` for a check to refuse."""
    if re.fullmatch(r"[+-]?\d+", text, re.ASCII):
        return int(text)
    try:
        return text if "_" in text else float(text)
    except ValueError:
        return text


def split_size(text: str, option: str = "--size", example: str = "256x256") -> tuple[str, str]:
    """Width and height of `64x48`."""
    width, separator, height = text.lower().partition("x")
    if not separator:
        raise ValueError(f"{option} = {text!r}: must be width x height, like {example}")
    return width, height


def definitions(defines: Sequence[str]) -> dict[str, str]:
    """Names and values of `-D name=value`."""
    pairs = {}
    for define in defines:
        name, separator, value = define.partition("=")
        if not separator or not name:
            raise ValueError(f"-D {define}: must be name=value, like -D spp=64")
        pairs[name] = value
    return pairs


def check_out(out: Path, film: Any = None, precision: str = "float") -> None:
    """Refuse a folder that cannot be written, or a disk too small for what `film` collects."""
    from tofrender.io import check_output

    shape = getattr(film, "shape", None)
    try:
        check_output(out, shape, precision=precision, overwrite=True)
    except OSError as error:
        raise ValueError(str(error).replace("path =", "--out =", 1)) from None


def load_render(out: Path, option: str) -> xr.Dataset:
    """What `tofrender render` has left in `out`; `option` is what asks for it."""
    from tofrender import io

    for path, load in (
        (out / FILES["npz"], io.load_npz),
        (out / FILES["multipart"], io.load_exr_stack),
        (out / "steady.exr", lambda _: io.load_exr_stack(out)),
    ):
        if path.exists():
            return load(path)
    raise ValueError(f"{option}: {out} holds no render")


def settings_of(**texts: str | None) -> dict[str, Any]:
    """Settings of `load_scene` from the texts of options of the same names, each one checked."""
    from ..scenes.settings import CHECKS

    values = dict(texts)
    if values.get("size") is not None:
        values["width"], values["height"] = split_size(str(values["size"]))
    values.pop("size", None)
    return {
        name: CHECKS[name]("--size" if name in ("width", "height") else f"--{name}", number(text))
        for name, text in values.items()
        if text is not None
    }
