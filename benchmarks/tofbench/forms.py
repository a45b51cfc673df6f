"""Closed forms in NumPy. Lengths are optical path lengths (OPL) in meters, radiances W/(m² sr)."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.polynomial.legendre import leggauss

C = 299_792_458.0
"""Speed of light [m/s]."""


def edges(bins: dict) -> np.ndarray:
    """Return the edges of time bins [m]."""
    return bins["start"] + bins["width"] * np.arange(bins["count"] + 1)


def centers(bins: dict) -> np.ndarray:
    """Return the centers of time bins [m]."""
    return bins["start"] + bins["width"] * (np.arange(bins["count"]) + 0.5)


def histogram(bins: dict, opl, radiance) -> np.ndarray:
    """Sum the radiance of paths in bins."""
    opl, radiance = np.broadcast_arrays(opl, radiance)
    return np.histogram(opl.ravel(), edges(bins), weights=radiance.ravel())[0]


def distance(p, q) -> float:
    """Return the distance of two points."""
    return float(np.linalg.norm(np.subtract(p, q, dtype=float)))


def lattice(count: int = 1 << 19, dimensions: int = 4) -> np.ndarray:
    """Return evenly spread points of the unit cube: multiples of powers of 1/x, x^(d+1) = x + 1."""
    # Solve for x by iteration
    x = 2.0
    for _ in range(64):
        x = (1 + x) ** (1 / (dimensions + 1))
    steps = x ** -np.arange(1.0, dimensions + 1)
    return (0.5 + steps[:, None] * np.arange(count)) % 1


def gauss(low: float, high: float, order: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes and weights of Gauss-Legendre integration."""
    x, w = leggauss(order)
    return 0.5 * (low + high) + 0.5 * (high - low) * x, 0.5 * (high - low) * w


def gaussian_cdf(x) -> np.ndarray:
    """Return the distribution function of the standard normal distribution."""
    return 0.5 * (1 + np.vectorize(math.erf)(np.asarray(x, float) / math.sqrt(2)))


def fresnel(n: float, cosine: float = 1.0) -> tuple[float, float]:
    """Return the reflectances r_s and r_p of a dielectric of relative index n."""
    inside = math.sqrt(1 - (1 - cosine**2) / n**2)
    s = (cosine - n * inside) / (cosine + n * inside)
    p = (n * cosine - inside) / (n * cosine + inside)
    return s**2, p**2


def point_on_floor(eye, x, light, intensity: float, albedo: float) -> tuple[float, float]:
    """Return OPL and radiance of a diffuse floor point under a point light: rho/pi I cos/d²."""
    d = distance(x, light)
    return distance(eye, x) + d, albedo / math.pi * intensity * (light[2] - x[2]) / d**3


