"""Telling whether two renders are of the same scene."""

from __future__ import annotations

import hashlib
from typing import Any

import mitsuba as mi


def fingerprint(scene: mi.Scene, sensor: mi.Sensor, integrator: Any) -> str:
    """A short hash of all that a picture depends on, but for film, samples and seed.

    Args:
        scene: Its shapes, materials and lights count, with all their parameters; of large arrays
            (meshes, textures) the size and the first and last values.
        sensor: Counts with its parameters.
        integrator: Counts as it prints itself.

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
                parts.append(f"{prefix}.{name} = {parameters[name]}")
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:12]
