"""A scene's steady integrator gives way to one in time, and what is said of depth stays."""

import warnings

import mitsuba as mi
import numpy as np
import pytest
from helpers.parts import area_light, diffuse
from helpers.scenes import refusal as refused
from helpers.support import film

import tofrender
from tofrender.scenes import cornell_box_steady_state
from tofrender.scenes.loading import load_scene

WINDOW = {"temporal_bins": 7, "start_opl": 4.0, "bin_width_opl": 0.5}
DEPTHS = {"max_depth": 3, "rr_depth": 7, "hide_emitters": True}
WRAPPERS = {"moment": "moments", "stokes": "Stokes vectors", "aov": "AOVs"}
OTHERS = ("prb", "direct", "ptracer", "depth")
QUIET = pytest.mark.filterwarnings("ignore:integrator = '.* replaced by")


def box(integrator: dict) -> dict:
    return cornell_box_steady_state(width=2, height=2, spp=1) | {"integrator": integrator}


def around(name: str, inner: dict) -> dict:
    more = {"aovs": "dd:depth"} if name == "aov" else {}
    return {"type": name, "inner": inner, **more}


def depths(scene: mi.Scene) -> dict:
    integrator = scene.integrator()
    assert type(integrator).__name__ == "TransientPath"
    return {name: getattr(integrator, name) for name in DEPTHS}


def refusal(source, **options) -> str:
    return refused(load_scene, source, **options)


def white_box(integrator: dict) -> dict:
    """Walls that glow with 1 and reflect 0.8: everybody sees 1 / (1 - 0.8) everywhere."""
    walls = {"type": "cube", "flip_normals": True, "bsdf": diffuse(0.8), "glow": area_light(1.0)}
    steady = {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}}
    sensor = {"type": "perspective", "film": steady}
    return {"type": "scene", "integrator": integrator, "sensor": sensor, "walls": walls}


@QUIET
@pytest.mark.parametrize("wrapper", [None, "aov"])
def test_a_closed_white_box_is_as_bright_as_mitsubas(wrapper):
    """Six segments would leave 0.74 of the light."""
    path = {"type": "path"}
    expected = np.array(mi.render(mi.load_dict(white_box(path)), spp=256)).mean()
    described = white_box(around(wrapper, path) if wrapper else path)
    ours = tofrender.render(described, window=(0, 400), bins=4, spp=256, progress=False)
    assert expected == pytest.approx(5, rel=0.02)
    assert float(ours.steady.mean()) == pytest.approx(5, rel=0.02)
    assert float(ours.transient.sum("opl").mean()) == pytest.approx(5, rel=0.02)
    assert ours.attrs["max_depth"] == -1


def test_a_film_keeps_its_size_its_crop_and_its_border():
    crop = {"crop_offset_x": 2, "crop_offset_y": 1, "crop_width": 5, "crop_height": 4}
    size = {"width": 9, "height": 7, "sample_border": True}
    described = box({"type": "path"})
    described["sensor"] = described["sensor"] | {"film": {"type": "hdrfilm", **size, **crop}}
    found = load_scene(described, **WINDOW).sensors()[0].film()
    assert found.shape == (4, 5, WINDOW["temporal_bins"], 3)
    assert (list(found.size()), list(found.crop_offset())) == ([9, 7], [2, 1])
    assert found.sample_border()


@pytest.mark.parametrize("name", ["path", "volpath", "volpathmis", "ptracer"])
def test_paths_without_a_limit_stay_so(name):
    for options in (WINDOW, {}) if name == "path" else ({},):
        changed = options or {"integrator": "transient_path"}
        scene = load_scene(box({"type": name, "hide_emitters": True}), **changed)
        assert depths(scene) == {"max_depth": -1, "rr_depth": 5, "hide_emitters": True}
        assert depths(load_scene(box({"type": name, **DEPTHS}), **changed)) == DEPTHS
    described = box({"type": "transient_path"})  # It has a default of its own
    described["sensor"] = described["sensor"] | {"film": film(2, 2)}
    assert depths(load_scene(described))["max_depth"] == 6


@pytest.mark.parametrize("name", WRAPPERS)
def test_a_path_is_taken_out_of_what_is_around_it(name):
    described = box(around(name, {"type": "path", **DEPTHS}))
    for options in (WINDOW, {"integrator": "transient_path"}, WINDOW | {"max_depth": 9}):
        with pytest.warns(UserWarning, match=f"integrator = '{name}': ") as warned:
            scene = load_scene(described, **options)
        assert len(warned) == 1
        assert "'transient_path'" in str(warned[0].message)
        assert WRAPPERS[name] in str(warned[0].message)
        assert warned[0].filename == __file__
        assert depths(scene) == DEPTHS | {k: v for k, v in options.items() if k == "max_depth"}


