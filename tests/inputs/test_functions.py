"""Every public function with bad values for each of its parameters: one clear line each."""

import ast
import functools
import inspect
import json
import shutil
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import mitsuba as mi
import numpy as np
import pytest
import xarray as xr
from helpers import bad_inputs
from helpers.bad_inputs import FILM, kind_of, kind_of_setting, listing, outcome, sample
from helpers.hidden_scenes import Wall, capture_of, rectangle
from helpers.made_dataset import make_dataset
from oracles import lamp_above_floor

import tofrender
from tofrender import sampling
from tofrender.runtime.settings import SCENE_SETTINGS

PACKAGE = Path(tofrender.__file__).parent

WINDOW = {"temporal_bins": 20, "start_opl": 3.5, "bin_width_opl": 0.6}
BOX = {"width": 4, "height": 4, "spp": 1, "max_depth": 2, **WINDOW}
WALL = {"width": 2, "height": 2, "spp": 1, "optimize": False}
PATCH = rectangle((-0.1, 0.1), (-0.1, 0.1), 1.0, 0.1)
QUIET = {"progress": False}
COUNTER = {"cycles": 9, "photons": {"photons_per_cycle": 0.1}, "spad": {}}

cached = functools.cache
box = cached(lambda: tofrender.load_scene("cornell_box", **BOX))
wall = cached(lambda: tofrender.load_scene("nlos_plane", **WALL))
lamp = cached(lambda: lamp_above_floor.scene())
gated = cached(lambda: mi.load_dict({"type": "tofrender_time_gated_transient_path"}))
data = cached(lambda: make_dataset(2, 3, 4, energy_outside_window=0.0))
halved = cached(lambda: tofrender.render(box(), spp=2, denoise=True, **QUIET))
captured = cached(lambda: capture_of(PATCH, Wall(4), bins=24, width=0.05))
volume = cached(lambda: tofrender.reconstruct(captured(), "bp", **QUIET))
pyramid = cached(lambda: tofrender.strategy_pyramid(box(), max_depth=2, spp=1, **QUIET))
counted = cached(lambda: tofrender.sensors.sense(data(), COUNTER))
depth_errors = cached(
    lambda: tofrender.sensors.reconstruction_errors(
        captured(), wall(), sensor=COUNTER, photons_per_cycle=[0.5], methods=["bp"], seeds=1
    )
)
verdict = cached(lambda: sampling.warp_case("tent").test(samples=2000, resolution=4))
drawn = cached(lambda: tofrender.plot_pixel_transient(CUBE, 0, 0, 1.0, 0.1))
record = cached(lambda: sampling.Sphere((0, 0, 1), 0.1).sample(mi.Point3f(0), mi.Point2f(0.5)))


@cached
def modulated() -> Any:
    integrator = mi.load_dict({"type": "tofrender_amcw_transient_path"})
    integrator.set_modulation(tofrender.AMCWPulse(20e6))
    return integrator


def seeded(seed: int) -> xr.Dataset:
    attrs = {"seed": seed, "spp": 1, "complete": 1, "render_seconds": 1.0, "fingerprint": "1"}
    return data().assign_attrs(attrs)


scan_shots = cached(lambda: tofrender.scan_pattern(shots=(2, 2)))
shots = cached(lambda: tofrender.lidar("cornell_box", scan_shots(), **QUIET, spp=1))
points = cached(lambda: tofrender.point_cloud(shots()))
apart = cached(lambda: tofrender.load_scene("cornell_box", **BOX, optimize=False))
heard = cached(lambda: tofrender.doppler(apart(), spp=1, **QUIET))
by_rates = cached(lambda: tofrender.range_rate(box(), spp=1, rate_bins=3, **QUIET))


@pytest.fixture(scope="module", autouse=True)
def _made():
    """What takes work is made before the tests forbid it; no scene stays behind."""
    for made in (pyramid, volume, verdict, depth_errors, halved, points, heard, by_rates):
        made()
    yield
    scenes = (box, wall, lamp, gated, modulated, halved, apart, heard, by_rates)
    for each in (
        *scenes,
        data,
        captured,
        depth_errors,
        volume,
        pyramid,
        verdict,
        record,
        shots,
        points,
    ):
        each.cache_clear()


CUBE = np.ones((2, 3, 4, 1))
PICTURE = np.ones((2, 3))
POINTS = np.array([[[0.0, 0, 0], [1, 0, 0]], [[0, 1, 0], [1, 1, 0]]])

