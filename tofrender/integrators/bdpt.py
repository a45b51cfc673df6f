"""Integrator plugin `transient_bdpt`: bidirectional path tracing with all connections."""

from __future__ import annotations

import re

import mitsuba as mi

from ..bidirectional.mis import BidirectionalMIS
from ..runtime import checks
from .bidirectional import BothEnds

# Exponents of the MIS weights by name
HEURISTICS = {"power": 2, "balance": 1, "none": 0}

MAX_DEPTH = 64  # Largest `max_depth`. All vertices of a light path are stored in lane memory


class TransientBDPT(BothEnds):
    """Bidirectional path tracing into time bins (plugin `transient_bdpt`).

    For each sample, a light path and a camera path are traced, and all their vertices are
    connected. A complete path can be found by several strategies (s, t), with s vertices from the
    light and t vertices from the lens. The strategies are weighted by MIS, see
    `tofrender.bidirectional.mis`. This integrator is slower per sample than `transient_path`. It
    has much less noise if light is difficult to find from the camera, for example caustics, lamps
    in fixtures, and light through holes.

    The parameters are the parameters of `BothEnds`, and:

    | parameter | default | meaning |
    |---|---|---|
    | `max_depth` | 6 | longest path in segments, 2 to 64 |
    | `camera_connections` | true | use strategies with t = 1 |
    | `strategy` | "" | only use one strategy, "s,t" |
    | `mis` | "power" | MIS weights, "power" or "balance". With `strategy`, the default is "none": \
the weight is 1 |

    The camera must be a `perspective` or a `thinlens`. Emitters without extent are not visible
    directly.

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
        # Read the strategies and their weights
        text = str(props.get("strategy", ""))
        default = "none" if text else "power"
        self.mis = checks.one_of("mis", props.get("mis", default), HEURISTICS)
        connections = props.get("camera_connections", True)
        self.camera_connections = checks.boolean("camera_connections", connections)
        super().__init__(props)

        # Check the depth and the strategy
        allowed = f"2 to {MAX_DEPTH}, because the vertices of light paths are stored"
        checks.require("max_depth", self.max_depth, 2 <= self.max_depth <= MAX_DEPTH, allowed)
        self.strategy = _strategy(text, self.max_depth, self.camera_connections)
        if self.mis == "none" and self.strategy is None:
            raise ValueError(
                "mis = 'none': must be 'power' or 'balance' without a strategy, because light "
                "would count several times"
            )

    def mis_strategies(self) -> BidirectionalMIS:
        """Return the strategies and their MIS weights."""
        return BidirectionalMIS(HEURISTICS[self.mis], self.camera_connections, self.strategy)


def _strategy(text: str, max_depth: int, camera_connections: bool) -> tuple[int, int] | None:
    """Parse a strategy (s, t).

    Args:
        text: Text like "2,1", or "" for all strategies.
        max_depth: Largest number of segments.
        camera_connections: Whether strategies with t = 1 are used.

    Returns:
        The strategy, None for all strategies.

    Raises:
        ValueError: The strategy is not valid.
    """
    if text == "":
        return None

    # Read s and t, and check that the strategy finds paths within the depth
    found = re.fullmatch(r"\s*(\d+)\s*,\s*(\d+)\s*", text)
    s, t = (int(n) for n in found.groups()) if found else (0, 0)
    allowed = f"'s,t' with s from 0, t from 1, and s + t from 2 to max_depth + 1 = {max_depth + 1}"
    checks.require("strategy", text, found and t >= 1 and 2 <= s + t <= max_depth + 1, allowed)
    if t == 1 and not camera_connections:
        raise ValueError(
            f"strategy = {checks.quote(text)}: t must be above 1 without camera_connections"
        )
    return s, t
