"""Closed forms of light in flight, in NumPy alone; each docstring holds its derivation.

Lengths are in meters, radiances in W / (m² sr). Nothing here knows the renderer.
"""

import math
from itertools import pairwise

import numpy as np


def _distance(p, q) -> float:
    return float(np.linalg.norm(np.asarray(p, float) - np.asarray(q, float)))


def point_light_on_plane(camera, x, normal, light, intensity, albedo) -> tuple[float, float]:
    """A point light, a diffuse surface point x, a camera: (radiance, OPL) of the only path.

    The light's irradiance on x is I cos / d², with d = |x - l| and the cosine between the normal
    and the direction to the light. A diffuse surface turns irradiance E into radiance ρ E / π.
    The light travels d and then |c - x|.
    """
    to_light = np.asarray(light, float) - np.asarray(x, float)
    d = float(np.linalg.norm(to_light))
    cosine = max(0.0, float(np.dot(normal, to_light)) / d)
    radiance = albedo / math.pi * intensity * cosine / d**2
    return radiance, _distance(camera, x) + d


def disk_light_masses(edges, h, radius, radiance) -> np.ndarray:
    """Irradiance that arrives in bins of distance r from a disk light, on axis and parallel.

    The ring at distance r from the receiver has the radius s = sqrt(r² - h²) and, as s ds = r dr,
    the area 2 π r dr. Each of its points adds Le cos² / r² dA with cos = h / r at both ends, so
    dE/dr = 2 π Le h² / r³ for r from h to sqrt(h² + R²). Its integral from h is
    π Le (1 - h² / r²); over all, E = π Le R² / (h² + R²).
    """
    r = np.clip(edges, h, math.hypot(h, radius))
    return np.diff(math.pi * radiance * (1 - h**2 / r**2))


def angle_in_corner_rectangle(s, a, b) -> np.ndarray:
    """Angle of the circle of radius s around a corner that lies in the rectangle [0, a] x [0, b].

    At the angle φ from the side a, the circle's point (s cos φ, s sin φ) is inside while
    s cos φ <= a and s sin φ <= b: from acos(a / s) (0 while s <= a) to asin(b / s) (π/2 while
    s <= b).
    """
    s = np.maximum(s, 1e-12)
    return np.maximum(0, np.arcsin(np.minimum(1, b / s)) - np.arccos(np.minimum(1, a / s)))


def angle_in_rectangle(s, x_range, y_range) -> np.ndarray:
    """The same for any rectangle around or beside the circle's center: four signed corners.

    The rectangle's indicator is the sum over its corners (x, y) of ± those of the rectangles
    between the center and the corner, with the sign of x and y taken out.
    """
    total = np.zeros_like(np.asarray(s, float))
    for sign_x, x in zip((-1, 1), x_range, strict=True):
        for sign_y, y in zip((-1, 1), y_range, strict=True):
            sign = sign_x * sign_y * math.copysign(1, x) * math.copysign(1, y)
            total += sign * angle_in_corner_rectangle(s, abs(x), abs(y))
    return total


def rectangle_light_masses(edges, h, x_range, y_range, radiance, fine: int = 4000) -> np.ndarray:
    """Irradiance in bins of distance r from a parallel rectangle light at height h.

    As for the disk, with the angle φ(s) of the ring that lies in the rectangle in place of 2 π:
    dE/dr = Le h² / r³ φ(s), s² = r² - h². The ranges are relative to the receiver's foot. The
    integral over each bin is a sum over `fine` points of it.
    """
    masses = []
    for low, high in pairwise(edges):
        r = low + (high - low) * (np.arange(fine) + 0.5) / fine
        s = np.sqrt(np.maximum(0, r**2 - h**2))
        density = radiance * h**2 / r**3 * angle_in_rectangle(s, x_range, y_range) * (r > h)
        masses.append(density.mean() * (high - low))
    return np.array(masses)


