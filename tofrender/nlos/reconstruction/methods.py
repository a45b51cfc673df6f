"""`reconstruct`: the hidden scene of a capture, by one of five methods."""

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
from .measured import Measured
from .phasor_field import default_wavelength, phasor_field
from .volume import VolumeGrid, default_volume, resample, volume_dataset

if TYPE_CHECKING:
    import xarray as xr
    from distributed import Client

METHODS = ("bp", "fbp", "lct", "fk", "phasor")

_positive = partial(checks.number, positive=True)

OPTIONS = {
    "weighting": (("bp", "fbp"), "r2", partial(checks.one_of, allowed=WEIGHTINGS)),
    "surface": (("lct", "fk"), "diffuse", partial(checks.one_of, allowed=SURFACES)),
    "snr": (("lct",), None, _positive),
    "wavelength": (("phasor",), None, partial(_positive, unit="metres")),
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
    | `bp` | all captures, any grid | backprojection: blurred, needs nothing |
    | `fbp` | all captures, any grid | minus the Laplacian of `bp` |
    | `lct` | confocal, even plane grid | light-cone transform: Wiener filter |
    | `fk` | confocal, even plane grid | f-k migration: wave equation |
    | `phasor` | all captures, even plane sensor grid | phasor field, Rayleigh-Sommerfeld |

    First and last legs are subtracted where the capture counts them. Of colours, the luminance is
    used. Of photon counts, dark counts are subtracted, and only bins are used in which light of the
    hidden scene stands out of them and comes after the wall's own reflection. See also `capture`,
    `depth_map`, `reconstruction_figure`.

    Two methods err in depth by more than half a bin, by their nature:

    - `lct` works in even steps of z², so near the wall it is off by up to half of such a step,
      (z_high² - z_low²) / (4 z bins): a plate at 0.3 m in a window of 500 bins that reaches 5 m
      deep was found 39 mm too deep, in one that reaches 1.25 m (125 bins) 3 mm. End the window
      where the scene does.
    - `phasor` finds a plane that is parallel to the wall too deep, by about 0.2 λ² / z with the
      wavelength λ and 5 cycles: 14 mm at 1 m and 27 mm at 0.5 m for λ = 0.25 m. Points are where
      they are.

    Args:
        capture: A result of `capture`, `make_capture` or `load_capture`, or photon counts that
            `sense` measured of one.
        method: One of the above.
        volume: A `VolumeGrid`, or its axes ((x low, x high, count), y, z) [m] in the wall's frame:
            origin at the centre of the sensor's grid, x along growing columns, y along growing
            rows, z into the hidden scene. By default voxels lie opposite to the grid's points and
            cover the depths of the window, in steps of half a bin (`lct`, `fk`) or of the longer
            one of half a bin and half the grid's spacing (the others). `lct` and `fk` work on their
            own default and are resampled to others.
        weighting: bp, fbp: "r2" (the default) multiplies light by the product of the distances to
            the laser spot and to the sensor's point, "uniform" does not.
        surface: lct, fk: falloff to undo, of "diffuse" (the default) or "retroreflective" surfaces.
        snr: lct: signal-to-noise ratio that the Wiener filter assumes, above 0. By default 10; of
            photon counts, that and the spectrum of their Poisson noise.
        wavelength: phasor: of the virtual pulse [m]; by default the larger one of four bins and
            twice the grid's spacing, four times if confocal.
        cycles: phasor: wavelengths in the virtual pulse, above 0; 5 by default.
        client: bp, fbp: a `distributed.Client`, whose workers divide the voxels.
        progress: Show a bar if it takes long.

    Returns:
        A Dataset: `intensity (z, y, x)` float32 in arbitrary units, >= 0 but by bp of counts, from
        which dark ones are subtracted; coordinates in metres, and `frame_origin`, `frame_axes`:
        world point = origin + x axes[0] + y axes[1] + z axes[2].

    Raises:
        ValueError: Not a capture, light that is not finite, a method that it does not allow (the
            line says which it does), a volume or option that cannot be.
        MemoryError: It would not fit.

    Warns:
        UserWarning: The light of photon counts stands out of the dark counts in no bin. All bins
            after the wall's own reflection are used then.

    Example:
        >>> from tofrender import capture
        >>> found = reconstruct(capture("nlos_patch", grid=(8, 8), spp=64), "fk")["intensity"]
        >>> round(float(found["z"][found.argmax(...)["z"]]), 1)  # 1 m behind the wall
        1.0
    """
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
    Cube(capture["transient"]).require_finite("capture: transient")
    measured = Measured.of(capture)
    _check_method(method, measured)
    if measured.legs.any() and (method in ("lct", "fk") or measured.counts):
        measured = Measured.of(without_first_and_last_legs(capture))
    if method == "lct" and not measured.counts:
        options.setdefault("snr", SNR)
    if method in ("lct", "fk"):
        values, grid = _in_frequencies(method, measured, options, progress)
        if wanted is not None:
            values, grid = resample(values, grid, wanted), wanted
    else:
        measured = measured.without_background()
        grid = wanted or default_volume(measured)
        if method == "phasor":
            options.setdefault("wavelength", default_wavelength(measured))
            values = phasor_field(measured, grid, **options, progress=progress)
        else:
            values = backproject(measured, grid, **options, progress=progress, client=client)
            values = sharpen(values, grid) if method == "fbp" else values
    attrs = {"method": method, "units": "arbitrary", **options}
    if "scene" in capture.attrs:
        attrs["scene"] = capture.attrs["scene"]
    return volume_dataset(values, grid, measured.frame, attrs)


def _options(method: str, given: dict[str, Any]) -> dict[str, Any]:
    """Check the options of a method, and fill in defaults."""
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
    """Refuse a method that the capture does not allow."""
    even = measured.lattice is not None
    allowed = ["bp", "fbp"]
    allowed += ["lct", "fk"] * (even and measured.mode == "confocal")
    allowed += ["phasor"] * even
    if method not in allowed:
        grid = "an even plane grid" if even else "a grid that is not even, or not plane"
        names = ", ".join(allowed)
        raise ValueError(f"method = {method!r}: a {measured.mode} capture on {grid} allows {names}")
    if measured.path_range()[1] <= 0:
        raise ValueError("capture: its bins end before light can come back; must hold later ones")


def _in_frequencies(
    method: str, measured: Measured, options: dict[str, Any], progress: bool
) -> tuple[np.ndarray, VolumeGrid]:
    """Run lct or fk, which need the same time axis in all pixels, from 0 or later on."""
    early = int(np.ceil(-measured.start / measured.width - 1e-6))
    if early > 0:  # nothing comes back before 0
        start = measured.start + early * measured.width
        later = measured.cube.view(np.s_[..., early:, :])
        measured = replace(measured, start=start, cube=later)
    measured = measured.without_background()
    run, steps = (light_cone_transform, 4) if method == "lct" else (fk_migration, 3)
    with ProgressBar(method, steps, unit="step", enabled=progress) as bar:
        return run(measured, bar=bar, **options)
