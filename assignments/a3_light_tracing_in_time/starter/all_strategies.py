"""Problem a3.all_strategies: paths from both ends, connected in all ways."""

# ruff: noqa: F401 (imported for what you will write)

from __future__ import annotations

import drjit as dr
import mitsuba as mi
from both_ends import BothEnds, Vertex, camera_path


class TransientBDPT(BothEnds):
    """Bidirectional path tracing in time.

    Strategy (s, t) makes paths of s vertices from the light and t vertices from the lens. Such a
    path has s + t - 1 segments, from 1 to `max_depth`. For s = 0 the path hits the light, for s = 1
    it connects to the light, for t = 1 it connects to the lens, and otherwise it connects two
    surface vertices. You may leave out (1, 1); then (0, 2) has the MIS weight 1. Lights are points,
    spots and surfaces, one or several.

    | parameter | default | meaning |
    |---|---|---|
    | `strategy` | "" | "s,t": use only this strategy |
    | `mis` | "power" | MIS weights: "power" (exponent 2), "balance" (exponent 1); or "none" with \
a `strategy`, which then has the weight 1 |
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        text = str(props.get("strategy", ""))
        self.only = tuple(int(n) for n in text.split(",")) if text else None
        self.mis = str(props.get("mis", "power"))

    def sample(self, scene, sampler, camera, lens, emission, land):
        """Trace paths from the light and from the camera, and connect all pairs of their vertices.

        For the arguments, see `TransientTwoStrategies.sample`.
        """
        raise NotImplementedError("a3.all_strategies: TransientBDPT.sample")
