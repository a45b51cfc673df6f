"""Integrator plugin `simple`: a point light and white surfaces."""

from __future__ import annotations

import math
from numbers import Real
from typing import Any

import mitsuba as mi

from ..runtime import checks
from .first_surface import FirstSurface
from .outside_lights import PointSource


class Simple(FirstSurface):
    """Integrator of one point light and one bounce off white surfaces (plugin `simple`).

        L(x) = Phi / (4 pi^2) max(0, cos) / |x - p|^2 V(x, p)

    where cos is between the shading normal and the direction to the light at p, and V is 1 where
    nothing stands between: a point light of power Phi has intensity Phi / (4 pi), and white diffuse
    surfaces reflect 1 / pi of what they receive. In time, light of x arrives at |c - x| + |x - p|
    for a camera at c. The light is the integrator's own; those of the scene stay dark.

    | parameter | default | meaning |
    |---|---|---|
    | `position` | required | where the light is, p [m] |
    | `energy` | required | its power Phi [W], a number or a colour, 0 or more |

    and those of `FirstSurface`.

    Example:
        >>> integrator = mi.load_dict({"type": "simple", "position": [0, 2, 1], "energy": 40.0})
        >>> integrator.energy
        [40.0, 40.0, 40.0]
    """

    def __init__(self, props: mi.Properties) -> None:
        for name in ("position", "energy"):
            if name not in props:
                raise ValueError(f"{name}: is missing; must be given to the integrator simple")
        self.position = checks.point("position", props["position"])
        self.energy = _colour("energy", props["energy"])
        super().__init__(props)
        rgb = {"type": "rgb", "value": [phi / (4 * math.pi) for phi in self.energy]}
        light = {"type": "point", "position": self.position, "intensity": rgb}
        self.emitter = mi.load_dict(light)

    def endpoint(self, scene: mi.Scene, sensor: mi.Sensor | None) -> PointSource:
        """Return the integrator's own light."""
        return PointSource(scene, self.emitter, self.hide_emitters)


def _colour(name: str, value: Any) -> list[float]:
    is_number = isinstance(value, Real) and not isinstance(value, bool)
    try:
        colour = [float(x) for x in ([value] * 3 if is_number else value)]
    except (TypeError, ValueError):
        colour = []
    valid = len(colour) == 3 and all(0 <= x < math.inf for x in colour)
    checks.require(name, value, valid, "a number or an RGB colour, 0 or more")
    return colour
