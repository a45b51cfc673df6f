"""Pictures of light in flight: tone mapping, animations, phasors, overlays and summaries.

Every function returns its figure or array. The functions do not use pyplot and do not open windows.
Therefore figures need not be closed, and notebooks, scripts and servers get the same picture. All
figures have one style. `figure_style` sets its theme and width, and `io.save_figure` writes a
figure.
"""

from ..runtime.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
