"""Pictures of light in flight: tone mapping, animations, phasors, overlays and summaries.

Every function returns its figure or array. None shows anything by itself, and none uses pyplot,
so nothing has to be closed and notebooks, scripts and servers get the same picture.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..lazy import names_of

if TYPE_CHECKING:
    from .animation import plot_pixel_transient, visualize_transient
    from .flight import light_in_flight
    from .phasors import phasor_panel
    from .plans import plan_figure
    from .reconstructions import reconstruction_figure
    from .summary import summary_figure
    from .tone import LUMINANCE, auto_exposure, check_exposure, luminance, tonemap
    from .transient import Transient
    from .unwarp import unwarp_camera
    from .warps import verdict_figure, warp_figure

__all__ = [
    "LUMINANCE",
    "Transient",
    "auto_exposure",
    "check_exposure",
    "light_in_flight",
    "luminance",
    "phasor_panel",
    "plan_figure",
    "plot_pixel_transient",
    "reconstruction_figure",
    "summary_figure",
    "tonemap",
    "unwarp_camera",
    "verdict_figure",
    "visualize_transient",
    "warp_figure",
]

__getattr__, __dir__ = names_of(
    __name__,
    {
        "animation": ("plot_pixel_transient", "visualize_transient"),
        "flight": ("light_in_flight",),
        "phasors": ("phasor_panel",),
        "plans": ("plan_figure",),
        "reconstructions": ("reconstruction_figure",),
        "summary": ("summary_figure",),
        "tone": ("LUMINANCE", "auto_exposure", "check_exposure", "luminance", "tonemap"),
        "transient": ("Transient",),
        "unwarp": ("unwarp_camera",),
        "warps": ("verdict_figure", "warp_figure"),
    },
)
