"""Telling whether two renders are of the same scene."""

from __future__ import annotations

import hashlib
import re
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np


def fingerprint(scene: mi.Scene, sensor: mi.Sensor, integrator: Any) -> str:
    """A short hash of all that a picture depends on, but for film, samples and seed.

    All parameters of shapes, materials, lights and the sensor count, and the integrator as it
    prints itself.

    Returns:
        Twelve hexadecimal digits.
    """
    parts = [str(integrator), sensor.class_name()]
    parts += [f"{shape.class_name()} {shape.bsdf().class_name()}" for shape in scene.shapes()]
    parts += [emitter.class_name() for emitter in scene.emitters()]
    for prefix, part in (("scene", scene), ("sensor", sensor)):
        parameters = mi.traverse(part)
        for name in list(parameters.keys()):
            if "film." not in name:
                parts.append(f"{prefix}.{name} = {_digest(parameters[name])}")
    # Mitsuba loads in parallel: the order varies, and nameless parts are named by their address
    lines = sorted(re.sub(r"object_\d+", "object", part) for part in parts)
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:12]


def _digest(value: Any) -> str:
    """A parameter as text; arrays by a hash that does not depend on the order of meshes in them."""
    if not dr.is_array_v(value) or dr.is_special_v(value):
        return str(value)
    return hashlib.sha256(np.sort(np.array(value), axis=None).tobytes()).hexdigest()
