"""Camera rays, and the point on the sensor where path lengths start."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..films.contribution import CameraSample
from ..runtime.interface import world_transform
from ..signals.polarization import sensor_frame
from .wavefronts import Wavefronts


@dataclass(frozen=True)
class Tile:
    """Part of the pixels of a larger film. The tile is rendered on a smaller film without crop."""

    x: int  # First column of the tile, in the crop window of the larger film
    y: int  # First row of the tile
    whole: mi.Film  # The larger film

    def numbers(self, film: mi.Film, pixel: mi.UInt32) -> mi.UInt32:
        """Convert pixel indices in the sampled area of the tile to indices in the larger film.

        Args:
            film: Film of the tile.
            pixel: Pixel indices, row by row in the sampled area of `film`.
        """
        tile_width = sampled_size(film)[0]
        row = pixel // tile_width
        column = pixel - row * tile_width

        # Opaque numbers give one kernel for all tiles
        x = dr.opaque(mi.UInt32, self.x)
        y = dr.opaque(mi.UInt32, self.y)
        whole_width = dr.opaque(mi.UInt32, sampled_size(self.whole)[0])
        return (row + y) * whole_width + column + x


def sampled_size(film: mi.Film) -> tuple[int, int]:
    """Return width and height [pixels] of the sampled area: the crop, and a filter's border."""
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
    """Sample one camera ray through each pixel.

    Args:
        sensor: The sensor.
        film: Film of the sensor, a film of the same size, or the film of the `tile`.
        sampler: The sampler.
        pixel: Pixel indices, row by row in the sampled area of `film`.
        tile: Position of `film` on the sensor's film, None if `film` shows all pixels.
        scene: The scene, which a `distant` sensor with a `target` needs.
    """
    # Sample a position on the film
    corner = pixel_corner(film, pixel)
    is_centered = getattr(sensor, "looks_at_pixel_centers", False)
    position = corner + (mi.Point2f(0.5) if is_centered else sampler.next_2d())

    # Find this position in the sensor's crop window. Opaque numbers give one kernel for all tiles
    crop_size = mi.ScalarVector2f((film if tile is None else tile.whole).crop_size())
    if tile is None:
        in_crop = position - mi.ScalarPoint2f(film.crop_offset())
    else:
        offset = mi.Vector2f(dr.opaque(mi.Float, tile.x), dr.opaque(mi.Float, tile.y))
        in_crop = position + offset

    # Sample aperture, time and wavelengths
    aperture = sampler.next_2d() if sensor.needs_aperture_sample() else mi.Point2f(0.5)
    time = sensor.shutter_open()
    if sensor.shutter_open_time() > 0:
        time += sampler.next_1d() * sensor.shutter_open_time()
    wavelength = sampler.next_1d() if mi.is_spectral else mi.Float(0)

    # Sample the ray
    ray, weight = sensor.sample_ray_differential(time, wavelength, in_crop / crop_size, aperture)
    return CameraSample(
        ray=ray,
        origin=ray_origin(sensor, ray, scene),
        weight=mi.unpolarized_spectrum(weight),
        position=corner if film.rfilter().is_box_filter() else position,
        frame=sensor_frame(sensor, ray),
    )


def pixel_corner(film: mi.Film, pixel: mi.UInt32) -> mi.Point2f:
    """Return the upper left corners of pixels on the film [pixels].

    Args:
        film: The film.
        pixel: Pixel indices, row by row in the sampled area.
    """
    width, _ = sampled_size(film)
    y = pixel // width
    x = pixel - y * width
    border = film.rfilter().border_size() if film.sample_border() else 0
    return mi.Point2f(x, y) + mi.Vector2f(film.crop_offset()) - border


def ray_origin(sensor: mi.Sensor, ray: mi.Ray3f, scene: mi.Scene | None = None) -> mi.Point3f:
    """Return the point on the sensor where a camera ray and its path length start.

    Mitsuba starts the rays of its projective cameras at the near plane. Therefore `si.t` is too
    short by near_clip / cos(angle to the axis), which is 10 mm or more with the default near clip.

    All rays of a `distant` sensor start on one plane, which touches the sphere around the scene.
    With a `target`, Mitsuba starts each ray two radii of the scene before the target point, so that
    lengths would not depend on depth. In this case, the result is on the plane nevertheless.

    Args:
        sensor: The sensor.
        ray: Camera rays of this sensor.
        scene: The scene, which a `distant` sensor with a `target` needs.

    Raises:
        ValueError: The scene is missing.
    """
    if not isinstance(sensor, mi.ProjectiveCamera):
        return _on_plane(scene, ray) if _has_target(sensor) else mi.Point3f(ray.o)

    # Go back from the near plane along the ray. `axis` has the scale of the sensor, like near_clip
    axis = world_transform(sensor) @ mi.Vector3f(0, 0, 1)
    near_clip = mi.traverse(sensor)["near_clip"]
    return ray.o - ray.d * (near_clip * dr.squared_norm(axis) / dr.dot(ray.d, axis))


def _has_target(sensor: mi.Sensor) -> bool:
    """Return whether a sensor is a `distant` sensor with a target.

    Only the text of a sensor shows its target.
    """
    is_distant = isinstance(sensor, mi.Sensor) and sensor.class_name() == "DistantSensorImpl"
    return is_distant and "target = none" not in str(sensor)


def _on_plane(scene: mi.Scene | None, ray: mi.Ray3f) -> mi.Point3f:
    """Return the start of the path length of a ray of a `distant` sensor with a target.

    The start is on the plane perpendicular to the ray that touches the sphere around the scene on
    the side from which the ray comes.

    Args:
        scene: The scene. None is refused.
        ray: The camera ray.

    Raises:
        ValueError: The scene is missing.
    """
    if scene is None:
        raise ValueError(
            "sensor: a distant sensor with a target needs the scene. Pass `scene` as well"
        )
    sphere = Wavefronts.around(scene, None)
    sphere.radius *= 1 + mi.math.RayEpsilon  # As in Mitsuba's sensors
    return ray.o - ray.d * sphere.length(ray.o, -ray.d)


def behind_emitters(scene: mi.Scene, ray: mi.Ray3f) -> mi.Ray3f:
    """Return rays that start behind all area lights in front of the first other surface.

    Derivatives of the result are derivatives of the given rays, at a fixed distance.
    """
    # Find the new origins without derivatives
    with dr.suspend_grad():
        behind = _behind_emitters(scene, ray)
        passed = dr.norm(behind.o - ray.o)

    # Attach the derivatives of the given rays
    behind.o = dr.replace_grad(behind.o, dr.fma(ray.d, passed, ray.o))
    behind.d = dr.replace_grad(behind.d, ray.d)
    return behind


@dr.syntax
def _behind_emitters(scene: mi.Scene, ray: mi.Ray3f) -> mi.Ray3f:
    """Move the origins of rays behind all area lights in front of the first other surface."""
    ray = mi.Ray3f(ray)
    passing = mi.Bool(True)
    while passing:
        si = scene.ray_intersect(ray, passing)
        passing &= si.is_valid() & (si.shape.emitter() != None)  # noqa: E711 (a Dr.Jit mask)
        ray[passing] = si.spawn_ray(ray.d)
    return ray