GOOD: dict[str, Callable[[], Any]] = {
    **{"scene": box, "dataset": data, "capture": captured, "where": captured, "volume": volume},
    **{"pyramid": pyramid, "verdict": verdict, "record": record, "figure": drawn},
    **{"integrator": gated, "sensor": lambda: box().sensors()[0]},
    "renders": lambda: [seeded(0), seeded(1)],
    "emitter": lambda: mi.load_dict({"type": "point"}),
    "si": lambda: wall().ray_intersect(mi.Ray3f(mi.Point3f(0, 0, 1), mi.Vector3f(0, 0, -1))),
    "relay_wall_shapes": lambda: wall().shapes()[:1],
    "cases": lambda: [sampling.warp_case("tent")],
    "light": sampling.Sphere,
    "shapes": lambda: [sampling.Sphere()],
    **dict.fromkeys(("sample", "p"), lambda: mi.Point2f(0.5)),
    "v": lambda: mi.Vector3f(0, 0, 1),
    "m": lambda: mi.Vector3f(0.5),
}
"""What makes a good value of a parameter that has no default."""

CONSTANTS: dict[str, Any] = {
    **dict.fromkeys(("data", "values", "transient_data", "rendered", "target"), CUBE),
    **dict.fromkeys(("I", "Q", "B0", "B90", "B180", "B270", "depth", "true_depth"), PICTURE),
    **{"distance_m": PICTURE, "stokes": np.ones((2, 3, 4, 3)), "image": np.ones((4, 4))},
    **{"frequency_hz": 20e6, "frequencies_hz": [20e6], "target_time": 6.0},
    **{"start_opl": 1.0, "bin_width_opl": 0.1},
    **{"x": 2, "y": 1, "opl": 1.0, "time_ns": 1.0, "pulse_width_opl": 0.03, "width_opl": 0.1},
    **{"k": 3, "n_bits": 4, "count": 4, "kind": "grid", "mode": "confocal", "name": "tent"},
    "layout": "lct",
    **{"v0": (0, 0, 0), "v1": (1, 0, 0), "v2": (0, 1, 0), "alpha": 0.3, "cos_theta_max": 0.5},
    **{"corner": (0, 0, 0), "e0": (1, 0, 0), "e1": (0, 1, 0), "o": (0, 0, 4), "wi": (0, 0, 1)},
    **{"time_s": 0.1, "source": "cornell_box", "film_config": FILM, "method": "bp", "offset": 4.0},
    **{"gate": lambda opl: opl, "pdf": sampling.square_to_tent_pdf, "domain": "plane"},
    **{"sensor_grid": POINTS, "sensor_normals": np.broadcast_to([0.0, 0, 1], POINTS.shape)},
    **{"transient": np.ones((2, 2, 4)), "layers": {"": np.ones((2, 3, 1))}},
    **{"bsdf": {"type": "diffuse"}, "truth": np.ones((4, 4)), "points": np.zeros((2, 4))},
}
"""Good values of more of them."""

QUICK = {"progress": False, "spp": 1, "min_size": 4, "samples": 1000, "resolution": 4}
"""Given to every function that has them."""

WRITTEN = {
    **{"Checkpoint": "a.npz", "save_npz": "a.npz", "save_video": "a.gif", "save_capture": "a.h5"},
    **{"save_point_cloud": "a.ply", "save_matlab_capture": "a.mat"},
    **{"save_exr_layers": "a.exr", "save_zarr": "a.zarr", "save_figure": "a.png"},
    "report": "a.html",
}
READ = {
    **{"load_zarr": "a.zarr", "load_npz": "a.npz", "load_exr_stack": "a.exr"},
    **{"load_capture": "counts.npz", "from_file": "a.csv"},
    **{"load_stl": "a.stl", "load_histograms": "a.json", "load_poses": "a.json"},
}
"""The file of each function that has a path."""

