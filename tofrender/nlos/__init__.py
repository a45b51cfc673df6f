"""Non-line-of-sight imaging: captures of a relay wall, and reconstructions of hidden scenes."""

from ..runtime.lazy import on_demand

__getattr__, __dir__, __all__ = on_demand(__name__, __file__)  # pyright: ignore[reportUnsupportedDunderAll]
