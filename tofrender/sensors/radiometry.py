"""Conversion of rendered radiance to the expected photons of a sensor's pixels."""

from dataclasses import dataclass, field, fields
from typing import Annotated, Any

import numpy as np
import xarray as xr

from ..labels import TRANSIENT, Bins, bins_of, intensity, read
from ..runtime import checks
from ..runtime.parameters import filled, takes
from ..signals.units import SPEED_OF_LIGHT

# Planck constant [J s]
PLANCK = 6.62607015e-34

# Required parameters of a description of the optics
NEEDED = {"pulse_energy_j", "lamp_power_w", "wavelength_m", "f_number", "pixel_pitch_m"}
LONG_NAMES = {
    "rate": "expected photons per bin and cycle",
    "background": "expected background photons per bin and cycle",
}
FRACTIONS = {"fill_factor", "transmission", "detection_efficiency"}


@dataclass(frozen=True, kw_only=True)
class Optics:
    """Conversion of radiance to photons: by laser, lens and pixels, or by the mean signal.

    The fields are the parameters of `expected_photons`.
    """

    photons_per_cycle: float | None = None
    background_per_cycle: float = 0.0
    lamp_power_w: float | None = None
    mean_power_w: float | None = None
    repetition_rate_hz: float | None = None
    pulse_energy_j: float | None = None
    wavelength_m: float | None = None
    f_number: float | None = None
    focal_length_m: float | None = None
    pixel_pitch_m: float | None = None
    fill_factor: float = 1.0
    transmission: float = 1.0
    detection_efficiency: float = 1.0
    ambient_radiance: float = 0.0
    dark_count_hz: float = 0.0

    def __post_init__(self) -> None:
        of_optics = self.photons_per_cycle is None
        for each in fields(Optics):
            name = each.name
            value = getattr(self, name)

            # Is the value in its range?
            if value is not None or each.default is not None:
                above = each.default is None
                high = 1 if name in FRACTIONS else None
                checks.number(name, value, positive=above, low=None if above else 0, high=high)

            # Is it allowed?
            is_optics = name not in ("photons_per_cycle", "background_per_cycle")
            allowed = f"left out {'without' if of_optics else 'with'} photons_per_cycle"
            checks.require(name, value, is_optics == of_optics or value == each.default, allowed)

            # Is it required?
            valid = value is not None
            allowed = "given, or photons_per_cycle instead of optics"
            if name == "pulse_energy_j":
                pair = [self.mean_power_w, self.repetition_rate_hz]
                valid = pair == [None, None] if valid else None not in pair
                allowed = "given, or mean_power_w and repetition_rate_hz, and not both"
            is_needed = of_optics and name in NEEDED
            checks.require(name, value, valid or not is_needed, allowed)


@dataclass(frozen=True, kw_only=True)
class PhotonArguments(Optics):
    """All parameters of `expected_photons`: a render and the conversion."""

    dataset: Annotated[xr.Dataset, TRANSIENT] = field(kw_only=False)