KINDS = {
    "amounts": "signal background",
    "boolean": "all_bins denoise discard_direct_light errors flip_normals folder hide_emitters "
    "occluder optimize overwrite paralysable passes_boundaries progress",
    "boolean but 1, 0": "counts_first_and_last_legs",
    "choice": "domain integrator k kind layout light loss method mis mode optimizer "
    "precision quantity sampler scheduler shown spheres style subject surface theme view weighting",
    "count": "adc_bits bins count height n_bits patience pulses sample_dimension slit_rows "
    "slit_width spp steps taps tdc_bits temporal_bins tests threads width workers",
    "cube": "data other rendered target transient values",
    "dataset": "capture dataset pyramid resume where",
    "file": "module out path",
    "fraction": "afterpulse_probability afterpulse_time_s coincidence_window_s "
    "crosstalk_probability dead_time_s detection_efficiency edge_s extinction fill_factor "
    "hot_fraction share tail_s tdc_dnl threshold tolerance transmission",
    "frequencies": "frequencies_hz frequency_hz",
    "from 0": "ambient_radiance dark_count_hz hot_rate_hz read_noise spread_slit spread_sweep",
    "function": "apply callback gate pdf tell",
    "integer": "x0 y0",
    "label": "again name title",
    "lanes": "m n p sample v",
    "mapping": "attrs define parameters settings",
    "mapping but dict-1": "bounds expected_moments",
    "meters": "energy_weight opl phase_offset start_opl start_s target_time tilt time_s",
    "object": "bsdf cases client detector emitter figure jitter params record relay_wall_shapes "
    "response shapes si verdict",
    "panel": "B0 B180 B270 B90 I Q amplitude amplitudes depth phase true_depth",
    "pair": "first_pixel pixel uv",
    "picture": "distance_m laser_grid laser_normals sensor_grid sensor_normals truth",
    "pixel": "x y",
    "place": "laser_origin sensor_origin",
    "point": "angular_velocity center corner e0 e1 laser o point position rotation_center v0 v1 v2 "
    "velocity wi",
    "positive": "bin_width bin_width_opl bin_width_s cycles distance exposure f_number "
    "focal_length_m full_well half_width intensity_scale lamp_power_w learning_rate "
    "mean_power_w period_ns "
    "pixel_pitch_m pulse_energy_j range_m repetition_rate_hz seconds side snr stops tdc_lsb_s "
    "wall_size wavelength wavelength_m",
    "positive but 1e30, 2**40": "megabytes radius",
    "pulse-width": "pulse_width pulse_width_opl sweep_opl width_opl",
    "radius": "hole_width lamp_radius",
    "seed": "demodulation device_seed seed",
    "series": "delays_opl harmonics",
    "share": "false_alarm sigma_s width_s",
    "shapes": "hidden_shapes relay_wall wall",
    "sizes": "grid macro_pixel size",
    "stops": "most_stops shadows stops_per_row",
    "turn": "angle polarizer",
}
"""The kind of each parameter, see `bad_inputs.KINDS`; others are of the kind that has their name.

None is good where it is the default.
"""

PARAMETERS = {name: kind for kind, names in KINDS.items() for name in names.split()} | {
    **{"max_bounces": "bounces", "percentile": "cent", "emission": "color", "dpi": "dots"},
    **{"film_config": "config", "cos_theta_max": "cosine", "max_depth": "depth", "fps": "rate"},
    **{"sigma_t": "extinction", "time_ns": "length", "light_samples": "light-samples"},
    **{"on_wall": "mask", "transform": "matrix", "alpha": "roughness", "contrast": "share"},
    **{
        "excess_noise": "rate",
        "min_size": "side",
        "axis": "stokes-axis",
        "orders": "mapping but dict-1, dataset",
    },
    **{"phases": "panel but array-nan", "points": "picture but array-nan"},
    **{"transient_data": "cube but dataset without pixels"},
    **{"needed_bytes": "seed but 2**40, 2**32", "swing": "from 0 but 1e30, 2**40"},
    **dict.fromkeys(("speed", "angular_speed"), "meters but 1e30, 2**40"),
}


class Row(NamedTuple):
    """A call, where it is more than the function with a good value for all it must be given."""

    name: str  # the function or class, as found in `tofrender`
    good: Callable[[], dict[str, Any]] = dict  # other arguments with which it works
    # kinds of parameters that differ from KINDS, or are not in the signature
    kinds: dict[str, str] = {}  # noqa: RUF012
    # whether it has bad values for these parameters alone, other rows for the rest
    alone: bool = False


def row(name: str, kinds: dict[str, str] | None = None, /, *, only=False, **good: Any) -> Row:
    """A row whose good values are those that are given; what is cached is called."""

    def made() -> dict[str, Any]:
        return {k: v() if hasattr(v, "cache_clear") else v for k, v in good.items()}

    return Row(name, made, kinds or {}, only)


alone = functools.partial(row, only=True)


def place_lamp(params: Any, values: dict[str, Any]) -> None:
    params[lamp_above_floor.POSITION] = mi.Point3f(0, 0, values["z"])


def rows(*names: str, **kinds: str) -> list[Row]:
    return [Row(name, kinds=kinds) for name in names]