def floor_in_view(
    height: float, fov: float, size: tuple[int, int], light, intensity: float, albedo: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return OPL, radiance and pixel of floor points under a point light.

    The camera is at (0, 0, height), with up = +y. Radiances sum to the mean of each pixel.
    """
    # Choose points on the floor
    width, rows = size
    u, v = lattice(1 << 20, 2)
    half = math.tan(math.radians(fov) / 2)
    scale = np.array([max(width / rows, 1.0), max(rows / width, 1.0)]) * half
    x = (2 * u - 1) * scale[0] * height
    y = (1 - 2 * v) * scale[1] * height

    # Compute light and path length
    d = np.sqrt((x - light[0]) ** 2 + (y - light[1]) ** 2 + light[2] ** 2)
    radiance = albedo / math.pi * intensity * light[2] / d**3
    seen = np.sqrt(height**2 + x**2 + y**2)
    pixel = (v * rows).astype(int) * width + (u * width).astype(int)
    return seen + d, radiance * width * rows / u.size, pixel


def disk_light(bins: dict, seen: float, h: float, radius: float, radiance: float, albedo: float):
    """Return bins of a floor point on the axis of a parallel disk: dE/dr = 2 pi Le h²/r³."""
    r = np.clip(edges(bins) - seen, h, math.hypot(h, radius))
    return np.diff(albedo * radiance * (1 - h**2 / r**2))


def _corner(s, a, b) -> np.ndarray:
    """Return the angle of a circle of radius s around a corner, inside of the rectangle."""
    return np.maximum(0, np.arcsin(np.minimum(1, b / s)) - np.arccos(np.minimum(1, a / s)))


def rectangle_light(bins: dict, seen: float, h: float, x, y, radiance: float, albedo: float):
    """Return bins of a floor point under a parallel rectangle: dE/dr = Le h²/r³ phi(s).

    The rectangle has the height h and the ranges x and y.
    """
    masses = []
    for low, high in pairwise(np.maximum(edges(bins) - seen, h)):
        # Integrate over the distance in a bin
        r = low + (high - low) * (np.arange(4000) + 0.5) / 4000
        w = (high - low) / 4000
        s = np.sqrt(np.maximum(r**2 - h**2, 1e-18))

        # The angle in the rectangle is a sum over its corners, with signs
        phi = sum(
            i * j * math.copysign(1, x[k] * y[m]) * _corner(s, abs(x[k]), abs(y[m]))
            for k, i in enumerate((-1, 1))
            for m, j in enumerate((-1, 1))
        )
        masses.append((w * h**2 / r**3 * phi).sum())
    return albedo / math.pi * radiance * np.array(masses)


def sphere_light(bins: dict, seen: float, away, radius: float, radiance: float, albedo: float):
    """Return bins of a floor point lit by a sphere above the floor: E = pi Le cos R²/D².

    The center of the sphere is at `away` from the point. Rings with equal steps of sin² of the
    angle to the center contribute equally.
    """
    d = float(np.linalg.norm(away))
    sine2 = (np.arange(1 << 16) + 0.5) / (1 << 16) * (radius / d) ** 2
    r = d * np.sqrt(1 - sine2) - np.sqrt(radius**2 - d**2 * sine2)
    total = albedo * radiance * away[2] / d * (radius / d) ** 2
    return histogram(bins, seen + r, total / sine2.size)


def furnace(
    bins: dict, bounces: int, radius: float, albedo: float, intensity: float, offset: float = 0.0
) -> np.ndarray:
    """Return bins of a diffuse sphere with a light at its center, for bounces 0 to n.

    The camera is at the center, or at an offset, where it records light from all sides. Bounce n
    has the radiance rho^(n+1) I/(pi R²). It arrives after 2R and n independent chords. Chords have
    the distribution r²/(4R²) on [0, 2R], and are convolved on a grid of 2000 steps.
    """
    # Distribution of a chord
    fine = 2000
    step = 2 * radius / fine
    chord = np.diff((np.arange(fine + 1) / fine) ** 2)
    masses = np.ones(1)
    result = np.zeros(bins["count"])
    first = 2 * radius

    # Distribution of the last segment
    if offset:
        mu = (np.arange(1 << 16) + 0.5) / (1 << 15) - 1
        leg = np.sqrt(radius**2 - offset**2 * (1 - mu**2)) - offset * mu
        cells = math.ceil(2 * offset / step) + 1
        grid = radius - offset + step * (np.arange(cells + 1) - 0.5)
        masses = np.histogram(leg, grid)[0] / leg.size
        first = 2 * radius - offset

    # Add bounce after bounce
    for n in range(bounces + 1):
        # A sum of n cells extends over n steps. Its center is n/2 steps further
        grid = first + (np.arange(masses.size + 1) - 0.5 + 0.5 * n) * step
        cdf = np.interp(edges(bins), grid, np.concatenate([[0], np.cumsum(masses)]))
        result += albedo ** (n + 1) * intensity / (math.pi * radius**2) * np.diff(cdf)

        # Add a chord
        size = masses.size + fine
        spectrum = np.fft.rfft(masses, 2 * size) * np.fft.rfft(chord, 2 * size)
        masses = np.fft.irfft(spectrum, 2 * size)[: size - 1]
    return result


def slab(n: float, air: float, glass: float, angle: float = 0.0, orders: int = 12):
    """Return OPL, S0 and S1 of the orders behind a glass slab, for radiance 1 and any angle.

    Order m has the transmittance (1-r)² r^2m. S0 is the mean over r_s and r_p, and S1 is half of
    the difference (s is positive).
    """
    cosine = math.cos(math.radians(angle))
    inside = math.sqrt(1 - (1 - cosine**2) / n**2)
    s, p = fresnel(n, cosine)
    m = np.arange(orders)
    both = [(1 - r) ** 2 * r ** (2 * m) for r in (s, p)]
    opl = air / cosine + (2 * m + 1) * n * glass / inside
    return opl, (both[0] + both[1]) / 2, (both[0] - both[1]) / 2


def slab_unpolarized(n: float, angle: float, orders: int = 12) -> np.ndarray:
    """Return the orders for renderers that average both reflectances at each face."""
    f = sum(fresnel(n, math.cos(math.radians(angle)))) / 2
    return (1 - f) ** 2 * f ** (2 * np.arange(orders))


def lens_patch(
    bins: dict, half: float, center, radius: float, fov: float, radiance: float
) -> np.ndarray:
    """Return bins of a square emitter parallel to a thin lens at the origin: mean L a/(A z²).

    A is the area of the film at unit distance. Importance times geometry is constant. Therefore all
    paths between evenly spread points of emitter and lens contribute equally.
    """
    # Choose points on lens and emitter
    a, b, c, d = lattice()
    r = radius * np.sqrt(c)
    phi = 2 * math.pi * d
    x = center[0] + half * (2 * a - 1)
    y = center[1] + half * (2 * b - 1)
    opl = np.sqrt((x - r * np.cos(phi)) ** 2 + (y - r * np.sin(phi)) ** 2 + center[2] ** 2)
    area = 4 * math.tan(math.radians(fov) / 2) ** 2
    return histogram(bins, opl, radiance * 4 * half**2 / (area * center[2] ** 2) / opl.size)


def single_scattering(
    bins: dict, light, intensity: float, scattering: float, extinction: float, x, phase
) -> np.ndarray:
    """Return bins of single scattering of a point light.

    The camera is at 0 along +x, the light at (p_x, p_y, 0), and the medium between x0 and x1. With
    depth t and OPL l = t + d: L = mu_s I 4 pi p(cos) exp(-mu_t(l - x0))/(4 pi d²) dt. Here cos is
    between the directions of light before and after scattering.
    """
    # Integrate over the depth
    w = (x[1] - x[0]) / (1 << 18)
    t = x[0] + w * (np.arange(1 << 18) + 0.5)
    d = np.hypot(light[0] - t, light[1])
    value = scattering * intensity * phase((light[0] - t) / d) / d**2
    return histogram(bins, t + d, w * value * np.exp(-extinction * (t + d - x[0])))


def hg(g: float):
    """Return the Henyey-Greenstein phase function."""
    return lambda cos: (1 - g * g) / (4 * math.pi * (1 + g * g - 2 * g * cos) ** 1.5)


def rayleigh(cos):
    """Evaluate the Rayleigh phase function."""
    return 3 / (16 * math.pi) * (1 + cos**2)


def half_space(albedo: float, mu: float) -> float:
    """Return the radiance in direction mu of a half-space under radiance 1: 1 - sqrt(1-a) H_a(mu).

    Chandrasekhar's H for isotropic scattering: 1/H(mu) = sqrt(1-a) + a/2 int x H(x)/(mu+x) dx.
    """
    # Solve the integral equation by iteration
    x, w = gauss(0, 1, 200)
    h = np.ones_like(x)
    root = math.sqrt(1 - albedo)
    for _ in range(400):
        h = 1 / (root + albedo / 2 * ((w * x * h) / (x[:, None] + x)).sum(axis=1))
    at = 1 / (root + albedo / 2 * (w * x * h / (mu + x)).sum())
    return 1 - root * at


def nodes(center, u, v, count: int = 300) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return centers of equal cells of a rectangle, the normal u x v, and the area of a cell."""
    s = (2 * np.arange(count) + 1) / count - 1
    s, t = (a.ravel() for a in np.meshgrid(s, s))
    points = np.asarray(center) + np.outer(s, u) + np.outer(t, v)
    cross = np.cross(u, v)
    area = float(np.linalg.norm(cross))
    return points, cross / area, np.full(s.size, 4 * area / s.size)


def around_corner(lit, seen, hidden, albedo: float, scale: float, wall_cosine: bool = True):
    """Return r1 + r2 and radiance of paths by a hidden diffuse surface. Both walls face +z.

    The radiance is scale albedo/pi int cos cos cos cos/(r1² r2²) dA. Without `wall_cosine`, `lit`
    is a point light.
    """
    # Distances and cosines of both segments
    points, normal, area = hidden
    r = []
    cos = []
    for end in (lit, seen):
        away = np.asarray(end, float) - points
        r.append(np.linalg.norm(away, axis=1))
        cos.append(np.maximum(away @ normal / r[-1], 0))
        cos.append(np.maximum(-away[:, 2] / r[-1], 0))

    # A point light has no cosine
    if not wall_cosine:
        cos[1] = np.ones_like(cos[1])
    value = scale * albedo / math.pi * np.prod(cos, axis=0) * area / (r[0] * r[1]) ** 2
    return r[0] + r[1], value
