"""Problems a3.light_tracer and a3.caustics: light tracing."""

# ruff: noqa: F401 (imported for what you will write)

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
from both_ends import BothEnds, Vertex

from tofrender.bidirectional.emission import Emitted


def light_path(scene: mi.Scene, sampler: mi.Sampler, emitted: Emitted, count: int) -> list[Vertex]:
    """Trace paths from the light; the counterpart of `camera_path` in `both_ends.py`.

    Only your code calls this function, so you may change it.

    Args:
        scene: The scene.
        sampler: Random numbers.
        emitted: Start of the light paths: `ray`, `origin`, `weight`, `active` and more.
        count: Largest number of vertices.

    Returns:
        The vertices, in their order from the light.
    """
    raise NotImplementedError("a3.light_tracer: light_path")


class TransientLightTracer(BothEnds):
    """Light tracing: connect each vertex of a path from the light to the lens.

    `render` is given (`both_ends.py`); other integrators are not allowed in your files.
    """

    def sample(self, scene, sampler, camera, lens, emission, land):
        """Trace paths from the light, and connect their vertices to the lens.

        Paths have 2 to `max_depth` segments, including the segments at light and camera. You may
        leave out light that the camera sees without a surface in between.

        Args:
            scene: The scene.
            sampler: Source of all random numbers: equal seeds must give equal pictures. It has one
                lane for each light path.
            camera: Camera rays, one for each lane.
            lens: The lens. A test may pass a different lens, with the methods `sample` and `arrive`
                and all fields of an `Arrival`.
            emission: The scene's lights: `emission.sample(sampler, camera.ray)` is an `Emitted`.
            land: Call `land(spectrum, opl, position, active)` for each connection: its
                contribution, its optical path length from the light to the lens [m], its position
                on the film [pixels], and the mask of the lanes with a connection. `land` divides by
                the number of paths per pixel.
        """
        raise NotImplementedError("a3.light_tracer: TransientLightTracer.sample")
