"""Guiding towards caustics: the same light with less noise, where photons say some is."""

import mitsuba as mi
import numpy as np
import pytest
from helpers.gallery import SCENES as GALLERY
from helpers.parts import area_light, diffuse, plane, rotate, translate
from helpers.support import agree, camera, film, load, over_seeds, rendered, scene, with_integrator

import tofrender
from tofrender.bidirectional.photons import trace_photons
from tofrender.integrators.guiding import guided
from tofrender.paths.guiding import BINS, GuidedMaterials
from tofrender.scenes import cornell_box, cornell_box_fog, cornell_box_glass, cornell_box_mirror

pytestmark = pytest.mark.filterwarnings("ignore:.*of the energy arrives outside")
MIRROR = {"type": "conductor", "material": "none"}
SEEDS, OTHER_SEEDS = range(24), range(1000, 1024)


def box(build, **parts) -> dict:
    size = {"width": 4, "height": 4, "temporal_bins": 24, "bin_width_opl": 0.25, "max_depth": 5}
    return build(**size) | parts


def by_mirror(**integrator) -> dict:
    """A lamp at z = 1 that shines up to a mirror at z = 2, and the floor below, seen from 0.9 m."""
    lamp = {"type": "rectangle", "emitter": area_light(5.0)}
    lamp["to_world"] = translate(0, 0, 1) @ mi.ScalarTransform4f().scale(0.5)
    mirror = plane(translate(0, 0, 2) @ rotate((1, 0, 0), 180), bsdf=MIRROR)
    parts = {"mirror": mirror, "floor": plane(bsdf=diffuse(0.5)), "lamp": lamp}
    eye = camera((2, 0, 0.9), (2, 0, 0), film(1, 1, 100, 4.0, 0.01), fov=0.1)
    return scene(parts, eye, max_depth=3, **integrator)


SCENES = {
    "mirror": lambda: box(cornell_box_mirror),
    "glass": lambda: box(cornell_box_glass),
    "plastic": lambda: box(cornell_box_mirror, floor=plastic()),
    "rough glass": lambda: box(cornell_box_mirror, ball=ball({"type": "roughdielectric"})),
    "two lamps and a sky": lambda: box(cornell_box_mirror, lamp=lamp(), sky=sky()),
    "nested dielectrics": GALLERY["nested dielectrics"],
    "by hits alone": lambda: box(cornell_box_mirror, lamp=lamp() | {"bsdf": MIRROR}),
}


def plastic() -> dict:
    to_world = translate(0, -1, 0) @ rotate((1, 0, 0), -90)
    return {"type": "rectangle", "to_world": to_world, "bsdf": {"type": "plastic"}}


def ball(bsdf: dict) -> dict:
    return {"type": "sphere", "center": [0.4, 0.3, 0.4], "radius": 0.25, "bsdf": bsdf}


def lamp() -> dict:
    return {"type": "sphere", "center": [-0.6, -0.6, 0.6], "radius": 0.1, "emitter": area_light(3)}


def sky() -> dict:
    return {"type": "constant", "radiance": {"type": "uniform", "value": 0.2}}


def prepared(described: dict):
    loaded = load(described)
    sensor = loaded.sensors()[0]
    return guided(loaded.integrator().plan(loaded, sensor), sensor)


def seen(described: dict, seeds, spp: int = 64) -> np.ndarray:
    """(seeds, what is compared): bins of all pixels, and pixels of all bins."""
    loaded = load(described)

    def estimate(seed: int) -> np.ndarray:
        steady, transient = rendered(loaded, spp, seed)
        return np.concatenate([transient.sum(axis=(0, 1, 3)), steady.mean(axis=2).ravel()])

    return over_seeds(estimate, seeds)


def unguided(described: dict) -> dict:
    return with_integrator(described, guiding=False)


@pytest.mark.statistical
@pytest.mark.parametrize("name", SCENES)
def test_the_same_light(name):
    described = SCENES[name]()
    assert type(prepared(described).scattering) is GuidedMaterials
    assert agree(seen(described, SEEDS), seen(unguided(described), OTHER_SEEDS), rounding=1e-4)


def test_scenes_with_caustics_are_guided():
    plans = {name: prepared(describe()) for name, describe in GALLERY.items()}
    found = [name for name, plan in plans.items() if type(plan.scattering) is GuidedMaterials]
    assert found == ["glass", "mirror", "nested dielectrics"]


