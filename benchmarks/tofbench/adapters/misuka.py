"""misuka, a renderer of sound. Its microphone records a sphere from all sides.

The license allows non-commercial use only.
"""

from __future__ import annotations

from functools import cache

import numpy as np

INSTALL = "pip install misuka (non-commercial license)"
ABILITIES = frozenset({"bins", "ear"})


def version() -> str:
    from importlib.metadata import PackageNotFoundError, version as number

    try:
        return f"misuka {number('misuka')}"
    except PackageNotFoundError as error:
        raise ImportError("misuka is not installed") from error


def _uniform(value: float) -> dict:
    return {"type": "uniform", "value": value}


@cache
def _load(count: int, width: float, segments: int, ear: tuple, parts: tuple):
    import misuka

    misuka.set_variant("llvm_ad_acoustic")
    misuka.set_log_level(misuka.LogLevel.Error)
    (radius, albedo), (lamp, radiance) = parts

    # Describe the scene
    film = {"type": "tape", "frequencies": "250, 500", "time_bins": count}
    film["rfilter"] = {"type": "box"}
    integrator = {"type": "acoustic_prb", "max_time": count * width, "speed_of_sound": 1.0}
    integrator |= {"max_energy_loss": -1.0, "max_depth": segments, "hide_emitters": True}
    place = misuka.ScalarTransform4f()
    described = {
        "type": "scene",
        "integrator": integrator,
        "sensor": {"type": "microphone", "film": film, "to_world": place.translate(list(ear))},
        "wall": {
            **{"type": "sphere", "to_world": place.scale(radius), "flip_normals": True},
            "bsdf": {"type": "diffuse", "reflectance": _uniform(albedo)},
        },
        "lamp": {
            **{"type": "sphere", "to_world": place.scale(lamp)},
            "bsdf": {"type": "diffuse", "reflectance": _uniform(0.0)},
            "emitter": {"type": "area", "radiance": _uniform(radiance)},
        },
    }
    return misuka.load_dict(described)


def render(scene: dict, bins: dict, samples: int, seed: int) -> np.ndarray:
    import misuka

    wall = scene["shapes"]["wall"]
    lamp = scene["shapes"]["lamp"]
    parts = ((wall["radius"], wall["material"]["albedo"]), (lamp["radius"], lamp["radiance"]))
    ear = tuple(scene["camera"]["origin"])
    loaded = _load(bins["count"], bins["width"], scene["segments"], ear, parts)
    tape = np.array(misuka.render(loaded, spp=samples, seed=seed + 1))
    return tape.reshape(bins["count"], -1)[:, 0][None, None]
