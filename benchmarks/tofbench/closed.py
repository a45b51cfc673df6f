"""Cases with closed forms. Scenes are in cases.json; this module computes the exact values."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np

from . import forms
from .cases import Case

DATA = json.loads(Path(__file__).with_name("cases.json").read_text(encoding="utf-8"))

# ----- A lamp over a floor


def lamp_path(scene: dict, eye=None, x=None) -> tuple[float, float]:
    """Return OPL and radiance of the path by a floor point, by default the target of the camera."""
    camera = scene["camera"]
    lamp = scene["lights"]["lamp"]
    albedo = scene["shapes"]["floor"]["material"]["albedo"]
    eye = eye or camera["origin"]
    x = x or camera["target"]
    return forms.point_on_floor(eye, x, lamp["position"], lamp["intensity"], albedo)


def floor_paths(scene: dict, size: tuple[int, int] = (1, 1)) -> tuple:
    """Return OPL, radiance and pixel of paths by the floor."""
    camera = scene["camera"]
    lamp = scene["lights"]["lamp"]
    view = camera["origin"][2], camera["fov"], size
    albedo = scene["shapes"]["floor"]["material"]["albedo"]
    return forms.floor_in_view(*view, lamp["position"], lamp["intensity"], albedo)


def plane(scene: dict, bins: dict) -> np.ndarray:
    """Return the bins of one floor point."""
    return forms.histogram(bins, *lamp_path(scene))


def pulse(scene: dict, bins: dict) -> np.ndarray:
    """Return the bins of one floor point under a Gaussian pulse."""
    opl, radiance = lamp_path(scene)
    return radiance * np.diff(forms.gaussian_cdf((forms.edges(bins) - opl) / bins["pulse"]))


def floor(scene: dict, bins: dict) -> np.ndarray:
    """Return the bins of the floor in view."""
    return forms.histogram(bins, *floor_paths(scene)[:2])


def gates(scene: dict, bins: dict) -> np.ndarray:
    """Return the floor in Gaussian gates."""
    opl, light, _ = floor_paths(scene)
    scaled = (np.array(bins["opl"])[:, None] - opl) / bins["width"]
    return np.exp(-0.5 * scaled**2) @ light / (bins["width"] * np.sqrt(2 * np.pi))


def pixels(scene: dict, bins: dict) -> np.ndarray:
    """Return the bins of each pixel."""
    # Sum the paths of each pixel
    camera = scene["camera"]
    width = camera["width"]
    height = camera["height"]
    opl, radiance, pixel = floor_paths(scene, (width, height))
    masks = (pixel == k for k in range(width * height))
    parts = [forms.histogram(bins, opl[mask], radiance[mask]) for mask in masks]
    film = np.reshape(parts, (height, width, -1))

    # Crop the film
    x, y, w, h = camera.get("crop", (0, 0, width, height))
    return film[y : y + h, x : x + w]


def under(scene: dict) -> tuple[dict, float, float]:
    """Return the light, the distance from camera to floor, and the albedo of the floor."""
    shapes = scene["shapes"]
    camera = scene["camera"]
    seen = forms.distance(camera["origin"], camera["target"])
    return shapes["light"], seen, shapes["floor"]["material"]["albedo"]


def disk_light(scene: dict, bins: dict) -> np.ndarray:
    """Return the bins of a floor point under a disk."""
    light, seen, albedo = under(scene)
    shape = light["center"][2], light["u"][0]
    return forms.disk_light(bins, seen, *shape, light["radiance"], albedo)


def rectangle_light(scene: dict, bins: dict) -> np.ndarray:
    """Return the bins of a floor point under a rectangle."""
    light, seen, albedo = under(scene)
    x, y, h = light["center"]
    a = abs(light["u"][0])
    b = abs(light["v"][1])
    ranges = (x - a, x + a), (y - b, y + b)
    return forms.rectangle_light(bins, seen, h, *ranges, light["radiance"], albedo)


def sphere_light(scene: dict, bins: dict) -> np.ndarray:
    """Return the bins of a floor point under a sphere."""
    light, seen, albedo = under(scene)
    parts = light["center"], light["radius"], light["radiance"]
    return forms.sphere_light(bins, seen, *parts, albedo)


def absorption(scene: dict, bins: dict) -> np.ndarray:
    """Return the bins of a floor point in a box that absorbs light."""
    opl, radiance = lamp_path(scene)
    box = scene["shapes"]["fog"]
    x = scene["camera"]["target"]
    lamp = scene["lights"]["lamp"]

    # Both segments cross the whole height of the box
    through = 2 * box["half"][2] * (1 + forms.distance(x, lamp["position"]) / lamp["position"][2])
    loss = np.exp(-scene["media"]["fog"]["absorption"] * through)
    return forms.histogram(bins, opl, radiance * loss)


def gradient(scene: dict, bins: dict) -> np.ndarray:
    """Return the derivatives of light, and of light times length.

    The parameter is the height of the floor (dH/dz = -1) or the albedo.
    """
    lamp = scene["lights"]["lamp"]
    h = scene["camera"]["origin"][2]
    albedo = scene["shapes"]["floor"]["material"]["albedo"]
    r = float(np.hypot(lamp["position"][0], h))

    # By the albedo
    light = lamp["intensity"] / np.pi * h / r**3
    if bins["by"][1] == "albedo":
        return light * np.array([1, h + r])

    # By the height
    slope = albedo * lamp["intensity"] / np.pi * (1 / r**3 - 3 * h * h / r**5)
    return np.array([-slope, -(slope * (h + r) + albedo * light * (1 + h / r))])


# ----- Spheres and rooms


def furnace(scene: dict, bins: dict) -> np.ndarray:
    """Return the bins of a diffuse sphere, with light and camera at the center."""
    wall = scene["shapes"]["wall"]
    lamp = scene["lights"]["lamp"]
    segments = scene["segments"]
    bounces = 60 if segments < 0 else segments - 2
    albedo = wall["material"]["albedo"]
    return forms.furnace(bins, bounces, wall["radius"], albedo, lamp["intensity"])


def furnace_ear(scene: dict, bins: dict) -> np.ndarray:
    """Return the bins of a diffuse sphere for a receiver off the center."""
    wall = scene["shapes"]["wall"]
    lamp = scene["shapes"]["lamp"]
    ear = scene["camera"]["origin"]
    intensity = np.pi * lamp["radius"] ** 2 * lamp["radiance"]

    # Light leaves the surface of the lamp, which is one radius closer to the wall
    bins = bins | {"start": bins["start"] + lamp["radius"]}
    albedo = wall["material"]["albedo"]
    return forms.furnace(bins, scene["segments"] - 2, wall["radius"], albedo, intensity, ear[0])


def mirror_room(scene: dict, bins: dict) -> np.ndarray:
    """Return the bins of direct light and its images in five walls."""
    # Mirror the source at each wall except the floor
    room = scene["room"]
    source = scene["shapes"]["source"]
    images = [room["source"]]
    for axis, size in enumerate(room["size"]):
        for wall in (0.0, size)[axis == 2 :]:
            image = list(room["source"])
            image[axis] = 2 * wall - image[axis]
            images.append(image)

    # Add the light of all images
    albedo = scene["shapes"]["floor"]["material"]["albedo"]
    parts = source["radius"], source["radiance"], albedo
    ways = [np.subtract(image, room["receiver"]) for image in images]
    return sum(forms.sphere_light(bins, room["extra_opl"], way, *parts) for way in ways)


def chords(scene: dict, bins: dict) -> np.ndarray:
    """Return the distribution of the chords of a sphere."""
    r = np.clip(forms.edges(bins), 0, 2 * scene["shapes"]["shell"]["radius"])
    return np.pi * np.diff(r**2 / 4)


def sky(scene: dict, bins: dict) -> np.ndarray:
    """Return the bins of a ball under a constant sky. The first bin contains all light."""
    albedo = scene["shapes"]["ball"]["material"]["albedo"]
    light = scene["lights"]["sky"]
    return albedo * light["radiance"] * np.eye(bins["count"])[0]


def only_sum(scene: dict, bins: dict) -> np.ndarray:
    """Return the weights of the sum."""
    return np.ones((1, bins["count"]))


# ----- Mirrors, glass, a lens


def at_mirror(scene: dict) -> tuple[list[float], list[float]]:
    """Return the image of the camera in a horizontal mirror, and the floor point in view."""
    camera = scene["camera"]
    z = scene["shapes"]["mirror"]["center"][2]
    image = np.array(camera["origin"]) * [1, 1, -1] + [0, 0, 2 * z]
    away = np.array(camera["target"]) - image
    return image.tolist(), (image - away * image[2] / away[2]).tolist()


def mirror(scene: dict, bins: dict) -> np.ndarray:
    """Return light by path length, or by the rate of change 2 v cos of the path length."""
    image, x = at_mirror(scene)
    opl, radiance = lamp_path(scene, image, x)
    if bins["quantity"] == "rate":
        speed = scene["shapes"]["mirror"]["velocity"][2]
        opl = 2 * speed * (image[2] - x[2]) / forms.distance(image, x)
    return forms.histogram(bins, opl, radiance)


def slab_orders(scene: dict) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return OPL, S0 and S1 of the orders of a slab or ball, and S0 without polarization."""
    # Find angle and thickness
    camera = scene["camera"]
    light = scene["shapes"]["light"]
    glass = scene["shapes"].get("slab") or scene["shapes"]["ball"]
    away = np.subtract(camera["target"], camera["origin"])
    angle = float(np.degrees(np.arccos(-away[2] / np.linalg.norm(away))))
    thickness = 2 * (glass["half"][2] if "half" in glass else glass["radius"])
    air = camera["origin"][2] - light["center"][2] - thickness
    index = glass["material"]["index"]
    orders = forms.slab(index, air, thickness, angle)
    return *orders, forms.slab_unpolarized(index, angle)


