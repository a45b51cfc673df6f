"""Files: EXR stacks, NumPy archives, PNG frames and videos, each written whole or not at all."""

from ..runtime.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
