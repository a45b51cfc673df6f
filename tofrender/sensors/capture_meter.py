"""Sensor plugin `nlos_capture_meter`: looks at a grid of points on a relay wall."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from .. import checks


class NLOSCaptureMeter(mi.Sensor):
    """A sensor that looks at the wall it is a child of (plugin `nlos_capture_meter`).

    Each pixel of its film looks at one point: the centre of the pixel's cell in the wall's uv
    square, from `sensor_origin`. All samples of a pixel go the same way. A rectangle is the best
    wall, since equal cells in uv are equal there.

    | parameter | default | meaning |
    |---|---|---|
    | `sensor_origin` | (0, 0, 0) | where the sensor is [m] |
    | `original_film_width`, `original_film_height` | none | accepted if equal to the film's |

    Example:
        >>> film = {"type": "transient_hdr_film", "width": 2, "height": 2}
        >>> meter = {"type": "nlos_capture_meter", "sensor_origin": [0, 0, 1], "film": film}
        >>> scene = mi.load_dict({"type": "scene", "w": {"type": "rectangle", "meter": meter}})
        >>> ray, _ = scene.sensors()[0].sample_ray(0, 0.5, [0.75, 0.25], 0.5)
        >>> scene.ray_intersect(mi.Ray3f(ray)).p
        [[0.5, -0.5, 0]]
    """

    looks_at_pixel_centres = True

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        origin: Any = props.get("sensor_origin", mi.ScalarPoint3f(0))
        self.origin = [checks.metres("sensor_origin", float(x)) for x in origin]
        checks.boolean(
            "account_first_and_last_bounces", props.get("account_first_and_last_bounces", True)
        )
        for name, size in zip(("width", "height"), self.film().size(), strict=True):
            given = props.get(f"original_film_{name}", None)
            if given is not None and given != size:
                raise ValueError(
                    f"original_film_{name} = {given}: must be left out; give the film that {name}, "
                    "a confocal capture renders all points at once"
                )

    def world_transform(self) -> mi.Transform4f:
        """Moves the origin to the sensor; its axes are those of the world."""
        return mi.Transform4f().translate(mi.Point3f(*self.origin))

    def targets(self, sample: mi.Point2f, active: mi.Bool = True) -> mi.Point3f:
        """Points of the wall that samples of the film's crop window, in [0, 1)^2, look at."""
        film = self.film()
        size = mi.ScalarVector2f(film.size())
        crop, offset = mi.ScalarVector2f(film.crop_size()), mi.ScalarVector2f(film.crop_offset())
        pixel = dr.floor(sample * crop) + offset
        return self.get_shape().sample_position(0.0, (pixel + 0.5) / size, active).p

    def sample_ray(self, time, sample1, sample2, sample3, active=True):
        """The ray from the sensor to the point of the wall that a film sample belongs to."""
        d = dr.normalize(self.targets(mi.Point2f(sample2), active) - mi.Point3f(*self.origin))
        wavelengths, weight = [], mi.Spectrum(1)
        if mi.is_spectral:
            wavelengths, weight = mi.sample_rgb_spectrum(mi.sample_shifted(sample1))
        return mi.RayDifferential3f(mi.Point3f(*self.origin), d, time, wavelengths), weight

    def sample_ray_differential(self, time, sample1, sample2, sample3, active=True):
        """As `sample_ray`; there is nothing next to a pixel's point."""
        return self.sample_ray(time, sample1, sample2, sample3, active)

    def to_string(self) -> str:
        """Where it is, and its film."""
        return f"NLOSCaptureMeter[sensor_origin = {self.origin}, film = {self.film()}]"


for name in ("nlos_capture_meter", "tofrender_nlos_capture_meter"):
    mi.register_sensor(name, NLOSCaptureMeter)
