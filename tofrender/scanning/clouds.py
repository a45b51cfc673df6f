"""Point clouds from the waveforms of a lidar."""

from typing import Any

import numpy as np
import xarray as xr

from ..runtime import checks
from ..sensors.estimators import echoes
from ..sensors.rates import generator
from ..sensors.spad import Spad
from ..signals.pulses import GaussianPulse


def point_cloud(
    waveforms: xr.Dataset,
    *,
    pulses: int = 1,
    detector: Any = None,
    response: Any = None,
    max_returns: int = 5,
    false_alarm: float = 1e-3,
    seed: int = 0,
) -> xr.Dataset:
    """Detect the echoes of each shot in noisy counts, and place them in space.

    Args:
        waveforms: The result of `lidar`.
        pulses: Pulses per shot, whose counts add up.
        detector: A `Spad`; None for one that counts all photons.
        response: Of pulse and detector, as for `echoes`; None for the pulse.
        max_returns: Echoes per shot, 1 to 15; the strongest are kept.
        false_alarm: Bound of the probability of a false echo in a shot, see `echoes`.
        seed: Seed of the noise.

    Returns:
        A Dataset along "point": `x`, `y`, `z`, `range` [m], `intensity` [counts], `width` [m],
        `return_number` from 1 by distance, `number_of_returns`, `time` [s], the index `shot`, and
        the shot's `true_range` [m].

    Raises:
        ValueError: Other waveforms, or a value out of range; one line.

    Example:
        >>> from tofrender.scanning import lidar, scan_pattern
        >>> shots = lidar("cornell_box", scan_pattern(shots=(4, 4), fov_deg=(20, 20)), spp=4)
        >>> first = point_cloud(shots).query(point="return_number == 1")
        >>> bool(abs(first["range"] - first["true_range"]).max() < 0.1)
        True
    """
    _require(waveforms)
    checks.instance("detector", detector, Spad | None, "a Spad or None")
    for name in ("macro_pixel", "crosstalk_probability") if detector else ():
        value, default = getattr(detector, name), getattr(Spad, name)
        checks.require(f"detector: {name}", value, value == default, f"{default}, of single shots")
    most, random = checks.integer("max_returns", max_returns, 1, 15), generator(seed)
    pulses = checks.integer("pulses", pulses, 1, (1 << 31) - 1)
    film = waveforms[["rate", "background"]].rename(shot="y").expand_dims(x=1)
    film = film.transpose("y", "x", "bin")
    if detector is None:
        counts = film.assign(counts=film["rate"].copy(data=random.poisson(film["rate"] * pulses)))
    else:
        counts = detector.histogram(film, pulses, seed)
    pulse = GaussianPulse(waveforms.attrs["pulse_width_opl"]) if response is None else response
    found = echoes(counts, pulse, false_alarm).to_dataframe()
    found = found[found.groupby("y")["intensity"].rank("first", ascending=False) <= most]
    numbers, shot = found.groupby("y")["number"], found["y"].to_numpy()
    columns = {"range": found["depth"], "intensity": found["intensity"], "width": found["width"]}
    columns["return_number"] = (numbers.cumcount() + 1).astype(np.uint8)
    columns["number_of_returns"] = numbers.transform("size").astype(np.uint8)
    return _points(waveforms, shot, columns).assign_attrs(pulses=pulses)


def true_points(waveforms: xr.Dataset) -> xr.Dataset:
    """Points of the first surfaces on the axes of those shots that meet one.

    Args:
        waveforms: The result of `lidar`.

    Returns:
        A Dataset along "point": `x`, `y`, `z`, `range`, `true_range` [m], `time` [s], `shot`.
    """
    _require(waveforms)
    shot = np.flatnonzero(np.isfinite(waveforms["true_range"]))
    return _points(waveforms, shot, {"range": waveforms["true_range"].values[shot]})


def _points(waveforms: xr.Dataset, shot: np.ndarray, columns: dict[str, Any]) -> xr.Dataset:
    """Place points at the column "range" of shots, and add columns of the shots."""
    arrays = {name: np.asarray(each) for name, each in columns.items()}
    ways = waveforms["direction"].transpose("shot", "axis").values
    origins = np.broadcast_to(waveforms["origin"].transpose(..., "axis").values, ways.shape)
    points = origins[shot] + ways[shot] * arrays["range"][:, None]
    arrays |= dict(zip("xyz", points.T, strict=True))
    arrays |= {name: waveforms[name].values[shot] for name in ("time", "true_range")}
    attrs = waveforms.attrs | {"quantity": "points", "units": "m"}
    return xr.Dataset({k: ("point", v) for k, v in {**arrays, "shot": shot}.items()}, attrs=attrs)


def _require(waveforms: Any) -> None:
    """Refuse all but Datasets of `lidar`."""
    whole = isinstance(waveforms, xr.Dataset) and {"rate", "direction", "origin"} <= set(waveforms)
    checks.require("waveforms", waveforms, whole, "a Dataset of lidar")
