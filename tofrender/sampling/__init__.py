"""Random numbers, point sets, warps of the unit square, and statistical tests of samplers."""

from ..runtime.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
