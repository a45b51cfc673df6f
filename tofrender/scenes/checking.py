"""What a loaded scene must not have: light that nobody follows, and numbers that are none."""

from __future__ import annotations

import math
import re
from collections import Counter
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import checks
from .media import require_sound_media
from .numbers import finite, first_wrong, floats_of, is_transform

LIGHT = re.compile(r"(.*\.)?(radiance|irradiance|intensity|texture|scale|\w+_scale|data)(\.\w+)?")
"""Parameters of emitters that say how bright they are."""

SINGULAR = 1e-12
"""Volume of a unit cube after a transform, over that of its edges', where there is no inverse."""

INVERSE = 1e-4
"""Largest error of a transform's product with its inverse, over what rounding acts on."""

GAP = 1500 * 2.0**-24
"""How far off a surface rays start, over 1 m and the largest coordinate (Mitsuba's RayEpsilon)."""

EXTENT = 0.03
"""Least diagonal of a scene, over 1 m and the largest coordinate: light and lengths are then right
to .5 %, measured in a diffuse sphere and the Cornell box by all integrators."""

SENSOR = "a sensor of the scene, as scene.sensors()[0]"


def check_scene(
    scene: mi.Scene,
    sensor: mi.Sensor | None = None,
    *,
    media: bool = False,
    polarisation: bool = False,
) -> None:
    """Refuse a scene whose picture would be wrong or black without a word.

    The sensor is the one that looks at it; None stands for all of the scene's. `media` says that
    participating media are followed, `polarisation` that polarised light is.

    Raises:
        ValueError: As `require_modelled`, `require_sound`, `require_extent` and
            `require_sound_media`; one line that names the object.

    Example:
        >>> lamp = {"type": "point", "intensity": {"type": "rgb", "value": [1, -2, 1]}}
        >>> check_scene(mi.load_dict({"type": "scene", "lamp": lamp}))
        Traceback (most recent call last):
        ValueError: lamp.intensity.value = [1, -2, 1]: must be 0 or more, light cannot be negative
    """
    require_modelled(scene, sensor, media=media, polarisation=polarisation)
    require_sound(scene, sensor)
    require_extent(scene)
    if media:
        require_sound_media(scene, sensor)


def check_view(
    scene: mi.Scene, sensor: mi.Sensor, *, media: bool = False, polarisation: bool = False
) -> None:
    """`check_scene` for a sensor that must be one.

    Raises:
        ValueError: As `check_scene`, or it is no sensor; one line.
    """
    check_scene(scene, sensor, media=media, polarisation=polarisation)
    checks.instance("sensor", sensor, mi.Sensor, SENSOR)


def require_modelled(
    scene: mi.Scene,
    sensor: mi.Sensor | None = None,
    *,
    media: bool = False,
    polarisation: bool = False,
) -> None:
    """Refuse what changes the light and is not followed: polarisation and media unless they are.

    Raises:
        ValueError: The scene is one of another variant, the variant is polarised, or a shape,
            an emitter or the sensor is in a medium; one line.
    """
    active = mi.variant() or "none"
    if not hasattr(scene, "variant_name"):
        allowed = f"a loaded scene of the active variant {active}"
        raise ValueError(f"scene = {checks.quote(scene)}: must be {allowed}")
    if scene.variant_name() != active:
        raise ValueError(
            f"scene: belongs to the variant {scene.variant_name()}; must be one of the active "
            f"variant {active}, load it again"
        )
    if mi.is_polarized and not polarisation:
        raise ValueError(
            f"variant = {active!r}: must be one without polarisation, which is not followed, "
            f"like {active.replace('_polarized', '')}"
        )
    if sensor is not None:
        checks.instance("sensor", sensor, mi.Sensor, SENSOR)
    if media:
        return
    cameras = scene.sensors() if sensor is None else [sensor]
    for node in mi.traverse(scene).hierarchy:
        if isinstance(node, mi.Shape):
            _refuse_medium(node, "interior_medium", node.interior_medium())
            _refuse_medium(node, "exterior_medium", node.exterior_medium())
    for endpoint in [*scene.emitters(), *cameras]:
        _refuse_medium(endpoint, "medium", endpoint.get_medium())


def _refuse_medium(owner: Any, what: str, medium: Any) -> None:
    if medium is not None:
        raise ValueError(
            f"{owner.id() or owner.class_name()}.{what} = {medium.class_name()}: must be left out; "
            "participating media are not followed"
        )


