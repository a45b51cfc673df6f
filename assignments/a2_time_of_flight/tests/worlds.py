"""Small scenes with known light, and pulses and modulations to render them with."""

from __future__ import annotations

import drjit as dr
import formulas
import mitsuba as mi
import numpy as np

# ----------------------------------------------------------------- what lengths count for


class Hat:
    """A pulse that rises evenly over its width and falls evenly again."""

    def __init__(self, width_opl):
        self.width_opl = width_opl
        self.normalization = 1 / width_opl
        self.support = (-width_opl, width_opl)

    def eval(self, t):
        return self.normalization * dr.maximum(1 - dr.abs(t) / self.width_opl, 0)

    def cdf(self, t):
        x = dr.clip(t / self.width_opl, -1, 1)
        return 0.5 + x - 0.5 * x * dr.abs(x)

    def sample(self, xi):
        x = 1 - dr.sqrt(2 * dr.minimum(xi, 1 - xi))
        return self.width_opl * dr.select(xi < 0.5, -x, x), mi.Float(1)


class Decay:
    """A pulse that starts at once and decays: the only one here that is not symmetric."""

    def __init__(self, width_opl):
        self.width_opl = width_opl
        self.normalization = 1 / width_opl
        self.support = (0.0, 12 * width_opl)

    def eval(self, t):
        return dr.select(t >= 0, self.normalization * dr.exp(-t / self.width_opl), 0)

    def cdf(self, t):
        return dr.select(t >= 0, 1 - dr.exp(-t / self.width_opl), 0)

    def sample(self, xi):
        return -self.width_opl * dr.log(dr.maximum(1 - xi, 2**-24)), mi.Float(1)


class Slope:
    """A pulse that starts at full power and decreases linearly to 0; it need not contain 0."""

    def __init__(self, first, last):
        self.support = (first, last)

    def eval(self, t):
        first, last = self.support
        inside = (t >= first) & (t <= last)
        return dr.select(inside, 2 * (last - t) / (last - first) ** 2, 0)

    def cdf(self, t):
        first, last = self.support
        left = (last - dr.clip(t, first, last)) / (last - first)
        return 1 - left * left

    def sample(self, xi):
        first, last = self.support
        return last - (last - first) * dr.sqrt(1 - xi), mi.Float(1)


class Box:
    """An even pulse from `first` to `last`."""

    def __init__(self, first, last):
        self.support = (first, last)

    def eval(self, t):
        first, last = self.support
        return dr.select((t >= first) & (t <= last), 1 / (last - first), 0)

    def cdf(self, t):
        first, last = self.support
        return (dr.clip(t, first, last) - first) / (last - first)

    def sample(self, xi):
        first, last = self.support
        return first + (last - first) * xi, mi.Float(1)


class Ramp:
    """A modulation that grows with the length, so its mean gives the mean length."""

    def __init__(self, at_zero, slope):
        self.at_zero = at_zero
        self.slope = slope

    def eval(self, opl):
        return self.at_zero + self.slope * opl


class Step:
    """A modulation that counts only light that is longer than a length."""

    def __init__(self, after):
        self.after = after

    def eval(self, opl):
        return dr.select(opl > self.after, mi.Float(1), 0)


def pulse(kind, *numbers):
    """A pulse by name, None for an instant."""
    kinds = {"hat": Hat, "decay": Decay, "slope": Slope, "box": Box, "none": lambda _: None}
    return kinds[kind](*(float(number) for number in numbers))


# ------------------------------------------------------------------------------------- parts


def gray(value):
    return {"type": "rgb", "value": [value] * 3}


def diffuse(albedo):
    return {"type": "diffuse", "reflectance": gray(albedo)}


def rectangle(matrix, bsdf, **more):
    return {"type": "rectangle", "to_world": mi.ScalarTransform4f(matrix), "bsdf": bsdf, **more}


def looking(origin, target, up=(0, 1, 0)):
    return mi.ScalarTransform4f().look_at(list(origin), list(target), list(up))


