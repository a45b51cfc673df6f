"""The same light in every variant."""

import mitsuba as mi
import numpy as np
import pytest
from helpers.gallery import SCENES
from helpers.support import camera, diffuse, film, path_image, plane, point_light, rendered, scene
from oracles import films as oracles

VARIANTS = [n for n in mi.variants() if n.startswith("llvm") and "polarized" not in n]
assert {"llvm_ad_rgb", "llvm_ad_mono", "llvm_ad_spectral"} <= set(VARIANTS)


@pytest.mark.parametrize("variant", VARIANTS)
def test_closed_form(variant):
    mi.set_variant(variant)
    eye, x, lamp = (0.4, 0, 1.5), (0.4, 0, 0), (1.0, 0.3, 2.0)
    parts = {"floor": plane(bsdf=diffuse(0.5)), "lamp": point_light(lamp, 3.0)}
    sensor = camera(eye, x, film(bins=640, bin_width=2**-6), fov=0.001)
    radiance, opl = oracles.point_light_on_plane(eye, x, (0, 0, 1), lamp, 3.0, 0.5)
    steady, transient = rendered(scene(parts, sensor), spp=4096)
    channels = 1 if "mono" in variant else 3
    assert transient.shape == (1, 1, 640, channels)
    assert np.flatnonzero(transient[0, 0, :, 0]).tolist() == [int(opl * 2**6)]
    # Spectral variants draw wavelengths: grey has noise in its colour
    tolerance = 0.03 if "spectral" in variant else 1e-4
    assert transient[0, 0].sum(axis=0) == pytest.approx([radiance] * channels, rel=tolerance)
    assert steady[0, 0] == pytest.approx(transient[0, 0].sum(axis=0), rel=1e-4)


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", ["cornell", "glass"])
@pytest.mark.usefixtures("mitsubas_steps")
def test_mitsubas_result(variant, name):
    mi.set_variant(variant)
    expected = path_image(SCENES[name](), spp=16, seed=1)
    steady, transient = rendered(SCENES[name](), spp=16, seed=1)
    assert steady.shape == expected.shape
    assert np.abs(steady - expected).max() < 1e-4 * expected.max()
    assert np.abs(transient.sum(axis=2) - steady).max() < 1e-4 * expected.max()
