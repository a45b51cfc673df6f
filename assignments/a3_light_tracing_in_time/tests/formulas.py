"""Closed forms of light that a camera gets, in NumPy alone. Lengths in meters."""

from __future__ import annotations

import math

import numpy as np

from tofrender.course.judge.inputs import Inputs

inputs = Inputs(__file__)


class View:
    """A pinhole: `size` pixels (width, height), `fov` degrees across its width.

    `crop` is (x, y, width, height) in pixels, `shift` moves the window by parts of its width and
    of its height. A mirrored camera sees right as left; `aperture` and `focus` are a thin lens's.
    """

    def __init__(
        self,
        origin,
        target,
        fov=40.0,
        size=(8, 8),
        up=(0, 1, 0),
        crop=None,
        shift=(0.0, 0.0),
        mirrored=False,
        aperture=0.0,
        focus=1.0,
        **_,
    ):
        self.origin = np.array(origin, float)
        self.axis = _unit(np.array(target, float) - self.origin)
        self.left = _unit(np.cross(up, self.axis))
        self.up = np.cross(self.axis, self.left)
        self.left *= -1 if mirrored else 1
        self.half = math.tan(math.radians(fov) / 2)
        self.size = size
        self.shift = shift
        self.aperture = aperture
        self.focus = focus
        self.crop = (0, 0, *size) if crop is None else crop
        width, height = size
        whole = 4 * self.half**2 * height / width
        self.area = whole * self.crop[2] * self.crop[3] / (width * height)

    def direction(self, x, y):
        """Unit vectors through film positions [pixels of the crop]."""
        width, height = self.size
        across = (1 - 2 * ((x + self.crop[0]) / width + self.shift[0])) * self.half
        down = (1 - 2 * ((y + self.crop[1]) / height + self.shift[1])) * self.half * height / width
        d = self.axis + across[..., None] * self.left + down[..., None] * self.up
        return _unit(d)

    def position(self, p):
        """Film positions of points [pixels of the whole film], and their depth along the axis."""
        width, height = self.size
        way = np.asarray(p, float) - self.origin
        depth = way @ self.axis
        x = (1 - (way @ self.left) / depth / self.half) / 2 - self.shift[0]
        y = (1 - (way @ self.up) / depth / self.half * width / height) / 2 - self.shift[1]
        return np.stack([x * width, y * height], -1), depth

    def density(self, d):
        """Density of the directions of camera rays [1/sr]."""
        return 1 / (self.area * (d @ self.axis) ** 3)

    def pixels(self, count=8):
        """Directions through even points of each pixel, shape (height, width, count^2, 3)."""
        width, height = self.crop[2:]
        inside = (np.arange(count) + 0.5) / count
        a, b = (each.ravel() for each in np.meshgrid(inside, inside))
        x, y = np.meshgrid(np.arange(width), np.arange(height))
        return self.direction(x[..., None] + a, y[..., None] + b)

    def through_lens(self, count=12):
        """As `pixels`, from even points of the thin lens: where rays start, and directions."""
        u, v, a, b = even(count**2 * 16, 4)
        x, y = np.meshgrid(np.arange(self.size[0]), np.arange(self.size[1]))
        d = self.direction(x[..., None] + a, y[..., None] + b)
        r = self.aperture * np.sqrt(u)
        φ = 2 * math.pi * v
        offset = (r * np.cos(φ))[:, None] * self.left + (r * np.sin(φ))[:, None] * self.up
        sharp = d * (self.focus / (d @ self.axis))[..., None]
        return self.origin + offset, _unit(sharp - offset)


def _unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def even(count, dimensions):
    """Even points of the unit cube, shape (dimensions, count): powers of 1 / g, g^(n+1) = g + 1."""
    g = 2.0
    for _ in range(60):
        g = (1 + g) ** (1 / (dimensions + 1))
    steps = g ** -np.arange(1.0, dimensions + 1)
    return (0.5 + steps[:, None] * np.arange(count)) % 1


# ------------------------------------------------------------------------------------- floor


def on_floor(view, d, z=0.0, origin=None):
    """Where rays meet the plane at z, their lengths, and their cosines to its normal."""
    origin = view.origin if origin is None else origin
    length = (z - origin[..., 2]) / d[..., 2]
    return origin + length[..., None] * d, length, np.abs(d[..., 2])


