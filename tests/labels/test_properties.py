"""Every public function of labeled data reads it by labels, whatever was done to it before.

The functions are found by the kinds in their annotations. Random sequences of selections, orders of
axes, types, chunks, sums and joined halves come before a call. The result must be that of a fresh
Dataset with the same content in the usual order, which this file makes from plain arrays, or the
call must be refused in one line of our own.
"""

import dataclasses
import functools
import hashlib
import importlib.util
import inspect
import itertools
import json
import re
import shutil
import traceback
import types
import warnings
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
import xarray as xr
from helpers.hidden_scenes import small_capture
from helpers.parts import plane, translate
from helpers.support import camera, scene as described
from matplotlib.animation import FuncAnimation
from matplotlib.figure import Figure

import tofrender
from tofrender import GaussianPulse, io, labels, motion, nlos, sensors
from tofrender.labels import Kind
from tofrender.rendering.labels import labeled

START, WIDTH = 3.375, 0.125
ALL_SEQUENCES = 200  # With --all-inputs
SEQUENCES = 50
SLOW_SEQUENCES = 10
SLOW = {
    *("light_in_flight", "measurement_figure", "plot_pixel_transient", "polarization_figure"),
    *("pyramid_figure", "range_velocity_map", "reconstruction_figure", "save_zarr"),
    *("summary_figure", "velocity_map", "visualize_transient", "fit", "lidar", "render"),
}
"""Functions that take 20 to 200 ms. Most share their reader with faster ones."""

IN_THE_GIVEN_ORDER = {
    *("coates", "coates_variance", "degree_of_polarization", "degree_of_linear_polarization"),
    *("degree_of_circular_polarization", "angle_of_linear_polarization"),
}
"""Functions of DataArrays whose result has the axes and labels of the argument in their order."""

NOT_CALLED = {
    "calibrate": "compares renders with histograms, see test_reading_poses",
}
"""Functions that the property does not fit, with the reason."""

PACKAGES = [
    each
    for name in ("tofrender", *tofrender.__all__)
    if isinstance(each := getattr(tofrender, name, tofrender), types.ModuleType)
]
DASK = importlib.util.find_spec("dask") is not None


def distances(data):
    """Return distances of pixels, by their labels."""
    return 0.02 * data["x"] + 0.05 * (data["y"] - data["y"].min())


VALUES = {
    **{"frequency_hz": 20e6, "bins": 1, "cycles": 50, "response": GaussianPulse(0.08), "seed": 3},
    **{"method": "bp", "progress": False, "distance_m": distances, "min_size": 4},
    **{"record": 1, "scene": "nlos_plane", "truth": lambda data: 1 + distances(data)},
    **{"x": lambda data: int(data["x"].max()), "y": lambda data: int(data["y"].max())},
    "sensor": {"cycles": 50, "photons": {"photons_per_cycle": 0.5}, "spad": {}},
}
"""Values of parameters by their names, or functions that make them of the data."""

OPTIONAL = ("seed", "progress", "min_size")
"""Parameters with a default that get these values as well."""

OPTIONS = {
    "expected_photons": {"photons_per_cycle": 0.5, "background_per_cycle": 0.2},
    "estimate_depth": {"method": "ml"},
    "pyramid_figure": {"opl": 3.55},
    "rebin": {"bins": 1},
    "reconstruction_errors": {"photons_per_cycle": [0.5], "methods": ["bp"], "seeds": 1},
    "save_matlab_capture": {"layout": "fk"},
    "coates": {"cycles": 1000},
    "lidar": {"scene": "cornell_box", "spp": 2},
    "render": {"scene": "cornell_box", "spp": 4, "seed": 3},
    "fit": {
        **{"scene": lambda _: wall_and_lamp(), "params": {"lamp.intensity.value": 3.0}},
        **{"learning_rate": 0.1, "steps": 1, "spp": 2},
    },
}
"""Further parameters of functions, or functions that make them of the data."""

