"""Going on with a render: the same picture as in one go, and only for the same render."""

import mitsuba as mi
import numpy as np
import pytest
from helpers.films_in_parts import crop, render
from helpers.refusals import refused
from helpers.support import with_film

import tofrender
from tofrender.scenes.fingerprint import fingerprint

pytestmark = pytest.mark.filterwarnings("ignore:.*of the energy arrives outside")


def box(**options) -> dict:
    return tofrender.cornell_box(
        **{"width": 32, "height": 32, "temporal_bins": 120, "bin_width_opl": 0.1, **options}
    )


@pytest.fixture(scope="module")
def earlier():
    return render(box(), spp=16)


@pytest.mark.parametrize(("spp", "saved"), [(8, False), (24, True), (50, False)])
def test_two_parts_are_one_render(tmp_path, spp, saved):
    whole, part = (render(box(), spp=count) for count in (64, spp))
    if saved:
        part = tofrender.load_exr_stack(tofrender.save_exr_stack(part, tmp_path / "stack"))
    again = render(box(), spp=64, resume=part)
    np.testing.assert_allclose(again.transient, whole.transient, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(again.steady, whole.steady, rtol=1e-4, atol=1e-6)
    assert (again.attrs["spp"], again.attrs["complete"]) == (64, 1)


def test_the_order_of_axes_does_not_matter(earlier):
    turned = earlier.isel(x=slice(None, None, -1), channel=[1, 2, 0]).transpose("x", "y", ...)
    again = [render(box(), spp=24, resume=each) for each in (earlier, turned)]
    np.testing.assert_array_equal(again[0]["transient"], again[1]["transient"])
    np.testing.assert_array_equal(again[0]["steady"], again[1]["steady"])


def filtered(rfilter: str) -> dict:
    described = with_film(box(width=12, height=9, temporal_bins=40, bin_width_opl=0.5), **BORDER)
    described["integrator"]["temporal_filter"] = "box"
    return with_film(described, rfilter={"type": rfilter})


BORDER = {"crop_width": 9, "crop_height": 7, "crop_offset_x": 2, "crop_offset_y": 1}


@pytest.mark.parametrize("rfilter", ["tent", "gaussian"])
def test_parts_with_a_filter_differ_by_less_than_the_noise(rfilter):
    """docs/checkpoints.md has these numbers. A checkpoint keeps sums, so that nothing differs."""
    described = filtered(rfilter)
    whole = render(described, spp=32)
    noise = off(render(described, spp=32, seed=1), whole)
    again = render(described, spp=32, resume=render(described, spp=16))
    for name in ("steady", "transient"):
        assert 1e-5 < off(again, whole)[name] < 1e-3
        assert off(again, whole)[name] < 0.05 * noise[name]


def off(one, other) -> dict[str, float]:
    """Differences of the variables, RMS over that of the other."""
    squares = ((one - other) ** 2).mean() / (other**2).mean()
    return {str(name): float(np.sqrt(value)) for name, value in squares.items()}


@pytest.mark.parametrize("sampler", ["independent", "multijitter"])
def test_other_samplers_draw_other_points(sampler):
    """Two halves of the same points would be no better than one."""
    half = render(box(), spp=16, sampler=sampler)
    whole = render(box(), spp=32, sampler=sampler, resume=half)
    rest = 2 * whole.transient - half.transient
    assert float(abs(rest - half.transient).max()) > 0.01
    assert float(rest.sum()) == pytest.approx(float(half.transient.sum()), rel=0.05)


@pytest.mark.parametrize(
    ("scene", "options", "text"),
    [
        (box(light="flash", start_opl=3.5), {}, "was rendered with fingerprint"),
        (box(max_depth=4), {}, "was rendered with max_depth = 8; must be 4"),
        (box(), {"seed": 1}, "was rendered with seed = 0; must be 1"),
        (box(), {"sampler": "independent"}, "was rendered with sampler"),
        (box(), {"window": (3.5, 20.0)}, "was rendered with bin_width_opl"),
        (box(width=16), {}, "resume:"),
        (box(), {"spp": 16}, "spp = 16: must be above 16, which resume has already"),
    ],
)
def test_another_render_is_refused(earlier, scene, options, text):
    with refused(text):
        render(scene, **{"spp": 32, **options}, resume=earlier)


def test_another_crop_is_refused():
    first, other = (with_film(box(), **crop(offset, 0, 8, 8)) for offset in (0, 8))
    with refused("resume: the axis x has the labels"):
        render(other, spp=32, resume=render(first, spp=16))


@pytest.mark.parametrize("name", ["transient", "steady"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_is_refused(earlier, name, bad):
    spoilt = earlier.copy(deep=True)
    values = spoilt[name].values
    values[5, 6, ..., 1] = bad
    count = values[5, 6, ..., 1].size
    with refused(rf"^resume: {name}: {count} of .* {bad:g} at \[5, 6, "):
        render(box(), spp=32, resume=spoilt)


def test_fingerprints_tell_scenes_apart_and_nothing_else():
    def of(scene: dict) -> str:
        loaded = mi.load_dict(scene)
        return fingerprint(loaded, loaded.sensors()[0], loaded.integrator())

    assert of(box()) == of(box(spp=7, temporal_bins=3, width=8, height=8)) != of(box(max_depth=3))


@pytest.mark.parametrize("given", [{}, {"pulse_width_opl": 0.1}], ids=["no pulse", "a pulse"])
def test_a_scene_has_the_same_fingerprint_once_it_is_rendered(given):
    loaded = mi.load_dict(box())
    tracer = mi.load_dict({"type": "transient_path"} | given)
    before = fingerprint(loaded, loaded.sensors()[0], tracer)
    mi.render(loaded, mi.traverse(loaded), integrator=tracer, spp=1)
    mi.traverse(tracer)
    assert fingerprint(loaded, loaded.sensors()[0], tracer) == before


@pytest.mark.parametrize(
    ("plugin", "name", "values"),
    [
        *[("transient_path", n, (False, True)) for n in ("camera_unwarp", "discard_direct_light")],
        ("simple", "energy", (1.0, 5.0)),
        ("transient_nlos_path", "laser_power", (1.0, 2.0)),
        ("transient_nlos_path", "capture_type", ("single", "confocal")),
        ("transient_nlos_path", "discard_direct_paths", (False, True)),
        ("transient_path", "hide_emitters", (False, True)),
        ("path_tracer_mis", "technique", ("reuse", "one_sample")),
    ],
)
def test_every_parameter_of_an_integrator_counts(plugin, name, values):
    loaded = tofrender.load_scene("cornell_box", width=4, height=4)
    given = {"simple": {"position": [0, 0, 1], "energy": 1.0}}.get(plugin, {})
    if plugin == "transient_nlos_path":
        given = {"nlos_laser_sampling": True}
    prints = {
        fingerprint(loaded, loaded.sensors()[0], tracer)
        for value in (*values, values[0])
        for tracer in [mi.load_dict({"type": plugin} | given | {name: value}, parallel=False)]
    }
    assert len(prints) == 2
