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

    All parameters of shapes, materials, lights, sensor and integrator count.

    Returns:
        Twelve hexadecimal digits.
    """
    parts = [type(integrator).__name__, sensor.class_name()]
    parts.append(f"integrator.hide_emitters = {integrator.hide_emitters}")  # Mitsuba keeps this one
    parts += [f"integrator.{name} = {_said(value)}" for name, value in vars(integrator).items()]
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


def _said(value: Any) -> str:
    """A parameter of an integrator as text: shapes by their ids, parts as they print themselves."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_said, value))}]"
    return value.id() if isinstance(value, mi.Shape) else str(value)


def _digest(value: Any) -> str:
    """A parameter as text; arrays by a hash that does not depend on the order of meshes in them."""
    if not dr.is_array_v(value) or dr.is_special_v(value):
        return str(value)
    return hashlib.sha256(np.sort(np.array(value), axis=None).tobytes()).hexdigest()
