"""Endpoints with lights outside of the scene: a point light and a white sky."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..paths.protocols import Endpoint
from ..paths.records import Connection, Path, Vertex
from ..paths.wavefronts import Wavefronts
from ..runtime import checks
from ..sampling.warps import square_to_cosine_hemisphere, square_to_cosine_hemisphere_pdf
from ..signals.illuminants import white


class PointSource(Endpoint):
    """A point light that is not part of the scene.

    Args:
        scene: The scene.
        emitter: A `point` emitter.
        hide_emitters: Whether camera rays pass the area lights of the scene.
    """

    def __init__(self, scene: mi.Scene, emitter: mi.Emitter, hide_emitters: bool = False) -> None:
        checks.instance("scene", scene, mi.Scene, "a loaded scene")
        self.hide_emitters = checks.boolean("hide_emitters", hide_emitters)
        self.emitter = checks.instance("emitter", emitter, mi.Emitter, "an emitter")

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """Connect to the light. Random numbers are not needed."""
        ds, weight = self.emitter.sample_direction(vertex.si, mi.Point2f(0.5), active)
        weight = mi.unpolarized_spectrum(weight)
        return Connection(
            point=ds.p,
            direction=ds.d,
            weight=weight,
            length=ds.dist,
            active=mi.Bool(active),
            pdf=ds.pdf,
        )


class OpenSky(Endpoint):
    """White sky with radiance 1 in all directions, which surfaces may block.

    Directions are sampled in proportion to the cosine with the shading normal, on the side of the
    surface where the path arrives. The light of each direction starts on a plane outside of the
    scene, see `Wavefronts`.

    Args:
        scene: The scene, which blocks the sky.
        sensor: As in `SceneLights`.
        hide_emitters: Whether camera rays pass the area lights of the scene.
    """

    def __init__(
        self, scene: mi.Scene, sensor: mi.Sensor | None = None, hide_emitters: bool = False
    ) -> None:
        checks.instance("scene", scene, mi.Scene, "a loaded scene")
        self.hide_emitters = checks.boolean("hide_emitters", hide_emitters)
        checks.instance("sensor", sensor, mi.Sensor | None, "a sensor or None")
        self.sphere = Wavefronts.around(scene, sensor)

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """Sample a direction of the sky in proportion to the cosine."""
        # Sample a direction, on the side where the path arrives
        si = vertex.si
        local = square_to_cosine_hemisphere(sampler.next_2d())
        pdf = square_to_cosine_hemisphere_pdf(local)
        d = si.to_world(mi.Vector3f(local.x, local.y, dr.mulsign(local.z, si.wi.z)))

        # Evaluate the sky
        weight = dr.select(pdf > 0, white(si.wavelengths) / pdf, 0)
        length = self.sphere.length(si.p, d)

        # End the connection behind all surfaces that may block the sky
        point = dr.fma(d, length + self.sphere.radius, si.p)
        return Connection(
            point=point,
            direction=d,
            weight=weight,
            length=length,
            active=active & (pdf > 0),
            pdf=pdf,
        )