def under_point(view, d, light, intensity, albedo=0.5, alpha=None, cone=None, origin=None):
    """A floor under a point light: radiance along rays, path lengths, and densities by area.

    The densities refer to the floor's points, from the camera and from the light. With `alpha`
    the floor is rough metal; with `cone` (target, cutoff, beam) [deg] the light is a spot with
    a uniform density in the cone.
    """
    x, seen, cos = on_floor(view, d, origin=origin)
    way = np.asarray(light, float) - x
    far = np.linalg.norm(way, axis=-1)
    cos_light = way[..., 2] / far
    f_cos = albedo / math.pi * cos_light
    if alpha is not None:
        f_cos = ggx(-d, way / far[..., None], alpha)
    spread = 1.0
    per_sr = 1 / (4 * math.pi)
    if cone is not None:
        spread, per_sr = spot(light, -way / far[..., None], *cone)
    radiance = f_cos * intensity * spread / far**2
    from_camera = view.density(d) * cos / seen**2
    from_light = cos_light / far**2 * per_sr
    return radiance, seen + far, from_camera, from_light


def spot(position, d, target, cutoff, beam):
    """Part of a spot's intensity in directions, and their density if they are even in its cone."""
    axis = _unit(np.asarray(target, float) - np.asarray(position, float))
    angle = np.degrees(np.arccos(np.clip(d @ axis, -1, 1)))
    part = np.clip((cutoff - angle) / (cutoff - beam), 0, 1)
    return part, (angle < cutoff) / (2 * math.pi * (1 - math.cos(math.radians(cutoff))))


def ggx(wi, wo, alpha):
    """Reflection of rough metal (GGX, no absorption) on a floor, times the cosine of wo."""
    half = _unit(wi + wo)[..., 2]
    d = 1 / (math.pi * alpha**2 * (half**2 + (1 - half**2) / alpha**2) ** 2)
    for w in (wi, wo):
        d = d * 2 / (1 + np.sqrt(1 + alpha**2 * (1 / w[..., 2] ** 2 - 1)))
    return d / (4 * wi[..., 2])


def under_panel(view, half, height, radiance, albedo=0.5, count=1 << 17):
    """A floor under a square light: parts of the film's mean, path lengths, and three densities.

    The densities belong to the strategies (0, 3), (1, 2) and (2, 1).
    """
    u, v, a, b = even(count, 4)
    d = view.direction(u * view.crop[2], v * view.crop[3])
    x, seen, cos = on_floor(view, d)
    y = np.stack([half * (2 * a - 1), half * (2 * b - 1), 0 * a + height], -1)
    way = y - x
    far = np.linalg.norm(way, axis=-1)
    cosine = height / far
    area = 4 * half**2
    part = albedo / math.pi * radiance * area * cosine**2 / far**2 / count
    by_camera = view.density(d) * cos / seen**2
    densities = [
        by_camera * cosine**2 / (math.pi * far**2),
        by_camera / area,
        cosine**2 / (area * math.pi * far**2),
    ]
    return part, seen + far, densities


# ------------------------------------------------------------------------------------ sphere


def sphere_bounce(n, radius, albedo, intensity):
    """Radiance of the n-th reflection, light and camera in the middle."""
    return albedo**n * intensity / (math.pi * radius**2)


def around_bubble(n, radius, bubble, albedo, intensity, index):
    """Radiance and first length of the n-th reflection, light and camera in a small bubble.

    The medium around the bubble fills the sphere. Light passes the bubble's surface straight,
    twice, and loses (1 - F)²; its radiance shrinks by the squared index on the way back.
    """
    reflected = ((index - 1) / (index + 1)) ** 2
    lost = (1 - reflected) ** 2 / index**2
    return lost * sphere_bounce(n, radius, albedo, intensity), 2 * (
        bubble + index * (radius - bubble)
    )


def sphere_shares(view, n, exponent, inner=True):
    """Shares of the strategies (1, t) to (s, 1) for n reflections, means over the film.

    All of a sphere's points are found with equal density by area from any of them; so strategies
    differ by the end that their path begins at: p from the camera, 1/4π from the light.
    """
    d = view.pixels(16)
    p = view.density(d) ** exponent
    q = (1 / (4 * math.pi)) ** exponent
    if inner:
        total = n * p + q
        return [float((p / total).mean())] * n + [float((q / total).mean())]
    return float((p / (p + q)).mean()), float((q / (p + q)).mean())


