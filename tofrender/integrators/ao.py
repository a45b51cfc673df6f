"""Integrator plugin `ao`: ambient occlusion."""

from __future__ import annotations

import mitsuba as mi

from .first_surface import FirstSurface
from .outside_lights import OpenSky


class AmbientOcclusion(FirstSurface):
    """White diffuse surfaces under a white sky, one bounce (plugin `ao`).

        L(x) = integral over the hemisphere of V(x, w) cos / pi dw

    where V is 1 in directions w in which there is no surface. Directions are sampled in proportion
    to the cosine, so that a sample is 1 or 0: whether the sky is seen. An open plane has the value
    1, the inside of a closed box 0. In time, light starts on a plane beyond the scene, one for each
    direction: see `tofrender.paths.endpoints`.

    Parameters: those of `FirstSurface`.

    Example:
        >>> integrator = mi.load_dict({"type": "ao"})
        >>> integrator.max_bounces
        1
    """

    def endpoint(self, scene: mi.Scene, sensor: mi.Sensor | None) -> OpenSky:
        """Return the sky."""
        return OpenSky(scene, sensor, self.hide_emitters)
