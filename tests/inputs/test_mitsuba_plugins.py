"""All plugins of Mitsuba: each renders in time, or is refused by one line."""

import struct
import zlib
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from helpers.support import agree, over_seeds

import tofrender

T = mi.ScalarTransform4f
SAMPLER = {"type": "independent", "sample_count": 16}
BOX = {"type": "box"}
FILM = {"type": "hdrfilm", "width": 5, "height": 3, "rfilter": BOX}
ONE_PIXEL = FILM | {"width": 1, "height": 1}


def rgb(*values: float) -> dict:
    return {"type": "rgb", "value": list(values)}


DIFFUSE = {"type": "diffuse", "reflectance": rgb(0.6, 0.4, 0.2)}


def view() -> Any:
    return T().look_at([0.3, 0.5, 4], [0, 0, 0], [0, 1, 0])


def from_above() -> Any:
    return T().look_at([0.2, 3, 1], [0, 0, 0], [1, 0, 0])


def bitmap(channels: int = 3) -> dict:
    pixels = np.random.default_rng(3).random((4, 8, channels)).astype(np.float32)
    return {"type": "bitmap", "raw": True, "bitmap": mi.Bitmap(pixels)}


def grid(values: np.ndarray) -> dict:
    place = T().translate([-1, -1, -1]).scale(2)
    return {
        "type": "gridvolume",
        "grid": mi.VolumeGrid(values.astype(np.float32)),
        "to_world": place,
    }


def scene(**changes: Any) -> dict:
    """A ball on a floor, under a lamp."""
    sensor = {"type": "perspective", "fov": 35, "film": FILM, "sampler": SAMPLER}
    above = T().translate([0.5, 3, 1]).rotate([1, 0, 0], 90)
    below = T().translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(4)
    lit = {"type": "area", "radiance": rgb(6, 5, 4)}
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 4},
        "sensor": sensor | {"to_world": view()},
        "floor": {"type": "rectangle", "to_world": below, "bsdf": DIFFUSE},
        "lamp": {"type": "rectangle", "to_world": above, "emitter": lit},
        "object": {"type": "sphere", "radius": 0.7, "bsdf": DIFFUSE},
    } | changes


def material(**bsdf: Any) -> dict:
    return scene(object={"type": "sphere", "radius": 0.7, "bsdf": bsdf})


def reflectance(**texture: Any) -> dict:
    return material(type="diffuse", reflectance=texture)


def shape(**described: Any) -> dict:
    return scene(object={"bsdf": DIFFUSE} | described)


def light(**emitter: Any) -> dict:
    described = scene(light=emitter)
    del described["lamp"]
    return described


def point(intensity: dict) -> dict:
    return light(type="point", position=[0, 3, 1], intensity=intensity)


def sensor(film: dict = FILM, **described: Any) -> dict:
    return scene(sensor=described | {"film": film, "sampler": SAMPLER})


def film(**changes: Any) -> dict:
    described = scene()
    return described | {"sensor": described["sensor"] | {"film": FILM | changes}}


def sampler(kind: str) -> dict:
    described = scene()
    own = {"type": kind, "sample_count": 16}
    return described | {"sensor": described["sensor"] | {"sampler": own}}


def medium(**described: Any) -> dict:
    fog = {"type": "homogeneous", "sigma_t": 1.0, "albedo": 0.7} | described
    return shape(type="sphere", radius=0.7, bsdf={"type": "null"}, interior=fog)


def integrator(**described: Any) -> dict:
    return scene(integrator=described)


def curve(kind: str, folder: Path, bsdf: dict = DIFFUSE) -> dict:
    points = "-0.8 -0.5 0 0.2\n-0.3 0.2 0.1 0.25\n0.3 0 0 0.2\n0.8 0.5 0.1 0.15\n"
    (folder / "curve.txt").write_text(points)
    return shape(type=kind, filename=str(folder / "curve.txt"), bsdf=bsdf)


def ellipsoids(kind: str) -> dict:
    values = {"centers": [[0, 0, 0]], "scales": [[0.5, 0.4, 0.3]], "quaternions": [[0, 0, 0, 1]]}
    arrays = {name: mi.TensorXf(np.array(value, np.float32)) for name, value in values.items()}
    return shape(type=kind, **arrays)


def ball_of_distances() -> dict:
    x = np.stack(np.meshgrid(*[np.linspace(-1, 1, 16)] * 3, indexing="ij"), axis=-1)
    distances = mi.TensorXf((np.linalg.norm(x, axis=-1) - 0.7).astype(np.float32)[..., None])
    place = T().translate([-1, -1, -1]).scale(2)
    return shape(type="sdfgrid", grid=distances, to_world=place)


