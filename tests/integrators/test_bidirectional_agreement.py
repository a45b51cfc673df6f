"""Paths from lights, from the camera, and joined: one picture, in every block and every bin.

`transient_path` is Mitsuba's `path` to float rounding (`test_energy.py`), and independent of the
others. Compared are means of 4 x 4 blocks of the picture, and the film's mean over path length.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import mitsuba as mi
import numpy as np
import pytest
from helpers.gallery import SCENES
from helpers.light_paths import (
    BDPT,
    GLASS,
    LIGHT_TRACER,
    MIRROR,
    OTHER_SEEDS,
    PATH,
    SEEDS,
    TRACERS,
    ball,
    blocks,
    facing_down,
    floor,
    lamp,
    spot,
    summary,
    through,
)
from helpers.parts import area_light, diffuse, gray, plane, rotate, translate
from helpers.support import agree, camera, film, load, rendered, scene, with_film, with_integrator

import tofrender

BINS = 40


class Seen(NamedTuple):
    """Several seeds of a picture: blocks (seeds, ...) and bins of the film's mean (seeds, bins)."""

    blocks: np.ndarray
    bins: np.ndarray


def seen(described: dict, technique: str, spp: int, seeds, n: int = 4, **more: Any) -> Seen:
    loaded = load(through(described, technique, **more))
    size = np.array(loaded.sensors()[0].film().crop_size())
    pictures = [rendered(loaded, spp, seed) for seed in seeds]
    steady = [each if n == 0 or (size < n).any() else blocks(each, n) for each, _ in pictures]
    return Seen(np.stack(steady), np.stack([cube.mean(axis=(0, 1, 3)) for _, cube in pictures]))


def same(found: Seen, reference: Seen) -> bool:
    """Whether the pictures agree, block by block, and in time."""
    mean = reference.bins.mean(axis=0)
    shown = summary(mean, np.arange(mean.size + 1.0), parts=6)
    in_time = agree(found.bins @ shown, reference.bins @ shown, rounding=1e-3)
    return in_time and agree(found.blocks, reference.blocks, rounding=1e-3)


def finds_mistakes(found: Seen, reference: Seen, factor: float = 1.05) -> bool:
    """Whether wrong light is found, light that is late, and light in the wrong place."""
    wrong = Seen(factor * found.blocks, factor * found.bins)
    late = Seen(found.blocks, np.roll(found.bins, 1, axis=1))
    mirrored = Seen(found.blocks[:, :, ::-1], found.bins)
    return not any(same(each, reference) for each in (wrong, late, mirrored))


def window(start: float, stop: float, size: int = 8, **more: Any) -> dict:
    return film(size, size, BINS, start, (stop - start) / BINS, **more)


def box(name: str = "cornell", max_depth: int = 4, start: float = 3.6) -> dict:
    """The Cornell box, or a scene of the gallery like it."""
    time = {"temporal_bins": BINS, "start_opl": start, "bin_width_opl": 0.22}
    return with_film(with_integrator(SCENES[name](), max_depth=max_depth), **time)


def dim(name: str = "cornell") -> dict:
    """Without the lamp itself, whose noise would hide that of all it lights."""
    return with_integrator(box(name), discard_direct_light=True)


def hidden_sky(name: str) -> dict:
    """What is lit by a sky that the camera does not see."""
    return with_integrator(box(name, 3, 4.0), hide_emitters=True)


def desk(parts: dict, start: float = 2.5, stop: float = 8.5, max_depth: int = 3, **more: Any):
    """A floor seen from aside."""
    eye = camera((0.5, -2.2, 1.6), (0, 0, 0.2), window(start, stop), up=(0, 0, 1), fov=45, **more)
    return scene(floor(3.0) | parts, eye, max_depth=max_depth)


def pixels(values: np.ndarray) -> dict:
    return {
        "type": "bitmap",
        "raw": True,
        "filter_type": "nearest",
        "data": mi.TensorXf(np.ascontiguousarray(values, np.float32)),
    }


def slide() -> dict:
    """A lamp that is brighter in some of its squares than in others."""
    values = np.random.default_rng(1).uniform(0, 1, (4, 4, 3)) ** 3
    emitter = {"type": "area", "radiance": pixels(40 * values)}
    lit = facing_down("rectangle", 1.5, 0.4, 1.0)["lamp"] | {"emitter": emitter}
    return desk({"lamp": lit, "ball": ball((-0.3, 0.2, 0.3), 0.3, bsdf=diffuse(0.6))})


