"""Bad values for each kind of argument, and the one check of how they are refused."""

import os
import re
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from helpers.made_dataset import make_dataset
from tofrender.runtime.settings import Setting

LONGEST = 600  # Characters of a line that can still be read at a glance

_PYTHONS_OWN = re.compile(
    r"Traceback|File \"|object has no attribute|object is not|unsupported operand|not supported "
    r"between|0x[0-9a-f]{6,}|incompatible function|positional argument|'NoneType' object|__\w+__|"
    r"argument must be|could not convert|ufunc|nanobind|drjit\.|Assertion|broadcast together"
)
_REMEDY = re.compile(
    r"[mM]ust |does not exist|expected |needs up to |requires? |cannot be combined|is missing|"
    r"\b([aA]dd|[rR]emove|[uU]se|[cC]hoose|[sS]elect|[pP]ass|[sS]et|[mM]ake|[rR]un|[cC]ontinue|"
    r"[cC]hange|[iI]ncrease|[rR]educe|[dD]efine|[sS]ave|[rR]estore) "
)
"""Words by which a message says what is allowed, or what to do instead."""


class Odd:
    """An object of no use to anything."""

    def __repr__(self) -> str:
        return "<an odd\nobject>"


ANY: dict[str, Any] = {
    **{"None": None, "True": True, "numpy-True": np.True_},
    **{name: float(name) for name in ("nan", "inf", "-inf")},
    **{"-1": -1, "0": 0, "1.5": 1.5, "1e30": 1e30, "2**40": 1 << 40, "10**400": 10**400},
    **{"text": "nonsense", "empty-text": "", "digits": "4", "lines": "two\nlines"},
    **{"nul": "a\0b", "bytes": b"4"},
    **{"list": [], "list-1": [1], "list-of-text": ["a", "b"], "ragged": [[1.0], [1.0, 2.0]]},
    **{"dict": {}, "dict-1": {"a": 1}, "set": {1}, "odd": Odd(), "type": int, "complex": 1j},
    **{"array-empty": np.zeros(0), "array": np.zeros((100, 7)), "array-1": np.ones(1)},
    **{"array-nan": np.full((2, 2), np.nan), "array-text": np.array(["a", "b"])},
    "array-object": np.array([None, {}], dtype=object),
    **{"date": np.datetime64("2020-01-01"), "dataset": xr.Dataset()},
}
"""Values of every sort; each kind of argument names those that are good for it."""

_NUMBERS = {"-1", "0", "1.5", "1e30", "2**40"}
_TEXTS = {"text", "empty-text", "digits", "lines", "nul"}
_ARRAYS = {"array-empty", "array", "array-nan", "array-1"}

FILM = {"temporal_bins": 4, "start_opl": 3.5, "bin_width_opl": 2.0}

NO_PIXELS = make_dataset(2, 3, 3).isel(x=slice(0, 0))

