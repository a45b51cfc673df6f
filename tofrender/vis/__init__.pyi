from .animation import (
    plot_pixel_transient as plot_pixel_transient,
)
from .animation import (
    visualize_transient as visualize_transient,
)
from .flight import light_in_flight as light_in_flight
from .panels import phasor_panel as phasor_panel
from .plans import plan_figure as plan_figure
from .reconstructions import reconstruction_figure as reconstruction_figure
from .summary import summary_figure as summary_figure
from .tone import (
    auto_exposure as auto_exposure,
)
from .tone import (
    tonemap as tonemap,
)
from .transient import Transient as Transient
from .transient import luminance as luminance
from .unwarp import unwarp_camera as unwarp_camera
from .warps import verdict_figure as verdict_figure
from .warps import warp_figure as warp_figure
