"""Light that a camera gets from a floor below it, over path length: film means in NumPy alone.

The floor is the plane z = 0 of albedo ρ. The camera, a pinhole at (0, 0, H), looks down; its square
window has the half-width a = tan(fov / 2) at unit distance, and the area A = 4 a². The window's
point (u, v) shows the floor's (u H, v H), at the distance H sqrt(1 + u² + v²). The mean of the film
is the mean over the window of the floor's radiance ρ E / π.

Light is a set of values that add up to the film's mean, each with its path length. Lengths are in
meters. Nothing here knows the renderer.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import leggauss

from oracles import films as oracles

C = 299_792_458.0


@dataclass
class Light:
    """Light in the mean of a film."""

    value: np.ndarray  # values that add up to the mean, shape (n,)
    opl: np.ndarray  # the path length of each [m], shape (n,)

    @classmethod
    def of(cls, value, opl) -> "Light":
        value, opl = np.broadcast_arrays(value, opl)
        return cls(value.ravel(), opl.ravel())

    @property
    def total(self) -> float:
        return float(self.value.sum())

    def masses(self, edges) -> np.ndarray:
        return np.histogram(self.opl, edges, weights=self.value)[0]

    def phasor(self, frequency_hz: float) -> complex:
        return complex(self.value @ np.exp(2j * math.pi * frequency_hz / C * self.opl))

    def gate(self, target: float, width: float) -> float:
        """Radiance per meter that a Gaussian pulse of this width has at a path length."""
        scaled = (target - self.opl) / width
        return float(self.value @ np.exp(-0.5 * scaled**2)) / (width * math.sqrt(2 * math.pi))


def window_area(fov: float) -> float:
    """A, for a square window."""
    return 4 * math.tan(math.radians(fov) / 2) ** 2


@dataclass
class View:
    """The camera: height H and field of view in degrees.

    `shift` moves the window along u, by a fraction of its width.
    """

    height: float
    fov: float = 40.0
    shift: float = 0.0

    @property
    def half(self) -> float:
        return math.tan(math.radians(self.fov) / 2)

    def points(self, count: int = 1 << 20):
        """Points x, y of the floor, their distance to the camera, and two numbers for the light.

        They are spread evenly in four dimensions by the powers of 1 / g, g^5 = g + 1: the error of
        a mean falls nearly as 1 / count.
        """
        steps = 1.1673039782614187 ** -np.arange(1.0, 5)
        u, v, a, b = ((0.5 + step * np.arange(count)) % 1 for step in steps)
        u, v = self.half * (2 * u - 1 + 2 * self.shift), self.half * (2 * v - 1)
        return u * self.height, v * self.height, self.height * np.sqrt(1 + u**2 + v**2), a, b


def under_a_point(view: View, light, intensity: float, albedo: float) -> Light:
    """E = I z / d³ from a point light at (x, y, z)."""
    x, y, seen, _, _ = view.points()
    d = np.sqrt((x - light[0]) ** 2 + (y - light[1]) ** 2 + light[2] ** 2)
    radiance = albedo / math.pi * intensity * light[2] / d**3
    return Light(radiance / x.size, seen + d)


def under_a_rectangle(view: View, half, height: float, radiance: float, albedo: float) -> Light:
    """E = Le ∫ h² / d⁴ dA from a rectangle over the origin that faces down: cosines are h / d."""
    x, y, seen, a, b = view.points()
    to_x, to_y = half[0] * (2 * a - 1) - x, half[1] * (2 * b - 1) - y
    d = np.sqrt(to_x**2 + to_y**2 + height**2)
    area = 4 * half[0] * half[1]
    return Light(albedo / math.pi * radiance * area * height**2 / d**4 / x.size, seen + d)


def under_a_disk(view: View, radius: float, height: float, radiance: float, albedo: float) -> Light:
    """The same for a disk."""
    x, y, seen, a, b = view.points()
    r, φ = radius * np.sqrt(a), 2 * math.pi * b
    d = np.sqrt((r * np.cos(φ) - x) ** 2 + (r * np.sin(φ) - y) ** 2 + height**2)
    area = math.pi * radius**2
    return Light(albedo / math.pi * radiance * area * height**2 / d**4 / x.size, seen + d)


def under_a_ball(view: View, radius: float, height: float, radiance: float, albedo: float) -> Light:
    """E = π Le cos (R / D)² from a glowing ball around (0, 0, h), its distance D, cos = h / D.

    Directions at the angle γ from its center's make up a ring, whose mean cosine is cos γ h / D.
    Its part of E is 2 π Le (h / D) cos γ sin γ dγ: equal steps of sin² γ, up to R² / D², have equal
    parts. They meet the ball at D cos γ - sqrt(R² - D² sin² γ).
    """
    x, y, seen, a, _ = view.points()
    distance = np.sqrt(x**2 + y**2 + height**2)
    sine2 = a * (radius / distance) ** 2
    d = distance * np.sqrt(1 - sine2) - np.sqrt(radius**2 - distance**2 * sine2)
    total = albedo * radiance * height / distance * (radius / distance) ** 2
    return Light(total / x.size, seen + d)


def under_a_sky(view: View, radiance: float, albedo: float, center, radius: float) -> Light:
    """E = π Le from a constant sky, whose light starts where it touches the sphere around all.

    Equal steps of cos² and of the azimuth have equal parts of E.
    """
    x, y, seen, a, b = view.points()
    cosine, φ = np.sqrt(a), 2 * math.pi * b
    across = (x - center[0]) * np.cos(φ) + (y - center[1]) * np.sin(φ)
    along = np.sqrt(1 - a) * across - center[2] * cosine
    return Light.of(albedo * radiance / x.size, seen + radius - along)


def under_a_sun(view: View, to_light, irradiance: float, albedo: float, center, radius: float):
    """E cos from parallel light, which starts as a sky's does."""
    x, y, seen, _, _ = view.points()
    along = (x - center[0]) * to_light[0] + (y - center[1]) * to_light[1] - center[2] * to_light[2]
    radiance = albedo / math.pi * irradiance * to_light[2]
    return Light.of(radiance / x.size, seen + radius - along)


