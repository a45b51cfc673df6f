"""Techniques for caustics: each kind of paths once, the same light by two techniques."""

from collections.abc import Callable

import mitsuba as mi
import numpy as np
import pytest
from helpers.gallery import SCENES as GALLERY
from helpers.limits import lower
from helpers.parts import area_light, diffuse, plane, rotate, translate
from helpers.support import (
    agree,
    camera,
    film,
    load,
    over_seeds,
    rendered,
    scene,
    with_film,
    with_integrator,
)

import tofrender
from tofrender.bidirectional.caustic_photons import CausticPhotons, EmissionTable
from tofrender.bidirectional.photons import trace_photons
from tofrender.films.recording import recording
from tofrender.integrators import passes, pilots
from tofrender.integrators.caustic_techniques import Caustics
from tofrender.integrators.extra_rays import DeltaChains
from tofrender.integrators.passes import WHOLE, best_sampler, steps
from tofrender.integrators.plan import Plan, Techniques
from tofrender.paths.camera import Tile
from tofrender.paths.endpoints import EmitterHits
from tofrender.paths.guiding import BINS
from tofrender.paths.path_kinds import Kind
from tofrender.scenes import cornell_box, cornell_box_fog, cornell_box_glass, cornell_box_mirror

pytestmark = pytest.mark.filterwarnings("ignore:.*of the energy arrives outside")
MIRROR = {"type": "conductor", "material": "none"}
CROP = {"crop_width": 4, "crop_height": 3, "crop_offset_x": 1, "crop_offset_y": 2}
SEEDS, OTHER_SEEDS = range(16), range(1000, 1016)
ON = {"caustic_photons": True, "caustic_rays": True, "chain_rays": True}
FOV = 20.0  # of the camera in `by_mirror` [degrees]
OFF = dict.fromkeys(ON, False)
NONE = Techniques(**OFF)
CAUSTICS = Kind.CAUSTIC, Kind.CAUSTIC_IN_MIRROR


def box(build, **parts) -> dict:
    size = {"width": 6, "height": 5, "temporal_bins": 24, "bin_width_opl": 0.25, "max_depth": 5}
    return with_film(build(**size) | parts, **CROP)


def in_few_bins(described: dict) -> dict:
    """Paths without techniques reach short bins so rarely that their variance is not known."""
    bins = {"start_opl": 2.0, "temporal_bins": 6, "bin_width_opl": 3.0}
    return with_integrator(with_film(described, **bins), max_depth=6)


def by_mirror(**integrator) -> dict:
    """A lamp at z = 1 that shines up to a mirror at z = 2, and the floor below, seen from 0.9 m.

    The floor has light of the mirror alone, see `of_mirror`.
    """
    lamp = {"type": "rectangle", "emitter": area_light(5.0)}
    lamp["to_world"] = translate(0, 0, 1) @ mi.ScalarTransform4f().scale(0.5)
    mirror = plane(translate(0, 0, 2) @ rotate((1, 0, 0), 180), bsdf=MIRROR)
    parts = {"mirror": mirror, "floor": plane(bsdf=diffuse(0.5)), "lamp": lamp}
    eye = camera((2, 0, 0.9), (2, 0, 0), film(1, 1, 100, 4.0, 0.01), fov=FOV)
    return scene(parts, eye, max_depth=3, **integrator)


def of_mirror() -> tuple[float, list[float]]:
    """Return the radiance of `by_mirror`, and the first and the last arrival [m], by quadrature.

    The irradiance of a point of the floor is that of the lamp's image at z = 3, the integral of
    L cosθ cosθ' / d² over the image.
    """
    points = (np.arange(40) + 0.5) / 40 - 0.5
    side = 2 * 0.9 * np.tan(np.radians(FOV / 2))
    x, y, u, v = np.meshgrid(2 + side * points, side * points, points, points, indexing="ij")
    square = (x - u) ** 2 + (y - v) ** 2 + 9
    irradiance = 5 * (9 / square**2).mean()
    lengths = np.sqrt((x - 2) ** 2 + y**2 + 0.9**2) + np.sqrt(square)
    return 0.5 / np.pi * irradiance, [lengths.min(), lengths.max()]