@QUIET
def test_integrators_in_time_are_taken_out_as_they_are():
    inner = {"type": "transient_path", "max_depth": 4, "camera_unwarp": True}
    scene = load_scene(box(around("aov", around("moment", inner))), **WINDOW)
    assert depths(scene)["max_depth"] == 4
    assert scene.integrator().camera_unwarp


def test_nothing_is_taken_out_of_a_steady_scene():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene = load_scene(box(around("aov", {"type": "path"})), width=4, max_depth=3)
    assert scene.integrator().class_name() == "AOVIntegrator"
    assert "max_depth = 3" in str(scene.integrator())


@pytest.mark.parametrize("name", OTHERS)
def test_others_are_refused_by_name(name):
    for integrator in ({"type": name}, around("aov", {"type": name})):
        assert refusal(box(integrator), **WINDOW).startswith(f"integrator = '{name}': ")
    two = around("aov", {"type": "path"}) | {"second": {"type": "path"}}
    assert refusal(box(two), **WINDOW).startswith("integrator = 'aov'")


def in_a_file(integrator: str, folder) -> str:
    nested = '<integrator type="path"><integer name="max_depth" value="3"/></integrator>'
    inner = nested if integrator in WRAPPERS else ""
    inner += '<string name="aovs" value="dd:depth"/>' if integrator == "aov" else ""
    size = '<integer name="width" value="2"/><integer name="height" value="2"/>'
    light = '<emitter type="area"><rgb name="radiance" value="1 1 1"/></emitter>'
    path = folder / f"{integrator}.xml"
    path.write_text(
        f"""<scene version="3.0.0"><integrator type="{integrator}">{inner}</integrator>
        <sensor type="perspective"><film type="hdrfilm">{size}</film></sensor>
        <shape type="cube"><boolean name="flip_normals" value="true"/>{light}</shape></scene>"""
    )
    return str(path)


@QUIET
@pytest.mark.parametrize("name", [*WRAPPERS, *OTHERS])
def test_an_override_renders_any_file(name, tmp_path):
    options = {"window": (0, 40), "bins": 2, "spp": 1, "progress": False}
    path = in_a_file(name, tmp_path)
    by_name = tofrender.render(path, integrator="transient_path", **options)
    assert by_name.attrs["integrator"] == "TransientPath"
    assert float(by_name.steady.min()) > 0
    if name in WRAPPERS:
        assert by_name.attrs["max_depth"] == 3
    override = {"type": "path_tracer_mis", "max_depth": 2}
    by_dict = tofrender.render(path, integrator=override, **options)
    assert (by_dict.attrs["integrator"], by_dict.attrs["max_depth"]) == ("PathTracerMIS", 2)
    ready = mi.load_dict({"type": "transient_path", "max_depth": 5})
    assert tofrender.render(path, integrator=ready, **options).attrs["max_depth"] == 5


@QUIET
def test_a_dict_says_what_changes():
    described = box(around("aov", {"type": "path", **DEPTHS}))
    given = {"type": "transient_path", "max_depth": 5, "camera_unwarp": True}
    scene = load_scene(described, integrator=given, **WINDOW)
    assert depths(scene) == DEPTHS | {"max_depth": 5}
    assert scene.integrator().camera_unwarp
    assert given == {"type": "transient_path", "max_depth": 5, "camera_unwarp": True}
    projector = {"type": "confocal_projector", "grid_intensity": 3.0}
    confocal = {"type": "confocal_transient_path", "confocal_projector": projector}
    assert load_scene(described, integrator=confocal).integrator().projector.power == [3, 3, 3]
    said = refusal(described, integrator={"type": "transient_path", "max_dept": 5})
    assert "max_dept" in said
    said = refusal(described, integrator={"max_depth": 5})
    assert said == "integrator = {'max_depth': 5}: must have a plugin's name as its type"


def test_an_override_takes_the_place_of_an_object_and_of_an_unknown_plugin():
    ready = mi.load_dict({"type": "path"})
    scene = load_scene(box({}) | {"integrator": ready}, integrator="transient_path")
    assert depths(scene)["max_depth"] == 6  # What an object was made with, nobody can ask
    none = {name: part for name, part in box({}).items() if name != "integrator"}
    assert depths(load_scene(none, integrator="transient_path"))["max_depth"] == 6
    assert depths(load_scene(none, **WINDOW))["max_depth"] == -1  # As Mitsuba renders it
    mi.register_integrator("own", lambda props: mi.load_dict({"type": "path"}))
    assert depths(load_scene(box({"type": "own"}), integrator="transient_path"))
