"""Refuse loaded scenes that cannot be rendered right: unsupported features, unsound numbers."""

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
"""Parameters of emitters that their radiance is proportional to."""

SINGULAR = 1e-12
"""Largest determinant, over the product of the edges' lengths, of a transform without inverse."""

INVERSE = 1e-4  # Largest error of a transform's product with its inverse, over the magnitudes in it

GAP = 1500 * 2.0**-24
"""Offset of rays from surfaces, over 1 m and the largest coordinate (Mitsuba's RayEpsilon)."""

BEAM = "DirectionalArea"
"""Emitter whose light leaves a surface along the normal alone."""

TIMED_SKY = "TimedSunskyEmitter"
"""Emitter whose light Mitsuba 3.9 cannot evaluate outside of scalar variants."""

WAVELENGTHS = {
    "RegularSpectrum": "regular",
    "IrregularSpectrum": "irregular",
    "BlackBodySpectrum": "blackbody",
}
"""Spectra by wavelength, which only spectral variants evaluate, and their plugins."""

NARROWEST_SPOT = 0.05
"""Cutoff angle of a spot from which on its power is right to 1 % [degrees]; 37 % is lost at .02."""

EXTENT = 0.03
"""Least diagonal of a scene, over 1 m and the largest coordinate: light and lengths are then right
to .5 %, measured in a diffuse sphere and the Cornell box by all integrators."""

SENSOR = "a sensor of the scene, as scene.sensors()[0]"


def check_scene(scene: mi.Scene, sensor: mi.Sensor | None = None, **supported: bool) -> None:
    """Refuse a scene whose picture would be silently wrong or black.

    None stands for all of the scene's sensors. `supported` is what `require_modelled` has.
    """
    require_modelled(scene, sensor, **supported)
    require_usable(scene)
    require_sound(scene, sensor)
    require_extent(scene)
    if supported.get("media"):
        require_sound_media(scene, sensor)


def check_view(scene: mi.Scene, sensor: mi.Sensor, **supported: bool) -> None:
    """`check_scene` for a sensor that must be one; with its options."""
    check_scene(scene, sensor, **supported)
    checks.instance("sensor", sensor, mi.Sensor, SENSOR)


def require_modelled(
    scene: mi.Scene,
    sensor: mi.Sensor | None = None,
    *,
    media: bool = False,
    polarisation: bool = False,
    beams: bool = True,
) -> None:
    """Refuse another variant, and what the integrator does not support.

    That may be polarization, media, or beams: light of one direction from a surface, which paths
    from the camera cannot find.
    """
    active = mi.variant() or "none"
    allowed = f"a loaded scene of the active variant {active}"
    checks.require("scene", scene, hasattr(scene, "variant_name"), allowed)
    if scene.variant_name() != active:
        raise ValueError(
            f"scene: belongs to the variant {scene.variant_name()}; must be one of the active "
            f"variant {active}, load it again"
        )
    plain = active.replace("_polarized", "")
    allowed = f"one without polarisation, which is not followed, like {plain}"
    checks.require("variant", active, polarisation or not mi.is_polarized, allowed)
    if sensor is not None:
        checks.instance("sensor", sensor, mi.Sensor, SENSOR)
    for emitter in scene.emitters():
        if emitter.class_name() == BEAM and not beams:
            name = emitter.get_shape().id() or "directionalarea"
            raise ValueError(
                f"emitter of {name!r}: paths from the camera cannot find the light of a "
                "directionalarea emitter. Use transient_light_tracer or transient_bdpt"
            )
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
                f"{parameter} = {medium.class_name()}: must be left out; participating media are "
                "not followed"
            )


def require_usable(scene: mi.Scene) -> None:
    """Refuse plugins that Mitsuba cannot evaluate in the active variant."""
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
    """Refuse parameters that are not finite, negative light, and transforms without an inverse.

    Looks at each number once: a millisecond or two, and as long again for a million vertices. The
    sensor need not be the scene's.
    """
    sources = [readable(mi.traverse(scene))]
    if sensor is not None and sensor not in sources[0].hierarchy:
        sources.append(readable(mi.traverse(sensor)))
    values = {name: value for source in sources for name, value in source}
    numbers = {name: list(floats_of(value)) for name, value in values.items()}
    dr.eval(numbers)
    for name, leaves in numbers.items():
        value = values[name]
        if not all(map(_is_finite, leaves)):
            # Coefficients of the spectra of black and white are infinite
            coefficients = is_spectral_coefficients(value)
            good: Any = (lambda x: ~np.isnan(x)) if coefficients else np.isfinite
            require_all(_qualified(name, scene), value, good, "finite numbers")
        if is_transform(value) and len(leaves) == 16:
            require_inverse(_qualified(name, scene), value)
    for emitter in scene.emitters():
        _require_positive(emitter)
        _warn_of_narrow_spot(emitter)
    for shape in scene.shapes():
        box: Any = shape.bbox()
        if shape.is_mesh() and np.all(np.ravel(box.max) == np.ravel(box.min)):
            raise ValueError(
                f"{shape.id() or shape.class_name()}.vertex_positions: are all in one point; "
                "must span a surface"
            )


def _is_finite(leaf: Any) -> bool:
    array = np.asarray(leaf)  # NaN is passed on by both
    return array.size == 0 or bool(np.isfinite([array.min(), array.max()]).all())


def _qualified(name: str, scene: mi.Scene) -> str:
    """Name of a parameter; objects without an id are named by their class and a number."""
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
    """Warn of a spot light if Mitsuba does not resolve its angles, as cosines are near 1."""
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
    shape = emitter.get_shape()
    owner = (emitter if shape is None else shape).id() or emitter.class_name()
    for name, value in mi.traverse(emitter):
        if LIGHT.fullmatch(name) and not (is_transform(value) or is_spectral_coefficients(value)):
            allowed = "0 or more, light cannot be negative"
            require_all(f"{owner}.{name}", value, lambda x: x >= 0, allowed)


def require_extent(scene: mi.Scene) -> None:
    """Refuse a scene that is so small, or so far from the origin, that gaps beside rays show.

    Mitsuba starts rays off surfaces by 9e-5 (1 m + the largest coordinate), however small all is.
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


def require_inverse(name: str, transform: Any, *, flat: bool = False) -> None:
    """Refuse a transform with a wrong inverse (a rotation about a long axis), or none unless flat.

    Transforms of meshes may be flat: they are applied to the vertices and forgotten.
    """
    both = (transform, transform.inverse())
    matrix, inverse = (np.array(each.matrix, dtype=float).reshape(4, 4)[:3, :3] for each in both)
    shown = np.round(np.array(transform.matrix, dtype=float).reshape(4, 4), 6).tolist()
    edges = np.linalg.norm(matrix, axis=0)
    if not flat and not abs(np.linalg.det(matrix)) > SINGULAR * math.prod(edges):
        raise ValueError(f"{name} = {shown}: must be a transform with an inverse, no scale of 0")
    if not np.isfinite([matrix, inverse]).all():
        return  # Refused elsewhere
    off = np.abs(matrix @ inverse - np.eye(3)).max()
    if off > INVERSE * (np.abs(matrix) @ np.abs(inverse)).max():
        raise ValueError(
            f"{name} = {shown}: must be a transform whose inverse is right; rotations need an axis "
            "of length 1"
        )
