"""The case `polarized`: time of polarized light, relative to Mitsuba's polarized `path`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import mitsuba as mi

import tofrender
from tofrender.runtime import backend

from .timing import Row, in_turn, trace

DEPTH = {"max_depth": 6, "rr_depth": 50}
KINDS = ("mono", "spectral")


def polarized(runs: int, quick: bool) -> list[Row]:
    """Render the Cornell box without and with metals and glass, at equal samples and rays."""
    size, spp = (32, 16) if quick else (128, 64)
    rows: list[Row] = []
    for kind in KINDS:
        with _in_variant(f"{str(mi.variant()).partition('_')[0]}_ad_{kind}_polarized"):
            for name, change in (("Cornell box", dict), ("metals and glass", _with_metals)):
                times = in_turn(_functions(size, spp, change), runs)
                what = f"{kind}, {name}, {size}x{size} x 300 bins, {spp} spp, over path"
                rows += times["ours"].rows(times["path"], what, wall=1.2)
    return rows


def _functions(
    size: int, spp: int, change: Callable[[dict[str, Any]], dict[str, Any]]
) -> dict[str, Callable[[], object]]:
    """Return functions that render the same scene with both integrators."""
    steady = tofrender.cornell_box_steady_state(width=size, height=size, spp=spp)
    steady["integrator"] = {"type": "path", **DEPTH}
    steady["sensor"]["sampler"] = {"type": "independent", "sample_count": spp}
    ours = tofrender.cornell_box(width=size, height=size, temporal_bins=300, spp=spp)
    ours["integrator"] = {"type": "transient_path", "light_samples": 1, **DEPTH}
    return {
        name: trace(mi.load_dict(change(each)), spp)
        for name, each in (("path", steady), ("ours", ours))
    }


def _with_metals(scene: dict[str, Any]) -> dict[str, Any]:
    """Change the boxes to metal, and add a ball of glass."""
    metal = {"type": "roughconductor", "alpha": 0.2, "eta": 0.2, "k": 3.9}
    for name in ("small-box", "large-box"):
        scene[name]["bsdf"] = metal
    ball = {"type": "sphere", "center": [0.3, -0.6, 0.75], "radius": 0.25}
    return scene | {"ball": ball | {"bsdf": {"type": "dielectric"}}}


@contextmanager
def _in_variant(name: str) -> Iterator[None]:
    """Use a variant of Mitsuba inside a `with` block."""
    before = str(mi.variant())
    backend.activate(name)
    try:
        yield
    finally:
        mi.set_variant(before)
