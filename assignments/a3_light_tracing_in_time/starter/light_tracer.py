"""Problems a3.light_tracer and a3.caustics: light tracing."""

# ruff: noqa: F401 (imported for what you will write)

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
from both_ends import BothEnds, Vertex

from tofrender.bidirectional.emission import Emitted


def light_path(scene: mi.Scene, sampler: mi.Sampler, emitted: Emitted, count: int) -> list[Vertex]:
    """The surface points that light meets: `camera_path` of `both_ends.py`, from the other end.

    Nobody calls this but you: another form is as good.

    Args:
        scene: The scene.
        sampler: Random numbers.
        emitted: How the light starts: `ray`, `origin`, `weight`, `active` and more.
        count: Most vertices.

    Returns:
        The vertices, the one next to the light first.
    """
    raise NotImplementedError("a3.light_tracer: light_path")


class TransientLightTracer(BothEnds):
    """Paths from the light, each vertex of which is connected to the lens.

    `render` is given (`both_ends.py`); other integrators are not allowed in your files.
    """

    def sample(self, scene, sampler, camera, lens, emission, land):
        """Follow light, and connect it.

        Paths have 2 to `max_depth` segments, those at light and camera included. You may
        leave out light that the camera sees without a surface in between.

        Args:
            scene: The scene.
            sampler: All random numbers: the same give the same picture. So many lanes, so many
                paths of light.
            camera: As many camera rays.
            lens: The lens; a test may bring another than yours, which has `sample` and `arrive`
                with all that an `Arrival` has.
            emission: The scene's lights: `emission.sample(sampler, camera.ray)` is an `Emitted`.
            land: Call `land(spectrum, opl, position, active)` for each connection: what it
                carries, its optical path length from the light to the lens [m], where it lands on
                the film [pixels], and the lanes that have one. It divides by the number of paths
                per pixel.
        """
        raise NotImplementedError("a3.light_tracer: TransientLightTracer.sample")
