"""Refusals of renders that have no derivatives, before any work."""

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
    *("to_world", *POSITIONS, "position", "direction", "control_points", "centers"),
    *("x_fov", "principal_point_offset_x", "principal_point_offset_y", "aperture_radius"),
    *("focus_distance", "near_clip", "far_clip", "cutoff_angle", "beam_width"),
    *("eta", "int_ior", "ext_ior"),
)
"""Ends of the names of parameters that light's way depends on."""

RENDERERS = ("tofrender", "mitsuba", "drjit")
TOLERANCE = 0.05  # Of a profile as the integral of its derivative, relative to its peak


class VisibilityWarning(UserWarning):
    """Derivatives leave out what becomes visible or hidden."""


def tracked(params: Mapping[str, Any] | None) -> list[str]:
    """Select the names of parameters that track gradients."""
    with dr.resume_grad():
        return [name for name, value in dict(params or {}).items() if dr.grad_enabled(value)]


def moving(names: Sequence[str]) -> list[str]:
    """Select the names of parameters that move what light meets.

    Example:
        >>> moving(["floor.to_world", "floor.bsdf.reflectance.value", "sensor.x_fov"])
        ['floor.to_world', 'sensor.x_fov']
    """
    return [name for name in names if name.rpartition(".")[2] in MOVING]


def require_changes(params: Mapping[str, Any] | None) -> None:
    """Raise a `ValueError` if no parameter tracks gradients."""
    if not tracked(params):
        raise ValueError(
            "params: track no gradients; must be those of mi.traverse(scene), with "
            "dr.enable_grad(params[name]) for one at least"
        )


def warn_of_edges(names: Sequence[str]) -> None:
    """Warn that derivatives by parameters that move things are not whole."""
    if moving(names):
        warnings.warn(
            f"params = {_shown(moving(names))}: move what light meets; derivatives leave out what "
            "becomes visible or hidden at silhouettes and shadows",
            VisibilityWarning,
            _users_level(),
        )


def _shown(names: Sequence[str]) -> str:
    return checks.quote(", ".join(names))


def _users_level() -> int:
    """Return the stack level of the first caller outside of renderers."""
    frame, level = sys._getframe(1), 1
    while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] in RENDERERS:
        frame, level = frame.f_back, level + 1
    return level


def require_derivatives(
    scene: mi.Scene,
    sensor: mi.Sensor,
    record: Recording,
    names: Sequence[str],
    straight: bool,
    attached: bool,
) -> None:
    """Raise a `ValueError` for a render without derivatives by the parameters of some names.

    `straight` says that connections go through surfaces that let light straight through. `attached`
    says that sampled directions, and so path lengths, change with the parameters.
    """
    changes_lengths = attached or bool(moving(names))
    reasons = chain(
        _film_reasons(record),
        _pulse_reasons(
            record, any(name.endswith("pulse_width_opl") for name in names), changes_lengths
        ),
        _material_reasons(scene, straight),
        _motion_reasons(scene, sensor, moving(names), straight) if moving(names) else (),
    )
    if reason := next(reasons, None):
        raise ValueError(f"{reason} (as {_shown(names)} tracks gradients)")


def _material_reasons(scene: mi.Scene, straight: bool) -> Iterator[str]:
    """Yield refusals of materials: see `paths.scattering`, and of changing transmission."""
    for bsdf in materials(scene):
        if wrong := undifferentiated(bsdf):
            yield (
                f"bsdf = {wrong}: has no derivatives; must be a material with one way of choosing "
                "single directions, or without them"
            )
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(0, 0, 1)
    for bsdf in materials(scene) if straight else ():
        with dr.resume_grad():
            changes = dr.grad_enabled(bsdf.eval_null_transmission(si))
        if changes:
            yield (
                f"bsdf = {bsdf.class_name()}: has no derivatives by transient_volpath of what it "
                "lets straight through; must be rendered by transient_path"
            )


# BSDFs that return p with its derivative, which a mask over them mixes with its own
CHOOSERS = ("ThinDielectric", "SmoothPlastic", BLEND)


def undifferentiated(bsdf: mi.BSDF) -> str:
    """Name the part of a BSDF that has no derivatives, "" if there is none.

    Example:
        >>> pane = {"type": "thindielectric"}
        >>> undifferentiated(mi.load_dict({"type": "mask", "opacity": 0.5, "pane": pane}))
        'mask over a thindielectric, a plastic or a blendbsdf'
        >>> undifferentiated(mi.load_dict(pane))
        ''
    """
    single = [part for part in bsdfs_in(bsdf) if mi.has_flag(part.flags(), mi.BSDFFlags.Delta)]
    kinds = [part.class_name() for part in single]
    if MASK in kinds and any(kind in CHOOSERS for kind in kinds):
        return "mask over a thindielectric, a plastic or a blendbsdf"
    smooth = [mi.has_flag(part.flags(), mi.BSDFFlags.Smooth) for part in single]
    if any(kind == BLEND and more for kind, more in zip(kinds, smooth, strict=True)):
        return "blendbsdf of single directions and others"
    return ""