@pytest.mark.statistical
@pytest.mark.parametrize("mistake", ["density", "direction", "table"])
def test_mistakes_are_found(mistake, monkeypatch):
    """The BSDF's density for the mixture's, directions a bin off, and weights without density."""
    described, right = by_mirror(), GuidedMaterials._direction
    expected = seen(described, OTHER_SEEDS, 1024)[:, -1:]
    if mistake == "density":
        monkeypatch.setattr(GuidedMaterials, "_mixture", lambda self, row, ω, pdf: pdf)
    elif mistake == "direction":
        turned = mi.ScalarTransform4f().rotate([1, 0, 0], 15)
        monkeypatch.setattr(
            GuidedMaterials,
            "_direction",
            lambda *args: mi.Transform4f(turned.matrix) @ right(*args),
        )
    else:
        tables = GuidedMaterials.__init__

        def wrong(self, materials, table):
            tables(self, materials, table)
            self.pdfs = 1.3 * self.pdfs

        monkeypatch.setattr(GuidedMaterials, "__init__", wrong)
    assert not agree(seen(described, SEEDS, 1024)[:, -1:], expected, rounding=1e-4)


@pytest.mark.statistical
def test_light_by_a_mirror():
    """Irradiance of the lamp's image at z = 3, by quadrature: ∫ L cosθ cosθ' / d² dA."""
    x = (np.arange(200) + 0.5) / 200 - 0.5
    square = (2 - x[:, None]) ** 2 + x[None] ** 2 + 9
    irradiance = 5 * (9 / square**2).mean()
    steady = over_seeds(lambda seed: rendered(by_mirror(), 1024, seed)[0][0, 0, :1], SEEDS)
    expected = np.full_like(steady[:2], 0.5 / np.pi * irradiance)
    assert agree(steady, expected, rounding=1e-3)
    assert not agree(1.2 * steady, expected, rounding=1e-3)
    _, transient = rendered(by_mirror(), 1024)
    bins = np.flatnonzero(transient[0, 0, :, 0])
    length = 0.9 + np.sqrt([1.5**2 + 9, 2.5**2 + 0.5**2 + 9])
    assert [4 + 0.01 * bins[0], 4 + 0.01 * bins[-1]] == pytest.approx(length, abs=0.05)


@pytest.mark.statistical
def test_there_is_less_noise():
    described = box(cornell_box_mirror)
    noise = [
        over_seeds(lambda seed, d=d: rendered(load(d), 64, seed)[1], range(8)).var(axis=0).mean()
        for d in (described, unguided(described))
    ]
    assert noise[1] > 2 * noise[0]


def test_a_table_is_a_density():
    plan = prepared(box(cornell_box_mirror))
    pdfs = np.array(plan.scattering.pdfs).reshape(-1, BINS)
    assert (pdfs >= 0).all()
    assert pdfs.mean(axis=1) * 4 * np.pi == pytest.approx(1, abs=1e-5)
    α = np.array(plan.scattering.α)
    assert α[0] == 0
    assert (α[1:] > 0.02).all()
    assert α.max() <= 0.85


def test_photons_of_a_mirror():
    """All of a lamp's power leaves for the mirror, most of which is seen by the floor: 20 m wide.

    Photons come from the image's direction, and their power is π A L.
    """
    loaded = load(by_mirror())
    photons = trace_photons(loaded, loaded.sensors()[0], 1 << 14)
    assert photons.emitted == pytest.approx(np.pi * 5, rel=1e-4)
    assert photons.power.sum() == pytest.approx(photons.emitted, rel=0.15)
    floor = np.abs(photons.p[:, 2]) < 1e-3
    image = photons.p[floor] + photons.d[floor] * (3 / photons.d[floor, 2:])
    assert np.abs(image[:, :2]).max() < 0.501


@pytest.mark.parametrize(
    "described",
    [
        lambda: box(cornell_box),
        lambda: with_integrator(by_mirror(), guiding=False),
        lambda: with_integrator(by_mirror(), emitter_sampling=False),
        lambda: with_integrator(by_mirror(), type="transient_light_tracer"),
        lambda: cornell_box_fog(width=4, height=4),
    ],
    ids=["nothing smooth", "off", "by hits", "from lights", "fog"],
)
def test_nothing_is_guided(described):
    assert type(getattr(prepared(described()), "scattering", None)) is not GuidedMaterials


def test_equal_seeds_give_equal_films():
    options = {"size": (8, 8), "seed": 3, "progress": False, "bins": 50}
    whole = tofrender.render("cornell_box_mirror", spp=8, **options)
    again = tofrender.render("cornell_box_mirror", spp=8, **options)
    assert np.array_equal(whole["transient"], again["transient"])
