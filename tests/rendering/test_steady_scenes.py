"""Scenes whose film is steady become transient: window, pulse, and filters."""

import warnings

import mitsuba as mi
import numpy as np
import pytest
from helpers.parts import area_light, diffuse, plane, point_light
from helpers.refusals import refused

import tofrender
from tofrender.integrators.transient_path import TransientPath
from tofrender.rendering import arrivals
from tofrender.rendering.job import WorkItem
from tofrender.rendering.renderer import make_job
from tofrender.rendering.settings import RenderSettings
from tofrender.rendering.work_items import _film_of

DISTANCE = 2.03
"""Distance from the plane of an orthographic camera to a glowing wall that faces it [m]."""

FILTERS = ["box", "tent", "gaussian", "mitchell", "catmullrom", "lanczos"]
WINDOW = {"bins": 40, "window": (1.5, 3.5)}


def steady_film(rfilter: str | None = None) -> dict:
    crop = {"crop_width": 5, "crop_height": 4, "crop_offset_x": 2, "crop_offset_y": 1}
    film = {"type": "hdrfilm", "width": 9, "height": 6, **crop}
    return film if rfilter is None else film | {"rfilter": {"type": rfilter}}


def looking(rfilter: str | None, kind: str = "orthographic", **parts: dict) -> dict:
    """A steady scene, seen by a tilted camera."""
    eye, target = np.array([0.4, -0.7, 1.1]), np.array([-0.2, 0.3, -0.5])
    to_world = mi.ScalarTransform4f().look_at(eye.tolist(), target.tolist(), [0.1, 1, 0.2])
    sensor = {"type": kind, "to_world": to_world, "near_clip": 0.01, "film": steady_film(rfilter)}
    integrator = {"type": "path", "max_depth": 3}
    return {"type": "scene", "integrator": integrator, "sensor": sensor, **parts}


def glowing_wall(rfilter: str | None) -> dict:
    """All light arrives at the length `DISTANCE`."""
    described = looking(rfilter)
    to_world = described["sensor"]["to_world"] @ mi.ScalarTransform4f().translate([0, 0, DISTANCE])
    facing = to_world @ mi.ScalarTransform4f().rotate([0, 1, 0], 180)
    return described | {"wall": plane(facing, emitter=area_light(0.7))}


