"""Small scenes with known light, and a lens to render them with."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

# -------------------------------------------------------------------------------------- lens


class MitsubasLens:
    """A lens by Mitsuba's own sampling of a camera's importance, so that none has to be written.

    Its film must not be cropped, nor its principal point shifted.
    """

    def __init__(self, sensor):
        self.sensor = sensor
        middle = sensor.world_transform() @ mi.Point3f(0)
        axis = dr.normalize(sensor.world_transform() @ mi.Vector3f(0, 0, 1))
        parameters = mi.traverse(sensor)
        self.axis = axis
        self.near = parameters["near_clip"]
        self.radius = None
        if "aperture_radius" in parameters:
            self.radius = parameters["aperture_radius"]
        if self.radius is None:  # else no single point is the lens's
            self.position = middle
        self.straight = self.arrive(middle + axis, middle).density

    def sample(self, sampler):
        if self.radius is None:
            return self.position
        disk = mi.warp.square_to_uniform_disk_concentric(sampler.next_2d()) * self.radius
        return self.sensor.world_transform() @ mi.Point3f(disk.x, disk.y, 0)

    def density(self, d):
        """Density of camera rays, also at the edge of the film, where rounding can be outside."""
        return self.straight / dr.power(dr.dot(d, self.axis), 3)

    def importance(self, d):
        return self.density(d) / dr.dot(d, self.axis)

    def arrive(self, p, lens):
        at = dr.zeros(mi.Interaction3f, dr.width(p))
        at.p = mi.Point3f(p)
        u = mi.Point2f(0.5)
        if self.radius is not None:
            local = self.sensor.world_transform().inverse() @ mi.Point3f(lens)
            u = mi.warp.uniform_disk_to_square_concentric(
                mi.Point2f(local.x, local.y) / self.radius
            )
        ds, weight = self.sensor.sample_direction(at, u)
        distance = dr.norm(p - lens)
        d = (p - lens) / distance
        seen = (ds.pdf > 0) & (dr.max(weight) > 0)
        return Arrival(
            lens=mi.Point3f(lens),
            near=lens + d * (self.near / dr.dot(d, self.axis)),
            direction=-d,
            distance=distance,
            density=dr.select(seen, weight.x * dr.square(distance), 0),
            position=mi.Point2f(ds.uv),
            seen=seen,
        )


class Arrival:
    """All that an arrival has."""

    def __init__(self, **fields):
        self.__dict__.update(fields)


# ------------------------------------------------------------------------------------- parts


def gray(value):
    return {"type": "rgb", "value": [value] * 3}


def rgb(*value):
    return {"type": "rgb", "value": list(value)}


def diffuse(albedo):
    return {"type": "diffuse", "reflectance": rgb(*np.broadcast_to(albedo, 3).tolist())}


def rectangle(matrix, bsdf, **more):
    return {"type": "rectangle", "to_world": mi.ScalarTransform4f(matrix), "bsdf": bsdf, **more}


def flat(z, half=20.0, up=True):
    """A square across the z axis, its matrix."""
    matrix = np.diag([half, half if up else -half, 1.0 if up else -1.0, 1.0])
    matrix[2, 3] = z
    return matrix


def glass(inside=1.5, outside=1.0):
    return {"type": "dielectric", "int_ior": inside, "ext_ior": outside}


def camera(
    origin,
    target,
    fov=40.0,
    near_clip=1e-3,
    size=(8, 8),
    bins=(1, 0.0, 100.0),
    up=(0, 1, 0),
    crop=None,
    shift=(0.0, 0.0),
    far_clip=1e4,
    mirrored=False,
    aperture=0.0,
    focus=1.0,
):
    """A pinhole over a film with time; `bins` is (number, start, width), `crop` (x, y, w, h).

    With an `aperture` [m] it is a thin lens.
    """
    names = ("temporal_bins", "start_opl", "bin_width_opl")
    film = {"type": "transient_hdr_film", "width": size[0], "height": size[1]}
    film |= dict(zip(names, (int(bins[0]), float(bins[1]), float(bins[2])), strict=True))
    film["rfilter"] = {"type": "box"}
    if crop is not None:
        names = ("crop_offset_x", "crop_offset_y", "crop_width", "crop_height")
        film |= dict(zip(names, map(int, crop), strict=True))
    to_world = mi.ScalarTransform4f().look_at(list(origin), list(target), list(up))
    if mirrored:
        to_world = to_world @ mi.ScalarTransform4f().scale([-1, 1, 1])
    sensor = {
        "type": "perspective",
        "fov": fov,
        "near_clip": near_clip,
        "far_clip": far_clip,
        "to_world": to_world,
        "film": film,
        "sampler": {"type": "independent", "sample_count": 16},
    }
    if aperture:
        return sensor | {"type": "thinlens", "aperture_radius": aperture, "focus_distance": focus}
    return sensor | {
        "principal_point_offset_x": shift[0],
        "principal_point_offset_y": shift[1],
    }


def load(parts):
    """Load a scene without merging its shapes."""
    return mi.load_dict({"type": "scene"} | parts, parallel=False, optimize=False)


def point(position, intensity):
    return {"type": "point", "position": list(position), "intensity": rgb(*intensity)}


# ------------------------------------------------------------------------------------ scenes


def square(x, y, z, half):
    """A black square across the z axis."""
    matrix = flat(z, half)
    matrix[:2, 3] = x, y
    return rectangle(matrix, {"type": "twosided", "bsdf": diffuse(0.0)})


def spot(position, intensity, target, cutoff, beam, weight=1.0):
    """A spot light; angles in degrees, and how often it is chosen."""
    up = (0.3, 0.8, 0.1)
    turn = mi.ScalarTransform4f().look_at(list(position), list(target), list(up))
    return {
        "type": "spot",
        "to_world": turn,
        "intensity": rgb(*intensity),
        "cutoff_angle": cutoff,
        "beam_width": beam,
        "sampling_weight": weight,
    }


def floor(
    view,
    lights,
    albedo=0.5,
    blockers=(),
    alpha=None,
    flipped=False,
    mirrored=0.0,
    spots=(),
    panels=(),
):
    """A floor z = 0 under point lights (position, intensity), and black squares (x, y, z, half).

    With `alpha` it is rough metal; flipped, its normal is down and both sides reflect; `mirrored`
    is the share of a mirror in it. `spots` are arguments of `spot`, `panels` (z, half, radiance)
    face down.
    """
    bsdf = diffuse(albedo)
    if mirrored:
        mirror = {"type": "conductor", "material": "none"}
        bsdf = {"type": "blendbsdf", "weight": mirrored, "matte": bsdf, "mirror": mirror}
    if alpha is not None:
        bsdf = {"type": "roughconductor", "material": "none", "alpha": alpha, "distribution": "ggx"}
    if flipped:
        bsdf = {"type": "twosided", "bsdf": bsdf}
    parts = {"sensor": view, "floor": rectangle(flat(0.0, up=not flipped), bsdf)}
    for number, (position, intensity) in enumerate(lights):
        parts[f"light_{number}"] = point(position, intensity)
    for number, those in enumerate(spots):
        parts[f"spot_{number}"] = spot(*those)
    for number, (z, half, radiance) in enumerate(panels):
        panel = rectangle(flat(z, half, up=False), diffuse(0.0))
        panel["emitter"] = {"type": "area", "radiance": rgb(*radiance)}
        parts[f"panel_{number}"] = panel
    for number, those in enumerate(blockers):
        parts[f"blocker_{number}"] = square(*those)
    return load(parts)


def by_mirror(view, lamp, mirror, albedo, color):
    """A floor z = 0, a spot light on it, and a colored mirror above both."""
    clear = {"type": "conductor", "material": "none", "specular_reflectance": rgb(*color)}
    return load(
        {
            "sensor": view,
            "floor": rectangle(flat(0.0), diffuse(albedo)),
            "lamp": spot(*lamp),
            "mirror": rectangle(flat(mirror, up=False), clear),
        }
    )


def by_floor(view, ceiling, panel, radiance, albedo, screen=None):
    """A floor z = 0 under a square light (z, half) that faces down, under a ceiling."""
    lamp = rectangle(flat(*panel, up=False), diffuse(0.0))
    lamp["emitter"] = {"type": "area", "radiance": rgb(*radiance)}
    above = rectangle(flat(ceiling, up=False), diffuse(albedo))
    below = rectangle(flat(0.0), diffuse(albedo))
    parts = {"sensor": view, "floor": below, "ceiling": above, "panel": lamp}
    if screen is not None:
        parts["screen"] = square(*screen)
    return load(parts)


def under_panel(view, half, height, radiance, albedo=0.5):
    """A floor z = 0 under a square light that faces down."""
    panel = rectangle(flat(height, half, up=False), diffuse(0.0))
    panel["emitter"] = {"type": "area", "radiance": gray(radiance)}
    return load({"sensor": view, "floor": rectangle(flat(0.0), diffuse(albedo)), "panel": panel})


def inside_sphere(view, radius, albedo, intensity):
    """A diffuse sphere around a point light in its middle."""
    sphere = {"type": "sphere", "radius": radius, "flip_normals": True, "bsdf": diffuse(albedo)}
    return load({"sensor": view, "sphere": sphere, "light": point([0] * 3, [intensity] * 3)})


def inside_bubble(view, radius, bubble, albedo, intensity, index):
    """A sphere filled with a medium, with a bubble of air around camera and light."""
    sphere = {"type": "sphere", "radius": radius, "flip_normals": True, "bsdf": diffuse(albedo)}
    air = {"type": "sphere", "radius": bubble, "bsdf": glass(1.0, outside=index)}
    light = point([0] * 3, [intensity] * 3)
    return load({"sensor": view, "sphere": sphere, "bubble": air, "light": light})


def under_slab(view, bottom, top, light, intensity, albedo=0.5, index=1.5):
    """A floor z = 0 under a wide slab of glass, and a point light above it."""
    # Not a cube: rays slip through the diagonals of its large faces
    return load(
        {
            "sensor": view,
            "floor": rectangle(flat(0.0, 50.0), diffuse(albedo)),
            "above": rectangle(flat(top, 50.0), glass(index)),
            "below": rectangle(flat(bottom, 50.0, up=False), glass(index)),
            "light": point((0, 0, light), [intensity] * 3),
        }
    )


def under_water(view, depth, light, intensity, index=1.33, albedo=0.5):
    """A floor z = 0 under water of some depth, and a point light above it."""
    surface = rectangle(flat(depth, 50.0), glass(index))
    return load(
        {
            "sensor": view,
            "floor": rectangle(flat(0.0, 50.0), diffuse(albedo)),
            "surface": surface,
            "light": point((0, 0, light), [intensity] * 3),
        }
    )


def under_ball(view, radius, light, floor_z, intensity, index=1.5, albedo=0.5):
    """A glass ball around the origin, a point light above it and a floor below."""
    ball = {"type": "sphere", "radius": radius, "bsdf": glass(index)}
    return load(
        {
            "sensor": view,
            "floor": rectangle(flat(floor_z, 50.0), diffuse(albedo)),
            "ball": ball,
            "light": point((0, 0, light), [intensity] * 3),
        }
    )


def beside_mirror(view, x, light, intensity, albedo=0.5):
    """A floor z = 0, a mirror in the plane at x that faces -x, and a point light."""
    # Columns: u = y, v = z, normal = -x
    matrix = np.array([[0, 0, -1, x], [20.0, 0, 0, 0], [0, -20.0, 0, 0], [0, 0, 0, 1]])
    mirror = rectangle(matrix, {"type": "conductor", "material": "none"})
    return load(
        {
            "sensor": view,
            "floor": rectangle(flat(0.0), diffuse(albedo)),
            "mirror": mirror,
            "light": point(light, [intensity] * 3),
        }
    )


def room(view, mirror=True, unit=1.0, radiance=(3.0, 2.2, 1.5)):
    """A closed room of 2 units: a panel under its ceiling, a glossy block, a wall that is a mirror.

    Without a mirror, that wall, the floor and the ceiling are glossy. Densities of the glossy
    material are equal in both directions, but densities of diffuse materials are not.
    """
    walls = {"sensor": view}
    white = diffuse(0.6)
    red = {"type": "diffuse", "reflectance": rgb(0.6, 0.2, 0.1)}
    glossy = {"type": "roughconductor", "alpha": 0.3, "sample_visible": False}
    clear = {"type": "conductor", "material": "none"}

    def turn():
        return mi.ScalarTransform4f().scale(unit)

    for name, axis, angle, bsdf in (
        ("floor", (1, 0, 0), -90, white if mirror else glossy),
        ("ceiling", (1, 0, 0), 90, white if mirror else glossy),
        ("left", (0, 1, 0), 90, red),
        ("right", (0, 1, 0), -90, clear if mirror else glossy),
        ("back", (0, 1, 0), 0, white),
        ("front", (0, 1, 0), 180, white),
    ):
        matrix = turn().rotate(list(axis), angle).translate([0, 0, -1])
        walls[name] = {"type": "rectangle", "to_world": matrix, "bsdf": bsdf}
    block = turn().translate([-0.3, -0.7, -0.2]).rotate([0, 1, 0], 30).scale([0.25, 0.3, 0.25])
    walls["block"] = {"type": "cube", "to_world": block, "bsdf": glossy}
    panel = turn().translate([0.1, 0.8, 0.0]).rotate([1, 0, 0], 90).scale([0.5, 0.5, 1])
    walls["panel"] = {"type": "rectangle", "to_world": panel, "bsdf": diffuse(0.0)}
    walls["panel"]["emitter"] = {"type": "area", "radiance": rgb(*radiance)}
    return load(walls)
