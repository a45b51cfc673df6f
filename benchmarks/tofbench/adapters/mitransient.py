"""mitransient: `transient_path`, `transient_prbvolpath` with media, and `transient_nlos_path`."""

from __future__ import annotations

import numpy as np

from . import mitsuba_scenes as scenes

INSTALL = "pip install mitransient ipython"
ABILITIES = scenes.FEATURES | {"bins", "stokes", "nlos", "gradient"}


def version() -> str:
    from importlib.metadata import version as number

    # Do not import mitransient here, because its plugins exist only in the first variant
    return f"mitransient {number('mitransient')}, Mitsuba {number('mitsuba')}"


@scenes.cached
def _load(scene: dict, bins: dict):
    mi = scenes.start("llvm_ad_mono_polarized" if bins["quantity"] == "stokes" else "llvm_ad_rgb")
    import mitransient

    # Load a capture, and aim the laser
    if bins["quantity"] == "nlos":
        described = scenes.capture(scene, bins, {})
        loaded = mi.load_dict(described, parallel=False, optimize=False)
        wall = next(shape for shape in loaded.shapes() if shape.is_sensor())
        target = mi.Point3f(scene["wall"]["lit"])
        if scene["wall"]["capture"] == "confocal":
            target = mi.Point3f(0, 0, 0)
        mitransient.nlos.focus_emitter_at_relay_wall_3dpoint(target, wall, loaded.emitters()[0])
        return loaded

    # Load a scene with a camera
    kind = "transient_prbvolpath" if scenes.has_media(scene) else "transient_path"
    described = scenes.dictionary(scene, {"type": kind}, scenes.film_of(bins))
    return mi.load_dict(described, parallel=False, optimize=False)


def render(scene: dict, bins: dict, samples: int, seed: int) -> np.ndarray:
    loaded = _load(scene, bins)
    import mitsuba as mi

    if bins["quantity"] == "gradient":
        return scenes.derivative(scene, bins, loaded, samples, seed)
    film = np.array(mi.render(loaded, spp=samples, seed=seed)[1])
    return scenes.split_stokes(film) if bins["quantity"] == "stokes" else film[..., 0]
