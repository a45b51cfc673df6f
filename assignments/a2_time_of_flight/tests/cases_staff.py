"""Scenes that every path tracer has to get right, drawn anew, with their light and its length."""

from __future__ import annotations

import math

import numpy as np
from scenes_staff import (
    blocked,
    color,
    diffuse,
    fresnel,
    ggx,
    on_panel,
    pane,
    panel,
    placed,
    point,
    sphere,
    square,
    under_coat,
    unit,
)

from tofrender.course.judge import expect


class Case:
    """A scene with rays, and the known light along them.

    Attributes:
        parts, rays: For the probe `along_rays`.
        light: Radiance of each ray, shape (n, 3).
        moment: Radiance times length, summed over paths.
        valid: Whether each ray meets a surface.
    """

    def __init__(self, parts):
        self.parts = parts
        self.light = []
        self.moment = []
        self.valid = []
        self.rays = {"origin": [], "towards": [], "start": [], "active": []}

    def add(self, origin, towards, paths=(), valid=True, active=True, behind=0.0):
        """A ray, and its paths, pairs of (radiance, length from the origin)."""
        origin = np.asarray(origin, float)
        towards = np.asarray(towards, float)
        start = origin - behind * unit(towards - origin)
        for name, value in zip(self.rays, (origin, towards, start, active), strict=True):
            self.rays[name].append(value)
        paths = [(np.broadcast_to(light, 3), opl + behind) for light, opl in paths]
        self.light.append(sum((light for light, _ in paths), np.zeros(3)))
        self.moment.append(sum((light * opl for light, opl in paths), np.zeros(3)))
        self.valid.append(valid and active)

    def ask(self, submission, name, **options):
        rays = {key: np.array(value) for key, value in self.rays.items()}
        return submission.ask(
            "along_rays", name=name, parts=self.parts, rays=rays, seed=submission.seed, **options
        )


def compare(came, case, hint, most, rounding=3e-3):
    """Light, its length, lanes that met a surface; `most` bounds the light's relative noise."""
    light = np.array(case.light)
    moment = np.array(case.moment)
    dark = light.max(axis=1) == 0
    names = {"light": light, "moment": moment} | ({"steady": light} if "steady" in came else {})
    texts = {
        "light": "radiance over all lengths, ray by ray",
        "moment": "sum of radiance x length, ray by ray",
        "steady": "radiance that sample returns, ray by ray",
    }
    for name, wanted in names.items():
        expect.shape(came[name][0], wanted.shape, texts[name])
        expect.finite(came[name], texts[name], hint="lanes that miss everything have no length")
        if dark.any():
            zero = np.zeros((len(came[name]), dark.sum(), 3))
            what = f"{texts[name]}: rays without light (nothing there, black, the back, not active)"
            expect.close(came[name][:, dark], zero, what, atol=1e-6, hint="mask them")
        expect.estimate(
            came[name][:, ~dark], wanted[~dark], texts[name], rounding=rounding, hint=hint
        )
    shares = came["light"][:, ~dark] / light[~dark]
    what = "radiance, over what is right, from few samples"
    expect.noise(shares, most, what, hint="random numbers where the light is; connections")
    wanted = np.array(case.valid, float)
    what = f"lanes that met a surface, ray by ray: expected {wanted}, came {came['valid'][0]}"
    expect.true(np.array_equal(came["valid"], np.tile(wanted, (len(came["valid"]), 1))), what)


# ------------------------------------------------------------------------------------ scenes


def several_lights(random):
    """Two lamps and a spot over a floor, and a black plate in the way of one of them."""
    albedo = random.uniform(0.2, 0.9, 3)
    lamps = [
        random.uniform([-0.6, -0.6, 1.6], [-0.3, 0.6, 2.4]),
        random.uniform([0.3, -0.6, 1.6], [0.6, 0.6, 2.4]),
        random.uniform([-0.4, -0.4, 3.0], [0.4, 0.4, 3.6]),
    ]
    intensities = random.uniform(1.0, 4.0, (3, 3))
    targets = np.array([(*random.uniform(-0.6, 0.6, 2), 0.0) for _ in range(4)])
    height = 1.0
    half = 0.12
    middle = targets[0] + height / lamps[0][2] * (lamps[0] - targets[0])
    plate = (middle, (1, 0, 0), (0, 1, 0), (half, half))
    down = placed(lamps[2], (1, 0, 0), (0, -1, 0), (1, 1))
    case = Case(
        {
            "floor": square((0, 0, 0), 30.0, diffuse(albedo)),
            "plate": square(middle, half, diffuse(0.0)),
            "lamp": point(lamps[0], intensities[0]),
            "other": point(lamps[1], intensities[1]),
            "spot": {
                "type": "spot",
                "to_world": down,
                "intensity": color(intensities[2]),
                "cutoff_angle": 60.0,
                "beam_width": 55.0,
            },
        }
    )
    behind = float(random.uniform(0.2, 1.0))
    for target in targets:
        eye = target + random.uniform([-0.5, -0.5, 0.3], [0.5, 0.5, 0.8])
        paths = []
        for lamp, intensity in zip(lamps, intensities, strict=True):
            d = np.linalg.norm(lamp - target)
            if not blocked(target, lamp, *plate):
                light = albedo / math.pi * intensity * lamp[2] / d**3
                paths.append((light, np.linalg.norm(eye - target) + d))
        case.add(eye, target, paths, behind=behind)
        if len(case.light) == 1:
            case.add(eye, target, active=False)
    above = np.array([0.1, 0.2, 5.0])
    case.add(above, above + random.uniform([-0.5, -0.5, 0.5], [0.5, 0.5, 1.5]), valid=False)
    case.add(middle + np.array([0, 0, 0.3]), middle)
    case.add((0.3, -0.2, -1.0), (0.1, 0.1, 0.0))
    return case


