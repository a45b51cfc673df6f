"""Integrator plugin `transient_volpath`: `transient_path` with the depth of Mitsuba's `volpath`."""

from __future__ import annotations

import mitsuba as mi

from ..paths.protocols import Endpoint
from ..paths.surfaces import lets_straight_through
from .lights_straight_ahead import LightsStraightAhead
from .plan import Plan
from .transient_path import TransientPath


class TransientVolpath(TransientPath):
    """Path tracer with the depth of Mitsuba's `volpath` (plugin `transient_volpath`).

    Both `transient_path` and `transient_volpath` support participating media such as fog, smoke and
    milk. `transient_volpath` replaces Mitsuba's `volpath`, `volpathmis` and `prbvolpath`. The
    parameters are the parameters of `TransientPath`, with another default:

    | parameter | default | meaning |
    |---|---|---|
    | `max_depth` | -1 | longest path in segments, including the camera segment; -1 is unlimited |

    Points where a medium scatters are vertices of a path. Index-matched boundaries (BSDF `null`)
    and null collisions are not vertices, and do not change path lengths. The length of a segment is
    the distance between its vertices, times the index of refraction. The index of refraction of a
    medium is the index of the glass around the medium.

    For surfaces with null transmission (`null` with or without a medium, `thindielectric`, `mask`,
    polarizers), the depth and the connections follow Mitsuba's `volpath` instead of `path`:

    | behind such a surface | `transient_path` | `transient_volpath` |
    |---|---|---|
    | connections to emitters | are blocked | are multiplied by the transmission |
    | emitters that rays cannot hit | are not visible | are visible |
    | depth of a path | is increased by 1 | does not change |

    With both integrators, connections pass `null` surfaces in scenes with media, and null
    transmission does not bend rays. Use `transient_path` for derivatives by moving objects in such
    scenes, or by the amount of null transmission.

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
        """Return the plan. Null interactions are not vertices of its paths."""
        plan = super().plan(scene, sensor, weight)

        # Null interactions change neither the depth nor MIS weights
        plan.limits.ignore_null = lets_straight_through(scene)
        return plan

    def endpoint(self, scene: mi.Scene, sensor: mi.Sensor | None) -> Endpoint:
        """Return the light-sampling technique, with connections through null surfaces."""
        if not (self.emitter_sampling and lets_straight_through(scene)):
            return super().endpoint(scene, sensor)
        points = self.light_samples
        return self.emitters(LightsStraightAhead, scene, sensor, light_samples=points)
