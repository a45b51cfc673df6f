"""The window of a render's time bins, and whether light is in it."""

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

CHECK_HITS = 1 << 12
"""Contributions that check an automatic window, fewer if the scene has so little light."""

CHECK_RENDERS = 16  # Most test renders in one check of an automatic window
CHECKS = 4  # Most times that an automatic window is checked and enlarged
UNCONFIRMED = LOST_ENERGY / 2  # Fraction of lost energy above which a window is enlarged

MANY_HITS = 250
"""Contributions near an empty window from which on chance cannot explain that it is empty."""

ARRIVALS_SEED = 0
"""Seed with which light is looked for: renders of all seeds have one window, and can be joined."""

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
            f"no light found on {PATHS} test paths: the picture may be black", stacklevel=5
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
        stacklevel=5,
    )


def enlarged(
    arrivals: Arrivals, profile: Pulse | None, look: Callable[[int], Arrivals]
) -> Arrivals:
    """Add light of further test renders until they confirm the window of the arrivals.

    One test render can miss light that few paths bring. While much of the energy of other test
    renders is outside the window, their light is added, which enlarges the window.

    Args:
        arrivals: Light that the first test render found.
        profile: Pulse that the film sees light with.
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
    """Warn if light is missing, and name a better window or the setting that finds one.

    Set `automatic` if that setting has found the window.
    """
    if outside <= LOST_ENERGY:
        return
    start, stop = film.start_opl, film.end_opl()
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
    """Return the width of a pulse that makes few paths smooth and still shows wavefronts.

    The width is the standard deviation [m], a 128th of the window, rounded to two digits. A path
    then lights about five of 300 bins. The result is None if the light already has a `pulse`, or if
    the bins are wider than twice that width.
    """
    width = float(f"{(film.end_opl() - film.start_opl) / PULSES:.2g}")
    return None if pulse or width < film.bin_width_opl / 2 else width
