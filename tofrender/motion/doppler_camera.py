"""Doppler time of flight: modulated light and a sensor that is modulated at another frequency.

Light of the path length L(t) = L + V t, sent with the modulation frequency f_g, is multiplied on
the sensor by a modulation of f_g + n / T over the exposure T. Of their product, the low frequencies
stay. Path by path the sensor adds, for harmonic k of a modulation with the coefficients c_k,

    c_k (1/T) ∫ A(t) exp(i k (2π n t / T + ω L(t) / c)) dt,        ω = 2π f_g.

With n = 0 (homodyne) that is the phasor of the depth; with n = 1, 2, ... (heterodyne) light of
constant A and L is exactly 0, and what remains tells of the velocity: for constant A, heterodyne
over homodyne is x / (nπ + x) with x = ω V T / (2c) (F. Heide et al., SIGGRAPH 2015).

A change of A within the exposure is as large as that. The scene is therefore traced in two poses,
at T/4 and 3T/4, by paths of equal random numbers, and A is linear in between. Within either pose
the integral over time is analytic, with the rate V of each path, so that no lengths are subtracted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from os import PathLike
from typing import Annotated, Any, Unpack

import drjit as dr
import mitsuba as mi
import numpy as np
import xarray as xr

from ..films.image import pixels_of
from ..films.phasor_sum import Factor
from ..films.rates import DopplerRecording
from ..integrators.running import render_all
from ..labels import DOPPLER, read
from ..rendering.dataset import pixels_and_channels
from ..rendering.labels import labelled
from ..runtime import checks, plugins
from ..scenes.motion import posed
from ..signals.units import SPEED_OF_LIGHT, check_frequency
from .choices import MAX_CYCLES, WAVEFORMS
from .opening import MovingSettings, open_moving, separated

HARMONICS = 4  # Odd harmonics of waveforms other than the sine
POSES = (-0.25, 0.25)  # Times of the poses, from the middle of the exposure, over the exposure
PARAMETERS = ("waveform", "cycles", "frequency_hz", "exposure_s")  # Attributes of a measurement
SMALL = 0.05  # Phase below which the integrals are series [rad]


def doppler(
    scene: mi.Scene | Mapping[str, object] | str | PathLike[str],
    *,
    frequency_hz: float = 30e6,
    exposure_s: float = 1.5e-3,
    cycles: int = 1,
    waveform: str = "sine",
    **settings: Unpack[MovingSettings],
) -> xr.Dataset:
    """Render what a Doppler time-of-flight camera measures: homodyne and heterodyne.

    Args:
        scene: As for `render`; its parts move as the scene says, or `moving`.
        frequency_hz: Frequency of the light's modulation [Hz].
        exposure_s: Exposure [s], from the time 0 on.
        cycles: Number n of cycles by which light and sensor differ in an exposure, 1 to 1000.
        waveform: Correlation of light and sensor over their phase, of amplitude 1: "sine";
            "triangle" (both rectangles) or "rectangle" (pulses and a rectangle), of harmonics 1, 3,
            5 and 7.
        **settings: `spp` (of each pose), `seed`, `size`, `max_depth`, `integrator`, `sensor`,
            `define`, `checkpoint`, `progress`, as for `render`; integrators are `transient_path`,
            `transient_volpath`, `transient_light_tracer` and `transient_bdpt`, without a pulse.

    Returns:
        A Dataset with `homodyne` and `heterodyne (y, x, part, channel)`, the means over the
        exposure of light times sensor, of whose two phases "Q" lags by 90 degrees, and `steady
        (y, x, channel)` [W m^-2 sr^-1].

    Raises:
        ValueError: An argument or the scene is wrong.
        KeyboardInterrupt: The render was stopped; one line.

    Example:
        >>> import tofrender
        >>> scene = tofrender.load_scene("cornell_box", width=8, height=8, optimize=False)
        >>> scene = tofrender.moving(scene, {"small-box": tofrender.Motion(velocity=(0, 0, 10))})
        >>> measured = doppler(scene, spp=4, progress=False)
        >>> dict(measured["heterodyne"].sizes)
        {'y': 8, 'x': 8, 'part': 2, 'channel': 3}
    """
    frequency = check_frequency("frequency_hz", frequency_hz)
    exposure = checks.number("exposure_s", exposure_s, unit="seconds", positive=True)
    cycles = checks.integer("cycles", cycles, 1, MAX_CYCLES)
    weights = _harmonics(checks.one_of("waveform", waveform, WAVEFORMS))
    one_bin = {"bins": 1, "start_opl": 0.0, "bin_width": 1.0}  # For films without time bins
    wanted, checkpoint, progress = separated(scene, settings, **one_bin)
    loaded, camera, tracer, spp = open_moving(wanted)
    pictures, sums = [], []
    for number, pose in enumerate(POSES):
        with posed(loaded, (0.5 + pose) * exposure):
            film = _film(camera, [k * frequency for k in weights] * 2)
            factor = _factor(frequency, exposure, cycles, list(weights), pose)
            record = DopplerRecording(film, tracer.exposure(), factor)
            plan = tracer.tracer(loaded, camera, record)
            identity = {"exposure_s": exposure, "cycles": cycles, "waveform": waveform}
            own = None if checkpoint is None else checkpoint.of_part(number)
            keep = wanted.seed, own, progress
            render_all(loaded, tracer, camera, plan, record, spp, *keep, **identity)
            if own is not None:  # Stopped in the next pose, this one is not rendered again
                own.save(spp, spp, record.state())
            picture, phasors = (np.array(each) for each in film.develop())
        height, width = picture.shape[:2]
        pictures.append(picture[:, :, : film.base_channels_count()])
        phasors = phasors.reshape(height, width, 2, len(weights), 2, -1)
        sums.append(phasors[..., 0, :] + 1j * phasors[..., 1, :])
    steady, total = np.mean(pictures, axis=0), np.sum(sums, axis=0)
    parts = np.stack(
        [
            sum(w * (total[:, :, :, i] * lag**k).real for i, (k, w) in enumerate(weights.items()))
            for lag in (1, -1j)  # Of "I" and "Q"
        ],
        axis=3,
    )
    dims = ("y", "x", "part", "channel")
    return labelled(
        xr.Dataset(
            {
                "homodyne": (dims, parts[:, :, 0]),
                "heterodyne": (dims, parts[:, :, 1]),
                "steady": (("y", "x", "channel"), steady),
            },
            coords=pixels_and_channels(film, parts.shape[-1]) | {"part": ["I", "Q"]},
            attrs={
                **{"scene": wanted.scene_label, "spp": spp, "seed": wanted.seed},
                **{"frequency_hz": frequency, "exposure_s": exposure, "cycles": cycles},
                "waveform": waveform,
            },
        )
    )


def doppler_rate(measured: Annotated[xr.Dataset, DOPPLER]) -> xr.DataArray:
    """Return the rate of change of path lengths that a Doppler measurement tells.

    From the real part r of heterodyne over homodyne, as complex numbers I + i Q of the sum of all
    channels: V = 2 c n π r / (ω T (1 - r)). Where light and camera coincide, distances change
    by V/2; where several paths add up, V is a mean. It is that at a fixed pixel: a tilted surface
    that slides along itself has 0, unlike in `range_rate`, whose rates are the material's. What
    changes the amplitude alone is in the imaginary part, and left out; at edges that cross a pixel
    within the exposure, V means nothing.

    Args:
        measured: A Dataset of `doppler`, of the waveform "sine".

    Returns:
        V (y, x) [m/s], positive for growing lengths; NaN where there is no light.

    Raises:
        ValueError: The Dataset is of another kind or waveform.
    """
    measured = read(measured, DOPPLER, "measured")
    missing = [name for name in PARAMETERS if name not in measured.attrs]
    if missing:
        raise ValueError(
            f"measured: the attribute {missing[0]} is missing. Keep attributes with "
            "xarray.set_options(keep_attrs=True)"
        )
    checks.one_of("waveform", measured.attrs["waveform"], ("sine",))
    homodyne, heterodyne = (
        _complex_of(measured[name].sum("channel")) for name in ("homodyne", "heterodyne")
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = (heterodyne / homodyne).real
        x = measured.attrs["cycles"] * math.pi * ratio / (1 - ratio)
    omega = 2 * math.pi * measured.attrs["frequency_hz"]
    rate = x * (2 * SPEED_OF_LIGHT / (omega * measured.attrs["exposure_s"]))
    units = {"units": "m/s", "long_name": "change of path length at a fixed pixel"}
    return rate.rename("rate").assign_attrs(units)


def _complex_of(parts: xr.DataArray) -> xr.DataArray:
    """Return I + i Q in double precision."""
    parts = parts.astype(float)
    return parts.sel(part="I", drop=True) + 1j * parts.sel(part="Q", drop=True)


def _harmonics(waveform: str) -> dict[int, float]:
    """Return the coefficient of each harmonic k of a waveform of amplitude 1 in cos(k φ)."""
    if waveform == "sine":
        return {1: 1.0}
    odd = range(1, 2 * HARMONICS, 2)
    if waveform == "triangle":
        return {k: 8 / (math.pi * k) ** 2 for k in odd}
    return {k: (-1) ** (k // 2) * 4 / (math.pi * k) for k in odd}


def _film(sensor: mi.Sensor, frequencies: list[float]) -> mi.Film:
    """Return a film for phasors of the same frequencies twice: homodyne and heterodyne."""
    kind = {"type": plugins.qualified_name("phasor_hdr_film"), "frequencies_hz": "1"}
    film: Any = mi.load_dict(kind | pixels_of(sensor.film()))
    film.frequencies_hz = tuple(frequencies)
    return film


def _factor(
    frequency: float, exposure: float, cycles: int, harmonics: list[int], pose: float
) -> Factor:
    """Return the integral over the exposure of light of one pose, for phasors and rates.

    With τ = t/T - 1/2, the pose at p = -+1/4 has the weight l(τ) = 1/2 + 8 p τ, and its phase is
    that at p. For y = ω V T / (2c) and u = k (π n + y), this is

        (-1)^(kn) exp(-2i k y p) (J0 / 2 + 8 p J1),    J0 = sin u / u,   J1 = i (J0 - cos u) / (2u).
    """
    per_rate = math.pi * frequency * exposure / SPEED_OF_LIGHT

    def factor(number: int, rate: mi.Float) -> tuple[mi.Float, mi.Float]:
        k = harmonics[number % len(harmonics)]
        n = cycles if number >= len(harmonics) else 0
        sign = -1.0 if (k * n) % 2 else 1.0
        y = rate * per_rate
        sine, cosine = dr.sincos(k * y)
        u = k * (math.pi * n + y)
        small = dr.abs(u) < SMALL
        safe = dr.select(small, 1, u)
        j0 = dr.select(small, 1 - u * u / 6, sign * sine / safe)  # sin u is exactly 0 at rest
        j1 = dr.select(small, u / 6 - u**3 / 60, (j0 - sign * cosine) / (2 * safe))
        re, im = sign * 0.5 * j0, sign * 8 * pose * j1
        turned_sine, turned_cosine = dr.sincos(-2 * k * pose * y)
        return re * turned_cosine - im * turned_sine, re * turned_sine + im * turned_cosine

    return factor