def camera(
    origin, target, fov=0.01, near_clip=1e-4, size=(1, 1), bins=None, up=(0, 1, 0), crop=None
):
    """A pinhole; `bins` is (number, start, width) for a film with time, `crop` (x, y, w, h)."""
    film = {"type": "hdrfilm", "width": size[0], "height": size[1], "rfilter": {"type": "box"}}
    film |= {"pixel_format": "rgb", "component_format": "float32"}
    if crop is not None:
        names = ("crop_offset_x", "crop_offset_y", "crop_width", "crop_height")
        film |= {name: int(value) for name, value in zip(names, crop, strict=True)}
    if bins is not None:
        names = ("temporal_bins", "start_opl", "bin_width_opl")
        time = dict(zip(names, (int(bins[0]), float(bins[1]), float(bins[2])), strict=True))
        film = {k: v for k, v in film.items() if "format" not in k}
        film |= {"type": "transient_hdr_film", **time}
    return {
        "type": "perspective",
        "fov": fov,
        "near_clip": near_clip,
        "to_world": looking(origin, target, up),
        "film": film,
        "sampler": {"type": "independent", "sample_count": 16},
    }


def load(parts):
    """Load a scene without merging its shapes."""
    # The default depth, because `render_amcw_phasor` may use the scene's integrator
    scene = {"type": "scene", "integrator": {"type": "path", "max_depth": 8}} | parts
    return mi.load_dict(scene, parallel=False, optimize=False)


def described(view, parts):
    """A scene from a dict of numbers and texts; matrices are arrays named `to_world`."""
    return load(
        ({} if view is None else {"sensor": view}) | {k: _made(v) for k, v in parts.items()}
    )


def _made(part):
    if not isinstance(part, dict):
        return part
    made = {key: _made(value) for key, value in part.items()}
    if "to_world" in made:
        made["to_world"] = mi.ScalarTransform4f(np.asarray(made["to_world"], np.float64))
    for key in {"position", "value"} & made.keys():
        made[key] = [float(each) for each in made[key]]
    return made


# ------------------------------------------------------------------------------------ scenes


def lamp(view, colors=((1.0, 1.0, 1.0), (1.0, 1.0, 1.0))):
    """A plane under a point light; the colors multiply its albedo and the light's intensity."""
    albedo, intensity = (
        {"type": "rgb", "value": [value * each for each in color]}
        for value, color in zip((formulas.ALBEDO, formulas.INTENSITY), colors, strict=True)
    )
    return load(
        {
            "sensor": view,
            "plane": rectangle(
                np.diag([20.0, 20, 1, 1]), {"type": "diffuse", "reflectance": albedo}
            ),
            "lamp": {"type": "point", "position": list(formulas.LIGHT), "intensity": intensity},
        }
    )


def lit_by_disk(view, h, radius, radiance):
    """A plane under a disk light, parallel and at the height h."""
    down = np.diag([radius, -radius, -1.0, 1.0])
    down[2, 3] = h
    disk = {"type": "disk", "to_world": mi.ScalarTransform4f(down), "bsdf": diffuse(0.0)}
    disk |= {"emitter": {"type": "area", "radiance": gray(radiance)}}
    floor = rectangle(np.diag([20.0, 20, 1, 1]), diffuse(0.5))
    return load({"sensor": view, "plane": floor, "disk": disk})


def light_and_mirror(view):
    """A panel of radiance 2 at z = 3 that faces down, over a mirror in z = 0."""
    down = np.diag([1.0, -1.0, -1.0, 1.0])
    down[2, 3] = 3
    panel = rectangle(down, diffuse(0.0), emitter={"type": "area", "radiance": gray(2.0)})
    mirror = rectangle(np.diag([20.0, 20, 1, 1]), {"type": "conductor", "material": "none"})
    return load({"sensor": view, "panel": panel, "mirror": mirror})


def inside_sphere(view, radius, albedo, intensity):
    """A diffuse sphere around a point light at the origin."""
    sphere = {"type": "sphere", "radius": radius, "flip_normals": True, "bsdf": diffuse(albedo)}
    light = {"type": "point", "position": [0.0] * 3, "intensity": gray(intensity)}
    return load({"sensor": view, "relay_wall": sphere, "light": light})


def around_corner(view, wall_albedo, hidden=(), floor=None, wall_size=5.0):
    """A wall z = 0 toward +z, hidden rectangles (matrix, albedo), and perhaps a floor (y)."""
    wall = np.diag([wall_size, wall_size, 1, 1])
    parts = {"sensor": view, "relay_wall": rectangle(wall, diffuse(wall_albedo))}
    for number, (matrix, albedo) in enumerate(hidden):
        parts[f"hidden_{number}"] = rectangle(np.asarray(matrix), diffuse(albedo))
    if floor is not None:
        y, half, albedo = floor
        # Toward +y: u = x, v = -z
        matrix = np.array([[half, 0, 0, 0], [0, 0, 1, y], [0, -half, 0, half], [0, 0, 0, 1]])
        parts["floor"] = rectangle(matrix, diffuse(albedo))
    return load(parts)