def lamp_in_mirror() -> dict:
    """The lamp, partly seen in a small mirror that fills a part of the picture."""
    described = by_mirror()
    described["mirror"] = plane(translate(1, 0, 2) @ rotate((1, 0, 0), 180), size=0.3, bsdf=MIRROR)
    eye = camera((2, 0.1, 0.9), (1, 0, 2), film(6, 5, 24, 2.0, 0.1), fov=50)
    return described | {"sensor": eye}


def plastic() -> dict:
    to_world = translate(0, -1, 0) @ rotate((1, 0, 0), -90)
    return {"type": "rectangle", "to_world": to_world, "bsdf": {"type": "plastic"}}


def ball(bsdf: dict, **more) -> dict:
    return {"type": "sphere", "center": [0.4, 0.3, 0.4], "radius": 0.25, "bsdf": bsdf} | more


def pane(**bsdf) -> dict:
    """A half-transparent pane below the lamp, tilted, through which light goes straight on."""
    to_world = translate(0.1, 0.4, 0.1) @ rotate((1, 0, 0), 80) @ mi.ScalarTransform4f().scale(0.4)
    nested = {"type": "mask", "opacity": 0.5, "bsdf": {"type": "twosided", "a": diffuse(0.4)}}
    return {"type": "rectangle", "to_world": to_world, "bsdf": nested | bsdf}


def lamp() -> dict:
    return {"type": "sphere", "center": [-0.6, -0.6, 0.6], "radius": 0.1, "emitter": area_light(3)}


def sky() -> dict:
    return {"type": "constant", "radiance": {"type": "uniform", "value": 0.2}}


SCENES: dict[str, Callable[[], dict]] = {
    "mirror": lambda: box(cornell_box_mirror),
    "glass": lambda: box(cornell_box_glass),
    "plastic": lambda: box(cornell_box_mirror, floor=plastic()),
    "rough glass": lambda: box(cornell_box_mirror, ball=ball({"type": "roughdielectric"})),
    "two lamps and a sky": lambda: box(cornell_box_mirror, lamp=lamp(), sky=sky()),
    "two lamps": lambda: box(cornell_box_mirror, lamp=lamp()),
    "lamp in a mirror": lambda: lamp_in_mirror(),
    "pane": lambda: box(cornell_box_glass, pane=pane()),
    "nested dielectrics": lambda: in_few_bins(GALLERY["nested dielectrics"]()),
    "lamp that reflects": lambda: box(cornell_box_mirror, lamp=lamp() | {"bsdf": MIRROR}),
}


@pytest.fixture(autouse=True)
def _in_small_films(monkeypatch):
    """Use the techniques in films that are too small for them to pay.

    Results of pilots are forgotten, because some tests plant mistakes in pilots.
    """
    lower(monkeypatch, few_paths=0)
    monkeypatch.setattr(pilots, "_results", {})


