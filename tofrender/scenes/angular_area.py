"""Emitter plugin `angulararea`: an area light that shines into a cone about its normals."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import checks


class AngularArea(mi.Emitter):
    """Area light that shines into a cone about its normal (plugin `angulararea`, of mitransient).

    The name `tofrender_angulararea` selects this class even if mitransient is loaded too. Up to the
    angle `beam_width` from the normal, the radiance equals that of an `area` light. Between
    `beam_width` and `cutoff_angle`, the radiance falls linearly with the angle. Beyond
    `cutoff_angle`, the radiance is 0. Integrators with paths that start at lights (such as
    `transient_bdpt`) do not support this emitter and refuse it.

    | parameter | default | meaning |
    |---|---|---|
    | `radiance` | 1.0 | radiance along the normal [W m^-2 sr^-1], a spectrum or texture |
    | `cutoff_angle` | 10 | largest angle to the normal [degrees], up to 90 |
    | `beam_width` | `cutoff_angle` | largest angle of full radiance [degrees] |

    Example:
        >>> lamp = {"type": "tofrender_angulararea", "cutoff_angle": 35.0, "beam_width": 20.0}
        >>> mi.load_dict({"type": "rectangle", "emitter": lamp}).emitter().beam
        20.0
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)

        # The two angles of the cone [degrees]
        cutoff: Any = props.get("cutoff_angle", 10.0)
        unit = "degrees"
        self.cutoff = checks.number("cutoff_angle", cutoff, positive=True, unit=unit, high=90)
        beam: Any = props.get("beam_width", self.cutoff)
        self.beam = checks.number("beam_width", beam, unit=unit, low=0, high=self.cutoff)

        # The radiance must not be negative anywhere
        self.radiance: Any = props.get_emissive_texture("radiance", 1.0)
        values = [np.ravel(np.array(value)) for _, value in mi.traverse(self.radiance)]
        for least in (each.min() for each in values if each.size and each.dtype.kind == "f"):
            checks.number("radiance", float(least), low=0)

        self.m_flags = mi.EmitterFlags.Surface
        if self.radiance.is_spatially_varying():
            self.m_flags |= mi.EmitterFlags.SpatiallyVarying

    def _emitted(self, si: mi.SurfaceInteraction3f, cos: Any, active: mi.Bool) -> Any:
        """Return the radiance of a point in a direction, given its cosine with the normal."""
        cutoff = math.radians(self.cutoff)
        beam = math.radians(self.beam)
        falloff = (cutoff - dr.safe_acos(cos)) / max(cutoff - beam, 1e-9)
        within = active & (cos > max(math.cos(cutoff), 0.0))
        return dr.select(within, self.radiance.eval(si, active) * dr.clip(falloff, 0, 1), 0)

    def eval(self, si: mi.SurfaceInteraction3f, active: Any = True) -> Any:
        """Return the radiance towards `si.wi`."""
        return self._emitted(si, mi.Frame3f.cos_theta(si.wi), mi.Bool(active))

    def sample_direction(self, it: mi.Interaction3f, sample: mi.Point2f, active: Any = True) -> Any:
        """Sample a point of the shape by area. The weight is the radiance over the density."""
        ds: Any = self.get_shape().sample_direction(it, sample, active)
        active = mi.Bool(active) & (dr.dot(ds.d, ds.n) < 0) & (ds.pdf > 0)
        ds.emitter = mi.EmitterPtr(self)
        return ds, dr.select(active, self.eval_direction(it, ds, active) / ds.pdf, 0)

    def pdf_direction(self, it: mi.Interaction3f, ds: Any, active: Any = True) -> Any:
        """Return the density of `sample_direction` per solid angle [1/sr]."""
        facing = mi.Bool(active) & (dr.dot(ds.d, ds.n) < 0)
        return dr.select(facing, self.get_shape().pdf_direction(it, ds, facing), 0)

    def eval_direction(self, it: mi.Interaction3f, ds: Any, active: Any = True) -> Any:
        """Return the radiance of the sampled point `ds` towards the reference point `it`."""
        si = mi.SurfaceInteraction3f(ds, it.wavelengths)
        return self._emitted(si, -dr.dot(ds.d, ds.n), mi.Bool(active))

    def bbox(self) -> mi.ScalarBoundingBox3f:
        """Return the bounding box of the shape."""
        return self.get_shape().bbox()

    def traverse(self, callback: Any) -> None:
        """Expose the radiance as a parameter, as the emitter `area` does."""
        callback.put("radiance", self.radiance, mi.ParamFlags.Differentiable)