def reflectance(cosine, index: float) -> np.ndarray:
    """Fresnel's, mean of both polarizations, for light that arrives where the index is 1."""
    sine2 = (1 - np.asarray(cosine) ** 2) / index**2
    behind = np.sqrt(np.maximum(0, 1 - sine2))
    total = sine2 >= 1
    s = (cosine - index * behind) / (cosine + index * behind)
    p = (index * cosine - behind) / (index * cosine + behind)
    return np.where(total, 1.0, 0.5 * (s**2 + p**2))


@dataclass
class Caustic:
    """Light from a point on the floor's axis that arrives in rings, by the angle it starts at."""

    power: np.ndarray  # power of each ring
    r: np.ndarray  # where it meets the floor, distance to the axis [m]
    opl: np.ndarray  # path length up to there [m]

    def seen(self, view: View, albedo: float, unwarp: bool = True) -> Light:
        """What the film's mean has of it: (ρ / π) P / (A H²), whatever the place.

        The floor's radiance is ρ E / π, and the window's area A covers A H² of the floor. Of a
        ring beyond the window's edge, the part counts that is within.
        """
        side = (-view.half * view.height, view.half * view.height)
        inside = oracles.angle_in_rectangle(self.r, side, side) / (2 * math.pi)
        value = albedo / math.pi * self.power * inside / (window_area(view.fov) * view.height**2)
        segment = 0 if unwarp else np.hypot(self.r, view.height)
        return Light.of(value, self.opl + segment)

    def pixels(self, view: View, albedo: float, n: int, azimuths: int = 60) -> np.ndarray:
        """The film of n x n pixels, shape (n, n). The points of each ring are turned by a bit."""
        turned = 0.6180339887498949 * np.arange(self.r.size)[:, None]
        φ = 2 * math.pi * (turned + np.arange(azimuths) / azimuths)
        edges = np.linspace(-view.half, view.half, n + 1) * view.height
        x, y = self.r[:, None] * np.cos(φ), self.r[:, None] * np.sin(φ)
        weights = np.broadcast_to(self.power[:, None] / azimuths, x.shape).ravel()
        power = np.histogram2d(y.ravel(), x.ravel(), (edges, edges), weights=weights)[0]
        return albedo / math.pi * power / (window_area(view.fov) / n**2 * view.height**2)


