"""Media that cannot be, or that the sensor does not know of: one line, before any tracing."""

import math

import mitsuba as mi
import numpy as np
import pytest
from helpers.fogs import FLAKES, TWO_LOBES, cloud, cube, filled, fog, volume
from helpers.scenes import refusal as refused

import tofrender
from tofrender.scenes.media import media_of


def box(medium: dict | None = None, **parts: dict) -> dict:
    """The Cornell box, 8 x 8 pixels, seen through a medium."""
    scene = tofrender.cornell_box(width=8, height=8, temporal_bins=120, bin_width_opl=0.25)
    if medium is not None:
        scene["sensor"]["medium"] = medium
    return scene | parts


def refusal(scene: dict, **options) -> str:
    return refused(tofrender.render, scene, spp=1, **options)


def smoke(value: float) -> dict:
    """A grid with an entry of this density."""
    density = np.ones((2, 2, 2, 1))
    density[1, 0, 1] = value
    return cloud(1.0) | {"sigma_t": volume(density, (-1, -1, -1), 2)}


BLEND = {"type": "blendphase", "weight": 1.5, "a": {"type": "isotropic"}, "b": {"type": "rayleigh"}}


@pytest.mark.parametrize(
    ("parts", "names"),
    [
        *(
            ({"medium": fog(0.2, 0.9) | {name: value}}, [name, "must be"])
            for name, values in {
                "sigma_t": (-1.0, math.nan),
                "scale": (-2.0,),
                "albedo": (1.2, -0.1, {"type": "rgb", "value": [0.5, math.nan, 0.5]}),
            }.items()
            for value in values
        ),
        ({"smoke": filled(cube(0.5), smoke(-3.0))}, ["sigma_t.data", "-3"]),
        ({"medium": fog(0.2, 0.9, phase=BLEND)}, ["weight"]),
    ],
)
def test_coefficients_and_grids(parts, names):
    text = refusal(box(**parts))
    for name in names:
        assert name in text


@pytest.mark.parametrize("sides", [("interior",), ("exterior",), ("interior", "exterior")])
def test_media_on_each_side_of_a_shape_are_found(sides):
    media = {side: fog(1.0 + k, 0.9) for k, side in enumerate(sides)}
    loaded = mi.load_dict({"type": "scene", "ball": {"type": "sphere", **media}})
    assert len(media_of(loaded)) == len(sides)


def test_a_sensor_that_does_not_know_its_medium():
    """It stands in a room full of fog, or says that it does."""
    room = filled(cube(20.0), fog(0.1, 0.9))
    assert "sensor.medium" in refusal(box(room=room))
    assert "sensor.medium" in refusal(box(fog(0.3, 0.9), room=room))
    tofrender.render(box(fog(0.1, 0.9), room=room), spp=1, window="auto")


def test_milk_in_a_glass_that_does_not_know_the_fog_around_it():
    glass = {"type": "sphere", "radius": 0.3, "bsdf": {"type": "dielectric"}}
    glass["interior"] = fog(3.0, 0.9)
    text = refusal(box(fog(0.1, 0.9), glass=glass))
    assert "glass" in text
    knows = box(fog(0.1, 0.9), glass=glass | {"exterior": fog(0.1, 0.9)})
    tofrender.render(knows, spp=1, window="auto")


def test_fog_without_end_under_a_sky():
    """No light would come through; where the fog ends, it does."""
    sky = {"type": "constant", "radiance": 0.1}
    assert "unbounded" in refusal(box(fog(0.1, 0.9), sky=sky))
    ends = box(fog(0.1, 0.9), sky=sky, room=filled(cube(20.0), fog(0.1, 0.9)))
    tofrender.render(ends, spp=1, window="auto")


@pytest.mark.parametrize(
    "integrator", [{"type": "simple", "position": [0, 0.5, 0], "energy": 1.0}, {"type": "ao"}]
)
def test_integrators_that_do_not_follow_media(integrator):
    text = refusal(box(fog(0.1, 0.9)) | {"integrator": integrator})
    assert "medium" in text
    assert "does not support" in text


def test_great_depths_are_right():
    """Behind an optical depth of 200 it is dark, and nothing is lost or not finite."""
    wall = filled(cube((0.5, 1.0, 0.1), (-0.5, 0, 0.5)), fog(1000.0, 0.0))
    result = tofrender.render(box(wall=wall), spp=4, window="auto")
    assert result.attrs["contributions_not_finite"] == 0
    assert float(result["steady"][4, 2].sum()) == 0
    assert float(result["steady"][4, 6].sum()) > 0


@pytest.mark.parametrize("name", ["volpath", "volpathmis", "prbvolpath", "transient_prbvolpath"])
def test_scenes_of_others_as_they_are(name):
    """Their integrators become `transient_volpath`, with the depth that they had."""
    scene = box(fog(0.1, 0.9)) | {"integrator": {"type": name, "max_depth": 3}}
    if name != "transient_prbvolpath":
        scene["sensor"]["film"] = {"type": "hdrfilm", "width": 8, "height": 8}
    result = tofrender.render(scene, spp=4, bins=30, window="auto")
    assert result.attrs["integrator"] == "TransientVolpath"
    assert result.attrs["max_depth"] == 3
    assert float(result["steady"].sum()) > 0
    assert mi.load_dict({"type": "transient_volpath"}).max_depth == -1  # No limit of its own


@pytest.mark.parametrize("kind", ["transient_light_tracer", "transient_bdpt"])
def test_a_blend_with_flakes_for_paths_from_lights(kind):
    smoke = fog(0.2, 0.9, phase=TWO_LOBES | {"a": FLAKES}, id="smoke")
    text = refusal(box(smoke), integrator={"type": kind})
    assert text.startswith("smoke.phase = blendphase: sggx ")
