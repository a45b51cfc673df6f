"""What paths from lights cannot do: refused before work starts, in one line."""

import re
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from helpers.light_paths import BDPT, LIGHT_TRACER, TRACERS, by, floor, lamp
from helpers.parts import translate
from helpers.scenes import refusal
from helpers.support import camera, film, load, refused, scene

import tofrender
from tofrender.scenes.fingerprint import fingerprint

NAN = float("nan")


def described(technique: str = LIGHT_TRACER, parts: dict | None = None, **sensor: Any) -> dict:
    lit = floor() | lamp((0.3, 0, 2)) if parts is None else parts
    kind = {"kind": "perspective"} | sensor
    eye = camera((0, 0, 1.5), (0, 0, 0), film(4, 4, bins=50), **kind)
    return scene(lit, eye) | {"integrator": by(technique)}


def render(loaded: mi.Scene) -> Any:
    """As `mi.render` does, which would hide what is raised in a longer message."""
    return loaded.integrator().render(loaded, spp=1)


BOTH = [
    *[("max_depth", value) for value in (1, 0, -2)],
    ("rr_depth", 0),
    ("camera_unwarp", 1),
    ("pulse_width_opl", NAN),
]
"""What is bad for other integrators, too, is in `test_plugins.py`."""
OWN = [
    *[("max_depth", value) for value in (-1, 65, 1 << 20)],
    ("camera_connections", "no"),
    *[("mis", value) for value in ("none", "best", "", 2)],
    *[("strategy", text) for text in ("0,1", "1,0", "0,0", "3,0", "-1,3", "2,-1")],
    *[("strategy", text) for text in ("2", "2,", "a,b", "2,2,2", "2.0,1", "s,t")],
    *[("strategy", text) for text in ("4,4", "0,8", "7,1")],  # 7 segments and more
    ("strategy", 21),
]


@pytest.mark.parametrize(
    ("plugin", "name", "value"),
    [*[(plugin, *each) for plugin in TRACERS for each in BOTH], *[(BDPT, *each) for each in OWN]],
)
def test_bad_parameter(plugin, name, value):
    with_value = described() | {"integrator": {"type": plugin, name: value}}
    text = refusal(tofrender.load_scene, with_value, kind=(ValueError, TypeError))
    assert name in text
    assert str(value) in text
    assert "must" in text


@pytest.mark.parametrize(("name", "value"), [("strategy", "1,2"), ("mis", "power"), ("no", 1)])
def test_unknown_parameter(name, value):
    """The light tracer has one strategy for each length, and no weights."""
    with_value = described() | {"integrator": {"type": LIGHT_TRACER, name: value}}
    refused(name, tofrender.load_scene, with_value)


@pytest.mark.parametrize(
    "integrator",
    [
        {"type": LIGHT_TRACER},
        {"type": LIGHT_TRACER, "max_depth": -1},
        {"type": LIGHT_TRACER, "max_depth": 1000, "rr_depth": 3, "hide_emitters": True},
        {"type": BDPT, "max_depth": 2},
        {"type": BDPT, "max_depth": 64, "mis": "balance", "camera_connections": False},
        {"type": BDPT, "strategy": "", "mis": "power"},
        {"type": BDPT, "strategy": "0,2", "mis": "none"},
        {"type": BDPT, "strategy": "6,1", "mis": "power"},
        {"type": BDPT, "strategy": "0,7", "mis": "balance"},
    ],
)
def test_what_is_allowed(integrator):
    loaded = mi.load_dict(integrator, parallel=False)
    assert loaded.max_depth == integrator.get("max_depth", 6)
    assert loaded.rr_depth == integrator.get("rr_depth", 5)
    assert (loaded.camera_unwarp, loaded.discard_direct_light, loaded.pulse) == (False, False, None)


def test_a_scenes_unlimited_depth_is_not_taken_over():
    """The scene's own integrator has no bound, and this one must have one."""
    endless = described() | {"integrator": {"type": "transient_path", "max_depth": -1}}
    refused("max_depth = -1", tofrender.render, endless, integrator=BDPT, spp=1, progress=False)


TWO = {name: {"type": "perspective", "film": film(1, 1, bins=50)} for name in ("one", "two")}
METERS = {
    "orthographic": camera((0, 0, 1.5), (0, 0, 0), film(bins=50), kind="orthographic"),
    "radiancemeter": {"origin": [0, 0, 1.5], "direction": [0, 0, -1], "film": film(bins=50)},
    "distant": {"direction": [0, 0, -1], "film": film(bins=50)},
    "batch": TWO | {"film": film(2, 1, bins=50)},
}
"""Sensors that nothing can be joined to."""


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize("technique", [LIGHT_TRACER, BDPT, "0,3"])
@pytest.mark.parametrize("kind", METERS)
def test_sensors_that_are_no_camera(kind, technique):
    loaded = load(described(technique) | {"sensor": METERS[kind] | {"type": kind}})
    text = refusal(render, loaded)
    assert {"sensor", "perspective"} <= set(re.findall(r"\w+", text))
    assert "thinlens" in text or kind == "batch"
    refused("sensor", tofrender.render, loaded, spp=1, progress=False)


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize("technique", [LIGHT_TRACER, BDPT, "1,2"])
def test_scenes_without_light(technique):
    dark = load(described(technique, floor()))
    gated, sensor = mi.load_dict(by(technique, pulse_width_opl=0.1)), dark.sensors()[0]
    refused("light|emitter", render, dark)
    refused("light|emitter", tofrender.render, dark, spp=1, progress=False)
    refused("light|emitter", tofrender.render_at_time, dark, gated, sensor, 3.0, spp=1)


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize("technique", TRACERS)
def test_gates_need_a_pulse(technique):
    loaded, bare = load(described(technique)), mi.load_dict(by(technique), parallel=False)
    sensor = loaded.sensors()[0]
    config = {"temporal_bins": 4, "start_opl": 3.0, "bin_width_opl": 0.5}
    refused("pulse", tofrender.render_at_time, loaded, bare, sensor, 3.5, spp=1)
    refused("pulse", tofrender.render_transient, loaded, bare, sensor, config, spp=1)


@pytest.mark.parametrize("technique", TRACERS)
def test_there_are_no_derivatives(technique):
    tracer = mi.load_dict(by(technique), parallel=False)
    for name in ("render_forward", "render_backward"):
        with pytest.raises(RuntimeError, match="derivatives are not supported"):
            getattr(tracer, name)(None, None, None)


def test_every_parameter_counts_for_a_resumed_render():
    """A render that goes on with another strategy would mix two pictures."""
    loaded = load(described(BDPT))
    changes = [
        {},
        {"strategy": "1,2"},
        {"strategy": "2,1"},
        {"strategy": "2,1", "mis": "power"},
        {"mis": "balance"},
        {"camera_connections": False},
        {"camera_unwarp": True},
    ]
    prints = [
        fingerprint(loaded, loaded.sensors()[0], mi.load_dict(by(BDPT, **each), parallel=False))
        for each in (*changes, {})
    ]
    assert len(set(prints)) == len(changes)
    assert prints[0] == prints[-1]


@pytest.mark.parametrize("technique", TRACERS)
def test_a_lamp_that_lights_nothing(technique):
    """Light that meets nothing that the camera sees is no error: the picture is black."""
    away = described(technique) | {"wall": floor(0.1)["floor"] | {"to_world": translate(9, 9, 9)}}
    del away["floor"]
    steady, transient = (np.array(each) for each in mi.render(load(away), spp=16))
    assert steady.max() == transient.max() == 0