def require_sound(scene: mi.Scene, sensor: mi.Sensor | None = None) -> None:
    """Refuse parameters that are not finite, negative light, and transforms without an inverse.

    Looks at each number once: a millisecond or two, and as long again for a million vertices. The
    sensor need not be the scene's.

    Raises:
        ValueError: One line with the object, its parameter and the value.
    """
    sources = [mi.traverse(scene)]
    if sensor is not None and sensor not in sources[0].hierarchy:
        sources.append(mi.traverse(sensor))
    values = {name: source[name] for source in sources for name in source.keys()}  # noqa: SIM118
    numbers = {name: list(floats_of(value)) for name, value in values.items()}
    dr.eval(numbers)
    for name, leaves in numbers.items():
        arrays = [np.asarray(leaf) for leaf in leaves]
        if not all(finite(each) for each in arrays) and not _may_be_infinite(values[name], arrays):
            called = _called(name, scene)
            raise ValueError(f"{first_wrong(called, arrays, np.isfinite)}: must be finite numbers")
        if is_transform(values[name]) and len(arrays) == 16:
            _require_inverse(_called(name, scene), values[name])
    for emitter in scene.emitters():
        _require_positive(emitter)
    for shape in scene.shapes():
        _require_extent(shape)


def _called(name: str, scene: mi.Scene) -> str:
    """A parameter's name; of an object without an id, the object's class and which one it is."""
    address = re.match(r"object_(\d+)(?=\.)", name)
    if address is None:
        return name
    counts: Counter[str] = Counter()
    for each in [*scene.shapes(), *scene.emitters(), *scene.sensors()]:
        counts[each.class_name()] += 1
        if each.ptr == int(address[1]):
            return f"{each.class_name()} {counts[each.class_name()]}{name[address.end() :]}"
    return name


def require_extent(scene: mi.Scene) -> None:
    """Refuse a scene that is so small, or so far from the origin, that gaps beside rays show.

    Mitsuba starts rays off surfaces by 9e-5 (1 m + the largest coordinate), however small all is.

    Raises:
        ValueError: One line with the extent and what is allowed.
    """
    box: Any = scene.bbox()
    low, high = np.ravel(box.min).astype(float), np.ravel(box.max).astype(float)
    if not (np.isfinite([low, high]).all() and (low <= high).all()):
        return
    extent, far = float(np.linalg.norm(high - low)), float(np.abs([low, high]).max())
    least = EXTENT * (1 + far)
    if extent < least:
        raise ValueError(
            f"scene: its shapes span {extent:.3g} m, up to {far:.3g} m from the origin; must span "
            f"at least {least:.3g} m there, where rays start {GAP * (1 + far):.2g} m off surfaces; "
            "scale it up"
        )


def _may_be_infinite(value: Any, arrays: list[np.ndarray]) -> bool:
    """Whether these are coefficients of a colour's spectrum; those of black and white are."""
    coefficients = mi.is_spectral and isinstance(value, mi.Color3f)
    return bool(coefficients and not np.isnan(arrays).any())


def _require_inverse(name: str, transform: Any) -> None:
    matrix = np.array(transform.matrix, dtype=float).reshape(4, 4)
    edges = np.linalg.norm(matrix[:3, :3], axis=0)
    if not abs(np.linalg.det(matrix[:3, :3])) > SINGULAR * math.prod(edges):
        shown = np.round(matrix, 6).tolist()
        raise ValueError(f"{name} = {shown}: must be a transform with an inverse, no scale of 0")
    require_right_inverse(name, transform)


def require_right_inverse(name: str, transform: Any) -> None:
    """Refuse a transform that keeps a wrong inverse, as a rotation about a long axis does.

    Raises:
        ValueError: One line with its name and its matrix.
    """
    matrix, inverse = (
        np.array(each.matrix, dtype=float).reshape(4, 4)[:3, :3]
        for each in (transform, transform.inverse())
    )
    if not np.isfinite([matrix, inverse]).all():
        return  # Refused elsewhere
    off = np.abs(matrix @ inverse - np.eye(3)).max()
    if off > INVERSE * (np.abs(matrix) @ np.abs(inverse)).max():
        shown = np.round(np.array(transform.matrix, dtype=float).reshape(4, 4), 6).tolist()
        raise ValueError(
            f"{name} = {shown}: must be a transform whose inverse is right; rotations need an axis "
            "of length 1"
        )


def _require_positive(emitter: mi.Emitter) -> None:
    """Refuse an emitter that takes light away."""
    shape = emitter.get_shape()
    owner = (emitter if shape is None else shape).id() or emitter.class_name()
    parameters = mi.traverse(emitter)
    for name in parameters.keys():  # noqa: SIM118, Mitsuba's parameters are no dict
        value = parameters[name]
        if not LIGHT.fullmatch(name) or is_transform(value):
            continue
        if mi.is_spectral and isinstance(value, mi.Color3f):  # Coefficients, of either sign
            continue
        arrays = [np.asarray(leaf) for leaf in floats_of(value)]
        if any(each.size and each.min() < 0 for each in arrays):
            shown = first_wrong(f"{owner}.{name}", arrays, lambda x: x >= 0)
            raise ValueError(f"{shown}: must be 0 or more, light cannot be negative")


def _require_extent(shape: mi.Shape) -> None:
    """Refuse a mesh that is a point, as one is after a scale of 0."""
    if shape.is_mesh():
        box: Any = shape.bbox()
        if np.all(np.ravel(box.max) == np.ravel(box.min)):
            raise ValueError(
                f"{shape.id() or shape.class_name()}.vertex_positions: are all in one point; "
                "must span a surface"
            )
