"""Moving scenes: Doppler time of flight, FMCW lidar, and frames of an animation."""

from ..runtime.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
