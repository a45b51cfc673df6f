"""Calls of a user's functions for the warp tester, in the process of the user's module.

Points are exchanged as arrays of shape (dimensions, n).
"""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .subjects import SUBJECTS, Functions

KINDS = {2: "mi.Point2f", 3: "mi.Vector3f"}


def sample(theirs: Any, subject: str, values: dict[str, Any], numbers: np.ndarray) -> list[Any]:
    """Return warped points. A light also returns their validity and their densities."""
    # Call the sampler
    given = SUBJECTS[subject]
    result: Any = _functions(theirs, subject, values)[0](mi.Point2f(np.ascontiguousarray(numbers)))
    points: Any
    points, *more = result if isinstance(result, tuple) and result else (result,)

    # Check the type of the points
    size = given.dimensions
    if not dr.is_array_v(points) or dr.depth_v(points) != 2 or dr.size_v(points) != size:
        kind = type(points).__name__
        raise TypeError(f"{given.names[0]} returns a value of type {kind}; must be {KINDS[size]}")
    dr.eval(points, more)
    return [np.array(points.numpy()), *(np.array(mi.Float(each)) for each in more)]


def density(theirs: Any, subject: str, values: dict[str, Any], points: np.ndarray) -> np.ndarray:
    """Return the density at points."""
    # Call the density
    given = SUBJECTS[subject]
    kind: Any = mi.Point2f if given.dimensions == 2 else mi.Vector3f
    value = _functions(theirs, subject, values)[1](kind(np.ascontiguousarray(points)))

    # Check the type of the result
    is_number = isinstance(value, int | float) or (dr.is_array_v(value) and dr.depth_v(value) == 1)
    if not is_number or dr.is_mask_v(value):
        first, *second = given.names
        name = second[0] if second else f"{first}.pdf"
        raise TypeError(f"{name} returns a value of type {type(value).__name__}; must be mi.Float")
    return np.array(mi.Float(value))


_last: list[tuple[Any, Functions]] = []


def _functions(theirs: Any, subject: str, values: dict[str, Any]) -> Functions:
    """Return the sampling function and the density of a subject.

    Both are made again for another subject or other parameters.
    """
    key = (subject, {k: np.asarray(v).tobytes() for k, v in values.items()})
    if not _last or _last[0][0] != key:
        _last[:] = [(key, SUBJECTS[subject].make(lambda name: getattr(theirs, name), **values))]
    for name in SUBJECTS[subject].names:
        getattr(theirs, name)  # The judge notes which names are used
    return _last[0][1]
