"""Closed forms of light whose arrival depends on a parameter θ, in NumPy alone.

Each form is a function of θ that returns `(light, opl)`: the light of a set of paths, which add up
to a measured value, and their lengths [m]. Directions and points of a surface that no θ moves are
quadrature nodes. The forms take complex θ, and `derived` differentiates them by a complex step,
f'(θ) = Im f(θ + ih) / h, which is exact to rounding. What is seen of the paths is linear in the
light: bins of a film with a Gaussian pulse, a gate, a phasor, a correlation.

Lengths are in meters, radiances in W / (m² sr). Nothing here knows the renderer.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial.legendre import leggauss
from scipy.special import ndtr

SPEED_OF_LIGHT = 299_792_458.0
TINY = 1e-30
Form = Callable[[Any], tuple[Any, Any]]


@dataclass
class Arrived:
    """Light of paths, their lengths [m], and the derivatives of both; arrays of shape (n,)."""

    light: np.ndarray
    opl: np.ndarray
    d_light: np.ndarray
    d_opl: np.ndarray

    def moments(self) -> np.ndarray:
        """Sum of light, and of length times light."""
        return np.array([self.light.sum(), (self.opl * self.light).sum()])

    def d_moments(self) -> np.ndarray:
        moment = self.opl * self.d_light + self.d_opl * self.light
        return np.array([self.d_light.sum(), moment.sum()])


def derived(form: Form, theta: float) -> Arrived:
    """Light and lengths of a form, and their derivatives."""
    light, opl = np.broadcast_arrays(*(np.atleast_1d(a) for a in form(theta + TINY * 1j)))
    light, opl = light.astype(complex), opl.astype(complex)
    return Arrived(light.real, opl.real, light.imag / TINY, opl.imag / TINY)


def density(x) -> np.ndarray:
    return np.exp(-0.5 * np.square(x)) / math.sqrt(2 * math.pi)


@dataclass
class Bins:
    """Bins from `start`, of width `width` [m], of light with a Gaussian pulse of deviation σ [m].

    A path of the length o gives the bin [a, b] the part P((b - o) / σ) - P((a - o) / σ). Along o it
    changes by [p((a - o) / σ) - p((b - o) / σ)] / σ, and along σ by
    [(a - o) p((a - o) / σ) - (b - o) p((b - o) / σ)] / σ².
    """

    start: float
    width: float
    count: int
    sigma: float

    @property
    def edges(self) -> np.ndarray:
        return self.start + self.width * np.arange(self.count + 1)

    @property
    def centers(self) -> np.ndarray:
        return 0.5 * (self.edges[1:] + self.edges[:-1])

    def _ends(self, light: Arrived) -> tuple[np.ndarray, np.ndarray]:
        """Edges in pulse widths from each path (edges, paths), and the density there."""
        x = (self.edges[:, None] - light.opl) / self.sigma
        return x, density(x)

    def value(self, light: Arrived) -> np.ndarray:
        return np.diff(ndtr(self._ends(light)[0]), axis=0) @ light.light

    def derivative(self, light: Arrived) -> np.ndarray:
        x, p = self._ends(light)
        moved = -np.diff(p, axis=0) / self.sigma @ (light.light * light.d_opl)
        return np.diff(ndtr(x), axis=0) @ light.d_light + moved

    def by_width(self, light: Arrived) -> np.ndarray:
        x, p = self._ends(light)
        return -np.diff(x * p, axis=0) / self.sigma @ light.light


@dataclass
class Gate:
    """A gate at the length `target` [m] of light with a Gaussian pulse of deviation σ [m].

    A path of the length o gives p(x / σ) / σ, x = target - o. Along o this changes by
    x p(x / σ) / σ³, and along σ by p(x / σ) / σ (x² / σ³ - 1 / σ).
    """

    target: float
    sigma: float

    def value(self, light: Arrived) -> np.ndarray:
        x = (self.target - light.opl) / self.sigma
        return np.array([light.light @ density(x)]) / self.sigma

    def derivative(self, light: Arrived) -> np.ndarray:
        x = (self.target - light.opl) / self.sigma
        change = light.d_light + light.light * light.d_opl * x / self.sigma
        return np.array([change @ density(x)]) / self.sigma

    def by_width(self, light: Arrived) -> np.ndarray:
        x = (self.target - light.opl) / self.sigma
        return np.array([light.light @ (density(x) * (x * x - 1))]) / self.sigma**2


@dataclass
class Phasor:
    """Real and imaginary part of the sum of L exp(i k o), k = 2 π f / c."""

    frequency_hz: float

    @property
    def k(self) -> float:
        return 2 * math.pi * self.frequency_hz / SPEED_OF_LIGHT

    def value(self, light: Arrived) -> np.ndarray:
        z = (light.light * np.exp(1j * self.k * light.opl)).sum()
        return np.array([z.real, z.imag])

    def derivative(self, light: Arrived) -> np.ndarray:
        change = light.d_light + 1j * self.k * light.light * light.d_opl
        z = (change * np.exp(1j * self.k * light.opl)).sum()
        return np.array([z.real, z.imag])


@dataclass
class Correlation:
    """The sum of L cos(k o + φ), φ the modulation's phase offset [rad]."""

    frequency_hz: float
    phase_offset: float = 0.0

    def _turned(self, parts: np.ndarray) -> np.ndarray:
        a = self.phase_offset
        return np.array([parts[0] * math.cos(a) - parts[1] * math.sin(a)])

    def value(self, light: Arrived) -> np.ndarray:
        return self._turned(Phasor(self.frequency_hz).value(light))

    def derivative(self, light: Arrived) -> np.ndarray:
        return self._turned(Phasor(self.frequency_hz).derivative(light))