def rough(alpha: float) -> dict:
    return {**GLASS, "type": "roughdielectric", "distribution": "ggx", "alpha": alpha}


def rough_ball() -> dict:
    lit = facing_down("rectangle", 1.8, 0.5, 5.0)
    return desk(lit | {"ball": ball((0, 0, 0.45), 0.4, bsdf=rough(0.4))}, max_depth=4)


def rough_face(side: int) -> dict:
    """A lamp on the other side of a rough face, with the camera in air (1) or in the glass (-1)."""
    turned = rotate((0, 1, 0), 0 if side > 0 else 180)
    lit = plane(turned @ translate(0.2, 0.1, -1), size=0.8, emitter=area_light(1.0))
    eye = camera((0.5 * side, 0, 1.5 * side), (0, 0, 0), window(2.0, 4.4), fov=50)
    return scene({"face": plane(bsdf=rough(0.4)), "lamp": lit}, eye, max_depth=2)


def below_glass(parts: dict, height: float, fov: float, stop: float, max_depth: int) -> dict:
    """Looking down from under some glass."""
    eye = camera((0, 0, height), (0.05, 0, 0), window(height + 0.3, stop), fov=fov)
    return scene(floor() | parts, eye, max_depth=max_depth)


def lens_of_a_lamp() -> dict:
    glass = ball((0.1, 0, 1.5), 0.5, bsdf=GLASS)
    lit = ball((0, 0.2, 4.0), 0.6, emitter=area_light(3.0))
    return below_glass({"glass": glass, "lamp": lit}, 0.9, 80, 8.0, 4)


def lamp_in_a_ball() -> dict:
    glass = ball((0, 0, 1.0), 0.6, bsdf=GLASS)
    lit = ball((0.1, 0, 1.0), 0.35, emitter=area_light(2.0))
    return below_glass({"glass": glass, "lamp": lit}, 0.35, 100, 3.5, 3)


def bumps(shadowing: bool) -> dict:
    """A bumpy floor and a wall with other normals than its own."""
    exact = {} if shadowing else {"use_shadowing_function": False, "flip_invalid_normals": False}
    rng = np.random.default_rng(2)
    hills = pixels(rng.uniform(0, 1, (6, 6, 1))) | {"filter_type": "bilinear"}
    tilts = np.concatenate([rng.uniform(0.3, 0.7, (4, 4, 2)), np.ones((4, 4, 1))], axis=2)
    white = diffuse(0.7)
    hilly = {"type": "bumpmap", "scale": 0.1, "texture": hills, "nested": white, **exact}
    tilted = {"type": "normalmap", "normalmap": pixels(tilts), "nested": white, **exact}
    wall = plane(translate(0, 1, 0) @ rotate((1, 0, 0), 90), size=1.5, bsdf=tilted)
    ground = plane(size=1.5, bsdf=hilly)
    return desk(lamp((0.6, -0.4, 1.0), 4.0) | {"floor": ground, "wall": wall})


def mesh_of(corners: list, normals: np.ndarray, faces: list, **parts: Any) -> mi.Mesh:
    props = mi.Properties()
    for name, part in parts.items():
        props[name] = load(part)
    mesh = mi.Mesh("mesh", len(corners), len(faces), has_vertex_normals=True, props=props)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = np.float32(corners).ravel()
    parameters["vertex_normals"] = np.float32(normals).ravel()
    parameters["faces"] = np.uint32(faces).ravel()
    parameters.update()
    return mesh


def rounded() -> dict:
    """A flat mesh whose normals lean outwards at its corners, as a sphere's do."""
    corners = np.array([(-1, -1, 0.3), (1, -1, 0.3), (1, 1, 0.3), (-1, 1, 0.3)])
    mesh = mesh_of(corners, corners * [1, 1, 3], [(0, 1, 2), (0, 2, 3)], bsdf=diffuse(0.8))
    wall = plane(translate(0, 1.2, 0) @ rotate((1, 0, 0), 90), size=1.5, bsdf=diffuse(0.7))
    return desk(lamp((0.9, -0.3, 0.8), 4.0) | {"mesh": mesh, "wall": wall})