def sphere_bounce_total(n, radius, albedo, intensity) -> float:
    """Radiance of the n-th bounce in a diffuse sphere, light and camera at its center.

    Direct light (n = 0) meets every point perpendicularly: E0 = I / R², L0 = ρ I / (π R²). In a
    sphere, the exchange between any two points is the same: cos cos / d² = 1 / (4 R²), so the
    uniform radiosity B is reflected as ρ B by every point: each bounce multiplies by ρ.
    """
    return albedo ** (n + 1) * intensity / (math.pi * radius**2)


def sphere_total(radius, albedo, intensity) -> float:
    """All bounces: the geometric series, ρ I / (π R² (1 - ρ))."""
    return albedo * intensity / (math.pi * radius**2 * (1 - albedo))


def sphere_bounce_masses(n, edges, radius, fine: int = 20000) -> np.ndarray:
    """Fraction of the n-th bounce that arrives in bins of OPL.

    Light goes R to the wall, n chords between points of the wall, and R to the camera. Cosine-
    distributed directions reach the sphere uniformly, so a chord r = 2 R cos has the density
    r / (2 R²) on [0, 2R], and cdf r² / (4 R²). The chords are independent: their sum's density is
    the n-fold convolution, here on a grid of `fine` steps per chord.
    """
    if n == 0:
        return np.histogram([2 * radius], edges)[0].astype(float)
    step = 2 * radius / fine
    chord = np.diff((np.arange(fine + 1) / fine) ** 2)
    masses = chord
    for _ in range(n - 1):
        size = masses.size + fine
        masses = np.fft.irfft(
            np.fft.rfft(masses, 2 * size) * np.fft.rfft(chord, 2 * size), 2 * size
        )
        masses = masses[:size]
    # n cells of a step each add up to a spread of n steps: their middle is n/2 steps further
    position = 2 * radius + (np.arange(masses.size) + 0.5 * n) * step
    cdf = np.concatenate([[0], np.cumsum(masses)])
    grid = np.concatenate([position - 0.5 * step, [position[-1] + 0.5 * step]])
    return np.diff(np.interp(edges, grid, cdf))


def slab_order(m, index, radiance) -> float:
    """Radiance that has been reflected 2 m times within a slab, at normal incidence.

    Each face reflects F = ((n - 1) / (n + 1))². Light that enters and leaves passes two faces,
    (1 - F)², and is reflected at 2 m others.
    """
    f = ((index - 1) / (index + 1)) ** 2
    return radiance * (1 - f) ** 2 * f ** (2 * m)


def slab_total(index, radiance) -> float:
    """All orders: (1 - F)² / (1 - F²) = (1 - F) / (1 + F)."""
    f = ((index - 1) / (index + 1)) ** 2
    return radiance * (1 - f) / (1 + f)


def slab_opl(m, air, index, thickness) -> float:
    """Optical length of order m: the way in air and 2 m + 1 times through the glass, n times d."""
    return air + (2 * m + 1) * index * thickness


def mirrored(point, on_mirror, normal) -> np.ndarray:
    """The mirror image of a point: p - 2 ((p - m) · n) n."""
    p, m, n = (np.asarray(v, float) for v in (point, on_mirror, normal))
    return p - 2 * np.dot(p - m, n) * n


def gaussian_cdf(t, width) -> np.ndarray:
    """(1 + erf(t / (s sqrt 2))) / 2."""
    scaled = np.asarray(t, float) / (width * math.sqrt(2))
    return 0.5 + 0.5 * np.vectorize(math.erf)(scaled)


def gaussian_masses(edges, center, width) -> np.ndarray:
    """Energy of a Gaussian pulse in bins: differences of its cdf."""
    return np.diff(gaussian_cdf(np.asarray(edges) - center, width))


def enclosing_sphere(corner_low, corner_high) -> tuple[np.ndarray, float]:
    """Center and radius of the sphere through a box's corners."""
    low, high = np.asarray(corner_low, float), np.asarray(corner_high, float)
    return 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))


def distant_length(p, to_light, center, radius) -> float:
    """Way from p towards a distant light, to the plane that touches the sphere on its far side.

    Points of the plane q satisfy (q - center) · w = radius for the unit vector w to the light; from
    p along w it takes radius - (p - center) · w.
    """
    p, w, center = (np.asarray(v, float) for v in (p, to_light, center))
    return radius - float(np.dot(p - center, w))
