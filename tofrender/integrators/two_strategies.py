"""Next-event estimation combined with light tracing, without other bidirectional strategies."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..bidirectional.mis import BidirectionalMIS
from ..runtime import checks
from .bidirectional import BothEnds

ENDS = ("both", "camera", "light")


class TwoStrategies(BidirectionalMIS):
    """MIS weights of the strategies (1, t) and (s, 1).

    Args:
        end: "camera" for (1, t), "light" for (s, 1), or "both".
    """

    def __init__(self, end: str) -> None:
        super().__init__(exponent=2, hits=False, inner=False)
        self.end = end

    def weight(self, x: mi.Float, s: mi.UInt32 | int, t: mi.UInt32 | int) -> mi.Float:
        """Return the MIS weight of (1, t) with t > 1 and of (s, 1) with s > 1, otherwise 0."""
        # Which of the two strategies is (s, t), and does it count?
        from_camera = (mi.UInt32(s) == 1) & (mi.UInt32(t) > 1) & (self.end != "light")
        from_light = (mi.UInt32(s) > 1) & (mi.UInt32(t) == 1) & (self.end != "camera")
        return dr.select(from_camera | from_light, super().weight(x, s, t), 0)


class TransientTwoStrategies(BothEnds):
    """Next-event estimation of camera paths, and connections of light paths to the lens.

    If both strategies can find a path, they are weighted by the power heuristic. If only one
    strategy can find a path, its weight is 1. Emitters that the camera sees directly, or only
    through mirrors and glass, are missing.

    | parameter | default | meaning |
    |---|---|---|
    | `end` | "both" | "camera" or "light" shows only the light of one strategy, with MIS weights |
    """

    def __init__(self, props: mi.Properties) -> None:
        self.end = checks.one_of("end", props.get("end", "both"), ENDS)
        super().__init__(props)

    def mis_strategies(self) -> BidirectionalMIS:
        """Return the two strategies and their MIS weights."""
        return TwoStrategies(self.end)
