"""Integrator plugin `transient_volpath`: `transient_path` with the depth of Mitsuba's `volpath`."""

from __future__ import annotations

import mitsuba as mi

from ..paths.protocols import Endpoint
from ..paths.surfaces import lets_straight_through
from .lights_straight_ahead import LightsStraightAhead
from .plan import Plan
from .transient_path import TransientPath


class TransientVolpath(TransientPath):
    """Path tracer through fog, smoke and milk into time bins (plugin `transient_volpath`).

    `transient_path` follows participating media, too. This one is for scenes that have `volpath`,
    `volpathmis` or `prbvolpath`: all parameters are those of `TransientPath`, but paths have no
    limit where none is given.

    | parameter | default | meaning |
    |---|---|---|
    | `max_depth` | -1 | longest path in segments, camera's included; -1 is unlimited |

    Points where a medium scatters count as vertices; boundaries of equal index (BSDF `null`) do
    not, and neither they nor null collisions change the length of a path. That is the distance
    between its vertices times the index of refraction there, which a medium has from the glass
    around it.

    Surfaces that let light straight through (`null` with or without a medium, `thindielectric`,
    `mask`, polarisers) follow the rules of Mitsuba's `volpath`, not those of its `path`:

    | straight through such a surface | `transient_path` | `transient_volpath` |
    |---|---|---|
    | connections to lamps | are blocked | go, less what it holds back |
    | lamps that paths cannot run into | are dark behind it | are not |
    | depth of a path | one more | the same |

    Both let connections through `null` where a medium is in the scene, and count all lengths as
    straight. Derivatives by what moves in such scenes, or by how much is let through, are
    `transient_path`'s.

    Example:
        >>> import tofrender
        >>> description = tofrender.cornell_box(width=16, height=16)
        >>> fog = {"type": "homogeneous", "sigma_t": 0.2, "albedo": 0.9}
        >>> description["sensor"]["medium"] = fog
        >>> description["integrator"] = {"type": "transient_volpath", "max_depth": 8}
        >>> mi.render(mi.load_dict(description), spp=4)[1].shape
        (16, 16, 300, 3)
    """

    default_depth = -1
    goes_straight = True

    def plan(self, scene, sensor=None, weight=None) -> Plan:
        """Return the plan, in which null interactions are no vertices."""
        plan = super().plan(scene, sensor, weight)
        plan.limits.ignore_null = lets_straight_through(scene)
        return plan

    def endpoint(self, scene: mi.Scene, sensor: mi.Sensor | None) -> Endpoint:
        """Return the light-sampling technique, through such surfaces, too."""
        if not (self.emitter_sampling and lets_straight_through(scene)):
            return super().endpoint(scene, sensor)
        points = self.light_samples
        return self.emitters(LightsStraightAhead, scene, sensor, light_samples=points)
