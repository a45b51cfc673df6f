"""Light by way of hidden mirrors and glass against closed forms with mirror images."""

import math

import mitsuba as mi
import numpy as np
import pytest
from helpers.parts import diffuse, gray
from helpers.refusals import refused
from helpers.support import agree, film, over_seeds
from oracles import nlos

import tofrender

SEEDS = range(16)
GRID = nlos.Grid(3, 2)
LASER = (-0.8, -0.5, 0.6)
LIT = np.array([-0.3, 0.25, 0.0])
POWER = 1.5
ALBEDO = 0.8
R = 0.7
INDEX = 1.5
F = ((INDEX - 1) / (INDEX + 1)) ** 2

MIRROR = {"type": "conductor", "material": "none", "specular_reflectance": gray(R)}
GLASS = {"type": "dielectric", "int_ior": INDEX, "ext_ior": 1.0}
PANE = {"type": "thindielectric", "int_ior": INDEX, "ext_ior": 1.0}
PLASTIC = {"type": "plastic", "diffuse_reflectance": gray(0.0), "int_ior": INDEX, "ext_ior": 1.0}


def setup_of(mode):
    return nlos.Setup(laser=None if mode == "confocal" else LASER, power=POWER, albedo=ALBEDO)


def described(mode, hidden, bins=1, **options):
    setup = setup_of(mode)
    the_film = film(3, 2, bins=bins, start=0.0, bin_width=20.0 / bins)
    if mode == "confocal":
        return nlos.confocal(setup, hidden, the_film, **options)
    return nlos.single(setup, hidden, LIT, the_film, **options)


def sheet(bsdf, z, size=4.0, tilt=0.0):
    """Return a square that faces the wall, rotated around y by `tilt` degrees."""
    pose = mi.ScalarTransform4f().translate([0, 0, z]).rotate([0, 1, 0], 180 + tilt).scale(size)
    return {"type": "rectangle", "to_world": pose, "bsdf": bsdf}


def normal_of(tilt):
    return np.array([-math.sin(math.radians(tilt)), 0, -math.cos(math.radians(tilt))])


def image(point, at, normal):
    return point - 2 * np.dot(point - at, normal) * normal


def points(mode):
    """Return the observed points, and the laser spot of each point."""
    for seen in GRID.points().reshape(-1, 3):
        yield seen, seen if mode == "confocal" else LIT


def by_mirror(mode, z, tilt):
    """Return L = R Φ ρ² cos cos / (π² r²) by way of a mirror, and the path length."""
    light, length = [], []
    at, normal = np.array([0, 0, z]), normal_of(tilt)
    for seen, lit in points(mode):
        r = np.linalg.norm(image(lit, at, normal) - seen)
        cos_seen = image(lit, at, normal)[2] / r
        cos_lit = image(seen, at, normal)[2] / r
        light.append(R * POWER * ALBEDO**2 * cos_seen * cos_lit / (math.pi * r) ** 2)
        length.append(r + setup_of(mode).length(lit, seen))
    return np.reshape(light, (2, 3)), np.reshape(length, (2, 3))


@pytest.mark.parametrize("tilt", [0.0, 12.0])
@pytest.mark.parametrize("mode", ["confocal", "single"])
def test_a_mirror(mode, tilt):
    """The mirror image of the laser spot lights the wall."""
    light, length = by_mirror(mode, 1.7, tilt)
    scene = described(mode, {"mirror": sheet(MIRROR, 1.7, tilt=tilt)}, bins=400)
    estimates = over_seeds(nlos.estimates(scene, 64, "transient"), SEEDS)
    assert agree(estimates.sum(axis=3), light)
    first = np.argmax(estimates.sum(axis=0), axis=2) * 0.05
    assert np.all((first <= length) & (length < first + 0.05))


def test_closed_forms_of_a_parallel_mirror():
    """Confocal light by a parallel mirror is R Φ ρ² / (4 π² D²)."""
    light, _ = by_mirror("confocal", 1.7, 0.0)
    expected = R * POWER * ALBEDO**2 / (4 * math.pi**2 * 1.7**2)
    assert light == pytest.approx(np.full((2, 3), expected))


def test_a_beam_with_a_width():
    light, _ = by_mirror("confocal", 1.7, 0.0)
    hidden = {"mirror": sheet(MIRROR, 1.7)}
    scene = described("confocal", hidden, spot_sigma=0.01)
    estimates = over_seeds(nlos.estimates(scene, 64), SEEDS)
    assert estimates.mean(axis=0) == pytest.approx(light, rel=3e-3)


@pytest.mark.parametrize(
    ("depth", "count"), [({"max_depth": 2}, 0), ({"max_depth": 3}, 1), ({"filter_bounces": 4}, 0)]
)
def test_depth(depth, count):
    """A path with laser spot, mirror and observed point has three surface points and segments."""
    light, _ = by_mirror("single", 1.7, 0.0)
    options = {"filter_bounces": -1, "use_nlos_only": True} | depth
    scene = described("single", {"mirror": sheet(MIRROR, 1.7)}, **options)
    estimates = over_seeds(nlos.estimates(scene, 16), range(4)).mean(axis=0)
    assert estimates == pytest.approx(count * light, rel=1e-2)


