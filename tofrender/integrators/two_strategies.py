"""Path tracing by next-event estimation and light tracing together, without what lies between."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..bidirectional.mis import BidirectionalMIS
from ..runtime import checks
from .bidirectional import BothEnds

ENDS = ("both", "camera", "light")


class TwoStrategies(BidirectionalMIS):
    """MIS of the strategies (1, t) if `end` is not "light", and (s, 1) if it is not "camera"."""

    def __init__(self, end: str) -> None:
        super().__init__(exponent=2, hits=False, inner=False)
        self.end = end

    def weight(self, x: mi.Float, s: mi.UInt32 | int, t: mi.UInt32 | int) -> mi.Float:
        """Return the MIS weight of (1, t), t > 1, and of (s, 1), s > 1; others do not count."""
        from_camera = (mi.UInt32(s) == 1) & (mi.UInt32(t) > 1) & (self.end != "light")
        from_light = (mi.UInt32(s) > 1) & (mi.UInt32(t) == 1) & (self.end != "camera")
        return dr.select(from_camera | from_light, super().weight(x, s, t), 0)


class TransientTwoStrategies(BothEnds):
    """Next-event estimation from the camera's paths, and connections of light paths to the lens.

    A path that both can find is shared by the power heuristic, and one that only one finds counts
    in full. Light that the camera sees directly, or in mirrors and glass alone, is missing.

    | parameter | default | meaning |
    |---|---|---|
    | `end` | "both" | "camera" or "light": only what this end's paths find, with its MIS weight |
    """

    def __init__(self, props: mi.Properties) -> None:
        self.end = checks.one_of("end", props.get("end", "both"), ENDS)
        super().__init__(props)

    def mis_strategies(self) -> BidirectionalMIS:
        """Return the two strategies."""
        return TwoStrategies(self.end)
