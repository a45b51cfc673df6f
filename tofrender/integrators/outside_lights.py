"""Lights that are not part of a scene: a point light, and a white sky."""

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
        hide_emitters: Whether the sensor looks through the scene's area lights.
    """

    def __init__(self, scene: mi.Scene, emitter: mi.Emitter, hide_emitters: bool = False) -> None:
        checks.instance("scene", scene, mi.Scene, "a loaded scene")
        self.hide_emitters = checks.boolean("hide_emitters", hide_emitters)
        self.emitter = checks.instance("emitter", emitter, mi.Emitter, "an emitter")

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """Return the only direction towards the light; draws no random number."""
        ds, weight = self.emitter.sample_direction(vertex.si, mi.Point2f(0.5), active)
        weight = mi.unpolarized_spectrum(weight)
        return Connection(ds.p, ds.d, weight, ds.dist, mi.Bool(active), ds.pdf)


class OpenSky(Endpoint):
    """Radiance 1 from every direction in which there is no surface.

    Directions are sampled by their cosine to the shading normal, on the side that the path comes
    from. In time, the light of each direction starts on the plane that `Wavefronts` says.

    Args:
        scene: The scene, which occludes the sky.
        sensor: As in `SceneLights`.
        hide_emitters: Whether the sensor looks through the scene's area lights.
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
        """Sample a direction of the sky by its cosine."""
        si = vertex.si
        local = square_to_cosine_hemisphere(sampler.next_2d())
        pdf = square_to_cosine_hemisphere_pdf(local)
        d = si.to_world(mi.Vector3f(local.x, local.y, dr.mulsign(local.z, si.wi.z)))
        weight = dr.select(pdf > 0, white(si.wavelengths) / pdf, 0)
        length = self.sphere.length(si.p, d)
        point = dr.fma(d, length + self.sphere.radius, si.p)  # Beyond all that could hide it
        return Connection(point, d, weight, length, active & (pdf > 0), pdf)