@pytest.mark.parametrize(
    ("bsdf", "reflectance"),
    [
        ({"type": "blendbsdf", "weight": 0.3, "a": diffuse(0.0), "b": MIRROR}, 0.3 * R),
        ({"type": "blendbsdf", "weight": 0.3, "a": GLASS, "b": MIRROR}, 0.7 * F + 0.3 * R),
        (PLASTIC, F),
        (PANE, F + F * (1 - F) ** 2 / (1 - F**2)),
        ({"type": "twosided", "bsdf": MIRROR}, R),
    ],
    ids=["blend", "two_mirrors", "plastic", "pane", "twosided"],
)
def test_lobes(bsdf, reflectance):
    """A parallel mirror of any kind reflects with its reflectance."""
    expected = reflectance * POWER * ALBEDO**2 / (4 * math.pi**2 * 1.7**2)
    scene = described("confocal", {"mirror": sheet(bsdf, 1.7)})
    estimates = over_seeds(nlos.estimates(scene, 256), SEEDS)
    assert agree(estimates, np.full((2, 3), expected))


def test_glass_before_a_mirror():
    """A slab of index n and thickness t, at a, in front of a mirror at D.

    Light passes four interfaces. It spreads as on 2 (D - t + t / n) in air, and its path length is
    2 (D - t + n t). Both sides of the slab also reflect.
    """
    front, thickness, distance = 1.3, 0.2, 2.0
    slab = {"type": "cube", "bsdf": GLASS}
    middle = front + thickness / 2
    slab["to_world"] = mi.ScalarTransform4f().translate([0, 0, middle]).scale([5, 5, thickness / 2])
    hidden = {"slab": slab, "mirror": sheet(MIRROR, distance)}
    scene = described("confocal", hidden, bins=400, filter_bounces=-1, max_depth=7)
    scene["integrator"]["use_nlos_only"] = True
    estimates = over_seeds(nlos.estimates(scene, 1024, "transient"), SEEDS)
    scale = POWER * ALBEDO**2 / (4 * math.pi**2)
    behind = front + thickness / INDEX
    ways = [
        (F, front, front),
        ((1 - F) ** 2 * F, behind, front + INDEX * thickness),
        (
            (1 - F) ** 4 * R,
            distance - thickness + thickness / INDEX,
            distance - thickness + INDEX * thickness,
        ),
    ]
    for number, (seen, _) in enumerate(points("confocal")):
        y, x = divmod(number, 3)
        for transmitted, reduced, optical in ways:
            opl = 2 * optical + setup_of("confocal").length(seen, seen)
            found = estimates[:, y, x, int(opl / 0.05)]
            expected = scale * transmitted / reduced**2
            # Diffuse light of later bounces is in the same bin, below 1 %
            assert agree(found, np.array(expected), rounding=0.01), (transmitted, number)


def test_a_ball():
    """At D in front of a ball of radius R, light spreads as on 2 D (1 + D / R)."""
    center, radius = np.array([0.1, -0.2, 1.9]), 0.6
    ball = {"type": "sphere", "center": center.tolist(), "radius": radius, "bsdf": MIRROR}
    scene = described("confocal", {"ball": ball})
    estimates = over_seeds(nlos.estimates(scene, 256), SEEDS)
    light = []
    for seen, _ in points("confocal"):
        away = np.linalg.norm(center - seen)
        distance = away - radius
        spread = 2 * distance * (1 + distance / radius)
        light.append(R * POWER * (ALBEDO * center[2] / away / math.pi / spread) ** 2)
    assert agree(estimates, np.reshape(light, (2, 3)))


def test_a_patch_before_and_behind_a_mirror():
    """Four bounces: from the spot's image to the patch, and from the patch to the point's image.

    The mirror is perpendicular to the wall, so that the images are in the wall's plane.
    """
    patch = nlos.Rectangle.turned((0.2, -0.1, 0.9), 25, 40, half=(0.2, 0.15), albedo=0.6)
    at, normal = np.array([1.3, 0, 0]), np.array([-1.0, 0, 0])
    pose = mi.ScalarTransform4f().translate(at.tolist()).rotate([0, 1, 0], -90).scale(5)
    upright = {"type": "rectangle", "to_world": pose, "bsdf": MIRROR}
    hidden = {"patch": patch.shape(), "mirror": upright}
    scene = described("single", hidden, filter_bounces=4)
    estimates = over_seeds(nlos.estimates(scene, 1024), SEEDS)
    setup, nodes, light = setup_of("single"), patch.nodes(), []
    for seen, lit in points("single"):
        before = nlos.total(setup, nodes, 0.6, image(lit, at, normal), seen)
        behind = nlos.total(setup, nodes, 0.6, lit, image(seen, at, normal))
        light.append(R * (before + behind))
    assert agree(estimates, np.reshape(light, (2, 3)), rounding=1e-4)


