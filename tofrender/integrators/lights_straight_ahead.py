"""Next-event estimation through thin panes and masks, for `transient_volpath`."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..paths.endpoints import SceneLights
from ..paths.protocols import HistoryUpdates
from ..paths.records import BSDFSample, Path, Vertex


class LastScattering(HistoryUpdates[mi.Interaction3f]):
    """History of paths with null interactions: the last vertex that scattered the path."""

    def start(self) -> mi.Interaction3f:
        """Return an empty interaction, because the first ray starts at the sensor."""
        return dr.zeros(mi.Interaction3f)

    def after_sample(self, path: Path, vertex: Vertex, bsdf_sample: BSDFSample) -> mi.Interaction3f:
        """Return the current vertex, or the earlier vertex after a null interaction."""
        return dr.select(bsdf_sample.null, path.history, mi.Interaction3f(vertex.si))


class LightsStraightAhead(SceneLights):
    """`SceneLights` with connections through null surfaces, for limits with `ignore_null`."""

    history = LastScattering()

    def connection_reference(self, path: Path) -> mi.Interaction3f:
        """Return the last vertex that scattered the path, where connections start."""
        return path.history
