"""Expected results, in closed form with NumPy. Lengths in meters."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from tofrender.course.judge.inputs import Inputs

inputs = Inputs(__file__)
SPEED_OF_LIGHT = 299_792_458.0


# ------------------------------------------------------------------------------------- pulses


def gaussian(t, width) -> np.ndarray:
    """Density of the Gaussian pulse [1/m]."""
    return np.exp(-0.5 * (np.asarray(t) / width) ** 2) / (width * math.sqrt(2 * math.pi))


def gaussian_cdf(t, width) -> np.ndarray:
    """(1 + erf(t / (σ √2))) / 2."""
    return 0.5 + 0.5 * np.vectorize(math.erf)(np.asarray(t, float) / (width * math.sqrt(2)))


def hat(t, width) -> np.ndarray:
    """Density of a pulse that rises evenly from -w to 0 and falls evenly to w."""
    return np.maximum(1 - np.abs(t) / width, 0) / width


def hat_cdf(t, width) -> np.ndarray:
    """Its integral."""
    x = np.clip(np.asarray(t) / width, -1, 1)
    return 0.5 + x - 0.5 * x * np.abs(x)


def decay(t, width) -> np.ndarray:
    """Density of a pulse that starts at 0 and decays: exp(-t / τ) / τ."""
    t = np.asarray(t, float)
    return np.where(t >= 0, np.exp(-np.maximum(t, 0) / width) / width, 0)


def slope(t, first, last) -> np.ndarray:
    """Density of a pulse that starts at `first` and falls evenly to 0 at `last`."""
    t = np.asarray(t, float)
    return np.where((t >= first) & (t <= last), 2 * (last - t) / (last - first) ** 2, 0)


def slope_cdf(t, first, last) -> np.ndarray:
    """Its integral."""
    return 1 - ((last - np.clip(t, first, last)) / (last - first)) ** 2


# ------------------------------------------------------------------------- lamp over a plane

LIGHT = (
    inputs.number("lamp x", 1.0, low=0.8, high=1.2),
    inputs.number("lamp y", 0.3, low=0.2, high=0.5),
    inputs.number("lamp z", 2.0, low=1.8, high=2.3),
)
INTENSITY = inputs.number("lamp's intensity", 3.0, low=2.0, high=4.0)
ALBEDO = inputs.number("albedo under the lamp", 0.5, low=0.4, high=0.7)
X = inputs.number("x under the camera", 0.4, low=0.3, high=0.55)
OVER = {"origin": (X, 0.0, 1.5), "target": (X, 0.0, 0.0)}


def lamp(x, y, camera) -> tuple[np.ndarray, np.ndarray]:
    """Radiance and length of the only path over (x, y, 0): ρ/π I cos / d², at |c - x| + d.

    The lamp's irradiance on the plane is I cos / d² with d = |x - l| and cos = l_z / d; a diffuse
    surface turns an irradiance E into the radiance ρ E / π.
    """
    x = np.asarray(x, float)
    y = np.asarray(y, float)
    d = np.sqrt((x - LIGHT[0]) ** 2 + (y - LIGHT[1]) ** 2 + LIGHT[2] ** 2)
    away = np.sqrt((x - camera[0]) ** 2 + (y - camera[1]) ** 2 + camera[2] ** 2)
    return ALBEDO / math.pi * INTENSITY * LIGHT[2] / d**3, away + d


def over_pixels(value, camera, fov, width, height, fine=40) -> np.ndarray:
    """Means of value(x, y) over the pixels of a camera that looks straight down, up = +y.

    The field of view refers to the width; columns run toward +x and rows toward -y.
    """
    half = camera[2] * math.tan(math.radians(fov) / 2)
    columns = (np.arange(width * fine) + 0.5) / (width * fine)
    rows = (np.arange(height * fine) + 0.5) / (height * fine)
    x = camera[0] + half * (2 * columns - 1)
    y = camera[1] + half * height / width * (1 - 2 * rows)
    values = np.asarray(value(*np.meshgrid(x, y)))
    values = values.reshape(*values.shape[:-2], height, fine, width, fine)
    return values.mean(axis=(-3, -1))


# ------------------------------------------------------------------------------------ lights


def disk_masses(edges, h, radius, radiance) -> np.ndarray:
    """Irradiance in bins of distance r from a disk light on the axis, parallel, at height h.

    The ring at the distance r has the area 2π r dr and adds Le cos² / r² of it, cos = h/r: from h
    to r there is π Le (1 - h² / r²).
    """
    r = np.clip(edges, h, math.hypot(h, radius))
    return np.diff(math.pi * radiance * (1 - h**2 / r**2))


def disk_total(h, radius, radiance) -> float:
    """π Le R² / (h² + R²)."""
    return math.pi * radiance * radius**2 / (h**2 + radius**2)


# ---------------------------------------------------------------------------- inside a sphere


def sphere_totals(bounces, radius, albedo, intensity) -> float:
    """Radiance up to so many bounces in a sphere, lamp and camera at the center.

    Direct light is ρ I / (π R²). Any two points of a sphere exchange equally, cos cos / d² =
    1 / (4 R²), so each further bounce multiplies by ρ.
    """
    return sum(albedo**n for n in range(1, bounces + 1)) * intensity / (math.pi * radius**2)


def chord_cdf(r, radius) -> np.ndarray:
    """Chords of cosine-distributed directions: r² / (4 R²) up to 2 R."""
    return np.clip(r, 0, 2 * radius) ** 2 / (4 * radius**2)


def confocal_sphere(vertices, radius, albedo, power) -> float:
    """Confocal light by so many points of a sphere, the lit one counted at both ends.

    From p to q and back: ∫ ρ/π cos dω, then ρ/π cos_q Φ ρ/π cos_p / r² with cos_q cos_p / r² =
    1 / (4 R²): Φ ρ³ / (4 π² R²). Each further vertex multiplies this by ρ.
    """
    return power * albedo**vertices / (4 * math.pi**2 * radius**2)


# -------------------------------------------------------------------------- around the corner


def patch(center, tilt, azimuth, half, cells=60):
    """Points, normals and areas of a rectangle that faces -z and is then turned by `tilt`.

    Returns also the 4 x 4 matrix that makes it of the square [-1, 1]².
    """
    t = math.radians(tilt)
    a = math.radians(azimuth)
    u = np.array([math.cos(t) * math.cos(a), math.cos(t) * math.sin(a), math.sin(t)])
    v = np.array([math.sin(a), -math.cos(a), 0.0])
    normal = np.cross(u, v)
    s = (2 * np.arange(cells) + 1) / cells - 1
    s, t = (each.ravel() for each in np.meshgrid(s, s))
    points = np.asarray(center, float) + np.outer(s * half[0], u) + np.outer(t * half[1], v)
    area = 4 * half[0] * half[1] / cells**2
    matrix = np.eye(4)
    matrix[:3] = np.stack([u * half[0], v * half[1], normal, np.asarray(center)], axis=1)
    return points, normal, area, matrix


def three_bounces(points, normal, area, lit, seen, device, power, wall, hidden):
    """(length, radiance) that each element of a hidden surface gives; the wall is at z = 0.

    The lit point sends Φ ρ_w/π cos_w1 per solid angle, so an element at r1 has the irradiance
    Φ ρ_w/π cos_w1 cos_h1 / r1². It sends ρ_h/π of that on; the seen point gets it under the solid
    angle dA cos_h2 / r2² and cos_w2, and reflects ρ_w/π. Confocal: Φ ρ_w² ρ_h dA cos_w² cos_h² /
    (π³ r⁴), at 2 d + 2 r.
    """
    value = power * wall**2 * hidden / math.pi**3 * area
    length = 0.0
    for point in (lit, seen):
        away = points - np.asarray(point, float)
        r = np.linalg.norm(away, axis=1)
        cos_wall = np.maximum(away[:, 2], 0) / r
        cos_hidden = np.maximum(-away @ normal, 0) / r
        value = value * cos_wall * cos_hidden / r**2
        length = length + r + np.linalg.norm(np.subtract(point, device))
    return length, value


def spots(device, target, sigma, count=60):
    """Points of the wall z = 0 that a Gaussian beam lights, with their shares; up to 5 σ."""
    axis = np.subtract(target, device) / np.linalg.norm(np.subtract(target, device))
    first = np.cross(axis, (0.0, 1.0, 0.0))
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    nodes = 5 * ((2 * np.arange(count) + 1) / count - 1)
    shares = np.exp(-0.5 * nodes**2)
    shares /= shares.sum()
    for x, a in zip(nodes, shares, strict=True):
        for y, b in zip(nodes, shares, strict=True):
            d = axis + math.tan(sigma) * (x * first + y * second)
            yield np.asarray(device) - d * device[2] / d[2], a * b


def plane_masses(edges, distance, power, wall, hidden) -> np.ndarray:
    """Confocal light of an infinite plane, parallel to the wall at D, in bins of r.

    All cosines are D/r, the ring at r has the area 2π r dr: dL/dr = 2 Φ ρ_w² ρ_h D⁴ / (π² r⁷).
    Beyond r lies Φ ρ_w² ρ_h D⁴ / (3 π² r⁶).
    """
    beyond = power * wall**2 * hidden * distance**4 / (3 * math.pi**2)
    return -np.diff(beyond / np.maximum(edges, distance) ** 6)


# ------------------------------------------------------------------------------------ phasors


def one_path(light, opl, frequency_hz) -> dict[str, float]:
    """Result of a correlation sensor for a single path with some light and length."""
    turns = frequency_hz * opl / SPEED_OF_LIGHT
    return {
        "I": light * math.cos(2 * math.pi * turns),
        "Q": light * math.sin(2 * math.pi * turns),
        "amplitude": light,
        "phase": 2 * math.pi * math.remainder(turns, 1.0),
        "depth": math.fmod(opl / 2, SPEED_OF_LIGHT / 2 / frequency_hz),
    }


def binned(edges, opl, light) -> np.ndarray:
    """Light in bins."""
    return np.histogram(opl, edges, weights=light)[0]


def disk_average(value, h, radius, radiance, fine=2000) -> complex:
    """∫ dE/dr value(r) dr of the disk light."""
    edges = np.linspace(h, math.hypot(h, radius), fine + 1)
    middles = np.array([0.5 * (a + b) for a, b in pairwise(edges)])
    return np.sum(disk_masses(edges, h, radius, radiance) * value(middles))


# ------------------------------------------------------------------------- fog and polarizers


def absorbed(bins, mu_a, start, width) -> np.ndarray:
    """Mean of exp(-mu_a s) over each bin, by many points."""
    fine = (np.arange(400) + 0.5) / 400
    lengths = start + width * (np.arange(bins)[:, None] + fine)
    return np.exp(-mu_a * lengths).mean(axis=1)


def turn_cdf(cosine, g) -> np.ndarray:
    """Share of turns with a smaller cosine: the integral of (1 - g²) / (2 (1 + g² - 2 g c)^1.5)."""
    cosine = np.asarray(cosine, float)
    if g == 0:
        return (1 + cosine) / 2
    return (1 - g * g) / (2 * g) * ((1 + g * g - 2 * g * cosine) ** -0.5 - 1 / (1 + g))


def wandered(mu_s, g, s) -> np.ndarray:
    """⟨z⟩, ⟨x²⟩, ⟨y²⟩, ⟨z²⟩ after the path length s, exact to all orders of scattering.

    n turns leave g^n of the mean cosine, and g^2n of the mean of its second Legendre polynomial. n
    is Poisson's, so ⟨u_z⟩ = exp(-a s), a = mu_s (1 - g), ⟨u_z²⟩ = 1/3 + 2/3 exp(-b s), b =
    mu_s (1 - g²), and ⟨u(t) u(t')⟩ = ⟨u(t)²⟩ exp(-a (t' - t)); integrated over both.
    """
    a = mu_s * (1 - g)
    b = mu_s * (1 - g * g)
    t = s * (np.arange(20_000) + 0.5) / 20_000
    later = (1 - np.exp(-a * (s - t))) / a
    along = 2 * s * np.mean((1 + 2 * np.exp(-b * t)) / 3 * later)
    across = 2 * s * np.mean((1 - np.exp(-b * t)) / 3 * later)
    return np.array([(1 - math.exp(-a * s)) / a, across, across, along])


def polarized(stokes, angle) -> np.ndarray:
    """Behind a polarizer: the part that passes, all of it along the axis."""
    s0, s1, s2 = (np.asarray(stokes, float)[..., k] for k in range(3))
    axis = np.array([1, math.cos(2 * angle), math.sin(2 * angle), 0])
    return ((s0 + axis[1] * s1 + axis[2] * s2) / 2)[..., None] * axis
