"""Problem a3.two_strategies: next-event estimation and light tracing."""

# ruff: noqa: F401 (imported for what you will write)

from __future__ import annotations

import drjit as dr
import mitsuba as mi
from both_ends import BothEnds, Vertex, camera_path


class TransientTwoStrategies(BothEnds):
    """Next-event estimation on paths from the camera, and connections of light paths to the lens.

    A path that both strategies can sample is weighted by the power heuristic (exponent 2). A path
    that only one strategy can sample has the MIS weight 1. Paths have 2 to `max_depth` segments.
    Lights that a path hits do not count. Lights are points, spots and surfaces, one or several.

    | parameter | default | meaning |
    |---|---|---|
    | `end` | "both" | "camera" or "light": only paths of this end, with their MIS weights |
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.end = str(props.get("end", "both"))

    def sample(self, scene, sampler, camera, lens, emission, land):
        """Trace paths from the light and from the camera, and connect each to the other end.

        For the arguments, see `TransientLightTracer.sample`. `lens` also has `density(d)`.
        Contributions of camera paths land at `camera.position`.
        """
        raise NotImplementedError("a3.two_strategies: TransientTwoStrategies.sample")