def test_a_wall_of_plastic():
    """The wall's mirror lobe reflects the beam to a hidden wall, and this spot lights the wall."""
    plastic = PLASTIC | {"diffuse_reflectance": gray(0.5)}
    scene = described("single", {"hidden": sheet(diffuse(0.6), 1.2)}, bins=400)
    scene["relay_wall"]["bsdf"] = plastic
    estimates = over_seeds(nlos.estimates(scene, 4096, "transient"), SEEDS)
    bsdf = mi.load_dict(plastic)

    # The mirrored laser is behind the wall
    d = LIT - np.array(LASER) * [1, 1, -1]
    spot = LIT + d * 1.2 / d[2]
    mirrored = np.linalg.norm(d)
    si = interaction_from(d / mirrored * [-1, -1, 1])
    reflectance = bsdf.sample(mirror_context(), si, 0.5, mi.Point2f(0.5))[1].x[0]
    for number, (seen, _) in enumerate(points("single")):
        y, x = divmod(number, 3)
        if (y, x) not in ((0, 0), (1, 2)):  # There, no other light is in the bins
            continue
        r = np.linalg.norm(spot - seen)
        towards = (spot - seen) / r
        si = interaction_from(np.array(setup_of("single").sensor) - seen)
        f = bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(*towards.tolist())).x[0]
        intensity = POWER * reflectance * 0.6 * towards[2] / math.pi
        opl = np.linalg.norm(spot - LIT) + r + setup_of("single").length(LIT, seen)
        found = estimates[:, y, x, int(opl / 0.05)]
        assert agree(found, np.array(intensity * f / r**2), rounding=0.05)


def interaction_from(wi):
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(*(np.asarray(wi) / np.linalg.norm(wi)).tolist())
    si.t = mi.Float(1)
    return si


def mirror_context():
    context = mi.BSDFContext()
    context.component = 0
    return context


def test_an_absorbing_medium_before_a_mirror():
    """Light passes a slab of thickness t on the way out and back: exp(-2 σ t)."""
    medium = {"type": "homogeneous", "albedo": 0.0, "sigma_t": 0.9}
    pose = mi.ScalarTransform4f().translate([0, 0, 1.4]).scale([6, 6, 0.15])
    fog = {"type": "cube", "to_world": pose, "bsdf": {"type": "null"}, "interior": medium}
    scene = described("confocal", {"fog": fog, "mirror": sheet(MIRROR, 1.7)})
    estimates = over_seeds(nlos.estimates(scene, 64), SEEDS)
    light, _ = by_mirror("confocal", 1.7, 0.0)
    assert agree(estimates, light * math.exp(-2 * 0.9 * 0.3))


BUMPY = {"type": "bumpmap", "texture": {"type": "checkerboard"}, "bsdf": MIRROR}


@pytest.mark.parametrize(
    ("bsdf", "reason"),
    [
        (BUMPY, "a bumpmap of a mirror or glass is not supported"),
        ({"type": "mask", "opacity": 0.5, "bsdf": MIRROR}, "a mask over a mirror or glass is not"),
    ],
)
def test_what_is_refused(bsdf, reason):
    scene = nlos.load_nlos(described("confocal", {"mirror": sheet(bsdf, 1.7)}))
    with refused(f"shape 'mirror': {reason}"):
        tofrender.capture(scene, mode="confocal", spp=1, progress=False)


@pytest.mark.parametrize("others", [{}, {"other": sheet(MIRROR, 50.0, size=0.1)}])
@pytest.mark.parametrize("bsdf", [MIRROR, {"type": "twosided", "bsdf": MIRROR}, GLASS])
def test_refused_instances(bsdf, others):
    hidden = {
        "group": {"type": "shapegroup", "sheet": sheet(bsdf, 0.0)},
        "copy": {
            "type": "instance",
            "to_world": mi.ScalarTransform4f().translate([0, 0, 1.7]),
            "shapegroup": {"type": "ref", "id": "group"},
        },
    }
    options = {"nlos_hidden_geometry_sampling": False}
    scene = nlos.load_nlos(described("confocal", hidden | others, **options))
    with refused("shape 'group': an instance of a mirror or glass is not supported. Add the shape"):
        tofrender.capture(scene, mode="confocal", spp=1, progress=False)


def test_instances_of_rough_shapes():
    """Instances of shapes without mirrors are not treated as mirrors."""
    hidden = {
        "group": {"type": "shapegroup", "sheet": sheet(diffuse(0.3), 0.0)},
        "copy": {"type": "instance", "shapegroup": {"type": "ref", "id": "group"}},
    }
    scene = nlos.load_nlos(described("confocal", hidden, nlos_hidden_geometry_sampling=False))
    plan = scene.integrator().plan(scene, scene.sensors()[0])
    assert plan.scan.specular is None


def test_refused_derivatives():
    scene = nlos.load_nlos(described("confocal", {"mirror": sheet(MIRROR, 1.7)}))
    plan = scene.integrator().plan(scene, scene.sensors()[0])
    with refused("by mirrors or glass are not supported; make 'mirror' rough"):
        plan.attached()
