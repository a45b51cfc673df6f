"""Fits of scenes to measured light, by gradients through arrival time."""

from ..runtime.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
