"""Problem a3.all_strategies: paths from both ends, connected in all ways."""

# ruff: noqa: F401 (imported for what you will write)

from __future__ import annotations

import drjit as dr
import mitsuba as mi
from both_ends import BothEnds, Vertex, camera_path


class TransientBDPT(BothEnds):
    """Bidirectional path tracing in time.

    Strategy (s, t) makes paths of s vertices from the light and t from the lens, of s + t - 1
    segments, 1 to `max_depth` of them: s = 0 runs into the light, s = 1 connects to it, t = 1
    connects to the lens, and all others connect two vertices. You may leave out (1, 1); (0, 2) then
    has its light in full. Lights are points, spots and surfaces, one or several.

    | parameter | default | meaning |
    |---|---|---|
    | `strategy` | "" | "s,t" lets this strategy alone count |
    | `mis` | "power" | MIS weights: "power" (exponent 2), "balance" (exponent 1); and "none" with \
a `strategy`, which then counts in full |
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        text = str(props.get("strategy", ""))
        self.only = tuple(int(n) for n in text.split(",")) if text else None
        self.mis = str(props.get("mis", "power"))

    def sample(self, scene, sampler, camera, lens, emission, land):
        """Follow light and camera rays, and connect each vertex of one to each of the other.

        Arguments are those of `TransientTwoStrategies.sample`.
        """
        raise NotImplementedError("a3.all_strategies: TransientBDPT.sample")
