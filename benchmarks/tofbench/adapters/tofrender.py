"""tofrender, with the functions that users call."""

from __future__ import annotations

import numpy as np

from . import mitsuba_scenes as scenes

INSTALL = "pip install tofrender"
QUANTITIES = {"bins", "phasor", "gate", "stokes", "rate", "nlos", "gradient", "locate"}
ABILITIES = scenes.FEATURES | QUANTITIES | {"pulse", "inside", "half-space", "moving gradient"}


def version() -> str:
    scenes.start()
    import tofrender

    return f"tofrender {tofrender.__version__}"


@scenes.cached
def _load(scene: dict, bins: dict):
    scenes.start("llvm_ad_mono_polarized" if bins["quantity"] == "stokes" else "llvm_ad_rgb")
    import tofrender

    if bins["quantity"] == "nlos":
        return tofrender.load_scene(scenes.capture(scene, bins, {}), optimize=False)

    # Choose integrator and film
    kind = "transient_volpath" if scenes.has_media(scene) else "transient_path"
    window = {"count": 1, "start": 0.0, "width": 1e3}
    in_time = bins["quantity"] not in ("rate", "gate", "phasor")
    film = scenes.film_of(window | bins if in_time else window)
    integrator = {"type": kind}
    if "pulse" in bins or bins["quantity"] == "gradient":
        integrator["pulse_width_opl"] = bins.get("pulse", 0.05)
    described = scenes.dictionary(scene, integrator, film)
    return tofrender.load_scene(described, optimize=False)


def _locate(scene: dict, bins: dict) -> np.ndarray:
    """Return the center of the brightest voxel of a backprojection."""
    import tofrender

    # Make a capture
    opl = np.array(scene["opl"])
    grid = np.array(scene["grid"])
    film = np.zeros((*opl.shape, bins["count"]))
    k = ((opl - bins["start"]) / bins["width"]).astype(int)
    np.put_along_axis(film, k[..., None], np.array(scene["light"])[..., None], axis=-1)
    y, x = np.meshgrid(grid, grid, indexing="ij")
    points = np.stack([x, y, 0 * x], axis=-1)
    window = {"start_opl": bins["start"], "bin_width_opl": bins["width"]}
    wall = {"sensor_grid": points, "sensor_normals": np.broadcast_to((0.0, 0.0, 1.0), points.shape)}
    capture = tofrender.make_capture(film, mode="confocal", **window, **wall)

    # Reconstruct. The ranges of the volume are from center to center
    half = [(high - low) / (n - 1) / 2 for low, high, n in scene["volume"]]
    extents = zip(scene["volume"], half, strict=True)
    volume = tuple((low - h, high + h, int(n)) for (low, high, n), h in extents)
    found = tofrender.reconstruct(capture, "bp", volume=volume, progress=False)["intensity"]
    at = found.stack(voxel=("x", "y", "z"))
    brightest = at[int(np.argmax(at.values))]
    return np.array([float(brightest[axis]) for axis in "xyz"])[None, None]


def render(scene: dict, bins: dict, samples: int, seed: int) -> np.ndarray:
    quantity = bins["quantity"]
    if quantity == "locate":
        scenes.start()
        return _locate(scene, bins)
    loaded = _load(scene, bins)
    import mitsuba as mi

    import tofrender

    # Gradients, phasors, gates and rates
    options = {"spp": samples, "seed": seed, "progress": False}
    if quantity == "gradient":
        return scenes.derivative(scene, bins, loaded, samples, seed)
    if quantity == "phasor":
        frequencies = list(bins["frequencies_hz"])
        found = tofrender.render_amcw_phasor(loaded, loaded.sensors()[0], frequencies, **options)
        return np.concatenate([np.moveaxis(part[..., 0], 0, -1) for part in found[:2]], axis=-1)
    if quantity == "gate":
        gated = {"type": "time_gated_transient_path", "pulse_width_opl": bins["width"]}
        gated = mi.load_dict(gated | {"max_depth": scene["segments"]})
        parts = [
            tofrender.render_at_time(loaded, gated, loaded.sensors()[0], opl, samples, seed)
            for opl in bins["opl"]
        ]
        return np.stack([part[..., 0] for part in parts], axis=-1)
    if quantity == "rate":
        end = bins["start"] + bins["count"] * bins["width"]
        rates = {"rates": (bins["start"], end), "rate_bins": bins["count"]}
        found = tofrender.range_rate(loaded, bins=1, window=(0.0, 1e3), **rates, **options)
        return found["radiance"].isel(channel=0, opl=0).transpose("y", "x", ...).values

    # Bins, also of polarized light
    found = tofrender.render(loaded, **options)["transient"]
    if quantity == "stokes":
        return scenes.split_stokes(found.isel(channel=0).transpose(..., "stokes").values)
    return found.values[..., 0]
