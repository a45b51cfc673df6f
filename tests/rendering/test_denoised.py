"""Renders in two halves, and without their noise."""

import itertools
import signal

import mitsuba as mi
import numpy as np
import pytest
import xarray as xr
from helpers.films_in_parts import (
    box as small_box,
    differences,
    in_small_steps,
    render,
    watch_steps,
)
from helpers.refusals import refused

import tofrender
from tofrender import denoise
from tofrender.integrators.features import by_name, render_features


@pytest.fixture(scope="module")
def box():
    return tofrender.load_scene(small_box())


@pytest.fixture(scope="module")
def found(box):
    return render(box, spp=64, denoise=True)


def test_the_raw_film_is_that_of_a_plain_render(box, found):
    plain, half = render(box, spp=64), render(box, spp=32)
    top = float(plain["transient"].max())
    np.testing.assert_allclose(found["raw"], plain["transient"], atol=1e-5 * top)
    first = found["raw"] + found["half_difference"]
    np.testing.assert_allclose(first, half["transient"], atol=1e-5 * top)
    for name in ("transient", "steady"):
        assert float(found[name].sum()) == pytest.approx(float(plain[name].sum()), rel=1e-4)
    change = (found["transient"] - found["raw"]).sum("opl")
    np.testing.assert_allclose(found["steady"] - plain["steady"], change, atol=1e-4 * top)


@pytest.mark.filterwarnings("ignore::UserWarning")  # Light outside of the window
def test_direct_light_of_points_has_more_samples():
    """Paths of two segments and longer ones add up; the former are those of four times `spp`."""
    scene, few = tofrender.load_scene("cornell_box_flash", width=12, height=9), {"spp": 64}
    kind = {"type": "transient_path", "max_depth": 2}
    found = render(scene, denoise=True, **few)
    direct = render(scene, spp=256, integrator=kind)
    top = float(direct["transient"].max())
    np.testing.assert_allclose(found["direct"], direct["transient"], atol=1e-5 * top)
    rest = render(scene, **few)["transient"] - render(scene, **few, integrator=kind)["transient"]
    np.testing.assert_allclose(found["raw"] - found["direct"], rest, atol=1e-5 * top)
    again = denoise(found)
    assert float(again["transient"].sum()) == pytest.approx(float(found["raw"].sum()), rel=1e-4)


@pytest.mark.filterwarnings("ignore::UserWarning")  # Light outside of the window
def test_single_scattering_is_apart():
    """Light that is scattered once and more often add up to that of one render."""
    scene = tofrender.load_scene("cornell_box_fog", width=6, height=6)
    found, whole = render(scene, spp=256, denoise=True), render(scene, spp=1024)
    direct = render(scene, spp=1024, integrator={"type": "transient_volpath", "max_depth": 2})
    top = float(direct["transient"].max())
    np.testing.assert_allclose(found["direct"], direct["transient"], atol=1e-5 * top)
    assert float(found["raw"].sum()) == pytest.approx(float(whole["transient"].sum()), rel=0.1)


def test_lamps_with_an_area_have_no_direct_light_apart(found):
    assert float(abs(found["direct"]).max()) == 0


def test_it_is_nearer_to_the_truth():
    scene = tofrender.load_scene(small_box(24, 24, bin_width_opl=0.1, temporal_bins=120))
    found, truth = render(scene, spp=16, denoise=True), render(scene, spp=1024, seed=1)
    errors = [float(((found[n] - truth["transient"]) ** 2).sum()) for n in ("transient", "raw")]
    assert errors[0] < errors[1] / 1.5


def test_files_keep_what_denoise_needs(found, tmp_path):
    assert denoise(found).identical(found)
    again = tofrender.load_npz(tofrender.save_npz(found, tmp_path / "box.npz"))
    assert again.identical(found)
    assert denoise(again).identical(found)
    tofrender.save_exr_stack(found, tmp_path / "box")
    loaded = tofrender.load_exr_stack(tmp_path / "box")
    assert set(loaded.data_vars) == {"transient", "steady"}
    np.testing.assert_array_equal(loaded["transient"], found["transient"])
    with refused("^dataset: has no raw"):
        denoise(loaded)


