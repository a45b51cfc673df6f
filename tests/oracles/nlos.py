"""Hidden surfaces in closed form, and scenes of them: what a relay wall sees after three bounces.

A laser of power Φ lights the point p of a diffuse wall, which becomes a source of intensity
Φ ρ_p cos_p / π. It gives a hidden surface element dA at q the irradiance I cos_q / r1², and
reflects the radiance ρ_q / π of that; the wall's point s receives the irradiance L cos_s cos_q' dA
/ r2² and reflects ρ_s / π of it to the sensor:

    L = Φ ρ_p ρ_q ρ_s / π³ ∫ cos_p cos_q cos_q' cos_s / (r1² r2²) dA   at d_p + r1 + r2 + d_s.

All cosines are positive or the light is zero. The integral is over the surface, in float64.
"""

from __future__ import annotations

import gc
import math
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import mitsuba as mi
import numpy as np
from helpers.parts import diffuse, gray, unit
from helpers.support import film
from numpy.polynomial.legendre import leggauss

import tofrender


@dataclass
class Nodes:
    """Points to integrate a surface by: positions, unit normals (n, 3), and areas (n,)."""

    points: np.ndarray
    normals: np.ndarray
    areas: np.ndarray

    def __add__(self, other: Nodes) -> Nodes:
        mine, theirs = vars(self), vars(other)
        return Nodes(**{k: np.concatenate([mine[k], theirs[k]]) for k in mine})


@dataclass
class Rectangle:
    """A rectangle `center` ± `u` ± `v` whose front is towards u x v."""

    center: Any
    u: Any
    v: Any
    albedo: float = 0.7

    @property
    def normal(self) -> np.ndarray:
        return unit(np.cross(self.u, self.v))

    @property
    def area(self) -> float:
        return float(4 * np.linalg.norm(np.cross(self.u, self.v)))

    @classmethod
    def turned(cls, center, tilt: float, azimuth: float, half=(0.1, 0.1), **more) -> Rectangle:
        """Facing -z, then turned by `tilt` degrees away from it, towards `azimuth`."""
        t, a = math.radians(tilt), math.radians(azimuth)
        u = np.array([math.cos(a), math.sin(a), 0])
        v = np.array([math.sin(a), -math.cos(a), 0])  # u x v is -z
        u = math.cos(t) * u + math.sin(t) * np.array([0, 0, 1])
        return cls(center, half[0] * u, half[1] * v, **more)

    def flipped(self) -> Rectangle:
        return Rectangle(self.center, self.u, -np.asarray(self.v), self.albedo)

    def matrix(self) -> np.ndarray:
        result = np.eye(4)
        columns = (self.u, self.v, self.normal, self.center)
        result[:3] = np.stack([np.asarray(c, float) for c in columns], axis=1)
        return result

    def shape(self, bsdf: dict | None = None, **more) -> dict:
        to_world = mi.ScalarTransform4f(self.matrix())
        return {"type": "rectangle", "to_world": to_world, "bsdf": bsdf or diffuse(self.albedo)} | (
            more
        )

    def nodes(self, across: int = 200, along: int = 200) -> Nodes:
        """Midpoints of equal cells."""
        s, t = ((2 * np.arange(n) + 1) / n - 1 for n in (across, along))
        s, t = (a.ravel() for a in np.meshgrid(s, t))
        points = np.asarray(self.center) + np.outer(s, self.u) + np.outer(t, self.v)
        areas = np.full(len(points), self.area / len(points))
        return Nodes(points, np.broadcast_to(self.normal, points.shape), areas)


def sphere_nodes(center, radius: float, order: int = 200) -> Nodes:
    """The whole sphere: Gauss in z, even in angle."""
    z, w = leggauss(order)
    phi = 2 * np.pi * (np.arange(order) + 0.5) / order
    sin = np.sqrt(1 - z * z)
    normals = np.stack(
        [np.outer(sin, np.cos(phi)), np.outer(sin, np.sin(phi)), np.outer(z, np.ones(order))], -1
    ).reshape(-1, 3)
    areas = np.repeat(w, order) * 2 * np.pi * radius**2 / order
    return Nodes(np.asarray(center) + radius * normals, normals, areas)


