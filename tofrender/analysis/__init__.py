"""Analysis of rendered light: phasors and depth, polarization, other bins and pixels."""

from ..runtime.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