NONE_GOOD: dict[str, dict[str, Any]] = {
    # kind that nothing of ANY is good for: more that is bad
    **{kind: {} for kind in ("object", "address", "definition", "render")},
    "zone": {"nan in it": [[np.nan, 1.0]]},
    "angles": {"400": (400, 10), "0": (0, 10), "1 number": (40,), "nan": (40, np.nan)},
    "returns": {"16": 16},
    "count": {"2.0": 2.0, "numpy-0": np.int64(0), "-2**40": -(1 << 40)},
    "share": {"1.0001": 1.0001},
    "chance": {"1": 1, "1.0": 1.0},
    "choice": {"case": "CONFOCAL", "list": ["single"]},
    "point": {"2 numbers": (0, 1), "4 numbers": [0, 1, 2, 3], "nan in it": (0, 1, np.nan)},
    "pair": {"3 numbers": (0, 1, 2), "text in it": (0, "1"), "nan in it": (0, np.nan)},
    "sizes": {"(0, 4)": (0, 4), "(4,)": (4,), "4x4": "4x4", "(4.5, 4)": (4.5, 4)},
    "cube": {
        **{"flat": np.ones((2, 2)), "5-axes": np.ones((1, 1, 2, 2, 3))},
        **{"no-pixels": np.ones((0, 2, 2, 3)), "4-channels": np.ones((2, 2, 2, 4))},
        **{"complex": np.ones((2, 2, 2, 3), complex), "dataset without pixels": NO_PIXELS},
    },
    "stokes": {"3 components": np.ones((2, 2, 3, 1)), "no-pixels": np.ones((0, 2, 3, 1))},
    "picture": {"flat": np.ones(3), "complex-array": np.ones((2, 2), complex)},
    "dataset": {
        **{"path": Path("x.npz"), "array-4": np.ones((2, 2, 2, 3)), "no-pixels": NO_PIXELS}
    },
    "volume": {"no-voxels": xr.Dataset({"intensity": (("z", "y", "x"), np.zeros((0, 2, 2)))})},
    "scene": {"path": Path("x.xml"), "built-in": "cornell_box"},
    "source": {"no-file": "no_such_file.xml", "misspelt": "cornel_box", "folder": Path()},
    "parameters": {"misspelt": {"lamp.positio": 1.0}, "text in it": {"lamp.position": "a"}},
    "pyramid-depth": {"1": 1, "65": 65},
    "radius": {"-0.0": -0.0},
    "side": {"5000": 5000},
    "inches": {"2.4": 2.4, "41.0": 41.0},
    "dots": {"19": 19, "2401": 2401},
    "samples": {"999": 999, "2000.0": 2000.0},
    "resolution": {"1": 1, "513": 513},
    "light-samples": {"65": 65, "2.0": 2.0},
    "span": {"backwards": (5.0, 3.0)},
    "window": {"backwards": (5.0, 3.0), "empty": (3.0, 3.0), "one": (1,), "all": "all"},
    "config": {"no-bins": {"start_opl": 1.0, "bin_width_opl": 1.0}, "more": FILM | {"a": 1}},
    "shape": {"3 numbers": (1, 2, 3), "negative": (1, 2, 3, -1), "fraction": (1, 2, 3, 1.5)},
    "layers": {"two sizes": {"a": np.ones((2, 2, 1)), "b": np.ones((3, 2, 1))}},
    "panel": {"complex-array": np.ones((2, 3), complex), "5 axes": np.ones((1, 2, 3, 1, 1))},
    "image": {"negative": [[1.0, -1.0]], "black": np.zeros((2, 2)), "nan": [[np.nan]]},
    "matrix": {"3x3": np.eye(3), "flat": np.zeros((4, 4)), "nan": np.eye(4) * np.nan},
    "place": {"2 numbers": (0, 1), "4 numbers": [0, 1, 2, 3]},
    "axis": {"backwards": (1.0, 0.5, 2), "no voxels": (0.5, 1.0, 0), "2 numbers": (1, 2)},
    "voxels": {"2 axes": [(0.5, 1.0, 2)] * 2, "nan": [(0.5, np.nan, 2)] * 3},
    "shapes": {"unknown": ["wand"]},
    "opl": {"outside": 1e3},
    "file": {"folder": ".", "long": "x" * 5000 + ".npz", "nothing": "none.npz"},
    "checkpoint": {"folder": ".", "long": "x" * 5000 + ".npz"},
    "renders": {"one": [xr.Dataset()] * 2},
    "figure": {"no folder": "no/a.png", "another ending": "a.jpg", "folder": "."},
}

