"""Ideal AMCW sensors, and errors of their depth by indirect light (multipath)."""

# ruff: noqa: E741 (I and Q are what the field calls them)

from typing import Any, NamedTuple

import numpy as np

from ..runtime import checks
from ..signals.labeled import of_same_axes
from ..signals.phasors import wrap


def four_bucket(
    I: Any, Q: Any, *, offset: Any, contrast: float = 0.5
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Simulate four correlation images of an AMCW pixel, at phases of 0, 90, 180 and 270 degrees.

        B(theta) = (offset + contrast (I cos theta + Q sin theta)) / 2

    Two taps in antiphase share all light: B(theta) + B(theta + 180 degrees) = offset. The model is
    described by Lange and Seitz, "Solid-state time-of-flight range camera", IEEE J. Quantum
    Electronics 37 (2001). The demodulation contrast is the measured amplitude over the measured
    offset. See also `from_four_bucket`.

    Args:
        I: Real part of the phasors, any shape, e.g. (height, width, channels).
        Q: Imaginary part, of the same shape.
        offset: All light that reaches the pixel, modulated or not: the steady image plus ambient
            light, at least 0, with a shape that broadcasts to the shape of I.
        contrast: Contrast in (0, 1]. For fully modulated sine light, demodulation by a sine has the
            contrast 1/2, demodulation by a square wave has 2/pi, and short samples have up to 1.
            Real pixels have less.

    Returns:
        (B0, B90, B180, B270), float64 of the shape of I.

    Raises:
        ValueError: The shapes do not match, the contrast is out of range, or the offset is negative
            or below contrast x amplitude, because light cannot be negative.

    Example:
        >>> buckets = four_bucket(0.0, 2.0, offset=3.0, contrast=0.5)
        >>> [float(b) for b in buckets]
        [1.5, 2.0, 1.5, 1.0]
    """
    # Check the phasors
    I, Q, offset = of_same_axes({"I": I, "Q": Q, "offset": offset})
    I = checks.real_array("I", I, np.float64)
    Q = checks.real_array("Q", Q, np.float64)
    if I.shape != Q.shape:
        raise ValueError(f"I, Q with shapes {I.shape}, {Q.shape}: must be equal")

    # Check offset and contrast
    base = checks.real_array("offset", offset)
    try:
        base = np.broadcast_to(base, I.shape)
    except ValueError:
        raise ValueError(f"offset with shape {base.shape}: must fit I of {I.shape}") from None
    contrast = checks.number("contrast", contrast, positive=True, high=1)
    checks.require("offset", offset, np.isfinite(base).all(), "finite")
    if (base < 0).any():
        raise ValueError(f"offset = {np.nanmin(base):g}: must be at least 0")
    if (base < contrast * np.hypot(I, Q) * (1 - 1e-5)).any():
        raise ValueError(
            f"offset = {base.min():g}: must be at least contrast x amplitude, or buckets hold "
            "negative light; it is the steady image plus ambient light"
        )

    # Evaluate the four phases
    part_i = contrast * I / 2
    part_q = contrast * Q / 2
    half = base / 2
    return half + part_i, half + part_q, half - part_i, half - part_q


def from_four_bucket(
    B0: Any, B90: Any, B180: Any, B270: Any, *, contrast: float = 0.5
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute phasors and offset from four correlation images, the inverse of `four_bucket`.

    I = (B0 - B180) / contrast, Q = (B90 - B270) / contrast, offset = (B0 + B90 + B180 + B270) / 2.
    Ambient light cancels in I and Q, and the phase needs no contrast.

    Args:
        B0: Correlation image at a phase step of 0 degrees, any shape.
        B90: Correlation image at 90 degrees, of the same shape.
        B180: Correlation image at 180 degrees, of the same shape.
        B270: Correlation image at 270 degrees, of the same shape.
        contrast: Demodulation contrast of the sensor, in (0, 1].

    Returns:
        (I, Q, offset), float64.

    Raises:
        ValueError: The shapes do not match, or the contrast is out of range.

    Example:
        >>> [float(v) for v in from_four_bucket(1.5, 2.0, 1.5, 1.0, contrast=0.5)]
        [0.0, 2.0, 3.0]
    """
    contrast = checks.number("contrast", contrast, positive=True, high=1)
    named = {"B0": B0, "B90": B90, "B180": B180, "B270": B270}
    aligned = zip(named, of_same_axes(named), strict=True)
    buckets = [checks.real_array(name, bucket, np.float64) for name, bucket in aligned]
    shapes = [bucket.shape for bucket in buckets]
    if len(set(shapes)) > 1:
        raise ValueError(f"B0, B90, B180, B270 with shapes {shapes}: must be equal")
    b0, b90, b180, b270 = buckets
    return (b0 - b180) / contrast, (b90 - b270) / contrast, (b0 + b90 + b180 + b270) / 2


class MultipathError(NamedTuple):
    """Differences between measured and true depths."""

    error: np.ndarray
    """Signed error of each pixel [m], positive if too far, NaN if a depth is not finite."""
    median: float
    """Median of the error [m]: the bias."""
    percentile_95: float
    """95th percentile of the absolute error [m]."""


def multipath_error(depth: Any, true_depth: Any, range_m: float | None = None) -> MultipathError:
    """Compare measured depth with the true depth.

    Args:
        depth: Measured depth [m], (height, width) or (height, width, channels).
        true_depth: Distance from the sensor [m], (height, width) or the shape of `depth`; see the
            function `true_depth`.
        range_m: Range after which the depth wraps [m], e.g. `unambiguous_range(20e6)`. Errors are
            then reduced to [-range/2, range/2). None for depth that does not wrap.

    Returns:
        A map of errors with the shape of `depth`, and its statistics. Errors are NaN if one of the
        depths is not finite. Without any finite error, the statistics are NaN as well.

    Raises:
        ValueError: The shapes do not match, or the range is not above 0.

    Example:
        >>> measured = np.array([[7.4, 2.1]])
        >>> result = multipath_error(measured, np.array([[0.1, 2.0]]), range_m=7.5)
        >>> result.error.round(6), round(result.median, 6)
        (array([[-0.2,  0.1]]), -0.05)
    """
    # Read both depths
    depth, true_depth = of_same_axes({"depth": depth, "true_depth": true_depth})
    depth = checks.real_array("depth", depth, np.float64)
    true_depth = checks.real_array("true_depth", true_depth, np.float64)
    truth = true_depth[..., None] if depth.ndim == true_depth.ndim + 1 == 3 else true_depth
    if depth.shape != truth.shape and (depth.ndim, *truth.shape) != (3, *depth.shape[:-1], 1):
        raise ValueError(
            f"depth, true_depth with shapes {depth.shape}, {true_depth.shape}: must be equal, "
            "except for channels last in depth"
        )

    # Compare pixels with both depths
    known = np.isfinite(depth) & np.isfinite(truth)
    error = np.subtract(depth, truth, out=np.full(depth.shape, np.nan), where=known)
    if range_m is not None:
        range_m = checks.meters("range_m", range_m, positive=True)
        error = wrap(error + range_m / 2, range_m) - range_m / 2

    # Compute statistics
    if not known.any():
        return MultipathError(error, np.nan, np.nan)
    found = error[known]
    return MultipathError(error, float(np.median(found)), float(np.percentile(np.abs(found), 95)))


def true_depth(scene: Any, sensor: int = 0) -> np.ndarray:
    """Trace the distance from a sensor to the first surface at the center of each pixel.

    If the light is at the camera (`cornell_box_flash`), an AMCW camera without multipath light
    measures this distance. In water it measures this distance times the index. In other scenes,
    phases give half of the path length instead.

    Args:
        scene: A loaded scene, or what `load_scene` accepts.
        sensor: Index of the sensor. The crop window of its film applies.

    Returns:
        float64 (height, width): distance along the ray [m] from the sensor's origin (not from its
        near plane) to the first surface, also if the surface is glass. Lights are surfaces unless
        the integrator of the scene has `hide_emitters`. NaN if the ray hits no surface.

    Raises:
        ValueError: The scene is invalid, or does not contain the sensor.
        BackendError: The active variant is a scalar variant.

    Example:
        >>> depth = true_depth("cornell_box_flash")
        >>> depth.shape, round(depth[128, 10].item(), 1)
        ((256, 256), 3.2)
    """
    import drjit as dr

    from ..paths.camera import ray_origin

    loaded, camera, ray, si, pixels = _pixel_center_hits(scene, sensor)
    origin = ray_origin(camera, ray, loaded)
    distance = dr.select(si.is_valid(), dr.norm(si.p - origin), dr.nan)
    return np.array(distance, dtype=np.float64).reshape(pixels)


def true_normals(scene: Any, sensor: int = 0) -> np.ndarray:
    """Trace the normals of the first surfaces at the centers of pixels.

    Arguments and errors are as for `true_depth`.

    Returns:
        float64 (height, width, 3): unit normals in world space, on the visible side. NaN if the ray
        hits no surface. Meshes have the normals of their triangles, without interpolation.

    Example:
        >>> normals = true_normals("cornell_box")
        >>> normals.shape, round(normals[128, 10, 0].item(), 3)
        ((256, 256, 3), 1.0)
    """
    import drjit as dr

    _, _, ray, si, pixels = _pixel_center_hits(scene, sensor)
    facing = si.n * -dr.sign(dr.dot(si.n, ray.d))
    normals = np.array(dr.select(si.is_valid(), facing, dr.nan), dtype=np.float64)
    return np.ascontiguousarray(normals.T).reshape(*pixels, 3)


def _pixel_center_hits(scene: Any, sensor: int) -> tuple[Any, Any, Any, Any, tuple[int, int]]:
    """Return scene, sensor, rays through pixel centers, first interactions, (height, width)."""
    import drjit as dr
    import mitsuba as mi

    from ..paths.camera import behind_emitters
    from ..paths.surfaces import first_surface
    from ..runtime import backend, variants
    from ..scenes.loading import load_scene, require_sensor

    # Load the scene
    variants.require_vectorized()
    scene = scene if isinstance(scene, mi.Scene) else load_scene(scene)
    camera: Any = require_sensor(scene, sensor)

    # Trace rays through the centers of the pixels
    width, height = (int(v) for v in camera.film().crop_size())
    x, y = dr.meshgrid(dr.arange(mi.Float, width), dr.arange(mi.Float, height))
    size: Any = mi.ScalarPoint2f(width, height)
    center = (mi.Point2f(x, y) + 0.5) / size
    with backend.tracing_lock():
        ray, _ = camera.sample_ray(camera.shutter_open(), 0.5, center, mi.Point2f(0.5))
        hides = getattr(scene.integrator(), "hide_emitters", False)
        si = first_surface(scene, behind_emitters(scene, ray) if hides else ray)
        dr.eval(ray, si)
    return scene, camera, ray, si, (height, width)