class OneKind:
    """The light of one kind of paths in a scene, by different techniques."""

    def __init__(self, described: dict, kind: Kind, spp: int = 64) -> None:
        self.scene = load(with_integrator(described, **ON))
        self.kind, self.spp = kind, spp
        self.sensor = self.scene.sensors()[0]
        self.integrator = self.scene.integrator()
        self.plan = self.integrator.plan(self.scene, self.sensor)

    def bare(self, plan: Plan, *left_out: Kind) -> Plan:
        """Return a plan without connections, techniques, and some kinds of paths."""
        other = plan.with_endpoint(EmitterHits(self.scene, self.sensor)).without(*left_out)
        other.techniques = NONE
        other.limits.min_depth = 2  # No kind is the sky behind the scene
        return other

    def paths(self, seed: int) -> np.ndarray:
        """Paths from the camera that run into emitters."""
        return self._steps(self.bare(self.plan, *(set(Kind) - {self.kind})), seed)

    def rays(self, seed: int) -> np.ndarray:
        """Caustic rays, which the other kind of caustics has none of here."""
        techniques = Techniques(caustic_photons=False, caustic_rays=True, chain_rays=False)
        plan = self.plan.without(*(set(CAUSTICS) - {self.kind}))
        plan.techniques = techniques
        return self._steps(self.bare(Caustics.of(plan, self.sensor).tracer, *Kind), seed)

    def photons(self, seed: int, aimed: bool = True) -> np.ndarray:
        """Photons, aimed or not."""
        photons = CausticPhotons(
            *(self.scene, self.sensor, self.plan.space, self.plan.limits), hide_emitters=False
        )
        assert not aimed or photons.aim(photons.trace_pilot())
        return self._pass(lambda record: passes._PhotonPass(photons, *self._common(record, seed)))

    def chains(self, seed: int) -> np.ndarray:
        """Rays from the camera."""
        rays = DeltaChains.of(self.plan, self.sensor, self.sensor.film())
        assert rays is not None
        assert rays.rate > 1
        return self._pass(
            lambda record: passes._ExtraPixels(
                rays, rays.pixels, *self._common(record, seed), lanes=1
            )
        )

    def _common(self, record, seed: int) -> tuple:
        return record, self.sensor, self.spp, seed, WHOLE

    def _steps(self, plan: Plan, seed: int) -> np.ndarray:
        record = recording(self.sensor.film(), self.integrator.exposure())
        for _ in steps(plan, record, self.sensor, best_sampler(self.spp), seed):
            pass
        return self._developed(record)

    def _pass(self, create) -> np.ndarray:
        """Render without any samples of pixels, which the picture's weights stand for."""
        record = recording(self.sensor.film(), self.integrator.exposure())
        record.prepare(self.spp, True, True)
        create(record).sample(self.spp)
        return self._developed(record)

    def _developed(self, record) -> np.ndarray:
        transient = np.array(record.film.bins.tensor())
        arrivals = transient.sum(axis=(0, 1, 3))
        groups = [part.sum() for part in np.array_split(arrivals, 4)]
        return np.array([arrivals.sum(), *groups])


def seen(described: dict, seeds, spp: int = 128) -> np.ndarray:
    """Energy in a few groups of bins, and in a few rows of pixels, shape (seeds, groups).

    Rare paths are bright without techniques: smaller groups would be far from normal.
    """
    loaded = load(described)

    def estimate(seed: int) -> np.ndarray:
        steady, transient = rendered(loaded, spp, seed)
        arrivals = transient.sum(axis=(0, 1, 3))
        groups = [part.sum() for part in np.array_split(arrivals, 4)]
        return np.array([*groups, *steady.sum(axis=(1, 2))])

    return over_seeds(estimate, seeds)


def without_techniques(described: dict) -> dict:
    return with_integrator(described, **OFF)


@pytest.mark.statistical
@pytest.mark.parametrize("name", ["plastic", "two lamps and a sky", "pane", "lamp that reflects"])
def test_the_same_light(name):
    described = SCENES[name]()
    expected = seen(without_techniques(described), OTHER_SEEDS)
    assert agree(seen(described, SEEDS), expected, rounding=1e-4)


@pytest.mark.statistical
@pytest.mark.parametrize("name", ["plastic", "rough glass"])
def test_the_same_light_by_rays(name):
    """Tiles of a film, on which no photons land, have caustic rays at all vertices."""
    described = SCENES[name]()
    expected = seen(without_techniques(described), OTHER_SEEDS)
    found = seen(with_integrator(described, caustic_photons=False), SEEDS)
    assert agree(found, expected, rounding=1e-4)


