# pyright: reportArgumentType=false
"""Lights that are not part of a scene: a point source, and a white sky."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ...runtime import checks
from ...sampling.warps import square_to_cosine_hemisphere, square_to_cosine_hemisphere_pdf
from ...signals.illuminants import white
from ..records import Connection, Path, Vertex
from .unseen import Unseen
from .wavefronts import Wavefronts


class PointSource(Unseen):
    """A point light of Mitsuba's that no scene needs to hold.

    Args:
        scene: What casts shadows.
        emitter: A `point` emitter.
        hide_emitters: As in `Unseen`.
    """

    def __init__(self, scene: mi.Scene, emitter: mi.Emitter, hide_emitters: bool = False) -> None:
        super().__init__(scene, hide_emitters)
        self.emitter: Any = checks.instance("emitter", emitter, mi.Emitter, "an emitter")

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """The one direction towards the light; draws no random number."""
        ds, weight = self.emitter.sample_direction(vertex.si, mi.Point2f(0.5), active)
        return Connection(
            point=ds.p,
            direction=ds.d,
            weight=mi.unpolarized_spectrum(weight),
            pdf=ds.pdf,
            delta=mi.Bool(True),
            length=ds.dist,
            active=mi.Bool(active),
            clear=mi.Bool(False),
        )


class OpenSky(Unseen):
    """Radiance 1 from every direction in which there is no surface.

    Directions are sampled by their cosine to the shading normal, on the side that the path comes
    from. In time, the light of each direction starts on the plane that `Wavefronts` says.

    Args:
        scene: What the sky is hidden by.
        sensor: As in `SceneLights`.
        hide_emitters: As in `Unseen`.
    """

    def __init__(
        self, scene: mi.Scene, sensor: mi.Sensor | None = None, hide_emitters: bool = False
    ) -> None:
        super().__init__(scene, hide_emitters)
        checks.instance("sensor", sensor, mi.Sensor | None, "a sensor or None")
        self.sphere = Wavefronts.around(scene, sensor)

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """A direction of the sky."""
        si = vertex.si
        local = square_to_cosine_hemisphere(sampler.next_2d())
        pdf = square_to_cosine_hemisphere_pdf(local)
        d = si.to_world(mi.Vector3f(local.x, local.y, dr.mulsign(local.z, si.wi.z)))
        length = self.sphere.length(si.p, d)
        return Connection(
            point=dr.fma(d, length + self.sphere.radius, si.p),  # Beyond all that could hide it
            direction=d,
            weight=dr.select(pdf > 0, white(si.wavelengths) / pdf, 0),
            pdf=pdf,
            delta=mi.Bool(True),
            length=length,
            active=active & (pdf > 0),
            clear=mi.Bool(False),
        )