def lamp_in_view() -> dict:
    """The camera looks through a hidden lamp at the floor."""
    lit = {"lamp": ball((0.1, 0, 1.2), 0.4, emitter=area_light(3.0))}
    eye = camera((0, 0, 3.0), (0, 0, 0), window(3.5, 8.0), fov=45)
    return scene(floor() | lit, eye, max_depth=3, hide_emitters=True)


def clipped() -> dict:
    """A card nearer than the camera's near plane, and a pit beyond its far plane."""
    card = plane(translate(0.1, 0.1, 1.6), size=0.1, bsdf=diffuse(0.9))
    ground = plane(translate(-1, 0, 0), size=1.0, bsdf=diffuse(0.5))
    pit = plane(translate(1, 0, -1), size=1.0, bsdf=diffuse(0.8))
    eye = camera((0, 0, 2.0), (0, 0, 0), window(3.0, 9.0), fov=45, near_clip=0.7, far_clip=2.5)
    parts = {"floor": ground, "pit": pit, "card": card} | lamp((0.1, 0.3, 2.5), 3.0)
    return scene(parts, eye, max_depth=3)


def rounded_lamp() -> dict:
    """A cube with the normals of a ball, which Mitsuba samples with: .6 to 1 times its cosines."""
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [(a, *two) for a, *rest in sides for two in (rest[:2], rest[1:])]
    parts = {"emitter": area_light(5.0), "bsdf": diffuse(0.0)}
    mesh = mesh_of(0.3 * corners + [0, 0, 1.0], corners / np.sqrt(3), faces, **parts)
    ground = {"ball": ball((0.5, -0.3, 0.2), 0.2, bsdf=diffuse(0.6))}
    return with_integrator(desk({"lit": mesh} | ground), discard_direct_light=True)


def never_chosen() -> dict:
    """A lamp in view and a sky that connections never choose, and a point light that they do."""
    lit = facing_down("rectangle", 1.2, 0.6, 4.0)["lamp"]
    lit["emitter"] |= {"sampling_weight": 0.0}
    sky = {"type": "constant", "radiance": gray(0.5), "sampling_weight": 0.0}
    return desk({"lit": lit, "sky": sky} | lamp((0.6, -0.4, 1.0), 2.0))


class World(NamedTuple):
    """A scene; samples per pixel of the path tracer, and of each that is compared with it."""

    describe: Callable[[], dict]
    path: int
    spp: dict[str, int]


def everyone(light_tracer: int = 512, bdpt: int = 64) -> dict[str, int]:
    return {LIGHT_TRACER: light_tracer, BDPT: bdpt}


WORLDS = {
    "cornell": World(dim, 128, everyone()),
    "area, point, spot, ball": World(
        lambda: box("many lights", start=2.8), 256, everyone(1024, 128)
    ),
    "flash": World(lambda: box("flash", start=6.0), 32, everyone()),
    "environment map": World(lambda: hidden_sky("environment map"), 128, everyone()),
    "environment map in view": World(lambda: box("environment map", 3), 64, {BDPT: 64}),
    "directional": World(lambda: hidden_sky("directional"), 64, everyone()),
    "textured lamp": World(slide, 128, everyone()),
    "glass in view": World(lambda: dim("glass"), 256, {BDPT: 128}),
    "mirror in view": World(lambda: dim("mirror"), 256, {BDPT: 128}),
    "rough conductor": World(lambda: dim("rough conductor"), 128, everyone()),
    "rough glass": World(rough_ball, 128, everyone()),
    "rough face from air": World(lambda: rough_face(1), 64, everyone()),
    "rough face from glass": World(lambda: rough_face(-1), 64, everyone()),
    "caustic of a lamp": World(lens_of_a_lamp, 512, everyone(512, 256)),
    "lamp in glass": World(lamp_in_a_ball, 256, everyone(256, 128)),
    "bumps": World(lambda: bumps(True), 64, everyone()),
    "bumps without shadows of their own": World(lambda: bumps(False), 64, everyone()),
    "normals of a mesh": World(rounded, 64, everyone()),
    "hidden lamp in view": World(lamp_in_view, 128, everyone()),
    "clipped": World(clipped, 32, everyone()),
    "lamp with smooth normals": World(rounded_lamp, 256, everyone()),
    "lamps of no sampling weight": World(never_chosen, 1024, everyone(512, 256)),
}
EACH = [(name, technique) for name in WORLDS for technique in WORLDS[name].spp]


