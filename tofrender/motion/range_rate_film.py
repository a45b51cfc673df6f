"""Light by path length and by the rate of change of path length, the input of FMCW lidars."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from os import PathLike
from typing import Unpack

import mitsuba as mi
import numpy as np
import xarray as xr

from ..films.rate_bins import Axis, RateRecording, rate_film
from ..integrators.render_loop import render_all
from ..rendering.dataset import LOST_ENERGY, pixels_and_channels
from ..rendering.labels import labeled
from ..rendering.time_window import windowed_film
from ..runtime import checks
from ..scenes.motion import motions_of
from .opening import MovingSettings, open_moving, split_settings

RATES = 65  # Default number of bins of the rate. For an odd number, the rate 0 is a bin's center
RADIANCE = {"units": "W m^-2 sr^-1", "long_name": "radiance per bin"}


def range_rate(
    scene: mi.Scene | Mapping[str, object] | str | PathLike[str],
    *,
    bins: int | None = None,
    window: tuple[float, float] | None = None,
    rate_bins: int = RATES,
    rates: tuple[float, float] | None = None,
    **settings: Unpack[MovingSettings],
) -> xr.Dataset:
    """Render light by path length and by the rate of change of path length.

    Args:
        scene: As for `render`. Parts move as described in the scene or set by `moving`.
        bins: Number of bins of path length. The default is that of the scene's film.
        window: Start and stop of path lengths [m]. The default is that of the scene's film.
        rate_bins: Number of bins of the rate.
        rates: Start and stop of the rates [m/s], positive for growing lengths. The default is plus
            and minus four times the largest speed of a part, or 1 m/s for scenes at rest.
        **settings: As for `doppler`.

    Returns:
        A Dataset with the `radiance` of each bin (y, x, opl, rate, channel) and `steady` (y, x,
        channel) [W m^-2 sr^-1]. `opl` [m] and `rate` [m/s] are the centers of the bins. The
        attributes `bin_width_opl` and `bin_width_rate` are the widths of the bins.

    Raises:
        ValueError: If an argument or the scene is wrong.
        MemoryError: If the bins do not fit into memory.
        KeyboardInterrupt: If the render was stopped.

    Warns:
        UserWarning: If more than 1 % of the energy is outside the bins.

    Example:
        >>> import tofrender
        >>> scene = tofrender.load_scene("cornell_box", width=8, height=8, optimize=False)
        >>> scene = tofrender.moving(scene, {"small-box": tofrender.Motion(velocity=(0, 0, 10))})
        >>> light = range_rate(scene, bins=50, window=(3.5, 15), rate_bins=9, spp=4, progress=False)
        >>> dict(light["radiance"].sizes)
        {'y': 8, 'x': 8, 'opl': 50, 'rate': 9, 'channel': 3}
    """
    # Check the arguments
    render_settings, checkpoint, progress = split_settings(
        "range_rate", scene, settings, bins=bins, window=window
    )
    checks.require("window", window, window != "auto", "(start, stop) in meters")
    count = checks.integer("rate_bins", rate_bins, 1, checks.MAX_BINS)
    span = rates if rates is None else checks.interval("rates", rates, "(start, stop) in m/s")

    # Open the scene, and choose the axes
    loaded, camera, tracer, spp = open_moving(render_settings)
    window_of = windowed_film(camera.film(), *render_settings.time_axis)
    opl = Axis(window_of.temporal_bins, window_of.start_opl, window_of.bin_width_opl)
    low, high = default_rates(loaded) if span is None else span
    rate = Axis(count, low, (high - low) / count)

    # Render
    film = rate_film(camera.film(), opl, rate)
    record = RateRecording(film, opl, rate)
    record.require_memory(spp)
    plan = tracer.tracer(loaded, camera, record)
    identity = {"rates": [low, high], "rate_bins": count, "bins": opl.count}
    identity["window"] = [window_of.start_opl, window_of.end_opl()]
    render_all(
        loaded,
        tracer,
        camera,
        plan,
        record,
        spp,
        render_settings.seed,
        checkpoint,
        progress,
        **identity,
    )

    # Separate the axes of path length and rate, and warn of light outside of the bins
    steady, bins_of_rates = film.take()
    height, width = steady.shape[:2]
    light = bins_of_rates.reshape(height, width, opl.count, rate.count, -1)
    steady = steady[:, :, : light.shape[-1]]
    inside = float(light.sum(dtype=float)) / (float(steady.sum(dtype=float)) or 1.0)
    if steady.any() and 1 - inside > LOST_ENERGY:
        warnings.warn(f"{1 - inside:.1%} of the energy is outside the bins", stacklevel=2)

    # Label the result
    centers = {
        name: each.start + (np.arange(each.count) + 0.5) * each.width
        for name, each in (("opl", opl), ("rate", rate))
    }
    return labeled(
        xr.Dataset(
            {
                "radiance": (("y", "x", "opl", "rate", "channel"), light, RADIANCE),
                "steady": (("y", "x", "channel"), steady),
            },
            coords=pixels_and_channels(film, light.shape[-1])
            | {
                "opl": centers["opl"],
                "rate": ("rate", centers["rate"], {"units": "m/s", "long_name": "rate of length"}),
            },
            attrs={
                "scene": render_settings.scene_label,
                "spp": spp,
                "seed": render_settings.seed,
                "quantity": "radiance",
                "energy_outside_window": min(max(1 - inside, 0.0), 1.0),
                **{"bin_width_opl": opl.width, "bin_width_rate": rate.width},
            },
        )
    )


def default_rates(scene: mi.Scene) -> tuple[float, float]:
    """Return the default range of rates [m/s]: four times the largest speed, 1 m/s at rest."""
    largest = 4 * fastest(scene) or 1.0
    return -largest, largest


def fastest(scene: mi.Scene) -> float:
    """Return the largest speed [m/s] of the corners of the moving parts' bounding boxes."""
    largest = 0.0
    motions = motions_of(scene)
    for part in [*scene.shapes(), *scene.sensors(), *scene.emitters()]:
        if part.id() in motions:
            largest = max(largest, motions[part.id()].speed_at(part.bbox()))
    return largest
