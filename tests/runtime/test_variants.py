"""Every variant in one process, there and back: same light, right classes, right plugins."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from helpers.gallery import SCENES
from helpers.support import camera, diffuse, film, path_image, plane, point_light, rendered, scene
from oracles import films as oracles

import tofrender

VARIANTS = [n for n in mi.variants() if n.startswith("llvm") and "polarized" not in n]


def lamp_and_floor() -> tuple[dict, float, float]:
    eye, x, lamp = (0.4, 0, 1.5), (0.4, 0, 0), (1.0, 0.3, 2.0)
    parts = {"floor": plane(bsdf=diffuse(0.5)), "lamp": point_light(lamp, 3.0)}
    sensor = camera(eye, x, film(bins=640, bin_width=2**-6), fov=0.001)
    return scene(parts, sensor), *oracles.point_light_on_plane(eye, x, (0, 0, 1), lamp, 3.0, 0.5)


def test_there_are_variants_of_every_kind():
    kinds = ("rgb", "mono", "spectral")
    assert {f"llvm_ad_{kind}" for kind in kinds} <= set(VARIANTS)


@pytest.mark.slow
@pytest.mark.parametrize("variant", VARIANTS)
def test_closed_form(variant):
    mi.set_variant(variant)
    described, radiance, opl = lamp_and_floor()
    steady, transient = rendered(described, spp=4096)
    channels = 1 if "mono" in variant else 3
    assert transient.shape == (1, 1, 640, channels)
    assert np.flatnonzero(transient[0, 0, :, 0]).tolist() == [int(opl * 2**6)]
    # Spectral variants draw wavelengths: grey has noise in its colour
    tolerance = 0.03 if "spectral" in variant else 1e-4
    assert transient[0, 0].sum(axis=0) == pytest.approx([radiance] * channels, rel=tolerance)
    assert steady[0, 0] == pytest.approx(transient[0, 0].sum(axis=0), rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", ["cornell", "glass"])
@pytest.mark.usefixtures("mitsubas_steps")
def test_mitsubas_result(variant, name):
    """Every variant gives what Mitsuba's own path tracer gives in it, to float rounding."""
    mi.set_variant(variant)
    expected = path_image(SCENES[name](), spp=16, seed=1)
    steady, transient = rendered(SCENES[name](), spp=16, seed=1)
    assert steady.shape == expected.shape
    assert np.abs(steady - expected).max() < 1e-4 * expected.max()
    assert np.abs(transient.sum(axis=2) - steady).max() < 1e-4 * expected.max()


@pytest.mark.slow
def test_switching_there_and_back():
    classes = {}
    for variant in [*VARIANTS, *VARIANTS]:
        mi.set_variant(variant)
        described, _, _ = lamp_and_floor()
        loaded = mi.load_dict(described, parallel=False)
        integrator, the_film = loaded.integrator(), loaded.sensors()[0].film()
        assert type(integrator) is tofrender.TransientPath
        assert type(the_film) is tofrender.TransientHDRFilm
        assert type(mi.load_dict({"type": "padded_sobol"})) is tofrender.PaddedSobolSampler
        assert isinstance(integrator, mi.SamplingIntegrator)
        assert isinstance(the_film, mi.Film)
        assert classes.setdefault(variant, tofrender.TransientPath) is tofrender.TransientPath
        _, transient = rendered(loaded)
        assert transient.sum() > 0
    assert len(set(classes.values())) == len(VARIANTS)


def test_dir_lists_the_plugins():
    assert {"TransientPath", "TransientHDRFilm", "PaddedSobolSampler"} <= set(dir(tofrender))


def test_scalar_variant_is_refused_in_one_line():
    mi.set_variant("scalar_rgb")
    with pytest.raises(AttributeError, match=r"needs an llvm_.* or cuda_.* variant") as error:
        tofrender.TransientPath  # noqa: B018
    assert "\n" not in str(error.value)
    with pytest.raises(tofrender.runtime.backend.BackendError, match=r"mi\.set_variant") as error:
        tofrender.runtime.backend.require_vectorised()
    assert "\n" not in str(error.value)


def test_a_bad_variant_is_refused():
    with pytest.raises(ValueError, match="variant = 'llvm_rgb'"):
        tofrender.runtime.backend.activate("llvm_rgb")
    assert mi.variant() == "llvm_ad_rgb"
