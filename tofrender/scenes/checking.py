"""Checks of loaded scenes: unsupported features and invalid numbers raise errors."""

from __future__ import annotations

import math
import re
import warnings
from collections import Counter
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import checks
from ..runtime.interface import readable
from .media import require_sound_media
from .numbers import floats_of, is_spectral_coefficients, is_transform, require_all

LIGHT = re.compile(r"(.*\.)?(radiance|irradiance|intensity|texture|scale|\w+_scale|data)(\.\w+)?")
"""Parameters of emitters that scale the radiance, so that they must not be negative."""

SINGULAR = 1e-12
"""Transforms are singular below this ratio of determinant and product of the columns' lengths."""

INVERSE = 1e-4  # Largest relative error of the product of a transform with its inverse

GAP = 1500 * 2.0**-24
"""Offset of rays from surfaces (Mitsuba's RayEpsilon), relative to 1 m + largest coordinate."""

BEAM = "DirectionalArea"
"""Emitter that shines only along the normal of its surface."""

TIMED_SKY = "TimedSunskyEmitter"
"""Emitter that Mitsuba 3.9 can evaluate in scalar variants only."""

WAVELENGTHS = {
    "RegularSpectrum": "regular",
    "IrregularSpectrum": "irregular",
    "BlackBodySpectrum": "blackbody",
}
"""Classes of spectra that only spectral variants evaluate, and their plugins."""

NARROWEST_SPOT = 0.05
"""Smallest cutoff angle [degrees] of a spot with 1 % error of power; at 0.02 the error is 37 %."""

EXTENT = 0.03
"""Smallest diagonal of a scene, relative to 1 m plus the largest coordinate. The error of light and
lengths is then below 0.5 %, measured for all integrators in a diffuse sphere and the Cornell
box."""

SENSOR = "a sensor of the scene, as scene.sensors()[0]"


def check_scene(scene: mi.Scene, sensor: mi.Sensor | None = None, **supported: bool) -> None:
    """Raise a ValueError if the picture of a scene would be wrong or black without an error.

    Args:
        scene: The scene.
        sensor: The sensor to render, or None for all sensors of the scene.
        **supported: Features that the integrator supports, the options of `require_modeled`.

    Raises:
        ValueError: If the scene is not supported, or a parameter is wrong.
    """
    require_modeled(scene, sensor, **supported)
    require_usable(scene)
    require_sound(scene, sensor)
    require_extent(scene)
    if supported.get("media"):
        require_sound_media(scene, sensor)


def check_view(scene: mi.Scene, sensor: mi.Sensor, **supported: bool) -> None:
    """Check a scene by `check_scene`. Raise an error for a `sensor` that is not an `mi.Sensor`."""
    check_scene(scene, sensor, **supported)
    checks.instance("sensor", sensor, mi.Sensor, SENSOR)


def require_modeled(
    scene: mi.Scene,
    sensor: mi.Sensor | None = None,
    *,
    media: bool = False,
    polarization: bool = False,
    beams: bool = True,
) -> None:
    """Raise a ValueError for a scene of another variant, and for features without support.

    Args:
        scene: The scene.
        sensor: The sensor to render, or None for all sensors of the scene.
        media: Whether the integrator supports participating media.
        polarization: Whether the integrator supports polarized variants.
        beams: Whether the integrator supports emitters that shine in one direction only, which
            paths from the camera cannot hit.

    Raises:
        ValueError: If the scene is not supported, or a parameter is wrong.
    """
    # The variant
    active = mi.variant() or "none"
    allowed = f"a loaded scene of the active variant {active}"
    checks.require("scene", scene, hasattr(scene, "variant_name"), allowed)
    if scene.variant_name() != active:
        raise ValueError(
            f"scene: belongs to the variant {scene.variant_name()}, but the active variant is "
            f"{active}. Load the scene again"
        )
    if mi.is_polarized and not polarization:
        raise ValueError(
            f"variant = {active!r}: the integrator does not support polarization. "
            f"Use {active.replace('_polarized', '')}"
        )

    # Sensor and emitters
    if sensor is not None:
        checks.instance("sensor", sensor, mi.Sensor, SENSOR)
    for emitter in scene.emitters():
        if emitter.class_name() == BEAM and not beams:
            name = emitter.get_shape().id() or "directionalarea"
            raise ValueError(
                f"emitter of {name!r}: paths from the camera cannot find the light of a "
                "directionalarea emitter. Use transient_light_tracer or transient_bdpt"
            )

    # Participating media
    if media:
        return
    cameras = scene.sensors() if sensor is None else [sensor]
    shapes = [node for node in mi.traverse(scene).hierarchy if isinstance(node, mi.Shape)]
    found = [(s, f"{side}_medium") for s in shapes for side in ("interior", "exterior")]
    found += [(endpoint, "get_medium") for endpoint in [*scene.emitters(), *cameras]]
    for owner, name in found:
        medium = getattr(owner, name)()
        if medium is not None:
            parameter = f"{owner.id() or owner.class_name()}.{name.removeprefix('get_')}"
            raise ValueError(
                f"{parameter} = {medium.class_name()}: the integrator does not support "
                "participating media. Use transient_volpath, or remove the medium"
            )


