"""Make one record of a data set: draw its scene, render the scene, and describe the render."""

from __future__ import annotations

import json
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np
import xarray as xr

from ..analysis import true_depth, true_normals
from ..films.image import time_bins
from ..integrators.amcw import render_amcw_phasor
from ..nlos import capture as capture_scene, hidden_depth
from ..rendering.group_store import PartReceipt
from ..rendering.renderer import render
from ..runtime import checks
from ..runtime.versions import versions
from ..scenes.fingerprint import fingerprint
from ..sensors import sense
from .dataset_config import Config
from .layout import GEOMETRY, ORIGINS, DatasetLayout
from .scene import load, scene_of

FACTOR = "photons_per_radiance"
"""Name of the factor from radiance to the sensor's photons, in receipts."""


@dataclass(kw_only=True)
class RecordReceipt(PartReceipt):
    """Receipt of a record on disk, with its origin."""

    drawn: dict[str, Any]  # drawn values, by name
    about: dict[str, Any]  # everything on which the record depends, for JSON
    warnings: list[str]  # warnings of the renders
    seconds: float  # time of the renders [s]


def make_record(
    config: Config, layout: DatasetLayout, record: int, photons_per_radiance: float | None = None
) -> tuple[dict[str, np.ndarray], RecordReceipt]:
    """Make the arrays of a record. If the scene cannot be rendered, draw it again (`retry`).

    Args:
        config: Description of the data set.
        layout: Arrays of the data set.
        record: Number of the record.
        photons_per_radiance: Factor from mean radiance to `photons_per_cycle`. If it is None, the
            record's own mean signal is the `photons_per_cycle` of the sensor. The factor is in the
            receipt.

    Raises:
        ValueError: None of the drawn scenes can be rendered.
        RuntimeError: Mitsuba reports an error.
    """
    start = time.perf_counter()
    reason = ""
    for attempt in range(config.retry + 1):
        # Draw and render a scene, and collect the warnings
        drawn = config.draw(record, attempt)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                arrays, about = _rendered(
                    config, layout, record, attempt, drawn, photons_per_radiance
                )
            except ValueError as error:
                reason = " ".join(str(error).split())
                continue
            except RuntimeError as error:
                raise RuntimeError(f"record {record}: {' '.join(str(error).split())}") from error

        # Describe the record
        texts = [" ".join(str(each.message).split()) for each in caught]
        receipt = RecordReceipt(
            drawn=drawn,
            about=about,
            warnings=texts,
            seconds=time.perf_counter() - start,
        )
        return arrays, receipt

    # All attempts have failed
    tries = f", and {config.retry} more draws neither" if config.retry else ""
    shown = ", ".join(f"{name} = {shown_value(value)}" for name, value in drawn.items())
    raise ValueError(f"record {record} cannot be made{tries}: {reason} ({shown or 'no draws'})")