@takes(PhotonArguments)
def expected_photons(*args: Any, **options: Any) -> xr.Dataset:  # noqa: D417, the record has them
    """Convert radiance per bin to expected detections per pixel, bin and laser cycle.

    In the render, lamps of the constant power P cause the radiance H_k in bin k. A laser pulse of
    the energy Q that replaces them causes

        radiance              H_k Q / P                                     [J m^-2 sr^-1]
        irradiance            pi / (4 N^2) cos^4(angle off the axis)        times radiance [J m^-2]
        energy on the pixel   pitch^2 fill_factor                           times irradiance [J]
        photons               wavelength / (h c)                            times energy
        signal_k              transmission detection_efficiency             times photons

    with the f-number N (camera equation for distant objects: Kolb, Mitchell and Hanrahan, SIGGRAPH
    1995). Ambient light is converted in the same way, for the time w / c of a bin:

        rate_k = signal_k + (ambient counts per second + dark_count_hz) w / c.

    A pulse of the render is part of H_k. Alternatively, `photons_per_cycle` scales the mean signal
    of all pixels, and `background_per_cycle` is divided among the bins. Then other parameters are
    not allowed.

    Args:
        dataset: A Dataset of `render`, "radiance per bin". Lazy Datasets remain lazy. Channels are
            averaged; `dataset.sel(channel=["R"])` selects one. S0 of Stokes vectors is used.
        photons_per_cycle: Mean signal per pixel and cycle, above 0.
        background_per_cycle: Background per pixel and cycle, at least 0.
        lamp_power_w: Power P [W] that the lamps of the scene emit.
        mean_power_w: Mean power of the laser [W].
        repetition_rate_hz: Pulses per second. Their period must not be shorter than the window.
        pulse_energy_j: Energy Q of a pulse [J], instead of mean power and repetition rate.
        wavelength_m: Wavelength of the laser [m].
        f_number: Focal length over the diameter of the aperture.
        focal_length_m: Focal length [m] for the factor cos^4, None to omit this factor.
        pixel_pitch_m: Distance of pixels [m].
        fill_factor: Sensitive fraction of a pixel, from 0 to 1.
        transmission: Transmission of lens and filter, from 0 to 1.
        detection_efficiency: Counts per photon, from 0 to 1.
        ambient_radiance: Radiance of ambient light in the filter's band [W m^-2 sr^-1].
        dark_count_hz: Dark counts of a pixel [1/s].

    Returns:
        A Dataset with `rate` (y, x, bin) and the coordinate opl [m], the `background` (y, x) that
        is part of each bin, and all parameters as attributes.

    Raises:
        ValueError: A parameter is missing, out of range, or not allowed with another parameter.

    Example:
        >>> from tofrender import render
        >>> box = render("cornell_box", spp=4, size=(8, 8), window="auto", progress=False)
        >>> rates = expected_photons(box, photons_per_cycle=0.5, background_per_cycle=0.1)
        >>> rates["rate"].dims, round(rates["rate"].sum("bin").mean().item(), 3)
        (('y', 'x', 'bin'), 0.6)
    """
    # Check the arguments
    o: Any = filled(PhotonArguments, expected_photons, args, options)
    dataset = read(o.dataset, TRANSIENT, "dataset")
    window = _check(dataset)

    # Average the channels. Reconstruction filters may have negative lobes
    transient = intensity(dataset["transient"], "dataset")
    signal = transient.mean("channel", dtype=np.float64)
    signal = signal.clip(min=0)
    bins = window.count
    bin_s = window.bin_width_opl / SPEED_OF_LIGHT

    # Scale the mean signal
    if o.photons_per_cycle is not None:
        mean = signal.sum("opl").mean()
        if not hasattr(mean.data, "dask"):
            lit = float(mean) > 0
            checks.require(
                "photons_per_cycle", o.photons_per_cycle, lit, "left out: no bin has light"
            )
        signal = signal * (o.photons_per_cycle / mean)
        background: Any = o.background_per_cycle / bins

    # Or convert radiance by the camera equation
    else:
        pulse_energy_j = o.pulse_energy_j
        if pulse_energy_j is None:
            fits = o.repetition_rate_hz * bins * bin_s <= 1 + 1e-9
            allowed = f"at most {1 / (bins * bin_s):g}, one over the window of the film"
            checks.require("repetition_rate_hz", o.repetition_rate_hz, fits, allowed)
            pulse_energy_j = o.mean_power_w / o.repetition_rate_hz

        # Counts per radiance and second
        area = o.pixel_pitch_m**2 * o.fill_factor * np.pi / (4 * o.f_number**2)
        photons = area * o.wavelength_m / (PLANCK * SPEED_OF_LIGHT)
        counts = photons * o.transmission * o.detection_efficiency

        # Apply cos^4 of the angle off the axis
        if o.focal_length_m is not None:
            square: Any = 1.0
            for axis, size in (("x", "film_width"), ("y", "film_height")):
                film_size = _film_size(dataset, size)
                offset_m = (dataset[axis] - (film_size / 2 - 0.5)) * o.pixel_pitch_m
                square = square + (offset_m / o.focal_length_m) ** 2
            counts = counts / square**2

        # Add signal and background
        signal = signal * counts * (pulse_energy_j / o.lamp_power_w)
        background = (counts * o.ambient_radiance + o.dark_count_hz) * bin_s

    # Describe the result
    background = (background + 0.0 * dataset["y"] + 0.0 * dataset["x"]).transpose("y", "x")
    rate = (signal + background).transpose("y", "x", "opl")
    rate = rate.drop_vars(["opl", "time"], errors="ignore").rename(opl="bin")
    opl = "bin", dataset["opl"].values, dataset["opl"].attrs
    kept = {each.name: getattr(o, each.name) for each in fields(Optics)}
    kept = {name: value for name, value in kept.items() if value is not None}
    kept |= {"scene": dataset.attrs.get("scene", ""), "quantity": "rate", "units": "1"}
    kept |= {"start_opl": window.start_opl, "bin_width_opl": window.bin_width_opl}
    found = xr.Dataset({"rate": rate, "background": background}, {"opl": opl}, kept)
    for name, long_name in LONG_NAMES.items():
        found[name].attrs = {"units": "1", "long_name": long_name}
    return found


def _film_size(dataset: xr.Dataset, name: str) -> float:
    """Return the width or height of the whole film [pixels], whose center is the optical axis."""
    size = dataset.attrs.get(name)
    if size is None:
        raise ValueError(
            f"dataset: the attribute {name} is missing, so that the optical axis is unknown. Keep "
            "the attributes of the render, or omit focal_length_m"
        )
    return checks.number(f"dataset: attribute {name}", size, positive=True)


def _check(dataset: xr.Dataset) -> Bins:
    """Check that sensors can measure a render, and return its bins."""
    if dataset.attrs.get("camera_unwarp"):
        raise ValueError(
            "dataset has path lengths without the camera's segment (camera_unwarp = 1), which "
            "sensors do not measure. Pass the render before unwarp_camera"
        )
    quantity = dataset.attrs.get("quantity")
    checks.require("quantity", quantity, quantity == "radiance per bin", "radiance per bin")
    return bins_of(dataset, "dataset")
