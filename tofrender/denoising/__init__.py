"""Removal of noise from transient films, by two halves of their samples and first-hit features."""

from ..runtime.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
