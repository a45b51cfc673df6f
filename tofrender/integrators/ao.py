"""Integrator plugin `ao`: ambient occlusion."""

from __future__ import annotations

import mitsuba as mi

from .first_surface import FirstSurface
from .outside_lights import OpenSky


class AmbientOcclusion(FirstSurface):
    """Ambient occlusion: white diffuse surfaces under a white sky, one bounce (plugin `ao`).

        L(x) = integral over the hemisphere of V(x, w) cos / pi dw

    where V is 1 if no surface blocks the direction w, and 0 otherwise. Directions are sampled in
    proportion to the cosine. The value of a sample is therefore 1 if the sky is visible, and 0
    otherwise. An open plane has the value 1, and the inside of a closed box has the value 0. On
    films with time bins, the light of each direction starts on a plane outside of the scene, see
    `tofrender.paths.wavefronts`.

    The parameters are the parameters of `FirstSurface`.

    Example:
        >>> integrator = mi.load_dict({"type": "ao"})
        >>> integrator.max_bounces
        1
    """

    def endpoint(self, scene: mi.Scene, sensor: mi.Sensor | None) -> OpenSky:
        """Return the sky."""
        return OpenSky(scene, sensor, self.hide_emitters)
