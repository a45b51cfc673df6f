"""`reconstruct`: compute the hidden scene of a capture by one of five methods."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from ...labels import CAPTURE
from ...rendering.cubes import Cube
from ...rendering.workers import require_client
from ...runtime import checks
from ...runtime.progress import ProgressBar
from ..captures import as_capture, read_capture, without_first_and_last_legs
from .backprojection import WEIGHTINGS, backproject, sharpen
from .fk import fk_migration
from .light_cone import SNR, SURFACES, light_cone_transform
from .phasor_field import default_wavelength, phasor_field
from .volume import VolumeGrid, default_volume, resample, volume_dataset
from .wall_capture import Measured

if TYPE_CHECKING:
    import xarray as xr
    from distributed import Client

METHODS = ("bp", "fbp", "lct", "fk", "phasor")

_positive = partial(checks.number, positive=True)

OPTIONS = {
    "weighting": (("bp", "fbp"), "r2", partial(checks.one_of, allowed=WEIGHTINGS)),
    "surface": (("lct", "fk"), "diffuse", partial(checks.one_of, allowed=SURFACES)),
    "snr": (("lct",), None, _positive),
    "wavelength": (("phasor",), None, partial(_positive, unit="meters")),
    "cycles": (("phasor",), 5.0, _positive),
}
"""Methods, default and check of each option."""


def reconstruct(
    capture: Annotated[xr.Dataset, CAPTURE],
    method: str,
    *,
    volume: Any = None,
    weighting: str | None = None,
    surface: str | None = None,
    snr: float | None = None,
    wavelength: float | None = None,
    cycles: float | None = None,
    client: Client | None = None,
    progress: bool = True,
) -> xr.Dataset:
    """Reconstruct the hidden scene of a capture.

    | method | for | |
    |---|---|---|
    | `bp` | all captures, any grid | backprojection: robust, but blurred |
    | `fbp` | all captures, any grid | negative Laplacian of `bp` |
    | `lct` | confocal, even plane grid | light-cone transform: Wiener filter |
    | `fk` | confocal, even plane grid | f-k migration: wave equation |
    | `phasor` | all captures, even plane sensor grid | phasor field, Rayleigh-Sommerfeld |

    If the capture counts first and last legs, they are subtracted. Colors are converted to
    luminance. Dark counts are subtracted from photon counts. Then only bins are used that come
    after the wall's own reflection and in which light of the hidden scene exceeds the dark counts.
    See also `capture`, `depth_map`, `reconstruction_figure`.

    The depths of two methods have a systematic error of more than half a bin:

    - `lct` uses even steps of z². Near the wall, the error is up to half a step,
      (z_high² - z_low²) / (4 z bins). For example, a plate at 0.3 m was found 39 mm too deep in a
      window of 500 bins down to a depth of 5 m, and 3 mm too deep in a window of 125 bins down to
      1.25 m. Choose a window that ends with the scene.
    - `phasor` finds a plane that is parallel to the wall too deep, by about 0.2 λ² / z with the
      wavelength λ and 5 cycles: 14 mm at 1 m and 27 mm at 0.5 m for λ = 0.25 m. Points have no
      such error.

    Args:
        capture: A result of `capture`, `make_capture` or `load_capture`, or photon counts that
            `sense` measured from such a capture.
        method: One of the methods above.
        volume: A `VolumeGrid`, or its axes ((x low, x high, count), y, z) [m] in the wall's frame:
            the origin is at the center of the sensor's grid, x follows the columns, y follows the
            rows, and z points into the hidden scene. By default, voxels are opposite to the points
            of the grid and cover the depths of the window. Their depth is half a bin for `lct` and
            `fk`. For other methods, it is the larger of half a bin and half the grid's spacing.
            `lct` and `fk` always use these voxels, and are resampled to other volumes.
        weighting: bp, fbp: "r2" (default) multiplies light by the product of the distances to the
            laser spot and to the sensor's point. "uniform" does not.
        surface: lct, fk: kind of the hidden surfaces, which determines how light decreases with
            distance: "diffuse" (default) or "retroreflective".
        snr: lct: signal-to-noise ratio that the Wiener filter assumes, above 0. The default is 10.
            For photon counts, the default also includes the spectrum of their Poisson noise.
        wavelength: phasor: wavelength of the virtual pulse [m]. The default is four bins or twice
            the grid's spacing (four times if confocal), whichever is larger.
        cycles: phasor: number of wavelengths in the virtual pulse, above 0. The default is 5.
        client: bp, fbp: a `distributed.Client`. Its workers divide the voxels.
        progress: Whether to show a progress bar.

    Returns:
        A Dataset with `intensity (z, y, x)`, float32 in arbitrary units, and coordinates in meters.
        Intensities are >= 0, except by `bp` from photon counts, because dark counts are subtracted.
        `frame_origin` and `frame_axes` define world points as
        origin + x axes[0] + y axes[1] + z axes[2].

    Raises:
        ValueError: The argument is not a capture, its light is not finite, it does not support the
            method (the message lists the supported methods), or an option is invalid.
        MemoryError: The reconstruction does not fit into memory.

    Warns:
        UserWarning: Photon counts exceed the dark counts in no bin. Then all bins after the wall's
            own reflection are used.

    Example:
        >>> from tofrender import capture
        >>> found = reconstruct(capture("nlos_patch", grid=(8, 8), spp=64), "fk")["intensity"]
        >>> round(float(found["z"][found.argmax(...)["z"]]), 1)  # 1 m behind the wall
        1.0
    """
    # Check the arguments
    checks.one_of("method", method, METHODS)
    given = {"weighting": weighting, "surface": surface, "snr": snr}
    options = _options(method, given | {"wavelength": wavelength, "cycles": cycles})
    if client is not None:
        allowed = f"None, as method = {method!r} is done in one process"
        checks.require("client", client, method in ("bp", "fbp"), allowed)
        require_client(client)
    wanted = None if volume is None else VolumeGrid.of(volume)
    capture = read_capture(as_capture(capture), "capture")
    checks.boolean("progress", progress)

    # Convert the capture to the frame of the wall
    Cube(capture["transient"]).require_finite("capture: transient")
    measured = Measured.of(capture)
    _check_method(method, measured)
    # Some methods need the same time axis in all pixels
    if measured.legs.any() and (method in ("lct", "fk") or measured.counts):
        measured = Measured.of(without_first_and_last_legs(capture))
    if method == "lct" and not measured.counts:
        options.setdefault("snr", SNR)
    # Methods in the frequency domain
    if method in ("lct", "fk"):
        values, grid = _in_frequencies(method, measured, options, progress)
        if wanted is not None:
            values = resample(values, grid, wanted)
            grid = wanted

    # Other methods, on the wanted grid
    else:
        measured = measured.without_background()
        grid = wanted or default_volume(measured)
        if method == "phasor":
            options.setdefault("wavelength", default_wavelength(measured))
            values = phasor_field(measured, grid, **options, progress=progress)
        else:
            values = backproject(measured, grid, **options, progress=progress, client=client)
            values = sharpen(values, grid) if method == "fbp" else values
    # Describe the result
    attrs = {"method": method, "units": "arbitrary", **options}
    if "scene" in capture.attrs:
        attrs["scene"] = capture.attrs["scene"]
    return volume_dataset(values, grid, measured.frame, attrs)


def _options(method: str, given: dict[str, Any]) -> dict[str, Any]:
    """Check the options of a method, and add default values."""
    options = {}
    for name, (methods, default, check) in OPTIONS.items():
        value = given[name]
        if method not in methods:
            allowed = f"None, as it is for {' and '.join(methods)} only"
            checks.require(name, value, value is None, allowed)
        elif value is not None or default is not None:
            options[name] = check(name, default if value is None else value)
    return options


def _check_method(method: str, measured: Measured) -> None:
    """Raise a ValueError if the capture does not support the method, or all bins are empty."""
    even = measured.lattice is not None
    allowed = ["bp", "fbp"]
    allowed += ["lct", "fk"] * (even and measured.mode == "confocal")
    allowed += ["phasor"] * even
    if method not in allowed:
        grid = "an even plane grid" if even else "a grid that is not even, or not plane"
        names = ", ".join(allowed)
        raise ValueError(f"method = {method!r}: a {measured.mode} capture on {grid} allows {names}")
    if measured.path_range()[1] <= 0:
        raise ValueError(
            "capture: its bins end before light can return from the hidden scene. Use later bins"
        )


def _in_frequencies(
    method: str, measured: Measured, options: dict[str, Any], progress: bool
) -> tuple[np.ndarray, VolumeGrid]:
    """Run lct or fk, which require the same time axis in all pixels, without lengths below 0."""
    # Omit bins before path length 0
    early = int(np.ceil(-measured.start / measured.width - 1e-6))
    if early > 0:
        start = measured.start + early * measured.width
        later = measured.cube.view(np.s_[..., early:, :])
        measured = replace(measured, start=start, cube=later)

    # Run the method
    measured = measured.without_background()
    run, steps = (light_cone_transform, 4) if method == "lct" else (fk_migration, 3)
    with ProgressBar(method, steps, unit="step", enabled=progress) as bar:
        return run(measured, bar=bar, **options)
