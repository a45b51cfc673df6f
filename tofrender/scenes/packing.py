"""Make scene dicts picklable by replacing Mitsuba objects with arrays."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np


@dataclass(frozen=True)
class Packed:
    """A Mitsuba object as an array."""

    kind: str  # "transform", "bitmap" or "grid"
    values: np.ndarray  # Matrix and its inverse transpose (2, 4, 4), or pixels, or voxels
    srgb: bool = False  # Whether pixels are gamma-encoded


def packed(name: str, value: Any) -> Any:
    """Return a picklable copy of the argument `name`. The path of a scene file becomes absolute."""
    if name == "scene" and isinstance(value, str | os.PathLike):
        return str(Path(value).resolve()) if os.path.exists(value) else value
    return _packed(value, name)


def _packed(value: Any, where: str) -> Any:
    """Return a picklable copy of a value; `where` is its path for error messages."""
    if isinstance(value, Mapping):
        return {name: _packed(part, f"{where}.{name}") for name, part in value.items()}
    if isinstance(value, list | tuple):
        parts = [_packed(part, where) for part in value]
        return parts if isinstance(value, list) else tuple(parts)
    if isinstance(value, mi.ScalarTransform4f):
        both = (value.matrix, value.inverse_transpose)
        return Packed("transform", np.array(both, dtype=np.float64).reshape(2, 4, 4))
    if isinstance(value, mi.Bitmap):
        return Packed("bitmap", np.array(value), value.srgb_gamma())
    if isinstance(value, mi.VolumeGrid):
        return Packed("grid", np.array(value))
    if isinstance(value, mi.Object):
        kind = type(value).__name__
        raise ValueError(
            f"{where} = {kind}: loaded objects cannot be sent to workers. Pass a name or a dict"
        )
    return value


def unpacked(scene: Any) -> Any:
    """Return the scene from which `packed` made its result."""
    if isinstance(scene, Mapping):
        return {name: unpacked(part) for name, part in scene.items()}
    if isinstance(scene, list | tuple):
        return type(scene)(map(unpacked, scene))
    if not isinstance(scene, Packed):
        return scene
    if scene.kind == "transform":
        transform = mi.ScalarTransform4f(scene.values[0].tolist())
        # Use the stored inverse transpose, because a new one would differ by rounding
        transform.inverse_transpose = type(transform.inverse_transpose)(scene.values[1].tolist())
        return transform
    if scene.kind == "grid":
        return mi.VolumeGrid(scene.values)
    bitmap = mi.Bitmap(scene.values)
    bitmap.set_srgb_gamma(scene.srgb)
    return bitmap