POINTS = np.array([[-0.7, -0.5, 0], [0.7, -0.5, 0.1], [0, 0.7, 0]], np.float32)


def triangle(kind: str, folder: Path) -> dict:
    """A triangle in a file of Wavefront, Stanford or Mitsuba 0.6."""
    path = folder / f"triangle.{kind}"
    if kind == "obj":
        vertices = "".join(f"v {x} {y} {z}\n" for x, y, z in POINTS)
        path.write_text(f"{vertices}f 1 2 3\n")
    elif kind == "ply":
        names = ["x", "y", "z", "r", "g", "b"]
        header = "".join(f"property float {name}\n" for name in names)
        start = "ply\nformat ascii 1.0\nelement vertex 3\n"
        face = "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
        rows = "".join(f"{x} {y} {z} 0.6 0.4 0.2\n" for x, y, z in POINTS)
        path.write_text(f"{start}{header}{face}{rows}3 0 1 2\n")
    else:
        name = b"triangle\0"
        mesh = struct.pack("<I", 0x1000) + name + struct.pack("<QQ", 3, 1)
        mesh += POINTS.tobytes() + np.array([0, 1, 2], np.uint32).tobytes()
        data = struct.pack("<HH", 0x041C, 4) + zlib.compress(mesh)
        path.write_bytes(data + struct.pack("<QI", 0, 1))
    return shape(type=kind, filename=str(path))


def instance() -> dict:
    cube = {"type": "cube", "to_world": T().scale(0.4), "bsdf": DIFFUSE}
    group = {"type": "shapegroup", "cube": cube}
    placed = {"type": "instance", "to_world": T().rotate([0, 1, 0], 30)}
    return scene(group=group, object=placed | {"of": {"type": "ref", "id": "group"}})


def beam_from_above(**integrator: Any) -> dict:
    above = T().translate([0, 3, 0]).rotate([1, 0, 0], 90)
    beam = {"type": "directionalarea", "radiance": rgb(3, 2, 1)}
    described = light(type="rectangle", to_world=above, emitter=beam)
    return described | ({"integrator": integrator} if integrator else {})


def two_cameras() -> dict:
    camera = {"type": "perspective", "to_world": view()}
    return sensor(FILM | {"width": 6}, type="batch", first=camera, second=camera)


def light_meter() -> dict:
    described = scene()
    del described["sensor"]
    meter = {"type": "irradiancemeter", "film": ONE_PIXEL, "sampler": SAMPLER}
    described["floor"] = described["floor"] | {"meter": meter}
    return described


FLAKES = np.tile([0.3, 0.5, 0.9, 0.05, 0.1, 0.02], (2, 2, 2, 1))
CLOUD = np.random.default_rng(0).random((4, 4, 4, 1))
BY_WAVELENGTH = {"wavelength_min": 400.0, "wavelength_max": 700.0, "values": "0.1, 0.5, 0.3"}
PATH = {"type": "path", "max_depth": 4}