FAR = "meters but 1e30, 2**40"
WAVE = {"frequency_hz": "positive"}
CASE = {"sample": "function", "expected_moments": "mapping? but dict-1"}
RENDERED = {"spp": "count?", "seed": "seed", "integrator": "choice?", "sensor": "sensor"}
RENDERED |= {"progress": "boolean"}
MOVING = RENDERED | {"scene": "source", "max_depth": "depth?", "size": "sizes?"}
MOVING |= {"checkpoint": "checkpoint?"}
DOPPLER = {"frequency_hz": "positive", "exposure_s": "positive", "cycles": "count"}
DOPPLER |= {"waveform": "choice"}
SIZE = {"width": "count", "height": "count", "spp": "count"}
BINNED = SIZE | {"temporal_bins": "count", "bin_width_opl": "positive", "start_opl": FAR}
BINNED |= {"max_depth": "depth", "integrator": "choice"}
OF_SCENE = {"sensor": "object", "integrator": "object"}
PATH = {"path": "path"}
FITTED = {"params": "parameters", "integrator": "object?", "loss": "choice but type"}
FITTED |= {"target": "cube but dataset without pixels"}
LAMP = {"scene": lamp, "params": {lamp_above_floor.POSITION: [0.0, 0.0, 1.0]}}
LAMP |= {"target": np.ones((4, 4, 60, 3)), "steps": 2}
PANEL = ("amplitude", "phase", "depth")
PHASES = {"phases": np.ones((2, 2, 3)), "frequencies_hz": [20e6, 30e6]}
FOCUSED = {"scene": "scene", "pixel": "pair?", "sensor": "sensor"}
OF_BINS = (
    *("vis.visualize_transient", "vis.plot_pixel_transient", "vis.light_in_flight"),
    *("vis.Transient.of", "analysis.transient_to_phasor"),
)
OTHER_BOXES = [f"scenes.cornell_box_{kind}" for kind in ("flash", "glass", "mirror")]
AXIS = {"start_opl": "meters", "bin_width_opl": "positive"}
GAUSS = tofrender.sensors.Response(1e-9)
HISTOGRAM = {"counts": np.ones((1, 1, 200)), "response": GAUSS, "bin_width_opl": 0.1}
COUNTED = {"bin_width_opl": "positive", "response": "object", "counts": "amounts"}
OPTICS = {"lamp_power_w": 1.0, "pulse_energy_j": 1e-9, "wavelength_m": 1e-6, "f_number": 2.0}
OPTICS |= {"pixel_pitch_m": 1e-5}
SPAD = {"mode": "multi_hit", "dead_time_s": 1e-9, "afterpulse_probability": 0.1}
SPAD |= {"crosstalk_probability": 0.1, "macro_pixel": (2, 2), "hot_fraction": 0.1}
PATTERN = {"pattern": "choice", "shots": "sizes", "fov_deg": "angles", "rate_hz": "positive"}
SCANNED = {"scene": "source", "pattern": "choice", "divergence_rad": "half-angle"}
SCANNED |= {"max_range": "positive? but 1e30, 2**40", "photons": "positive"}
SCANNED |= {
    "pose_time_s": "positive",
    "aperture_m": "positive",
    "background_hz": "from 0",
    "sensor": "sensor",
}
SCANNED |= {"bin_width_opl": "pulse-width", "max_depth": "depth", "spp": "count", "seed": "seed"}
CHIRPS = {"bandwidth_hz": "positive but 1e30", "chirp_s": "positive", "window": "choice"}
CHIRPS |= {"looks": "seed", "photons": "positive?", "sample_rate_hz": "positive?"}
FRAMES = {"scene": "source", "times_s": "times", "exposure_s": "from 0", "row_time_s": "from 0"}
ZONES = {"centers": "zone", "sizes": "zone", "gains": "zone", "starts_opl": "zone"}
ZONES |= {"floors": "zone", "pulse": "object", "bins": "count", "bin_width_opl": "pulse-width"}
ZONES |= {"blur": "fraction", "shift": "pair", "scale": "pair", "crosstalk": "fraction"}
TWO_ZONES = {"centers": [[0.0, 0.1]] * 2, "sizes": [[0.1, 0.2]] * 2, "gains": [1.0, 2.0]}
TWO_ZONES |= {"starts_opl": [0.0, 0.0], "floors": [0.0, 0.0]}
TWO_ZONES |= {"pulse": tofrender.SampledPulse([1.0], 0.0, 0.1), "bins": 3}
TWO_ZONES |= {"bin_width_opl": 0.1}
TENT = {"sample": sampling.square_to_tent, "name": "a"}
PIXELS = np.ones((2, 3, 3))
FIRST_HITS = dict.fromkeys(("position", "normal", "albedo"), PIXELS)
FIRST_HITS |= dict.fromkeys(("distance", "kind"), PICTURE)
HALVES = {"mean": CUBE, "half_difference": CUBE, "features": FIRST_HITS}
CHI_SQUARE = {"samples": "samples", "resolution": "resolution", "seed": "seed"}
IN_BINS = (
    *("caustic", "cornell_box_fog", "headlight_in_fog", "lamp_in_milk", "smoke_corridor"),
    *("brewster_window", "strained_mirror_corridor", "lamp_in_fixture", "light_through_hole"),
    *("mirror_and_glass", "fan", "corridor", "moving_mirror"),
)
PEERS = (
    *("ourbox_confocal", "wall_box_behind", "wall_box_hi_nlos", "wall_box_sphere_nlos"),
    *("wall_box_spheres_nlos", "rectangle_light_quad", "rectangle_light_triangles"),
    *("sphere_light_small", "sphere_light_medium", "sphere_light_large"),
)

