"""Telling whether two renders are of the same scene."""

from __future__ import annotations

import hashlib
import re
from functools import cached_property
from inspect import isclass, isroutine
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
    own = {"hide_emitters": None, **getattr(integrator, "__dict__", {})}  # Mitsuba keeps the first
    for name, value in own.items():
        parts.append(f"integrator.{name} = {_said(getattr(integrator, name, value))}")
    parts += [f"{shape.class_name()} {shape.bsdf().class_name()}" for shape in scene.shapes()]
    parts += [emitter.class_name() for emitter in scene.emitters()]
    for prefix, part in (("scene", scene), ("sensor", sensor)):
        parameters = mi.traverse(part)
        for name in list(parameters.keys()):
            if "film." not in name:
                parts.append(f"{prefix}.{name} = {_digest(name, parameters[name])}")
    # Mitsuba loads in parallel: the order varies, and nameless parts are named by their address
    lines = sorted(re.sub(r"object_\d+", "object", part) for part in parts)
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:12]


def _said(value: Any, depth: int = 5) -> str:
    """A parameter of an integrator as text: shapes by their ids, other objects by what they hold.

    Of objects that print themselves, like pulses of the package, their text and what is public.
    """
    if isinstance(value, list | tuple):
        return f"[{', '.join(_said(each, depth) for each in value)}]"
    if isinstance(value, np.ndarray):
        return _hash(value)
    if isinstance(value, mi.Shape):
        return value.id()
    if not depth or isroutine(value) or isclass(value) or not hasattr(value, "__dict__"):
        return _digest("", value)
    kind, silent = type(value), type(value).__repr__ is object.__repr__
    inside = ", ".join(
        f"{name} = {_said(each, depth - 1)}"
        for name, each in vars(value).items()
        if (silent or name[0] != "_") and not isinstance(getattr(kind, name, 0), cached_property)
    )
    return f"{kind.__name__ if silent else value}({inside})"


def _digest(name: str, value: Any) -> str:
    """A parameter as text; arrays by a hash, those of meshes by one without their order in it."""
    if not dr.is_array_v(value) or dr.is_special_v(value):
        return re.sub(r" at 0x[0-9a-fA-F]+", "", str(value))
    array = np.array(value)
    sizes = {"vertex_positions": 3, "vertex_normals": 3, "vertex_texcoords": 2, "faces": 1}
    size = sizes.get(name.rpartition(".")[2])
    if size is not None:
        rows = array.reshape(-1, size)
        array = rows[np.lexsort(rows.T)]
    return _hash(array)


def _hash(array: np.ndarray) -> str:
    return hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()