def require_usable(scene: mi.Scene) -> None:
    """Raise a ValueError if Mitsuba cannot evaluate a plugin in the active variant."""
    spectral = mi.is_spectral
    for node in mi.traverse(scene).hierarchy:
        kind = node.class_name()
        if kind in WAVELENGTHS and not spectral:
            raise ValueError(
                f"spectrum {node.id()!r}: Mitsuba evaluates the plugin {WAVELENGTHS[kind]} in "
                f"spectral variants only. Use llvm_ad_spectral instead of {mi.variant()}, or rgb"
            )
        if kind == TIMED_SKY:
            raise ValueError(
                f"emitter {node.id()!r}: Mitsuba cannot evaluate timed_sunsky in the variant "
                f"{mi.variant()}. Use sunsky"
            )


def require_sound(scene: mi.Scene, sensor: mi.Sensor | None = None) -> None:
    """Raise a ValueError for infinite parameters, negative light, and transforms without inverse.

    Args:
        scene: The scene.
        sensor: A sensor to check too, which may be outside of the scene.

    Raises:
        ValueError: If a number is invalid. The message has the parameter's name and value.

    The check runs for one or two milliseconds, and twice as long with a million vertices.
    """
    # Collect the numbers of all parameters
    sources = [readable(mi.traverse(scene))]
    if sensor is not None and sensor not in sources[0].hierarchy:
        sources.append(readable(mi.traverse(sensor)))
    values = {name: value for source in sources for name, value in source}
    numbers = {name: list(floats_of(value)) for name, value in values.items()}
    dr.eval(numbers)

    # Are all numbers finite, and can transforms be inverted?
    for name, leaves in numbers.items():
        value = values[name]
        if not all(map(_is_finite, leaves)):
            # Coefficients of the spectra of black and white are infinite
            coefficients = is_spectral_coefficients(value)
            good: Any = (lambda x: ~np.isnan(x)) if coefficients else np.isfinite
            require_all(_qualified(name, scene), value, good, "finite numbers")
        if is_transform(value) and len(leaves) == 16:
            require_inverse(_qualified(name, scene), value)

    # Check emitters and meshes
    for emitter in scene.emitters():
        _require_positive(emitter)
        _warn_of_narrow_spot(emitter)
    for shape in scene.shapes():
        box: Any = shape.bbox()
        if shape.is_mesh() and np.all(np.ravel(box.max) == np.ravel(box.min)):
            raise ValueError(
                f"{shape.id() or shape.class_name()}.vertex_positions: all vertices are at one "
                "point. Pass vertices of a surface"
            )


def _is_finite(leaf: Any) -> bool:
    """Return whether all numbers of an array are finite."""
    array = np.asarray(leaf)  # `min` and `max` are NaN if a number is NaN
    return array.size == 0 or bool(np.isfinite([array.min(), array.max()]).all())


