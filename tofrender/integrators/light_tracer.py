"""Integrator plugin `transient_light_tracer`: light that finds the camera."""

from ..bidirectional.mis import BidirectionalMIS
from .bidirectional import BothEnds


class TransientLightTracer(BothEnds):
    """Light tracing into time bins (plugin `transient_light_tracer`).

    Paths start at the emitters, and each of their vertices is connected to the lens: light that
    arrives there lands in whatever pixel sees it, at its time. Good for caustics, which a path from
    the camera finds by chance or, with a point light, never; what the camera sees in mirrors and
    through glass is missing, since no connection passes those.

    Parameters: those of `BothEnds`; a sample per pixel is one path of light per pixel.

    Example:
        >>> import mitsuba as mi, tofrender
        >>> scene = mi.load_dict(tofrender.cornell_box(width=16, height=16))
        >>> tracer = mi.load_dict({"type": "transient_light_tracer", "max_depth": 4})
        >>> steady, transient = mi.render(scene, integrator=tracer, spp=4)
        >>> transient.shape
        (16, 16, 300, 3)
    """

    from_camera = False

    def mis_strategies(self) -> BidirectionalMIS:
        """Return the strategies with t = 1, each of which alone finds the paths of its length."""
        return BidirectionalMIS(exponent=0)
