"""The command `tofrender sense`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ..runtime import backend
from ..runtime.progress import deferred_stop
from . import checkpoints, completion, options as opt
from .answers import Json, answer

if TYPE_CHECKING:
    import xarray as xr

FILE = "sensed.nc"
PRESETS = ("flash_dtof", "scanning_dtof", "itof", "iccd_gate", "streak")


def sense(
    source: Annotated[Path, opt.argument("DIR", "What `tofrender render` has written.")],
    sensor: Annotated[
        str,
        opt.named(
            f"{'|'.join(PRESETS)}|FILE.toml",
            "Sensor, its exposure and its light.",
            complete=completion.among(PRESETS),
        ),
    ],
    out: opt.Out,
    seed: Annotated[int, opt.integer(0, (1 << 32) - 1, "Seed of the sensor's noise.")] = 0,
    figure: opt.Figure = "png",
    dpi: opt.Dpi = None,
    as_json: Json = False,
) -> None:
    """Simulate what a sensor measures of a render: photon counts, correlations, gates, a streak.

    --sensor is a preset or a TOML file; docs/sensors.md describes its keys, and the presets are
    files to start from. The command writes sensed.nc, a NetCDF file with what was measured and its
    expectation, and summary.png, with a pixel of both.
    """
    opt.check_out(out)
    opt.check_apart(out, source)
    backend.activate()

    from tofrender import io, vis
    from tofrender.io.netcdf import save_measurement
    from tofrender.sensors.config import read_sensor, sense as measure

    config = read_sensor(sensor)
    measured = measure(opt.load_render(source, "DIR"), config, seed).load()
    opt.check_disk_space(out, measured.nbytes // 4)
    with (
        checkpoints.exclusively(out),
        deferred_stop() as stop,
        io.output_folder(out, overwrite=True) as folder,
    ):
        save_measurement(measured, folder / FILE)
        page = vis.measurement_figure(measured)
        io.save_figure(page, folder / f"summary.{figure}", **opt.dots(dpi))
    files = [FILE, f"summary.{figure}"]
    found, expected = _totals(measured)
    facts = {"out": str(out), "files": files, "source": str(source), "sensor": sensor}
    facts |= {"quantity": measured.attrs["quantity"], "seed": seed}
    facts |= {"cycles": config.cycles, "total": found, "expected": expected}
    about = "" if expected is None else f", {expected:,.0f} expected"
    lines = [f"{out}: {', '.join(files)}", f"sum of {facts['quantity']} {found:,.0f}{about}"]
    answer("sense", as_json, facts, lines)
    checkpoints.end_if_stopped(stop)


def _totals(measured: xr.Dataset) -> tuple[float, float | None]:
    """Sums of what was measured and of its expectation, without saturated pixels."""
    whole = 1 - measured["saturated"] if "saturated" in measured else 1
    names = measured.attrs["quantity"], "expected"
    found = [float((measured[n] * whole).sum()) if n in measured else None for n in names]
    return found[0] or 0.0, found[1]
