"""Integrator plugin `transient_volpath`: `transient_path` with the depth of Mitsuba's `volpath`."""

from __future__ import annotations

import mitsuba as mi

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

    Example:
        >>> import tofrender
        >>> description = tofrender.cornell_box(width=16, height=16)
        >>> fog = {"type": "homogeneous", "sigma_t": 0.2, "albedo": 0.9}
        >>> description["sensor"]["medium"] = fog
        >>> description["integrator"] = {"type": "transient_volpath", "max_depth": 8}
        >>> mi.render(mi.load_dict(description), spp=4)[1].shape
        (16, 16, 300, 3)
    """

    def __init__(self, props: mi.Properties) -> None:
        if not {"max_depth", "max_bounces"} & set(props.keys()):
            props["max_depth"] = -1
        super().__init__(props)
