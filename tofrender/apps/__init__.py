"""What one looks at and touches: the explorer, the warp tester, pictures side by side."""

from ..runtime.lazy import on_demand

__getattr__, __dir__, __all__ = on_demand(__name__, __file__)  # pyright: ignore[reportUnsupportedDunderAll]
