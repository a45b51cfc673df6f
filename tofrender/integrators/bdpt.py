"""Integrator plugin `transient_bdpt`: paths from both ends, connected in all ways."""

from __future__ import annotations

import re

import mitsuba as mi

from ..bidirectional.mis import BidirectionalMIS
from ..runtime import checks
from .bidirectional import BothEnds

HEURISTICS = {"power": 2, "balance": 1, "none": 0}

MAX_DEPTH = 64  # A lane keeps all vertices of a light path in its own memory


class TransientBDPT(BothEnds):
    """Bidirectional path tracing into time bins (plugin `transient_bdpt`).

    A sample is a path from a light and one from the camera, all of whose vertices are connected.
    Each path of light is thus found by several strategies (s, t), s vertices from the light and t
    from the lens, weighted by MIS, see `tofrender.bidirectional.mis`.
    Slower per sample than `transient_path`, and far better where light is hard to find from the
    camera: caustics, lamps in fixtures, light through holes.

    Besides the parameters of `BothEnds`:

    | parameter | default | meaning |
    |---|---|---|
    | `max_depth` | 6 | longest path in segments, 2 to 64 |
    | `camera_connections` | true | use strategies with t = 1 |
    | `strategy` | "" | "s,t" lets this strategy alone count |
    | `mis` | "power" | weights: "power" or "balance"; with `strategy` also "none", the default \
there, which shows what it makes of all light of its lengths |

    Limitations: cameras are `perspective` or `thinlens`; a light of no extent is not seen directly.

    Example:
        >>> import mitsuba as mi, tofrender
        >>> scene = mi.load_dict(tofrender.cornell_box(width=16, height=16))
        >>> tracer = mi.load_dict({"type": "transient_bdpt", "max_depth": 4})
        >>> steady, transient = mi.render(scene, integrator=tracer, spp=4)
        >>> transient.shape
        (16, 16, 300, 3)
    """

    shown = ("max_depth", "rr_depth", "camera_connections", "strategy", "mis", "pulse")

    def __init__(self, props: mi.Properties) -> None:
        text = str(props.get("strategy", ""))
        default = "none" if text else "power"
        self.mis = checks.one_of("mis", props.get("mis", default), HEURISTICS)
        connections = props.get("camera_connections", True)
        self.camera_connections = checks.boolean("camera_connections", connections)
        super().__init__(props)
        allowed = f"2 to {MAX_DEPTH}, vertices of light paths are kept"
        checks.require("max_depth", self.max_depth, 2 <= self.max_depth <= MAX_DEPTH, allowed)
        self.strategy = _strategy(text, self.max_depth, self.camera_connections)
        if self.mis == "none" and self.strategy is None:
            raise ValueError(
                "mis = 'none': must be 'power' or 'balance' without strategy, light would count "
                "several times"
            )

    def mis_strategies(self) -> BidirectionalMIS:
        """Return all strategies, or one."""
        return BidirectionalMIS(HEURISTICS[self.mis], self.camera_connections, self.strategy)


def _strategy(text: str, max_depth: int, camera_connections: bool) -> tuple[int, int] | None:
    """Parse a strategy like "2,1"; None for all."""
    if text == "":
        return None
    found = re.fullmatch(r"\s*(\d+)\s*,\s*(\d+)\s*", text)
    s, t = (int(n) for n in found.groups()) if found else (0, 0)
    allowed = f"'s,t' with s from 0, t from 1, and s + t from 2 to max_depth + 1 = {max_depth + 1}"
    checks.require("strategy", text, found and t >= 1 and 2 <= s + t <= max_depth + 1, allowed)
    if t == 1 and not camera_connections:
        raise ValueError(
            f"strategy = {checks.quote(text)}: must have t above 1 without camera_connections"
        )
    return s, t