def _qualified(name: str, scene: mi.Scene) -> str:
    """Return the name of a parameter for messages.

    An object without an id is named by its class and a number, e.g. "Rectangle 2.to_world".
    """
    address = re.match(r"object_(\d+)(?=\.)", name)
    if address is None:
        return name
    counts: Counter[str] = Counter()
    for each in [*scene.shapes(), *scene.emitters(), *scene.sensors()]:
        counts[each.class_name()] += 1
        if each.ptr == int(address[1]):
            return f"{each.class_name()} {counts[each.class_name()]}{name[address.end() :]}"
    return name


def _warn_of_narrow_spot(emitter: mi.Emitter) -> None:
    """Warn if a spot light is so narrow that Mitsuba's cosines do not resolve its angles."""
    if emitter.class_name() != "SpotLight":
        return
    parameter: Any = mi.traverse(emitter)["cutoff_angle"]
    angle = float(np.ravel(parameter)[0])
    if angle < NARROWEST_SPOT:
        name = f"{emitter.id() or 'spot'}.cutoff_angle"
        text = (
            f"{name} = {angle:.3g} degrees: Mitsuba does not resolve such angles, and the power of "
            f"the spot is wrong. Use {NARROWEST_SPOT} degrees or more"
        )
        warnings.warn(text, stacklevel=5)


def _require_positive(emitter: mi.Emitter) -> None:
    """Raise a ValueError if an emitter has negative light."""
    shape = emitter.get_shape()
    owner = (emitter if shape is None else shape).id() or emitter.class_name()
    for name, value in mi.traverse(emitter):
        if LIGHT.fullmatch(name) and not (is_transform(value) or is_spectral_coefficients(value)):
            allowed = "0 or more, light cannot be negative"
            require_all(f"{owner}.{name}", value, lambda x: x >= 0, allowed)


def require_extent(scene: mi.Scene) -> None:
    """Raise a ValueError if a scene is too small, or too far from the origin, for ray offsets.

    Mitsuba starts rays at a distance of 9e-5 (1 m + largest coordinate) from surfaces. In small
    scenes this offset is visible.
    """
    box: Any = scene.bbox()
    low = np.ravel(box.min).astype(float)
    high = np.ravel(box.max).astype(float)
    if not (np.isfinite([low, high]).all() and (low <= high).all()):
        return
    extent = float(np.linalg.norm(high - low))
    farthest = float(np.abs([low, high]).max())
    least = EXTENT * (1 + farthest)
    if extent < least:
        raise ValueError(
            f"scene: its diagonal is {extent:.3g} m and its largest coordinate {farthest:.3g} m, "
            f"where Mitsuba starts rays {GAP * (1 + farthest):.2g} m off surfaces. Scale the scene "
            f"up to at least {least:.3g} m, or move it to the origin"
        )


def require_inverse(name: str, transform: Any, *, flat: bool = False) -> None:
    """Raise a ValueError if a transform has a wrong or missing inverse.

    Mitsuba computes a wrong inverse for a rotation about an axis with a length other than 1.

    Args:
        name: Name of the parameter.
        transform: The transform.
        flat: Whether the transform may be singular. This is allowed for meshes, because Mitsuba
            applies their transform to the vertices and does not keep it.

    Raises:
        ValueError: If the inverse is wrong or missing.
    """
    both = (transform, transform.inverse())
    matrix, inverse = (np.array(each.matrix, dtype=float).reshape(4, 4)[:3, :3] for each in both)
    shown = np.round(np.array(transform.matrix, dtype=float).reshape(4, 4), 6).tolist()
    edges = np.linalg.norm(matrix, axis=0)
    if not flat and not abs(np.linalg.det(matrix)) > SINGULAR * math.prod(edges):
        raise ValueError(f"{name} = {shown}: the transform is singular. Use scales other than 0")

    # Is the product with the inverse the identity? Infinite numbers are refused by `require_sound`
    if not np.isfinite([matrix, inverse]).all():
        return
    off = np.abs(matrix @ inverse - np.eye(3)).max()
    if off > INVERSE * (np.abs(matrix) @ np.abs(inverse)).max():
        raise ValueError(
            f"{name} = {shown}: Mitsuba's inverse of this transform is wrong. Use axes of length 1 "
            "for rotations"
        )
