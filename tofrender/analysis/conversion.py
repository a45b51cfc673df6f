"""Phasors of transient data: amplitude, phase and depth of an AMCW time-of-flight camera.

The phasor of a pixel at the modulation frequency f is

    P(f) = sum over k of L_k exp(+i 2 pi f opl_k / c),    I = Re P,    Q = Im P

with the radiance L_k of bin k and the path length opl_k of the bin's center.
"""

# ruff: noqa: E741 (I and Q are what the field calls them)

import math
import warnings
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np
import xarray as xr

from ..labels import TRANSIENT, bins_of, energy_outside_window, intensity, read
from ..rendering.cubes import Cube
from ..rendering.dataset import LOST_ENERGY, QUANTITIES
from ..runtime import checks
from ..runtime.progress import status
from ..signals.labeled import frequencies_first, of_same_axes
from ..signals.phasors import phasor_parts
from ..signals.units import SPEED_OF_LIGHT, check_below_limit, check_frequencies


@status("Converting to phasors")
def transient_to_phasor(
    transient_data: Annotated[Any, TRANSIENT],
    frequency_hz: float | Sequence[float],
    start_opl: float | None = None,
    bin_width_opl: float | None = None,
    *,
    quantity: str | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Convert transient data to phasors: P(f) = sum L_k exp(+i 2 pi f opl_k / c) at bin centers.

    Radiance per bin is summed directly. Radiance per meter is multiplied by the bin width. See also
    `render_amcw_phasor`, `phasor_panel`. The result differs from phasors that are accumulated path
    by path:

    - Light outside the window is missing. The error can be large, and a warning reports it.
    - Light is treated as if it arrived at the center of its bin. Light that is spread evenly over a
      bin of width w has a smaller amplitude by sinc(f w / c) = sin(pi f w / c) / (pi f w / c).
      Therefore the result is too large by about (pi f w / c)^2 / 6, e.g. by 2e-5 for bins of 0.02 m
      at 50 MHz. This is not corrected.
    - A pulse of the render remains in the data. It multiplies the phasor by its characteristic
      function. For a Gaussian, this is exp(-(2 pi f s / c)^2 / 2), e.g. 0.9995 for s = 0.03 m at
      50 MHz.

    Args:
        transient_data: A Dataset of `render` or a part of it, or an array (height, width, bins,
            channels) with 1 or 3 channels, or (height, width, bins). S0 of Stokes vectors is used.
        frequency_hz: Modulation frequency [Hz], above 0 and below c / (2 bin_width_opl), or a
            sequence of frequencies.
        start_opl: Start of the first bin [m], by default the Dataset's start.
        bin_width_opl: Width of a bin [m], above 0, by default the Dataset's width.
        quantity: "radiance per bin" or "radiance per meter", by default the Dataset's quantity. The
            default for arrays is "radiance per bin".

    Returns:
        (I, Q, amplitude, phase, depth), each float64 (height, width, channels), with a leading axis
        of frequencies for a sequence of frequencies; see `phasor_parts`.

    Raises:
        ValueError: Shape, frequency or time axis are invalid, a value is not finite, or attributes
            of a Dataset are missing.

    Warns:
        UserWarning: The Dataset's window lost more than 1 % of the energy.

    Example:
        >>> transient = np.zeros((1, 1, 100, 1))
        >>> transient[0, 0, 60] = 2.0  # arrives at 3.0 + 60.5 * 0.02 = 4.21 m
        >>> I, Q, amplitude, phase, depth = transient_to_phasor(transient, 20e6, 3.0, 0.02)
        >>> amplitude.item(), round(depth.item(), 6)
        (2.0, 2.105)
    """
    # Read the light and its bins
    frequencies, many = check_frequencies(frequency_hz)
    outside = 0.0
    if isinstance(transient_data, xr.Dataset | xr.DataArray):
        given = {"start_opl": start_opl, "bin_width_opl": bin_width_opl, "quantity": quantity}
        film = read(transient_data, TRANSIENT, "transient_data")
        start, width, quantity = _agreeing(given, film)
        outside = energy_outside_window(film, "transient_data")
        if outside is None:
            raise ValueError(
                "transient_data: attribute energy_outside_window is missing; must be as `render` "
                "has it"
            )
        cube = Cube.of("transient_data", intensity(film["transient"], "transient_data"))
    else:
        start = checks.meters("start_opl", start_opl)
        width = checks.meters("bin_width_opl", bin_width_opl, positive=True)
        quantity = QUANTITIES[0] if quantity is None else quantity
        quantity = checks.one_of("quantity", quantity, QUANTITIES)
        cube = _four_axes(Cube.of("transient_data", transient_data))

    # Check the frequencies, and report missing energy
    check_below_limit(frequencies, width)
    if outside > LOST_ENERGY:
        warnings.warn(
            f"{100 * outside:.1f} % of the energy arrives outside the window and is missing from "
            "the phasors; use a longer window, or accumulate phasors per path",
            stacklevel=3,
        )

    # Correlate the bins with waves
    centers = start + (np.arange(cube.shape[2]) + 0.5) * width
    angles = 2 * math.pi / SPEED_OF_LIGHT * np.outer(frequencies, centers)
    waves = np.concatenate((np.cos(angles), np.sin(angles)))
    if quantity == "radiance per meter":
        waves *= width
    sums = _correlate(cube, waves)
    if not np.isfinite(sums).all():
        cube.require_finite("transient_data")
    I, Q = np.split(sums, 2)
    if not many:
        I = I[0]
        Q = Q[0]
    return I, Q, *phasor_parts(I, Q, frequency_hz)


def sum_channels(
    I: Any, Q: Any, frequency_hz: float | Sequence[float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Add the channels of phasors (I, Q), like a sensor without color filters.

    Phasors are added. Phases must not be averaged, because they wrap, and because dark channels
    would have the same weight as bright channels.

    Args:
        I: Real part, channels last; of a DataArray, the channels are the axis `channel`.
        Q: Imaginary part, of the same shape.
        frequency_hz: As for `phasor_parts`.

    Returns:
        (I, Q, amplitude, phase, depth) of the sums, with a last axis of length 1.

    Raises:
        ValueError: As for `phasor_parts`.

    Example:
        >>> I, Q = np.full((2, 2, 3), -1.0), np.array([-0.1, 0.1, 0.1])  # phases of about -pi, pi
        >>> phase = sum_channels(I, np.broadcast_to(Q, I.shape), 20e6)[3]
        >>> phase.shape, round(phase[0, 0, 0].item(), 4)
        ((2, 2, 1), 3.1083)
    """
    if isinstance(I, xr.DataArray):
        checks.require("axes of I", I.dims, "channel" in I.dims, "with an axis channel")
        I = I.transpose(..., "channel")
    I, Q = of_same_axes({"I": I, "Q": Q})
    frequencies, many = check_frequencies(frequency_hz)
    if many:
        I = frequencies_first("I", I, frequencies)
        Q = frequencies_first("Q", Q, frequencies)
    parts = [checks.real_array(name, values) for name, values in (("I", I), ("Q", Q))]
    shapes = [values.shape for values in parts]
    if shapes[0] != shapes[1] or not shapes[0]:
        raise ValueError(
            f"I, Q with shapes {shapes[0]}, {shapes[1]}: must be equal, with channels in the last "
            "axis"
        )
    I, Q = (values.sum(axis=-1, keepdims=True, dtype=np.float64) for values in parts)
    return I, Q, *phasor_parts(I, Q, frequency_hz)


def _four_axes(cube: Cube) -> Cube:
    """Return values with the axes (height, width, bins, channels)."""
    # An array with a last axis of 1 or 3 is an image
    shape = cube.shape
    if len(shape) == 3 and shape[2] not in (1, 3):
        cube = cube.view((..., None))
    if len(cube.shape) != 4 or cube.shape[3] not in (1, 3) or 0 in shape:
        swapped = len(shape) == 4 and shape[2] in (1, 3)
        raise ValueError(
            f"transient_data with shape {shape}: must be (height, width, bins) or (height, width, "
            "bins, channels) with 1 or 3 channels last"
            + ("; np.moveaxis(transient_data, 2, 3) brings them there" if swapped else "")
        )
    return cube


def _agreeing(given: Mapping[str, Any], dataset: xr.Dataset) -> tuple[float, float, str]:
    """Return start and width [m] of a Dataset's bins, and the quantity that the Dataset contains.

    Args:
        given: The caller's values of `start_opl`, `bin_width_opl` and `quantity`, None if missing.
        dataset: The Dataset.

    Raises:
        ValueError: An attribute is missing, or the caller's value differs from the Dataset.
    """
    # Check the attributes
    if dataset.attrs.get("camera_unwarp"):
        raise ValueError(
            "transient_data has path lengths without the camera's segment (camera_unwarp = 1), "
            "so that phases differ from a camera's phases. Pass the render before unwarp_camera"
        )
    if "quantity" not in dataset.attrs:
        raise ValueError(
            "transient_data: attribute quantity is missing; must be as `render` has it"
        )
    bins = bins_of(dataset, "transient_data")
    quantity = checks.one_of("quantity", dataset.attrs["quantity"], QUANTITIES)
    own: dict[str, Any] = {
        "start_opl": bins.start_opl,
        "bin_width_opl": bins.bin_width_opl,
        "quantity": quantity,
    }

    # Compare with given values
    for name, found in own.items():
        value = given[name]
        if value is None or value == found:
            continue
        valid = name != "quantity"
        valid = valid and abs(checks.meters(name, value) - found) <= 1e-3 * bins.bin_width_opl
        checks.require(name, value, valid, f"{found!r}, as the Dataset has it, or left out")
    return bins.start_opl, bins.bin_width_opl, quantity


def _correlate(cube: Cube, waves: np.ndarray) -> np.ndarray:
    """Sum (height, width, bins, channels) times waves (waves, bins) over bins, as float64."""
    height, width, _, channels = cube.shape
    sums = np.zeros((len(waves), height, width, channels))

    # Infinite values result in NaN, which the caller reports
    with np.errstate(invalid="ignore"):
        for (rows, columns, bins, _), values in cube.pieces():
            part = waves[:, bins] @ values.astype(np.float64)
            sums[:, rows, columns] += np.moveaxis(part, 2, 0)
    return sums
