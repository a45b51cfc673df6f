"""Every parameter of every plugin with bad values, in a scene that is loaded: one clear line."""

import re
from collections.abc import Callable
from typing import Any, NamedTuple

import mitsuba as mi
import numpy as np
import pytest
from helpers.bad_inputs import ANY, outcome
from helpers.rooms import camera, material, room

import tofrender
from tofrender.runtime.plugins import PLUGINS

NUMBERS = {"-1", "0", "1.5", "1e30", "2**40"}

MORE: dict[str, Any] = {
    "vector": (1.0, 2.0, 3.0),
    "transform": mi.ScalarTransform4f() if mi.variant() else None,
    **{"object": {"type": "sphere"}, "cut-text": "0.1, 0.2,", "long-text": "9" * 5000},
    **{"-2": -2, "2.0": 2.0, "65": 65},
}
TEXTS = {"text", "empty-text", "digits", "lines", "cut-text", "long-text", "nul"}
WHOLE = {"2.0", "65"}
ALL_NUMBERS = NUMBERS | WHOLE | {"-2"}
KINDS: list[tuple[set[str], str]] = [
    # what of ANY and MORE is good, and for which parameters
    (
        {"True", "numpy-True"},
        "hide_emitters camera_unwarp discard_direct_light emitter_sampling",
    ),
    ({"True", "numpy-True"}, "caustic_photons caustic_rays chain_rays shared_paths"),
    ({"True", "numpy-True"}, "camera_connections use_nlos_only discard_direct_paths sample_border"),
    ({"True", "numpy-True"}, "nlos_hidden_geometry_sampling account_first_and_last_bounces"),
    ({"True", "numpy-True"}, "nlos_laser_sampling nlos_hidden_geometry_sampling_do_rroulette"),
    ({"True", "numpy-True"}, "nlos_hidden_geometry_sampling_includes_relay_wall is_confocal"),
    ({"True", "numpy-True"}, "force_equal_illumination_scanning confocal"),
    (WHOLE | {"-1"}, "max_depth filter_bounces filter_depth"),
    (WHOLE | {"-1", "0"}, "max_bounces"),
    (WHOLE, "rr_depth temporal_bins width height sample_count grid_rows grid_cols"),
    (WHOLE | {"0"}, "seed grid_seed"),
    (WHOLE | {"1.5"}, "pulse_width_opl"),
    ({"2.0"}, "light_samples capture_type max_rejection_samples"),
    ({"1.5", "2.0"}, "fov"),
    ({"0"}, "spot_sigma"),
    (ALL_NUMBERS, "target_time phase_offset start_opl"),
    (ALL_NUMBERS - {"-1", "-2", "0"}, "gaussian_stddev frequency_hz power bin_width_opl wl_mean"),
    (ALL_NUMBERS - {"-1", "-2", "0"}, "wl_sigma lobe_exponent grid_sigma grid_intensity"),
    (ALL_NUMBERS - {"-1", "-2", "0"} | {"digits", "vector", "cut-text"}, "frequencies_hz"),
    (ALL_NUMBERS - {"-1", "-2"} | {"vector"}, "energy"),
    ({"vector"}, "position sensor_origin laser_origin laser_lookat_pixel laser_lookat_3d"),
    ({"empty-text"}, "temporal_filter strategy"),
    (TEXTS, "relay_wall hidden_shapes"),
    ({"0", "object"}, "reflectance"),
    (NUMBERS - {"-1"} | {"vector", "object"} | WHOLE, "radiance"),
    ({"1.5"} | WHOLE, "cutoff_angle"),
    ({"0", "1.5", "2.0"}, "beam_width"),
    ({"transform", "array-object"}, "frame"),
    (set(), "gradient_sampling mis grid_spacing pulse_type rfilter"),
    (set(), "spot_positions spot_sigmas spot_intensities ao.max_depth"),
]
GOOD = {name: good for good, names in KINDS for name in names.split()}


class Plugin(NamedTuple):
    """A plugin, the scene that it is put into, and the names of its parameters."""

    name: str
    scene: Callable[[dict[str, Any]], dict[str, Any]]
    good: dict[str, Any]
    parameters: str


def with_meter(meter: dict) -> dict[str, Any]:
    described = tofrender.nlos_plane(width=4, height=4, spp=1)
    wall = described["relay_wall"]
    name = next(k for k, v in wall.items() if isinstance(v, dict) and "film" in v)
    return described | {"relay_wall": wall | {name: meter | {"film": wall[name]["film"]}}}


def with_projector(projector: dict) -> dict[str, Any]:
    described = tofrender.nlos_plane(width=4, height=4, spp=1)
    plain = {"type": "confocal_transient_path", "confocal_projector": projector}
    return described | {"integrator": plain}


def with_lamp(lamp: dict) -> dict[str, Any]:
    return room(lamp={"type": "rectangle", "emitter": lamp})


FOLLOWS = "max_depth rr_depth hide_emitters camera_unwarp discard_direct_light "
FOLLOWS += "emitter_sampling gradient_sampling "
IN_BINS = FOLLOWS + "temporal_filter gaussian_stddev pulse_width_opl "
CAUSTICS = "caustic_photons caustic_rays chain_rays shared_paths "
LIGHTS = IN_BINS + CAUSTICS + "light_samples "
WALL = IN_BINS + "relay_wall hidden_shapes use_nlos_only filter_bounces "
WALL += "nlos_hidden_geometry_sampling account_first_and_last_bounces "

