from ..runtime.canvas import figure_style as figure_style
from ..sampling.verdicts import verdict_figure as verdict_figure
from .animation import (
    plot_pixel_transient as plot_pixel_transient,
    visualize_transient as visualize_transient,
)
from .flight_figures import gate_figure as gate_figure, light_in_flight as light_in_flight
from .panels import phasor_panel as phasor_panel
from .plans import plan_figure as plan_figure
from .polarization_figures import (
    polarization_figure as polarization_figure,
    polarization_picture as polarization_picture,
)
from .pyramid import pyramid_figure as pyramid_figure
from .rate_figures import range_velocity_map as range_velocity_map, velocity_map as velocity_map
from .reconstructions import (
    reconstruction_errors_figure as reconstruction_errors_figure,
    reconstruction_figure as reconstruction_figure,
)
from .sensing import measurement_figure as measurement_figure
from .summary import summary_figure as summary_figure
from .tone import (
    auto_exposure as auto_exposure,
    growing_exposure as growing_exposure,
    lit_bins as lit_bins,
    tonemap as tonemap,
)
from .transient_figures import Transient as Transient, luminance as luminance
from .unwarp import unwarp_camera as unwarp_camera
from .warp_figures import warp_figure as warp_figure
