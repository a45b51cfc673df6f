"""The window of a render's time bins, and whether light is in it."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

from ..films.image import require_resolved, time_bins, transient_film
from .arrivals import PATHS, Arrivals
from .dataset import LOST_ENERGY
from .settings import is_auto, start_and_width

if TYPE_CHECKING:
    import mitsuba as mi

    from ..films.transient import TransientHDRFilm
    from ..signals.pulses import Pulse
    from .job import Job

MANY_HITS = 250
"""Contributions near an empty window from which on chance cannot explain that it is empty."""

BINS = 300  # Bins of a scene that has none
WINDOW_OPTION = "`window='auto'`"  # Setting that finds a better window, for warnings
PULSES = 128  # Standard deviations of the pulse that is chosen for a window, in that window


def windowed_film(
    film: mi.Film,
    window: object = None,
    bins: int | None = None,
    start_opl: float | None = None,
    bin_width: float | None = None,
) -> TransientHDRFilm:
    """An empty film of the same pixels as `film`, with the time axis of some `RenderSettings`."""
    own = time_bins(film) or (None, None, None)
    given = (bins, start_opl, bin_width) if window is None else (bins, 0.0, 1.0)
    axis: Any = [old if new is None else new for old, new in zip(own, given, strict=True)]
    if None in axis:
        raise ValueError(
            f"film = {film.class_name()}: has no time bins; must be transient_hdr_film, or give "
            "`bins` and `window`"
        )
    if window is not None and not is_auto(window):
        axis[1:] = start_and_width(window, axis[0])
    windowed = transient_film(film, *axis)
    require_resolved(windowed)
    return windowed


def check_window(film: TransientHDRFilm, arrivals: Arrivals, profile: Pulse | None) -> None:
    """Refuse a window that no light reaches, and doubt one that none of the test paths reached.

    No light reaches a window where none was found while much was nearby, within a quarter of the
    path length, or where there was none nearby either. In between, light may be too rare.
    """
    start, stop = film.start_opl, film.end_opl()
    if not arrivals.any:
        warnings.warn(
            f"no light found on {PATHS} test paths: the picture may be black", stacklevel=4
        )
        return
    if arrivals.between(start, stop, profile):
        return
    first, last = arrivals.window(profile, 1.0)
    if not 0 < arrivals.between(start / 1.25, stop * 1.25, profile) < MANY_HITS:
        raise ValueError(
            f"window = {start:g} m to {stop:g} m: no light arrives in it; "
            f"must overlap {first:g} m to {last:g} m"
        )
    warnings.warn(
        f"none of {PATHS} test paths arrives between {start:g} m and {stop:g} m: the bins may stay "
        f"empty; light was found from {first:g} m to {last:g} m",
        stacklevel=4,
    )


def warn_of_losses(
    film: TransientHDRFilm,
    outside: float,
    arrivals: Arrivals | None = None,
    profile: Pulse | None = None,
    window_option: str = WINDOW_OPTION,
    stacklevel: int = 4,
) -> None:
    """Say when light is missing, which window would hold it if that is known, and what says so."""
    if outside > LOST_ENERGY:
        better = "another one may hold it"
        if arrivals is not None:
            first, last = arrivals.window(profile)
            better = f"{first:g} to {last:g} m would hold 99.9 %"
        warnings.warn(
            f"{100 * outside:.1f} % of the energy arrives outside the window {film.start_opl:g} to "
            f"{film.end_opl():g} m; {better} ({window_option})",
            stacklevel=stacklevel,
        )


def pulse_width_for(job: Job) -> float | None:
    """A pulse that makes a film of few paths smooth and still shows wavefronts.

    Its standard deviation [m] is a 128th of the window, rounded to two digits; a path then lights
    about five of 300 bins. None where the light has a pulse already, or bins are as wide as that.
    """
    film = job.film
    width = float(f"{(film.end_opl() - film.start_opl) / PULSES:.2g}")
    return None if job.integrator.pulse or width < film.bin_width_opl / 2 else width
