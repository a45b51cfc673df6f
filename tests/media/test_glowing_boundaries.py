"""Emitters on index-matched boundaries: rays pass them, and their light counts.

Closed forms where all light is seen along straight rays. Otherwise the reference is Mitsuba's
`volpath`. All boundaries are far from other surfaces.
"""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.fogs import FLOOR, LIT, THIN, cloud, cube, filled, fog, looked_at, red, sphere
from helpers.light_paths import BDPT, LIGHT_TRACER
from helpers.parts import area_light, diffuse, plane, point_light, rotate, translate
from helpers.support import agree, camera, film, load, over_seeds, rendered, scene, steady_twin

import tofrender
from tofrender.scanning import lidar, scan_pattern

SEEDS = range(8)
OTHER_SEEDS = range(1000, 1008)
SPP = 512
DEPTH = 5
NULL = {"type": "null"}

RADIANCE = {"type": "area", "radiance": red(3.0, 1.5, 1.0)}
BALL = {"ball": filled(sphere(0.6, (0.2, 0.1, 0.1)), fog(0.8, red(0.9, 0.7, 0.5)), glow=RADIANCE)}
BOX = {
    "box": filled(cube((0.5, 0.4, 0.3), (0.2, -0.1, 0.2)), cloud(0.5), glow=RADIANCE),
}
MIST = fog(0.2, 0.9)
NESTED = {
    "outer": filled(sphere(0.9, (0.2, 0.1, 0.1)), MIST, glow=area_light(0.7)),
    "ball": BALL["ball"] | {"exterior": MIST},
}
MIRROR = {
    "mirror": plane(translate(0, 2.5, 0) @ rotate((1, 0, 0), 80), 2.0, bsdf={"type": "conductor"})
}
SCENES: dict[str, dict[str, Any]] = {
    "ball": {"floor": FLOOR} | BALL,
    "box of cloud": {"floor": FLOOR} | BOX,
    "in fog": {"floor": FLOOR, "around": THIN} | {"ball": BALL["ball"] | {"exterior": THIN}},
    "lamp behind": LIT | BALL,
    "point behind": {"floor": FLOOR, "point": point_light((0.6, 0.3, 2.0), 20.0)} | BALL,
    "one in another": {"floor": FLOOR} | NESTED,
    "beside fog": {
        "floor": FLOOR,
        "fog": filled(sphere(0.4, (-1.2, 0, 0)), fog(1.0, 0.9)),
        "empty": sphere(0.5, (0.4, 0, 0.1), bsdf=NULL, glow=RADIANCE),
    },
    "in a mirror": {"floor": FLOOR} | MIRROR | BALL,
    # The rays pass the sheet long before they reach the fog, where other light is
    "sheet before fog": LIT
    | {
        "sheet": plane(
            translate(0.3, -2.9, 1.3) @ rotate((1, 0, 0), 70), 0.5, bsdf=NULL, light=area_light(0.2)
        ),
        "fog": filled(sphere(0.9), fog(1.5, 0.9)),
    },
}


def means(description: dict, seeds, spp: int, by: Any = None) -> np.ndarray:
    """Means of the picture's channels for each seed."""
    loaded = load(description)

    def one(seed: int) -> np.ndarray:
        if by is None:
            picture = rendered(loaded, spp, seed)[0]
        else:
            picture = np.array(mi.render(loaded, integrator=by, spp=spp, seed=seed), float)
        return picture.mean((0, 1))

    return over_seeds(one, seeds)


def seen(name: str, **integrator: Any) -> dict:
    """A scene of this file with an integrator."""
    options = {"max_depth": DEPTH} | integrator
    return looked_at(SCENES[name], **options)


def volpath(name: str, spp: int = 2 * SPP, **options: Any) -> np.ndarray:
    """Pictures by Mitsuba's `volpath`."""
    integrator = mi.load_dict({"type": "volpath", "max_depth": DEPTH, "rr_depth": 20} | options)
    return means(steady_twin(seen(name)), OTHER_SEEDS, spp, integrator)


@pytest.mark.statistical
@pytest.mark.parametrize("name", SCENES)
def test_light_is_that_of_volpath(name):
    expected = volpath(name)
    assert agree(means(seen(name), SEEDS, SPP), expected, rounding=1e-3)


