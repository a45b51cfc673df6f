"""Pictures of light in flight: tone mapping, animations, phasors, overlays and summaries.

Every function returns its figure or array. None shows anything by itself, and none uses pyplot,
so nothing has to be closed and notebooks, scripts and servers get the same picture. All are drawn
in one style, of which `figure_style` sets theme and width; `io.save_figure` writes them.
"""

from ..runtime.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
