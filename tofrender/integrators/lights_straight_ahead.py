"""Next-event estimation through panes and masks, for `transient_volpath`."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..paths.endpoints import SceneLights
from ..paths.protocols import HistoryUpdates
from ..paths.records import BSDFSample, Path, Vertex


class LastScattering(HistoryUpdates[mi.Interaction3f]):
    """History of paths that go straight through surfaces: the last vertex that scattered them."""

    def start(self) -> mi.Interaction3f:
        """Return a placeholder: the first ray comes from the sensor."""
        return dr.zeros(mi.Interaction3f)

    def after_sample(self, path: Path, vertex: Vertex, bsdf_sample: BSDFSample) -> mi.Interaction3f:
        """Return the vertex, or the earlier one where the path goes straight on."""
        return dr.select(bsdf_sample.null, path.history, mi.Interaction3f(vertex.si))


class LightsStraightAhead(SceneLights):
    """`SceneLights` with connections through panes and masks, for `Limits` with `ignore_null`."""

    history = LastScattering()

    def connection_reference(self, path: Path) -> mi.Interaction3f:
        """Return the last vertex that scattered the path, from which connections go."""
        return path.history