def _motion_reasons(
    scene: mi.Scene, sensor: mi.Sensor, names: Sequence[str], straight: bool
) -> Iterator[str]:
    """Yield refusals of what moves where its derivatives are not whole."""
    params = f"params = {_shown(names)}: have no derivatives"
    if straight:
        yield (
            f"{params} by transient_volpath where surfaces let light straight through; must be "
            "coefficients, materials or power, or by transient_path"
        )
    media = media_of(scene, sensor)
    if media and (Boundaries(scene).exist or not all(m.is_homogeneous() for m in media)):
        yield (
            f"{params} in a scene with media that are grids or have boundaries of equal index; "
            "must be coefficients, materials or power"
        )
    for shape in scene.shapes():
        corners = name_of(dict.fromkeys(names), POSITIONS, f"{shape.id()}.")
        if shape.is_emitter() and corners is not None and flat_twin(shape) is not None:
            yield (
                f"{corners}: has no derivative, the lamp's normals are smooth; must be a mesh with "
                "face_normals"
            )
    for emitter in scene.emitters():
        if mi.has_flag(emitter.flags(), mi.EmitterFlags.Infinite):
            yield (
                f"{params} under {emitter.class_name()}, whose light starts at a sphere around all "
                "that moves; must be materials or power, or light must be near"
            )
    if any(name.endswith(".eta") for name in names) and index_around(scene, sensor) != 1:
        yield "sensor: is in glass or water, whose index changes; must be in air"


def _film_reasons(record: Recording) -> Iterator[str]:
    film = record.film
    if not film.rfilter().is_box_filter():
        yield f"film.rfilter = {film.rfilter().class_name()}: has no derivatives; must be box"
    if "xyz" in str(film):
        yield "film.pixel_format = xyz: has no derivatives; must be rgb or luminance"
    if isinstance(record, MitransientRecording):
        kind = f"{type(film).__module__}.{type(film).__name__}"
        yield f"film = {kind}: has no derivatives; must be this package's"


def _pulse_reasons(record: Recording, by_width: bool, changes_lengths: bool) -> Iterator[str]:
    """Yield refusals of pulses without derivative, by length or by their width.

    Parameters that do not change path lengths need no pulse.
    """
    if isinstance(record, PhasorRecording) and by_width:
        yield "pulse_width_opl: has no derivative on a phasor_hdr_film; must be on a film with bins"
    exposure = record.exposure
    gate = getattr(record.weight, "pulse", exposure.pulse if exposure.at_centers else None)
    if gate is not None and hasattr(gate, "support") and not _is_smooth(gate, gate.eval):
        yield (
            f"pulse = {checks.quote(gate)}: has hard edges, so that gates have no derivative by "
            "length; must be one whose eval is the integral of its derivative, as of GaussianPulse"
        )
    if not isinstance(record, BinRecording):
        return
    pulse = record.profile
    if pulse is None:
        if changes_lengths or exposure.at_centers:
            yield (
                "pulse = None: leaves bins without a derivative by length; must be a pulse, e.g. "
                "by pulse_width_opl = 0.03"
            )
    elif not exposure.at_centers and not _is_smooth(pulse, pulse.cdf):
        yield (
            f"pulse = {checks.quote(pulse)}: has a cdf without derivative; must be one that is the "
            "integral of its derivative, in operations of Dr.Jit"
        )
    if by_width and pulse is not exposure.pulse:
        yield "pulse_width_opl: has no derivative through a temporal_filter; must be 'box'"


def _is_smooth(pulse: Pulse, profile: Callable[[mi.Float], mi.Float], count: int = 1 << 12) -> bool:
    """Whether a profile is the integral of its derivative by Dr.Jit: has no jumps, stays in it."""
    if type(pulse) is GaussianPulse:
        return True
    low, high = pulse.support
    step = (high - low) / count
    with dr.resume_grad():
        t = mi.Float(low + step * (np.arange(count) + 0.5))
        dr.enable_grad(t)
        values = profile(t)
        if not dr.grad_enabled(values):
            return False
        dr.forward_from(t)
        slope, height = (np.array(each, dtype=float) for each in (dr.grad(values), values))
    off = np.abs(np.cumsum(slope) * step - height).max()
    return bool(off < TOLERANCE * np.abs(height).max())
