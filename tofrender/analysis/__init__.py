"""Phasors and depth, sensor models and statistics, computed from rendered light."""

from ..runtime.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
