"""Refusals of renders that have no derivatives, in one line each, before any work."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..films.recording import BinRecording, PhasorRecording, Recording
from ..paths.refraction import index_around
from ..paths.scattering import undifferentiated
from ..paths.surfaces import Boundaries, flat_twin, materials
from ..runtime import checks
from ..scenes.media import media_of
from ..signals.pulses import GaussianPulse

MOVING = (
    *("to_world", "vertex_positions", "position", "direction", "control_points", "centers"),
    *("x_fov", "principal_point_offset_x", "principal_point_offset_y", "aperture_radius"),
    *("focus_distance", "near_clip", "far_clip", "cutoff_angle", "beam_width"),
    *("eta", "int_ior", "ext_ior"),
)
"""Ends of the names of parameters that light's way depends on."""

RENDERERS = ("tofrender", "mitsuba", "drjit")

ROUGHLY = 0.05
"""How far a profile may be from the integral of its derivative, as a part of its peak."""


class VisibilityWarning(UserWarning):
    """Derivatives leave out what becomes visible or hidden."""


def tracked(params: Any) -> list[str]:
    """Names of parameters that track gradients."""
    with dr.resume_grad():
        return [name for name, value in dict(params or {}).items() if dr.grad_enabled(value)]


def moving(names: Sequence[str]) -> list[str]:
    """Select the names of parameters that move what light meets.

    Example:
        >>> moving(["floor.to_world", "floor.bsdf.reflectance.value", "sensor.x_fov"])
        ['floor.to_world', 'sensor.x_fov']
    """
    return [name for name in names if name.rpartition(".")[2] in MOVING]


def require_changes(params: Any) -> None:
    """Refuse parameters of which none has a derivative.

    Raises:
        ValueError: None tracks gradients; one line.
    """
    if not tracked(params):
        raise ValueError(
            "params: track no gradients; must be those of mi.traverse(scene), with "
            "dr.enable_grad(params[name]) for one at least"
        )


def warn_of_edges(names: Sequence[str]) -> None:
    """Tell who renders that derivatives by parameters that move things are not whole."""
    if moving(names):
        warnings.warn(
            f"params = {_shown(moving(names))}: move what light meets; derivatives leave out what "
            "becomes visible or hidden at silhouettes and shadows",
            VisibilityWarning,
            _users_level(),
        )


def _shown(names: Sequence[str]) -> str:
    return checks.shown(", ".join(names))


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
    straight: bool = False,
) -> None:
    """Refuse a render that has no derivatives by the parameters of some names.

    `straight` says that connections go through surfaces that let light straight through.

    Raises:
        ValueError: One line with what of it has none.
    """
    try:
        _require_film(record)
        _require_pulse(record, any(name.endswith("pulse_width_opl") for name in names))
        _require_materials(scene)
        if straight:
            _require_fixed_transmission(scene)
        if moving(names):
            _require_still(scene, sensor, moving(names), straight)
        if any(name.endswith(".eta") for name in names) and index_around(scene, sensor) != 1:
            raise ValueError("sensor: is in glass or water, whose index changes; must be in air")
    except ValueError as error:
        raise ValueError(f"{error} (as {_shown(names)} tracks gradients)") from None


# ------------------------------------------------------------------------------- the scene


def _require_still(
    scene: mi.Scene, sensor: mi.Sensor, names: Sequence[str], straight: bool
) -> None:
    """Refuse that things move where their derivatives are not whole."""
    shown = _shown(names)
    if straight:
        raise ValueError(
            f"params = {shown}: have no derivatives by transient_volpath where surfaces let light "
            "straight through; must be coefficients, materials or power, or by transient_path"
        )
    media = media_of(scene, sensor)
    if media and (Boundaries(scene).exist or not all(m.is_homogeneous() for m in media)):
        raise ValueError(
            f"params = {shown}: have no derivatives in a scene with media that are grids or have "
            "boundaries of equal index; must be coefficients, materials or power"
        )
    for shape in scene.shapes():
        corners = f"{shape.id()}.vertex_positions"
        if shape.is_emitter() and corners in names and flat_twin(shape) is not None:
            raise ValueError(
                f"{corners}: has no derivative, the lamp's normals are smooth; must be a mesh with "
                "face_normals"
            )
    afar = [e for e in scene.emitters() if mi.has_flag(e.flags(), mi.EmitterFlags.Infinite)]
    if afar:
        raise ValueError(
            f"params = {shown}: have no derivatives under {afar[0].class_name()}, whose light "
            "starts at a sphere around all that moves; must be materials or power, or light must "
            "be near"
        )


