"""Light around a corner, by quadrature: what the lit point of a wall sends through patches."""

from __future__ import annotations

import math

import numpy as np
from formulas import patch
from scenes_staff import diffuse, unit


class Patch:
    """A hidden rectangle, in small parts.

    Attributes:
        points, normal, area: Its parts, each of the same area.
        albedo: One for each channel.
        part: Dict for `described`.
    """

    def __init__(self, center, half, albedo, tilt=0.0, azimuth=0.0, cells=24):
        self.points, self.normal, self.area, matrix = patch(center, tilt, azimuth, half, cells)
        self.albedo = np.asarray(albedo)
        self.part = {"type": "rectangle", "to_world": matrix, "bsdf": diffuse(albedo)}

    def turned(self, is_seen):
        """The patch turned around; its back reflects if it is visible."""
        bsdf = self.part["bsdf"]
        matrix = self.part["to_world"] @ np.diag([1.0, -1.0, -1.0, 1.0])
        return self.part | {
            "to_world": matrix,
            "bsdf": {"type": "twosided", "bsdf": bsdf} if is_seen else bsdf,
        }


def legs(p, each):
    """From a point of the wall z = 0 to the parts of a patch: cos cos / r² (both ends), and r."""
    away = each.points - p
    r = np.linalg.norm(away, axis=1)
    cosines = np.maximum(away[:, 2], 0) * np.maximum(-away @ each.normal, 0) / r**2
    return cosines / r**2, r


def one_patch(p, d, each, wall, power):
    """(light, light x length) of laser, p, patch, p, camera: Φ ρ_w² ρ A cos⁴ / (π³ r⁴)."""
    g, r = legs(p, each)
    light = power * g**2 * each.area / math.pi**3
    return _sums(light, 2 * d + 2 * r, wall**2 * each.albedo)


def two_patches(p, d, first, second, wall, power):
    """Light and length of paths over two patches, in both orders."""
    (g1, r1), (g2, r2) = legs(p, first), legs(p, second)
    away = second.points[None] - first.points[:, None]
    r = np.linalg.norm(away, axis=2)
    between = np.maximum(away @ first.normal, 0) * np.maximum(-away @ second.normal, 0) / r**4
    light = g1[:, None] * between * g2[None] * first.area * second.area
    length = 2 * d + r1[:, None] + r + r2[None]
    albedos = wall**2 * first.albedo * second.albedo
    return _sums(2 * power * light / math.pi**4, length, albedos)


def _sums(light, length, albedos):
    return light.sum() * albedos, (light * length).sum() * albedos


def lit_points(random, number):
    """Points of the wall, devices that look at them from aside, and how far those are."""
    for _ in range(number):
        p = np.array([random.uniform(0.25, 0.35), random.uniform(-0.1, 0.1), 0.0])
        eye = np.array([random.uniform(0.1, 0.3), *random.uniform([-1.0, 0.3], [-0.8, 0.45])])
        yield p, eye, float(np.linalg.norm(eye - p))


def facing(center, point):
    """Tilt and azimuth [degrees] of a `patch` at `center` that faces a point."""
    n = unit(np.subtract(point, center))
    return {
        "tilt": math.degrees(math.acos(-n[2])),
        "azimuth": math.degrees(math.atan2(n[1], n[0])),
    }
