"""Doppler time of flight: modulated light, and a sensor that is modulated at another frequency.

The light is modulated with the frequency f_g. The sensor multiplies the received light by a
modulation of f_g + n / T and integrates over the exposure T. A path has the amplitude A(t) and the
length L(t) = L + V t. For harmonic k of a modulation with the coefficients c_k, the low-frequency
part of the product adds to the sensor

    c_k (1/T) ∫ A(t) exp(i k (2π n t / T + ω L(t) / c)) dt,        ω = 2π f_g.

For n = 0 (homodyne), this is the phasor of the depth. For n = 1, 2, ... (heterodyne), light with
constant A and L gives exactly 0, so the measurement depends on the velocity. For constant A, the
ratio of heterodyne and homodyne is x / (nπ + x) with x = ω V T / (2c) (F. Heide et al., SIGGRAPH
2015).

A change of A during the exposure has an effect of the same size. Therefore the scene is traced in
two poses, at T/4 and 3T/4, with the same random numbers, and A is linear in time. For each pose,
the integral over time is computed analytically from the rate V of each path. Path lengths of the
two poses are not subtracted.
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
from ..films.rate_bins import DopplerRecording
from ..integrators.render_loop import render_all
from ..labels import DOPPLER, read
from ..rendering.dataset import pixels_and_channels
from ..rendering.labels import labeled
from ..runtime import checks, plugins
from ..scenes.motion import posed
from ..signals.units import SPEED_OF_LIGHT, check_frequency
from .choices import MAX_CYCLES, WAVEFORMS
from .opening import MovingSettings, open_moving, split_settings

HARMONICS = 4  # Number of odd harmonics of waveforms other than the sine
POSES = (-0.25, 0.25)  # Times of the poses relative to the middle of the exposure, in exposures
PARAMETERS = ("waveform", "cycles", "frequency_hz", "exposure_s")  # Attributes of a measurement
SMALL = 0.05  # Phase below which the integrals are computed by series [rad]


def doppler(
    scene: mi.Scene | Mapping[str, object] | str | PathLike[str],
    *,
    frequency_hz: float = 30e6,
    exposure_s: float = 1.5e-3,
    cycles: int = 1,
    waveform: str = "sine",
    **settings: Unpack[MovingSettings],
) -> xr.Dataset:
    """Render the measurement of a Doppler time-of-flight camera: homodyne and heterodyne.

    Args:
        scene: As for `render`. Parts move as described in the scene or set by `moving`.
        frequency_hz: Modulation frequency of the light [Hz].
        exposure_s: Exposure [s], which starts at the time 0.
        cycles: Number n of cycles that light and sensor differ by in one exposure, 1 to 1000.
        waveform: Correlation of light and sensor as a function of phase, with amplitude 1: "sine",
            "triangle" (light and sensor are square waves) or "rectangle" (pulses of light and a
            square wave). The latter two have the harmonics 1, 3, 5 and 7.
        **settings: `spp` (of each pose), `seed`, `size`, `max_depth`, `integrator`, `sensor`,
            `define`, `checkpoint`, `progress`, as for `render`. Supported integrators are
            `transient_path`, `transient_volpath`, `transient_light_tracer` and `transient_bdpt`
            without a pulse.

    Returns:
        A Dataset with `homodyne` and `heterodyne` (y, x, part, channel), the means of light times
        sensor over the exposure, and `steady` (y, x, channel) [W m^-2 sr^-1]. The parts are "I"
        and "Q", with a sensor phase that lags by 90 degrees for "Q".

    Raises:
        ValueError: If an argument or the scene is wrong.
        KeyboardInterrupt: If the render was stopped.

    Example:
        >>> import tofrender
        >>> scene = tofrender.load_scene("cornell_box", width=8, height=8, optimize=False)
        >>> scene = tofrender.moving(scene, {"small-box": tofrender.Motion(velocity=(0, 0, 10))})
        >>> measured = doppler(scene, spp=4, progress=False)
        >>> dict(measured["heterodyne"].sizes)
        {'y': 8, 'x': 8, 'part': 2, 'channel': 3}
    """
    # Check the arguments
    frequency = check_frequency("frequency_hz", frequency_hz)
    exposure = checks.number("exposure_s", exposure_s, unit="seconds", positive=True)
    cycles = checks.integer("cycles", cycles, 1, MAX_CYCLES)
    weights = _harmonics(checks.one_of("waveform", waveform, WAVEFORMS))

    # Open the scene; time bins are set in case that its film is steady
    one_bin = {"bins": 1, "start_opl": 0.0, "bin_width": 1.0}
    render_settings, checkpoint, progress = split_settings("doppler", scene, settings, **one_bin)
    loaded, camera, tracer, spp = open_moving(render_settings)

    # Render the phasors of each pose
    pictures = []
    sums = []
    for number, pose in enumerate(POSES):
        with posed(loaded, (0.5 + pose) * exposure):
            film = _film(camera, [k * frequency for k in weights] * 2)
            factor = _factor(frequency, exposure, cycles, list(weights), pose)
            record = DopplerRecording(film, tracer.exposure(), factor)
            plan = tracer.tracer(loaded, camera, record)
            identity = {"exposure_s": exposure, "cycles": cycles, "waveform": waveform}
            of_pose = None if checkpoint is None else checkpoint.of_part(number)
            render_all(
                loaded,
                tracer,
                camera,
                plan,
                record,
                spp,
                render_settings.seed,
                of_pose,
                progress,
                **identity,
            )

            # Save the finished pose, so that it is not rendered again if the next pose is stopped
            if of_pose is not None:
                of_pose.save(spp, spp, record.accumulation.state())
            picture, phasors = (np.array(each) for each in film.develop())
        height, width = picture.shape[:2]
        pictures.append(picture[:, :, : film.base_channels_count()])
        phasors = phasors.reshape(height, width, 2, len(weights), 2, -1)
        sums.append(phasors[..., 0, :] + 1j * phasors[..., 1, :])

    # Sum the harmonics of both poses
    steady = np.mean(pictures, axis=0)
    total = np.sum(sums, axis=0)
    parts = np.stack(
        [
            sum(w * (total[:, :, :, i] * lag**k).real for i, (k, w) in enumerate(weights.items()))
            for lag in (1, -1j)  # Phase factors of "I" and "Q"
        ],
        axis=3,
    )

    # Label the result
    dims = ("y", "x", "part", "channel")
    return labeled(
        xr.Dataset(
            {
                "homodyne": (dims, parts[:, :, 0]),
                "heterodyne": (dims, parts[:, :, 1]),
                "steady": (("y", "x", "channel"), steady),
            },
            coords=pixels_and_channels(film, parts.shape[-1]) | {"part": ["I", "Q"]},
            attrs={
                "scene": render_settings.scene_label,
                "spp": spp,
                "seed": render_settings.seed,
                "frequency_hz": frequency,
                "exposure_s": exposure,
                "cycles": cycles,
                "waveform": waveform,
            },
        )
    )


def doppler_rate(measured: Annotated[xr.Dataset, DOPPLER]) -> xr.DataArray:
    """Compute the rate of change of path lengths from a Doppler measurement.

    The rate is V = 2 c n π r / (ω T (1 - r)), where r is the real part of heterodyne over homodyne.
    Both are complex numbers I + i Q, summed over all channels. If light and camera are at the same
    point, distances change by V/2. If several paths contribute to a pixel, V is a mean.

    V is the rate at a fixed pixel. A tilted surface that slides along itself has V = 0. In
    contrast, the rates of `range_rate` belong to points of the material. Changes of the amplitude
    affect the imaginary part of the ratio only, which is ignored. If an edge crosses a pixel during
    the exposure, V of this pixel is not meaningful.

    Args:
        measured: A Dataset of `doppler` with the waveform "sine".

    Returns:
        V (y, x) [m/s], positive for growing lengths, NaN for pixels without light.

    Raises:
        ValueError: If the Dataset has another kind or another waveform.
    """
    # Check the Dataset
    measured = read(measured, DOPPLER, "measured")
    missing = [name for name in PARAMETERS if name not in measured.attrs]
    if missing:
        raise ValueError(
            f"measured: the attribute {missing[0]} is missing. Keep attributes with "
            "xarray.set_options(keep_attrs=True)"
        )
    checks.one_of("waveform", measured.attrs["waveform"], ("sine",))

    # Compute the ratio and the rate
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
    """Return the complex numbers I + i Q in double precision."""
    parts = parts.astype(float)
    return parts.sel(part="I", drop=True) + 1j * parts.sel(part="Q", drop=True)


def _harmonics(waveform: str) -> dict[int, float]:
    """Return the coefficients of cos(k φ) of a waveform with amplitude 1, by harmonic k."""
    if waveform == "sine":
        return {1: 1.0}
    odd = range(1, 2 * HARMONICS, 2)
    if waveform == "triangle":
        return {k: 8 / (math.pi * k) ** 2 for k in odd}
    return {k: (-1) ** (k // 2) * 4 / (math.pi * k) for k in odd}


def _film(sensor: mi.Sensor, frequencies: list[float]) -> mi.Film:
    """Return a film for phasors; `frequencies` has homodyne, then heterodyne frequencies [Hz]."""
    kind = {"type": plugins.qualified_name("phasor_hdr_film"), "frequencies_hz": "1"}
    film: Any = mi.load_dict(kind | pixels_of(sensor.film()))
    film.frequencies_hz = tuple(frequencies)
    return film


def _factor(
    frequency: float, exposure: float, cycles: int, harmonics: list[int], pose: float
) -> Factor:
    """Return a function that integrates the light of one pose over the exposure.

    The function's arguments are the index of a phasor and the rate V. With τ = t/T - 1/2, a pose at
    p = -1/4 or p = 1/4 has the weight l(τ) = 1/2 + 8 p τ, and its phase is the phase at p. For
    y = ω V T / (2c) and u = k (π n + y), the integral is

        (-1)^(kn) exp(-2i k y p) (J0 / 2 + 8 p J1),    J0 = sin u / u,   J1 = i (J0 - cos u) / (2u).

    Args:
        frequency: Modulation frequency [Hz].
        exposure: Exposure T [s].
        cycles: Number n of cycles of the heterodyne phasors.
        harmonics: Harmonics k of the phasors.
        pose: Time p of the pose, in exposures.
    """
    per_rate = math.pi * frequency * exposure / SPEED_OF_LIGHT

    def factor(number: int, rate: mi.Float) -> tuple[mi.Float, mi.Float]:
        """Return real and imaginary part of the integral for phasor `number`."""
        # Harmonic and cycles of this phasor
        k = harmonics[number % len(harmonics)]
        n = cycles if number >= len(harmonics) else 0
        sign = -1.0 if (k * n) % 2 else 1.0
        y = rate * per_rate
        sine, cosine = dr.sincos(k * y)

        # J0 and J1 / i, by series for small u. sin u is exactly 0 for light at rest
        u = k * (math.pi * n + y)
        small = dr.abs(u) < SMALL
        safe = dr.select(small, 1, u)
        j0 = dr.select(small, 1 - u * u / 6, sign * sine / safe)
        j1 = dr.select(small, u / 6 - u**3 / 60, (j0 - sign * cosine) / (2 * safe))

        # Weight of the pose, and phase at the time of the pose
        re = sign * 0.5 * j0
        im = sign * 8 * pose * j1
        turned_sine, turned_cosine = dr.sincos(-2 * k * pose * y)
        return re * turned_cosine - im * turned_sine, re * turned_sine + im * turned_cosine

    return factor