SPP = {"photons": 64, "rays": 256, "paths": 4096, "chains": 256}
KINDS = {
    "photons and rays": ("glass", Kind.CAUSTIC, "photons", "rays"),
    "photons and paths": ("mirror", Kind.CAUSTIC, "photons", "paths"),
    "photons and rays, pane": ("pane", Kind.CAUSTIC, "photons", "rays"),
    "photons and rays, two lamps": ("two lamps", Kind.CAUSTIC, "photons", "rays"),
    "photons and rays, nested": ("nested dielectrics", Kind.CAUSTIC, "photons", "rays"),
    "rays and paths": ("mirror", Kind.CAUSTIC_IN_MIRROR, "rays", "paths"),
    "rays and paths, plastic": ("plastic", Kind.CAUSTIC_IN_MIRROR, "rays", "paths"),
    "chains and paths": ("lamp in a mirror", Kind.CHAIN, "chains", "paths"),
}


@pytest.mark.statistical
@pytest.mark.parametrize("name", KINDS)
def test_one_kind_by_two_techniques(name):
    """Techniques that share no code find the same energy and the same arrivals."""
    where, kind, *techniques = KINDS[name]
    described = SCENES[where]()
    a, b = (
        over_seeds(getattr(OneKind(described, kind, SPP[technique]), technique), seeds)
        for technique, seeds in zip(techniques, (SEEDS, OTHER_SEEDS), strict=True)
    )
    assert agree(a, b, rounding=1e-4)
    assert a.sum() > 0
    brighter = 2 if "paths" in techniques else 1.5
    assert not agree(brighter * a, b, rounding=1e-4)


@pytest.mark.statistical
@pytest.mark.parametrize("name", ["mirror", "two lamps"])
def test_photons_aimed_and_not_aimed(name):
    one_kind = OneKind(SCENES[name](), Kind.CAUSTIC)
    aimed = over_seeds(one_kind.photons, SEEDS)
    not_aimed = over_seeds(lambda seed: one_kind.photons(seed, aimed=False), OTHER_SEEDS)
    assert agree(aimed, not_aimed, rounding=1e-4)
    assert aimed.var(axis=0).sum() < not_aimed.var(axis=0).sum() / 2


def floor_by_mirror(technique: str | None, seeds=SEEDS, spp: int = 512) -> np.ndarray:
    """Radiance of the floor of `by_mirror` by one technique, shape (seeds, 1)."""
    used = OFF if technique is None else OFF | {technique: True}
    loaded = load(by_mirror(**used))
    return over_seeds(lambda seed: rendered(loaded, spp, seed)[0][0, 0, :1], seeds)


@pytest.mark.statistical
@pytest.mark.parametrize("technique", ["caustic_photons", "caustic_rays"])
def test_light_by_a_mirror(technique):
    radiance, arrivals = of_mirror()
    found = floor_by_mirror(technique)
    expected = np.full_like(found[:2], radiance)
    assert agree(found, expected, rounding=1e-3)
    assert not agree(1.1 * found, expected, rounding=1e-3)
    _, transient = rendered(by_mirror(**(OFF | {technique: True})), 512)
    bins = np.flatnonzero(transient[0, 0, :, 0])
    assert [4 + 0.01 * bins[0], 4.01 + 0.01 * bins[-1]] == pytest.approx(arrivals, abs=0.03)


@pytest.mark.statistical
def test_there_is_less_noise():
    described = box(cornell_box_mirror)
    noise = [
        over_seeds(lambda seed, d=d: rendered(load(d), 64, seed)[1], range(8)).var(axis=0).mean()
        for d in (described, without_techniques(described))
    ]
    assert noise[1] > 4 * noise[0]


def chosen(described: dict, tile: bool = False) -> Caustics:
    loaded = load(described)
    sensor = loaded.sensors()[0]
    plan = loaded.integrator().plan(loaded, sensor)
    return Caustics.of(plan, sensor, Tile(0, 0, sensor.film()) if tile else None)


def left_out(caustics: Caustics) -> set[Kind]:
    return set(getattr(getattr(caustics.tracer, "limits", None), "left_out", ()))


