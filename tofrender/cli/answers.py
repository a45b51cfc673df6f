"""What commands say when they are done: lines for people or, with --json, one object for scripts.

The classes are the objects' schemas. docs/for_scripts.md describes them; keys may be added.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypedDict

import typer

from .options import say

if TYPE_CHECKING:
    import xarray as xr

Json = Annotated[bool, typer.Option("--json", help="Say what was made as one JSON object.")]


class Scene(TypedDict):
    """A built-in scene."""

    name: str
    description: str


class Scenes(TypedDict):
    """`tofrender scenes`."""

    scenes: list[Scene]


class Check(TypedDict):
    """What `tofrender doctor` has looked at."""

    name: str
    ok: bool
    detail: str
    remedy: str
    required: bool


class Doctor(TypedDict):
    """`tofrender doctor`."""

    works: bool
    checks: list[Check]


class Render(TypedDict):
    """`tofrender render`."""

    out: str
    files: list[str]
    complete: bool
    scene: str
    width: int
    height: int
    bins: int
    channels: int
    start_opl: float
    bin_width: float
    spp: int
    seed: int
    integrator: str
    pulse: str
    max_depth: int
    sampler: str
    variant: str
    render_seconds: float
    energy_outside_window: float


class Phasor(TypedDict):
    """`tofrender phasor`."""

    out: str
    files: list[str]
    source: str
    frequencies_hz: list[float]
    width: int
    height: int


class Gate(TypedDict):
    """`tofrender gate`."""

    out: str
    files: list[str]
    scene: str
    at: float
    pulse_width: float
    spp: int
    seed: int
    width: int
    height: int


class Capture(TypedDict):
    """`tofrender capture`."""

    out: str
    complete: bool
    scene: str
    mode: str
    columns: int
    rows: int
    bins: int
    start_opl: float
    bin_width: float
    spp: int
    seed: int


class Reconstruct(TypedDict):
    """`tofrender reconstruct`."""

    out: str
    files: list[str]
    source: str
    method: str
    median_depth: float | None


def answer(command: str, as_json: bool, facts: Any, lines: Iterable[str]) -> None:
    """Say what a command has done, on stdout: its facts, or lines of text."""
    from tofrender import __version__

    if as_json:
        about = {"command": command, "version": __version__}
        lines = [json.dumps(about | facts, allow_nan=False)]
    say(*lines)


def of_render(dataset: xr.Dataset, out: Path, files: list[str]) -> Render:
    """Facts of a render."""
    sizes = dataset.sizes
    attrs = dataset.attrs
    return {
        "out": str(out),
        "files": files,
        "complete": bool(attrs["complete"]),
        "scene": attrs["scene"],
        "width": sizes["x"],
        "height": sizes["y"],
        "bins": sizes["opl"],
        "channels": sizes["channel"],
        "start_opl": float(attrs["start_opl"]),
        "bin_width": float(attrs["bin_width_opl"]),
        "spp": int(attrs["spp"]),
        "seed": int(attrs["seed"]),
        "integrator": attrs["integrator"],
        "pulse": attrs["pulse"],
        "max_depth": int(attrs["max_depth"]),
        "sampler": attrs["sampler"],
        "variant": attrs["variant"],
        "render_seconds": float(attrs["render_seconds"]),
        "energy_outside_window": float(attrs["energy_outside_window"]),
    }
