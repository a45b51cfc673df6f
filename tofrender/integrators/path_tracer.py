"""Base class of the course's path tracers: bounces, and films with time or without."""

from __future__ import annotations

from dataclasses import replace

import mitsuba as mi

from ..films.exposure import BINS, PHASORS, PICTURE, Exposure
from ..runtime import checks
from .transient_path import TransientPath


class PathTracer(TransientPath):
    """A path tracer for both kinds of films: pictures (`hdrfilm`), and bins (`transient_hdr_film`).

    A subclass says in `endpoint` how light is found, and nothing else. It takes the parameters of
    `TransientPath`, and instead of `max_depth`

    | parameter | default | meaning |
    |---|---|---|
    | `max_bounces` | -1 | surfaces on the longest path: 0 shows lights only, 1 adds direct light; \
-1 is unlimited |
    """

    default_depth = -1

    def __init__(self, props: mi.Properties) -> None:
        if "max_bounces" in props and "max_depth" in props:
            raise ValueError(
                f"max_depth = {props['max_depth']}: must be left out next to max_bounces, "
                "which is one less"
            )
        if "max_bounces" in props:
            props["max_depth"] = checks.depth_of_bounces(props["max_bounces"])
        super().__init__(props)
        if not self.emitter_sampling:
            raise ValueError(
                "emitter_sampling = False: must be left out; path_tracer_mats runs into lights"
            )

    @property
    def max_bounces(self) -> int:
        """Surfaces on the longest path, -1 if unlimited."""
        return self.max_depth - 1 if self.max_depth > 0 else -1

    def exposure(self) -> Exposure:
        """Return how light counts: on a picture all of it."""
        return replace(super().exposure(), supported_films=(BINS, PHASORS, PICTURE))