# Scenes by the plugin that they show, or functions of a folder for files
RENDERED: dict[str, Any] = {
    # BSDFs
    "blendbsdf": material(type="blendbsdf", weight=0.3, a=DIFFUSE, b={"type": "conductor"}),
    "bumpmap": material(type="bumpmap", texture=bitmap(1), bsdf=DIFFUSE),
    "circular": material(type="circular"),
    "conductor": material(type="conductor"),
    "dielectric": material(type="dielectric"),
    "diffuse": material(**DIFFUSE),
    "hair": lambda folder: curve("bsplinecurve", folder, {"type": "hair"}),
    "mask": material(type="mask", opacity=0.4, bsdf=DIFFUSE),
    "normalmap": material(type="normalmap", normalmap=bitmap(), bsdf=DIFFUSE),
    "null": material(type="null"),
    "plastic": material(type="plastic"),
    "polarizer": material(type="polarizer"),
    "pplastic": material(type="pplastic"),
    "principled": material(type="principled", spec_trans=0.3, metallic=0.2, roughness=0.4),
    "principledthin": material(type="principledthin", spec_trans=0.4, diff_trans=0.5),
    "retarder": material(type="retarder"),
    "roughconductor": material(type="roughconductor"),
    "roughdielectric": material(type="roughdielectric"),
    "roughplastic": material(type="roughplastic"),
    "thindielectric": material(type="thindielectric"),
    "twosided": material(type="twosided", bsdf=DIFFUSE),
    # Emitters
    "area": scene(),
    "constant": light(type="constant"),
    "directional": light(type="directional", direction=[0.1, -1, -0.3]),
    "directionalarea": beam_from_above(type="transient_light_tracer", max_depth=4),
    "envmap": light(type="envmap", bitmap=bitmap()["bitmap"]),
    "point": point(rgb(3, 2, 1)),
    "projector": light(type="projector", irradiance=rgb(9, 8, 7), to_world=from_above()),
    "spot": light(type="spot", to_world=from_above()),
    "sunsky": light(type="sunsky", sun_direction=[0.1, 0.3, 1]),
    # Shapes
    "bsplinecurve": lambda folder: curve("bsplinecurve", folder),
    "cube": shape(type="cube", to_world=T().scale(0.5)),
    "cylinder": shape(type="cylinder", to_world=T().scale(0.5)),
    "disk": shape(type="disk"),
    "ellipsoids": lambda _: ellipsoids("ellipsoids"),
    "ellipsoidsmesh": lambda _: ellipsoids("ellipsoidsmesh"),
    "instance": instance(),
    "linearcurve": lambda folder: curve("linearcurve", folder),
    "merge": shape(type="merge", cube={"type": "cube", "to_world": T().scale(0.4)}),
    "obj": lambda folder: triangle("obj", folder),
    "ply": lambda folder: triangle("ply", folder),
    "rectangle": shape(type="rectangle"),
    "sdfgrid": lambda _: ball_of_distances(),
    "serialized": lambda folder: triangle("serialized", folder),
    "shapegroup": instance(),
    "sphere": scene(),
    # Sensors
    "distant": sensor(ONE_PIXEL, type="distant", direction=[1, -0.5, -1], target=[0, 0, 0]),
    "irradiancemeter": light_meter(),
    "orthographic": sensor(type="orthographic", to_world=view()),
    "perspective": scene(),
    "radiancemeter": sensor(
        ONE_PIXEL, type="radiancemeter", origin=[0, 0, 4], direction=[0, -0.1, -1]
    ),
    "thinlens": sensor(type="thinlens", aperture_radius=0.1, focus_distance=4.0, to_world=view()),
    # Films, samplers and reconstruction filters
    "hdrfilm": scene(),
    "independent": scene(),
    "ldsampler": sampler("ldsampler"),
    "multijitter": sampler("multijitter"),
    "orthogonal": sampler("orthogonal"),
    "stratified": sampler("stratified"),
    "box": scene(),
    "gaussian": film(rfilter={"type": "gaussian"}),
    "tent": film(rfilter={"type": "tent"}),
    # Textures and spectra
    "bitmap": reflectance(**bitmap()),
    "checkerboard": reflectance(type="checkerboard"),
    "d65": point({"type": "d65"}),
    "mesh_attribute": lambda folder: (
        triangle("ply", folder)
        | {
            "object": triangle("ply", folder)["object"]
            | {"bsdf": {"type": "diffuse", "reflectance": COLOR}}
        }
    ),
    "rawconstant": reflectance(type="rawconstant", value=0.4),
    "srgb": reflectance(type="srgb", color=[0.2, 0.3, 0.4]),
    "uniform": reflectance(type="uniform", value=0.4),
    "volume": reflectance(type="volume", volume={"type": "constvolume", "value": rgb(0.2, 0.3, 0)}),
    # Media, volumes and phase functions
    "blendphase": medium(
        phase={"type": "blendphase", "weight": 0.3, "a": {"type": "hg"}, "b": {"type": "isotropic"}}
    ),
    "constvolume": medium(type="heterogeneous", sigma_t={"type": "constvolume", "value": 1.0}),
    "gridvolume": lambda _: medium(type="heterogeneous", sigma_t=grid(CLOUD)),
    "heterogeneous": lambda _: medium(type="heterogeneous", sigma_t=grid(CLOUD)),
    "hg": medium(phase={"type": "hg", "g": 0.4}),
    "homogeneous": medium(),
    "isotropic": medium(phase={"type": "isotropic"}),
    "rayleigh": medium(phase={"type": "rayleigh"}),
    "sggx": lambda _: medium(phase={"type": "sggx", "S": grid(FLAKES)}),
    "tabphase": medium(phase={"type": "tabphase", "values": "0.5, 1.0, 1.5"}),
    # Integrators that become a path tracer in time
    "aov": integrator(type="aov", aovs="d:depth", inner=PATH),
    "moment": integrator(type="moment", inner=PATH),
    "path": integrator(**PATH),
    "prbvolpath": integrator(type="prbvolpath", max_depth=4),
    "stokes": integrator(type="stokes", inner=PATH),
    "volpath": integrator(type="volpath", max_depth=4),
    "volpathmis": integrator(type="volpathmis", max_depth=4),
}
COLOR = {"type": "mesh_attribute", "name": "vertex_color"}