ONE_SAMPLE = {"type": "path_tracer_mis", "technique": "one_sample"}
TECHNIQUES: dict[str, dict[str, Any]] = {
    "path": {"type": "transient_path"},
    "nee": {"type": "path_tracer_nee"},
    "mats": {"type": "path_tracer_mats"},
    "one sample": ONE_SAMPLE,
    "light tracer": {"type": LIGHT_TRACER},
    "bdpt": {"type": BDPT},
    "several light samples": {"type": "transient_path", "light_samples": 3},
}


@pytest.mark.statistical
@pytest.mark.parametrize("name", ["ball", "lamp behind"])
@pytest.mark.parametrize("technique", TECHNIQUES)
def test_every_technique_finds_the_same_light(name, technique):
    expected = volpath(name)
    assert agree(means(seen(name, **TECHNIQUES[technique]), SEEDS, SPP), expected, rounding=1e-3)


@pytest.mark.statistical
def test_a_gate_sees_the_light_of_a_boundary():
    """The sum over gates times their distance is the picture."""
    gates = {"temporal_bins": 40, "start_opl": 2.03, "bin_width_opl": 0.3}
    loaded = load(seen("ball", type="transient_path"))
    gated = mi.load_dict(
        {
            "type": "time_gated_transient_path",
            "max_depth": DEPTH,
            "rr_depth": 20,
            "pulse_width_opl": 0.3,
        }
    )

    def one(seed: int) -> np.ndarray:
        options = {"spp": SPP, "seed": seed, "progress": False}
        found = tofrender.render_transient(loaded, gated, loaded.sensors()[0], gates, **options)
        return found.sum(axis=2).mean((0, 1)) * gates["bin_width_opl"]

    assert agree(over_seeds(one, SEEDS), volpath("ball"), rounding=2e-3)


@pytest.mark.statistical
@pytest.mark.parametrize("name", ["ball", "lamp behind"])
def test_hidden_boundaries_light_the_scene(name):
    """The camera looks through the ball and the fog in it, as in Mitsuba."""
    found = means(seen(name, hide_emitters=True), SEEDS, SPP)
    assert agree(found, volpath(name, hide_emitters=True), rounding=1e-3)
    assert not agree(found, volpath(name), rounding=1e-3)


SHEETS = {2.43: red(0.3, 0.5, 0.2), 3.76: red(0.1, 0.2, 0.9)}
"""Radiance of glowing sheets, by distance from the camera [m]."""

WALL = 5.28, red(0.7, 0.1, 0.4)
"""Distance and radiance of an opaque emitter behind the sheets."""


def sheets_before_a_wall(medium: dict | None, **integrator: Any) -> dict:
    """Glowing sheets of type `null` and a lamp, which the camera sees along its axis."""
    eye = np.array([0.3, -0.2, 4.0])
    facing = {"medium": medium} if medium else {}
    view = camera(eye, eye - (0, 0, 1), film(2, 1, 60, 2.0, 0.1), fov=0.1, **facing)
    parts = {"aside": filled(sphere(0.5, (9, 0, 0)), fog(1.0))}
    for number, (distance, radiance) in enumerate(SHEETS.items()):
        place = translate(0, 0, 4.0 - distance)
        glow = {"type": "area", "radiance": radiance}
        parts[f"sheet {number}"] = plane(place, 2.0, bsdf=NULL, glow=glow)
        if medium:
            parts[f"sheet {number}"] |= {"interior": medium, "exterior": medium}
    distance, radiance = WALL
    lamp = {"type": "area", "radiance": radiance}
    parts["wall"] = plane(translate(0, 0, 4.0 - distance), 2.0, bsdf=diffuse(0.0), lamp=lamp)
    return scene(parts, view, **{"max_depth": 1} | integrator)


def bins_of_sheets(sigma_t: float = 0.0) -> np.ndarray:
    """Radiance that arrives in each time bin, attenuated by exp(-sigma_t * distance)."""
    bins = np.zeros((60, 3))
    for distance, radiance in [*SHEETS.items(), WALL]:
        k = int((distance - 2.0) / 0.1)
        bins[k] += np.exp(-sigma_t * distance) * np.array(radiance["value"])
    return bins


