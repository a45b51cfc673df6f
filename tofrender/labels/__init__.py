"""Labels of Datasets: one reader for what functions take, and one writer for what they return.

Users slice, reorder, join and reduce Datasets before they pass them on. Therefore no function reads
axes by position, or the time axis from attributes. `read` finds axes, channels and Stokes
components by their labels, brings them to one order, and checks that the result is defined. It
refuses everything else in one line.
"""

from .axes import CHANNELS, STOKES, Bins
from .energy import energy_outside_window, with_energy
from .kinds import (
    CAPTURE,
    COUNTS,
    FILM,
    FRAMES,
    GATES,
    IMAGE,
    LIGHT,
    PHASORS,
    PIXELS,
    PYRAMID,
    RATES,
    SENSED,
    STREAK,
    TAPS,
    TRANSIENT,
    WAVEFORMS,
    Kind,
)
from .reading import (
    bins_of,
    intensity,
    on_pixels,
    pixel_steps,
    read,
    read_array,
    require_consecutive,
    require_whole_stokes,
)

__all__ = [
    "CAPTURE",
    "CHANNELS",
    "COUNTS",
    "FILM",
    "FRAMES",
    "GATES",
    "IMAGE",
    "LIGHT",
    "PHASORS",
    "PIXELS",
    "PYRAMID",
    "RATES",
    "SENSED",
    "STOKES",
    "STREAK",
    "TAPS",
    "TRANSIENT",
    "WAVEFORMS",
    "Bins",
    "Kind",
    "bins_of",
    "energy_outside_window",
    "intensity",
    "on_pixels",
    "pixel_steps",
    "read",
    "read_array",
    "require_consecutive",
    "require_whole_stokes",
    "with_energy",
]