def in_sphere(view, d, radius):
    """Lengths of rays to a sphere around the origin, and its points' densities by area.

    The first is from the camera; the other from any of its points, and from a light in its middle.
    """
    along = d @ view.origin
    length = np.sqrt(along**2 + radius**2 - view.origin @ view.origin) - along
    cos = (length + along) / radius
    return length, view.density(d) * cos / length**2, 1 / (4 * math.pi * radius**2)


def shares(mine, count, other, power):
    """MIS weights of one of `count` equal strategies, and of one other strategy.

    The equal strategies have the density `mine`, the other strategy `other`, pixel by pixel.
    """
    mine = mine**power
    other = other**power
    total = count * mine + other
    return (mine / total).mean(-1), (other / total).mean(-1)


def chord_masses(edges, radius):
    """Shares of random chords, density r / 2R², between lengths."""
    return np.diff(np.clip(np.asarray(edges, float) / (2 * radius), 0, 1) ** 2)


# ------------------------------------------------------------------------------ two surfaces


def by_mirror(view, lamp, mirror, albedo, count=1 << 18):
    """Light of a spot that a floor z = 0 gets from itself, by a mirror above it.

    `lamp` is (position, intensity, target, cutoff, beam). Two surfaces and the mirror between them.

    Returns:
        Parts of the film's mean, path lengths, and densities of the paths from the camera (a
        connection to the lamp) and from the light.
    """
    u, v, a, b = even(count, 4)
    d = view.direction(u * view.size[0], v * view.size[1])
    x, seen, cos = on_floor(view, d)
    position, intensity, target, cutoff, beam = lamp
    position = np.array(position, float)
    top = 1 - math.cos(math.radians(cutoff))
    axis = _unit(np.array(target, float) - position)
    side = _unit(np.cross(axis, (0.3, 0.8, 0.1)))
    rays = _around(axis, side, np.cross(axis, side), 1 - a * top, 2 * math.pi * b)
    part, per_sr = spot(position, rays, target, cutoff, beam)
    far = -position[2] / rays[:, 2]
    y = position + far[:, None] * rays
    by_lamp = per_sr * np.abs(rays[:, 2]) / far**2
    y[:, 2] = 2 * mirror
    way = np.linalg.norm(y - x, axis=-1)
    each = (2 * mirror / way) ** 2 / (math.pi * way**2)
    part = part * intensity * 2 * math.pi * top * albedo**2 / math.pi * each / count
    by_camera = view.density(d) * cos / seen**2
    return part, seen + way + far, [by_camera * each, by_lamp * each]


def by_floor(view, ceiling, panel, radiance, albedo, screen=None, count=1 << 18):
    """Light of a panel that a ceiling gets from a floor z = 0.

    `panel` is (z, half) and faces down, around the z axis; a black `screen` is (x, y, z, half).

    Returns:
        Parts of the film's mean, path lengths, and densities of strategies (0, 4) to (3, 1).
    """
    u, v, a, b, e, f = even(count, 6)
    d = view.direction(u * view.size[0], v * view.size[1])
    x, seen, cos = on_floor(view, d, ceiling)
    rays = _around(*-np.eye(3)[::-1], np.sqrt(a), 2 * math.pi * b)  # by the cosine
    way = -ceiling / rays[:, 2]
    y = x + way[:, None] * rays
    lamp = np.stack([(2 * e - 1) * panel[1], (2 * f - 1) * panel[1], 0 * e + panel[0]], -1)
    far = np.linalg.norm(lamp - y, axis=-1)
    x_y = (ceiling / way) ** 2 / (math.pi * way**2)
    y_lamp = (panel[0] / far) ** 2 / (math.pi * far**2)
    area = 4 * panel[1] ** 2
    part = albedo**2 * radiance * area * y_lamp / count * ~_meets(x, y, (0, 0, *panel))
    if screen is not None:
        part = part * ~_meets(x, y, screen) * ~_meets(y, lamp, screen)
    by_camera = view.density(d) * cos / seen**2
    densities = [
        by_camera * x_y * y_lamp,
        by_camera * x_y / area,
        by_camera * y_lamp / area,
        y_lamp * x_y / area,
    ]
    return part, seen + way + far, densities


def _around(axis, u, v, cos, φ):
    """Directions at angles to an axis and around it."""
    sin = np.sqrt(1 - cos**2)
    return np.stack([cos, sin * np.cos(φ), sin * np.sin(φ)], -1) @ np.stack([axis, u, v])