TABLE = [
    row("render", RENDERED | {"scene": "source"}),
    row("Checkpoint", {"path": "checkpoint", "resume": "boolean"}),
    row("local_workers", count=1),
    row("strategy_pyramid", {"scene": "source", "max_depth": "pyramid-depth"}, max_depth=2),
    *rows("render_at_time", "render_transient", **OF_SCENE),
    row("render_single_amcw", OF_SCENE, integrator=modulated),
    *rows(
        "render_amcw_phasor",
        **(OF_SCENE | {"integrator": "object?", "frequency_hz": "frequencies but digits"}),
    ),
    row("fit", FITTED, **LAMP),
    alone("fit", {"apply": "function?"}, **LAMP | {"params": {"z": 1.0}}, apply=place_lamp),
    alone("fit", {"frequency_hz": "frequencies"}, **LAMP, loss="phasor", frequency_hz=5e7),
    *rows("l2_loss", **dict.fromkeys(("rendered", "target"), "cube but flat, 5-axes")),
    row("denoise", dataset=halved),
    row("denoising.denoise_film", dict.fromkeys(HALVES, "object") | {"colors": "seed"}, **HALVES),
    row("load_scene", {n: f"{kind_of_setting(s)}?" for n, s in SCENE_SETTINGS.items()}),
    # ----------------------------------------------------------------------------------- files
    *rows("io.save_exr_stack", "io.save_png_frames", "io.save_exr_layers", **PATH),
    *rows("io.check_output", "io.output_folder", "io.replacing", **PATH),
    *rows("io.save_npz", path="path but nothing"),
    *rows("io.save_figure", path="path but text, digits, lines"),
    row("explore", {"data": "dataset", "scene": "source?"}, data=data),
    row("paths_of", {"scene": "source", "opl": "window?"}, pixel=(0, 0)),
    row("report", {"data": "dataset"} | PATH, data=data),
    # --------------------------------------------------------------------------------- figures
    row("vis.gate_figure", {"image": "light", "pulse_width_opl": "positive"}, image=PIXELS),
    *rows("vis.figure_style", width="inches?"),
    row("vis.phasor_panel", **dict.fromkeys([*"IQ", *PANEL], np.ones((1, 2, 3, 1)))),
    row("vis.plan_figure", scene=wall),
    *rows("vis.pyramid_figure", opl="opl?"),
    *rows("vis.auto_exposure", values="light"),
    row("vis.tonemap", {"values": "light"}, values=PIXELS),
    row("vis.luminance", {"values": "colors"}, values=PICTURE),
    *rows("vis.Transient", quantity="label"),
    *(row(name, AXIS, start_opl=1.0, bin_width_opl=0.1) for name in OF_BINS),
    # -------------------------------------------------------------------------------- analysis
    row("analysis.unwrap", {"max_depth": "positive?"}, **PHASES),
    *rows("analysis.true_normals", "analysis.true_depth", scene="source"),
    row("analysis.rebin", {"bins": "count", "window": "window?"}, bins=2),
    # ------------------------------------------------------------------------ around the corner
    *(row(f"nlos.{name}", {"scene": "source"}, scene=wall) for name in ("capture", "hidden_depth")),
    alone("nlos.focus_laser", FOCUSED, scene=wall, pixel=(0, 0)),
    alone("nlos.focus_laser", {"point": "point?"}, scene=wall, point=(0, 0, 0)),
    alone("nlos.focus_laser", {"uv": "pair?"}, scene=wall, uv=(0.5, 0.5)),
    row("nlos.check_capture", dataset=captured),
    *rows("nlos.reconstruct", volume="voxels? but nan"),
    alone("nlos.reconstruct", {"surface": "choice?", "snr": "positive?"}, method="lct"),
    alone("nlos.reconstruct", {"wavelength": "positive?", "cycles": "positive?"}, method="phasor"),
    row("nlos.VolumeGrid", dict.fromkeys("xyz", "axis"), **dict.fromkeys("xyz", (0.5, 1.0, 2))),
    row("nlos.VolumeGrid.of", {"value": "voxels but nan"}, value=[(0.5, 1.0, 2)] * 3),
    row("find_relay_wall", scene=wall),
    # --------------------------------------------------------------------------------- signals
    *rows("AMCWPulse", "SquareWave", "HamiltonianCode", "MSequence", **WAVE),
    row("SampledPulse", {"values": "energies", "bin_width_opl": "pulse-width"}, values=[1.0, 2.0]),
    row("SampledPulse.from_file"),
    row("KnotPulse", {"opl": "zone", "values": "zone"}, opl=[0.0, 0.1], values=[1.0, 2.0]),
    *rows("opl_to_ns", opl="length"),
    row("sensors.MultiZone", ZONES, **TWO_ZONES),
    # --------------------------------------------------------------------------------- sensors
    row("sensors.Spad", {"coincidence": "count"}, **SPAD, coincidence=2),
    row("sensors.GatedCamera", delays_opl=[1.0], width_s=1e-9),
    row("sensors.StreakCamera", sweep_opl=0.1),
    row("sensors.Itof", {"frequencies_hz": "frequencies"}),
    row("sensors.Response", sigma_s=1e-9),
    row("sensors.coates", {"counts": "amounts", "cycles": "count"}, counts=[1, 2], cycles=9),
    row("sensors.coates_variance", {"rates": "amounts", "cycles": "count"}, rates=[1.0], cycles=9),
    *(
        row(f"sensors.{name}", signal=9.0, background=1.0, response=GAUSS, bin_width_opl=0.1)
        for name in ("depth_bound", "echo_bounds")
    ),
    *(row(f"sensors.{name}", COUNTED, **HISTOGRAM) for name in ("estimate_depth", "echoes")),
    row("sensors.expected_photons", {"dataset": "dataset"}, dataset=data, **OPTICS),
    alone(
        "sensors.expected_photons",
        {"photons_per_cycle": "positive?", "background_per_cycle": "from 0"},
        dataset=data,
        photons_per_cycle=1.0,
    ),
    # --------------------------------------------------------------------------------- scanning
    row("scanning.scan_pattern", PATTERN, shots=(2, 2)),
    row("scanning.lidar", SCANNED, pattern=scan_shots, max_range=10.0),
    row("scanning.point_cloud", {"waveforms": "render", "max_returns": "returns"}, waveforms=shots),
    row("scanning.true_points", {"waveforms": "render"}, waveforms=shots),
    row("io.save_point_cloud", {"cloud": "render"}, cloud=points),
    row("sensors.sense", {"sensor": "choice", "dataset": "dataset"}, dataset=data, sensor=COUNTER),
    row(
        "sensors.reconstruction_errors",
        {
            "methods": "choice",
            "photons_per_cycle": "times",
            "scene": "source",
            "seeds": "count",
            "sensor": "choice",
        },
        methods=["bp"],
        photons_per_cycle=[0.5],
        scene=wall,
        seeds=1,
        sensor=COUNTER,
    ),
    row("vis.reconstruction_errors_figure", {"errors": "object"}, errors=depth_errors),
    row("vis.measurement_figure", {"measured": "dataset"}, measured=counted),
    # ---------------------------------------------------------------------------------- motion
    row("render_frames", {"poses": "count?"} | FRAMES, scene=apart, times_s=[0.1], exposure_s=0.1),
    row("moving", {"scene": "scene", "motions": "mapping?"}, scene=apart, motions={}),
    *(row(name, {"scene": "scene"}, scene=apart) for name in ("motions_of", "posed")),
    row("range_rate", MOVING | {"rates": "window?", "rate_bins": "count"}, scene=apart),
    row("doppler", MOVING | DOPPLER, scene=apart),
    row("doppler_rate", {"measured": "render"}, measured=heard),
    row("Fmcw", CHIRPS, bandwidth_hz=1e7, chirp_s=1e-5, wavelength_m=1e-6, photons=1.0),
    row("vis.range_velocity_map", {"film": "render", "lidar": "object?"}, film=by_rates),
    row(
        "vis.velocity_map",
        {"limit_m_s": "positive?", "rate": "object"},
        rate=xr.DataArray(PICTURE, dims=("y", "x")),
    ),
    # -------------------------------------------------------------------------------- sampling
    row("sampling.point_set"),
    alone("sampling.point_set", {"seed": "seed"}, kind="independent"),
    *rows("sampling.warp_case", name="choice"),
    row("scenes.describe", {"name": "choice"}, name="cornell_box"),
    alone("sampling.warp_case", {"alpha": "roughness"}, name="beckmann", alpha=0.3),
    alone("sampling.warp_case", {"image": "image"}, name="hierarchical", image=np.ones((2, 2))),
    row("warptest", subject="tent"),
    *rows("sampling.bsdf_case", uv="pair"),
    *rows("sampling.light_case", light="object"),
    row("sampling.chi_square_suite", {"alpha": "chance"} | CHI_SQUARE),
    row("sampling.chi_square_test", {"alpha": "chance", "figure": "figure?"} | CASE, **TENT),
    row("sampling.Case", CASE, **TENT),
    *rows("sampling.Quad", size="pair"),
    row("sampling.Quad.from_edges"),
    Row("sampling.sample_triangle_pdf", lambda: {"p": mi.Point3f(0)}),
    # ---------------------------------------------------------------------------------- scenes
    *rows(*(f"scenes.{name}" for name in IN_BINS), **BINNED),
    *rows("scenes.small_box", "scenes.veach", **SIZE, max_bounces="bounces", integrator="choice"),
    *rows("scenes.cornell_box", start_opl="meters? but 1e30, 2**40"),
    *rows(*OTHER_BOXES, temporal_bins="count", start_opl="meters?"),
    *rows("scenes.nlos_behind_fog", "scenes.nlos_bunny", "scenes.nlos_z", **SIZE),
    *rows("scenes.nlos_patch", side="positive"),
    *rows(*(f"scenes.{name}" for name in PEERS), width="count"),
    # ------------------------------------------------------------------------------- endpoints
    *rows("ConnectionsOnly", "EmitterHits", "OneSampleLights", sensor="object?"),
    *rows("SceneLights", "OpenSky", sensor="object?"),
    row("GatedLights", {"sensor": "object?"}, sensor=None),
]
SAID = {
    "source": "scene",
    "Checkpoint path": "checkpoint",
    "nlos.check_capture dataset": "capture",
    "nlos.VolumeGrid.of value": "volume",
    "find_relay_wall wall": "relay_wall",
    "render_amcw_phasor frequency_hz": "frequencies_hz",
}
"""What messages call a parameter, where that is not its name."""

