"""Camera rays with the point that path lengths are measured from."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..runtime.interface import world_transform
from ..signals.polarisation import sensor_frame
from .wavefronts import Wavefronts


@dataclass
class CameraSample:
    """Rays through random points of given pixels, an array of any width."""

    ray: mi.Ray3f  # rays in world space; they start at the near plane
    origin: mi.Point3f  # where lengths start: the sensor's position, or the point on its lens [m]
    # importance of each ray over its density, of type `mi.UnpolarizedSpectrum`
    weight: mi.UnpolarizedSpectrum
    # position on the film [pixels], crop offset included; the pixel's corner if the film has a box
    # filter, so that rounding cannot move a sample to the next pixel
    position: mi.Point2f
    # matrix that turns polarised light of each ray into the sensor's frame, or None
    frame: mi.Spectrum | None = None


@dataclass(frozen=True)
class Tile:
    """A part of a film's pixels, on a film of its own that has no crop."""

    x: int  # first column in the crop window of the whole film
    y: int  # first row there
    whole: mi.Film

    def numbers(self, film: mi.Film, pixel: mi.UInt32) -> mi.UInt32:
        """Convert pixel indices in the tile's sampled area to those in the whole film's."""
        own, width = sampled_size(film)[0], sampled_size(self.whole)[0]
        row = pixel // own
        x, y, width = (dr.opaque(mi.UInt32, n) for n in (self.x, self.y, width))
        return (row + y) * width + (pixel - row * own) + x


def sampled_size(film: mi.Film) -> tuple[int, int]:
    """Return width and height [pixels] of the area that camera rays must cover."""
    border = 2 * film.rfilter().border_size() if film.sample_border() else 0
    width, height = film.crop_size()
    return int(width) + border, int(height) + border


def sample_camera(
    sensor: mi.Sensor,
    film: mi.Film,
    sampler: mi.Sampler,
    pixel: mi.UInt32,
    tile: Tile | None = None,
    scene: mi.Scene | None = None,
) -> CameraSample:
    """Sample one ray through each pixel, given by indices row by row in the sampled area.

    The film is the sensor's own or one of the same size; else a `tile` says where it is there. The
    `scene` is needed for a `distant` sensor with a `target`.
    """
    corner = pixel_corner(film, pixel)
    centred = getattr(sensor, "looks_at_pixel_centers", False)
    position = corner + (mi.Point2f(0.5) if centred else sampler.next_2d())
    crop_size = mi.ScalarVector2f((film if tile is None else tile.whole).crop_size())
    if tile is None:
        in_crop = position - mi.ScalarPoint2f(film.crop_offset())
    else:  # One kernel for all tiles
        in_crop = position + mi.Vector2f(*(dr.opaque(mi.Float, n) for n in (tile.x, tile.y)))
    aperture = sampler.next_2d() if sensor.needs_aperture_sample() else mi.Point2f(0.5)
    time = sensor.shutter_open()
    if sensor.shutter_open_time() > 0:
        time += sampler.next_1d() * sensor.shutter_open_time()
    wavelength = sampler.next_1d() if mi.is_spectral else mi.Float(0)

    ray, weight = sensor.sample_ray_differential(time, wavelength, in_crop / crop_size, aperture)
    return CameraSample(
        ray=ray,
        origin=ray_origin(sensor, ray, scene),
        weight=mi.unpolarized_spectrum(weight),
        position=corner if film.rfilter().is_box_filter() else position,
        frame=sensor_frame(sensor, ray),
    )


def pixel_corner(film: mi.Film, pixel: mi.UInt32) -> mi.Point2f:
    """Return the upper left corner of pixels, by their index row by row in the sampled area."""
    width, _ = sampled_size(film)
    y = pixel // width
    x = pixel - y * width
    border = film.rfilter().border_size() if film.sample_border() else 0
    return mi.Point2f(x, y) + mi.Vector2f(film.crop_offset()) - border


def ray_origin(sensor: mi.Sensor, ray: mi.Ray3f, scene: mi.Scene | None = None) -> mi.Point3f:
    """Return the point on the sensor that a camera ray comes from.

    Mitsuba starts the rays of its projective cameras at the near plane, so that `si.t` is short by
    near_clip / cos(angle to the axis): 10 mm and more with the default near clip. It starts each
    ray of a `distant` sensor with a `target` two radii of the scene before the target point, so
    that lengths would not depend on depth. Without a target, all rays start on one plane, which
    touches the sphere around the scene. Here that plane is the origin of both.
    """
    if not isinstance(sensor, mi.ProjectiveCamera):
        return _on_plane(scene, ray) if _has_target(sensor) else mi.Point3f(ray.o)
    axis = world_transform(sensor) @ mi.Vector3f(0, 0, 1)  # Scaled as near_clip is
    near_clip = mi.traverse(sensor)["near_clip"]
    return ray.o - ray.d * (near_clip * dr.squared_norm(axis) / dr.dot(ray.d, axis))


def _has_target(sensor: mi.Sensor) -> bool:
    """Whether a sensor is a `distant` one with a target, which only its text shows."""
    is_distant = isinstance(sensor, mi.Sensor) and sensor.class_name() == "DistantSensorImpl"
    return is_distant and "target = none" not in str(sensor)


def _on_plane(scene: mi.Scene | None, ray: mi.Ray3f) -> mi.Point3f:
    """Return the point of a ray on the plane that touches the sphere around the scene."""
    if scene is None:
        raise ValueError(
            "sensor: a distant sensor with a target needs the scene. Pass `scene` as well"
        )
    sphere = Wavefronts.around(scene, None)
    sphere.radius *= 1 + mi.math.RayEpsilon  # As Mitsuba's sensors do
    return ray.o - ray.d * sphere.length(ray.o, -ray.d)


def behind_emitters(scene: mi.Scene, ray: mi.Ray3f) -> mi.Ray3f:
    """Let rays pass through all area lights that they meet before any other surface."""
    with dr.suspend_grad():
        behind = _behind_emitters(scene, ray)
        passed = dr.norm(behind.o - ray.o)
    behind.o = dr.replace_grad(behind.o, dr.fma(ray.d, passed, ray.o))
    behind.d = dr.replace_grad(behind.d, ray.d)
    return behind


@dr.syntax
def _behind_emitters(scene: mi.Scene, ray: mi.Ray3f) -> mi.Ray3f:
    """Move rays' origins behind the area lights that they meet first."""
    ray = mi.Ray3f(ray)
    passing = mi.Bool(True)
    while passing:
        si = scene.ray_intersect(ray, passing)
        passing &= si.is_valid() & (si.shape.emitter() != None)  # noqa: E711 (a Dr.Jit mask)
        ray[passing] = si.spawn_ray(ray.d)
    return ray