def test_polarized_components_are_kept(tmp_path):
    mi.set_variant("llvm_ad_spectral_polarized")
    found = render("brewster_window", size=(8, 6), spp=16, denoise=True)
    assert found["half_difference"].dims == found["transient"].dims
    again = tofrender.load_npz(tofrender.save_npz(found, tmp_path / "window.npz"))
    assert again.identical(found)


@pytest.mark.parametrize("half", [0, 1])
def test_a_checkpoint_goes_on(monkeypatch, tmp_path, box, found, half):
    path, parts = tmp_path / "box.npz", itertools.count()

    def look(number):
        if number == 0 and next(parts) == half:
            signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patch, refused("of 2 halves", KeyboardInterrupt):
        in_small_steps(patch, 12 * 9)
        watch_steps(patch, look)
        render(box, spp=64, denoise=True, checkpoint=path)
    resumed = render(box, spp=64, denoise=True, checkpoint=path)
    assert max(differences(resumed, found).values()) < 1e-4


def test_features_of_a_plane():
    """Looking down on a wall at distance 3: positions, normals and albedo are known."""
    scene = {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "fov": 40.0,
            "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}},
        },
        "wall": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().translate([0, 0, 3]).rotate([0, 1, 0], 180).scale(9),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.2, 0.4, 0.6]}},
        },
        "mirror": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f()
            .translate([4.4, 0, 2])
            .rotate([0, 1, 0], 180)
            .scale(4),
            "bsdf": {"type": "conductor"},
        },
        "fog": {"type": "sphere", "center": [0, 0, 2], "radius": 0.9, "bsdf": {"type": "null"}},
    }
    loaded = mi.load_dict(scene)
    sensor = loaded.sensors()[0]
    features = by_name(render_features(loaded, sensor, sensor.film()))
    own = features["kind"] == 0
    assert (features["kind"] == 2).any()
    assert own.any()
    np.testing.assert_allclose(features["position"][own][:, 2], 3, atol=1e-4)
    np.testing.assert_allclose(
        features["normal"][own], np.tile([0, 0, -1], (own.sum(), 1)), atol=1e-5
    )
    np.testing.assert_allclose(
        features["albedo"][own], np.tile([0.2, 0.4, 0.6], (own.sum(), 1)), rtol=1e-5
    )
    length = np.linalg.norm(features["position"], axis=-1)
    np.testing.assert_allclose(features["distance"][own], length[own], rtol=1e-2)


def test_the_order_of_axes_does_not_matter(found):
    turned = found.isel(x=slice(None, None, -1), channel=[2, 0, 1]).transpose("opl", "x", "y", ...)
    xr.testing.assert_identical(denoise(turned), denoise(found))


def test_what_has_no_halves_is_refused(box, found, tmp_path):
    for text, options in {
        "^spp = 1: must be even": {"spp": 1},
        "^spp = 63: must be even": {"spp": 63},
        "^denoise = True: must be False with errors": {"spp": 64, "errors": True},
        "^denoise = True: must be False with `out`": {"spp": 64, "out": tmp_path / "a.zarr"},
        "^resume: must be left out with denoise": {"spp": 128, "resume": found},
    }.items():
        with refused(text):
            render(box, denoise=True, **options)
    with refused("^resume: was rendered with denoise = True; must be False"):
        render(box, spp=128, resume=found)
    for text, dataset in {
        "^dataset: has no raw": render(box, spp=2),
        "^mean: .* not finite": found.assign(raw=found["raw"] * np.nan),
        "^dataset: has no features": found.drop_vars("features"),
        "^dataset: the axis x skips pixels": found.isel(x=slice(None, None, 2)),
        "^features: position with shape|coordinates": found.isel(feature=slice(1)),
    }.items():
        with refused(text):
            denoise(dataset)