@pytest.mark.parametrize("kind", ["transient_path", "transient_volpath", "path_tracer_mats"])
def test_each_boundary_counts_at_its_own_time(kind):
    """Passed emitters do not count as vertices, so that depth 1 suffices."""
    _, transient = rendered(sheets_before_a_wall(None, type=kind), 16)
    expected = np.broadcast_to(bins_of_sheets(), (*transient.shape[:2], 60, 3))
    np.testing.assert_allclose(transient, expected, rtol=1e-4, atol=1e-6)


@pytest.mark.statistical
def test_each_boundary_is_attenuated_by_the_fog_before_it():
    dim = fog(0.4, 0.0)
    loaded = load(sheets_before_a_wall(dim))
    found = over_seeds(lambda seed: rendered(loaded, 2048, seed)[1].mean((0, 1)), SEEDS)
    expected = bins_of_sheets(0.4)
    filled_bins = expected.sum(axis=1) > 0
    np.testing.assert_array_equal(found.mean(axis=0).sum(axis=1) > 0, filled_bins)
    wanted = np.broadcast_to(expected[filled_bins], (len(SEEDS), 3, 3))
    assert agree(found[:, filled_bins], wanted, rounding=1e-3)


def test_hidden_sheets_are_black():
    steady, _ = rendered(sheets_before_a_wall(None, hide_emitters=True), 16)
    assert steady.max() == 0


def test_paths_list_the_boundaries_that_they_pass():
    loaded = load(sheets_before_a_wall(None))
    paths = tofrender.paths_of(loaded, (0, 0), spp=64, count=40)
    through = [paths.isel(path=k) for k in range(paths.sizes["path"]) if "wall" in paths.shape[k]]
    for path in through:
        assert path["shape"].values.tolist() == ["sensor", "sheet 0", "sheet 1", "wall"]
        expected = [0, *SHEETS, WALL[0]]
        np.testing.assert_allclose(path["vertex_opl"].values, expected, atol=1e-2)
    assert through
    counts = [np.count_nonzero(paths["shape"][k] != "") for k in range(paths.sizes["path"])]
    assert set(counts) == {2, 3, 4}


def test_lidar_passes_a_glowing_boundary():
    """The emission of a boundary changes nothing that a lidar receives."""

    def echoes(**more: Any) -> np.ndarray:
        facing = mi.ScalarTransform4f().translate([0.2, 0, 5]).rotate([0, 1, 0], 165).scale(20)
        parts = {
            "wall": {"type": "rectangle", "to_world": facing, "bsdf": diffuse(0.5)},
            "ball": filled(sphere(0.7, (0.1, 0.2, 2.5)), fog(0.3, 0.8), **more),
            "sensor": {"type": "perspective"},
        }
        shots = scan_pattern(shots=(3, 2), fov_deg=(20, 10))
        options = {"max_range": 9.0, "max_depth": 3, "bin_width_opl": 0.1, "pulse_width_opl": 0.2}
        found = lidar({"type": "scene", **parts}, shots, spp=64, progress=False, **options)
        return found["rate"].values

    np.testing.assert_allclose(echoes(glow=RADIANCE), echoes(), rtol=1e-6)


@pytest.mark.parametrize("what", ["radiance", "sigma_t"])
def test_derivatives(what):
    """Differentiate the sum over pixels, channels and bins by a sheet's radiance and by the fog."""
    σ = 0.4
    described = sheets_before_a_wall(fog(σ, 0.0), pulse_width_opl=0.2)
    described["sensor"]["medium"]["sigma_t"] = {"type": "constvolume", "value": σ}
    loaded = load(described)
    params = mi.traverse(loaded)
    if what == "radiance":
        names = ["sheet 0.emitter.radiance.value"]
        wanted = 2 * 3 * np.exp(-σ * 2.43)
    else:
        names = [name for name in params.keys() if name.endswith("sigma_t.value.value")]  # noqa: SIM118
        lights = [*SHEETS.items(), WALL]
        each = [-d * np.exp(-σ * d) * sum(radiance["value"]) for d, radiance in lights]
        wanted = 2 * sum(each)
    for name in names:
        dr.enable_grad(params[name])
    params.update()
    steady, _ = mi.render(loaded, params=params, spp=4096)
    dr.backward(dr.sum(steady, axis=None))
    found = sum(float(dr.sum(dr.grad(params[name]))[0]) for name in names)
    assert found == pytest.approx(wanted, rel=0.05)