def test_scenes_with_caustics_have_techniques():
    found = {name: chosen(describe()) for name, describe in GALLERY.items()}
    assert [name for name in found if found[name].photons is not None] == [
        "glass",
        "mirror",
        "nested dielectrics",
    ]


@pytest.mark.parametrize(
    ("describe", "photons", "kinds"),
    [
        (lambda: by_mirror(), True, {*CAUSTICS}),
        (lambda: by_mirror(caustic_rays=False), True, {Kind.CAUSTIC}),
        (lambda: by_mirror(caustic_photons=False), False, {*CAUSTICS}),
        (lambda: by_mirror(caustic_photons=False, caustic_rays=False), False, set()),
        (lambda: by_mirror(emitter_sampling=False), False, set()),
        (lambda: with_integrator(by_mirror(), max_depth=2), False, set()),
        (lambda: with_integrator(by_mirror(), type="transient_light_tracer"), False, set()),
        (lambda: box(cornell_box), False, set()),
        (lambda: cornell_box_fog(width=4, height=4), False, set()),
    ],
    ids=["all", "photons", "rays", "off", "by hits", "short", "from lights", "no lobes", "fog"],
)
def test_which_techniques_are_used(describe, photons, kinds):
    caustics = chosen(describe())
    assert (caustics.photons is not None) == photons
    assert left_out(caustics) == kinds


def test_no_photons_land_on_tiles():
    caustics = chosen(by_mirror(), tile=True)
    assert caustics.photons is None
    assert left_out(caustics) == {*CAUSTICS}


def test_an_orthographic_camera_has_rays():
    described = by_mirror()
    described["sensor"] |= {"type": "orthographic"}
    del described["sensor"]["fov"]
    caustics = chosen(described)
    assert caustics.photons is None
    assert left_out(caustics) == {*CAUSTICS}


def test_a_table_is_a_density():
    caustics = chosen(box(cornell_box_mirror))
    guided = caustics.tracer.caustic_rays.guided
    pdfs = np.array(guided.pdfs).reshape(-1, BINS)
    assert (pdfs >= 0).all()
    assert pdfs.mean(axis=1) * 4 * np.pi == pytest.approx(1, abs=1e-5)
    α = np.array(guided.α)
    assert α[0] == 0
    assert (α[1:] > 0.02).all()
    assert α.max() <= 0.85


@pytest.mark.parametrize("emitters", [1, 3, 16, 100])
def test_an_emission_table_is_a_density(emitters):
    """The mean of 1 / density over samples is the volume of the cube."""
    table = EmissionTable(emitters)
    table.aim(np.random.default_rng(0).uniform(size=table.size) ** 8)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, 1 << 16)
    cell, *numbers, density = table.sample(sampler)
    assert np.array(cell).max() < table.size
    inverse = 1 / np.array(density)
    assert inverse.max() <= 10.01
    assert inverse.mean() == pytest.approx(1, abs=6 * float(inverse.std()) / 256)
    for values in numbers:
        weighted = (np.atleast_2d(np.array(values)) * inverse).mean(axis=1)
        assert weighted == pytest.approx(0.5, abs=6 * float(inverse.std()) / 256)


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


def test_small_films_have_no_pilots(monkeypatch):
    lower(monkeypatch, few_paths=6 * 4)
    tried = []
    monkeypatch.setattr(Caustics, "of", classmethod(lambda cls, *_: tried.append(1) or cls(_[0])))
    loaded = load(with_film(by_mirror(), width=3, height=2))
    rendered(loaded, 3)
    assert not tried
    rendered(loaded, 4)
    assert tried


def test_equal_seeds_give_equal_films():
    """Threads add photons in any order, so that sums differ in their last digits."""
    options = {"size": (8, 8), "seed": 3, "progress": False, "bins": 50}
    whole = tofrender.render("cornell_box_mirror", spp=8, **options)
    again = tofrender.render("cornell_box_mirror", spp=8, **options)
    scale = float(whole["transient"].max())
    np.testing.assert_allclose(again["transient"], whole["transient"], rtol=1e-5, atol=1e-6 * scale)