ANOTHER = "does not support a transient film or a pulse"
REFUSED: dict[str, tuple[dict, str]] = {
    "directionalarea from the camera": (
        beam_from_above(),
        "cannot find the light of a directional",
    ),
    "timed_sunsky": (light(type="timed_sunsky"), "cannot evaluate timed_sunsky .* Use sunsky"),
    "blackbody": (point({"type": "blackbody", "temperature": 4000.0}), "Use llvm_ad_spectral"),
    "regular": (reflectance(type="regular", **BY_WAVELENGTH), "Use llvm_ad_spectral"),
    "irregular": (
        reflectance(type="irregular", wavelengths="400, 500, 700", values="0.1, 0.5, 0.3"),
        "evaluates the plugin irregular in spectral variants only",
    ),
    "measured": (material(type="measured"), 'Property "filename" cannot be found'),
    "measured_polarized": (material(type="measured_polarized"), "In non-spectral modes"),
    "blender": (shape(type="blender"), 'missing property "name"'),
    "batch": (two_cameras(), "batches of sensors are not supported. Use one sensor"),
    "specfilm": (film(type="specfilm"), "only be used in Mitsuba variants that perform a spectral"),
    **{
        kind: (integrator(type=kind), ANOTHER)
        for kind in (
            *("depth", "direct", "ptracer", "prb", "prb_basic", "direct_projective"),
            *("prb_projective", "volprim_rf_basic"),
        )
    },
}

ELSEWHERE = {"catmullrom", "lanczos", "mitchell"}
"""Reconstruction filters with negative lobes, whose tests are those of films."""


def described(name: str, folder: Path) -> dict:
    found = RENDERED[name]
    return found if isinstance(found, dict) else found(folder)


def rendered(parts: dict, spp: int = 32, seed: int = 0) -> Any:
    options = {"bins": 8, "window": (0.0, 32.0), "progress": False}
    return tofrender.render(parts, spp=spp, seed=seed, **options)


@pytest.mark.filterwarnings("ignore:integrator = .* replaced by")
@pytest.mark.parametrize("name", RENDERED)
def test_plugins_that_render(name, tmp_path):
    found = rendered(described(name, tmp_path))
    assert found.attrs["contributions_not_finite"] == 0
    steady = found["steady"].values
    assert np.isfinite(steady).all()
    assert steady.max() > 0
    assert found["transient"].values.sum() == pytest.approx(steady.sum(), rel=0.05)


@pytest.mark.parametrize("name", REFUSED)
def test_plugins_that_are_refused(name):
    parts, message = REFUSED[name]
    with pytest.raises((ValueError, TypeError), match=message) as error:
        rendered(parts)
    assert "\n" not in str(error.value)


def test_every_plugin_of_mitsuba_is_listed():
    package = Path(mi.__file__).parent
    native = {each.stem for each in (package / "plugins").iterdir()}
    ours = {"__init__", "common"}
    python = {each.stem for each in (package / "python/ad/integrators").glob("*.py")} - ours
    known = set(RENDERED) | ELSEWHERE | {name.split()[0] for name in REFUSED}
    assert native | python == known


HAIRS: dict[str, dict] = {
    "pigments": {"type": "hair", "eumelanin": 0.2, "pheomelanin": 0.4},
    "absorption": {"type": "hair", "sigma_a": rgb(0.2, 0.4, 0.8)},
    "blend": {
        "type": "blendbsdf",
        "weight": 0.4,
        "hair": {"type": "hair", "eumelanin": 0.1},
        "glass": {"type": "roughdielectric", "alpha": 0.3},
    },
}


@pytest.mark.statistical
@pytest.mark.parametrize("name", HAIRS)
def test_light_of_hair_is_that_of_path(name, tmp_path):
    parts = curve("bsplinecurve", tmp_path, HAIRS[name])
    loaded = mi.load_dict(parts, optimize=False)
    path = mi.load_dict(PATH | {"rr_depth": 20})
    own = parts | {"integrator": {"type": "transient_path", "max_depth": 4, "rr_depth": 20}}

    def by_mitsuba(seed: int) -> np.ndarray:
        picture = np.array(mi.render(loaded, integrator=path, spp=1024, seed=seed), float)
        return picture[..., :3].mean((0, 1))

    def by_us(seed: int) -> np.ndarray:
        return rendered(own, 1024, seed)["steady"].values.astype(float).mean((0, 1))

    found = over_seeds(by_us, range(8))
    expected = over_seeds(by_mitsuba, range(100, 108))
    assert agree(found, expected, rounding=1e-3)


def test_light_that_passes_hair_is_in_air_again(tmp_path):
    """The index of hair changes directions only, not the length of light behind it."""
    from tofrender.paths.refraction import Glass

    hair = curve("bsplinecurve", tmp_path, {"type": "hair"})
    glass = curve("bsplinecurve", tmp_path, {"type": "roughdielectric"})
    assert not Glass(mi.load_dict(hair, optimize=False)).exists
    assert Glass(mi.load_dict(glass, optimize=False)).exists