def materials(random):
    """Plates of several materials under a panel, each seen where a mirror would show the panel."""
    height = random.uniform(1.8, 2.4)
    radius = random.uniform(0.7, 1.1)
    radiance = random.uniform(0.5, 3.0, 3)
    tint = random.uniform(0.3, 0.9, 3)
    alpha = random.uniform(0.2, 0.4)
    eta = random.uniform(1.4, 1.7)
    mirror = {"type": "conductor", "material": "none"}
    rough = {"type": "roughconductor", "material": "none", "alpha": alpha, "distribution": "ggx"}
    coat = {"type": "plastic", "int_ior": eta, "ext_ior": 1.0}
    points, area = on_panel(height, radius)

    def by_area(eye, plate, f):
        """Light of the panel's points, and that times its length."""
        away = points - plate
        r = np.linalg.norm(away, axis=1)
        light = f(away / r[:, None]) * height / r / r**2 * area
        length = np.linalg.norm(eye - plate) + r
        return light.sum(), (light * length).sum()

    def lambert(wo):
        return wo[:, 2] / math.pi

    case = Case({"panel": panel(height, radius, radiance)})
    behind = float(random.uniform(0.2, 1.0))
    order = random.permutation(5)
    for x, number in zip(0.75 * (np.arange(5) - 2), order, strict=True):
        plate = np.array([x, 0.0, 0.0])
        turn = random.uniform(0, 2 * math.pi)
        seen = random.uniform(0.1, 0.6) * radius * np.array([math.cos(turn), math.sin(turn), 0])
        to_panel = unit(seen + np.array([0, 0, height]) - plate)
        eye = plate + random.uniform(0.4, 0.9) * to_panel * (-1, -1, 1)
        wi = unit(eye - plate)
        whole = np.linalg.norm(eye - plate) + height / to_panel[2]
        smooth = by_area(eye, plate, lambert)

        def metal(wo, wi=wi):
            return ggx(alpha, wi, wo)

        def base(wo, wi=wi):
            return lambert(wo) * under_coat(wi[2], wo[:, 2], eta)

        bsdf, parts = (
            (
                rough | {"specular_reflectance": color(tint)},
                [(tint, by_area(eye, plate, metal))],
            ),
            (
                coat | {"diffuse_reflectance": color(tint)},
                [(fresnel(wi[2], eta), (1, whole)), (tint, by_area(eye, plate, base))],
            ),
            (mirror, [(1, (1, whole))]),
            (diffuse(tint), [(tint, smooth)]),
            ({"type": "twosided", "bsdf": diffuse(tint)}, [(tint, smooth)]),
        )[number]
        case.parts[f"plate_{number}"] = square(plate, 0.2, bsdf, down=number == 4)
        paths = [(radiance * weight * light, moment / light) for weight, (light, moment) in parts]
        case.add(eye, plate, paths, behind=behind)
    case.parts["back"] = square((0.0, -1.2, 0.0), 0.2, diffuse(0.8), down=True)
    case.add((0.1, -1.3, 0.4), (0.0, -1.2, 0.0))
    glass = np.array([0.0, 2.5, 0.6])
    target = np.array([0.0, random.uniform(-0.4, 0.4), height])
    case.parts["glass"] = square(
        glass, 0.3, {"type": "thindielectric", "int_ior": eta, "ext_ior": 1.0}
    )
    eye = glass - 0.3 * (target - glass)
    through = pane(unit(target - glass)[2], eta)
    length = np.linalg.norm(target - eye)
    case.add(eye, target, [(radiance * through, length)], behind=behind)
    case.add((0.1, 0.2, height + 1), (0.1, 0.2, height))
    return case


def long_paths(random, max_depth):
    """A lamp in the middle of a colored sphere, which every vertex sees unhindered."""
    radius = random.uniform(0.6, 1.6)
    albedo = random.permutation([0.9, 0.75, 0.5])
    intensity = random.uniform(1.0, 4.0, 3)
    case = Case({"relay_wall": sphere(radius, albedo), "lamp": point((0, 0, 0), intensity)})
    paths = [
        (albedo**n * intensity / (math.pi * radius**2), 2 * radius + (n - 1) * 4 / 3 * radius)
        for n in range(1, max_depth)
    ]
    for towards in random.normal(size=(2, 3)):
        case.add((0, 0, 0), towards, paths)
    case.radius = radius
    return case
