"""Scenes with known radiance, as dicts; transforms are 4 x 4 arrays."""

from __future__ import annotations

import numpy as np


def rgb(*values):
    """A color."""
    return {"type": "rgb", "value": list(values) if len(values) == 3 else [*values] * 3}


def diffuse(albedo):
    """A diffuse material."""
    return {"type": "diffuse", "reflectance": rgb(albedo)}


def lamp(radiance):
    """Emitter that turns a shape into a light."""
    return {"type": "area", "radiance": rgb(radiance)}


BLACK = diffuse(0.0)


def frame(origin, z, scale=1.0):
    """A transform that maps +z to the direction `z`, and the origin to `origin`."""
    z = np.asarray(z, float) / np.linalg.norm(z)
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    m = np.eye(4)
    m[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1) * np.broadcast_to(scale, 3)
    m[:3, 3] = origin
    return m


def rectangle(origin, z, size, bsdf, **more):
    """A rectangle around `origin` with the normal `z`; `size` is half its width and height."""
    size = np.append(np.broadcast_to(size, 2), 1.0)
    return {"type": "rectangle", "to_world": frame(origin, z, size), "bsdf": bsdf, **more}


def disk(origin, z, radius, bsdf, **more):
    """A disk around `origin` with the normal `z`."""
    return {"type": "disk", "to_world": frame(origin, z, radius), "bsdf": bsdf, **more}


def sphere(center, radius, bsdf, **more):
    """A sphere."""
    return {"type": "sphere", "center": list(center), "radius": radius, "bsdf": bsdf, **more}


def floor(albedo=0.8, size=50.0):
    """The plane z = 0, seen from above."""
    return rectangle([0, 0, 0], [0, 0, 1], size, diffuse(albedo))


def scene(**parts):
    """A scene without camera."""
    return {"type": "scene", **parts}


def integrating_sphere(radius, radiance, albedo):
    """The inside of a diffuse unit sphere around a black ball that emits."""
    return scene(
        wall=sphere([0, 0, 0], 1.0, diffuse(albedo), flip_normals=True),
        ball=sphere([0, 0, 0], radius, BLACK, emitter=lamp(radiance)),
    )


def photo(width, height, origin, z, size):
    """An orthographic camera that looks along `z` at a square of half the side `size`."""
    return {
        "type": "orthographic",
        "to_world": frame(origin, z, [size, size, 1.0]),
        "sampler": {"type": "independent"},
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
            "component_format": "float32",
        },
    }
