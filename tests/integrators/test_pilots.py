"""Results of pilots are kept for renders of the same scene, and only for these."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.support import load, rendered, with_film, with_integrator

from tofrender.integrators import caustic_techniques, passes, pilots
from tofrender.integrators.caustic_techniques import Caustics
from tofrender.scenes import cornell_box_mirror

SPP = 4


@pytest.fixture(autouse=True)
def _in_small_films(monkeypatch):
    """Use pilots in small films, and forget the results of earlier tests."""
    monkeypatch.setattr(passes, "FEW_PATHS", 0)
    monkeypatch.setattr(pilots, "_results", {})


def described(**integrator) -> dict:
    size = {"width": 6, "height": 5, "temporal_bins": 24, "bin_width_opl": 0.25, "max_depth": 4}
    crop = {"crop_width": 4, "crop_height": 3, "crop_offset_x": 1, "crop_offset_y": 2}
    return with_integrator(with_film(cornell_box_mirror(**size), **crop), **integrator)


def chosen(scene: mi.Scene) -> Caustics:
    sensor = scene.sensors()[0]
    return Caustics.of(scene.integrator().plan(scene, sensor), sensor)


def launches(scene: mi.Scene, seed: int = 0, spp: int = SPP) -> int:
    """Number of kernels that a render launches for the photons of pilots."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        rendered(scene, spp, seed)
        return [each.get("size") for each in dr.kernel_history()].count(caustic_techniques.PILOT)


def tables(scene: mi.Scene) -> list[np.ndarray]:
    """Probabilities of emission, and the table of directions."""
    techniques = chosen(scene)
    guided = techniques.tracer.caustic_rays.guided
    emission = techniques.photons.table.distribution.pmf
    return [np.array(each) for each in (emission, guided.α, guided.slots, guided.pdfs)]


def equal(a: list[np.ndarray], b: list[np.ndarray]) -> bool:
    """Whether tables have the same bits."""
    return all(map(np.array_equal, a, b))


def test_the_next_render_has_no_pilot():
    """Neither the seed nor the number of samples matters."""
    scene = load(described())
    assert launches(scene) > 0
    assert launches(scene) == 0
    assert launches(scene, seed=7, spp=2 * SPP) == 0


def test_a_scene_that_is_loaded_again_has_no_pilot():
    first = load(described())
    launches(first)
    assert launches(load(described())) == 0


CHANGES = {
    "light": ("light.emitter.radiance.value", lambda value: value * mi.Color3f(1, 2, 3)),
    "wall": ("red-wall.to_world", lambda pose: pose @ mi.Transform4f().translate([0, 0, 1e-6])),
    "camera": ("sensor.to_world", lambda pose: pose @ mi.Transform4f().translate([0.1, 0, 0])),
    "film": ("sensor.film.crop_offset", lambda _: mi.ScalarPoint2u(2, 1)),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_change_in_place_needs_a_new_pilot(name):
    """The tables are those of a scene that has never been different."""
    scene = load(described())
    launches(scene)
    parameters = mi.traverse(scene)
    key, change = CHANGES[name]
    before = type(parameters[key])(parameters[key])
    parameters[key] = change(parameters[key])
    parameters.update()
    assert launches(scene) > 0
    kept = tables(scene)
    pilots._results.clear()
    assert equal(tables(scene), kept)

    # The first state has its first result
    launches(scene)
    parameters[key] = before
    parameters.update()
    first = tables(scene)
    assert launches(scene) == 0
    assert equal(first, tables(load(described())))


@pytest.mark.parametrize(
    "settings", [{"max_depth": 5}, {"hide_emitters": True}], ids=lambda each: next(iter(each))
)
def test_settings_of_photons_need_a_new_pilot(settings):
    """The pilot of caustic rays does not depend on them."""
    both = launches(load(described()))
    assert 0 < launches(load(described(**settings))) < both


def test_a_kept_result_gives_the_same_picture():
    """Without photons, each pixel has one writer, so that even the last digits are equal."""
    size = {"width": 40, "height": 30, "temporal_bins": 24, "bin_width_opl": 0.25, "max_depth": 4}
    scene = load(with_integrator(cornell_box_mirror(**size), caustic_photons=False))
    first = rendered(scene, SPP, 3)
    kept = rendered(scene, SPP, 3)
    pilots._results.clear()
    again = rendered(scene, SPP, 3)
    for result in (kept, again):
        for expected, found in zip(first, result, strict=True):
            np.testing.assert_array_equal(found, expected)


def test_tables_have_the_same_bits():
    """Also the sums of photons, which threads add in any order."""
    scene = load(described())
    first = tables(scene)
    pilots._results.clear()
    assert equal(tables(scene), first)
    assert not equal(tables(load(described(max_depth=6))), first)


def test_few_results_are_kept():
    """The result that was used longest ago is dropped."""
    scene = load(described())
    parts = pilots.Pilots(scene, scene.sensors()[0])
    traced = []
    for number in (*range(pilots.MOST_RESULTS), 0, pilots.MOST_RESULTS, 0, 1):
        assert parts.result(lambda n=number: traced.append(n) or n, number) == number
    assert traced == [*range(pilots.MOST_RESULTS + 1), 1]