def _meets(a, b, square):
    """Whether segments between points hit a square (x, y, z, half) across the z axis."""
    x, y, z, half = square
    t = (z - a[:, 2]) / (b[:, 2] - a[:, 2])
    at = a + t[:, None] * (b - a) - (x, y, z)
    return (t > 0) & (t < 1) & np.all(np.abs(at[:, :2]) < half, axis=-1)


# -------------------------------------------------------------------------------- refraction


def fresnel(cos_i, index):
    """Reflectance of unpolarized light; `index` is that behind the surface over that before."""
    sin_t2 = (1 - cos_i**2) / index**2
    cos_t = np.sqrt(np.maximum(1 - sin_t2, 0))
    s = (cos_i - index * cos_t) / (cos_i + index * cos_t)
    p = (index * cos_i - cos_t) / (index * cos_i + cos_t)
    return np.where(sin_t2 >= 1, 1, (s**2 + p**2) / 2), cos_t


def _landing(view, r, φ, z, power, opl, albedo):
    """Contribution to the film's mean of light with some power that hits a floor at (r, φ)."""
    p = np.stack([r * np.cos(φ), r * np.sin(φ), 0 * r + z], -1)
    position, depth = view.position(p)
    inside = (depth > 0) & np.all((position >= 0) & (position < view.size), axis=-1)
    way = p - view.origin
    seen = np.linalg.norm(way, axis=-1)
    cos = np.abs(way[:, 2]) / seen
    d = way / seen[:, None]
    part = power * albedo / math.pi * cos * view.density(d) / seen**2
    return np.where(inside, part, 0), opl + seen


def through_slab(
    view, bottom, top, light, intensity, albedo=0.5, index=1.5, order=0, count=1 << 18
):
    """Light that a slab lets through: parts of the film's mean, and path lengths.

    The order is how often both of its surfaces have reflected it before.
    """
    through = (2 * order + 1) * (top - bottom)
    u, v = even(count, 2)
    # Even in the half of all directions
    cos = u
    φ = 2 * math.pi * v
    reflected, inside = fresnel(cos, index)
    tan = np.sqrt(1 - cos**2) / cos
    tan_in = np.sqrt(1 - inside**2) / inside
    r = (light - top + bottom) * tan + through * tan_in
    opl = (light - top + bottom) / cos + index * through / inside
    power = 2 * math.pi * intensity * (1 - reflected) ** 2 * reflected ** (2 * order) / count
    return _landing(view, r, φ, 0.0, power, opl, albedo)


def into_water(view, depth, light, intensity, albedo=0.5, index=1.33, count=1 << 18):
    """Light that water lets in, on its floor: parts of the film's mean."""
    u, v = even(count, 2)
    reflected, inside = fresnel(u, index)
    r = (light - depth) * np.sqrt(1 - u**2) / u + depth * np.sqrt(1 - inside**2) / inside
    power = 2 * math.pi * intensity * (1 - reflected) / count
    return _landing(view, r, 2 * math.pi * v, 0.0, power, 0.0, albedo)[0]


def through_ball(view, radius, light, floor_z, intensity, albedo=0.5, index=1.5, count=1 << 18):
    """Light that a ball around the origin lets through at once, from a point above it."""
    u, v = even(count, 2)
    reach = 1 - math.sqrt(1 - (radius / light) ** 2)
    cos = 1 - u * reach  # even in the cone around the ball
    sin = np.sqrt(1 - cos**2)
    sin_i = sin * light / radius
    cos_i = np.sqrt(1 - sin_i**2)
    reflected, cos_t = fresnel(cos_i, index)
    near = light * cos - radius * cos_i
    chord = 2 * radius * cos_t
    # In the plane of incidence: each surface turns the ray by θi - θt toward the axis
    angle = np.arcsin(sin)
    turned = np.arccos(cos_i) - np.arccos(cos_t)
    x0 = near * sin
    z0 = light - near * cos
    x1 = x0 + chord * np.sin(angle - turned)
    z1 = z0 - chord * np.cos(angle - turned)
    out = angle - 2 * turned
    far = (z1 - floor_z) / np.cos(out)
    opl = near + index * chord + far
    power = 2 * math.pi * reach * intensity * (1 - reflected) ** 2 / count
    return _landing(view, x1 + far * np.sin(out), 2 * math.pi * v, floor_z, power, opl, albedo)
