"""Scenes of spectral variants: coefficients of spectra and wavelengths are no colors."""

import mitsuba as mi
import numpy as np
import pytest

import tofrender
from tofrender.scenes.checking import check_scene
from tofrender.scenes.loading import load_scene
from tofrender.scenes.media import scatters


def picture(seed: int = 5) -> dict:
    pixels = np.random.default_rng(seed).random((3, 4, 3), dtype=np.float32)
    return {"type": "bitmap", "bitmap": mi.Bitmap(pixels)}


def textured_lights() -> dict[str, dict]:
    to_world = mi.ScalarTransform4f().look_at([0.8, 1.1, 2.0], [0.1, 0, 0], [0, 1, 0])
    posed = {"to_world": to_world}
    panel = {"type": "rectangle", **posed}
    return {
        "envmap": picture() | {"type": "envmap"},
        "area": panel | {"emitter": {"type": "area", "radiance": picture()}},
        "spot": {"type": "spot", "texture": picture(), "intensity": 9.0, **posed},
        "projector": {"type": "projector", "irradiance": picture(), "scale": 30.0, **posed},
    }


def spectral_scene(light: dict, **parts) -> dict:
    wall = {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": picture(6)}}
    eye = mi.ScalarTransform4f().look_at([0.2, -0.4, 3], [0, 0.1, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 5, "height": 4, "rfilter": {"type": "box"}}
    sensor = {"type": "perspective", "to_world": eye, "fov": 35, "film": film}
    more = {"sensor": sensor, "wall": wall, "light": light, **parts}
    return {"type": "scene", "integrator": {"type": "volpath", "max_depth": 3}, **more}


def boundary(fog: dict) -> dict:
    return {"box": {"type": "cube", "bsdf": {"type": "null"}, "interior": fog}}


def load_and_check(fog: dict) -> None:
    check_scene(
        load_scene(spectral_scene(textured_lights()["envmap"], **boundary(fog))), media=True
    )


@pytest.mark.parametrize("name", ["envmap", "area", "spot", "projector"])
def test_textured_lights_of_spectral_variants(name):
    """Their coefficients may be negative. The picture is that of Mitsuba."""
    mi.set_variant("llvm_ad_spectral")
    light = textured_lights()[name]
    found = tofrender.render(spectral_scene(light), spp=512, bins=8, window=(0, 40), progress=False)
    expected = np.array(mi.render(mi.load_dict(spectral_scene(light)), spp=2048, seed=3))
    means = [np.asarray(each).mean(axis=(0, 1)) for each in (found.steady, expected)]
    assert means[1].min() > 1e-3
    np.testing.assert_allclose(*means, rtol=0.05)


SPECTRA = [
    {
        "type": "regular",
        "wavelength_min": 380.0,
        "wavelength_max": 720.0,
        "values": "0.2, 0.9, 0.6",
    },
    {"type": "irregular", "wavelengths": "380, 500, 720", "values": "0.2, 0.9, 0.6"},
    {"type": "rgb", "value": [0.2, 0.9, 0.6]},
]


@pytest.mark.parametrize("albedo", SPECTRA, ids=lambda albedo: albedo["type"])
def test_albedos_of_media_that_are_spectra(albedo):
    mi.set_variant("llvm_ad_spectral")
    fog = {"type": "homogeneous", "sigma_t": 0.5, "albedo": albedo}
    load_and_check(fog)
    if albedo["type"] == "regular":
        wrong = albedo | {"values": "0.2, 1.4, 0.6"}
        with pytest.raises(ValueError, match=r"albedo\.value\.values = \[.*1\.4.*\]: must be from"):
            load_and_check(fog | {"albedo": wrong})


@pytest.mark.parametrize(
    ("albedo", "expected"),
    [([0.5] * 3, True), ([0.2] * 3, True), ([0, 0, 0.3], True), ([0.0] * 3, False)],
)
@pytest.mark.parametrize("variant", ["llvm_ad_spectral", "llvm_ad_rgb"])
def test_gray_media_scatter(albedo, expected, variant):
    """A gray spectrum has coefficients of 0 or less in a spectral variant."""
    mi.set_variant(variant)
    assert (
        scatters(mi.load_dict({"type": "homogeneous", "albedo": {"type": "rgb", "value": albedo}}))
        is expected
    )
    voxels = np.zeros((2, 3, 2, 3), np.float32)
    voxels[1, 2, 0] = albedo
    volume = {"type": "gridvolume", "grid": mi.VolumeGrid(voxels)}
    assert scatters(mi.load_dict({"type": "heterogeneous", "albedo": volume})) is expected
