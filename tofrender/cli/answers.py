"""Output of commands that are done: lines for people or, with --json, one object for scripts.

The classes are the objects' schemas. docs/for_scripts.md describes them; keys may be added.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypedDict, get_type_hints

from .options import say, switch

if TYPE_CHECKING:
    import xarray as xr

Json = Annotated[bool, switch("--json", "Say what was made as one JSON object.")]


class Scene(TypedDict):
    """A built-in scene."""

    name: str
    description: str


class Scenes(TypedDict):
    """`tofrender scenes`."""

    scenes: list[Scene]


class Check(TypedDict):
    """A check of `tofrender doctor`."""

    name: str
    ok: bool
    detail: str
    remedy: str
    required: bool


class Doctor(TypedDict):
    """`tofrender doctor`."""

    works: bool
    checks: list[Check]


class _Written(TypedDict):
    out: str
    files: list[str]


class _Picture(_Written):
    width: int
    height: int


class _Binned(TypedDict):
    out: str
    complete: bool
    scene: str
    bins: int
    start_opl: float
    bin_width: float
    spp: int
    seed: int


class Render(_Picture, _Binned):
    """`tofrender render`."""

    channels: int
    integrator: str
    pulse: str
    max_depth: int
    sampler: str
    variant: str
    render_seconds: float
    energy_outside_window: float


class Phasor(_Picture):
    """`tofrender phasor`."""

    source: str
    frequencies_hz: list[float]


class Gate(_Picture):
    """`tofrender gate`."""

    scene: str
    at: float
    pulse_width: float
    spp: int
    seed: int


class Capture(_Binned):
    """`tofrender capture`."""

    mode: str
    columns: int
    rows: int


class Reconstruct(_Written):
    """`tofrender reconstruct`."""

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


def dataset_facts(kind: Any, dataset: xr.Dataset, more: Mapping[str, Any]) -> Any:
    """Facts of a schema from a Dataset's attributes, and more."""
    attrs = dataset.attrs
    given = {"bins": dataset.sizes["opl"], "bin_width": attrs["bin_width_opl"], **more}
    complete = {"complete": attrs.get("complete", 1)}  # Captures of earlier versions have none
    found = complete | attrs | given
    return {name: convert(found[name]) for name, convert in get_type_hints(kind).items()}


def render_facts(dataset: xr.Dataset, out: Path, files: list[str]) -> Render:
    """Facts of a render."""
    sizes = dataset.sizes
    picture = {"width": sizes["x"], "height": sizes["y"], "channels": sizes["channel"]}
    return dataset_facts(Render, dataset, {"out": out, "files": files, **picture})
