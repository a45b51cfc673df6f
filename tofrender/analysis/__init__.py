"""Phasors and depth, sensor models and statistics, computed from rendered light."""

from ..runtime.lazy import on_demand

__getattr__, __dir__, __all__ = on_demand(__name__, __file__)  # pyright: ignore[reportUnsupportedDunderAll]