def shown_value(value: Any) -> str:
    """Format a drawn value for a message."""
    if isinstance(value, list):
        return f"[{', '.join(map(shown_value, value))}]"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _rendered(
    config: Config,
    layout: DatasetLayout,
    record: int,
    attempt: int,
    drawn: Mapping[str, Any],
    photons_per_radiance: float | None,
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Render the arrays of a record, and describe everything on which they depend."""
    # Load the scene, and compare its time bins with the other records
    scene = load(scene_of(config, drawn), config)
    camera: Any = scene.sensors()[config.sensor]
    bins = time_bins(camera.film())
    if bins is not None:
        _require_window(layout, *bins[1:])
    seed = config.render_seed(record, attempt)
    spp = config.settings.get("spp") or camera.sampler().sample_count()
    outputs = config.outputs
    arrays = {}

    # Describe the record
    about: dict[str, Any] = {
        "record": record,
        "attempt": attempt,
        "seed": config.seed,
        "render_seed": seed,
        "scene": config.plain["scene"],
        "scene_checksum": config.checksum,
        "drawn": dict(drawn),
        "config": config.plain,
        "variant": mi.variant(),
        "versions": json.loads(versions()),
    }
    tracer: Any = scene.integrator()
    if getattr(tracer, "traits", None) is not None:
        about["fingerprint"] = fingerprint(scene, camera, tracer)

    # Render the film, and measure it with the sensor
    common: dict[str, Any] = {"sensor": config.sensor, "progress": False}
    sampler = config.settings.get("sampler")
    if outputs.rendered or config.sense is not None:
        film = render(scene, spp=spp, seed=seed, sampler=sampler, **common)
        arrays |= {name: film[name].values for name in ("transient", "steady")}
        _require_whole(film.attrs)
        keep = ("spp", "integrator", "max_depth", "pulse", "sampler", "energy_outside_window")
        about |= {name: film.attrs[name] for name in keep}
        about["render"] = dict(film.attrs)
        if config.sense is not None:
            about["sensor_seed"] = config.render_seed(record, attempt, "sensor")
            sensor = _with_photons(config, film, photons_per_radiance, about)
            measured = sense(film, sensor, about["sensor_seed"]).drop_vars("cycles")
            arrays |= {f"sensor_{name}": each.values for name, each in measured.items()}

    # Render the independent film with fewer samples
    if outputs.noisy:
        about["noise_seed"] = config.render_seed(record, attempt, "noise")
        film = render(scene, spp=outputs.noisy, seed=about["noise_seed"], sampler=sampler, **common)
        _require_whole(film.attrs)
        arrays["noisy"] = film["transient"].values

    # Render phasors, depth, normals and the capture
    if outputs.phasor:
        parts = render_amcw_phasor(scene, camera, outputs.phasor, spp, seed, progress=False)
        arrays["phasor"] = np.stack(parts[:2], axis=-2)
    if outputs.depth:
        arrays["depth"] = true_depth(scene, config.sensor)
    if outputs.normals:
        arrays["normals"] = true_normals(scene, config.sensor)
    if outputs.capture is not None:
        arrays |= _captured(config, scene, seed, common, about)
        _require_window(layout, *(about["capture"][n] for n in ("start_opl", "bin_width_opl")))

    # Check the arrays
    for name, array in arrays.items():
        _require_light(name, array)
    layout.check(arrays)
    kept = {each.name: arrays[each.name].astype(each.dtype, copy=False) for each in layout.arrays}
    return kept, about


def _with_photons(
    config: Config, film: xr.Dataset, photons_per_radiance: float | None, about: dict[str, Any]
) -> Mapping[str, Any]:
    """Return the sensor of a record, with the mean signal that the common factor gives.

    The mean signal is photons_per_radiance times the mean radiance in the bins.
    """
    sensor = config.sense
    assert sensor is not None
    if config.photons_per_cycle is None:
        return sensor

    # The mean over pixels of what `expected_photons` scales
    light = film["transient"].mean("channel", dtype=np.float64).clip(min=0)
    mean = float(light.sum("opl").mean())
    if not mean > 0:
        raise ValueError("transient is black, no light arrives")

    if photons_per_radiance is None:
        photons_per_radiance = config.photons_per_cycle / mean
    about[FACTOR] = photons_per_radiance
    photons = sensor["photons"] | {"photons_per_cycle": photons_per_radiance * mean}
    return {**sensor, "photons": photons}


def _captured(
    config: Config, scene: mi.Scene, seed: int, common: Mapping[str, Any], about: dict[str, Any]
) -> dict[str, np.ndarray]:
    """Render a capture, its geometry, and the true depth of the hidden objects."""
    wanted = config.outputs.capture
    assert wanted is not None

    # Render the capture, and describe it
    spp = config.settings.get("spp")
    wall = wanted.relay_wall
    film = capture_scene(scene, mode=wanted.mode, spp=spp, seed=seed, relay_wall=wall, **common)
    _require_whole(film.attrs)
    names = ("start_opl", "bin_width_opl", "counts_first_and_last_legs", "spp", "capture_mode")
    about["capture"] = {n: film.attrs[n] for n in (*names, "energy_outside_window")}

    # Collect the arrays
    arrays = {"capture": film["transient"].values}
    arrays |= {f"capture_{name}": film[name].values for name in (*GEOMETRY, *ORIGINS)}
    everywhere = np.ones(arrays["capture_sensor_grid"].shape[:2], bool)
    arrays["capture_on_wall"] = film["on_wall"].values if "on_wall" in film else everywhere
    if wanted.hidden_depth:
        arrays["hidden_depth"] = hidden_depth(scene, film).values
    return arrays


def _require_window(layout: DatasetLayout, start_opl: float, bin_width_opl: float) -> None:
    """Raise a ValueError if the time bins differ from the time bins of the other records."""
    found = (float(start_opl), float(bin_width_opl))
    if layout.window is None:
        return
    if not np.allclose(found, layout.window, rtol=1e-6, atol=1e-9):
        raise ValueError(
            f"its time bins start at {found[0]:g} m (width {found[1]:g} m), in other records at "
            f"{layout.window[0]:g} m (width {layout.window[1]:g} m). Set start_opl and "
            "bin_width_opl in [render]"
        )


def _require_whole(attrs: Mapping[str, Any]) -> None:
    """Stop if a render was stopped before its last sample."""
    if not attrs.get("complete", 1):
        raise KeyboardInterrupt


LIT = ("transient", "steady", "noisy", "phasor", "capture")
"""Arrays that contain light."""


def _require_light(name: str, array: np.ndarray) -> None:
    """Raise a ValueError if light is zero or not finite, or no pixel has depths or normals."""
    if name in LIT:
        checks.finite(name, array)
        if not array.any():
            raise ValueError(f"{name} is black, no light arrives")
    elif name in ("depth", "normals") and np.isnan(array).all():
        raise ValueError(f"{name} is empty, no surface is seen")