KINDS: dict[str, tuple[set[str], dict[str, Any]]] = {
    # kind: what of ANY is good for it, and more that is bad
    **{kind: (set(), more) for kind, more in NONE_GOOD.items()},
    "integer": ({"-1", "0"}, {"2.0": 2.0}),
    "seed": ({"0"}, {"2**32": 1 << 32, "numpy-2.0": np.float64(2)}),
    "meters": (_NUMBERS, {"numpy-nan": np.float32("nan")}),
    "positive": (_NUMBERS - {"-1", "0"}, {"-0.0": -0.0, "numpy-nan": np.float32("nan")}),
    "sides": (_NUMBERS - {"-1", "0"} | {"a list"}, {}),
    "pulse-width": ({"1.5"}, {"-0.0": -0.0, "1e-30": 1e-30}),
    "fraction": ({"0"}, {"1.0001": 1.0001, "-1e-9": -1e-9}),
    "frequencies": (
        _NUMBERS - {"-1", "0"} | {"list-1", "array-1", "set"},
        {"a list with 0": [1e6, 0.0], "nested": [[1e6]]},
    ),
    "half-angle": ({"0"}, {"0.51": 0.51, "-1e-9": -1e-9}),
    "boolean": ({"True", "numpy-True"}, {"1": 1, "no": "no"}),
    "name": (_TEXTS - {"nul", "lines"}, {}),
    "label": (_TEXTS, {}),
    "path": (_TEXTS - {"empty-text", "nul"}, {"long": "x" * 5000 + ".npz"}),
    "array": (_ARRAYS | _NUMBERS | {"list", "list-1", "nan", "inf", "-inf"}, {}),
    "stokes-axis": ({"-1"}, {"2.0": 2.0, "-2**40": -(1 << 40)}),
    "mapping": ({"dict", "dict-1", "dataset"}, {"pairs": [("a", 1)], "numbers": {1: 2}}),
    "function": ({"type"}, {}),
    "depth": ({"-1"}, {"-2": -2, "2.0": 2.0}),
    "bounces": ({"-1", "0"}, {"-2": -2, "2.0": 2.0}),
    "turn": ({"0", "1.5", "-1"}, {"181": 181, "numpy-nan": np.float32("nan")}),
    "extinction": ({"0", "1.5"}, {"-1e-9": -1e-9, "numpy-nan": np.float32("nan")}),
    "roughness": ({"0", "1.5"}, {"1e7": 1e7}),
    "cosine": ({"-1", "0"}, {"1.1": 1.1}),
    "rate": ({"1.5"}, {"500": 500}),
    "cent": ({"1.5"}, {"101": 101}),
    "stops": ({"0", "1.5"}, {"-0.1": -0.1}),
    "sensor": ({"0"}, {"1": 1, "0.0": 0.0}),
    "pixel": ({"0"}, {"9": 9, "0.0": 0.0}),
    "pixels": ({"list", "array-empty", "dataset"}, {"outside": [(99, 0)], "fraction": [(0.5, 0)]}),
    "offset": ({"2**40", "1e30", "1.5", "list-1", "array-1"}, {"small": 1e-3}),
    "light": (_ARRAYS | {"nan", "inf", "-inf", "list", "list-1"} | _NUMBERS, {}),
    "colors": ({"list-1", "array-1"}, {}),
    "energies": ({"list-1", "array-1"}, {"negative": [1.0, -1.0], "nan in it": [1.0, np.nan]}),
    "length": (
        _ARRAYS | _NUMBERS | {"nan", "inf", "-inf", "True", "numpy-True", "complex", "dataset"},
        {},
    ),
    "color": (
        {"0", "1.5", "1e30", "2**40", "list-1", "array-1"},
        {"negative": (1, 1, -1), "2 numbers": (1, 2)},
    ),
    "mask": ({"True", "numpy-True"}, {"too small": np.zeros((1, 1), bool)}),
    "lanes": (_NUMBERS | {"nan", "inf", "-inf", "list-1", "array-1"}, {}),
    "from 0": (_NUMBERS - {"-1"}, {}),
    "times": ({"list-1", "array-1"}, {"nested": [[0.0]], "nan in it": [0.0, np.nan]}),
    "series": ({"list", "list-1", "array-empty", "array-1"}, {"nan in it": [1.0, np.nan]}),
    "amounts": (
        _ARRAYS - {"array-nan"} | {"list", "list-1"} | _NUMBERS - {"-1"},
        {"negative": [1.0, -1.0], "nan in it": [1.0, np.nan]},
    ),
    "from 30": ({"1e30", "2**40"}, {}),
    "alpha": ({"1.5"}, {}),
    "host": ({"0"}, {}),
    "paths": ({"list"}, {"a Dataset in it": [xr.Dataset()]}),
}

