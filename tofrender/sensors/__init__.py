"""Sensor models on rendered light: photons, SPAD, iToF, gated and streak cameras, estimators."""

from ..runtime.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
