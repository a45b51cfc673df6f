"""Every public function with bad values for each of its parameters: one clear line each."""

from __future__ import annotations

import ast
import functools
import inspect
import shutil
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import mitsuba as mi
import numpy as np
import pytest
import xarray as xr
from helpers.bad_inputs import listing, outcome, sample
from helpers.hidden_scenes import Wall, capture_of, rectangle
from helpers.made_dataset import make_dataset
from oracles import lamp_above_floor

import tofrender
from tofrender import sampling
from tofrender.integrators import passes
from tofrender.nlos import exhaustive
from tofrender.rendering import pieces, strategies

PACKAGE = Path(tofrender.__file__).parent


# ----------------------------------------------------------------------- what the calls are given


@functools.cache
def box() -> mi.Scene:
    window = {"temporal_bins": 20, "start_opl": 3.5, "bin_width_opl": 0.6}
    return tofrender.load_scene("cornell_box", width=4, height=4, spp=1, max_depth=2, **window)


@functools.cache
def wall() -> mi.Scene:
    return tofrender.load_scene("nlos_plane", width=2, height=2, spp=1, optimize=False)


@functools.cache
def plugin(kind: str, name: str) -> Any:
    return mi.load_dict({"type": f"tofrender_{name}"})


@functools.cache
def data() -> xr.Dataset:
    return make_dataset(2, 3, 4, energy_outside_window=0.0)


def seeded(seed: int) -> xr.Dataset:
    return data().assign_attrs(seed=seed, spp=1, complete=1, render_seconds=1.0)


@functools.cache
def captured() -> xr.Dataset:
    return capture_of(rectangle((-0.1, 0.1), (-0.1, 0.1), 1.0, 0.1), Wall(4), bins=24, width=0.05)


@functools.cache
def volume() -> xr.Dataset:
    return tofrender.reconstruct(captured(), "bp", progress=False)


@functools.cache
def pyramid() -> xr.Dataset:
    return tofrender.strategy_pyramid(box(), max_depth=2, spp=1, progress=False)


@functools.cache
def verdict() -> Any:
    return sampling.warp_case("tent").test(samples=2000, resolution=4)


@functools.cache
def drawn() -> Any:
    return tofrender.plot_pixel_transient(CUBE, 0, 0, 1.0, 0.1)


@functools.cache
def record() -> Any:
    return sampling.Sphere((0, 0, 1), 0.1).sample(mi.Point3f(0, 0, 0), mi.Point2f(0.5, 0.5))


def seen() -> Any:
    ray = mi.Ray3f(mi.Point3f(0, 0, 1), mi.Vector3f(0, 0, -1))
    return wall().ray_intersect(ray)


@pytest.fixture(scope="module", autouse=True)
def _forget():
    """Leave no scene behind."""
    yield
    for cached in (box, wall, plugin, data, captured, volume, pyramid, verdict, record):
        cached.cache_clear()


# ------------------------------------------------------------------------------------- the table


class Row(NamedTuple):
    """A call.

    Attributes:
        name: The function or class, as found in `tofrender`.
        good: Arguments with which it works; a folder that is there for each call comes in.
        kinds: What kind of value each parameter takes, see `bad_inputs.KINDS`.
    """

    name: str
    good: Callable[[Path], dict[str, Any]]
    kinds: dict[str, str]


CUBE = np.ones((2, 3, 4, 1))
STOKES = np.ones((2, 3, 4, 3))
PHASOR = {"I": np.ones((2, 3)), "Q": np.ones((2, 3))}
BUCKETS = {name: np.ones((2, 3)) for name in ("B0", "B90", "B180", "B270")}
FILM = {"temporal_bins": 4, "start_opl": 3.5, "bin_width_opl": 2.0}
POINTS = np.array([[[0.0, 0, 0], [1, 0, 0]], [[0, 1, 0], [1, 1, 0]]])
NORMALS = np.broadcast_to([0.0, 0, 1], POINTS.shape)
MADE = {
    "transient": np.ones((2, 2, 4)),
    "mode": "confocal",
    "start_opl": 1.0,
    "bin_width_opl": 0.1,
    "sensor_grid": POINTS,
    "sensor_normals": NORMALS,
}
SIZE = {"width": "count", "height": "count", "spp": "count"}
BINS = {"temporal_bins": "count", "start_opl": "metres but 1e30, 2**40", "bin_width_opl": "width"}
DEPTH = {"max_depth": "depth"}
BOX = SIZE | BINS | DEPTH
SEEDED = {"spp": "count", "seed": "seed"}
KEPT = {"checkpoint": "checkpoint?", "progress": "boolean"}
AXIS = {"start_opl": "metres", "bin_width_opl": "positive"}
SHOWN = {
    "data": "dataset",
    "orders": "mapping? but dict-1, dataset",
    "distance_m": "picture?",
    "title": "label?",
    "megabytes": "positive but 1e30, 2**40",
}
SAVED = {"overwrite": "boolean", "progress": "boolean"}
COMPARED = {"rendered": np.ones((2, 3, 4, 1)), "target": np.ones((2, 3, 4, 1))}
FITTED = {
    "scene": "scene",
    "params": "parameters",
    "target": "cube",
    "integrator": "object?",
    "sensor": "sensor",
    "loss": "choice but type",
    "optimizer": "choice",
    "learning_rate": "positive",
    "bounds": "mapping? but dict-1",
    "steps": "count",
    "spp": "count?",
    "seed": "seed",
    "tolerance": "fraction",
    "patience": "count",
    "callback": "function?",
    "progress": "boolean",
}


