"""Files: EXR stacks, NumPy archives, PNG frames and videos, each written whole or not at all."""

from ..runtime.lazy import on_demand

__getattr__, __dir__, __all__ = on_demand(__name__, __file__)  # pyright: ignore[reportUnsupportedDunderAll]
