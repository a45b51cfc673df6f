"""Warps as students write them: right, wrong, raising, and not written yet."""

from pathlib import Path

RIGHT = """
import drjit as dr
import mitsuba as mi


def square_to_tent(sample):
    return mi.Point2f(dr.select(sample < 0.5, dr.sqrt(2 * sample) - 1, 1 - dr.sqrt(2 - 2 * sample)))


def square_to_tent_pdf(p):
    height = dr.maximum(1 - dr.abs(p), 0)
    return height.x * height.y
"""
WRONG = """
import drjit as dr
import mitsuba as mi


def square_to_cosine_hemisphere(sample):
    r = dr.sqrt(sample.x)
    sin_phi, cos_phi = dr.sincos(dr.two_pi * sample.y)
    return mi.Vector3f(r * cos_phi, r * sin_phi, dr.sqrt(1 - sample.x))


def square_to_cosine_hemisphere_pdf(v):
    return dr.select(v.z > 0, dr.inv_two_pi, mi.Float(0))
"""
RAISES = """
def square_to_uniform_disk(sample):
    return radius_of(sample)


def radius_of(sample):
    raise RuntimeError("<b>no</b> & never")


def square_to_uniform_disk_pdf(p):
    return 1.0
"""
STUB = '''
def square_to_uniform_sphere(sample):
    """Warp to the sphere."""
    raise NotImplementedError("a1.sphere_and_hemispheres: square_to_uniform_sphere")


def square_to_uniform_sphere_pdf(v):
    raise NotImplementedError("a1.sphere_and_hemispheres: square_to_uniform_sphere_pdf")
'''
HOSTILE = """
import os
from pathlib import Path

import mitsuba as mi


def square_to_tent(sample):
    Path(__file__).with_name("written.txt").write_text("here I am")
    return mi.Point2f(sample)


def square_to_tent_pdf(p):
    os._exit(0)
"""
FILES = {"tent.py": RIGHT, "cosine.py": WRONG, "disk.py": RAISES, "sphere.py": STUB}


def write_warps(folder: Path, **changes: str) -> Path:
    """A student's folder; `tent=HOSTILE` changes tent.py."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in (FILES | {f"{key}.py": text for key, text in changes.items()}).items():
        (folder / name).write_text(text.lstrip(), encoding="utf-8")
    return folder