CONTEXTS = ("io.output_folder", "io.replacing", "local_workers", "posed", "vis.figure_style")
"""Calls that are entered."""

LEFT_OUT = {
    *("MultipathError", "DepthError", "Fit", "Moment", "Verdict", "SuiteVerdict", "EmitterRecord"),
    *("Warp", "make_dataset", "load_dataset"),
}
"""Results, a row of the table WARPS, and what tests/datasets has tables for."""


def saved(folder: Path, name: str) -> Path:
    """A file that can be read."""
    path = folder / name
    if path.exists():
        return path
    if path.suffix == ".h5":
        return tofrender.save_capture(captured(), path)
    if name == "counts.npz":
        np.savez(path, counts=np.ones((2, 3, 4)), bin_width_s=1e-10, wall_size=1.0)
    elif path.suffix == ".stl":
        corners = "vertex 0 0 0 vertex 1 0 0 vertex 0 1 0"
        path.write_text(f"solid facet normal 0 0 1 outer loop {corners} endloop endfacet endsolid")
    elif path.suffix == ".json":
        path.write_text(json.dumps([{"hists": [[1, 2]], "pose": np.eye(4).tolist()}]))
    elif path.suffix == ".csv":
        path.write_text("0.0,1\n0.1,2\n")
    elif path.suffix == ".zarr":
        tofrender.save_zarr(data(), path)
    elif path.suffix == ".npz":
        tofrender.save_npz(data(), path)
    else:
        tofrender.save_exr_stack(data(), path, layout="multipart", progress=False)
    return path


