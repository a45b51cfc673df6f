"""One table of settings: `render`, the command, their documentation and bad values follow it."""

import functools
import inspect
import re
from dataclasses import fields

import mitsuba as mi
import numpy as np
import pytest
import xarray as xr
from helpers.bad_inputs import bad, kind_of_setting, one_clear_line
from helpers.films_in_parts import ROOT, box, check_same
from helpers.refusals import refused
from hypothesis import given, strategies as st

import tofrender
from tofrender import cornell_box, cornell_box_steady_state, render
from tofrender.cli.render import render as command
from tofrender.rendering.renderer import make_job
from tofrender.rendering.settings import SCENE_NAMES, SETTINGS, Execution, RenderSettings
from tofrender.runtime.settings import CHECKS, unchecked

RECORD = {field.name: field.default for field in fields(RenderSettings)}

FILES = {"format", "precision", "video", "figure", "dpi", "as_json"}
"""What becomes of the files: in Python, `save_exr_stack` and others are told."""

FRAMES = {"frames", "frame_time", "exposure", "poses", "row_time"}
"""An animation: in Python, `render_frames` is told."""

OBJECTS = {"client", "settings", "progress"}
"""What a command cannot be given, and what `--no-progress` is for in all commands."""

OTHERS = {"resume", "checkpoint", "out", "client"}
"""Arguments of `render` that are files or objects."""


def test_render_has_the_settings_of_the_table():
    parameters = inspect.signature(render).parameters
    assert set(parameters) == set(SETTINGS) | OTHERS
    for name, default in RECORD.items():
        assert name == "scene" or parameters[name].default == default
    for name in set(parameters) - set(RECORD):
        assert parameters[name].default is (True if name == "progress" else None)


def test_the_command_has_the_settings_of_the_table():
    ours, its = (inspect.signature(each).parameters for each in (render, command))
    assert set(its) - set(ours) == FILES | FRAMES | {"variant"}  # In Python, `mitsuba.set_variant`
    assert set(ours) - set(its) == OBJECTS
    for name in set(SETTINGS) & set(its):
        assert its[name].default == ours[name].default


@pytest.mark.parametrize(
    ("given", "similar"), [("ssp", "spp"), ("denose", "denoise"), ("worker", "workers")]
)
def test_a_misspelled_parameter_is_refused_with_the_nearest_name(given, similar):
    with pytest.raises(TypeError, match=rf"^render\(\) .*'{given}'.*'{similar}'\?$"):
        render("cornell_box", **{given: 4})


def test_parameters_are_bound_as_in_a_signature():
    with pytest.raises(TypeError, match=r"^render\(\) missing .*'scene'$"):
        render(spp=4)
    with pytest.raises(TypeError, match=r"^render\(\) too many positional arguments$"):
        render("cornell_box", 4)
    with pytest.raises(
        TypeError, match=r"^render\(\) got an unexpected keyword argument 'zzzz'\. Use "
    ):
        render("cornell_box", zzzz=4)


def test_execution_is_no_setting_of_the_picture():
    names = {field.name for field in fields(Execution)}
    assert names == {"out", "checkpoint", "resume", "workers", "scheduler", "client", "progress"}
    assert not names & set(RECORD)


def test_the_documentation_says_what_the_table_does():
    entries = inspect.getdoc(render).partition("Args:\n")[2].partition("\nReturns:")[0]
    texts = dict(re.findall(r"^    (\w+): ((?:.*\n)(?:     .*\n)*)", entries, re.MULTILINE))
    assert list(texts) == list(inspect.signature(render).parameters)
    for name, setting in SETTINGS.items():
        assert " ".join(texts[name].split()).startswith(setting.help), name


@pytest.mark.parametrize("name", [n for n, s in SETTINGS.items() if s.check is not unchecked])
def test_bad_values_are_refused(name):
    check = SETTINGS[name].check
    for label, value in bad(kind_of_setting(SETTINGS[name])):
        if value is not None:
            with pytest.raises(ValueError, match=" ") as error:
                check(name, value)
            assert not one_clear_line(error.value, name, value), label


@pytest.mark.parametrize("name", [n for n, each in SETTINGS.items() if each.high is not None])
@given(value=st.integers(-(2**40), 2**40))
def test_ranges(name, value):
    setting, wanted = SETTINGS[name], (value, 1) if name == "size" else value
    if setting.low <= value <= setting.high and (name, value) != ("max_depth", 0):
        setting.check(name, wanted)
    else:
        with pytest.raises(ValueError, match=rf"{name} = {value}: must be "):
            setting.check(name, wanted)


NUMBERS = st.integers(-10, 2**26) | st.floats() | st.sampled_from(["auto", "x", None, True])


@given(value=NUMBERS)
def test_scenes_and_renders_have_the_same_ranges(value):
    for name, scene_name in (SCENE_NAMES | {"spp": "spp"}).items():
        if scene_name in CHECKS and value != "auto":
            assert accepts(SETTINGS[name].check, value) == accepts(CHECKS[scene_name], value)