def _require_fixed_transmission(scene: mi.Scene) -> None:
    """Refuse that what surfaces let straight through changes, which connections do not follow."""
    si: Any = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(0, 0, 1)
    for bsdf in materials(scene):
        with dr.resume_grad():
            if dr.grad_enabled(bsdf.eval_null_transmission(si)):
                raise ValueError(
                    f"bsdf = {bsdf.class_name()}: has no derivatives by transient_volpath of what "
                    "it lets straight through; must be rendered by transient_path"
                )


def _require_materials(scene: mi.Scene) -> None:
    """Refuse materials whose chances of single directions are not known, see `paths.scattering`."""
    for bsdf in materials(scene):
        if wrong := undifferentiated(bsdf):
            raise ValueError(
                f"bsdf = {wrong}: has no derivatives; must be a material with one way of choosing "
                "single directions, or without them"
            )


# ---------------------------------------------------------------------------- film and pulse


def _require_film(record: Recording) -> None:
    film = record.film
    if not film.rfilter().is_box_filter():
        raise ValueError(
            f"film.rfilter = {film.rfilter().class_name()}: has no derivatives; must be box"
        )
    if "xyz" in str(film):
        raise ValueError("film.pixel_format = xyz: has no derivatives; must be rgb or luminance")
    if isinstance(record, BinRecording) and not record.in_time:
        kind = type(film)
        raise ValueError(
            f"film = {kind.__module__}.{kind.__name__}: has no derivatives; must be this package's"
        )


def _require_pulse(record: Recording, by_width: bool) -> None:
    """Refuse pulses without derivative, and derivatives by a pulse's width that are not known."""
    if isinstance(record, PhasorRecording) and by_width:
        raise ValueError(
            "pulse_width_opl: has no derivative on a phasor_hdr_film; must be on a film with bins"
        )
    gate: Any = record.exposure.pulse if record.exposure.at_centres else None
    gate = getattr(record.weight, "pulse", gate)
    if hasattr(gate, "support") and not _is_smooth(gate, gate.eval):
        raise ValueError(
            f"pulse = {checks.shown(gate)}: has hard edges, so that gates have no derivative by "
            "length; must be one whose eval is the integral of its derivative, as of GaussianPulse"
        )
    if not isinstance(record, BinRecording):
        return
    pulse: Any = record.profile
    if pulse is None:
        raise ValueError(
            "pulse = None: leaves bins without a derivative by length; must be a pulse, e.g. by "
            "pulse_width_opl = 0.03"
        )
    if not record.exposure.at_centres and not _is_smooth(pulse, pulse.cdf):
        raise ValueError(
            f"pulse = {checks.shown(pulse)}: has a cdf without derivative; must be one that is "
            "the integral of its derivative, in operations of Dr.Jit"
        )
    if by_width and record.profile is not record.exposure.pulse:
        raise ValueError(
            "pulse_width_opl: has no derivative through a temporal_filter; must be 'box'"
        )


def _is_smooth(pulse: Any, profile: Callable[[mi.Float], mi.Float], count: int = 1 << 12) -> bool:
    """Whether a profile, 0 before its support, is the integral of what Dr.Jit says of its change.

    It is not where it jumps, is constant in pieces, or leaves Dr.Jit for its values.
    """
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
    return bool(off < ROUGHLY * np.abs(height).max())
