"""Scanning lidar: patterns of shots, their rendered waveforms, and point clouds."""

from ..runtime.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
