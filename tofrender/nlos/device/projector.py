"""Emitter plugin `confocal_projector`: Gaussian laser spots that scan a wall."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...runtime import checks
from ...signals.illuminants import Colors

if TYPE_CHECKING:
    from ...signals.pulses import Pulse

MAX_SPOTS = 65536
LISTED = ("spot_positions", "spot_sigmas", "spot_intensities")
SPACINGS = ("uniform", "random")
PULSES = ("gaussian", "histogram")


class ConfocalProjector(mi.Emitter):
    """Laser projector with a pattern of Gaussian spots (plugin `confocal_projector`).

    The projector is nested in a `transient_path` or `confocal_transient_path`, and is not an
    emitter of the scene. The pattern is defined on a plane at unit distance. The field of view
    covers [-1, 1] x [-1, 1] of this plane: a direction (X, Y, 1) in the projector's frame has the
    coordinates (X, Y) / tan(fov / 2). A spot of power Phi at (x0, y0) has the radiant intensity

        I(w) = Phi / (2 pi sigma^2) exp(-((x-x0)^2 + (y-y0)^2) / (2 sigma^2))
               / (tan^2(fov/2) cos^3)   [W/sr]

    with the cosine between w and the projector's axis, because dw = tan^2(fov/2) cos^3 dx dy. Light
    outside the field of view is cut off.

    The course's fork of mitransient interprets `grid_intensity` as a density over the plane of the
    pattern instead of a power, so that its light is darker.

    | parameter | default | meaning |
    |---|---|---|
    | `fov` | 0.2 | full angle of the field of view [rad], below pi |
    | `is_confocal` | true | the axis follows each camera ray, otherwise it is fixed by `frame` |
    | `frame` | none | projector to world transform; the projector looks along its z axis |
    | `grid_rows`, `grid_cols` | 1, 1 | number of spots |
    | `grid_sigma` | 0.01 | standard deviation of each spot, in half fields of view |
    | `grid_intensity` | 1.0 | power of each spot [W] |
    | `grid_spacing` | "uniform" | "uniform": the centers of equal cells; "random" |
    | `grid_seed` | 0 | seed of random positions |
    | `spot_positions` | none | instead of a grid: (n, 2) positions in [-1, 1] |
    | `spot_sigmas` | none | their (n,) standard deviations |
    | `spot_intensities` | none | their powers [W], (n,), or (n, 3) with colors |
    | `max_rejection_samples` | 8 | trials to sample inside the field of view, 1 to 64 |
    | `pulse_type` | "gaussian" | "gaussian" or "histogram" |
    | `pulse_width_opl` | 0.01 | standard deviation of a Gaussian pulse [m] |
    | `pulse_values`, `pulse_start_opl`, `pulse_bin_width_opl` | none, 0, 0.001 | a histogram [m] |

    In a dict, lists are arrays. In XML, lists are numbers separated by commas or blanks.

    Example:
        >>> projector = mi.load_dict({"type": "confocal_projector", "grid_intensity": 2.0})
        >>> projector.power, projector.pulse
        ([2.0, 2.0, 2.0], GaussianPulse(width_opl=0.01))
    """

    def __init__(self, props: mi.Properties) -> None:
        # Import here, because the plugin is registered at import
        from scipy.special import ndtr

        super().__init__(props)

        # Geometry
        self.is_confocal = checks.boolean("is_confocal", props.get("is_confocal", True))
        fov = checks.number("fov", props.get("fov", 0.2), positive=True, unit="radians")
        checks.require("fov", fov, fov < math.pi, "an angle above 0 and below pi, in radians")
        self.tan = math.tan(fov / 2)
        tries = props.get("max_rejection_samples", 8)
        self.tries = checks.integer("max_rejection_samples", tries, 1, 64)
        frame: Any = props.get("frame", None)
        if frame is None and not self.is_confocal:
            raise ValueError("frame is missing. Add it, or set is_confocal to true")
        self.frame: Any = None if frame is None else mi.ScalarTransform4f(_pose(frame))

        # Pulse
        self._pulse_width_opl, self._histogram = _pulse(props)

        # Spots. Lists are passed to Dr.Jit, because it compiles anew for each alignment of NumPy's
        # memory
        positions, sigmas, powers = _spots(props)
        self.power: list[float] = powers.sum(axis=0).tolist()
        brightness = powers.mean(axis=1)
        self.count = len(sigmas)
        self.positions = mi.Point2f(*(mi.Float(each.tolist()) for each in positions.T))
        self.sigmas = mi.Float(sigmas.tolist())
        self.colors = Colors(powers / brightness[:, None])

        # Distribution of power over the spots
        self.cumulative = mi.Float((np.cumsum(brightness) / brightness.sum()).tolist())
        self.fractions = mi.Float((brightness / brightness.sum()).tolist())
        self.total = float(brightness.sum())

        # Fraction of each Gaussian inside the field of view
        upper, lower = (ndtr((edge - positions) / sigmas[:, None]) for edge in (1, -1))
        inside = np.prod(upper - lower, axis=1)
        self.inside = mi.Float(inside.tolist())
        dr.eval(self.positions, self.sigmas, self.cumulative, self.inside)

    @property
    def pulse(self) -> Pulse:
        """Return the temporal profile of the light."""
        from ...signals.pulses import GaussianPulse

        return GaussianPulse(self._pulse_width_opl) if self._histogram is None else self._histogram

    def axes(self, direction: Any, up: Any) -> mi.Frame3f:
        """Return the frame of the projector: t is up, n is the axis, s as in `look_at`.

        Args:
            direction: Direction of a camera ray.
            up: Upward direction of the camera.
        """
        if not self.is_confocal:
            to_world = mi.Transform4f(self.frame)
            s, t, n = (to_world @ mi.Vector3f(*axis) for axis in np.eye(3).tolist())
            return mi.Frame3f(dr.normalize(s), dr.normalize(t), dr.normalize(n))
        s = dr.normalize(dr.cross(up, direction))
        return mi.Frame3f(s, dr.cross(direction, s), direction)

    def origin(self, camera: Any) -> mi.Point3f:
        """Return the position of the projector [m], given the position of the camera."""
        if self.is_confocal:
            return mi.Point3f(camera)
        return mi.Transform4f(self.frame) @ mi.Point3f(0)

    def sample_beam(
        self, axes: mi.Frame3f, sampler: mi.Sampler, active: mi.Bool, wavelengths: Any = None
    ) -> tuple[mi.Vector3f, Any]:
        """Sample a direction in proportion to the pattern.

        Args:
            axes: Frame of the projector, as from `axes`.
            sampler: The sampler.
            active: Active lanes.
            wavelengths: Wavelengths [nm].

        Returns:
            The direction, and its weight [W], which is 0 outside the field of view.
        """
        # Choose a spot in proportion to its power
        xi = sampler.next_1d()
        u = sampler.next_2d()
        index = mi.UInt32(0)
        if self.count > 1:
            index = dr.binary_search(
                0, self.count - 1, lambda k: dr.gather(mi.Float, self.cumulative, k, active) <= xi
            )

        # Sample the Gaussian of this spot, and try again outside the field of view
        center = dr.gather(mi.Point2f, self.positions, index, active)
        sigma = dr.gather(mi.Float, self.sigmas, index, active)
        inside = dr.gather(mi.Float, self.inside, index, active)
        p = center + sigma * mi.warp.square_to_std_normal(u)
        for _ in range(self.tries - 1):
            again = dr.any(dr.abs(p) > 1)
            retry = center + sigma * mi.warp.square_to_std_normal(sampler.next_2d())
            p = dr.select(again, retry, p)

        # With k tries, a sample is inside with the probability 1 - (1 - inside)^k
        missed: Any = dr.power(1 - inside, self.tries)
        weight = dr.select(dr.all(dr.abs(p) <= 1), self.total * inside / (1 - missed), 0)
        d = axes.to_world(dr.normalize(mi.Vector3f(p.x * self.tan, p.y * self.tan, 1)))
        return d, self.colors.at(index, wavelengths, active) * weight

    def intensity(self, axes: mi.Frame3f, direction: mi.Vector3f, wavelengths: Any = None) -> Any:
        """Return the radiant intensity [W/sr] of the spots in a direction.

        Args:
            axes: Frame of the projector, whose z axis is the optical axis.
            direction: Unit vector in world space.
            wavelengths: Wavelengths [nm] in spectral variants.
        """
        # Coordinates in the plane of the pattern
        local = axes.to_local(direction)
        x = local.x / (local.z * self.tan)
        y = local.y / (local.z * self.tan)

        # Sum over all spots
        total = mi.UnpolarizedSpectrum(0)
        for k in range(self.count):
            center = dr.gather(mi.Point2f, self.positions, k)
            sigma = dr.gather(mi.Float, self.sigmas, k)
            r2 = dr.square(x - center.x) + dr.square(y - center.y)
            power = dr.gather(mi.Float, self.fractions, k) * self.total
            density = power * dr.exp(-r2 / (2 * sigma * sigma)) / (2 * dr.pi * sigma * sigma)
            total += self.colors.at(mi.UInt32(k), wavelengths) * density

        # Cut off outside the field of view
        seen = (local.z > 0) & (dr.abs(x) <= 1) & (dr.abs(y) <= 1)
        per_sr = 1 / (self.tan**2 * local.z**3)
        return dr.select(seen, total * per_sr, 0)

    # Mitsuba calls the methods of all emitters in memory, also for other scenes. The integrator
    # alone samples this emitter, so that these methods return no light

    def _no_light(self, *args: Any, **kwargs: Any) -> Any:
        return mi.Spectrum(0)

    def _no_density(self, *args: Any, **kwargs: Any) -> Any:
        return mi.Float(0)

    eval = _no_light
    eval_direction = _no_light
    pdf_direction = _no_density
    pdf_position = _no_density

    def sample_ray(self, time, sample1, sample2, sample3, active=True):
        """Return a ray without light, because only the integrator samples the projector."""
        return dr.zeros(mi.Ray3f), mi.Spectrum(0)

    def sample_direction(self, it, sample, active=True):
        """Return a direction sample without light."""
        return dr.zeros(mi.DirectionSample3f), mi.Spectrum(0)

    def sample_position(self, time, sample, active=True):
        """Return a position sample of weight 0."""
        return dr.zeros(mi.PositionSample3f), mi.Float(0)

    def sample_wavelengths(self, si, sample, active=True):
        """Return the wavelengths of the interaction, without light."""
        return si.wavelengths, mi.Spectrum(0)

    def bbox(self):
        """Return an empty bounding box."""
        return mi.ScalarBoundingBox3f()

    def to_string(self) -> str:
        """Return kind, number of spots and power [W] as text."""
        kind = "confocal" if self.is_confocal else "fixed"
        return f"ConfocalProjector[{kind}, {self.count} spots, power = {self.power}]"


def _pose(frame: Any) -> np.ndarray:
    """Return the matrix of a transform, which must be finite and invertible."""
    matrix = getattr(frame, "matrix", 0)
    checks.require("frame", frame, np.size(matrix) == 16, "an mi.ScalarTransform4f")
    pose = np.array(matrix, dtype=np.float64).reshape(4, 4)
    # Do the axes span space?
    lengths = np.linalg.norm(pose[:3, :3], axis=0)
    spans = np.isfinite(pose).all() and lengths.min() > 0
    spans = spans and abs(np.linalg.det(pose[:3, :3] / lengths)) >= 1e-6
    allowed = "finite, with three axes that span space"
    checks.require("frame", pose[:3].tolist(), spans, allowed)
    return pose


def _pulse(props: mi.Properties) -> tuple[float, Pulse | None]:
    """Read a pulse.

    Returns:
        The width of a Gaussian pulse [m], and the pulse of a histogram, which replaces the Gaussian
        pulse. One of both is used.
    """
    kind = checks.one_of("pulse_type", props.get("pulse_type", "gaussian"), PULSES)
    width = props.get("pulse_width_opl", 0.01)
    start: Any = props.get("pulse_start_opl", 0.0)
    bin_width: Any = props.get("pulse_bin_width_opl", 0.001)
    values = props.get("pulse_values", None)

    # A Gaussian pulse
    if kind == "gaussian":
        return checks.width("pulse_width_opl", width), None

    # A histogram
    if values is None:
        raise ValueError(
            "pulse_values are missing. Add them, or choose a pulse_type other than 'histogram'"
        )
    from ...signals.pulses import SampledPulse

    return 0.0, SampledPulse(numbers("pulse_values", values).ravel(), start, bin_width)


def _spots(props: mi.Properties) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Read positions (n, 2), standard deviations (n,) and powers (n, 3) of the spots."""
    listed = {name: props.get(name, None) for name in LISTED}
    given = [name for name, value in listed.items() if value is not None]
    grid = _grid(props)
    if not given:
        return grid

    # All three lists must be given
    for name in LISTED:
        if name not in given:
            raise ValueError(f"{name} is missing. Add it, because {given[0]} is set")
    positions, sigmas, powers = (numbers(name, listed[name]).ravel() for name in LISTED)

    # The sizes must fit
    n = len(sigmas)
    if len(positions) != 2 * n or len(powers) not in (n, 3 * n):
        raise ValueError(
            f"spot_positions: {len(positions)} numbers, spot_sigmas: {n}, spot_intensities: "
            f"{len(powers)}; must be two, one, and one or three for each spot"
        )
    positions = positions.reshape(n, 2)
    powers = powers.reshape(n, -1)

    # Check the values
    if np.any(np.abs(positions) > 1):
        raise ValueError("spot_positions: must be from -1 to 1")
    for name, values in (("spot_sigmas", sigmas), ("spot_intensities", powers.mean(axis=1))):
        checks.number(name, float(values.min()), positive=True)
    return positions, sigmas, np.broadcast_to(powers, (n, 3)).copy()