def accepts(check, value) -> bool:
    try:
        check("x", value)
    except ValueError:
        return False
    return True


def test_words_and_settings_ask_for_the_same():
    words = {"size": (8, 6), "bins": 50, "bin_width": 0.25, "max_depth": 3, "pulse_width": 0.1}
    one = render("cornell_box", spp=4, start_opl=3.0, **words)
    settings = {
        **{"width": 8, "height": 6, "temporal_bins": 50, "bin_width_opl": 0.25},
        **{"max_depth": 3, "pulse_width_opl": 0.1, "start_opl": 3.0},
    }
    other = render("cornell_box", spp=4, settings=settings)
    check_same(one, other)
    assert one.transient.shape == (6, 8, 50, 3)
    assert one.attrs["pulse"] == "GaussianPulse(width_opl=0.1)"
    assert (one.attrs["max_depth"], one.attrs["scene"]) == (3, "cornell_box")


def test_a_loaded_scene_takes_another_time_axis():
    dataset = render(loaded(), spp=1, bins=20, start_opl=3.0, bin_width=0.6)
    np.testing.assert_allclose(dataset.opl, 3.0 + (np.arange(20) + 0.5) * 0.6)


@functools.cache
def loaded():
    return tofrender.load_scene(box())


PATH = {"type": "transient_path"}
LOADED = "must be left out with a loaded scene"


@pytest.mark.parametrize(
    ("scene", "options", "text"),
    [
        (loaded, {"size": (4, 4)}, f"size = (4, 4): {LOADED}"),
        (loaded, {"pulse_width": 0.1}, f"pulse_width = 0.1: {LOADED}"),
        (loaded, {"max_depth": 3}, f"max_depth = 3: {LOADED}"),
        (loaded, {"define": {"a": 1}}, f"define = {{'a': 1}}: {LOADED}"),
        (box, {"window": "auto", "start_opl": 3}, "start_opl = 3: must be left out with `window`"),
        (box, {"window": "auto", "bin_width": 3}, "bin_width = 3: must be left out with `window`"),
        (box, {"workers": 2, "scheduler": "127.0.0.1:8786"}, "scheduler: must be left out with `w"),
        (box, {"workers": 2, "resume": xr.Dataset()}, "resume: must be left out"),
        (box, {"bins": 3, "settings": {"temporal_bins": 4}}, "bins: must be left out, settings ha"),
        (
            box,
            {"size": (4, 4), "settings": {"height": 4}},
            "size: must be left out, settings has h",
        ),
        (box, {"window": (3, 9), "settings": {"start_opl": 1.0}}, "window: must be left out, set"),
        (
            box,
            {"max_depth": 2, "integrator": mi.load_dict(PATH)},
            "max_depth = 2: must be left out",
        ),
        (loaded, {"integrator": "path"}, "integrator = 'path': must be"),
    ],
)
def test_what_does_not_go_together(scene, options, text):
    with refused(re.escape(text)):
        render(scene(), **options)


def test_steady_scenes_turn_transient():
    steady = cornell_box_steady_state(width=8, height=8)
    axis = {"bins": 30, "start_opl": 3.5, "bin_width": 1.0}
    one = render(steady, spp=4, **axis)
    check_same(one, render(steady, spp=4, bins=30, window=(3.5, 33.5)))
    assert one.attrs["integrator"] == "TransientPath"
    assert one.transient.shape == (8, 8, 30, 3)
    assert float(one.transient.sum() / one.steady.sum()) == pytest.approx(1, abs=1e-4)
    found = render(steady, spp=4, bins=30, window="auto")
    assert 3.5 < found.attrs["start_opl"] < 4.0


def test_an_xml_file_has_parameters():
    file = ROOT / "scenes" / "cornell_box.xml"
    dataset = render(file, spp=1, size=(4, 4), define={"max_depth": 2})
    assert dataset.attrs["max_depth"] == 2


def test_workers_here():
    scene = cornell_box(width=8, height=8, temporal_bins=40, bin_width_opl=0.3)
    both = [
        render(scene, spp=4, max_depth=4, size=(6, 6), workers=workers) for workers in (None, 2)
    ]
    np.testing.assert_allclose(both[0].transient, both[1].transient, rtol=1e-4, atol=1e-6)


def test_what_workers_are_told_makes_the_same_job():
    settings = RenderSettings(box(), spp=8, bins=30, window="auto", size=(6, 5))
    job = make_job(settings)
    make, words = job.origin
    again = make(axis=(30, 3.5, 0.4), **words)
    assert again.settings.values == settings.values
    assert again.film.shape == job.film.shape == (5, 6, 30, 3)
    assert again.recipe["fingerprint"] == job.recipe["fingerprint"]