def slab(scene: dict, bins: dict) -> np.ndarray:
    """Return the bins of light behind glass."""
    opl, _, _, light = slab_orders(scene)
    return forms.histogram(bins, opl, light)


def order_bins(scene: dict, bins: dict, count: int = 2) -> np.ndarray:
    """Return the weights of the bins of the first orders."""
    return np.array([forms.histogram(bins, opl, 1.0) for opl in slab_orders(scene)[0][:count]])


def slab_readings(scene: dict, bins: dict) -> np.ndarray:
    """Return the weights of the sum and of two or three orders."""
    weak = slab_orders(scene)[3][2] < 1e-3
    return np.vstack([np.ones(bins["count"]), order_bins(scene, bins, 2 if weak else 3)])


def slab_stokes(scene: dict, bins: dict) -> np.ndarray:
    """Return the Stokes components of light behind glass."""
    opl, light, difference, _ = slab_orders(scene)
    return stokes(bins, opl, light, -difference)


def slab_stokes_readings(scene: dict, bins: dict) -> np.ndarray:
    """Return the weights of orders of S0 and S1, and of the sums of S2 and S3."""
    orders = order_bins(scene, bins)
    parts = [np.kron(np.eye(4)[k], orders) for k in (0, 1)]
    return np.vstack([*parts, components(scene, bins)[2:]])


