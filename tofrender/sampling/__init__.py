"""Random numbers, point sets, warps of the unit square, and the tests of all of them."""

from ..runtime.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