def _grid(props: mi.Properties) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Read the spots of a grid, in the same form as `_spots`."""
    rows = checks.integer("grid_rows", props.get("grid_rows", 1), 1, MAX_SPOTS)
    columns = checks.integer("grid_cols", props.get("grid_cols", 1), 1, MAX_SPOTS)
    sigma = props.get("grid_sigma", 0.01)
    power = props.get("grid_intensity", 1.0)
    sigma = checks.number("grid_sigma", sigma, positive=True, unit="half fields of view")
    power = checks.number("grid_intensity", power, positive=True, unit="watts")
    spacing = checks.one_of("grid_spacing", props.get("grid_spacing", "uniform"), SPACINGS)
    seed = checks.integer("grid_seed", props.get("grid_seed", 0), 0, checks.MAX_SEED)
    n = checks.integer("grid_rows * grid_cols", rows * columns, 1, MAX_SPOTS)

    # Place the spots
    if spacing == "uniform":
        x = (2 * np.arange(columns) + 1) / columns - 1
        y = (2 * np.arange(rows) + 1) / rows - 1
        positions = np.stack(np.meshgrid(x, y), axis=-1).reshape(n, 2)
    else:
        positions = np.random.default_rng(seed).uniform(-1, 1, (n, 2))
    return positions, np.full(n, sigma), np.full((n, 3), power)


def numbers(name: str, value: Any) -> np.ndarray:
    """Convert an array, or text with commas or blanks, to an array of finite numbers."""
    try:
        if isinstance(value, str):
            value = [float(x) for x in value.replace(",", " ").split()]
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.array([])
    checks.require(name, value, array.size and np.all(np.isfinite(array)), "finite numbers")
    return array
