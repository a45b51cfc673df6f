"""Tables of a scene's emitters, made once before light starts at them."""

from __future__ import annotations

import math
import re
from typing import Any

import mitsuba as mi
import numpy as np

from .surfaces import number_of

CONES = {"PointLight": "point", "SpotLight": "spot", "Projector": "projector"}
SHAPES = {"AreaLight": "area"}
BEAMS = {"DirectionalArea": "directionalarea"}
DISTANT = {
    "DirectionalEmitter": "directional",
    "ConstantBackgroundEmitter": "constant",
    "EnvironmentMapEmitter": "envmap",
    "SunskyEmitter": "sunsky",
    "TimedSunskyEmitter": "timed_sunsky",
}
KINDS = CONES | SHAPES | BEAMS | DISTANT
"""Emitters that light can be followed from: names of their classes, and their plugins'."""


def chances(emitters: list[mi.Emitter]) -> tuple[Any, mi.Float, mi.Float]:
    """Return the distribution over emitters, None if their weights alone are used.

    Also the chance by weight over that chance, and that chance where the weight is 0: both by the
    emitter's number.
    """
    weights = np.array([float(emitter.sampling_weight()) for emitter in emitters])
    hit = [not mi.has_flag(emitter.flags(), mi.EmitterFlags.Delta) for emitter in emitters]
    lost = (weights == 0) & hit
    if not lost.any():
        return None, mi.Float(1), mi.Float(0)
    own = np.where(lost, weights.sum() / max(np.count_nonzero(weights), 1) or 1, weights)
    numbers = [int(number_of(mi.EmitterPtr(emitter))[0]) for emitter in emitters]
    rarer, alone = np.zeros((2, max(numbers) + 1), np.float32)
    rarer[numbers] = own.sum() / (weights.sum() or 1) * (weights > 0)
    alone[numbers] = lost * own / own.sum()
    return mi.DiscreteDistribution(mi.Float(own)), mi.Float(rarer), mi.Float(alone)


def cones(emitters: list[mi.Emitter]) -> mi.Float:
    """Apex, axis and height over a unit sphere's base of each cone, by the emitter's number."""
    numbers = [int(number_of(mi.EmitterPtr(emitter))[0]) for emitter in emitters]
    table = np.zeros((max(numbers) + 1, 7), dtype=np.float32)
    for row, emitter in zip(numbers, emitters, strict=True):
        if emitter.class_name() in CONES:
            frame = np.array(emitter.world_transform().matrix, dtype=float).reshape(4, 4)
            parameters: Any = mi.traverse(emitter)
            apex = parameters["position"] if "position" in parameters else frame[:3, 3]
            axis = frame[:3, 2] / np.linalg.norm(frame[:3, 2])
            height = 1 - math.cos(_half_angle(emitter))
            table[row] = [*np.ravel(np.array(apex)), *axis, height]
    return mi.Float(table.ravel())


def by_area(emitters: list[mi.Emitter]) -> mi.Float:
    """Return 1 over the area of each area light [1/m²], by the emitter's number.

    That is `pdf_position` of its shape, which would ask all living shapes; some have none.
    """
    numbers = [int(number_of(mi.EmitterPtr(emitter))[0]) for emitter in emitters]
    table = np.zeros(max(numbers) + 1, dtype=np.float32)
    for row, emitter in zip(numbers, emitters, strict=True):
        shape: Any = emitter.get_shape()
        if shape is not None:
            table[row] = 1 / float(np.ravel(np.array(shape.surface_area()))[0])
    return mi.Float(table.tolist())


def places(emitters: list[mi.Emitter]) -> mi.UInt32:
    """The place of each emitter among these, by its number."""
    numbers = [int(number_of(mi.EmitterPtr(emitter))[0]) for emitter in emitters]
    table = np.zeros(max(numbers, default=0) + 1, dtype=np.uint32)
    table[numbers] = range(len(numbers))
    return mi.UInt32(table)


def _half_angle(emitter: mi.Emitter) -> float:
    """Largest angle to its axis in which an emitter at a point shines [rad]."""
    if emitter.class_name() == "PointLight":
        return math.pi
    parameters: Any = mi.traverse(emitter)
    if emitter.class_name() == "SpotLight":
        return math.radians(float(np.ravel(parameters["cutoff_angle"])[0]))
    # A projector says its angle nowhere else; its picture's form is the window's
    wide = math.tan(math.radians(float(re.findall(r"x_fov = (\S+),", str(emitter))[0])) / 2)
    height, width = (
        parameters["irradiance.data"].shape[:2] if "irradiance.data" in parameters else (1, 1)
    )
    return math.atan(wide * math.hypot(1, height / width))