def function(name: str) -> Any:
    return functools.reduce(getattr, name.split("."), tofrender)


def signature(name: str) -> dict[str, inspect.Parameter]:
    """The parameters that are not `**more`."""
    parameters = inspect.signature(function(name)).parameters
    return {k: v for k, v in parameters.items() if v.kind not in (v.VAR_KEYWORD, v.VAR_POSITIONAL)}


def kinds_of(row: Row) -> dict[str, str]:
    """What kind of value each parameter takes that is tried."""
    if row.alone:
        return row.kinds
    elsewhere = {
        name for other in TABLE if other.alone and other.name == row.name for name in other.kinds
    }
    kinds = dict(row.kinds)
    for name, parameter in signature(row.name).items():
        if name not in row.kinds and name not in elsewhere:
            kind, *left_out = PARAMETERS.get(name, name).partition(" but ")
            kinds[name] = "".join([kind, "?" * (parameter.default is None), *left_out])
    return kinds


def arguments(row: Row, out: Path) -> dict[str, Any]:
    """With which the call works; files are in the folder."""
    given = {}
    base = row.name.rpartition(".")[2]
    for name, parameter in signature(row.name).items():
        if name in QUICK:
            given[name] = QUICK[name]
        elif name == "path":
            given[name] = saved(out, READ[base]) if base in READ else out / WRITTEN.get(base, "a")
        elif parameter.default is parameter.empty:
            given[name] = GOOD[name]() if name in GOOD else CONSTANTS.get(name)
    return given | row.good()


def called(row: Row, out: Path, /, **changes: Any) -> Any:
    """The result of a call; what is a context is entered."""
    result = function(row.name)(**arguments(row, out) | changes)
    if row.name in CONTEXTS:
        with result as inner:
            return not isinstance(inner, Path) or inner.exists() or inner.touch()
    return result