SCANS = "capture_type nlos_laser_sampling discard_direct_paths filter_depth "
SCANS += "nlos_hidden_geometry_sampling_do_rroulette force_equal_illumination_scanning "
SCANS += "nlos_hidden_geometry_sampling_includes_relay_wall"
METER = "sensor_origin laser_origin laser_lookat_pixel laser_lookat_3d confocal"
FILM = "temporal_bins bin_width_opl start_opl "
SPOTS = "fov is_confocal frame grid_rows grid_cols grid_sigma grid_intensity grid_spacing "
SPOTS += "grid_seed spot_positions spot_sigmas spot_intensities max_rejection_samples pulse_type "
SPOTS += "pulse_width_opl"


def integrator(name: str, parameters: str, **good: Any) -> Plugin:
    return Plugin(name, lambda it: room(integrator=it), good, parameters)


def of_camera(part: str, name: str, parameters: str, **good: Any) -> Plugin:
    return Plugin(name, lambda it: camera(**{part: it}), good, parameters)


SIZE = {"width": 4, "height": 4}
PHASORS = SIZE | {"frequencies_hz": "2e7"}

TABLE = [
    integrator("transient_path", LIGHTS),
    integrator("transient_volpath", LIGHTS),
    integrator("path_tracer_mats", IN_BINS + "max_bounces"),
    integrator("path_tracer_nee", LIGHTS + "max_bounces"),
    integrator("path_tracer_mis", LIGHTS + "max_bounces"),
    integrator("ao", IN_BINS),
    integrator("simple", IN_BINS + "position energy", position=[0, 0, 2], energy=4.0),
    integrator("transient_light_tracer", IN_BINS),
    integrator("transient_bdpt", IN_BINS + "camera_connections strategy mis"),
    integrator("time_gated_transient_path", FOLLOWS + "target_time"),
    integrator(
        "amcw_transient_path", FOLLOWS + CAUSTICS + "frequency_hz phase_offset", frequency_hz=20e6
    ),
    integrator("confocal_transient_path", WALL + "power spot_sigma"),
    integrator("transient_nlos_path", WALL + SCANS),
    of_camera("film", "transient_hdr_film", FILM + "width height sample_border rfilter", **SIZE),
    of_camera("film", "phasor_hdr_film", FILM + "frequencies_hz wl_mean wl_sigma", **PHASORS),
    of_camera("sampler", "padded_sobol", "sample_count seed"),
    Plugin("retroreflector", lambda bsdf: material(**bsdf), {}, "reflectance lobe_exponent"),
    Plugin("angulararea", with_lamp, {}, "radiance cutoff_angle beam_width"),
    Plugin("nlos_capture_meter", with_meter, {"sensor_origin": [-0.5, 0, 1]}, METER),
    Plugin("confocal_projector", with_projector, {}, SPOTS),
]
ELSEWHERE = {
    "a heading": "parameter technique",
    "no effect, as in mitransient": "block_size laser_power illumination_scan_fov "
    "nlos_hidden_geometry_sampling_max_depth",
    "with_projector": "confocal_projector",
    "test_nlos_input.py": "pulse_values pulse_start_opl pulse_bin_width_opl original_film_width "
    "original_film_height",
    "of some integrators alone": "max_bounces light_samples pulse_width_opl "
    "caustic_photons caustic_rays chain_rays shared_paths "
    "temporal_filter gaussian_stddev target_time",
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
        for number, (plugin, name) in enumerate(
            (p, name) for p in TABLE for name in p.parameters.split()
        )
    ],
)
def test_bad_parameters(plugin, name, start, pytestconfig):
    good = GOOD.get(f"{plugin.name}.{name}", GOOD[name])
    values = {
        label: value
        for label, value in (ANY | MORE | {"transform": mi.ScalarTransform4f()}).items()
        if label not in good and not isinstance(value, np.ndarray)
    }
    if not pytestconfig.getoption("--all-inputs"):
        values = {label: values[label] for label in list(values)[start % 4 :: 4]}
    wrong = {}
    for label, value in values.items():
        wrong[label] = outcome(lambda value=value: load(plugin, **{name: value}), name)
    assert not {label: what for label, what in wrong.items() if what}


def test_the_table_has_every_parameter():
    present = {name for names in ELSEWHERE.values() for name in names.split()}
    known = {plugin.name: plugin.parameters.split() for plugin in TABLE}
    missing = []
    for name, plugin in PLUGINS.items():
        documented = set()
        for kind in getattr(tofrender, name).__mro__:
            if kind.__module__.startswith("tofrender"):
                rows = re.findall(r"^\s*\| `([\w`, ]+)` \|", kind.__doc__ or "", re.MULTILINE)
                documented |= {each for row in rows for each in re.findall(r"\w+", row)}
        missing += [
            f"{plugin.name}.{each}"
            for each in sorted(documented - set(known.get(plugin.name, [])) - present)
        ]
    assert not missing
