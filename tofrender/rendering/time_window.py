"""Time window of a render: make, choose, enlarge and check the window."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ..films.image import require_resolved, time_bins
from ..films.windowed import transient_film
from .arrivals import PATHS, Arrivals
from .dataset import LOST_ENERGY
from .settings import is_auto, start_and_width

if TYPE_CHECKING:
    import mitsuba as mi

    from ..films.transient import TransientHDRFilm
    from ..signals.pulses import Pulse

# Number of contributions for one check of an automatic window. Dark scenes may give fewer
CHECK_HITS = 1 << 12

# Largest number of test renders in one check of an automatic window
CHECK_RENDERS = 16

# Largest number of checks. Each check can enlarge the window
CHECKS = 4

# Fraction of the energy outside the window above which the window is enlarged
UNCONFIRMED = LOST_ENERGY / 2

# Number of contributions near an empty window above which the window is not empty by chance
MANY_HITS = 250

# Seed of the first test render. With one seed, all renders of a scene have the same window, so
# that `merge` can join them
ARRIVALS_SEED = 0

# Default number of bins of a steady scene
BINS = 300

# Setting that finds a better window, for warnings
WINDOW_OPTION = "`window='auto'`"

# Width of the window divided by the standard deviation of an automatic pulse
PULSES = 128


def windowed_film(
    film: mi.Film,
    window: object = None,
    bins: int | None = None,
    start_opl: float | None = None,
    bin_width: float | None = None,
) -> TransientHDRFilm:
    """Return an empty film with the pixels of `film` and the given time axis.

    Args:
        film: Film of the scene. It also defines the values of the time axis that are missing.
        window: Start and stop [m], "auto" for a preliminary window, or None.
        bins: Number of bins.
        start_opl: Start of the first bin [m].
        bin_width: Width of a bin [m].
    """
    # Replace the values of the film. A given window replaces start and width below
    own = time_bins(film) or (None, None, None)
    given = (bins, start_opl, bin_width) if window is None else (bins, 0.0, 1.0)
    axis: Any = [old if new is None else new for old, new in zip(own, given, strict=True)]
    if None in axis:
        raise ValueError(
            f"film = {film.class_name()}: has no time bins; must be transient_hdr_film, or give "
            "`bins` and `window`"
        )

    # Make the film
    if window is not None and not is_auto(window):
        axis[1:] = start_and_width(window, axis[0])
    windowed = transient_film(film, *axis)
    require_resolved(windowed)
    return windowed


def check_window(film: TransientHDRFilm, arrivals: Arrivals, profile: Pulse | None) -> None:
    """Raise a ValueError if no light reaches the window, and warn if light may be rare there.

    An empty window is an error in two cases: many contributions arrive nearby, or no contribution
    arrives nearby. Nearby means within a quarter of the path length. With few contributions nearby,
    the window may be empty by chance, so the function only warns.
    """
    # Did the test render find any light?
    start = film.start_opl
    stop = film.end_opl()
    if not arrivals.any:
        warnings.warn(
            f"no light found on {PATHS} test paths: the picture may be black", stacklevel=5
        )
        return

    # Is the light within the window?
    if arrivals.between(start, stop, profile):
        return

    # Is the window empty by chance?
    first, last = arrivals.window(profile, 1.0)
    if not 0 < arrivals.between(start / 1.25, stop * 1.25, profile) < MANY_HITS:
        raise ValueError(
            f"window = {start:g} m to {stop:g} m: no light arrives in it; "
            f"must overlap {first:g} m to {last:g} m"
        )
    warnings.warn(
        f"none of {PATHS} test paths arrives between {start:g} m and {stop:g} m: the bins may stay "
        f"empty; light was found from {first:g} m to {last:g} m",
        stacklevel=5,
    )


def enlarged(
    arrivals: Arrivals, profile: Pulse | None, look: Callable[[int], Arrivals]
) -> Arrivals:
    """Add the light of further test renders until they confirm the window of the arrivals.

    One test render can miss light of rare paths. If much of the energy of further test renders is
    outside the window, their light is added. This enlarges the window.

    Args:
        arrivals: Light that the first test render found.
        profile: Temporal profile of a contribution on the film.
        look: Function that makes the test render of a seed.
    """
    seed = ARRIVALS_SEED
    for _ in range(CHECKS):
        # Look for light until there is enough to check the window with
        check = look(seed := seed + 1)
        for _ in range(CHECK_RENDERS - 1):
            if check.hits.sum() >= CHECK_HITS:
                break
            check = check.joined(look(seed := seed + 1))

        # Is the light within the window?
        start, stop = arrivals.window(profile)
        if check.outside(start, stop, profile) <= UNCONFIRMED:
            break
        arrivals = arrivals.joined(check)
    return arrivals


def warn_of_losses(
    film: TransientHDRFilm,
    outside: float,
    arrivals: Arrivals | None = None,
    profile: Pulse | None = None,
    window_option: str = WINDOW_OPTION,
    automatic: bool = False,
    stacklevel: int = 4,
) -> None:
    """Warn if much energy is outside the window, and name a better window or a setting.

    Args:
        film: Film with the window.
        outside: Fraction of the energy outside the window.
        arrivals: Energy over path length, to find a better window.
        profile: Temporal profile of a contribution on the film.
        window_option: Setting that finds a better window.
        automatic: Whether this setting has chosen the window already.
        stacklevel: As for `warnings.warn`.
    """
    if outside <= LOST_ENERGY:
        return
    start = film.start_opl
    stop = film.end_opl()

    # Choose a remedy
    remedy = f"another one may hold it ({window_option})"
    if automatic:
        more = 0.5 * (stop - start)
        earlier = max(start - more, min(start, 0.0))
        remedy = f"set `window` to a wider one, for example {earlier:g} to {stop + more:g} m"
    elif arrivals is not None:
        first, last = arrivals.window(profile)
        remedy = f"{first:g} to {last:g} m would hold 99.9 % ({window_option})"
    warnings.warn(
        f"{100 * outside:.1f} % of the energy arrives outside the window {start:g} to {stop:g} m; "
        f"{remedy}",
        stacklevel=stacklevel,
    )


def pulse_width_for(film: TransientHDRFilm, pulse: Pulse | None) -> float | None:
    """Return the width of a pulse that smooths noise and still shows wavefronts.

    The width is the standard deviation [m]. It is a 128th of the window, rounded to two digits. One
    path then contributes to about five of 300 bins. The result is None if the light already has a
    `pulse`, or if the bins are wider than twice the width.
    """
    width = float(f"{(film.end_opl() - film.start_opl) / PULSES:.2g}")
    return None if pulse or width < film.bin_width_opl / 2 else width