def phasors(scene: dict, bins: dict) -> np.ndarray:
    """Return the real and imaginary parts of phasors behind glass."""
    opl, _, _, light = slab_orders(scene)
    turns = np.outer(bins["frequencies_hz"], opl) / forms.C
    found = np.exp(2j * np.pi * turns) @ light
    return np.concatenate([found.real, found.imag])


def thin_lens(scene: dict, bins: dict) -> np.ndarray:
    """Return the bins of an emitter in front of a thin lens."""
    light = scene["shapes"]["light"]
    camera = scene["camera"]
    patch = (light["u"][0], light["center"])
    lens = (camera["aperture_radius"], camera["fov"])
    return forms.lens_patch(bins, *patch, *lens, light["radiance"])


# ----- Polarized light


def stokes(bins: dict, opl, *light) -> np.ndarray:
    """Return S0, S1, S2 and S3 in bins. Components that are not passed are 0."""
    parts = [forms.histogram(bins, opl, each) for each in light]
    return np.concatenate([*parts, np.zeros(bins["count"] * (4 - len(parts)))])


def components(scene: dict, bins: dict) -> np.ndarray:
    """Return the weights of the sums of S0, S1, S2 and S3."""
    return np.kron(np.eye(4), np.ones(bins["count"]))


def reflection(scene: dict, bins: dict) -> np.ndarray:
    """Return the Stokes components of a reflection at 45°, with 1 m before and behind it."""
    s, p = forms.fresnel(scene["shapes"]["face0"]["material"]["index"], np.sqrt(0.5))
    return stokes(bins, 2.0, (s + p) / 2, (p - s) / 2)


def two_mirrors(scene: dict, bins: dict) -> np.ndarray:
    """Return the Stokes components of two reflections at Brewster's angle, over 3 m.

    The second mirror is twisted by 30° (cos² = 3/4).
    """
    n2 = scene["shapes"]["face0"]["material"]["index"] ** 2
    light = ((n2 - 1) / (n2 + 1)) ** 4 * 0.75 / 2
    return stokes(bins, 3.0, light, -light)


# ----- Media


