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
    """Direct light of one point light on white surfaces (plugin `simple`).

        L(x) = Phi / (4 pi^2) max(0, cos) / |x - p|^2 V(x, p)

    where cos is the cosine between the shading normal and the direction to the light at p. V is 1
    if no surface blocks the light, and 0 otherwise. A point light with the power Phi has the
    intensity Phi / (4 pi), and white diffuse surfaces have the BSDF 1 / pi. The light of a surface
    point x arrives at the path length |c - x| + |x - p|, for a camera at c. The emitters of the
    scene are ignored.

    The parameters are the parameters of `FirstSurface`, and:

    | parameter | default | meaning |
    |---|---|---|
    | `position` | required | position p of the light [m] |
    | `energy` | required | power Phi of the light [W], a number or a color, 0 or more |

    Example:
        >>> integrator = mi.load_dict({"type": "simple", "position": [0, 2, 1], "energy": 40.0})
        >>> integrator.energy
        [40.0, 40.0, 40.0]
    """

    def __init__(self, props: mi.Properties) -> None:
        # Read the position and the power of the light
        for name in ("position", "energy"):
            if name not in props:
                raise ValueError(f"{name} is missing. Set {name} of the integrator simple")
        self.position = checks.point("position", props["position"])
        self.energy = _color("energy", props["energy"])
        super().__init__(props)

        # Create the light, which emits in all directions
        rgb = {"type": "rgb", "value": [phi / (4 * math.pi) for phi in self.energy]}
        light = {"type": "point", "position": self.position, "intensity": rgb}
        self.emitter = mi.load_dict(light)

    def endpoint(self, scene: mi.Scene, sensor: mi.Sensor | None) -> PointSource:
        """Return the endpoint with the light of this integrator."""
        return PointSource(scene, self.emitter, self.hide_emitters)


def _color(name: str, value: Any) -> list[float]:
    """Require a number or an RGB color, and return the color."""
    # A number is the same power in all channels
    is_number = isinstance(value, Real) and not isinstance(value, bool)
    try:
        color = [float(x) for x in ([value] * 3 if is_number else value)]
    except (TypeError, ValueError):
        color = []
    valid = len(color) == 3 and all(0 <= x < math.inf for x in color)
    checks.require(name, value, valid, "a number or an RGB color, 0 or more")
    return color
