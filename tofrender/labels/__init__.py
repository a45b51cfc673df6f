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
    CAPTURES,
    COUNTS,
    DOPPLER,
    FILM,
    FRAMES,
    GATES,
    IMAGE,
    LIGHT,
    PATTERN,
    PHASORS,
    PIXELS,
    PYRAMID,
    RANGE_RATES,
    RATES,
    RECORDS,
    SENSED,
    SPECTRA,
    STREAK,
    TAPS,
    TRANSIENT,
    VOLUME,
    WAVEFORMS,
    Kind,
)
from .reading import (
    bins_of,
    by_pixel,
    intensity,
    pixel_steps,
    read,
    read_array,
    require_consecutive,
    require_whole_stokes,
)

__all__ = [
    "CAPTURE",
    "CAPTURES",
    "CHANNELS",
    "COUNTS",
    "DOPPLER",
    "FILM",
    "FRAMES",
    "GATES",
    "IMAGE",
    "LIGHT",
    "PATTERN",
    "PHASORS",
    "PIXELS",
    "PYRAMID",
    "RANGE_RATES",
    "RATES",
    "RECORDS",
    "SENSED",
    "SPECTRA",
    "STOKES",
    "STREAK",
    "TAPS",
    "TRANSIENT",
    "VOLUME",
    "WAVEFORMS",
    "Bins",
    "Kind",
    "bins_of",
    "by_pixel",
    "energy_outside_window",
    "intensity",
    "pixel_steps",
    "read",
    "read_array",
    "require_consecutive",
    "require_whole_stokes",
    "with_energy",
]