def lit_ball(**reflectance) -> dict:
    texture = {"type": "bitmap", "filter_type": "nearest", **reflectance}
    ball = {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": texture}, "radius": 0.8}
    lamp = point_light((0.9, 1.4, 2.1), 7.0)
    return looking("box", "perspective", ball=ball, lamp=lamp)


def render(scene, **options):
    return tofrender.render(scene, **({"spp": 16, "progress": False} | options))


@pytest.mark.parametrize(
    ("rfilter", "is_loaded"),
    [*((each, False) for each in (None, *FILTERS)), (None, True), ("catmullrom", True)],
)
def test_the_filter_of_the_picture_does_not_change_times(rfilter, is_loaded):
    """All light is in the bin of its length, as much as is in the steady picture."""
    scene = glowing_wall(rfilter)
    if is_loaded:
        scene = mi.load_dict(scene)
    found = render(scene, **WINDOW, integrator="transient_path" if is_loaded else None)
    light = found.transient.values.sum(axis=(0, 1, 3), dtype=float)
    assert np.flatnonzero(light).tolist() == [int((DISTANCE - 1.5) / 0.05)]
    assert light.sum() == pytest.approx(float(found.steady.sum()), rel=1e-5)
    assert found.steady.values == pytest.approx(0.7, rel=1e-4)
    assert found.attrs["temporal_filter"] == "box"


def test_a_made_integrator_sees_a_steady_scene_through_a_box():
    made = mi.load_dict({"type": "transient_path", "max_depth": 2})
    found = render(glowing_wall("gaussian"), **WINDOW, integrator=made)
    assert np.count_nonzero(found.transient.values.sum(axis=(0, 1, 3))) == 1


def test_filters_in_time_that_are_asked_for_stay():
    """An integrator's filter, and that of a film with time bins."""
    smooth = {"type": "transient_path", "temporal_filter": "gaussian"}
    found = render(glowing_wall("tent"), **WINDOW, integrator=smooth)
    assert np.count_nonzero(found.transient.values.sum(axis=(0, 1, 3))) > 6
    assert found.attrs["temporal_filter"] == "gaussian"

    described = glowing_wall("tent")
    bins = {"temporal_bins": 40, "start_opl": 1.5, "bin_width_opl": 0.05}
    described["sensor"]["film"] |= {"type": "transient_hdr_film", **bins}
    found = render(described, integrator="transient_path")
    assert np.count_nonzero(found.transient.values.sum(axis=(0, 1, 3))) == 3
    assert found.attrs["temporal_filter"] == "as rfilter"

    described["sensor"]["film"]["rfilter"] = {"type": "lanczos"}
    with refused(r"rfilter LanczosSincFilter has negative lobes.* temporal_filter .* to 'box'"):
        render(described, integrator="transient_path")


@pytest.mark.parametrize("temporal_filter", ["", "box"])
def test_tiles_have_the_temporal_filter_of_the_film(temporal_filter):
    film = {"type": "transient_hdr_film", "width": 9, "height": 6, "rfilter": {"type": "tent"}}
    whole = mi.load_dict(film | {"temporal_filter": temporal_filter})
    tile, where = _film_of(whole, WorkItem(1, 4, 3, 2, 0, 1))
    assert tile.temporal_filter == temporal_filter
    assert (where.x, where.y) == (3, 0)
    assert tuple(tile.size()) == tuple(tile.crop_size()) == (4, 5)


@pytest.mark.parametrize("variant", ["llvm_ad_spectral", "llvm_ad_rgb"])
@pytest.mark.parametrize("kind", ["bitmap", "data"])
def test_pictures_of_the_caller_stay_as_they_are(variant, kind):
    """A second render, or a window that is found, shows the same colors."""
    mi.set_variant(variant)
    pixels = np.random.default_rng(8).random((3, 5, 3), dtype=np.float32)
    given = mi.Bitmap(pixels) if kind == "bitmap" else mi.TensorXf(pixels)
    scene = lit_ball(**{kind: given})
    first = render(scene, bins=20, window=(1.0, 9.0))
    assert np.array(given).tobytes() == pixels.tobytes()
    for options in ({}, {"window": "auto"}, {"bins": 20, "window": (1.0, 9.0)}):
        again = render(scene, **options)
        np.testing.assert_allclose(again.steady, first.steady, rtol=1e-5)
    if kind == "bitmap":  # A tensor holds spectra in spectral variants, not colors
        assert np.ptp(first.steady.values.mean(axis=(0, 1))) > 0.01 * float(first.steady.mean())


def test_a_scene_is_loaded_once(monkeypatch):
    loads = []
    usual = TransientPath.__init__
    monkeypatch.setattr(TransientPath, "__init__", lambda *all: loads.append(1) or usual(*all))
    found = make_job(RenderSettings(lit_ball(bitmap=mi.Bitmap(np.ones((2, 2, 3), np.float32)))))
    assert len(loads) == 1
    assert found.integrator.pulse.width == found.settings.pulse_width
    make, words = found.origin
    axis = found.film.temporal_bins, found.film.start_opl, found.film.bin_width_opl
    assert make(axis=axis, **words).recipe == found.recipe  # What a worker loads is the same


def test_light_is_looked_for_once(monkeypatch):
    seeds = []
    usual = arrivals.find_arrivals

    def counted(*given):
        seeds.append(given[-1])
        return usual(*given)

    monkeypatch.setattr(arrivals, "find_arrivals", counted)
    settings = RenderSettings(lit_ball(bitmap=mi.Bitmap(np.ones((2, 2, 3), np.float32))))
    found = make_job(settings)
    assert len(seeds) == len(set(seeds)) >= 2

    # The window is that of a render with this pulse, which looks for the light itself
    again = make_job(found.settings)
    assert again.film.start_opl == found.film.start_opl
    assert again.film.bin_width_opl == found.film.bin_width_opl


def test_the_pulse_of_an_integrator_of_the_caller_stays():
    made = mi.load_dict({"type": "transient_path", "max_depth": 2})
    film = {"type": "transient_hdr_film", "width": 4, "height": 3, "temporal_bins": 300}
    scene = lit_ball(bitmap=mi.Bitmap(np.ones((2, 2, 3), np.float32))) | {"integrator": made}
    scene["sensor"]["film"] = film
    with refused("integrator of the scene is a ready-made object"):
        render(scene, window="auto", pulse_width="auto")
    assert made.pulse is None


@pytest.mark.parametrize(
    ("options", "axis", "pulse"),
    [
        ({}, None, "GaussianPulse"),
        ({"window": "auto"}, None, "none"),
        ({"window": (2.0, 8.0)}, (300, 2.0, 0.02), "none"),
        ({"pulse_width": 0.1}, None, "GaussianPulse(width_opl=0.1)"),
        ({"window": "auto", "pulse_width": 0.1}, None, "GaussianPulse(width_opl=0.1)"),
        ({"settings": {"pulse_width_opl": 0.1}}, None, "GaussianPulse(width_opl=0.1)"),
        ({"start_opl": 2.0, "bin_width": 0.03}, (300, 2.0, 0.03), "none"),
        ({"window": (2.0, 8.0), "bins": 50}, (50, 2.0, 0.12), "none"),
    ],
)
def test_what_is_left_open_of_time_is_found(options, axis, pulse):
    wall = plane(mi.ScalarTransform4f().translate([0, 0, -1]), bsdf=diffuse(0.6))
    scene = looking(None, "perspective", wall=wall, lamp=point_light((0.3, 0.9, 1.7), 5.0))
    film = make_job(RenderSettings(scene, spp=4, **options))
    found = film.film
    if axis is None:
        assert found.temporal_bins == 300
        assert 4.5 < found.start_opl < 5.2 < 6.0 < found.end_opl()
    else:
        assert (found.temporal_bins, found.start_opl) == axis[:2]
        assert found.bin_width_opl == pytest.approx(axis[2])
    assert film.recipe["pulse"].startswith(pulse)


def small_lamp() -> dict:
    """A Cornell box in a wide view: few paths meet it, and the lamp itself is seen by very few."""
    scene = tofrender.cornell_box(width=24, height=16)
    scene["sensor"]["fov"] = 140
    return scene


def test_an_automatic_window_is_enlarged_until_it_holds_the_light():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = render(small_lamp(), spp=64, window="auto")
    assert found.attrs["energy_outside_window"] < 0.01
    assert found.attrs["start_opl"] < 4.0  # The lamp is seen from 3.8 m on


def test_an_automatic_window_does_not_recommend_itself(monkeypatch):
    monkeypatch.setattr("tofrender.rendering.time_window.CHECKS", 0)
    with pytest.warns(UserWarning, match="outside the window 4.53 to 14.24 m; set `window`"):
        render(small_lamp(), spp=64, window="auto")