@dataclass
class Setup:
    """A flat wall at z = 0 towards +z, laser and sensor: power [W], albedo, positions [m]."""

    sensor: Any = (-0.6, 0.3, 1.2)
    laser: Any = None
    power: float = 1.0
    albedo: float = 0.8
    normal: Any = (0.0, 0.0, 1.0)
    legs: bool = True

    def length(self, lit, seen) -> float:
        laser = self.sensor if self.laser is None else self.laser
        away = [np.subtract(lit, laser), np.subtract(seen, self.sensor)]
        return self.legs * sum(float(np.linalg.norm(a)) for a in away)


def three_bounces(
    setup: Setup, hidden: Nodes, albedo: float, lit, seen, shading: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """(OPL, radiance) of each node. `shading` are normals by which the material sees the laser.

    With such normals, a path that comes from s meets the element under its true cosine cos_q', and
    the material multiplies by the cosine of the shading normal to the light.
    """
    shading = hidden.normals if shading is None else shading
    r, cos_wall, cos_true, cos_shading = [], [], [], []
    for point in (lit, seen):
        away = np.asarray(point, float) - hidden.points
        distance = np.linalg.norm(away, axis=1)
        r.append(distance)
        cos_wall.append(np.maximum(-away @ np.asarray(setup.normal) / distance, 0))
        cos_true.append(np.maximum(np.einsum("ij,ij->i", away, hidden.normals) / distance, 0))
        cos_shading.append(np.maximum(np.einsum("ij,ij->i", away, shading) / distance, 0))
    scale = setup.power * setup.albedo**2 * albedo / math.pi**3
    light = cos_wall[0] * cos_wall[1] * cos_shading[0] * cos_true[1] * (cos_shading[1] > 0)
    light = scale * light * hidden.areas / (r[0] ** 2 * r[1] ** 2)
    return r[0] + r[1] + setup.length(lit, seen), light


def total(setup: Setup, hidden: Nodes, albedo: float, lit, seen, **more) -> float:
    return float(three_bounces(setup, hidden, albedo, lit, seen, **more)[1].sum())


def masses(edges, opl: np.ndarray, light: np.ndarray) -> np.ndarray:
    return np.histogram(opl, edges, weights=light)[0]


def plane_masses(edges, setup: Setup, albedo: float, distance: float) -> np.ndarray:
    """Light of an infinite plane, parallel to the wall at `distance` D, in bins of r; confocal.

    All cosines are D / r, and the ring at the distance r has the area 2 π r dr, so dL/dr =
    2 Φ ρ_w² ρ_h D⁴ / (π² r⁷) for r > D; beyond r lies Φ ρ_w² ρ_h D⁴ / (3 π² r⁶).
    """
    r = np.maximum(edges, distance)
    scale = setup.power * setup.albedo**2 * albedo / (3 * math.pi**2)
    return -np.diff(scale * distance**4 / r**6)


def sphere_masses(edges, setup: Setup, albedo: float, point, center, radius: float) -> np.ndarray:
    """Light of a sphere in bins of r; confocal, the sphere all in front of the wall.

    Let D be the distance of the center c from the wall's point p. Points of the sphere at the
    distance r from p make a circle around the axis p c, at the angle a from it as seen from c, with
    r² = D² + R² - 2 D R cos a, so that r dr = D R sin a da and its area is 2 π R² sin a da =
    2 π R r dr / D. There (law of cosines) D² = R² + r² + 2 R r cos_h, which is positive up to
    r² = D² - R²; and R² = D² + r² - 2 D r cos γ for the angle γ between the directions from p to
    the point and to c. With β between the axis and the wall's normal, cos_w = cos β cos γ +
    sin β sin γ cos φ around the circle, whose square has the mean cos² β cos² γ +
    sin² β sin² γ / 2. So dL/dr = Φ ρ_w² ρ_h / π³ 2 π R / D <cos_w²> cos_h² / r³.
    """
    axis = np.subtract(center, point)
    distance = float(np.linalg.norm(axis))
    cos_b = float(np.dot(axis, setup.normal)) / distance
    x, w = leggauss(40)
    result = []
    nearest, farthest = distance - radius, math.sqrt(distance**2 - radius**2)
    for low, high in pairwise(np.clip(edges, nearest, farthest)):
        r = 0.5 * (low + high) + 0.5 * (high - low) * x
        cos_h = (distance**2 - radius**2 - r**2) / (2 * radius * r)
        cos_g = (distance**2 + r**2 - radius**2) / (2 * distance * r)
        square = cos_b**2 * cos_g**2 + 0.5 * (1 - cos_b**2) * (1 - cos_g**2)
        density = 2 * radius / distance * square * cos_h**2 / (math.pi**2 * r**3)
        result.append(0.5 * (high - low) * (w * density).sum())
    return setup.power * setup.albedo**2 * albedo * np.array(result)


@dataclass
class Groove:
    """Two faces at right angles that meet in an edge along y at (0, z) and open towards the wall.

    A confocal point at the origin sees both under 45°; all of each face sees all of the other.
    """

    z: float = 1.2
    width: float = 0.3
    half_length: float = 0.4
    albedo: float = 0.9

    def faces(self) -> tuple[Rectangle, Rectangle]:
        half = 0.5 * self.width / math.sqrt(2)
        along = np.array([0, self.half_length, 0])
        left = Rectangle((-half, 0, self.z - half), along, (half, 0, half), self.albedo)
        right = Rectangle((half, 0, self.z - half), along, (half, 0, -half), self.albedo)
        return left, right

    def long_total(self, setup: Setup) -> float:
        """Three bounces if the edge is infinite; confocal, at the origin.

        A face's plane is at h = z / √2 from the origin, which is also the distance v0 from the
        origin's foot to the edge. At v from the foot and u along the edge, r² = u² + w² with
        w² = h² + v²; cos_q = h / r and cos_p = Z(v) / r, where the height over the wall Z is
        (h + v) / √2 and does not depend on u. The integral of du / (u² + w²)⁴ is 5 π / (16 w⁷), so
        each face gives Φ ρ_w² ρ_h / π³ ∫ h² Z² 5 π / (16 w⁷) dv from v0 - width to v0.
        """
        x, weights = leggauss(60)
        h = self.z / math.sqrt(2)
        v = h - 0.5 * self.width * (1 - x)
        height, w = (h + v) / math.sqrt(2), np.hypot(h, v)
        integral = 0.5 * self.width * (weights * h**2 * height**2 * 5 * math.pi / 16 / w**7).sum()
        return 2 * setup.power * setup.albedo**2 * self.albedo / math.pi**3 * float(integral)

    def four_bounces(self, setup: Setup, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """(OPL, radiance) of random light paths p, one face, the other, p; confocal at the origin.

        A point q1, even on a face of area A, has the irradiance I cos / r1² and sends the fraction
        ρ of that power on, in directions that are even in cos: it lands at q2, where the part that
        the other face covers is again reflected, as by a source of intensity ρ cos / π. In all:
        Φ ρ_w² ρ_h² / π³ A <cos_p cos_1 / r1² [q2 is on the other face] cos_2 cos_s / r2²>. Light
        that starts on either face counts.
        """
        rng = np.random.default_rng(seed)
        opl, light = [], []
        normal = np.asarray(setup.normal)
        for first, second in (self.faces(), self.faces()[::-1]):
            s, t = rng.uniform(-1, 1, (2, count))
            q1 = np.asarray(first.center) + np.outer(s, first.u) + np.outer(t, first.v)
            radius, angle = np.sqrt(rng.uniform(size=count)), rng.uniform(0, 2 * np.pi, count)
            basis = unit(first.u), unit(first.v), first.normal
            local = radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - radius**2)
            d = sum(np.outer(a, b) for a, b in zip(local, basis, strict=True))
            along = d @ second.normal
            distance = (np.asarray(second.center) - q1) @ second.normal / along
            q2 = q1 + distance[:, None] * d
            hits = (distance > 0) & (along < 0)
            for axis in (second.u, second.v):
                square = np.dot(axis, axis)
                hits &= np.abs((q2 - np.asarray(second.center)) @ np.asarray(axis)) < square
            r1, r2 = np.linalg.norm(q1, axis=1), np.linalg.norm(q2, axis=1)
            ends = (q1 @ normal) * -(q1 @ first.normal) / r1**4
            ends *= (q2 @ normal) * -(q2 @ second.normal) / r2**4
            scale = setup.power * setup.albedo**2 * self.albedo**2 * first.area / math.pi**3
            opl.append((r1 + distance + r2)[hits] + setup.length((0, 0, 0), (0, 0, 0)))
            light.append(scale / count * ends[hits])
        return np.concatenate(opl), np.concatenate(light)


def relay_wall(
    setup: Setup, the_film: dict | None = None, to_world=None, spp: int = 256, **more
) -> dict:
    """A wall of 2 m x 2 m with its capture meter."""
    meter = {
        "type": "nlos_capture_meter",
        "sensor_origin": list(setup.sensor),
        "film": the_film or film(),
        "sampler": {"type": "independent", "sample_count": spp},
    }
    placed = {} if to_world is None else {"to_world": to_world}
    wall = {"type": "rectangle", "bsdf": diffuse(setup.albedo), "sensor": meter}
    return wall | placed | more


def confocal(setup: Setup, hidden: dict, the_film: dict | None = None, **options: Any) -> dict:
    """A scene for `confocal_transient_path`."""
    integrator = {"type": "confocal_transient_path", "power": setup.power, "filter_bounces": 3}
    if not setup.legs:
        integrator["account_first_and_last_bounces"] = False
    wall = relay_wall(setup, the_film)
    return {"type": "scene", "integrator": integrator | options, "relay_wall": wall} | hidden


def spot(origin, target, intensity: float = 1.0, angle: float = 5.0) -> dict:
    """A spot light, even within 4/5 of its angle [degrees]."""
    up = [0, 1, 0] if np.any(np.subtract(target, origin)[[0, 2]]) else [1, 0, 0]
    to_world = mi.ScalarTransform4f().look_at(list(origin), list(target), up)
    angles = {"cutoff_angle": angle, "beam_width": 0.8 * angle}
    return {"type": "spot", "intensity": gray(intensity), "to_world": to_world} | angles


def single(setup: Setup, hidden: dict, lit, the_film: dict | None = None, **options: Any) -> dict:
    """A scene for `transient_nlos_path` whose laser gives the lit point of the wall `power`."""
    away = np.subtract(setup.laser, lit)
    distance = float(np.linalg.norm(away))
    intensity = setup.power * distance**3 / float(np.dot(away, setup.normal))
    integrator = {
        "type": "transient_nlos_path",
        "nlos_laser_sampling": True,
        "nlos_hidden_geometry_sampling": True,
        "account_first_and_last_bounces": setup.legs,
        "filter_bounces": 3,
    }
    return {
        "type": "scene",
        "integrator": integrator | options,
        "relay_wall": relay_wall(setup, the_film),
        "laser": spot(setup.laser, lit, intensity),
    } | hidden


def load_nlos(description: dict) -> mi.Scene:
    return tofrender.load_scene(description, optimize=False)


def picture_film(width: int = 1, height: int | None = None) -> dict:
    sizes = {"width": width, "height": height or width, "rfilter": {"type": "box"}}
    return {"type": "hdrfilm", "pixel_format": "rgb", "component_format": "float32"} | sizes


def in_pictures(described: dict, the_film: dict, **integrator: Any) -> dict:
    """The same wall and lights, for an integrator of Mitsuba's that knows no time."""
    wall = described["relay_wall"]
    wall = wall | {"sensor": wall["sensor"] | {"film": the_film}}
    return described | {"relay_wall": wall, "integrator": integrator}


def estimates(description: dict | mi.Scene, spp: int, what: str = "steady"):
    """A function of the seed: the first channel of the picture (y, x) or the bins (y, x, t)."""
    gc.collect()  # Dr.Jit compiles what all living scenes might do
    loaded = load_nlos(description) if isinstance(description, dict) else description
    index = ("steady", "transient").index(what)

    def estimate(seed: int) -> np.ndarray:
        return np.array(mi.render(loaded, spp=spp, seed=seed)[index], dtype=np.float64)[..., 0]

    return estimate


@dataclass
class Grid:
    """Points of a wall like `relay_wall`'s that pixels look at."""

    width: int
    height: int
    matrix: np.ndarray = field(default_factory=lambda: np.eye(4))

    def point(self, x: float, y: float) -> np.ndarray:
        local = [(2 * x + 1) / self.width - 1, (2 * y + 1) / self.height - 1, 0, 1]
        return (self.matrix @ local)[:3]

    def points(self) -> np.ndarray:
        rows = [[self.point(x, y) for x in range(self.width)] for y in range(self.height)]
        return np.array(rows)
