"""Point clouds from the waveforms of a lidar."""

from dataclasses import replace
from typing import Annotated, Any

import numpy as np
import pandas as pd
import xarray as xr

from ..labels import WAVEFORMS, read
from ..runtime import checks
from ..sensors.echo_detection import choices, find_echoes
from ..sensors.photon_histograms import Returns
from ..sensors.photon_rates import generator
from ..sensors.response import blurred
from ..sensors.spad import Spad
from ..signals.pulses import GaussianPulse

# Number of bins of all shots that are processed together
BLOCK = 1 << 20


def point_cloud(
    waveforms: Annotated[xr.Dataset, WAVEFORMS],
    *,
    pulses: int = 1,
    detector: Any = None,
    response: Any = None,
    max_returns: int = 5,
    false_alarm: float = 1e-3,
    seed: int = 0,
) -> xr.Dataset:
    """Detect the echoes of each shot in noisy counts, and compute their positions.

    Args:
        waveforms: The result of `lidar`.
        pulses: Number of pulses per shot. Their counts are summed.
        detector: A `Spad`, or None for a detector that counts all photons.
        response: Response of pulse and detector, as for `echoes`. By default the pulse of the
            waveforms, convolved with the jitter of the detector.
        max_returns: Largest number of echoes per shot, 1 to 15. The strongest echoes are kept.
        false_alarm: Probability of a false echo in a shot, see `echoes`. The background of the
            waveforms is used. If the detector has afterpulses or hot pixels, the background is
            estimated from the counts instead. With few pulses, dead time makes false echoes rarer
            than `false_alarm`.
        seed: Seed of the noise.

    Returns:
        A Dataset along "point": `x`, `y`, `z`, `range` [m], `intensity` [counts], `width` [m],
        `return_number` from 1 by distance, `number_of_returns`, `time` [s], the index `shot` (the
        label of the shot if the waveforms have this coordinate), and `true_range` [m] of the shot.

    Raises:
        ValueError: The waveforms are invalid, bins are missing, or a value is out of range.

    Example:
        >>> from tofrender.scanning import lidar, scan_pattern
        >>> shots = lidar("cornell_box", scan_pattern(shots=(4, 4), fov_deg=(20, 20)), spp=4)
        >>> first = point_cloud(shots).query(point="return_number == 1")
        >>> bool(abs(first["range"] - first["true_range"]).max() < 0.1)
        True
    """
    # Check the arguments
    waveforms = _read(waveforms)
    checks.instance("detector", detector, Spad | None, "a Spad or None")
    for name in ("macro_pixel", "crosstalk_probability") if detector else ():
        value = getattr(detector, name)
        default = getattr(Spad, name)
        checks.require(f"detector: {name}", value, value == default, f"{default}, of single shots")
    most = checks.integer("max_returns", max_returns, 1, 15)
    false_alarm = checks.number("false_alarm", false_alarm, positive=True, high=0.5)
    pulses = checks.integer("pulses", pulses, 1, (1 << 31) - 1)

    # Describe the shots as pixels of a film, and find the response
    film = waveforms[["rate", "background"]].drop_vars("shot", errors="ignore")
    film = film.rename(shot="y").expand_dims(x=1).transpose("y", "x", "bin")
    if response is None:
        pulse = checks.width(
            "waveforms: attribute pulse_width_opl", waveforms.attrs.get("pulse_width_opl")
        )
        jitter = None if detector is None else detector.jitter
        response = GaussianPulse(pulse) if jitter is None else blurred(jitter, pulse)

    # Count photons and find echoes in blocks of shots, so that memory does not grow
    random = generator(seed)
    draws = choices(seed, film.sizes["y"])
    background = _background(film, pulses, detector)
    measured = None if detector is None else detector.histogram(film, pulses, seed)
    step = max(1, BLOCK // film.sizes["bin"])
    tables = []
    for start in range(0, film.sizes["y"], step):
        rows = slice(start, start + step)
        block = film.isel(y=rows)
        if measured is None:
            drawn = random.poisson(block["rate"] * pulses)
            counts = block.assign(counts=block["rate"].copy(data=drawn))
        else:
            counts = measured.isel(y=rows)
        data = Returns(counts, response, None, None)
        known = None if background is None else background[rows]
        table = find_echoes(data, false_alarm, known, draws[rows])
        tables.append(table.assign(y=table["y"] + start))
    found = pd.concat(tables, ignore_index=True)

    # Keep the strongest echoes of each shot
    found = found[found.groupby("y")["intensity"].rank("first", ascending=False) <= most]
    numbers = found.groupby("y")["number"]
    shot = found["y"].to_numpy()

    # Describe the points
    columns = {"range": found["depth"], "intensity": found["intensity"], "width": found["width"]}
    columns["return_number"] = (numbers.cumcount() + 1).astype(np.uint8)
    columns["number_of_returns"] = numbers.transform("size").astype(np.uint8)
    return _points(waveforms, shot, columns).assign_attrs(pulses=pulses)


def _background(film: xr.Dataset, pulses: int, detector: Spad | None) -> np.ndarray | None:
    """Return the expected background counts (y, x) per bin of shots, None if it is unknown.

    With dead time, the background depends on the bin. Then the largest value is used, so that false
    alarms are at most as frequent as requested.
    """
    per_pulse = film["background"].values
    if detector is None:
        return per_pulse * pulses
    if detector.interactions() or detector.hot_fraction:
        return None

    # Most shots have the same background
    values, which = np.unique(per_pulse, return_inverse=True)
    dark = film.isel(y=np.zeros(values.size, int)).assign(background=(("y", "x"), values[:, None]))
    dark = dark.assign(rate=(dark["background"] + 0 * dark["rate"]).transpose("y", "x", "bin"))
    counts = detector.expected(dark, pulses)["counts"].max("bin").values
    return counts.ravel()[which].reshape(per_pulse.shape)


def true_points(waveforms: Annotated[xr.Dataset, WAVEFORMS]) -> xr.Dataset:
    """Return the points where the axes of shots hit the first surface.

    Args:
        waveforms: The result of `lidar`.

    Returns:
        A Dataset along "point": `x`, `y`, `z`, `range`, `true_range` [m], `time` [s], `shot`.
    """
    waveforms = _read(waveforms)
    distances = waveforms["true_range"].values
    shot = np.flatnonzero(np.isfinite(distances))
    return _points(waveforms, shot, {"range": distances[shot]})


def _points(waveforms: xr.Dataset, shot: np.ndarray, columns: dict[str, Any]) -> xr.Dataset:
    """Place points at the column "range" of shots, and add columns of the shots."""
    # Positions along the direction of the shots
    arrays = {name: np.asarray(each) for name, each in columns.items()}
    ways = waveforms["direction"].values
    origins = np.broadcast_to(waveforms["origin"].values, ways.shape)
    points = origins[shot] + ways[shot] * arrays["range"][:, None]
    arrays |= dict(zip("xyz", points.T, strict=True))

    # Columns of the shots
    arrays |= {name: waveforms[name].values[shot] for name in ("time", "true_range")}
    arrays["shot"] = waveforms["shot"].values[shot]
    attrs = waveforms.attrs | {"quantity": "points", "units": "m"}
    return xr.Dataset({name: ("point", each) for name, each in arrays.items()}, attrs=attrs)


def _read(waveforms: object) -> xr.Dataset:
    """Read a result of `lidar`. The origin of a lidar that moves differs between shots."""
    kind = WAVEFORMS
    origin = waveforms.get("origin") if isinstance(waveforms, xr.Dataset) else None
    if origin is not None and "shot" in origin.dims:
        kind = replace(kind, variables={**kind.variables, "origin": ("shot", "axis")})
    return read(waveforms, kind, "waveforms")
