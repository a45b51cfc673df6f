"""Checks that a render has derivatives, before any work starts."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import chain
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..films.recording import BinRecording, MitransientRecording, PhasorRecording, Recording
from ..paths.refraction import index_around
from ..paths.scattering import BLEND, MASK
from ..paths.surfaces import Boundaries, bsdfs_in, flat_twin, materials
from ..runtime import checks
from ..runtime.interface import POSITIONS, name_of
from ..scenes.media import media_of
from ..signals.pulses import GaussianPulse, Pulse

MOVING = (
    "to_world",
    *POSITIONS,
    "position",
    "direction",
    "control_points",
    "centers",
    "x_fov",
    "principal_point_offset_x",
    "principal_point_offset_y",
    "aperture_radius",
    "focus_distance",
    "near_clip",
    "far_clip",
    "cutoff_angle",
    "beam_width",
    "eta",
    "int_ior",
    "ext_ior",
)
"""Last parts of the names of parameters that change the geometry of paths."""

# Packages that are skipped when the caller of a render is searched
RENDERERS = ("tofrender", "mitsuba", "drjit")

# Largest difference of a profile and the integral of its derivative, relative to the peak
TOLERANCE = 0.05


class VisibilityWarning(UserWarning):
    """Warning that derivatives do not include changes of visibility."""


def tracked(params: Mapping[str, Any] | None) -> list[str]:
    """Select the names of parameters that track gradients."""
    with dr.resume_grad():
        return [name for name, value in dict(params or {}).items() if dr.grad_enabled(value)]


def moving(names: Sequence[str]) -> list[str]:
    """Select the names of parameters that change the geometry of paths.

    Example:
        >>> moving(["floor.to_world", "floor.bsdf.reflectance.value", "sensor.x_fov"])
        ['floor.to_world', 'sensor.x_fov']
    """
    return [name for name in names if name.rpartition(".")[2] in MOVING]


def require_changes(params: Mapping[str, Any] | None) -> None:
    """Raise a `ValueError` if no parameter tracks gradients."""
    if not tracked(params):
        raise ValueError(
            "params: no parameter tracks gradients. Pass the parameters of mi.traverse(scene), and "
            "call dr.enable_grad(params[name]) for at least one of them"
        )


def warn_of_edges(names: Sequence[str]) -> None:
    """Warn that derivatives by parameters that move objects are not complete."""
    if moving(names):
        warnings.warn(
            f"params = {_shown(moving(names))}: these parameters move objects. Derivatives leave "
            "out what becomes visible or hidden at silhouettes and shadows",
            VisibilityWarning,
            _users_level(),
        )


def _shown(names: Sequence[str]) -> str:
    """Return a list of names for a message."""
    return checks.quote(", ".join(names))


def _users_level() -> int:
    """Return the stack level of the first caller outside of `RENDERERS`."""
    frame = sys._getframe(1)
    level = 1
    while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] in RENDERERS:
        frame = frame.f_back
        level += 1
    return level


def require_derivatives(
    scene: mi.Scene,
    sensor: mi.Sensor,
    record: Recording,
    names: Sequence[str],
    straight: bool,
    attached: bool,
) -> None:
    """Raise a `ValueError` if a render does not have derivatives by some parameters.

    Args:
        scene: The scene.
        sensor: The sensor.
        record: Recording on the film.
        names: Names of the parameters that track gradients.
        straight: Whether connections pass surfaces with null transmission.
        attached: Whether sampling is attached. Sampled directions, and therefore path lengths,
            then change with the parameters.
    """
    by_width = any(name.endswith("pulse_width_opl") for name in names)
    changes_lengths = attached or bool(moving(names))
    reasons = chain(
        _film_reasons(record),
        _pulse_reasons(record, by_width, changes_lengths),
        _material_reasons(scene, straight),
        _motion_reasons(scene, sensor, moving(names), straight) if moving(names) else (),
    )
    if reason := next(reasons, None):
        raise ValueError(f"{reason} (required because {_shown(names)} tracks gradients)")


def _material_reasons(scene: mi.Scene, straight: bool) -> Iterator[str]:
    """Yield error messages for materials without derivatives, see `paths.scattering`.

    Args:
        scene: The scene.
        straight: Whether connections pass surfaces with null transmission.
    """
    # Does a BSDF choose between delta lobes in more than one way?
    for bsdf in materials(scene):
        if wrong := undifferentiated(bsdf):
            yield (
                f"bsdf = {wrong}: derivatives are not supported. Use a material without delta "
                "lobes, or with one BSDF that chooses between them"
            )

    # Does the null transmission change, when connections use it?
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(0, 0, 1)
    for bsdf in materials(scene) if straight else ():
        with dr.resume_grad():
            changes = dr.grad_enabled(bsdf.eval_null_transmission(si))
        if changes:
            yield (
                f"bsdf = {bsdf.class_name()}: transient_volpath does not support derivatives of "
                "null transmission. Use transient_path"
            )


# BSDFs that return a probability with derivatives. A mask over such a BSDF would combine this
# derivative with the derivative of the probability of the mask
CHOOSERS = ("ThinDielectric", "SmoothPlastic", BLEND)


def undifferentiated(bsdf: mi.BSDF) -> str:
    """Return a description of the part of a BSDF without derivatives, otherwise "".

    Example:
        >>> pane = {"type": "thindielectric"}
        >>> undifferentiated(mi.load_dict({"type": "mask", "opacity": 0.5, "pane": pane}))
        'mask over a thindielectric, a plastic or a blendbsdf'
        >>> undifferentiated(mi.load_dict(pane))
        ''
    """
    # Is a mask over a BSDF that chooses between lobes?
    single = [part for part in bsdfs_in(bsdf) if mi.has_flag(part.flags(), mi.BSDFFlags.Delta)]
    kinds = [part.class_name() for part in single]
    if MASK in kinds and any(kind in CHOOSERS for kind in kinds):
        return "mask over a thindielectric, a plastic or a blendbsdf"

    # Does a blend combine delta lobes and smooth lobes?
    smooth = [mi.has_flag(part.flags(), mi.BSDFFlags.Smooth) for part in single]
    if any(kind == BLEND and mixed for kind, mixed in zip(kinds, smooth, strict=True)):
        return "blendbsdf of delta lobes and smooth lobes"
    return ""


def _motion_reasons(
    scene: mi.Scene, sensor: mi.Sensor, names: Sequence[str], straight: bool
) -> Iterator[str]:
    """Yield error messages for moving objects, if their derivatives are not supported.

    Args:
        scene: The scene.
        sensor: The sensor.
        names: Names of the parameters that change the geometry of paths.
        straight: Whether connections pass surfaces with null transmission.
    """
    params = f"params = {_shown(names)}"
    unsupported = f"{params}: derivatives by moving objects are not supported"

    # Media and surfaces with null transmission
    if straight:
        yield (
            f"{params}: transient_volpath does not support derivatives by moving objects in scenes "
            "with null transmission. Use transient_path, or differentiate by coefficients, "
            "materials or power"
        )
    media = media_of(scene, sensor)
    if media and (Boundaries(scene).exist or not all(m.is_homogeneous() for m in media)):
        yield (
            f"{unsupported} in scenes with grids or with index-matched boundaries of media. "
            "Differentiate by coefficients, materials or power"
        )

    # Emitters with smooth normals
    for shape in scene.shapes():
        corners = name_of(dict.fromkeys(names), POSITIONS, f"{shape.id()}.")
        if shape.is_emitter() and corners is not None and flat_twin(shape) is not None:
            yield (
                f"{corners}: derivatives are not supported for emitters with smooth normals. Set "
                "face_normals of the mesh to true"
            )

    # Emitters that are infinitely far away
    for emitter in scene.emitters():
        if mi.has_flag(emitter.flags(), mi.EmitterFlags.Infinite):
            yield (
                f"{unsupported} with {emitter.class_name()}, because its light starts at a sphere "
                "around the moving scene. Use near emitters, or differentiate by materials or power"
            )

    # Changes of the index of refraction around the sensor
    if any(name.endswith(".eta") for name in names) and index_around(scene, sensor) != 1:
        yield (
            "sensor: derivatives by eta are not supported for a sensor in glass or water. Place "
            "the sensor in air"
        )


def _film_reasons(record: Recording) -> Iterator[str]:
    """Yield error messages for films without derivatives."""
    film = record.film
    if not film.rfilter().is_box_filter():
        rfilter = film.rfilter().class_name()
        yield f"film.rfilter = {rfilter}: derivatives are not supported. Use a box filter"
    if "xyz" in str(film):
        yield "film.pixel_format = xyz: derivatives are not supported. Use rgb or luminance"
    if isinstance(record, MitransientRecording):
        kind = f"{type(film).__module__}.{type(film).__name__}"
        yield f"film = {kind}: derivatives are not supported. Use transient_hdr_film of tofrender"


def _pulse_reasons(record: Recording, by_width: bool, changes_lengths: bool) -> Iterator[str]:
    """Yield error messages for pulses without derivatives by path length or by width.

    Args:
        record: Recording on the film.
        by_width: Whether the width of the pulse tracks gradients.
        changes_lengths: Whether the parameters change path lengths. Otherwise a pulse is not
            required.
    """
    if isinstance(record, PhasorRecording) and by_width:
        yield (
            "pulse_width_opl: derivatives are not supported on a phasor_hdr_film. Use a film with "
            "time bins"
        )

    # Time gates need a continuous density of the pulse
    exposure = record.exposure
    gate = getattr(record.exposure.weight, "pulse", exposure.pulse if exposure.at_centers else None)
    if gate is not None and hasattr(gate, "support") and not _is_smooth(gate, gate.eval):
        yield (
            f"pulse = {checks.quote(gate)}: the pulse has hard edges, so gates do not have "
            "derivatives by path length. Use a pulse whose eval is the integral of its derivative, "
            "for example a GaussianPulse"
        )

    # Time bins need a continuous cumulative distribution
    if not isinstance(record, BinRecording):
        return
    pulse = record.profile
    if pulse is None:
        if changes_lengths or exposure.at_centers:
            yield (
                "pulse = None: derivatives by path length require a pulse on films with time bins. "
                "Set pulse_width_opl, for example to 0.03"
            )
    elif not exposure.at_centers and not _is_smooth(pulse, pulse.cdf):
        yield (
            f"pulse = {checks.quote(pulse)}: the cdf does not have derivatives. Use operations of "
            "Dr.Jit, and a cdf that is the integral of its derivative"
        )
    if by_width and pulse is not exposure.pulse:
        yield (
            "pulse_width_opl: derivatives are not supported with a temporal_filter. Set "
            "temporal_filter to 'box'"
        )


def _is_smooth(pulse: Pulse, profile: Callable[[mi.Float], mi.Float], count: int = 1 << 12) -> bool:
    """Return whether a profile is the integral of its derivative in Dr.Jit.

    The result is False if the profile has jumps, or is not computed by operations of Dr.Jit.

    Args:
        pulse: The pulse.
        profile: Function of the path length [m], for example the density of the pulse.
        count: Number of points.
    """
    if type(pulse) is GaussianPulse:
        return True

    # Compute values and derivatives at equidistant points
    low, high = pulse.support
    step = (high - low) / count
    with dr.resume_grad():
        t = mi.Float(low + step * (np.arange(count) + 0.5))
        dr.enable_grad(t)
        values = profile(t)
        if not dr.grad_enabled(values):
            return False
        dr.forward_from(t)
        slope = np.array(dr.grad(values), dtype=float)
        height = np.array(values, dtype=float)

    # Compare with the integral of the derivative
    off = np.abs(np.cumsum(slope) * step - height).max()
    return bool(off < TOLERANCE * np.abs(height).max())
