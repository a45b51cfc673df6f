"""Output of commands that are done: lines for people or, with --json, one object for scripts.

`SCHEMAS` lists the objects' keys, and docs/for_scripts.md describes them; keys may be added.
"""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from .options import say, switch

if TYPE_CHECKING:
    import xarray as xr

Json = Annotated[bool, switch("--json", "Print the result as one JSON object.")]

_CHECK = {"name": str, "ok": bool, "detail": str, "remedy": str, "required": bool}
_WRITTEN = {"out": str, "files": list[str]}
_PICTURE = _WRITTEN | {"width": int, "height": int}
_SAMPLING = {"spp": int, "seed": int}
_BINNED = {"out": str, "complete": bool, "scene": str, "bins": int, "start_opl": float}
_BINNED |= {"bin_width": float, **_SAMPLING}
_RENDER = {"channels": int, "integrator": str, "pulse": str, "max_depth": int, "sampler": str}
_RENDER |= {"variant": str, "render_seconds": float, "energy_outside_window": float}
_AGREEMENT = {"recording": str, "poses": int, "correlation": float, "correlation_p10": float}
_AGREEMENT |= {"log_correlation": float, "log_correlation_p10": float}
_AGREEMENT |= {"zone_correlation": list[float], "peak_error_m": float, "peak_error_p90_m": float}
_AGREEMENT |= {"peak_near": float, "counts_near": float}

SCHEMAS: dict[str, dict[str, Any]] = {
    "scenes": {"scenes": [{"name": str, "description": str}]},
    "doctor": {"works": bool, "checks": [_CHECK]},
    "render": _PICTURE | _BINNED | _RENDER,
    "phasor": _PICTURE | {"source": str, "frequencies_hz": list[float]},
    "gate": _PICTURE | {"scene": str, "at": float, "pulse_width": float, **_SAMPLING},
    "doppler": _PICTURE
    | {"scene": str, "frequency_hz": float, "exposure": float, "cycles": int, "waveform": str}
    | _SAMPLING,
    "fmcw": _PICTURE
    | {"scene": str, "resolution": float, "rate_resolution": float, "bins": int}
    | {"rate_bins": int, **_SAMPLING, "energy_outside_window": float},
    "sense": _WRITTEN
    | {"source": str, "sensor": str, "quantity": str, "seed": int, "cycles": int}
    | {"expected": float | None, "total": float},
    "capture": _BINNED | {"mode": str, "columns": int, "rows": int},
    "lidar": _WRITTEN | {"scene": str, "shots": int, "points": int},
    "twin": _WRITTEN
    | {"source": str, **_SAMPLING, "table": [_AGREEMENT]}
    | {"wrong_mesh_correlation": float, "later_scale": float},
    "reconstruct": _WRITTEN | {"source": str, "method": str, "median_depth": float | None},
}
"""Types of the values that each command's object has, in their order."""


def answer(command: str, as_json: bool, facts: Any, lines: Iterable[str]) -> None:
    """Print what a command has done on stdout: its facts, or lines of text."""
    from tofrender import __version__

    if as_json:
        about = {"command": command, "version": __version__}
        lines = [json.dumps(about | facts, allow_nan=False)]
    say(*lines)


def dataset_facts(command: str, dataset: "xr.Dataset", more: Mapping[str, Any]) -> dict[str, Any]:
    """Facts of a command's schema from a Dataset's attributes, and more."""
    attrs = dataset.attrs
    given = {"bins": dataset.sizes["opl"], "bin_width": attrs["bin_width_opl"], **more}
    complete = {"complete": attrs.get("complete", 1)}  # Captures of earlier versions have none
    found = complete | attrs | given
    return {name: convert(found[name]) for name, convert in SCHEMAS[command].items()}


def render_facts(dataset: "xr.Dataset", out: Path, files: list[str]) -> dict[str, Any]:
    """Facts of a render."""
    sizes = dataset.sizes
    picture = {"width": sizes["x"], "height": sizes["y"], "channels": sizes["channel"]}
    return dataset_facts("render", dataset, {"out": out, "files": files, **picture})