RENDERED = {"size": (4, 3), "bins": 8, "start_opl": START, "bin_width": 0.7}
OPTIONS["render"] |= RENDERED


@functools.cache
def wall_and_lamp():
    """Return a scene whose camera has the pixels and bins of `film`."""
    picture = {
        **{"type": "transient_hdr_film", "width": 9, "height": 8, "rfilter": {"type": "box"}},
        **{"crop_offset_x": 2, "crop_offset_y": 5, "crop_width": 3, "crop_height": 2},
        **{"temporal_bins": 8, "start_opl": START, "bin_width_opl": WIDTH},
    }
    parts = {
        "wall": plane(translate(0, 0, 0), 9),
        "lamp": {"type": "point", "position": [0.2, -0.1, 1.9], "intensity": 2.0},
    }
    sensor = camera((0, 0, 1.9), (0, 0, 0), picture, fov=40)
    return mi.load_dict(described(parts, sensor, max_depth=2))


@functools.cache
def few_samples():
    """Return a render that `render` continues."""
    options = RENDERED | {"spp": 2, "seed": 3, "progress": False}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # The window does not contain all light
        return tofrender.render("cornell_box", **options)


ITOF = sensors.Itof(frequencies_hz=(20e6, 50e6), contrast=0.7)
INSTANCES = {
    "Fmcw": motion.Fmcw(bandwidth_hz=1e9, chirp_s=1e-5, wavelength_m=1.55e-6),
    "MultiZone": dataclasses.replace(sensors.MultiZone.preset("tmf8820"), bins=20),
    "GatedCamera": sensors.GatedCamera(delays_opl=[3.5], width_s=1e-9),
    "Itof": ITOF,
    "Spad": sensors.Spad(),
    "StreakCamera": sensors.StreakCamera(sweep_opl=0.125),
}
LOADERS = {
    "save_npz": (io.load_npz, ".npz"),
    "save_exr_stack": (io.load_exr_stack, ""),
    "save_zarr": (tofrender.load_zarr, ".zarr"),
    "save_capture": (tofrender.load_capture, ".h5"),
    "save_matlab_capture": (tofrender.load_capture, ".mat"),
    "save_point_cloud": (None, ".nc"),
    "save_png_frames": (None, ""),
    "save_video": (None, ".gif"),
    "report": (None, ".html"),
}
"""Readers of the files that functions write, None for bytes, and the suffix of their names."""

PIXELS = {"y": np.arange(5, 7), "x": np.arange(2, 5)}
COLORS = ["R", "G", "B"]


