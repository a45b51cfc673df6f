"""Scenes for Mitsuba and for packages that use Mitsuba. Functions import Mitsuba when called."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

FEATURES = {"camera", "crop", "glass", "grid", "lens", "medium", "meter", "mirror", "rough", "sky"}
"""Abilities of Mitsuba's plugins."""


def start(variant: str = "llvm_ad_rgb") -> Any:
    """Import Mitsuba and set a variant. TOFBENCH_BACKEND names another backend, such as cuda."""
    import mitsuba as mi

    wanted = variant.replace("llvm", os.environ.get("TOFBENCH_BACKEND", "llvm"))
    if mi.variant() != wanted:
        mi.set_variant(wanted)
    mi.set_log_level(mi.LogLevel.Error)
    return mi


def cached(load: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that loads equal scenes only once."""
    found = cache(lambda text: load(*json.loads(text)))
    return lambda *parts: found(json.dumps(parts))


def gray(value: float) -> dict:
    """Describe a gray spectrum."""
    import mitsuba as mi

    if mi.variant() and "mono" in mi.variant():
        return {"type": "uniform", "value": value}
    return {"type": "rgb", "value": [value] * 3}


def material(described: dict) -> dict:
    """Describe a BSDF."""
    kind = described["kind"]
    if kind == "diffuse":
        result = {"type": "diffuse", "reflectance": gray(described["albedo"])}
        return {"type": "twosided", "bsdf": result} if described.get("two_sided") else result
    if kind == "mirror":
        return {"type": "conductor", "material": "none"}
    if kind == "rough":
        rough = {"distribution": "beckmann", "alpha": described["alpha"], "material": "none"}
        return {"type": "roughconductor"} | rough
    if kind == "glass":
        return {"type": "dielectric", "int_ior": described["index"], "ext_ior": 1.0}
    return {"type": "null"}


def medium(described: dict) -> dict:
    """Describe a medium."""
    # Scattering, absorption and phase function
    scattering = described["scattering"]
    absorption = described["absorption"]
    extinction = scattering + absorption
    phase: dict = {"type": described["phase"]}
    if phase["type"] == "hg":
        phase["g"] = described["g"]
    albedo = {"albedo": scattering / extinction, "phase": phase}
    if "grid" not in described:
        return {"type": "homogeneous", "sigma_t": extinction} | albedo
    import mitsuba as mi

    # The density is constant except in one corner, which sets the majorant
    grid = described["grid"]
    density = np.ones((8, 8, 8, 1), np.float32)
    density[0, 0, 0] = grid["corner"]
    place = mi.ScalarTransform4f().translate(grid["low"]).scale(grid["size"])
    volume = {"type": "gridvolume", "grid": mi.VolumeGrid(density), "filter_type": "nearest"}
    volume["to_world"] = place
    return {"type": "heterogeneous", "sigma_t": volume, "scale": extinction} | albedo


def shape(described: dict, media: dict) -> dict:
    """Describe a shape."""
    import mitsuba as mi

    # Geometry
    result: dict = {"bsdf": material(described["material"])}
    kind = described["kind"]
    if kind == "sphere":
        result |= {"type": "sphere", "center": described["center"], "radius": described["radius"]}
        result["flip_normals"] = described.get("inward", False)
    elif kind == "box":
        place = mi.ScalarTransform4f().translate(described["center"]).scale(described["half"])
        result |= {"type": "cube", "to_world": place}
    else:
        u = np.array(described["u"], float)
        v = np.array(described["v"], float)
        normal = np.cross(u, v)
        matrix = np.eye(4)
        matrix[:3] = np.stack([u, v, normal / np.linalg.norm(normal), described["center"]], axis=1)
        result |= {"type": kind, "to_world": mi.ScalarTransform4f(matrix)}

    # Light, media and motion
    if "radiance" in described:
        result["emitter"] = {"type": "area", "radiance": gray(described["radiance"])}
    for side, name in (("interior", "inside"), ("exterior", "outside")):
        if name in described:
            result[side] = media[described[name]]
    if "velocity" in described:
        result["velocity"] = described["velocity"]
    return result


def light(described: dict) -> dict:
    """Describe a light."""
    if described["kind"] == "sky":
        return {"type": "constant", "radiance": gray(described["radiance"])}
    intensity = gray(described["intensity"])
    result = {"type": "point", "position": described["position"], "intensity": intensity}
    return result | ({"velocity": described["velocity"]} if "velocity" in described else {})


def sensor(described: dict, media: dict, film: dict, sampler: str = "independent") -> dict:
    """Describe a sensor."""
    import mitsuba as mi

    # Film and sampler
    film = {"width": described["width"], "height": described["height"]} | film
    film["rfilter"] = {"type": "box"}
    if "crop" in described:
        names = ("crop_offset_x", "crop_offset_y", "crop_width", "crop_height")
        film |= dict(zip(names, described["crop"], strict=True))
    result = {"film": film, "sampler": {"type": sampler, "sample_count": 16}}
    if "medium" in described:
        result["medium"] = media[described["medium"]]

    # An irradiance meter, or a camera
    if described["kind"] == "meter":
        return result | {"type": "irradiancemeter"}
    look = mi.ScalarTransform4f().look_at(*(described[k] for k in ("origin", "target", "up")))
    result |= {"type": "perspective", "to_world": look, "fov": described["fov"]}
    result |= {"fov_axis": "smaller", "near_clip": 1e-4, "far_clip": 1e3}
    if "aperture_radius" in described:
        names = ("aperture_radius", "focus_distance")
        result |= {"type": "thinlens"} | {name: described[name] for name in names}
    return result


def dictionary(scene: dict, integrator: dict, film: dict, sampler: str = "independent") -> dict:
    """Return a scene for `mi.load_dict`."""
    media = {name: medium(each) for name, each in scene["media"].items()}
    depth = {"max_depth": scene["segments"], "rr_depth": 8 if scene["segments"] < 0 else 64}
    result = {"type": "scene", "integrator": depth | integrator}

    # Add shapes. A meter is part of a shape
    camera = sensor(scene["camera"], media, film, sampler)
    for name, each in scene["shapes"].items():
        result[name] = shape(each, media)
        if scene["camera"]["kind"] == "meter" and scene["camera"]["on"] == name:
            result[name]["sensor"] = camera
    if scene["camera"]["kind"] != "meter":
        result["sensor"] = camera
    return result | {name: light(each) for name, each in scene["lights"].items()}


def film_of(bins: dict) -> dict:
    """Return the parameters of mitransient's film, which other packages support, too."""
    names = {"count": "temporal_bins", "start": "start_opl", "width": "bin_width_opl"}
    return {"type": "transient_hdr_film"} | {new: bins[old] for old, new in names.items()}


def has_media(scene: dict) -> bool:
    """Whether a scene contains media."""
    return bool(scene["media"])


def capture(scene: dict, bins: dict, integrator: dict) -> dict:
    """Describe a capture of one point of the relay wall z = 0. The laser spot gets `power`."""
    import mitsuba as mi

    # The sensor
    wall = scene["wall"]
    device = np.array(wall["device"], float)
    meter = {"type": "nlos_capture_meter", "sensor_origin": list(device)}
    meter |= {"film": film_of(bins) | {"width": 1, "height": 1, "rfilter": {"type": "box"}}}
    meter["sampler"] = {"type": "independent", "sample_count": 16}

    # The laser
    lit = np.array([0, 0, 0] if wall["capture"] == "confocal" else wall["lit"], float)
    distance = float(np.linalg.norm(device - lit))
    look = mi.ScalarTransform4f().look_at(device.tolist(), lit.tolist(), [0, 1, 0])
    laser = {"type": "spot", "to_world": look, "cutoff_angle": 5.0, "beam_width": 4.0}
    laser["intensity"] = gray(wall["power"] * distance**3 / device[2])

    # The integrator
    options = {"type": "transient_nlos_path", "max_depth": scene["segments"]}
    options |= {"nlos_laser_sampling": True, "nlos_hidden_geometry_sampling": True}
    options |= {"account_first_and_last_bounces": False, "temporal_filter": "box"}
    options["capture_type"] = {"single": 1, "confocal": 2}[wall["capture"]]
    bsdf = material({"kind": "diffuse", "albedo": wall["albedo"]})
    return {
        "type": "scene",
        "integrator": options | integrator,
        "relay_wall": {"type": "rectangle", "bsdf": bsdf, "sensor": meter},
        "laser": laser,
        **{name: shape(each, {}) for name, each in scene["shapes"].items()},
    }


def derivative(scene: dict, bins: dict, loaded: Any, samples: int, seed: int) -> np.ndarray:
    """Return the derivatives of all light, and of light times length, (1, 1, 2)."""
    import drjit as dr
    import mitsuba as mi

    # Attach the gradient
    name, kind, value = bins["by"]
    parameters = mi.traverse(loaded)
    θ = mi.Float(value)
    dr.enable_grad(θ)
    if kind == "albedo":
        parameters[f"{name}.bsdf.reflectance.value"] = mi.Color3f(θ)
    else:
        place = shape(scene["shapes"][name], {})["to_world"]
        moved = mi.Transform4f().translate(mi.Vector3f(0, 0, θ - value))
        parameters[f"{name}.to_world"] = moved @ mi.Transform4f(mi.Matrix4f(place.matrix))
    parameters.update()

    # Differentiate in forward mode
    film = mi.render(loaded, parameters, spp=samples, seed=seed)[1]
    dr.forward(θ)
    gradient = np.array(dr.grad(film))[..., 0]
    lengths = bins["start"] + bins["width"] * (np.arange(bins["count"]) + 0.5)
    return np.stack([gradient.sum(axis=-1), gradient @ lengths], axis=-1)


def split_stokes(film: np.ndarray) -> np.ndarray:
    """Reshape (height, width, bins, 4 or more) to all bins of S0, then of S1, S2 and S3."""
    return np.moveaxis(film[..., :4], -1, 2).reshape(*film.shape[:2], -1)