def _angles(largest: float, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Angles from the axis, and the solid angle of each ring."""
    edges = np.linspace(0, largest, n + 1)
    return 0.5 * (edges[1:] + edges[:-1]), -2 * math.pi * np.diff(np.cos(edges))


def through_a_slab(
    index: float, thickness: float, air: float, largest: float, intensity: float = 1.0, order=0
) -> Caustic:
    """A slab of glass between a point light and the floor; `air` is what is left of the height.

    Both faces pass 1 - F. Order m is reflected 2 m times in between.
    """
    θ, Ω = _angles(largest, 8000)
    behind = np.arcsin(np.sin(θ) / index)
    f = reflectance(np.cos(θ), index)
    ways = 2 * order + 1
    return Caustic(
        power=intensity * Ω * (1 - f) ** 2 * f ** (2 * order),
        r=air * np.tan(θ) + ways * thickness * np.tan(behind),
        opl=air / np.cos(θ) + ways * index * thickness / np.cos(behind),
    )


def out_of_glass(
    index: float, depth: float, air: float, largest: float, intensity: float = 1.0
) -> Caustic:
    """A point light within glass, at this depth under its face, and the floor in front of it.

    The angle, at most `largest` within the glass, is below that of total reflection. Power is what
    passes: the light's importance does not grow by n² there, as radiance falls.
    """
    θ, Ω = _angles(largest, 8000)
    outside = np.arcsin(index * np.sin(θ))
    return Caustic(
        power=intensity * Ω * (1 - reflectance(np.cos(outside), index)),
        r=depth * np.tan(θ) + air * np.tan(outside),
        opl=index * depth / np.cos(θ) + air / np.cos(outside),
    )


def through_a_ball(
    index: float, radius: float, light: float, floor: float, intensity: float = 1.0
) -> Caustic:
    """A ball of glass; from its center, a point light is up by `light`, the floor down by `floor`.

    In the plane of the ray: it leaves at t, meets the ball under the angle i, sin i = (light / R)
    sin t, and is bent to b. Seen from the center it then is at i - t from the axis. Its chord turns
    that by π - 2 b, and it leaves at i to the normal. Orders with reflections within are left out.
    """
    t, Ω = _angles(math.asin(radius / light), 12000)
    i = np.arcsin(light / radius * np.sin(t))
    b = np.arcsin(np.sin(i) / index)
    at = i - t + math.pi - 2 * b
    down = -np.cos(at + i)
    rest = np.where(down > 1e-6, (radius * np.cos(at) + floor) / np.maximum(down, 1e-6), 1e6)
    return Caustic(
        power=intensity * Ω * (1 - reflectance(np.cos(i), index)) ** 2,
        r=np.abs(radius * np.sin(at) + np.sin(at + i) * rest),
        opl=light * np.cos(t) - radius * np.cos(i) + 2 * radius * index * np.cos(b) + rest,
    )


def ball_in_a_lens(y, radius: float, radiance: float, lens: float, fov: float) -> Light:
    """A glowing ball around y, seen through a lens of this radius around the origin, along z.

    From the lens point p, with c = y - p and D = |c|, the ball fills the cone sin γ <= r / D. The
    window at unit distance has the area dω / cos³ θ for the solid angle dω, whose ray meets the
    ball at D cos γ - sqrt(r² - D² sin² γ). For a small ball this is I ⟨D⟩ / (A z³), I = π r² Le.
    """
    nodes, weights = leggauss(6)
    φ = 2 * math.pi * (np.arange(12) + 0.5) / 12
    r = lens * np.sqrt(0.5 * (nodes + 1))[:, None]
    p = np.stack([(r * np.cos(φ)).ravel(), (r * np.sin(φ)).ravel(), np.zeros(72)], axis=-1)
    share = np.repeat(0.5 * weights / φ.size, φ.size)
    c = np.asarray(y, float) - p
    distance = np.linalg.norm(c, axis=-1, keepdims=True)
    ahead = c / distance
    side = np.cross(ahead, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    up = np.cross(ahead, side)
    # Rings of equal steps of sin²
    sine2 = (np.arange(40) + 0.5) / 40 * (radius / distance) ** 2
    cosine, sine = np.sqrt(1 - sine2)[..., None], np.sqrt(sine2)[..., None]
    ring = (radius / distance) ** 2 / 40 / (2 * np.sqrt(1 - sine2)) * 2 * math.pi / φ.size
    z = ahead[:, None, None, 2] * cosine
    z = z + sine * (np.cos(φ) * side[:, None, None, 2] + np.sin(φ) * up[:, None, None, 2])
    value = radiance / window_area(fov) * (share[:, None] * ring)[..., None] / z**3
    length = distance * np.sqrt(1 - sine2) - np.sqrt(radius**2 - distance**2 * sine2)
    return Light.of(value, length[..., None])
