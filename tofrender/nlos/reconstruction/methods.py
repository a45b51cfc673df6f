"""`reconstruct`: the hidden scene of a capture, by one of five methods."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...rendering.cubes import Cube
from ...rendering.workers import require_client
from ...runtime import checks
from ..captures import check_capture, without_first_and_last_legs
from . import fk, light_cone, phasor_field
from .backprojection import WEIGHTINGS, backproject, sharpen
from .fourier import Steps
from .measured import Measured
from .volume import VolumeGrid, default_volume, resample, volume_dataset

if TYPE_CHECKING:
    import xarray as xr
    from distributed import Client

METHODS = ("bp", "fbp", "lct", "fk", "phasor")
SHARED = ("bp", "fbp")
"""Those that workers can share."""

_USED_BY = {
    "weighting": ("bp", "fbp"),
    "surface": ("lct", "fk"),
    "snr": ("lct",),
    "wavelength": ("phasor",),
    "cycles": ("phasor",),
}
_DEFAULTS = {"weighting": "r2", "surface": "diffuse", "snr": 10.0, "cycles": 5.0}


def reconstruct(
    capture: xr.Dataset,
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

    Path lengths start where `opl` says, and the first and last legs are taken off where the
    capture counts them. Of colours, the luminance is used.

    Two methods err in depth by more than half a bin, by their nature:

    - `lct` works in even steps of z², so near the wall it is off by up to half of such a step,
      (z_high² - z_low²) / (4 z bins): a plate at 0.3 m in a window of 500 bins that reaches 5 m
      deep was found 39 mm too deep, in one that reaches 1.25 m (125 bins) 3 mm. End the window
      where the scene does.
    - `phasor` finds a plane that is parallel to the wall too deep, by about 0.2 λ² / z with the
      wavelength λ and 5 cycles: 14 mm at 1 m and 27 mm at 0.5 m for λ = 0.25 m. Points are where
      they are.

    Args:
        capture: What `capture`, `make_capture` or `load_capture` returns.
        method: One of the above.
        volume: A `VolumeGrid`, or its axes ((x low, x high, count), y, z) [m] in the wall's frame:
            origin at the centre of the sensor's grid, x along growing columns, y along growing
            rows, z into the hidden scene. By default voxels lie opposite to the grid's points and
            reach through the depths that the bins speak of, in steps of half a bin (`lct`, `fk`) or
            of the longer one of half a bin and half the grid's spacing (the others). `lct` and `fk`
            work on their own default; other voxels get its linear interpolation, or the mean of
            what they cover where they are larger, and 0 outside of it.
        weighting: bp, fbp: "r2" (the default) multiplies light by the product of the distances to
            the lit point and to the point looked at, "uniform" takes it as it is.
        surface: lct, fk: what falloff to undo, of "diffuse" (the default) or "retroreflective"
            surfaces.
        snr: lct: signal-to-noise ratio that the Wiener filter assumes, above 0; 10 by default.
        wavelength: phasor: of the virtual pulse [m]; by default the larger one of four bins and
            twice the grid's spacing, four times if confocal.
        cycles: phasor: wavelengths in the virtual pulse, above 0; 5 by default.
        client: bp, fbp: a `distributed.Client`, whose workers share the voxels. The others take
            seconds in one process.
        progress: Show a bar if it takes longer than two seconds.

    Returns:
        A Dataset: `intensity (z, y, x)` float32 >= 0 in arbitrary units, coordinates in metres, and
        `frame_origin`, `frame_axes`: world point = origin + x axes[0] + y axes[1] + z axes[2].

    Raises:
        ValueError: Not a capture, light that is not finite, a method that it does not allow (the
            line says which it does), a volume or option that cannot be.
        MemoryError: It would not fit.

    Example:
        >>> from tofrender.nlos import make_capture
        >>> x, y = np.meshgrid(np.linspace(-1, 1, 16), np.linspace(-1, 1, 16))
        >>> wall = np.stack([x, y, 0 * x], axis=-1)
        >>> path = 2 * np.linalg.norm(wall - [0.3, -0.2, 1.0], axis=-1)
        >>> opl = 1.9 + 0.02 * (np.arange(100) + 0.5)
        >>> light = np.exp(-(((opl - path[..., None]) / 0.02) ** 2)) / path[..., None] ** 4
        >>> capture = make_capture(
        ...     light,
        ...     mode="confocal",
        ...     start_opl=1.9,
        ...     bin_width_opl=0.02,
        ...     sensor_grid=wall,
        ...     sensor_normals=np.broadcast_to([0, 0, 1], wall.shape),
        ... )
        >>> found = reconstruct(capture, "lct")["intensity"]
        >>> place = found.where(found == found.max(), drop=True)
        >>> [round(float(place[axis][0]), 1) for axis in "xyz"]
        [0.3, -0.2, 1.0]
    """
    checks.one_of("method", method, METHODS)
    given = {
        "weighting": weighting,
        "surface": surface,
        "snr": snr,
        "wavelength": wavelength,
        "cycles": cycles,
    }
    options = _options(method, given)
    if client is not None and method not in SHARED:
        raise ValueError(
            f"client = {checks.quote(client)}: must be None, as method = {method!r} is done in one "
            "process"
        )
    if client is not None:
        require_client(client)
    wanted = None if volume is None else VolumeGrid.of(volume)
    check_capture(capture)
    checks.boolean("progress", progress)
    Cube(capture["transient"]).require_finite("capture: transient")
    measured = Measured.of(capture)
    _check_method(method, measured)
    if method in ("lct", "fk"):
        values, grid = _in_frequencies(method, capture, measured, options, progress)
        if wanted is not None:
            values, grid = resample(values, grid, wanted), wanted
    else:
        grid = wanted or default_volume(measured)
        if method == "phasor":
            options.setdefault("wavelength", phasor_field.default_wavelength(measured))
            values = phasor_field.phasor_field(measured, grid, **options, progress=progress)
        else:
            values = backproject(measured, grid, **options, progress=progress, client=client)
            values = sharpen(values, grid) if method == "fbp" else values
    attrs = {"method": method, "units": "arbitrary", **options}
    if "scene" in capture.attrs:
        attrs["scene"] = capture.attrs["scene"]
    return volume_dataset(values, grid, measured.frame, attrs)