CHECKED = {
    **{"_check_size": "sizes", "_check_window": "window", "_check_length": "positive"},
    **{"_check_pulse_width": "pulse-width", "width": "pulse-width", "meters": "meters"},
    **{"mapping": "mapping", "boolean": "boolean", "address": "address", "depth": "depth"},
    "unchecked": "source",
}
"""The kind of a setting, by the function that checks it."""

TEXTS: dict[str, str] = {
    **{name: name for name in ("nan", "inf", "-inf", "-1", "0", "1.5", "1e30", "True")},
    **{"2**40": str(1 << 40), "text": "nonsense", "empty-text": "", "lines": "1\n2", "blank": " "},
    **{"underscore": "1_000", "hexadecimal": "0x10", "padded": " 4", "another script": "\u0663"},
    **{"many digits": "9" * 5000, "a list": "1,2", "a dict": "{}", "complex": "1j"},
    **{"percent": "5%", "unit": "5m", "capitals": "FRAMES", "bytes": "b'x'"},
    **{"None": "None", "a path": "../x"},
}
"""What is typed on a command line; names that are in ANY, too, are good for the same kinds."""

LONG, SURROGATE = "x" * 3000, "\udcff"

MORE_TEXTS: dict[str, list[str]] = {
    "pulse-width": ["AUTO"],
    "span": ["3", "1,2,3", "6,-6", "3,3", "3,nan", "a,b"],
    "window": ["3", "1,2,3", "15,3", "3,3", "AUTO", "3,nan", "0,1e13", "a,b"],
    "angles": ["0x8", "8x", "8x8x8", "-8x8", "361x8", "8x181", "nanx8", "8  8"],
    "sizes": ["0x8", "8x", "8x8x8", "-8x8", "8.5x8", "70000x8", "nanx8", "8  8"],
    "address": [
        *("tcp://127.0.0.1", "tcp://127.0.0.1:0", "tcp://127.0.0.1:70000", "tcp://:8786"),
        *("http://a:1", LONG, SURROGATE),
    ],
    **{"choice": [LONG, SURROGATE], "host": [LONG]},
    "definition": ["spp", "=3", "wdth=3", "a\nb=3"],
    "source": ["cornel_box", "no.xml", ".", "\x01", LONG, SURROGATE],
    **{"file": [".", "no.h5", LONG, SURROGATE], "render": [".", "no.xml", LONG, SURROGATE]},
}


def kind_of(text: str) -> str:
    """The kind itself, of `"kind?"`, which is one that may be None, or of `"kind but x, y"`."""
    return text.partition(" but ")[0].rstrip("?")


def kind_of_setting(setting: Setting) -> str:
    """The kind of a setting of `render` or `load_scene`, by its description."""
    if setting.choices:
        return "choice"
    if isinstance(setting.check, partial):
        return "count" if setting.low else "seed"
    return CHECKED[setting.check.__name__]


def bad(kind: str) -> Iterator[tuple[str, Any]]:
    """Values that are bad for a kind."""
    good, more = KINDS[kind_of(kind)]
    skipped = {"None"} if "?" in kind else set()
    skipped.update(kind.partition(" but ")[2].split(", "))
    for name, value in (ANY | more).items():
        if name not in good | skipped:
            yield name, value


def bad_texts(kind: str) -> dict[str, str]:
    """The same for an option of a command."""
    good = KINDS[kind][0]
    texts = {name: text for name, text in TEXTS.items() if name not in good}
    return texts | {text: text for text in MORE_TEXTS.get(kind, [])}


