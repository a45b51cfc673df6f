"""Contributions that are not finite are left out, counted and told of."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.parts import area_light, diffuse, plane, point_light
from helpers.support import camera, film, load, scene, with_integrator

import tofrender
from tofrender.paths.endpoints.emitters import power_heuristic


class Broken(mi.BSDF):
    """A diffuse material: right of x = 0, its value is NaN, or else the weight of its samples."""

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.inner = mi.load_dict(diffuse(0.5))
        self.samples = props.get("samples", False)
        self.m_components = [int(mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide)]
        self.m_flags = self.m_components[0]

    def sample(self, ctx, si, sample1, sample2, active):
        bs, weight = self.inner.sample(ctx, si, sample1, sample2, active)
        return bs, dr.select((si.p.x > 0) & self.samples, dr.nan, weight)

    def eval(self, ctx, si, wo, active):
        value = self.inner.eval(ctx, si, wo, active)
        return dr.select((si.p.x > 0) & (not self.samples), dr.nan, value)

    def pdf(self, ctx, si, wo, active):
        return self.inner.pdf(ctx, si, wo, active)

    def eval_pdf(self, ctx, si, wo, active):
        return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)


def half_broken(max_depth: int = 2, **bsdf: bool) -> mi.Scene:
    """A floor that is seen from above, half of it broken, under a lamp."""
    mi.register_bsdf("broken", Broken)
    sensor = camera((0, 0, 3), (0, 0, 0), film(8, 4, bins=20, bin_width=0.5))
    parts = {"floor": plane(bsdf={"type": "broken"} | bsdf), "lamp": point_light((0.5, 0, 2), 3.0)}
    return load(scene(parts, sensor, max_depth=max_depth))


def test_render_counts_and_tells():
    with pytest.warns(UserWarning, match="128 contributions of paths were not finite"):
        dataset = tofrender.render(half_broken(), spp=8, progress=False)
    assert dataset.attrs["contributions_not_finite"] == 128  # 16 pixels of 8 samples
    lit = dataset["steady"].values[..., 0] > 0
    assert lit.sum() == 16
    assert np.isfinite(dataset["transient"].values).all()
    assert dataset["transient"].values.sum() == pytest.approx(dataset["steady"].values.sum())


def test_a_film_on_disk_tells_too(tmp_path):
    with pytest.warns(UserWarning, match="128 contributions of paths were not finite"):
        tofrender.render(half_broken(), spp=8, out=tmp_path / "film.zarr", progress=False)


def test_mi_render_and_gates_tell():
    broken = half_broken()
    with pytest.warns(UserWarning, match="not finite"):
        mi.render(broken, spp=4)
    gate = mi.load_dict({"type": "time_gated_transient_path", "pulse_width_opl": 0.5})
    with pytest.warns(UserWarning, match="not finite"):
        image = tofrender.render_at_time(broken, gate, broken.sensors()[0], 5.0, spp=4)
    assert np.isfinite(image).all()


def test_paths_that_break_are_counted():
    with pytest.warns(UserWarning, match="128 contributions of paths were not finite"):
        steady, _ = mi.render(half_broken(4, samples=True), spp=8)
    assert (np.array(steady)[..., 0] > 0).all()


def test_a_sound_scene_counts_none():
    dataset = tofrender.render("cornell_box", spp=1, window=(3.5, 15.0), progress=False)
    assert dataset.attrs["contributions_not_finite"] == 0


# The normal is (0, -1, 7e-17), as if an XML file rotates a rectangle by 90 degrees
ROTATED = [[0.3, 0, 0, 0.1], [0, 1.8e-17, -0.25, 0.99], [0, 0.25, 1.8e-17, 0.2], [0, 0, 0, 1]]


@pytest.mark.parametrize("light_samples", [1, 4])
def test_a_lamp_that_reflects_its_own_light_counts_none(light_samples):
    """Points of a flat emitter see each other edge-on, with a density of up to 1e20."""
    lamp = {"type": "rectangle", "to_world": mi.ScalarTransform4f(ROTATED)}
    lamp |= {"bsdf": diffuse(0.6), "emitter": area_light(3.0)}
    eye = camera((0.2, -1.5, 0.3), (0.1, 0.99, 0.2), film(16, 12, 20, 0, 0.5), up=(0, 0, 1), fov=12)
    loaded = load(scene({"lamp": lamp}, eye, max_depth=3, light_samples=light_samples))
    dataset = tofrender.render(loaded, spp=2048, progress=False)
    assert dataset.attrs["contributions_not_finite"] == 0
    assert dataset["steady"].values.max() == pytest.approx(3.0, rel=1e-4)


@pytest.mark.parametrize("density", [0.3, 1e10, 1e19, 1e30, np.inf])
def test_the_power_heuristic_of_high_densities(density):
    both = [(density, 0.2), (0.2, density)]
    weights = [float(power_heuristic(*map(mi.Float, each))[0]) for each in both]
    assert sum(weights) == pytest.approx(1)
    expected = 1 / (1 + (0.2 / density) ** 2)
    assert weights[0] == pytest.approx(expected)
    assert 0 < float(power_heuristic(mi.Float(density), mi.Float(density))[0]) <= 1


def test_a_capture_leaves_out_and_tells_too():
    mi.register_bsdf("broken", Broken)
    described = tofrender.nlos_patch(width=4, height=4, spp=8)
    described["relay_wall"] = described["relay_wall"] | {"bsdf": {"type": "broken"}}
    loaded = load(
        with_integrator(described, capture_type=2, discard_direct_paths=True, filter_bounces=3)
    )
    with pytest.warns(UserWarning, match="not finite"):
        _, transient = mi.render(loaded, spp=8)
    lit = np.array(transient).sum(axis=(2, 3)) > 0
    assert lit.any(axis=1).all()
    assert lit.sum() == 8  # Of the wall's points, half are broken
    assert np.isfinite(np.array(transient)).all()