def fitted() -> dict[str, Any]:
    return {
        "scene": lamp_above_floor.scene(),
        "params": {lamp_above_floor.POSITION: [0.0, 0.0, 1.0]},
        "target": np.ones((4, 4, 60, 3)),
        "steps": 2,
        "progress": False,
    }


def place_lamp(params: Any, values: dict[str, Any]) -> None:
    params[lamp_above_floor.POSITION] = mi.Point3f(0, 0, values["z"])


def warp(name: str, given: str, **more: Any) -> Row:
    value = {"sample": mi.Point2f, "p": mi.Point2f}.get(given, mi.Vector3f)(0.5)
    kinds = {given: "lanes"} | dict.fromkeys(more, "roughness")
    return Row(f"sampling.{name}", lambda _: {given: value} | more, kinds)


def built_in(name: str, **kinds: str) -> Row:
    return Row(f"scenes.{name}", lambda _: {}, kinds)


def pulse(name: str, **good: Any) -> Row:
    kinds = {
        "width_opl": "pulse-width",
        "frequency_hz": "positive",
        "phase_offset": "number",
        "k": "choice",
        "n_bits": "count",
        "demodulation": "seed",
    }
    extra = {} if "width_opl" in good else {"phase_offset": kinds["phase_offset"]}
    return Row(name, lambda _: good, {key: kinds[key] for key in good} | extra)