CONTENTS = {
    **{"empty": b"", "text": b"some text\n" * 9, "zeros": bytes(4096), "zip": b"PK\x03\x04" * 25},
    **{"png": b"\x89PNG\r\n\x1a\n" + bytes(40), "exr": b"\x76\x2f\x31\x01" + bytes(200)},
    **{"hdf5": b"\x89HDF\r\n\x1a\n" + bytes(200), "pickle": b"cos\nsystem\n(S'true'\ntR."},
    "numpy": b"\x93NUMPY\x01\x00v\x00" + bytes(200),
}
PLACES: dict[str, Callable[[Path], Any]] = {
    "folder": Path.mkdir,
    "dangling": lambda path: path.symlink_to(path.parent / "nowhere"),
    "loop": lambda path: path.symlink_to(path),
    "pipe": os.mkfifo,
}
"""Ways to make something that is no file to be read."""

OTHER_FILES = PLACES | {
    "missing": lambda path: None,
    **{name: lambda path, it=content: path.write_bytes(it) for name, content in CONTENTS.items()},
}

ALWAYS = {"None", "nan", "inf", "-1", "0", "1.5", "text", "empty-text"}  # What is tried everywhere


def sample(kind: str, everything: bool, start: int, texts: bool = False) -> dict[str, Any]:
    """Bad values of a kind, all or some; of those that are not tried always a sixth, from start."""
    found = bad_texts(kind) if texts else dict(bad(kind))
    always = ALWAYS.union(MORE_TEXTS.get(kind, []) if texts else KINDS[kind_of(kind)][1])
    rest = [name for name in found if name not in always]
    left_out = set() if everything else set(rest) - set(rest[start % 6 :: 6])
    return {name: value for name, value in found.items() if name not in left_out}


def one_clear_line(error: BaseException, name: str, value: Any = ...) -> str:
    """What is wrong with how an error tells of a parameter and its bad value; "" if nothing is."""
    said = str(error)
    if not isinstance(error, ValueError | TypeError | MemoryError | OSError):
        return f"{type(error).__name__} is no error of bad input: {said!r}"
    if "\n" in said or not said.strip():
        return f"{len(said.splitlines())} lines: {said!r}"
    if len(said) > LONGEST:
        return f"{len(said)} characters: {said[:LONGEST]!r}"
    if _PYTHONS_OWN.search(said):
        return f"Python's words, not ours: {said!r}"
    if not re.search(rf"(?<!\w){re.escape(name)}(?!\w)", said):
        return f"does not name {name}: {said!r}"
    if not _REMEDY.search(said):
        return f"does not say what is allowed: {said!r}"
    if value is not ... and not any(word in said for word in _words(value)):
        return f"does not name the value: {said!r}"
    return ""


def _words(value: Any) -> list[str]:
    """Words by which a message may name a value: its text, or type, or shape."""
    try:
        text = [" ".join(repr(value).split()), str(value)]
    except ValueError:  # More digits than Python writes
        text = ["an integer of 1329 bits", "inf"]
    words = [*text, text[0][:20], type(value).__name__]
    if isinstance(value, dict | xr.Dataset):
        words += ["= None", "dataset with", "Dataset", "= {}", "the axis", "the variable"]
    if isinstance(value, int | float) and abs(value) < 1e300:
        words += [f"{value:g}", f"{float(value)!r}"]
    if isinstance(value, np.ndarray):
        words += [str(value.shape), str(value.dtype), *(f"{x}" for x in value.ravel()[:1])]
    if isinstance(value, list | tuple | set | dict | str):
        words += [str(len(value)), repr(value)[:20], *map(repr, value)]
        words += [f"{x:g}" for x in value if isinstance(x, int | float)]
        words += re.findall(r"[\w.]+", repr(value)) if len(value) < 9 else []
    try:
        words += [str(np.shape(value)), "row 0", "all pixels"]
    except (TypeError, ValueError):  # Ragged, or a Dataset
        words.append("list")
    return words


def outcome(call: Callable[[], Any], name: str, value: Any = ...) -> str:
    """How a call with a bad value ends: "" if it is refused as it should be."""
    try:
        got = call()
    except Exception as error:
        return one_clear_line(error, name, value)
    return f"was taken: {type(got).__name__}"


def listing(folder: Path) -> dict[str, bytes | None]:
    """All that is in a folder, and what files hold."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }
