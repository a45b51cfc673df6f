"""What one looks at and touches: the explorer of what was rendered, captured or reconstructed."""

from ..runtime.lazy import on_demand

__getattr__, __dir__, __all__ = on_demand(__name__, __file__)  # pyright: ignore[reportUnsupportedDunderAll]
