"""Non-line-of-sight imaging: captures of a relay wall, and reconstructions of hidden scenes."""

from ..runtime.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
