"""Parts of scenes as dicts, and optics in NumPy, for what the staff's tests draw."""

from __future__ import annotations

import math

import numpy as np

# ------------------------------------------------------------------------------------- parts


def color(value):
    """Three channels."""
    return {"type": "rgb", "value": np.broadcast_to(np.asarray(value, float), 3)}


def diffuse(albedo):
    return {"type": "diffuse", "reflectance": color(albedo)}


def placed(center, right, up, half):
    """The matrix of a rectangle [-1, 1]² with its center, axes of length 1 and half sizes."""
    matrix = np.eye(4)
    matrix[:3] = np.stack(
        [np.multiply(right, half[0]), np.multiply(up, half[1]), np.cross(right, up), center], axis=1
    )
    return matrix


def square(center, half, bsdf, down=False, **more):
    """A horizontal square that faces up, or down."""
    up = (0, -1, 0) if down else (0, 1, 0)
    return {
        "type": "rectangle",
        "to_world": placed(center, (1, 0, 0), up, (half, half)),
        "bsdf": bsdf,
        **more,
    }


def point(position, intensity):
    return {"type": "point", "position": np.asarray(position), "intensity": color(intensity)}


def sphere(radius, albedo, **more):
    """A sphere around the origin, seen from inside."""
    return {
        "type": "sphere",
        "radius": radius,
        "flip_normals": True,
        "bsdf": diffuse(albedo),
        **more,
    }


def panel(height, radius, radiance):
    """A disk light at (0, 0, height) that faces down."""
    return {
        "type": "disk",
        "to_world": placed((0, 0, height), (1, 0, 0), (0, -1, 0), (radius, radius)),
        "bsdf": diffuse(0.0),
        "emitter": {"type": "area", "radiance": color(radiance)},
    }


# ------------------------------------------------------------------------------------ optics


def unit(v):
    v = np.asarray(v, float)
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def ggx(alpha, wi, wo, normal=(0.0, 0.0, 1.0)):
    """A perfect rough conductor's f cos_o: D G1(i) G1(o) / (4 cos_i), after Walter et al., 2007."""
    normal = np.asarray(normal)
    h = unit(np.asarray(wi) + wo)

    def masking(w):
        cos = np.clip(w @ normal, 1e-9, 1)
        return 2 / (1 + np.sqrt(1 + alpha**2 * (1 / cos**2 - 1)))

    cos_i = np.asarray(wi) @ normal
    cos_o = wo @ normal
    cos_h = h @ normal
    density = alpha**2 / (math.pi * ((alpha**2 - 1) * cos_h**2 + 1) ** 2)
    value = density * masking(np.asarray(wi)) * masking(wo) / (4 * np.maximum(cos_i, 1e-9))
    return np.where((cos_i > 0) & (cos_o > 0), value, 0)


def fresnel(cos, eta):
    """Reflectance of a boundary for unpolarized light that comes from air."""
    inside = np.sqrt(1 - (1 - cos**2) / eta**2)
    s = (cos - eta * inside) / (cos + eta * inside)
    p = (eta * cos - inside) / (eta * cos + inside)
    return (s**2 + p**2) / 2


def under_coat(cos_i, cos_o, eta):
    """Reflection of the base of `plastic`, over albedo cos_o / π: in and out by Fresnel.

    Internal reflection is included as in Mitsuba, by a fit of its mean.
    """
    x = 1 / eta
    within = 0.0636 * eta + x * (x * -1.4399 + 0.7099) + 0.6681
    return (1 - fresnel(cos_i, eta)) * (1 - fresnel(cos_o, eta)) / ((1 - within) * eta**2)


def pane(cos, eta):
    """Transmittance of a thin pane, including all internal reflections."""
    r = fresnel(cos, eta)
    return 1 - 2 * r / (1 + r)


def on_panel(height, radius, rings=120, turns=240):
    """Points of `panel`, and the area of each."""
    r = radius * np.sqrt((np.arange(rings) + 0.5) / rings)
    a = 2 * math.pi * (np.arange(turns) + 0.5) / turns
    r, a = (each.ravel() for each in np.meshgrid(r, a))
    points = np.stack([r * np.cos(a), r * np.sin(a), np.full(r.shape, height)], axis=1)
    return points, math.pi * radius**2 / r.size


def blocked(a, b, center, right, up, half):
    """Whether segments from a to b, arrays of points that broadcast, meet a rectangle."""
    a, b = np.broadcast_arrays(np.asarray(a, float), np.asarray(b, float))
    normal = np.cross(right, up)
    from_a = (a - center) @ normal
    from_b = (b - center) @ normal
    with np.errstate(all="ignore"):
        t = from_a / (from_a - from_b)
        meets = a + t[..., None] * (b - a) - center
        inside = (np.abs(meets @ np.asarray(right)) < half[0]) & (
            np.abs(meets @ np.asarray(up)) < half[1]
        )
    return (from_a * from_b < 0) & inside
