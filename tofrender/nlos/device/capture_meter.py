"""Sensor plugin `nlos_capture_meter`: measures a grid of points on a relay wall."""

from __future__ import annotations

import warnings
from typing import Any

import drjit as dr
import mitsuba as mi

from ...runtime import checks
from ...runtime.backend import tracing_lock
from .laser import axis, find_laser


class NLOSCaptureMeter(mi.Sensor):
    """Sensor that measures the wall to which it is attached (plugin `nlos_capture_meter`).

    Each pixel of its film looks at one point, from `sensor_origin`. The point is the center of the
    pixel's cell in the wall's uv square. A rectangle is the best wall, because equal cells in uv
    have equal areas there.

    | parameter | default | meaning |
    |---|---|---|
    | `sensor_origin` | (0, 0, 0) | position of the sensor [m] |
    | `laser_origin` | none | new position of the scene's laser [m] |
    | `laser_lookat_pixel` | none | pixel at which the laser is aimed; (0, 0) is a pixel's center |
    | `laser_lookat_3d` | none | point at which the laser is aimed, instead of a pixel [m] |
    | `confocal` | none | default of `capture_type` of a `transient_nlos_path` |
    | `original_film_width`, `original_film_height` | none | see below |

    Some tools capture point by point and set the size of an original film. Then the film itself has
    one pixel, which looks at the laser spot. `account_first_and_last_bounces` is accepted with a
    warning, because the integrator has this parameter.

    Example:
        >>> film = {"type": "transient_hdr_film", "width": 2, "height": 2}
        >>> meter = {"type": "nlos_capture_meter", "sensor_origin": [0, 0, 1], "film": film}
        >>> scene = mi.load_dict({"type": "scene", "w": {"type": "rectangle", "meter": meter}})
        >>> ray, _ = scene.sensors()[0].sample_ray(0, 0.5, [0.75, 0.25], 0.5)
        >>> scene.ray_intersect(mi.Ray3f(ray)).p
        [[0.5, -0.5, 0]]
    """

    looks_at_pixel_centers = True

    def __init__(self, props: mi.Properties) -> None:
        # Position of the sensor
        super().__init__(props)
        self.origin = _point(props, "sensor_origin") or [0.0, 0.0, 0.0]

        # Position and aim of the laser. A pixel (-1, -1) is mitransient's default
        self.laser_origin = _point(props, "laser_origin")
        pixel = _point(props, "laser_lookat_pixel")
        point = _point(props, "laser_lookat_3d")
        if pixel is not None and pixel[:2] != [-1, -1]:
            self.laser_target: Any = ("pixel", pixel[:2])
        else:
            self.laser_target = None if point is None else ("3d", point)

        # Capture type
        confocal = props.get("confocal", None)
        self.confocal = None if confocal is None else checks.boolean("confocal", confocal)

        # A parameter of the integrator
        legs = "account_first_and_last_bounces"
        if legs in props:
            checks.boolean(legs, props[legs])
            warnings.warn(
                f"{legs} of nlos_capture_meter: has no effect; transient_nlos_path has it",
                stacklevel=2,
            )

        # With an original film, the only pixel follows the laser
        self.follows_laser = self._is_one_pixel(props)
        self.laser_point: mi.Point3f | None = None

    def _is_one_pixel(self, props: mi.Properties) -> bool:
        """Return whether the film is one pixel of an original film."""
        size = list(self.film().size())
        names = ("original_film_width", "original_film_height")
        given = [props.get(name, None) for name in names]
        if given == [None, None] or given == size:
            return False
        for name, value in zip(names, given, strict=True):
            checks.integer(name, value, 1, checks.MAX_SIZE)
        allowed = f"the film's {size}, or the film 1 x 1"
        checks.require(", ".join(names), given, size == [1, 1], allowed)
        return True

    def world_transform(self) -> mi.Transform4f:
        """Return a translation to the sensor's origin, without a rotation."""
        return mi.Transform4f().translate(mi.Point3f(*self.origin))

    def targets(self, sample: mi.Point2f, active: mi.Bool | bool = True) -> mi.Point3f:
        """Return points of the wall [m] for samples of the film's crop window in [0, 1)^2."""
        if self.laser_point is not None:
            return self.laser_point
        film = self.film()
        size = mi.ScalarVector2f(film.size())
        crop = mi.ScalarVector2f(film.crop_size())
        offset = mi.ScalarVector2f(film.crop_offset())
        pixel = dr.floor(sample * crop) + offset
        return self.get_shape().sample_position(0.0, (pixel + 0.5) / size, active).p

    def misplaced_aim(self) -> str:
        """Return an error message if the laser is aimed at a missing pixel, otherwise ""."""
        kind, target = self.laser_target
        size = list(self.film().size())
        if kind == "3d" or all(-0.5 <= k <= n - 0.5 for k, n in zip(target, size, strict=True)):
            return ""
        return f"laser_lookat_pixel = {target}: must be a pixel of the film, which has {size}"

    def aim(self) -> mi.Point3f:
        """Return the point at which the laser is aimed [m]."""
        kind, target = self.laser_target
        if kind == "3d":
            return mi.Point3f(*target)
        uv = [(k + 0.5) / n for k, n in zip(target, self.film().size(), strict=True)]
        return self.get_shape().sample_position(0.0, mi.Point2f(*uv), True).p

    @tracing_lock()
    def follow_laser(self, scene: mi.Scene) -> None:
        """Aim the sensor at the laser spot, if the film is one pixel of an original film."""
        if self.follows_laser:
            # Import here, because editions without `paths` contain this sensor
            from ...paths.surfaces import first_surface

            si = first_surface(scene, mi.Ray3f(*axis(find_laser(scene))))
            self.laser_point = dr.select(si.is_valid(), si.p, mi.Point3f(*self.origin) + 1)

    def sample_ray(self, time, sample1, sample2, sample3, active=True):
        """Sample the ray from the sensor to a film sample's point of the wall."""
        d = dr.normalize(self.targets(mi.Point2f(sample2), active) - mi.Point3f(*self.origin))
        wavelengths = []
        weight = mi.Spectrum(1)
        if mi.is_spectral:
            wavelengths, weight = mi.sample_rgb_spectrum(mi.sample_shifted(sample1))
        return mi.RayDifferential3f(mi.Point3f(*self.origin), d, time, wavelengths), weight

    sample_ray_differential = sample_ray

    def to_string(self) -> str:
        """Return position and film as text."""
        return f"NLOSCaptureMeter[sensor_origin = {self.origin}, film = {self.film()}]"


def _point(props: mi.Properties, name: str) -> list[float] | None:
    """Read a parameter with three numbers. Return None without a value."""
    value: Any = props.get(name, None)
    return None if value is None else checks.point(name, value)
