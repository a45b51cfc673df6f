"""The command `tofrender sense`."""

from pathlib import Path
from typing import Annotated

from ..io.command_files import SENSED
from ..runtime import backend
from ..runtime.progress import deferred_stop
from ..sensors.presets import PRESETS
from . import checkpoints, completion, options as opt
from .answers import Json, answer


def sense(
    source: Annotated[Path, opt.argument("DIR", "Folder of `tofrender render`.")],
    sensor: Annotated[
        str,
        opt.named(
            "NAME|FILE.toml",
            f"Preset or description of the sensor. Presets: {', '.join(PRESETS)}.",
            complete=completion.among(PRESETS),
        ),
    ],
    out: opt.Out,
    seed: opt.Seed = 0,
    figure: opt.Figure = "png",
    dpi: opt.Dpi = None,
    as_json: Json = False,
) -> None:
    """Simulate the measurement of a sensor.

    A sensor measures photon counts, correlations, gates, or a streak image of a render. The page
    docs/sensors.md describes the keys of the TOML file. The command writes sensed.nc, a NetCDF file
    with the measurement and its expectation, and the figure summary.png.

    Examples:
        tofrender sense box --sensor flash_dtof --out counts
        tofrender sense box --sensor camera.toml --seed 1 --out taps
    """
    opt.check_out(out)
    opt.check_apart(out, source)
    backend.activate()

    from tofrender import io, vis
    from tofrender.io.netcdf import save_measurement
    from tofrender.sensors.sensor_config import read_sensor, sense as measure

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

    # Sums without saturated pixels
    quantity = measured.attrs["quantity"]
    usable = 1 - measured.get("saturated", 0)
    total = float((measured[quantity] * usable).sum())
    expected = float((measured["expected"] * usable).sum()) if "expected" in measured else None
    facts = {
        "out": str(out),
        "files": files,
        "source": str(source),
        "sensor": sensor,
        "quantity": quantity,
        "seed": seed,
        "cycles": int(measured["cycles"]),
        "expected": expected,
        "total": total,
    }
    expectation = "" if expected is None else f", {expected:,.0f} expected"
    lines = [f"{out}: {', '.join(files)}", f"sum of {quantity} {total:,.0f}{expectation}"]
    answer("sense", as_json, facts, lines)
    checkpoints.end_if_stopped(stop)
