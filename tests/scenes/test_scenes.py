"""The built-in scenes: parameters, arguments, the XML twin, every variant."""

from __future__ import annotations

import importlib
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from helpers.support import parsed, require_equal

import tofrender  # noqa: F401  (picks the variant, registers the plugins)
from tofrender.scenes import (
    BUILT_IN,
    START_OPL,
    cornell_box,
    cornell_box_flash,
    cornell_box_glass,
    cornell_box_mirror,
    cornell_box_steady_state,
    describe,
)

CORNELL_BOXES = [name for name in BUILT_IN if name.startswith("cornell")]
ROOT = Path(__file__).parents[2]
XML = ROOT / "scenes" / "cornell_box.xml"


def test_facts():
    scene = cornell_box()
    film, sensor = scene["sensor"]["film"], scene["sensor"]
    assert (film["width"], film["height"], film["temporal_bins"]) == (256, 256, 300)
    assert (film["start_opl"], film["bin_width_opl"]) == (3.5, 0.02)
    assert (sensor["fov"], sensor["near_clip"], sensor["far_clip"]) == (39.3077, 0.001, 100.0)
    assert scene["integrator"] == {"type": "transient_path", "max_depth": 8}
    corner = np.array(scene["light"]["to_world"].matrix) @ [1, 1, 0, 1]
    np.testing.assert_allclose(corner[:3], [0.23, 0.99, 0.2], atol=1e-6)
    down = np.array(scene["light"]["to_world"].matrix) @ [0, 0, 1, 0]
    assert down[1] < 0


@pytest.mark.parametrize(
    ("wall", "position", "inwards"),
    [
        ("floor", [0, -1, 0], [0, 1, 0]),
        ("ceiling", [0, 1, 0], [0, -1, 0]),
        ("back", [0, 0, -1], [0, 0, 1]),
        ("green-wall", [1, 0, 0], [-1, 0, 0]),
        ("red-wall", [-1, 0, 0], [1, 0, 0]),
    ],
)
def test_walls_face_in(wall, position, inwards):
    matrix = np.array(cornell_box()[wall]["to_world"].matrix)
    np.testing.assert_allclose(matrix[:3, 3], position, atol=1e-6)
    np.testing.assert_allclose(matrix[:3, 2], inwards, atol=1e-6)


def test_same_picture_as_mitsubas_own_cornell_box():
    reference = mi.cornell_box()
    ours = cornell_box_steady_state(width=24, height=24)
    reference["sensor"]["film"] = ours["sensor"]["film"]
    reference["sensor"]["sampler"] = ours["sensor"]["sampler"]
    pictures = [np.array(mi.render(mi.load_dict(s), spp=16, seed=1)) for s in (ours, reference)]
    np.testing.assert_allclose(*pictures, rtol=1e-3, atol=1e-4)


def test_xml_is_the_dict():
    require_equal(parsed(XML), parsed(cornell_box()))


def test_root_package_hands_the_builders_on(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    scenes = importlib.import_module("scenes")
    assert scenes.cornell_box is cornell_box
    assert set(scenes.__all__) == set(BUILT_IN)


@pytest.mark.parametrize("name", CORNELL_BOXES)
def test_every_box_loads(name):
    scene = mi.load_dict(BUILT_IN[name](width=8, height=8, spp=1))
    assert len(scene.emitters()) == 1


@pytest.mark.parametrize("name", BUILT_IN)
def test_every_scene_is_described(name):
    assert 20 < len(describe(name)) < 90


@pytest.mark.parametrize("variant", ["llvm_ad_mono", "llvm_ad_spectral", "llvm_ad_rgb"])
def test_every_box_loads_under_other_variants(variant):
    before = mi.variant()
    try:
        mi.set_variant(variant)
        for name in CORNELL_BOXES:
            assert mi.load_dict(BUILT_IN[name](width=8, height=8)).emitters()
    finally:
        mi.set_variant(before)


def test_variants_of_the_box():
    assert cornell_box_mirror()["red-wall"]["bsdf"]["type"] == "conductor"
    glass = cornell_box_glass(width=8)
    assert "small-box" not in glass
    sphere = glass["glass-sphere"]
    assert sphere["center"][1] - sphere["radius"] == pytest.approx(-1)  # stands on the floor
    assert sphere["bsdf"]["int_ior"] == 1.5


def test_flash_stands_at_the_camera_and_its_window_starts_in_time():
    flash = cornell_box_flash()
    camera = np.array(flash["sensor"]["to_world"].matrix)[:3, 3]
    np.testing.assert_allclose(flash["light"]["position"], camera)
    assert flash["sensor"]["film"]["start_opl"] == START_OPL["flash"]
    assert cornell_box_flash(start_opl=1.0)["sensor"]["film"]["start_opl"] == 1.0
    nearest = np.linalg.norm(camera - [1, 0, 1])  # the middle of a side wall's front edge
    assert 0 < 2 * nearest - START_OPL["flash"] < 0.2


def test_flash_and_ceiling_light_are_about_equally_bright():
    def median(builder):
        scene = builder(width=24, height=24)
        film = scene["sensor"]["film"] | {"type": "hdrfilm"}
        for key in ("temporal_bins", "start_opl", "bin_width_opl"):
            del film[key]
        scene["sensor"]["film"], scene["integrator"] = film, {"type": "path", "max_depth": 8}
        return np.median(np.array(mi.render(mi.load_dict(scene), spp=64)))

    assert 0.6 < median(cornell_box_flash) / median(cornell_box) < 1.6


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"width": 0}, "width = 0: must be an integer from 1 to 65536"),
        ({"height": -1}, "height = -1: must be an integer"),
        ({"temporal_bins": 2.5}, "temporal_bins = 2.5: must be an integer"),
        ({"temporal_bins": "300"}, "temporal_bins = '300': must be an integer"),
        ({"bin_width_opl": float("nan")}, "bin_width_opl = nan: must be a finite number"),
        ({"start_opl": float("-inf")}, "start_opl = -inf: must be a finite number"),
        ({"spp": 0}, "spp = 0: must be an integer from 1 to 16777216"),
        ({"max_depth": 0}, r"max_depth = 0: must be -1 \(no limit\) or an integer"),
        ({"light": "flsh"}, "light = 'flsh': did you mean 'flash'?"),
        ({"light": None}, "light = None: must be one of area, flash"),
        ({"light": ["area"]}, r"light = \['area'\]: must be one of"),
    ],
)
@pytest.mark.parametrize("builder", [cornell_box, cornell_box_glass])
def test_bad_arguments_are_one_line(builder, arguments, text):
    with pytest.raises(ValueError, match=text) as error:
        builder(**arguments)
    assert "\n" not in str(error.value)
