"""What the tests of scenes share: refusals, and who sees whom."""

from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import tofrender


def refusal(call: Callable, *arguments: Any, kind: Any = ValueError, **options: Any) -> str:
    """The one line with which a call refuses."""
    with pytest.raises(kind, match=r"\A.+\Z") as error:
        call(*arguments, **options)
    return str(error.value)


def load(described: dict) -> mi.Scene:
    """A scene whose shapes Mitsuba does not merge."""
    return tofrender.load_scene(described, optimize=False)


def pixel_rays(scene: mi.Scene, width: int, height: int) -> mi.Ray3f:
    """Rays through the pixels' centers, row by row."""
    index = dr.arange(mi.UInt32, width * height)
    at = mi.Point2f((index % width + 0.5) / width, (index // width + 0.5) / height)
    return scene.sensors()[0].sample_ray(0, 0.5, at, 0.5)[0]


def seen(described: dict, size: int, *names: str) -> np.ndarray:
    """Which of size x size pixels see one of these shapes at their center."""
    scene = load(described)
    shape = scene.ray_intersect(pixel_rays(scene, size, size)).shape
    found = [shape == mi.ShapePtr(each) for each in scene.shapes() if each.id() in names]
    return np.any(np.array(found), axis=0).reshape(size, size)


def numbers(seed: int, count: int) -> mi.Sampler:
    """Random numbers for so many lanes."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, count)
    return sampler


def random_directions(lanes: int = 1 << 18, seed: int = 0) -> mi.Vector3f:
    return mi.warp.square_to_uniform_sphere(numbers(seed, lanes).next_2d())


def random_rays(center: Sequence[float]) -> mi.Ray3f:
    direction = random_directions()
    return mi.Ray3f(mi.Point3f(center) + dr.zeros(mi.Float, dr.width(direction)), direction)
