"""Data sets for training: renders of many scenes, with depth, normals and all drawn values."""

from ..runtime.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