def by_readings(weights, values) -> np.ndarray:
    """Return numbers with given readings. Only the readings are compared."""
    return np.linalg.lstsq(weights, np.asarray(values, float))[0]


def fog(scene: dict, bins: dict) -> np.ndarray:
    """Return the bins of single scattering."""
    medium = scene["media"]["fog"]
    lamp = scene["lights"]["lamp"]
    box = scene["shapes"]["fog"]
    phase = forms.rayleigh if medium["phase"] == "rayleigh" else forms.hg(medium.get("g", 0.0))

    # The medium fills a box
    scattering = medium["scattering"]
    ends = box["center"][0] - box["half"][0], box["center"][0] + box["half"][0]
    parts = lamp["intensity"], scattering, scattering + medium["absorption"]
    return forms.single_scattering(bins, lamp["position"], *parts, ends, phase)


def moments(scene: dict, bins: dict) -> np.ndarray:
    """Return the weights of light, and of light times length."""
    return np.array([np.ones(bins["count"]), forms.centers(bins)])


def mean_path(scene: dict, bins: dict) -> np.ndarray:
    """Return bins with the mean path length in a sphere, 4/3 R for any scattering."""
    mean = 4 / 3 * scene["shapes"]["shell"]["radius"]
    return by_readings(moments(scene, bins), [np.pi, np.pi * mean])


def fog_room(scene: dict, bins: dict) -> np.ndarray:
    """Return bins with the radiance of the shell as their sum."""
    return by_readings(only_sum(scene, bins), [scene["shapes"]["shell"]["radiance"]])


RATES = (0.0, 0.25, 1.0, 2.0)
"""Rates of additional absorption [1/m]."""


def damped(scene: dict, bins: dict) -> np.ndarray:
    """Return weights that decay with the path length, as absorption of rates `RATES` does."""
    return np.exp(-np.outer(RATES, forms.centers(bins)))


def half_space(scene: dict, bins: dict) -> np.ndarray:
    """Return bins with the light of a half-space for each additional absorption."""
    fog = scene["media"]["fog"]
    albedos = [fog["scattering"] / (fog["scattering"] + fog["absorption"] + x) for x in RATES]
    return by_readings(damped(scene, bins), [forms.half_space(a, 1.0) for a in albedos])


# ----- Around the corner


def nodes(plate: dict, turn: int = 1) -> tuple:
    """Return the cells of a plate; `turn` = -1 turns it around."""
    return forms.nodes(plate["center"], turn * np.array(plate["u"]), plate["v"], 1000)


def hidden(scene: dict, bins: dict) -> np.ndarray:
    """Return the bins of a capture of a hidden plate."""
    wall = scene["wall"]
    plate = scene["shapes"]["plate"]

    # The visible side of a two-sided plate is its back
    turn = -1 if plate["material"].get("two_sided") else 1
    lit = (0, 0, 0) if wall["capture"] == "confocal" else wall["lit"]
    scale = wall["power"] * wall["albedo"] ** 2 / np.pi**2
    albedo = plate["material"]["albedo"]
    paths = forms.around_corner(lit, (0, 0, 0), nodes(plate, turn), albedo, scale)
    return forms.histogram(bins, *paths)


def occluder(scene: dict, bins: dict) -> np.ndarray:
    """Return the bins of light from a lamp by a plate and the floor."""
    camera = scene["camera"]
    lamp = scene["lights"]["lamp"]
    plate = scene["shapes"]["plate"]
    scale = lamp["intensity"] * scene["shapes"]["floor"]["material"]["albedo"] / np.pi
    ends = lamp["position"], camera["target"]
    albedo = plate["material"]["albedo"]
    opl, light = forms.around_corner(*ends, nodes(plate), albedo, scale, wall_cosine=False)
    return forms.histogram(bins, opl + forms.distance(camera["origin"], camera["target"]), light)


def locate(scene: dict, bins: dict) -> np.ndarray:
    """Return the position of a hidden point."""
    return np.array(scene["hidden"])


def made(name: str, described: dict) -> Case:
    """Make a case of cases.json. `exact` and `readings` are names of functions in this module."""
    data = dict(described)
    scene = {"shapes": {}, "lights": {}, "media": {}} | data.pop("scene")
    bins = data["bins"]
    needs = tuple(data.pop("needs", ()))
    weights = globals()[data.pop("readings")](scene, bins) if "readings" in data else None
    value = partial(globals()[data.pop("exact")], scene, bins)
    return Case(name, scene=scene, exact=value, needs=needs, readings=weights, **data)


CASES = [made(name, described) for name, described in DATA.items()]