TABLE = [
    # ------------------------------------------------------------------------------- rendering
    Row(
        "render",
        lambda _: {"scene": box(), "spp": 1, "progress": False},
        {
            "scene": "source",
            "spp": "count?",
            "seed": "seed",
            "size": "sizes?",
            "bins": "count?",
            "start_opl": "metres?",
            "bin_width": "width?",
            "pulse_width": "pulse-width?",
            "max_depth": "depth?",
            "define": "mapping?",
            "integrator": "choice?",
            "sensor": "sensor",
            "sampler": "choice?",
            "window": "window?",
            "temporal_bins": "count?",
            "workers": "count?",
            "scheduler": "choice?",
            "resume": "dataset?",
            "settings": "mapping?",
            "errors": "boolean",
            "checkpoint": "checkpoint?",
            "out": "file?",
            "client": "object?",
            "progress": "boolean",
        },
    ),
    Row(
        "render",
        lambda _: {"scene": box(), "params": mi.traverse(box()), "spp": 1, "progress": False},
        {
            "scene": "scene",
            "params": "object?",
            "spp": "count?",
            "seed": "seed",
            "integrator": "choice?",
            "sensor": "sensor",
            "progress": "boolean",
        },
    ),
    Row(
        "Checkpoint",
        lambda out: {"path": out / "a.npz"},
        {
            "path": "checkpoint",
            "seconds": "positive",
            "tell": "function",
            "again": "label",
            "resume": "boolean",
        },
    ),
    Row("local_workers", lambda _: {"count": 1}, {"count": "count", "threads": "count?"}),
    Row("merge", lambda _: {"renders": [seeded(0), seeded(1)]}, {"renders": "renders"}),
    Row(
        "strategy_pyramid",
        lambda _: {"scene": box(), "max_depth": 2, "spp": 1, "progress": False},
        {
            "scene": "source",
            "max_depth": "pyramid-depth",
            "mis": "choice",
            "parameters": "mapping?",
            "spp": "count?",
            "seed": "seed",
            "size": "sizes?",
            "sensor": "sensor",
            "window": "window?",
            "bins": "count?",
            "temporal_bins": "count?",
            "progress": "boolean",
        },
    ),
    Row(
        "render_at_time",
        lambda _: {
            "scene": box(),
            "integrator": plugin("integrator", "time_gated_transient_path"),
            "sensor": box().sensors()[0],
            "target_time": 6.0,
            "spp": 1,
        },
        {
            "scene": "scene",
            "integrator": "object",
            "sensor": "object",
            "target_time": "metres",
        }
        | SEEDED
        | KEPT,
    ),
    Row(
        "render_transient",
        lambda _: {
            "scene": box(),
            "integrator": plugin("integrator", "time_gated_transient_path"),
            "sensor": box().sensors()[0],
            "film_config": FILM,
            "spp": 1,
        },
        {"scene": "scene", "integrator": "object", "sensor": "object", "film_config": "config"}
        | SEEDED
        | KEPT,
    ),
    Row(
        "render_single_amcw",
        lambda _: {
            "scene": box(),
            "integrator": modulated(),
            "sensor": box().sensors()[0],
            "spp": 1,
        },
        {"scene": "scene", "integrator": "object", "sensor": "object"} | SEEDED | KEPT,
    ),
    Row(
        "render_amcw_phasor",
        lambda _: {
            "scene": box(),
            "sensor": box().sensors()[0],
            "frequency_hz": 20e6,
            "spp": 1,
        },
        {
            "scene": "scene",
            "sensor": "object",
            "frequency_hz": "frequencies but digits",
            "integrator": "object?",
        }
        | SEEDED
        | KEPT,
    ),
    Row("fit", lambda _: fitted(), FITTED),
    Row(
        "fit",
        lambda _: fitted() | {"apply": place_lamp, "params": {"z": 1.0}},
        {"apply": "function?"},
    ),
    Row(
        "fit",
        lambda _: fitted() | {"loss": "phasor", "frequency_hz": 5e7},
        {"frequency_hz": "frequencies"},
    ),
    Row("l2_loss", lambda _: COMPARED, dict.fromkeys(COMPARED, "cube but flat, 5-axes")),
    Row(
        "wasserstein_loss",
        lambda _: COMPARED,
        dict.fromkeys(COMPARED, "cube") | {"energy_weight": "number"},
    ),
    Row(
        "phasor_loss",
        lambda _: COMPARED | {"frequency_hz": 5e7, "start_opl": 1.0, "bin_width_opl": 0.1},
        dict.fromkeys(COMPARED, "cube") | {"frequency_hz": "frequencies"} | AXIS,
    ),
    Row(
        "load_scene",
        lambda _: {"source": "cornell_box"},
        {
            "source": "source",
            "parameters": "mapping?",
            "optimize": "boolean",
            "width": "count?",
            "height": "count?",
            "temporal_bins": "count?",
            "start_opl": "metres? but 1e30, 2**40",
            "bin_width_opl": "width?",
            "spp": "count?",
            "sampler": "choice?",
            "max_depth": "depth?",
            "integrator": "choice?",
            "pulse_width_opl": "pulse-width?",
        },
    ),
    # ----------------------------------------------------------------------------------- files
    Row(
        "io.save_npz",
        lambda out: {"dataset": data(), "path": out / "a.npz"},
        {"dataset": "dataset", "path": "path but nothing", "overwrite": "boolean"},
    ),
    Row(
        "io.save_exr_stack",
        lambda out: {"dataset": data(), "path": out / "a", "progress": False},
        {"dataset": "dataset", "path": "path", "layout": "choice", "precision": "choice"} | SAVED,
    ),
    Row(
        "io.save_png_frames",
        lambda out: {"dataset": data(), "path": out / "a", "min_size": 4, "progress": False},
        {"dataset": "dataset", "path": "path", "exposure": "positive?", "min_size": "side"} | SAVED,
    ),
    Row(
        "io.save_video",
        lambda out: {"dataset": data(), "path": out / "a.gif", "min_size": 4, "progress": False},
        {
            "dataset": "dataset",
            "path": "file",
            "fps": "rate",
            "exposure": "positive?",
            "min_size": "side",
            "all_bins": "boolean",
            "progress": "boolean",
        },
    ),
    Row(
        "io.save_capture",
        lambda out: {"capture": captured(), "path": out / "a.h5"},
        {"capture": "dataset", "path": "file", "overwrite": "boolean"},
    ),
    Row(
        "io.save_exr_layers",
        lambda out: {"path": out / "a.exr", "layers": {"": np.ones((2, 3, 1))}},
        {"path": "path", "layers": "layers", "attrs": "mapping?"},
    ),
    Row(
        "save_zarr",
        lambda out: {"dataset": data(), "path": out / "a.zarr"},
        {"dataset": "dataset", "path": "file"},
    ),
    Row("load_zarr", lambda out: {"path": saved(out, "a.zarr")}, {"path": "file"}),
    Row("io.load_npz", lambda out: {"path": saved(out, "a.npz")}, {"path": "file"}),
    Row("io.load_exr_stack", lambda out: {"path": saved(out, "a.exr")}, {"path": "file"}),
    Row("io.load_capture", lambda out: {"path": saved(out, "a.h5")}, {"path": "file"}),
    Row(
        "io.check_output",
        lambda out: {"path": out / "a"},
        {
            "path": "path",
            "shape": "shape?",
            "layout": "choice",
            "precision": "choice",
            "overwrite": "boolean",
        },
    ),
    Row(
        "io.output_folder",
        lambda out: {"path": out / "a"},
        {"path": "path", "overwrite": "boolean", "needed_bytes": "seed? but 2**40, 2**32"},
    ),
    Row(
        "io.replacing",
        lambda out: {"path": out / "a"},
        {"path": "path", "folder": "boolean", "needed_bytes": "seed? but 2**40, 2**32"},
    ),
    # ---------------------------------------------------------------------------- the explorer
    Row("explore", lambda _: {"data": data()}, SHOWN),
    Row(
        "report",
        lambda out: {"data": data(), "path": out / "a.html"},
        SHOWN | {"path": "path", "overwrite": "boolean"},
    ),
    # --------------------------------------------------------------------------------- figures
    Row(
        "vis.visualize_transient",
        lambda _: {"data": CUBE, "start_opl": 1.0, "bin_width_opl": 0.1},
        {"data": "cube"} | AXIS,
    ),
    Row(
        "vis.plot_pixel_transient",
        lambda _: {"data": CUBE, "x": 2, "y": 1, "start_opl": 1.0, "bin_width_opl": 0.1},
        {"data": "cube", "x": "pixel", "y": "pixel", "quantity": "choice?"} | AXIS,
    ),
    Row(
        "vis.light_in_flight",
        lambda _: {"data": CUBE, "start_opl": 1.0, "bin_width_opl": 0.1},
        {"data": "cube", "style": "choice", "period_ns": "positive?", "exposure": "positive?"}
        | AXIS,
    ),
    Row(
        "vis.gate_figure",
        lambda _: {"image": np.ones((2, 3, 3)), "opl": 5.9, "pulse_width_opl": 0.03},
        {
            "image": "light",
            "opl": "metres",
            "pulse_width_opl": "positive",
            "exposure": "positive?",
            "title": "label?",
        },
    ),
    Row("vis.figure_style", lambda _: {}, {"theme": "choice?", "width": "inches?"}),
    Row(
        "io.save_figure",
        lambda out: {"figure": drawn(), "path": out / "a.png"},
        {"figure": "object", "path": "path but text, digits, lines", "dpi": "dots"},
    ),
    Row(
        "vis.phasor_panel",
        lambda _: {
            "frequencies_hz": [20e6],
            **{name: np.ones((1, 2, 3, 1)) for name in (*"IQ", "amplitude", "phase", "depth")},
        },
        {
            "frequencies_hz": "frequencies",
            **dict.fromkeys((*"IQ", "amplitude", "phase", "depth"), "panel"),
            "title": "label?",
        },
    ),
    Row(
        "vis.plan_figure",
        lambda _: {"scene": wall()},
        {"scene": "scene", "view": "choice", "laser": "point?", "title": "label?"},
    ),
    Row(
        "vis.pyramid_figure",
        lambda _: {"pyramid": pyramid()},
        {
            "pyramid": "dataset",
            "weighting": "choice",
            "opl": "opl?",
            "stops_per_row": "stops",
            "title": "label?",
        },
    ),
    Row(
        "vis.reconstruction_figure",
        lambda _: {"volume": volume()},
        {"volume": "volume", "threshold": "fraction", "title": "label?"},
    ),
    Row(
        "vis.summary_figure",
        lambda _: {"dataset": data()},
        {"dataset": "dataset", "pixels": "pixels?"},
    ),
    Row("vis.auto_exposure", lambda _: {"values": CUBE}, {"values": "light", "percentile": "cent"}),
    Row(
        "vis.tonemap",
        lambda _: {"values": np.ones((2, 3, 3))},
        {"values": "light", "exposure": "positive?", "percentile": "cent", "shadows": "stops"},
    ),
    Row(
        "vis.polarisation_picture",
        lambda _: {"stokes": STOKES},
        {"stokes": "stokes", "shown": "choice", "exposure": "positive?"},
    ),
    Row(
        "vis.polarisation_figure",
        lambda _: {"stokes": STOKES},
        {"stokes": "stokes", "exposure": "positive?", "title": "label?"},
    ),
    *(
        Row(
            f"analysis.{name}",
            lambda _: {"stokes": STOKES},
            {"stokes": "stokes", "axis": "stokes-axis"},
        )
        for name in (
            *("degree_of_polarisation", "degree_of_linear_polarisation"),
            *("degree_of_circular_polarisation", "angle_of_linear_polarisation"),
        )
    ),
    Row(
        "vis.growing_exposure",
        lambda _: {"values": CUBE},
        {"values": "cube", "share": "fraction", "most_stops": "stops"},
    ),
    Row("vis.lit_bins", lambda _: {"values": CUBE}, {"values": "cube", "stops": "positive"}),
    Row("vis.luminance", lambda _: {"values": np.ones((2, 3))}, {"values": "colours"}),
    Row(
        "vis.Transient",
        lambda _: {"values": CUBE, "start_opl": 1.0, "bin_width_opl": 0.1},
        {"values": "cube", "x0": "integer", "y0": "integer", "quantity": "label"} | AXIS,
    ),
    Row(
        "vis.Transient.of",
        lambda _: {"data": CUBE, "start_opl": 1.0, "bin_width_opl": 0.1},
        {"data": "cube", "quantity": "choice?"} | AXIS,
    ),
    Row(
        "vis.unwarp_camera",
        lambda _: {"dataset": data(), "distance_m": np.ones((2, 3))},
        {"dataset": "dataset", "distance_m": "picture"},
    ),
    Row("vis.verdict_figure", lambda _: {"verdict": verdict()}, {"verdict": "object"}),
    Row(
        "vis.warp_figure",
        lambda _: {"points": np.zeros((2, 4)), "verdict": verdict()},
        {"points": "picture but array-nan", "verdict": "object", "title": "label"},
    ),
    # -------------------------------------------------------------------------------- analysis
    Row(
        "analysis.phasor_parts",
        lambda _: PHASOR | {"frequency_hz": 20e6},
        {
            "I": "panel",
            "Q": "panel",
            "frequency_hz": "frequencies",
        },
    ),
    Row(
        "analysis.sum_channels",
        lambda _: PHASOR | {"frequency_hz": 20e6},
        {
            "I": "panel",
            "Q": "panel",
            "frequency_hz": "frequencies",
        },
    ),
    Row(
        "analysis.transient_to_phasor",
        lambda _: {
            "transient_data": CUBE,
            "frequency_hz": 20e6,
            "start_opl": 1.0,
            "bin_width_opl": 0.1,
        },
        {
            "transient_data": "cube but dataset without pixels",
            "frequency_hz": "frequencies",
            "quantity": "choice?",
        }
        | AXIS,
    ),
    Row(
        "analysis.four_bucket",
        lambda _: PHASOR | {"offset": 4.0},
        {"I": "panel", "Q": "panel", "offset": "offset", "contrast": "share"},
    ),
    Row(
        "analysis.from_four_bucket",
        lambda _: BUCKETS,
        dict.fromkeys(BUCKETS, "panel") | {"contrast": "share"},
    ),
    Row(
        "analysis.multipath_error",
        lambda _: {"depth": np.ones((2, 3)), "true_depth": np.ones((2, 3))},
        {"depth": "panel", "true_depth": "panel", "range_m": "positive?"},
    ),
    Row(
        "analysis.true_normals", lambda _: {"scene": box()}, {"scene": "source", "sensor": "sensor"}
    ),
    Row("analysis.true_depth", lambda _: {"scene": box()}, {"scene": "source", "sensor": "sensor"}),
    Row(
        "analysis.unambiguous_range",
        lambda _: {"frequency_hz": 20e6},
        {"frequency_hz": "frequencies"},
    ),
    Row(
        "analysis.unwrap",
        lambda _: {"phases": np.ones((2, 2, 3)), "frequencies_hz": [20e6, 30e6]},
        {
            "phases": "panel but array-nan",
            "frequencies_hz": "frequencies",
            "max_depth": "positive?",
            "amplitudes": "panel?",
        },
    ),
    # ------------------------------------------------------------------------ around the corner
    Row(
        "nlos.capture",
        lambda _: {"scene": wall(), "spp": 1, "progress": False},
        {
            "scene": "source",
            "mode": "choice",
            "grid": "sizes?",
            "spp": "count?",
            "seed": "seed",
            "sensor": "sensor",
            "relay_wall": "shapes?",
            "checkpoint": "checkpoint?",
            "client": "object?",
            "progress": "boolean",
        },
    ),
    Row(
        "nlos.focus_laser",
        lambda _: {"scene": wall(), "pixel": (0, 0)},
        {"scene": "scene", "pixel": "pair?", "sensor": "sensor"},
    ),
    Row("nlos.focus_laser", lambda _: {"scene": wall(), "point": (0, 0, 0)}, {"point": "point?"}),
    Row("nlos.focus_laser", lambda _: {"scene": wall(), "uv": (0.5, 0.5)}, {"uv": "pair?"}),
    Row(
        "nlos.make_capture",
        lambda _: MADE,
        {
            "transient": "cube",
            "mode": "choice",
            "sensor_grid": "picture",
            "sensor_normals": "picture",
            "laser_grid": "picture?",
            "laser_normals": "picture?",
            "sensor_origin": "place?",
            "laser_origin": "place?",
            "counts_first_and_last_legs": "boolean but 1, 0",
            "on_wall": "mask?",
            "attrs": "mapping?",
        }
        | AXIS,
    ),
    Row("nlos.check_capture", lambda _: {"dataset": captured()}, {"dataset": "dataset"}),
    Row(
        "nlos.without_first_and_last_legs",
        lambda _: {"capture": captured()},
        {"capture": "dataset"},
    ),
    Row(
        "nlos.reconstruct",
        lambda _: {"capture": captured(), "method": "bp", "progress": False},
        {
            "capture": "dataset",
            "method": "choice",
            "volume": "voxels? but nan",
            "weighting": "choice?",
            "client": "object?",
            "progress": "boolean",
        },
    ),
    Row(
        "nlos.reconstruct",
        lambda _: {"capture": captured(), "method": "lct", "progress": False},
        {"surface": "choice?", "snr": "positive?"},
    ),
    Row(
        "nlos.reconstruct",
        lambda _: {"capture": captured(), "method": "phasor", "progress": False},
        {"wavelength": "positive?", "cycles": "positive?"},
    ),
    Row("nlos.max_projection", lambda _: {"volume": volume()}, {"volume": "volume"}),
    Row(
        "nlos.depth_map",
        lambda _: {"volume": volume()},
        {"volume": "volume", "threshold": "fraction"},
    ),
    Row(
        "nlos.depth_error",
        lambda _: {"volume": volume(), "truth": np.ones((4, 4))},
        {"volume": "volume", "truth": "picture", "threshold": "fraction"},
    ),
    Row(
        "nlos.hidden_depth",
        lambda _: {"scene": wall(), "where": captured()},
        {"scene": "source", "where": "dataset", "hidden_shapes": "shapes?"},
    ),
    Row(
        "nlos.VolumeGrid",
        lambda _: dict.fromkeys("xyz", (0.5, 1.0, 2)),
        dict.fromkeys("xyz", "axis"),
    ),
    Row(
        "nlos.VolumeGrid.of", lambda _: {"value": [(0.5, 1.0, 2)] * 3}, {"value": "voxels but nan"}
    ),
    Row("find_relay_wall", lambda _: {"scene": wall()}, {"scene": "scene", "wall": "shapes"}),
    Row(
        "is_on_relay_wall",
        lambda _: {"si": seen(), "relay_wall_shapes": wall().shapes()[:1]},
        {"si": "object", "relay_wall_shapes": "object"},
    ),
    # --------------------------------------------------------------------------------- signals
    pulse("AMCWPulse", frequency_hz=20e6),
    pulse("SquareWave", frequency_hz=20e6),
    pulse("HamiltonianCode", k=3, frequency_hz=20e6, demodulation=0),
    pulse("MSequence", n_bits=4, frequency_hz=20e6),
    pulse("GaussianPulse", width_opl=0.1),
    pulse("BoxPulse", width_opl=0.1),
    Row(
        "SampledPulse",
        lambda _: {"values": [1.0, 2.0], "start_opl": 0.0, "bin_width_opl": 0.1},
        {"values": "energies", "start_opl": "metres", "bin_width_opl": "pulse-width"},
    ),
    Row("SampledPulse.from_file", lambda out: {"path": saved(out, "a.csv")}, {"path": "file"}),
    Row("opl_to_ns", lambda _: {"opl": 1.0}, {"opl": "length"}),
    Row("ns_to_opl", lambda _: {"time_ns": 1.0}, {"time_ns": "length"}),
    # -------------------------------------------------------------------------------- sampling
    Row("sampling.grid", lambda _: {"count": 4}, {"count": "count"}),
    Row("sampling.independent", lambda _: {"count": 4}, {"count": "count", "seed": "seed"}),
    Row("sampling.stratified", lambda _: {"count": 4}, {"count": "count", "seed": "seed"}),
    Row(
        "sampling.point_set",
        lambda _: {"kind": "grid", "count": 4},
        {"kind": "choice", "count": "count"},
    ),
    Row(
        "sampling.point_set",
        lambda _: {"kind": "independent", "count": 4},
        {"seed": "seed"},
    ),
    Row("sampling.warp_case", lambda _: {"name": "tent"}, {"name": "choice"}),
    Row("warptest", lambda _: {"subject": "tent"}, {"subject": "choice", "module": "file?"}),
    Row(
        "sampling.warp_case",
        lambda _: {"name": "beckmann", "alpha": 0.3},
        {"alpha": "roughness"},
    ),
    Row(
        "sampling.warp_case",
        lambda _: {"name": "hierarchical", "image": np.ones((2, 2))},
        {"image": "image"},
    ),
    Row(
        "sampling.bsdf_case",
        lambda _: {"bsdf": {"type": "diffuse"}, "wi": (0, 0, 1)},
        {"bsdf": "object", "wi": "point", "uv": "pair", "name": "label"},
    ),
    Row(
        "sampling.light_case",
        lambda _: {"light": sampling.Sphere(), "o": (0, 0, 4)},
        {"light": "object", "o": "point", "name": "label"},
    ),
    Row(
        "sampling.chi_square_suite",
        lambda _: {"cases": [sampling.warp_case("tent")], "samples": 1000, "resolution": 4},
        {
            "cases": "object",
            "alpha": "chance",
            "samples": "samples",
            "resolution": "resolution",
            "seed": "seed",
        },
    ),
    Row(
        "sampling.chi_square_test",
        lambda _: {
            "sample": sampling.square_to_tent,
            "pdf": sampling.square_to_tent_pdf,
            "domain": "plane",
            "samples": 1000,
            "resolution": 4,
        },
        {
            "sample": "function",
            "pdf": "function",
            "domain": "choice",
            "samples": "samples",
            "resolution": "resolution",
            "seed": "seed",
            "alpha": "chance",
            "tests": "count",
            "name": "label",
            "sample_dimension": "count",
            "expected_moments": "mapping? but dict-1",
            "figure": "figure?",
        },
    ),
    Row(
        "sampling.Case",
        lambda _: {
            "sample": sampling.square_to_tent,
            "pdf": sampling.square_to_tent_pdf,
            "domain": "plane",
        },
        {
            "sample": "function",
            "pdf": "function",
            "domain": "choice",
            "name": "label",
            "sample_dimension": "count",
            "expected_moments": "mapping? but dict-1",
        },
    ),
    Row("sampling.EnvironmentWarp", lambda _: {"image": np.ones((4, 4))}, {"image": "image"}),
    Row("sampling.HierarchicalWarp", lambda _: {"image": np.ones((2, 2))}, {"image": "image"}),
    Row(
        "sampling.Quad",
        lambda _: {"size": (1, 2)},
        {"size": "pair", "emission": "colour", "transform": "matrix?"},
    ),
    Row(
        "sampling.Quad.from_edges",
        lambda _: {"corner": (0, 0, 0), "e0": (1, 0, 0), "e1": (0, 1, 0)},
        {"corner": "point", "e0": "point", "e1": "point", "emission": "colour"},
    ),
    Row(
        "sampling.Triangle",
        lambda _: {"v0": (0, 0, 0), "v1": (1, 0, 0), "v2": (0, 1, 0)},
        {"v0": "point", "v1": "point", "v2": "point", "emission": "colour"},
    ),
    Row(
        "sampling.Sphere",
        lambda _: {},
        {
            "centre": "point",
            "radius": "positive but 1e30, 2**40",
            "emission": "colour",
            "transform": "matrix?",
            "flip_normals": "boolean",
        },
    ),
    Row("sampling.SurfaceGroup", lambda _: {"shapes": [sampling.Sphere()]}, {"shapes": "object"}),
    Row("sampling.emitters_of", lambda _: {"scene": box()}, {"scene": "scene"}),
    Row(
        "sampling.visible",
        lambda _: {"scene": box(), "record": record()},
        {"scene": "scene", "record": "object", "n": "lanes?"},
    ),
    Row(
        "sampling.sample_triangle",
        lambda _: {
            "v0": (0, 0, 0),
            "v1": (1, 0, 0),
            "v2": (0, 1, 0),
            "sample": mi.Point2f(0.5, 0.5),
        },
        {"v0": "point", "v1": "point", "v2": "point", "sample": "lanes"},
    ),
    Row(
        "sampling.sample_triangle_pdf",
        lambda _: {"p": mi.Point3f(0), "v0": (0, 0, 0), "v1": (1, 0, 0), "v2": (0, 1, 0)},
        {"p": "lanes", "v0": "point", "v1": "point", "v2": "point"},
    ),
    Row(
        "sampling.sample_sphere_cap",
        lambda _: {"sample": mi.Point2f(0.5), "cos_theta_max": 0.5},
        {"sample": "lanes", "cos_theta_max": "cosine"},
    ),
    Row(
        "sampling.sample_sphere_cap_pdf",
        lambda _: {"v": mi.Vector3f(0, 0, 1), "cos_theta_max": 0.5},
        {"v": "lanes", "cos_theta_max": "cosine"},
    ),
    warp("square_to_tent", "sample"),
    warp("square_to_tent_pdf", "p"),
    warp("square_to_uniform_disk", "sample"),
    warp("square_to_uniform_disk_pdf", "p"),
    warp("square_to_uniform_sphere", "sample"),
    warp("square_to_uniform_sphere_pdf", "v"),
    warp("square_to_uniform_hemisphere", "sample"),
    warp("square_to_uniform_hemisphere_pdf", "v"),
    warp("square_to_cosine_hemisphere", "sample"),
    warp("square_to_cosine_hemisphere_pdf", "v"),
    warp("square_to_beckmann", "sample", alpha=0.3),
    warp("square_to_beckmann_pdf", "m", alpha=0.3),
    # ---------------------------------------------------------------------------------- scenes
    built_in("bust_ao", **SIZE),
    built_in("bust_simple", **SIZE),
    built_in("caustic", **BOX, integrator="choice", lamp_radius="radius"),
    built_in("cornell_box", **BOX | {"start_opl": "metres? but 1e30, 2**40"}, light="choice"),
    built_in("cornell_box_steady_state", **SIZE | DEPTH, light="choice"),
    *(
        built_in(name, **BOX, integrator="choice", sigma_t="extinction")
        for name in ("cornell_box_fog", "headlight_in_fog", "lamp_in_milk", "smoke_corridor")
    ),
    built_in("brewster_window", **BOX, integrator="choice", polariser="turn"),
    built_in("strained_mirror_corridor", **BOX, integrator="choice", angle="turn"),
    built_in("nlos_behind_fog", **SIZE, sigma_t="extinction", occluder="boolean"),
    built_in("lamp_in_fixture", **BOX, integrator="choice"),
    built_in("light_through_hole", **BOX, integrator="choice", hole_width="radius"),
    built_in("mirror_and_glass", **BOX, integrator="choice", lamp_radius="radius"),
    built_in("small_box", **SIZE, integrator="choice", max_bounces="bounces", spheres="choice"),
    built_in("veach", **SIZE, integrator="choice", max_bounces="bounces"),
    *(
        built_in(f"cornell_box_{kind}", temporal_bins="count", start_opl="metres?")
        for kind in ("flash", "glass", "mirror")
    ),
    built_in("nlos_bunny", **SIZE, distance="distance", occluder="boolean"),
    built_in("nlos_z", **SIZE, distance="distance", occluder="boolean"),
    built_in("nlos_plane", distance="distance", half_width="distance", occluder="boolean"),
    built_in("nlos_patch", side="distance", position="point", tilt="number", occluder="boolean"),
    *(
        built_in(name, width="count")
        for name in (
            *("ourbox_confocal", "wall_box_behind", "wall_box_hi_nlos"),
            *("wall_box_sphere_nlos", "wall_box_spheres_nlos"),
            *("rectangle_light_quad", "rectangle_light_triangles"),
            *("sphere_light_small", "sphere_light_medium", "sphere_light_large"),
        )
    ),
    Row("scenes.describe", lambda _: {"name": "cornell_box"}, {"name": "choice"}),
    # ------------------------------------------------------------------------------- endpoints
    *(
        Row(
            name,
            lambda _: {"scene": box()},
            {
                "scene": "scene",
                "sensor": "object?",
                "hide_emitters": "boolean",
                "discard_direct_light": "boolean",
                "light_samples": "light-samples",
            },
        )
        for name in ("ConnectionsOnly", "EmitterHits", "OneSampleLights", "SceneLights")
    ),
    Row(
        "OpenSky",
        lambda _: {"scene": box()},
        {"scene": "scene", "sensor": "object?", "hide_emitters": "boolean"},
    ),
    Row(
        "PointSource",
        lambda _: {"scene": box(), "emitter": mi.load_dict({"type": "point"})},
        {"scene": "scene", "emitter": "object", "hide_emitters": "boolean"},
    ),
    Row(
        "GatedLights",
        lambda _: {"scene": box(), "sensor": None, "gate": lambda opl: opl},
        {
            "scene": "scene",
            "sensor": "object?",
            "gate": "function",
            "hide_emitters": "boolean",
            "discard_direct_light": "boolean",
        },
    ),
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

LEFT_OUT = {
    "MultipathError": "a result",
    "DepthError": "a result",
    "Fit": "a result",
    "Moment": "a result",
    "Verdict": "a result",
    "SuiteVerdict": "a result",
    "EmitterRecord": "a result",
    "Warp": "a row of the table WARPS",
    "make_dataset": "tests/datasets has its table",
    "load_dataset": "tests/datasets has its table",
}
"""Public classes that nobody makes, and functions with tables of their own."""


@functools.cache
def modulated() -> Any:
    integrator = mi.load_dict({"type": "tofrender_amcw_transient_path"})
    integrator.set_modulation(tofrender.AMCWPulse(20e6))
    return integrator


def saved(folder: Path, name: str) -> Path:
    """A file that can be read."""
    path = folder / name
    if path.exists():
        return path
    if path.suffix == ".h5":
        return tofrender.save_capture(captured(), path)
    if path.suffix == ".csv":
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


def called(row: Row, out: Path, /, **changes: Any) -> Any:
    """The result of a call; what is a context is entered."""
    result = function(row.name)(**row.good(out) | changes)
    if row.name in ("io.output_folder", "io.replacing", "local_workers", "vis.figure_style"):
        with result as inner:
            return not isinstance(inner, Path) or inner.exists() or inner.touch()
    return result


# ------------------------------------------------------------------------------------- the tests


@pytest.fixture
def no_work(monkeypatch):
    """Fail if rendering starts."""

    def never(*_, **__):
        raise AssertionError("work has started")

    pyramid()
    for module in (pieces, strategies, exhaustive, passes):
        monkeypatch.setattr(module, "steps", never)
    monkeypatch.setattr(passes, "expose", never)
    monkeypatch.setattr(tofrender.TransientHDRFilm, "prepare", never)


@pytest.mark.filterwarnings("ignore::ResourceWarning")  # Of sockets of distributed
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("row", [pytest.param(r, id=f"{k}-{r.name}") for k, r in enumerate(TABLE)])
def test_good_arguments(row, tmp_path):
    """The calls of the table work, so that what is refused is refused for its own sake."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        called(row, tmp_path)


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize(
    ("row", "name", "start"),
    [
        pytest.param(row, name, number, id=f"{row.name}-{name}")
        for number, (row, name) in enumerate((row, name) for row in TABLE for name in row.kinds)
    ],
)
def test_bad_values(row, name, start, tmp_path, monkeypatch, pytestconfig):
    """Each is refused in one clear line, and nothing is written."""
    monkeypatch.chdir(tmp_path)
    row.good(tmp_path)
    before = listing(tmp_path)
    key = f"{row.name} {name}"
    said = SAID.get(key, SAID.get(name, name))
    values = sample(row.kinds[name], pytestconfig.getoption("--all-inputs"), start)
    wrong = {}
    for label, value in values.items():
        what = outcome(lambda value=value: called(row, tmp_path, **{name: value}), said, value)
        if listing(tmp_path) != before:
            what = f"{what}; files have changed"
            shutil.rmtree(tmp_path)
            tmp_path.mkdir()
            row.good(tmp_path)
        if what:
            wrong[label] = what
    assert not wrong


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


def public() -> set[str]:
    """Names in the stubs of the rooms, as the table calls them."""
    names = set()
    for room in ("", "apps", "io", "vis", "analysis", "nlos", "sampling", "scenes"):
        stub = PACKAGE / room / "__init__.pyi"
        if not stub.exists():
            names |= {f"{room}.{name}" for name in function(room).__all__}
            continue
        for node in ast.parse(stub.read_text()).body:
            if isinstance(node, ast.ImportFrom) and node.module:
                names |= {f"{room}.{alias.asname}".lstrip(".") for alias in node.names}
    return names


def test_the_table_has_every_public_function():
    """And every parameter of each."""
    rows: dict[int, dict[str, str]] = {}
    for row in TABLE:
        rows.setdefault(_key(function(row.name)), {}).update(row.kinds)
    missing = []
    for name in sorted(public()):
        thing = function(name)
        base = name.rpartition(".")[2]
        is_plugin = inspect.isclass(thing) and thing.__module__.startswith(
            ("tofrender.integrators", "tofrender.films", "tofrender.samplers", "tofrender.nlos.d")
        )
        if not callable(thing) or base in LEFT_OUT or is_plugin or issubclass_of_plugin(thing):
            continue
        kinds = rows.get(_key(thing))
        if kinds is None:
            missing.append(name)
            continue
        for parameter in inspect.signature(thing).parameters.values():
            fixed = parameter.kind not in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL)
            if fixed and parameter.name not in kinds:
                missing.append(f"{name}({parameter.name})")
    assert not missing


def issubclass_of_plugin(thing: Any) -> bool:
    kinds = (mi.Integrator, mi.Film, mi.Sampler, mi.Sensor, mi.Emitter, mi.BSDF)
    return inspect.isclass(thing) and issubclass(thing, kinds)


def _key(thing: Any) -> int:
    return id(getattr(thing, "__func__", thing))