def public() -> set[str]:
    """Names in the stubs of the rooms, as the table calls them."""
    names = set()
    for room in (
        "",
        "apps",
        "io",
        "vis",
        "analysis",
        "nlos",
        "sampling",
        "scenes",
        "sensors",
        "scanning",
    ):
        stub = PACKAGE / room / "__init__.pyi"
        if not stub.exists():
            names |= {f"{room}.{name}" for name in function(room).__all__}
            continue
        for node in ast.parse(stub.read_text()).body:
            if isinstance(node, ast.ImportFrom) and node.module:
                names |= {f"{room}.{alias.asname}".lstrip(".") for alias in node.names}
    return names


def rest() -> list[Row]:
    """Calls of the public functions that the table does not name."""
    found: dict[int, Row] = {_key(function(row.name)): row for row in TABLE}
    for name in sorted(public(), key=lambda name: (-name.count("."), name)):
        thing = function(name)
        if callable(thing) and name.rpartition(".")[2] not in LEFT_OUT and not is_plugin(thing):
            found.setdefault(_key(thing), Row(name))
    return [row for row in found.values() if row not in TABLE]


def is_plugin(thing: Any) -> bool:
    rooms = ("integrators", "films", "samplers", "nlos.d")
    kinds = (mi.Integrator, mi.Film, mi.Sampler, mi.Sensor, mi.Emitter, mi.BSDF)
    there = tuple(f"tofrender.{room}" for room in rooms)
    return inspect.isclass(thing) and (
        thing.__module__.startswith(there) or issubclass(thing, kinds)
    )


def _key(thing: Any) -> int:
    return id(getattr(thing, "__func__", thing))


CALLS = [*TABLE, *rest()]


@pytest.mark.filterwarnings("ignore::ResourceWarning")  # Of sockets of distributed
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("row", [pytest.param(r, id=f"{k}-{r.name}") for k, r in enumerate(CALLS)])
def test_good_arguments(row, tmp_path):
    """The calls of the table work, so that what is refused is refused for its own sake."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        called(row, tmp_path)


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize(
    ("row", "name", "kind", "start"),
    [
        pytest.param(row, name, kind, number, id=f"{row.name}-{name}")
        for number, (row, name, kind) in enumerate(
            (row, name, kind) for row in CALLS for name, kind in kinds_of(row).items()
        )
    ],
)
def test_bad_values(row, name, kind, start, tmp_path, monkeypatch, pytestconfig):
    monkeypatch.chdir(tmp_path)
    arguments(row, tmp_path)
    before = listing(tmp_path)
    said = SAID.get(f"{row.name} {name}", SAID.get(name, name))
    values = sample(kind, pytestconfig.getoption("--all-inputs"), start)
    wrong = {}
    for label, value in values.items():
        what = outcome(lambda value=value: called(row, tmp_path, **{name: value}), said, value)
        if listing(tmp_path) != before:
            what = f"{what}; files have changed"
            shutil.rmtree(tmp_path)
            tmp_path.mkdir()
            arguments(row, tmp_path)
        if what:
            wrong[label] = what
    assert not wrong


def test_every_parameter_has_a_kind():
    kinds = [(row.name, *each) for row in CALLS for each in kinds_of(row).items()]
    assert not [each for each in kinds if kind_of(each[-1]) not in bad_inputs.KINDS]
    assert len(CALLS) > 150


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize(
    ("settings", "name"),
    [
        ({"source": "small_box"}, "settings"),
        ({"integrator": "ao"}, "settings"),
        ({"sampler": "independent"}, "settings"),
        ({"width": 0}, "width"),
        ({"start_opl": "far"}, "start_opl"),
        ({"parameters": {"a": 1}}, "a"),
    ],
)
def test_settings_of_a_render(settings, name):
    refused = outcome(lambda: tofrender.render("cornell_box", settings=settings), name)
    assert not refused


@pytest.mark.usefixtures("no_work")
@pytest.mark.filterwarnings("ignore::ResourceWarning")  # Of sockets of distributed
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_client_that_is_closed():
    with tofrender.local_workers(1, threads=1) as client:
        pass
    for call in (
        lambda: tofrender.render("cornell_box", client=client),
        lambda: tofrender.nlos.capture("nlos_plane", client=client),
        lambda: tofrender.nlos.reconstruct(captured(), "bp", client=client),
        lambda: tofrender.nlos.reconstruct(captured(), "lct", client=client),
    ):
        assert not outcome(call, "client")


@pytest.mark.parametrize(
    "changes",
    [{"spp": 0}, {"spp": "4"}, {"complete": None}, {"render_seconds": "long"}, {"seed": 0}],
    ids=str,
)
def test_attributes_of_renders_that_are_joined(changes):
    other = seeded(1).assign_attrs(changes)
    assert not outcome(lambda: tofrender.merge([seeded(0), other]), next(iter(changes)))
