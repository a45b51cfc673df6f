"""Base class of the path tracers of the course, for films with and without time bins."""

from __future__ import annotations

from dataclasses import replace

import mitsuba as mi

from ..films.exposure import BINS, PHASORS, PICTURE, Exposure
from ..runtime import checks
from .transient_path import TransientPath


class PathTracer(TransientPath):
    """Path tracer for steady pictures, time bins and phasors.

    The supported films are `hdrfilm`, `transient_hdr_film` and `phasor_hdr_film`. A subclass only
    overrides `endpoint` to define how light is found. The parameters are the parameters of
    `TransientPath`. The parameter in the table replaces `max_depth`.

    | parameter | default | meaning |
    |---|---|---|
    | `max_bounces` | -1 | largest number of surfaces on a path: 0 only shows emitters, 1 adds \
direct light, -1 is unlimited |
    """

    default_depth = -1

    def __init__(self, props: mi.Properties) -> None:
        # Convert bounces to segments
        if "max_bounces" in props and "max_depth" in props:
            raise ValueError(
                f"max_depth = {props['max_depth']}: must be left out next to max_bounces, because "
                "max_depth is max_bounces + 1"
            )
        if "max_bounces" in props:
            props["max_depth"] = checks.depth_of_bounces(props["max_bounces"])
        super().__init__(props)
        if not self.emitter_sampling:
            raise ValueError(
                "emitter_sampling = False: must be left out. Use path_tracer_mats for paths that "
                "hit emitters by chance"
            )

    @property
    def max_bounces(self) -> int:
        """Largest number of surfaces on a path, -1 if unlimited."""
        return self.max_depth - 1 if self.max_depth > 0 else -1

    def exposure(self) -> Exposure:
        """Return the weighting of light. A steady picture shows all light."""
        return replace(super().exposure(), supported_films=(BINS, PHASORS, PICTURE))
