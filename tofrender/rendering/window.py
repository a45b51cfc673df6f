"""The window of a render's time bins: what is asked for, and whether light is in it."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

from ..films.image import time_bins, transient_film
from ..runtime import checks
from .arrivals import PATHS, Arrivals
from .dataset import LOST_ENERGY

if TYPE_CHECKING:
    from ..signals.pulses import Pulse

MANY_HITS = 250
"""Contributions near an empty window from which on chance cannot explain that it is empty."""


def windowed_film(film: Any, window: Any, temporal_bins: int | None) -> Any:
    """An empty film of the same pixels as `film`, with the window that is asked for."""
    own = time_bins(film)
    if own is None and (window is None or temporal_bins is None):
        raise ValueError(
            f"film = {film.class_name()}: has no time bins; must be transient_hdr_film, or give "
            "both window and temporal_bins"
        )
    bins = own[0] if own and temporal_bins is None else temporal_bins
    bins = checks.integer("temporal_bins", bins, 1, checks.MAX_BINS)
    if is_auto(window):
        start, width = 0.0, 1.0  # Until the light was looked at
    elif window is not None:
        start, width = start_and_width(window, bins)
    else:
        assert own is not None
        _, start, width = own
    return transient_film(film, bins, start, width)


def start_and_width(window: Any, bins: int) -> tuple[float, float]:
    """Start and bin width of a window given as (start, stop)."""
    try:
        start, stop = window
    except (TypeError, ValueError):
        raise ValueError(
            f"window = {checks.shown(window)}: must be 'auto' or (start, stop) in metres"
        ) from None
    start, stop = checks.metres("window[0]", start), checks.metres("window[1]", stop)
    if not start < stop < start + checks.MAX_OPL:
        raise ValueError(
            f"window = {checks.shown(window)}: must end after it starts, and not at infinity"
        )
    return start, (stop - start) / bins


def is_auto(window: Any) -> bool:
    """Whether the window is to be found."""
    return isinstance(window, str) and window == "auto"


def check_window(film: Any, arrivals: Arrivals, profile: Pulse | None) -> None:
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
            f"start_opl, end = {start:g} m, {stop:g} m: no light arrives in this window; "
            f"it must overlap {first:g} m to {last:g} m"
        )
    warnings.warn(
        f"none of {PATHS} test paths arrives between {start:g} m and {stop:g} m: the bins may stay "
        f"empty; light was found from {first:g} m to {last:g} m",
        stacklevel=4,
    )


def warn_of_losses(
    film: Any, arrivals: Arrivals, profile: Pulse | None, outside: float, stacklevel: int = 4
) -> None:
    """Say when light is missing, and which window would hold it."""
    if outside > LOST_ENERGY:
        first, last = arrivals.window(profile)
        warnings.warn(
            f"{100 * outside:.1f} % of the energy arrives outside the window {film.start_opl:g} to "
            f"{film.end_opl():g} m; {first:g} to {last:g} m would hold 99.9 % (window='auto')",
            stacklevel=stacklevel,
        )
