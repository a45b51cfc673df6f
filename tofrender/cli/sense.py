"""The command `tofrender sense`."""

from pathlib import Path
from typing import Annotated

from ..io.contents import SENSED
from ..runtime import backend
from ..runtime.progress import deferred_stop
from ..sensors.presets import PRESETS
from . import checkpoints, completion, options as opt
from .answers import Json, answer


def sense(
    source: Annotated[Path, opt.argument("DIR", "What `tofrender render` has written.")],
    sensor: Annotated[
        str,
        opt.named(f"{'|'.join(PRESETS)}|FILE.toml", "Sensor.", complete=completion.among(PRESETS)),
    ],
    out: opt.Out,
    seed: opt.Seed = 0,
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

    read_sensor(sensor)
    measured = measure(opt.load_render(source, "DIR"), sensor, seed).load()
    opt.check_disk_space(out, measured.nbytes // 4)
    files = [SENSED, f"summary.{figure}"]
    with (
        checkpoints.exclusively(out),
        deferred_stop() as stop,
        io.output_folder(out, overwrite=True) as folder,
    ):
        save_measurement(measured, folder / SENSED)
        io.save_figure(vis.measurement_figure(measured), folder / files[1], **opt.dots(dpi))
    quantity, whole = measured.attrs["quantity"], 1 - measured.get("saturated", 0)
    names = {"total": quantity, "expected": "expected"}
    sums = {k: float((measured[v] * whole).sum()) for k, v in names.items() if v in measured}
    facts = {"out": str(out), "files": files, "source": str(source), "sensor": sensor}
    facts |= {
        "quantity": quantity,
        "seed": seed,
        "cycles": int(measured["cycles"]),
        "expected": None,
    } | sums
    about = f", {sums['expected']:,.0f} expected" if "expected" in sums else ""
    lines = [f"{out}: {', '.join(files)}", f"sum of {quantity} {sums['total']:,.0f}{about}"]
    answer("sense", as_json, facts, lines)
    checkpoints.end_if_stopped(stop)