def dot(a, b):
    return (np.asarray(a) * np.asarray(b)).sum(axis=-1)


def length(a):
    """Euclidean length, which complex numbers keep analytic."""
    return np.sqrt(dot(a, a))


def unit_interval(order: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss' nodes on [0, 1], and their weights."""
    x, w = leggauss(order)
    return 0.5 + 0.5 * x, 0.5 * w


def film_directions(
    origin, target, fov: float, up=(0, 1, 0), order: int = 16
) -> tuple[np.ndarray, np.ndarray]:
    """Unit directions of a square film's rays (n, 3), and weights of a mean over the film."""
    forward = np.subtract(target, origin)
    forward = forward / length(forward)
    left = np.cross(up, forward)
    left = left / length(left)
    x, w = leggauss(order)
    u, v = (a.ravel() * math.tan(math.radians(fov / 2)) for a in np.meshgrid(x, x))
    d = forward + np.outer(u, left) + np.outer(v, np.cross(forward, left))
    return d / length(d)[:, None], np.outer(w, w).ravel() / 4


@dataclass
class View:
    """A pinhole camera at `origin` that looks at `target`; a square film of `fov` degrees."""

    origin: Any
    target: Any
    fov: float = 20.0
    up: Any = (0, 1, 0)

    def on_plane(self, point, normal, moved=0, order: int = 40):
        """What the film sees of a plane: points, lengths to them, weights; `moved` shifts it."""
        d, w = film_directions(self.origin, self.target, self.fov, self.up, order)
        origin = np.asarray(self.origin) + moved
        r = dot(np.asarray(point) - origin, normal) / dot(d, normal)
        return origin + r[:, None] * d, r, w


def lit_by_point(p, normal, light, intensity):
    """Irradiance I cos / r² of points of a plane, and r."""
    to_light = light - p
    r = length(to_light)
    return intensity * dot(to_light, normal) / r**3, r


def lit_plane(
    view: View, point, normal, light, intensity: float, albedo: float, moved=0
) -> tuple[Any, Any]:
    """g1: a diffuse plane under a point light. The fixed rays of the camera meet it at p."""
    p, r, w = view.on_plane(point, normal, moved)
    irradiance, to_light = lit_by_point(p, normal, light, intensity)
    return w * albedo / math.pi * irradiance, r + to_light


def corridor(
    view: View, floor, ceiling, light, intensity: float, albedos: tuple[Any, Any]
) -> tuple[Any, Any]:
    """g1': a floor and a ceiling z = const around a point light; the camera sees the floor.

    Light that met the floor alone, and light that met the ceiling first: that reflects the radiance
    L_c = ρ_c / π I cos / s² to the floor, of which ρ_f / π L_c cos cos / r² dA goes on. The
    ceiling's nodes are polar around the light: ρ = tan α.
    """
    up = np.array([0.0, 0, 1])
    lamp = np.asarray(light)
    p, seen, w = view.on_plane(floor * up, up, order=10)
    irradiance, to_light = lit_by_point(p, up, lamp, intensity)
    α, w_α = unit_interval(32)
    α, w_α = 0.5 * math.pi * α, 0.5 * math.pi * w_α
    φ = 2 * math.pi * (np.arange(16) + 0.5) / 16
    ρ = np.tan(α)[:, None]
    area = (w_α * np.tan(α) / np.cos(α) ** 2)[:, None] * 2 * math.pi / 16 * np.ones(16)
    x, y = lamp[0] + ρ * np.cos(φ), lamp[1] + ρ * np.sin(φ)
    q = np.stack([a.ravel() for a in (x, y, np.zeros_like(x))], -1) + ceiling * up
    lit, s = lit_by_point(q, -up, lamp, intensity)
    between = q - p[:, None]
    r = length(between)
    kernel = (ceiling - floor) ** 2 / r**4 * area.ravel()
    once = w * albedos[0] / math.pi * irradiance
    twice = w[:, None] * albedos[0] * albedos[1] / math.pi**2 * kernel * lit
    opl = seen[:, None] + r + s
    light = np.concatenate([once, twice.ravel()])
    return light, np.concatenate([seen + to_light, opl.ravel()])


def disk_light(h, radius: float, radiance: float, albedo, camera: float) -> tuple[Any, Any]:
    """b1: a disk parallel to a receiver, on its axis at height h; `camera` is the last segment.

    The ring of radius s gives the irradiance Le h² / r⁴ 2 π s ds, r² = s² + h².
    """
    s, w = unit_interval(64)
    s, w = radius * s, radius * w
    r = np.sqrt(s**2 + h**2)
    return albedo * radiance * h**2 / r**4 * 2 * s * w, camera + r


def inside_sphere(
    radius, albedo, intensity: float, bounces: int, order: int = 160
) -> tuple[Any, Any]:
    """c: light and camera at the center of a diffuse sphere; up to `bounces` beyond the first.

    Bounce n has ρ^(n+1) I / (π R²), after 2 R and n chords of 2 R c, where c has the density 2 c.
    """
    c, w = unit_interval(order)
    w = 2 * c * w
    chords, weights = np.zeros(1), np.ones(1)
    light, opl = [], []
    for n in range(bounces + 1):
        light.append(albedo ** (n + 1) * intensity / (math.pi * radius**2) * weights)
        opl.append(2 * radius * (1 + chords))
        if n < bounces:
            chords, weights = np.add.outer(chords, c).ravel(), np.outer(weights, w).ravel()
    return np.concatenate(light), np.concatenate(opl)


def sphere_light(
    radius, distance: float, cosine: float, radiance: float, albedo: float, camera: float
) -> tuple[Any, Any]:
    """g2: a sphere light, its center at `distance` from a receiver and under the angle of `cosine`.

    A direction at the angle γ from the center's meets it after D cos γ - sqrt(R² - D² sin² γ); the
    mean over the azimuth of its cosine on the receiver is cos_n cos γ. With D sin γ = R sin a, the
    directions 2 π sin γ cos γ dγ are 2 π (R / D)² sin a cos a da.
    """
    a, w = unit_interval(128)
    a, w = 0.5 * math.pi * a, 0.5 * math.pi * w
    cos_g = np.sqrt(1 - (radius / distance * np.sin(a)) ** 2)
    solid = 2 * (radius / distance) ** 2 * np.sin(a) * np.cos(a) * w
    opl = camera + distance * cos_g - radius * np.cos(a)
    return albedo * radiance * cosine * solid, opl


def fresnel(sine: float, index):
    """Unpolarized reflectance of glass for light in air at the sine of its angle."""
    cos_i, cos_t = math.sqrt(1 - sine**2), np.sqrt(1 - (sine / index) ** 2)
    r_s = (cos_i - index * cos_t) / (cos_i + index * cos_t)
    r_p = (index * cos_i - cos_t) / (index * cos_i + cos_t)
    return 0.5 * (r_s**2 + r_p**2)


def slab(
    index, thickness: float, sine: float, air: float, radiance: float, orders: int
) -> tuple[Any, Any]:
    """g3: a glass slab before a parallel lamp; order m is reflected 2 m times within.

    The way through the glass is d / cos_t, and optically n d / cos_t = n² d / sqrt(n² - sin²); each
    order goes 2 m + 1 such ways. `air` is the way in air, which no n changes.
    """
    f = fresnel(sine, index)
    m = np.arange(orders)
    light = radiance * (1 - f) ** 2 * f ** (2 * m)
    return light, air + (2 * m + 1) * index**2 * thickness / np.sqrt(index**2 - sine**2)


def seen_in_mirror(z, air: float, cosine: float, light: float) -> tuple[Any, Any]:
    """g4: a mirror moved by z along its normal, in front of a lamp across the reflected ray."""
    return np.array([light]), air - 2 * cosine * np.atleast_1d(z)


def hidden_patch(
    moved, center, half_u, half_v, lit, seen, legs: float, scale: float, order: int = 12
) -> tuple[Any, Any]:
    """f1: a diffuse patch that a point `lit` of a wall z = 0 lights and a point `seen` sees.

    L = Φ ρ_w² ρ_h / π³ ∫ cos_p cos_q cos_q' cos_s / (r1² r2²) dA, see `nlos_oracles`; `scale` is
    what stands before the integral, `legs` the way to the wall and from it, `moved` a vector.
    """
    x, w = leggauss(order)
    s, t = (a.ravel() for a in np.meshgrid(x, x))
    normal = np.cross(half_u, half_v)
    area = np.outer(w, w).ravel() * length(normal)
    normal = normal / length(normal)
    q = np.asarray(center) + np.outer(s, half_u) + np.outer(t, half_v) + moved
    light, opl = scale * area, legs
    for point in (lit, seen):
        away = np.asarray(point) - q
        r = length(away)
        light = light * -away[:, 2] * dot(away, normal) / r**4
        opl = opl + r
    return light, opl
