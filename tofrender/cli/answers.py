"""Output of finished commands: lines of text, or with --json one object for scripts.

`SCHEMAS` lists the keys of the objects. The page docs/for_scripts.md describes them. Later versions
may add keys.
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
_BINNED = {
    "out": str,
    "complete": bool,
    "scene": str,
    "bins": int,
    "start_opl": float,
    "bin_width": float,
    "spp": int,
    "seed": int,
}
_RENDER = {
    "channels": int,
    "integrator": str,
    "pulse": str,
    "max_depth": int,
    "sampler": str,
    "variant": str,
    "render_seconds": float,
    "energy_outside_window": float,
}
_AGREEMENT = {
    "recording": str,
    "poses": int,
    "correlation": float,
    "correlation_p10": float,
    "log_correlation": float,
    "log_correlation_p10": float,
    "zone_correlation": list[float],
    "peak_error_m": float,
    "peak_error_p90_m": float,
    "peak_near": float,
    "counts_near": float,
}

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
"""Keys of the object of each command in their order, with the types of the values."""


def answer(command: str, as_json: bool, facts: Any, lines: Iterable[str]) -> None:
    """Print the result of a command on stdout, as one JSON object or as lines of text.

    Args:
        command: Name of the command.
        as_json: Whether to print `facts` instead of `lines`.
        facts: Values of the JSON object, as in the schema of the command.
        lines: Lines of readable text.
    """
    from tofrender import __version__

    if as_json:
        about = {"command": command, "version": __version__}
        lines = [json.dumps(about | facts, allow_nan=False)]
    say(*lines)


def dataset_facts(command: str, dataset: "xr.Dataset", more: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of a command's schema from the attributes of a Dataset and from `more`."""
    from ..labels import bins_of  # Slow: --help does not need xarray

    found: dict[str, Any] = {
        "complete": 1,
        **dataset.attrs,
        "bins": dataset.sizes["opl"],
        "bin_width": bins_of(dataset, "dataset").bin_width_opl,
        **more,
    }
    return {name: convert(found[name]) for name, convert in SCHEMAS[command].items()}


def render_facts(dataset: "xr.Dataset", out: Path, files: list[str]) -> dict[str, Any]:
    """Return the values of the schema of `render`."""
    sizes = dataset.sizes
    picture = {"width": sizes["x"], "height": sizes["y"], "channels": sizes["channel"]}
    return dataset_facts("render", dataset, {"out": out, "files": files, **picture})