def film(stokes=False, bins=8, halves=False):
    """Return a film of 3 x 2 pixels, with different light everywhere."""
    rng = np.random.default_rng(8)
    shape = (2, 3, bins, 4, 3) if stokes else (2, 3, bins, 3)
    light = rng.gamma(0.5, 1.0, shape).astype(np.float32)
    light[:, :, bins // 2] += 3.0
    dims = ("y", "x", "opl", "stokes", "channel") if stokes else ("y", "x", "opl", "channel")
    steady = light.sum(axis=2) * np.float32(1.25)
    axes = PIXELS | {"opl": START + WIDTH * (np.arange(bins) + 0.5), "channel": COLORS}
    if stokes:
        axes["stokes"] = ["S0", "S1", "S2", "S3"]
    variables = {
        "transient": (dims, light),
        "steady": (tuple(axis for axis in dims if axis != "opl"), steady),
    }
    if halves:
        variables["raw"] = variables["transient"]
        variables["half_difference"] = (dims, (0.1 * rng.standard_normal(shape)).astype("f4"))
        variables["direct"] = (dims, 0 * light)
        features = rng.random((2, 3, FEATURES)).astype(np.float32)
        variables["features"] = (("y", "x", "feature"), features)
    attrs = {
        **{"start_opl": START, "bin_width_opl": WIDTH, "quantity": "radiance per bin"},
        **{"units": "W m^-2 sr^-1", "energy_outside_window": 0.2, "complete": 1, "spp": 16},
        **{"scene": "scene", "seed": 3, "fingerprint": "1", "render_seconds": 0.1},
    }
    return labeled(xr.Dataset(variables, axes, attrs))


FEATURES = 11  # Of a render for `denoise`


def frames():
    """Return two frames."""
    parts = [film(bins=4), film(bins=4) * 2]
    return labeled(xr.concat(parts, xr.DataArray([0.0, 0.5], dims="frame", name="frame")))


def poses():
    """Return renders of three poses."""
    parts = [film(bins=4), film(bins=4) * 2, film(bins=4) * 3]
    made = xr.concat(parts, xr.DataArray([0, 1, 2], dims="pose", name="pose"))
    tangents = {"tan_x": ("x", [0.3, 0.05, -0.2]), "tan_y": ("y", [0.2, -0.1])}
    return labeled(made.assign_coords(tangents))


def pyramid():
    """Return a result of `strategy_pyramid`."""
    light = xr.concat([film(bins=4) * k for k in (1, 2, 3)], "strategy")
    both = xr.concat([light, 2 * light], "weighting").drop_attrs()
    axes = {"weighting": ["mis", "none"], "strategy": ["0,2", "1,1", "0,3"]}
    axes |= {"s": ("strategy", [0, 1, 0]), "t": ("strategy", [2, 1, 3])}
    attrs = {"start_opl": START, "bin_width_opl": WIDTH, "units": "W m^-2 sr^-1", "scene": "s"}
    return labeled(both.assign_coords(axes).assign_attrs(attrs))


def range_rates():
    """Return a result of `range_rate`."""
    rng = np.random.default_rng(4)
    axes = PIXELS | {"opl": 5 + 0.1 * np.arange(4), "rate": 0.1 * np.arange(-1, 2)}
    light = rng.random((2, 3, 4, 3, 3)).astype(np.float32)
    parts = {"radiance": (("y", "x", "opl", "rate", "channel"), light)}
    parts["steady"] = ("y", "x", "channel"), light.sum(axis=(2, 3))
    return xr.Dataset(parts, axes | {"channel": COLORS}, {"units": "W m^-2 sr^-1", "scene": "s"})


def doppler():
    """Return a result of `doppler`."""
    rng = np.random.default_rng(5)
    axes = PIXELS | {"part": ["I", "Q"], "channel": COLORS}
    dims = ("y", "x", "part", "channel")
    parts = {name: (dims, rng.random((2, 3, 2, 3))) for name in ("homodyne", "heterodyne")}
    attrs = {"frequency_hz": 5e7, "exposure_s": 1e-3, "cycles": 1.0, "waveform": "sine"}
    return xr.Dataset(parts, axes, attrs)


def waveforms():
    """Return a result of `lidar` with an echo in each shot."""
    rng = np.random.default_rng(6)
    rate = 0.01 * rng.random((5, 12))
    rate[:, 6] += 3.0
    direction = rng.random((5, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    variables = {
        "rate": (("shot", "bin"), rate),
        "background": ("shot", 0.005 * rng.random(5)),
        "true_range": ("shot", 2 + rng.random(5)),
        "time": ("shot", 1e-5 * np.arange(5)),
        "direction": (("shot", "axis"), direction),
        "origin": ("axis", np.array([1.0, 2.0, 3.0])),
    }
    opl = "bin", START + WIDTH * (np.arange(12) + 0.5)
    axes = {"shot": np.arange(5), "opl": opl, "axis": ["x", "y", "z"]}
    attrs = {"start_opl": START, "bin_width_opl": WIDTH, "pulse_width_opl": 0.1, "scene": "s"}
    return xr.Dataset(variables, axes, attrs | {"max_range": 10.0})


def cloud():
    """Return a result of `point_cloud`."""
    rng = np.random.default_rng(7)
    return xr.Dataset({name: ("point", rng.random(5)) for name in ("x", "y", "z", "intensity")})


def records():
    """Return a data set of two renders."""
    whole = xr.concat([film(bins=4), 2 * film(bins=4)], "record").drop_vars("time")
    about = json.dumps({"render": film(bins=4).attrs})
    axes = {"record": [0, 1], "made_with": ("record", [about] * 2)}
    attrs = {"start_opl": START, "bin_width_opl": WIDTH, "quantity": "radiance per bin"}
    return whole.drop_attrs().assign_coords(axes).assign_attrs(attrs)


def captures():
    """Return a data set of two captures."""
    axes = {"y": "wall_y", "x": "wall_x", "opl": "capture_opl"}
    stored = {}
    for name in ("transient", "sensor_grid", "sensor_normals", "sensor_origin", "laser_origin"):
        values = CAPTURE[name].drop_vars("time", errors="ignore")
        values = values.rename({axis: axes[axis] for axis in axes if axis in values.dims})
        stored["capture" if name == "transient" else f"capture_{name}"] = values
    about = {"scene": "s", "render_seed": 3, "capture": CAPTURE.attrs | {"spp": 4}}
    axes = {"record": [0, 1], "made_with": ("record", [json.dumps(about)] * 2)}
    return xr.concat([xr.Dataset(stored)] * 2, "record").drop_attrs().assign_coords(axes)


def phasors():
    """Return the real and imaginary parts of phasors at two frequencies."""
    axis = xr.IndexVariable("frequency", [2e7, 5e7])
    real = xr.concat([film()["steady"] * k for k in (1, -2)], axis)
    return xr.Dataset({"I": real, "Q": 1 - real})


def sensed(sensor):
    """Return what a sensor measures of a film."""
    photons = {"photons_per_cycle": 0.5}
    return sensors.sense(film(), {"cycles": 90, "photons": photons} | sensor, seed=1)


def depth_errors():
    """Return errors of two methods at three signal levels."""
    axes = ("reconstruction", "photons_per_cycle", "seed")
    rng = np.random.default_rng(4)
    values = {name: (axes, 0.1 + rng.random((2, 3, 2))) for name in ("error", "found")}
    levels = {"reconstruction": ["lct", "bp"], "photons_per_cycle": [0.1, 0.3, 2.0]}
    return xr.Dataset(values, levels | {"seed": [0, 1]})


RATES = sensors.expected_photons(film(bins=12), photons_per_cycle=1.0, background_per_cycle=0.5)
CAPTURE = small_capture().isel(x=slice(3), y=slice(2), opl=slice(8))
EXAMPLES = {
    "BINNED": [RATES["rate"]],
    "CAPTURE": [CAPTURE],
    "CAPTURES": [captures()],
    "CLOUD": [cloud()],
    "COUNTS": [sensed({"spad": {}})],
    "DEPTH_ERRORS": [depth_errors()],
    "DOPPLER": [doppler()],
    "FILM": [film(bins=4), film(stokes=True, bins=4)],
    "FRAMES": [frames()],
    "GATES": [sensed({"gated": {"delays_opl": [3.5, 3.7, 3.9], "width_s": 1e-9}})],
    "IMAGE": [film(stokes=True)["steady"]],
    "LIGHT": [film()["transient"]],
    "PHASORS": [
        xr.concat(
            [film()["steady"] * k for k in (1, -2)], xr.IndexVariable("frequency", [2e7, 5e7])
        )
        .to_dataset(name="I")
        .assign(Q=lambda d: 1 - d["I"])
    ],
    "PATTERN": [tofrender.scan_pattern("raster", shots=(3, 2))],
    "PIXELS": [film()["steady"].isel(channel=0, drop=True) - 3.0],
    "POSES": [poses()],
    "PYRAMID": [pyramid()],
    "RANGE_RATES": [range_rates()],
    "RATES": [RATES],
    "RECORDS": [records()],
    "SPECTRA": [INSTANCES["Fmcw"].spectra(range_rates().isel(y=[0]))],
    "STOKES_VECTORS": [film(stokes=True)["steady"]],
    "STREAK": [sensed({"streak": {"sweep_opl": 0.25}})],
    "TAPS": [sensed({"itof": {"frequencies_hz": [20e6, 50e6], "contrast": 0.7}})],
    "TRANSIENT": [film(), film(stokes=True)],
    "VOLUME": [nlos.reconstruct(CAPTURE, "bp", progress=False).isel(z=slice(4))],
    "WAVEFORMS": [waveforms()],
}
"""Small Datasets of each kind."""

EXAMPLES_OF = {
    "denoise": [film(bins=4, halves=True)],
    "fit": [film()],
    "estimate_depth": [sensors.Spad().histogram(RATES, 900, 1)],
    "echoes": [sensors.Spad().histogram(RATES, 900, 1)],
    "save_matlab_capture": [small_capture().isel(x=slice(3), y=slice(3), opl=slice(8))],
}
"""Those of single functions."""


def metadata_of(annotation):
    """Return what `Annotated` adds to a type, or to a type within it."""
    inner = [each for one in getattr(annotation, "__args__", ()) for each in metadata_of(one)]
    return [*getattr(annotation, "__metadata__", ()), *inner]


def kinds_of(function, parameter):
    """Return the kinds in the annotation of a parameter, and whether it is a sequence of them."""
    annotation = parameter.annotation
    if isinstance(annotation, str):
        found = re.search(r"Annotated\[.*, (\w+)\]", annotation)
        scope = vars(labels) | inspect.unwrap(function).__globals__
        metadata = [found and scope.get(found[1])]
    else:
        metadata = metadata_of(annotation)
    kinds = [each for each in metadata if isinstance(each, Kind | tuple)]
    kinds = kinds[0] if kinds else ()
    return (kinds if isinstance(kinds, tuple) else (kinds,)), "Sequence[" in str(annotation)


def methods_of(name, thing):
    """Return a function, or the methods of a class, by name."""
    if inspect.isfunction(thing):
        return {name: thing}
    if not inspect.isclass(thing):
        return {}
    methods = inspect.getmembers(thing, inspect.isfunction)
    return {f"{name}.{key}": each for key, each in methods if not key.startswith("_")}


def found_functions():
    """Return functions and methods with labeled data as a parameter, with kinds, by name."""
    found = {}
    for package in PACKAGES:
        for name in getattr(package, "__all__", ()):
            for key, function in methods_of(name, getattr(package, name)).items():
                for parameter in inspect.signature(function).parameters.values():
                    kinds, is_sequence = kinds_of(function, parameter)
                    if kinds and key not in NOT_CALLED:
                        found.setdefault(key, (function, kinds, is_sequence))
    return found


FUNCTIONS = found_functions()
NAMES = {
    id(kind): name for name in labels.__all__ if isinstance(kind := getattr(labels, name), Kind)
}


def called(name, data, folder):
    """Call a function, with values of its other parameters by their names."""
    function, _, is_sequence = FUNCTIONS[name]
    owner, _, method = name.rpartition(".")
    if owner:
        function = getattr(INSTANCES[owner], method)
    parameters = list(inspect.signature(function).parameters.values())
    labeled = next(each.name for each in parameters if kinds_of(function, each)[0])
    options = {
        each.name: VALUES[each.name]
        for each in parameters
        if each.name != labeled
        if each.name in VALUES and (each.default is each.empty or each.name in OPTIONAL)
    }
    options |= OPTIONS.get(name, {})
    options = {key: f(data) if inspect.isfunction(f) else f for key, f in options.items()}
    given = [data, data.assign_attrs(seed=4)] if is_sequence else data
    if name in IN_THE_GIVEN_ORDER:
        result = function(**{labeled: given}, **options)
        like = EXAMPLES["BINNED"][0] if "bin" in result.dims else film()["steady"]
        return rebuilt(result, like)
    if name not in LOADERS:
        return function(**{labeled: given}, **options)
    load, suffix = LOADERS[name]
    path = folder / f"file{suffix}"
    try:
        function(given, path, **options)
        if load is not None:
            return load(path).load()
        files = sorted(path.iterdir()) if path.is_dir() else [path]
        return b"".join(each.read_bytes() for each in files)
    finally:
        shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink(missing_ok=True)


def chosen(data, axis, rng):
    """Select labels along an axis in a random order."""
    count = rng.integers(1, data.sizes[axis] + 1)
    return data.isel({axis: rng.permutation(data.sizes[axis])[:count]})


def by_label(data, axis, rng):
    """Select along an axis by its labels, if it has any."""
    if axis not in data.indexes:
        return data
    count = rng.integers(1, data.sizes[axis] + 1)
    return data.sel({axis: rng.permutation(data[axis].values)[:count]})


def sliced(data, axis, rng):
    """Take a part of an axis, or every second entry."""
    first = rng.integers(data.sizes[axis])
    last = rng.integers(first + 1, data.sizes[axis] + 1)
    return data.isel({axis: slice(first, last, rng.integers(1, 3))})


def reversed_along(data, axis, rng):
    return data.isel({axis: slice(None, None, -1)})


def transposed(data, axis, rng):
    return data.transpose(*rng.permutation(list(data.dims)))


def of_type(data, axis, rng):
    return data.astype(["float32", "float64"][rng.integers(2)])


def joined(data, axis, rng):
    """Cut an axis, and join the parts in the other order."""
    if data.sizes[axis] < 2:
        return data
    cut = rng.integers(1, data.sizes[axis])
    halves = [data.isel({axis: slice(cut, None)}), data.isel({axis: slice(cut)})]
    more = {"data_vars": "minimal"} if isinstance(data, xr.Dataset) else {}
    return xr.concat(halves, axis, **more)


def scaled(data, axis, rng):
    return data * 3


def added(data, axis, rng):
    return data + data


def chunked(data, axis, rng):
    return data.chunk({axis: 1})


OPERATIONS = [
    *(chosen, by_label, sliced, sliced, reversed_along, transposed, of_type, joined, scaled, added),
    *[chunked] * DASK,
]
FIXED = ("xyz", "axis", "laser_x", "laser_y", "beat", "feature")
"""Axes along which nothing is chosen."""


@functools.cache
def changed(index, seed):
    """Apply one to three random operations to an example."""
    like = ALL[index]
    rng = np.random.default_rng(seed)
    axes = [axis for axis in like.dims if axis not in FIXED]
    axes += 2 * [axis for axis in axes if axis in ("opl", "bin", "stokes")]
    data = like
    with xr.set_options(keep_attrs=True):
        for _ in range(rng.integers(1, 4)):
            operation = OPERATIONS[rng.integers(len(OPERATIONS))]
            data = operation(data, axes[rng.integers(len(axes))], rng)
    return data


@functools.cache
def usual(index, seed):
    """Return the canonical form of the same data, and a digest of it."""
    found = rebuilt(changed(index, seed), ALL[index])
    return found, fingerprint(found)


ORDERS = {
    **{"channel": ["R", "G", "B", "L"], "stokes": ["S0", "S1", "S2", "S3"]},
    **{"weighting": ["mis", "none"], "part": ["I", "Q"]},
}
GIVEN = ("frame", "strategy", "point", "pose")
"""Axes whose order means something, and stays."""


def rebuilt(data, like):
    """Make data with the same content in the order of `like`, from plain arrays."""
    if isinstance(data, xr.DataArray):
        whole = rebuilt(data.to_dataset(name="array"), like.to_dataset(name="array"))
        return whole["array"].assign_attrs(like.attrs)
    orders, coordinates = {}, {}
    for axis, size in data.sizes.items():
        key = data["opl"].values if axis in ("opl", "bin") and "opl" in data.coords else None
        if key is None and axis in data.coords and axis not in GIVEN:
            key = data[axis].values
        if key is None:
            key = np.arange(size)
        if axis in ORDERS:
            key = [ORDERS[axis].index(str(name)) for name in key]
        orders[axis] = np.argsort(key, kind="stable")
    for name, each in data.coords.items():
        if name != "time" and each.ndim == 1:
            axis = each.dims[0]
            coordinates[name] = (axis, each.values[orders[axis]])
    variables = {}
    for name, each in data.data_vars.items():
        values = each.values
        for number, axis in enumerate(each.dims):
            values = np.take(values, orders[axis], axis=number)
        wanted = like[name].dims
        values = np.moveaxis(values, [each.dims.index(axis) for axis in wanted], range(each.ndim))
        variables[name] = (wanted, np.array(values, order="C"), like[name].attrs)
    made = xr.Dataset(variables, coordinates, like.attrs)
    if "opl" in made.coords and "bin_width_opl" in made.attrs:
        made.attrs["start_opl"] = float(made["opl"][0]) - made.attrs["bin_width_opl"] / 2
    if {"transient", "steady"} <= set(made.data_vars) and "energy_outside_window" in made.attrs:
        first = {"stokes": 0} if "stokes" in made.dims else {}
        light, steady = (float(made[k].isel(first).sum()) for k in ("transient", "steady"))
        made.attrs["energy_outside_window"] = min(max(1 - light / steady, 0.0), 1.0)
    return labeled(made) if "opl" in made.coords else made


def fingerprint(data):
    """Return a digest of all values and labels."""
    parts = data.variables if isinstance(data, xr.Dataset) else {"": data.variable, **data.coords}
    digest = hashlib.sha256()
    for name, each in parts.items():
        digest.update(f"{name}{each.dims}{each.dtype}{each.shape}".encode())
        digest.update(np.asarray(each.values).tobytes())
    return digest.digest()


ALL = [each for examples in (*EXAMPLES.values(), *EXAMPLES_OF.values()) for each in examples]
INDICES = {id(each): index for index, each in enumerate(ALL)}


def is_undefined(data):
    """Whether bins do not follow each other, or polarized light has no intensity."""
    if "stokes" in data.coords and "S0" not in data["stokes"].values:
        return True
    if "opl" not in data.coords or "bin_width_opl" not in data.attrs:
        return False
    steps = np.diff(np.sort(data["opl"].values))
    return not np.allclose(steps, data.attrs["bin_width_opl"], rtol=1e-3)


def arrays_of(result):
    """Return what a function has computed as arrays by name."""
    if isinstance(result, FuncAnimation):
        result._draw_was_started = True  # It would warn that nothing has played it
        result = result._fig
    if isinstance(result, Figure):
        return drawn(result)
    if isinstance(result, bytes):
        return {"bytes": np.frombuffer(result, np.uint8)}
    if hasattr(result, "header"):  # An explorer
        axis, grid = result.header["axis"], result.header["grid"]
        places = [axis["start"], axis["width"], *grid["first"], grid["step"]]
        return {"data": np.frombuffer(result.data, np.uint8), "places": places}
    if isinstance(result, xr.Dataset):
        numbers = [name for name, each in result.variables.items() if each.dtype.kind in "biuf"]
        arrays = {name: result.variables[name] for name in numbers}
        names = ("start_opl", "bin_width_opl", "energy_outside_window")
        return arrays | {name: result.attrs[name] for name in names if name in result.attrs}
    if isinstance(result, xr.DataArray):
        return {"array": result}
    if isinstance(result, tofrender.Fit):
        return {"losses": result.losses, **result.values}
    if dataclasses.is_dataclass(result):
        return dataclasses.asdict(result)
    return dict(enumerate(result if isinstance(result, tuple) else [result]))


def drawn(figure):
    """Return the numbers of a figure."""
    found = {}
    for k, axes in enumerate(figure.axes):
        for n, image in enumerate(axes.images):
            found[f"image {n} of {k}"] = np.ma.filled(image.get_array(), np.nan)
            found[f"extent {n} of {k}"] = image.get_extent()
        for n, line in enumerate(axes.lines):
            found[f"line {n} of {k}"] = line.get_data()
    return found


def outcome(name, data, folder):
    """Return arrays of a call, or the refusal."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return {
                key: np.asarray(each) for key, each in arrays_of(called(name, data, folder)).items()
            }
    except Exception as error:
        return error


def require_own_refusal(error):
    file = Path(traceback.extract_tb(error.__traceback__)[-1].filename)
    assert isinstance(error, ValueError), repr(error)
    assert "\n" not in str(error)
    assert "tofrender" in file.parts, repr(error)


def examples_of(name):
    """Return small Datasets of the kinds that a function takes."""
    if name == "render":
        few = few_samples()
        if id(few) not in INDICES:
            INDICES[id(few)] = len(ALL)
            ALL.append(few)
        return [few]
    own = EXAMPLES_OF.get(name)
    kinds = FUNCTIONS[name][1]
    return own or [each for kind in kinds for each in EXAMPLES[NAMES[id(kind)]]]


def test_datasets_have_a_kind():
    """A parameter that is annotated as a Dataset names its kind, so that its function is found."""
    for package in PACKAGES:
        for name in getattr(package, "__all__", ()):
            for key, function in methods_of(name, getattr(package, name)).items():
                for parameter in inspect.signature(function).parameters.values():
                    if re.search("Dataset|DataArray", str(parameter.annotation)):
                        kinds, _ = kinds_of(function, parameter)
                        assert kinds, f"{key}: annotate {parameter.name} with a kind"


def test_functions_are_found():
    assert {"rebin", "sense", "Spad.histogram", "Itof.depth", "explore"} <= set(FUNCTIONS)
    for name, (_, kinds, _) in FUNCTIONS.items():
        owner, _, _ = name.rpartition(".")
        assert not owner or owner in INSTANCES, f"{name}: add an instance to INSTANCES"
        for kind in kinds:
            assert NAMES[id(kind)] in EXAMPLES, f"{name}: add a Dataset of {kind.name} to EXAMPLES"


@pytest.mark.parametrize("name", EXAMPLES)
def test_xarray_writes_all_kinds_as_netcdf(name, tmp_path):
    """SciPy's writer does not support each name of an attribute."""
    for number, data in enumerate(EXAMPLES[name]):
        path = tmp_path / f"{number}.nc"
        data.to_netcdf(path, engine="scipy")
        loaded = xr.load_dataset(path)
        if isinstance(data, xr.DataArray):
            data = data.to_dataset(name=data.name or "__xarray_dataarray_variable__")
        xr.testing.assert_equal(loaded, data)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_read_labels(name, tmp_path, pytestconfig):
    examples = examples_of(name)
    plain = [outcome(name, each, tmp_path) for each in examples]
    assert not any(isinstance(each, Exception) for each in plain), plain
    accepted = 0
    known = {fingerprint(like): found for like, found in zip(examples, plain, strict=True)}
    count = SLOW_SEQUENCES if name in SLOW else SEQUENCES
    if pytestconfig.getoption("--all-inputs"):
        count = ALL_SEQUENCES
    for number, like in zip(range(count), itertools.cycle(examples), strict=False):
        index = INDICES[id(like)]
        data = changed(index, number)
        found = outcome(name, data, tmp_path)
        if isinstance(found, Exception):
            require_own_refusal(found)
            continue
        assert not is_undefined(data), f"sequence {number}: gaps, or no S0, are accepted"
        canonical, key = usual(index, number)
        if key not in known:
            known[key] = outcome(name, canonical, tmp_path)
        right = known[key]
        assert not isinstance(right, Exception), f"sequence {number}: {right!r}"
        assert found.keys() == right.keys()
        for part, values in right.items():
            np.testing.assert_allclose(
                found[part],
                values,
                rtol=2e-5,
                atol=1e-6,
                err_msg=f"sequence {number}: {part}",
            )
        accepted += 1
    assert accepted > count / 10  # Else the test would say little
