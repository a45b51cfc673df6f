"""Denoising of transient films, from two halves of their samples and features of first hits."""

from ..runtime.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
