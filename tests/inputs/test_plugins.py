"""Every parameter of every plugin with bad values, in a scene that is loaded: one clear line."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, NamedTuple

import mitsuba as mi
import numpy as np
import pytest
from helpers.bad_inputs import ANY, outcome

import tofrender
from tofrender.runtime.plugins import PLUGINS

FILM = {"type": "transient_hdr_film", "width": 4, "height": 4, "temporal_bins": 8}
FILM |= {"start_opl": 0.0, "bin_width_opl": 1.0}
NUMBERS = {"-1", "0", "1.5", "1e30", "2**40"}

MORE: dict[str, Any] = {
    "vector": (1.0, 2.0, 3.0),
    "transform": mi.ScalarTransform4f() if mi.variant() else None,
    "object": {"type": "sphere"},
    "cut-text": "0.1, 0.2,",
    "long-text": "9" * 5000,
    "-2": -2,
    "2.0": 2.0,
    "65": 65,
}
KINDS: dict[str, set[str]] = {
    # kind: what of ANY and MORE is good for it; nothing for kinds that are not here
    "depth": {"-1", "65", "2.0"},
    "bounces": {"-1", "0", "65", "2.0"},
    "order": {"65", "2.0"},
    "boolean": {"True", "numpy-True"},
    "light-samples": {"2.0"},
    "filter": {"empty-text"},
    "positive": NUMBERS - {"-1", "0"} | {"2.0", "65"},
    "metres": NUMBERS | {"2.0", "65", "-2"},
    "width": {"1.5", "2.0", "65"},
    "fov": {"1.5", "2.0"},
    "seed": {"0", "65", "2.0"},
    "small-count": {"2.0", "65"},
    "count": {"2.0", "65"},
    "tries": {"2.0"},
    "capture": {"2.0"},
    "text": {"text", "empty-text", "digits", "lines", "cut-text", "long-text", "nul"},
    "bounce-filter": {"-1", "65", "2.0"},
    "sigma": {"0"},
    "numbers": {"vector", "digits", "1.5", "0", "-1", "2.0", "65", "-2", "1e30", "2**40"},
    "frequencies": {"1.5", "2.0", "65", "digits", "1e30", "2**40", "vector", "cut-text"},
    "point": {"vector"},
    "colour": {"vector", "0", "1.5", "2.0", "65", "1e30", "2**40"},
    "reflectance": {"0", "object"},
    "frame": {"transform", "array-object"},
    "length": NUMBERS | {"2.0", "65", "-2"},
}


class Plugin(NamedTuple):
    """A plugin, the scene that it is put into, and what kind each of its parameters is."""

    name: str
    scene: Callable[[dict[str, Any]], dict[str, Any]]
    good: dict[str, Any]
    kinds: dict[str, str]


def room(**parts: Any) -> dict[str, Any]:
    """A floor, a lamp and a camera."""
    look = mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
    camera = {"type": "perspective", "to_world": look, "film": FILM}
    light = {"type": "point", "position": [0, 0, 2]}
    floor = {"type": "rectangle"}
    return {"type": "scene", "floor": floor, "lamp": light, "sensor": camera} | parts


def as_integrator(plugin: dict) -> dict[str, Any]:
    return room(integrator=plugin)


def with_part(name: str) -> Callable[[dict], dict[str, Any]]:
    """The room with another part of its camera."""
    described = room(integrator={"type": "transient_path"})
    return lambda part: described | {"sensor": described["sensor"] | {name: part}}


def with_material(bsdf: dict) -> dict[str, Any]:
    return room(integrator={"type": "transient_path"}, floor={"type": "rectangle", "bsdf": bsdf})


def with_meter(meter: dict) -> dict[str, Any]:
    described = tofrender.nlos_plane(width=4, height=4, spp=1)
    wall = described["relay_wall"]
    name = next(k for k, v in wall.items() if isinstance(v, dict) and "film" in v)
    return described | {"relay_wall": wall | {name: meter | {"film": wall[name]["film"]}}}


def with_projector(projector: dict) -> dict[str, Any]:
    described = tofrender.nlos_plane(width=4, height=4, spp=1)
    plain = {"type": "confocal_transient_path", "confocal_projector": projector}
    return described | {"integrator": plain}


FOLLOWS = {
    "max_depth": "depth",
    "rr_depth": "order",
    **dict.fromkeys(
        ("hide_emitters", "camera_unwarp", "discard_direct_light", "emitter_sampling"), "boolean"
    ),
    "gradient_sampling": "sampling",
}
IN_BINS = FOLLOWS | {
    "temporal_filter": "filter",
    "gaussian_stddev": "positive",
    "pulse_width_opl": "width",
}
LIGHTS = IN_BINS | {"light_samples": "light-samples"}
TRACED = {"max_bounces": "bounces"}
WALL = IN_BINS | {
    "relay_wall": "text",
    "hidden_shapes": "text",
    "use_nlos_only": "boolean",
    "filter_bounces": "bounce-filter",
    "nlos_hidden_geometry_sampling": "boolean",
    "account_first_and_last_bounces": "boolean",
}


def integrator(name: str, kinds: dict[str, str], **good: Any) -> Plugin:
    return Plugin(name, as_integrator, good, kinds)


TABLE = [
    integrator("transient_path", LIGHTS),
    integrator("transient_volpath", LIGHTS),
    integrator("path_tracer_mats", IN_BINS | TRACED),
    integrator("path_tracer_nee", LIGHTS | TRACED),
    integrator("path_tracer_mis", LIGHTS | TRACED),
    integrator("ao", IN_BINS | {"max_depth": "left out"}),
    integrator(
        "simple",
        IN_BINS | {"position": "point", "energy": "colour"},
        position=[0, 0, 2],
        energy=4.0,
    ),
    integrator("transient_light_tracer", IN_BINS),
    integrator(
        "transient_bdpt",
        IN_BINS | {"camera_connections": "boolean", "strategy": "filter", "mis": "choice"},
    ),
    integrator("time_gated_transient_path", FOLLOWS | {"target_time": "length"}),
    integrator(
        "amcw_transient_path",
        FOLLOWS | {"frequency_hz": "positive", "phase_offset": "metres"},
        frequency_hz=20e6,
    ),
    integrator("confocal_transient_path", WALL | {"power": "positive", "spot_sigma": "sigma"}),
    integrator(
        "transient_nlos_path",
        WALL
        | {
            "capture_type": "capture",
            "nlos_laser_sampling": "boolean",
            "nlos_hidden_geometry_sampling_do_rroulette": "boolean",
            "nlos_hidden_geometry_sampling_includes_relay_wall": "boolean",
            "discard_direct_paths": "boolean",
            "filter_depth": "bounce-filter",
            "force_equal_illumination_scanning": "boolean",
        },
    ),
    Plugin(
        "transient_hdr_film",
        with_part("film"),
        {"width": 4, "height": 4},
        {
            "temporal_bins": "count",
            "bin_width_opl": "positive",
            "start_opl": "metres",
            "width": "count",
            "height": "count",
            "sample_border": "boolean",
            "rfilter": "rfilter",
        },
    ),
    Plugin(
        "phasor_hdr_film",
        with_part("film"),
        {"width": 4, "height": 4, "frequencies_hz": "2e7"},
        {
            "frequencies_hz": "frequencies",
            "temporal_bins": "count",
            "bin_width_opl": "positive",
            "start_opl": "metres",
            "wl_mean": "positive",
            "wl_sigma": "positive",
        },
    ),
    Plugin("padded_sobol", with_part("sampler"), {}, {"sample_count": "count", "seed": "seed"}),
    Plugin(
        "retroreflector",
        with_material,
        {},
        {"reflectance": "reflectance", "lobe_exponent": "positive"},
    ),
    Plugin(
        "nlos_capture_meter",
        with_meter,
        {"sensor_origin": [-0.5, 0, 1]},
        {
            "sensor_origin": "point",
            "laser_origin": "point",
            "laser_lookat_pixel": "point",
            "laser_lookat_3d": "point",
            "confocal": "boolean",
        },
    ),
    Plugin(
        "confocal_projector",
        with_projector,
        {},
        {
            "fov": "fov",
            "is_confocal": "boolean",
            "frame": "frame",
            "grid_rows": "small-count",
            "grid_cols": "small-count",
            "grid_sigma": "positive",
            "grid_intensity": "positive",
            "grid_spacing": "choice",
            "grid_seed": "seed",
            "spot_positions": "spots",
            "spot_sigmas": "spots",
            "spot_intensities": "spots",
            "max_rejection_samples": "tries",
            "pulse_type": "choice",
            "pulse_width_opl": "width",
        },
    ),
]
PRESENT = {
    "parameter": "a heading",
    "technique": "a heading",
    "block_size": "no effect, as in mitransient",
    "confocal_projector": "an object, with_projector",
    "pulse_values": "test_nlos_input.py",
    "pulse_start_opl": "test_nlos_input.py",
    "pulse_bin_width_opl": "test_nlos_input.py",
    "original_film_width": "must be given with its fellows: test_nlos_input.py",
    "original_film_height": "must be given with its fellows: test_nlos_input.py",
    "laser_power": "no effect, as in mitransient",
    "nlos_hidden_geometry_sampling_max_depth": "no effect, as in mitransient",
    "illumination_scan_fov": "no effect, as in mitransient",
    "max_bounces": "of path tracers alone",
    "light_samples": "of those that connect to lights",
    "pulse_width_opl": "of those that fill bins",
    "temporal_filter": "of those that fill bins",
    "gaussian_stddev": "of those that fill bins",
    "target_time": "of gates",
}
"""Parameters in the tables of docstrings that are tried elsewhere, or not with every plugin."""


def load(plugin: Plugin, **changes: Any) -> mi.Scene:
    described = plugin.scene({"type": plugin.name} | plugin.good | changes)
    return tofrender.load_scene(described, optimize=False)


@pytest.mark.parametrize("plugin", TABLE, ids=lambda plugin: plugin.name)
def test_good_parameters(plugin):
    load(plugin)


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize(
    ("plugin", "name", "start"),
    [
        pytest.param(plugin, name, number, id=f"{plugin.name}-{name}")
        for number, (plugin, name) in enumerate((p, name) for p in TABLE for name in p.kinds)
    ],
)
def test_bad_parameters(plugin, name, start, pytestconfig):
    values = {
        label: value
        for label, value in (ANY | MORE | {"transform": mi.ScalarTransform4f()}).items()
        if label not in KINDS.get(plugin.kinds[name], ()) and not isinstance(value, np.ndarray)
    }
    if not pytestconfig.getoption("--all-inputs"):
        values = {label: values[label] for label in list(values)[start % 4 :: 4]}
    wrong = {}
    for label, value in values.items():
        what = outcome(lambda value=value: load(plugin, **{name: value}), name)
        if what:
            wrong[label] = what
    assert not wrong


def test_the_table_has_every_parameter():
    """As the tables in the docstrings name them."""
    known = {plugin.name: plugin.kinds for plugin in TABLE}
    missing = []
    for name, plugin in PLUGINS.items():
        documented = set()
        for kind in getattr(tofrender, name).__mro__:
            if kind.__module__.startswith("tofrender"):
                rows = re.findall(r"^\s*\| `([\w`, ]+)` \|", kind.__doc__ or "", re.MULTILINE)
                documented |= {each for row in rows for each in re.findall(r"\w+", row)}
        missing += [
            f"{plugin.name}.{each}"
            for each in sorted(documented - set(known.get(plugin.name, {})) - set(PRESENT))
        ]
    assert not missing