def _options(method: str, given: dict[str, Any]) -> dict[str, Any]:
    """Checked options of the method, with defaults."""
    options = {k: v for k, v in _DEFAULTS.items() if method in _USED_BY[k]}
    for name, value in given.items():
        if value is None:
            continue
        if method not in _USED_BY[name]:
            allowed = " and ".join(_USED_BY[name])
            raise ValueError(
                f"{name} = {checks.quote(value)}: must be None, as it is for {allowed} only"
            )
        options[name] = value
    if "weighting" in options:
        checks.one_of("weighting", options["weighting"], WEIGHTINGS)
    if "surface" in options:
        checks.one_of("surface", options["surface"], light_cone.SURFACES)
    for name, unit in (("snr", ""), ("cycles", ""), ("wavelength", "metres")):
        if name in options:
            options[name] = checks.number(name, options[name], unit=unit, positive=True)
    return options


def _check_method(method: str, measured: Measured) -> None:
    """Refuse a method that the capture does not allow."""
    even = measured.lattice is not None
    allowed = ["bp", "fbp"]
    allowed += ["lct", "fk"] * (even and measured.mode == "confocal")
    allowed += ["phasor"] * even
    if method not in allowed:
        grid = "an even plane grid" if even else "a grid that is not even, or not plane"
        raise ValueError(
            f"method = {method!r}: a {measured.mode} capture on {grid} allows {', '.join(allowed)}"
        )
    if measured.path_range()[1] <= 0:
        raise ValueError("capture: its bins end before light can come back; must hold later ones")


def _in_frequencies(
    method: str, capture: xr.Dataset, measured: Measured, options: dict[str, Any], progress: bool
) -> tuple[np.ndarray, VolumeGrid]:
    """What lct and fk find: they need the same time axis in all pixels, from 0 or later on."""
    if measured.legs.any():
        capture = without_first_and_last_legs(capture)
        measured = Measured.of(capture)
    early = int(np.ceil(-measured.start / measured.width - 1e-6))
    if early > 0:  # nothing comes back before 0
        start = measured.start + early * measured.width
        later = measured.cube.view(np.s_[..., early:, :])
        measured = replace(measured, start=start, cube=later)
    with Steps(method, 4 if method == "lct" else 3, progress) as steps:
        if method == "lct":
            return light_cone.light_cone_transform(measured, steps=steps, **options)
        return fk.fk_migration(measured, steps=steps, **options)
