"""Integrator plugin `transient_light_tracer`: paths from emitters to the camera."""

from ..bidirectional.mis import BidirectionalMIS
from .bidirectional import BothEnds


class TransientLightTracer(BothEnds):
    """Light tracing into time bins (plugin `transient_light_tracer`).

    Paths start at the emitters, and each vertex of a path is connected to the lens. The light is
    added to the pixel that sees the vertex, at the time of its arrival. Light tracing finds
    caustics well. Paths from the camera find caustics only by chance, and never if the emitter is a
    point. Light that the camera sees in mirrors or through glass is missing, because connections do
    not pass mirrors and glass.

    The parameters are the parameters of `BothEnds`. The number of light paths is the number of
    pixels times the samples per pixel.

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
        """Return the strategies with t = 1, with the MIS weight 1."""
        return BidirectionalMIS(exponent=0)