@functools.cache
def of_path(name: str) -> Seen:
    world = WORLDS[name]
    return seen(world.describe(), PATH, world.path, OTHER_SEEDS)


@functools.cache
def of_tracer(name: str, technique: str) -> Seen:
    world = WORLDS[name]
    return seen(world.describe(), technique, world.spp[technique], SEEDS)


@pytest.mark.statistical
@pytest.mark.parametrize(("name", "technique"), EACH)
def test_all_agree(name, technique):
    assert same(of_tracer(name, technique), of_path(name))


@pytest.mark.statistical
def test_connections_to_a_lamp_with_smooth_normals_find_what_paths_run_into():
    hits = seen(rounded_lamp(), PATH, 2048, OTHER_SEEDS, emitter_sampling=False)
    assert same(seen(rounded_lamp(), PATH, 256, SEEDS), hits)


@pytest.mark.statistical
@pytest.mark.parametrize("name", ["cornell", "textured lamp", "hidden lamp in view"])
def test_mistakes_are_found(name):
    assert finds_mistakes(of_tracer(name, BDPT), of_path(name))


def corner(max_depth: int = 3, the_film: dict | None = None, **more: Any) -> dict:
    """Two colored walls on a floor under a lamp, with nothing alike left and right."""
    red = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.3, 0.2]}}
    yellow = {"type": "area", "radiance": {"type": "rgb", "value": [6.0, 8.0, 4.0]}}
    walls = {
        "left": plane(translate(-1, 0, 1) @ rotate((0, 1, 0), 90), size=1.0, bsdf=red),
        "back": plane(translate(0, 1, 1) @ rotate((1, 0, 0), 90), size=1.0, bsdf=diffuse(0.7)),
        "floor": plane(size=1.0, bsdf=diffuse(0.5)),
        "lamp": plane(translate(-0.2, 0.3, 1.6) @ rotate((1, 0, 0), 180), 0.3, emitter=yellow),
    }
    view = {"kind": "perspective", "up": (0, 0, 1), "fov": 50} | more
    eye = camera((1.1, -1.3, 1.2), (-0.2, 0.2, 0.6), the_film or window(1.5, 7.5), **view)
    return scene(walls, eye, max_depth=max_depth)


CROP = {"crop_width": 5, "crop_height": 4, "crop_offset_x": 3, "crop_offset_y": 1}
OFFSETS = {"principal_point_offset_x": 0.2, "principal_point_offset_y": -0.1}
LENS = {"kind": "thinlens", "aperture_radius": 0.1, "focus_distance": 1.5}


def filtered(kind: str, **more: Any) -> dict:
    return window(1.5, 7.5, **more) | {"rfilter": {"type": kind}}


VIEWS = {
    "plain": corner,
    "crop": lambda: corner(the_film=window(1.5, 7.5, **CROP)),
    "gaussian": lambda: corner(the_film=filtered("gaussian")),
    "tent, crop and border": lambda: with_integrator(
        corner(the_film=filtered("tent", sample_border=True, **CROP)), temporal_filter="box"
    ),
    "offsets": lambda: corner(**OFFSETS),
    "lens and crop": lambda: corner(the_film=window(1.5, 7.5, **CROP), **LENS),
    "unwarped": lambda: with_integrator(corner(), camera_unwarp=True),
    "roulette": lambda: with_integrator(corner(12), rr_depth=1),
}


@functools.cache
def view_of_path(name: str) -> Seen:
    return seen(VIEWS[name](), PATH, 128, OTHER_SEEDS, n=0)


@pytest.mark.statistical
@pytest.mark.parametrize("technique", TRACERS)
@pytest.mark.parametrize("name", VIEWS)
def test_every_pixel_agrees(name, technique):
    spp = 512 if technique == LIGHT_TRACER else 64
    assert same(seen(VIEWS[name](), technique, spp, SEEDS, n=0), view_of_path(name))


@pytest.mark.statistical
def test_other_views_are_told_apart():
    """Each differs from the plain picture by more than its noise."""
    plain = seen(corner(), PATH, 128, SEEDS, n=0)
    for name in ("gaussian", "offsets", "unwarped", "roulette"):
        assert not same(plain, view_of_path(name)), name


