"""One language: what the command can be asked, `render` can be asked with the same words."""

from __future__ import annotations

import inspect
import re

import numpy as np
import pytest
from helpers.films_in_parts import ROOT, box, check_same

import tofrender
from tofrender import cornell_box, cornell_box_steady_state, render
from tofrender.cli.render import render as command
from tofrender.rendering.asked import Asked
from tofrender.rendering.renderer import make_job

FILES = {"format", "precision", "video", "figure", "dpi", "as_json"}
"""What becomes of the files: in Python, `save_exr_stack` and others are told."""

THE_APPLICATIONS = {"variant"}
"""In Python, `mitsuba.set_variant`."""

OTHER_KINDS = {"out", "checkpoint", "resume"}
"""A folder, seconds and a switch here; a film on disk, a file and a Dataset there."""

OBJECTS = {"client", "params", "settings", "temporal_bins"}
"""What a command cannot be given, and old names."""


def test_the_command_and_render_have_the_same_words():
    ours, its = (set(inspect.signature(each).parameters) for each in (render, command))
    assert its - ours == FILES | THE_APPLICATIONS
    assert ours - its == OBJECTS
    assert set(inspect.signature(Asked).parameters) <= ours
    assert ours - set(inspect.signature(Asked).parameters) == {
        *("resume", "checkpoint", "out", "workers", "scheduler", "client", "progress"),
        *("params", "temporal_bins"),
    }


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
    assert one.attrs["max_depth"] == 3


def test_the_old_name_of_bins():
    one, other = (
        render(box(), spp=4, window=(3.5, 15.0), **{name: 7}) for name in ("bins", "temporal_bins")
    )
    check_same(one, other)
    with pytest.raises(ValueError, match="temporal_bins = 7: must be left out with `bins`"):
        render(box(), bins=8, temporal_bins=7)


def test_a_loaded_scene_takes_another_time_axis():
    scene = tofrender.load_scene(box())
    dataset = render(scene, spp=1, bins=20, start_opl=3.0, bin_width=0.6)
    np.testing.assert_allclose(dataset.opl, 3.0 + (np.arange(20) + 0.5) * 0.6)


@pytest.mark.parametrize(
    ("name", "value"),
    [("size", (4, 4)), ("pulse_width", 0.1), ("max_depth", 3), ("define", {"a": 1})],
)
def test_a_loaded_scene_cannot_be_changed(name, value):
    scene = tofrender.load_scene(box())
    message = re.escape(f"{name} = {value!r}: must be left out with a loaded scene")
    with pytest.raises(ValueError, match=message):
        render(scene, **{name: value})


@pytest.mark.parametrize("name", ["start_opl", "bin_width"])
def test_a_window_leaves_nothing_to_say_of_its_bins(name):
    with pytest.raises(ValueError, match=f"{name} = 3: must be left out with `window`"):
        render(box(), window="auto", **{name: 3})


def test_two_ways_to_ask_for_workers():
    with pytest.raises(ValueError, match="scheduler: must be left out with `workers`"):
        render(box(), workers=2, scheduler="127.0.0.1:8786")
    with pytest.raises(ValueError, match="resume: must be left out"):
        render(box(), workers=2, resume=render(box(), spp=1))


def test_a_word_and_its_setting():
    with pytest.raises(ValueError, match="bins: must be left out, settings has temporal_bins"):
        Asked("cornell_box", bins=3, settings={"temporal_bins": 4})


def test_steady_scenes_turn_transient():
    steady = cornell_box_steady_state(width=8, height=8)
    axis = {"bins": 30, "start_opl": 3.5, "bin_width": 1.0}
    one = render(steady, spp=4, **axis)
    check_same(one, render(steady, spp=4, bins=30, window=(3.5, 33.5)))
    assert one.attrs["integrator"] == "TransientPath"


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
    asked = Asked(box(), spp=8, bins=30, window="auto", size=(6, 5))
    job = make_job(asked)
    make, words = job.origin
    again = make(axis=(30, 3.5, 0.4), **words)
    assert again.asked.words == asked.words
    assert again.film.shape == job.film.shape == (5, 6, 30, 3)
    assert again.recipe["fingerprint"] == job.recipe["fingerprint"]