@pytest.mark.statistical
def test_unlimited_paths_of_the_light_tracer():
    reference = seen(corner(40), PATH, 64, OTHER_SEEDS, max_depth=-1)
    found = seen(corner(40), LIGHT_TRACER, 256, SEEDS, max_depth=-1)
    assert same(found, reference)
    assert not same(found, seen(corner(3), PATH, 64, OTHER_SEEDS))


@pytest.mark.statistical
@pytest.mark.parametrize("camera_connections", [True, False])
@pytest.mark.parametrize("mis", ["power", "balance"])
def test_weights(mis, camera_connections):
    options = {"mis": mis, "camera_connections": camera_connections}
    found = seen(corner(), BDPT, 64, SEEDS, n=0, **options)
    assert same(found, view_of_path("plain"))


@pytest.mark.statistical
@pytest.mark.parametrize("variant", ["llvm_ad_mono", "llvm_ad_spectral"])
def test_variants(variant):
    mi.set_variant(variant)
    reference = seen(corner(), PATH, 128, OTHER_SEEDS, n=3)
    for technique, spp in ((LIGHT_TRACER, 512), (BDPT, 64)):
        found = seen(corner(), technique, spp, SEEDS, n=3)
        assert found.blocks.shape[-1] == (1 if "mono" in variant else 3)
        assert same(found, reference), technique
        assert not same(Seen(1.1 * found.blocks, found.bins), reference)


@pytest.mark.parametrize("technique", TRACERS)
@pytest.mark.parametrize("kind", ["perspective", "thinlens"])
def test_a_point_light_in_view_is_not_seen(technique, kind):
    """A path tracer never meets it, through a lens neither; and it may be where the camera is."""
    lens = LENS if kind == "thinlens" else {}
    eye = camera((0, 0, 3), (0, 0, 0), window(0, 8, 4), **lens)
    lights = {"ahead": lamp((0.1, 0, 1))["lamp"], "here": lamp((0, 0, 3))["lamp"]}
    steady, transient = rendered(through(scene(lights, eye), technique), spp=64)
    assert steady.max() == transient.max() == 0


@pytest.mark.parametrize("technique", TRACERS)
def test_discarded_direct_light(technique):
    eye = camera((0, 0, 2), (0, 0, 0), window(0, 8, 4))
    glows = {"glows": plane(emitter=area_light(1.0), bsdf=diffuse(0))}
    shown = scene(glows, eye, max_depth=3)
    assert rendered(through(shown, technique), spp=1024)[0].max() > 0.5
    assert rendered(through(shown, technique, discard_direct_light=True), 16)[0].max() == 0
    assert rendered(through(shown, technique, hide_emitters=True), 16)[0].max() == 0


@pytest.mark.parametrize("material", [MIRROR, GLASS])
def test_smooth_materials_take_no_connections(material):
    """Only a path that is scattered by them passes; nothing is joined there."""
    sheet = plane(translate(0, 0, 1), bsdf=material)
    eye = camera((0, 0, 2), (0, 0, 0), window(0, 8, 2))
    lit = {"sheet": sheet, "spot": spot((1, 0, 2), (0, 0, 1), 30, 31)}
    described = through(scene(lit, eye, max_depth=5), BDPT)
    assert rendered(described, spp=64)[0].max() == 0
    assert rendered(through(described, LIGHT_TRACER), spp=64)[0].max() == 0


@pytest.mark.parametrize(("loaded", "depth"), [(False, 6), (True, -1)])
def test_a_pyramid_has_no_light_that_the_scene_hides(loaded, depth):
    """Depth is the pyramid's own; what the scene's integrator hides stays hidden."""
    own = {"type": "transient_path", "hide_emitters": True, "max_depth": depth}
    described = tofrender.cornell_box(width=4, height=4) | {"integrator": own}
    described["flash"] = {"type": "sphere", "center": [0, 0, 0], "radius": 0.3}
    described["flash"]["emitter"] = area_light(5.0)
    source = tofrender.load_scene(described) if loaded else described
    pyramid = tofrender.strategy_pyramid(source, max_depth=2, spp=16, progress=False)
    steady = pyramid["steady"].sel(weighting="none").sum(["y", "x", "channel"])
    assert steady.sel(strategy=["0,2", "1,1"]).values.tolist() == [0, 0]
    assert steady.sel(strategy="0,3") > 0
