"""Every public function of labeled data reads it by labels, whatever was done to it before.

The functions are found by the kinds in their annotations. Random sequences of selections, orders of
axes, types and joined halves come before a call. The result must be that of a fresh Dataset with
the same content in the usual order, which this file makes from plain arrays, or the call must be
refused in one line of our own.
"""

import inspect
import itertools
import re
import shutil
import traceback
import warnings
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from helpers.hidden_scenes import small_capture

import tofrender
from tofrender import GaussianPulse, analysis, datasets, io, labels, nlos, sensors
from tofrender.labels import Kind
from tofrender.rendering.labels import labelled

START, WIDTH = 3.375, 0.125
SEQUENCES = 200
FEWER = {"save_zarr": 20}  # It takes a quarter of a second, and shares its reader with save_npz
PACKAGES = (tofrender, analysis, datasets, io, nlos, sensors)

VALUES = {
    **{"frequency_hz": 20e6, "bins": 1, "cycles": 50, "response": GaussianPulse(0.08), "seed": 3},
    **{"method": "bp", "progress": False},
    "sensor": {"cycles": 50, "photons": {"photons_per_cycle": 0.5}, "spad": {}},
}
"""Values of parameters by their names."""

OPTIONS = {
    "expected_photons": {"photons_per_cycle": 0.5, "background_per_cycle": 0.2},
    "estimate_depth": {"method": "ml"},
    "rebin": {"bins": 1},
}
"""Further parameters of functions."""

ITOF = sensors.Itof(frequencies_hz=(20e6, 50e6), contrast=0.7)
INSTANCES = {
    "Spad": sensors.Spad(),
    "Itof": ITOF,
    "GatedCamera": sensors.GatedCamera(delays_opl=[3.5], width_s=1e-9),
    "StreakCamera": sensors.StreakCamera(sweep_opl=0.125),
}
LOADERS = {
    "save_npz": (io.load_npz, ".npz"),
    "save_exr_stack": (io.load_exr_stack, ""),
    "save_zarr": (tofrender.load_zarr, ".zarr"),
    "save_capture": (tofrender.load_capture, ".h5"),
}
"""What reads the files of functions that write some, and the suffix of their names."""


def film(stokes=False, bins=12):
    """Return a film of 4 x 3 pixels, with different light everywhere."""
    rng = np.random.default_rng(8)
    shape = (3, 4, bins, 4, 3) if stokes else (3, 4, bins, 3)
    light = rng.gamma(0.5, 1.0, shape).astype(np.float32)
    light[:, :, bins // 2] += 3.0
    dims = ("y", "x", "opl", "stokes", "channel") if stokes else ("y", "x", "opl", "channel")
    steady = light.sum(axis=2) * np.float32(1.25)
    axes = {
        "y": np.arange(5, 8),
        "x": np.arange(2, 6),
        "opl": START + WIDTH * (np.arange(bins) + 0.5),
        "channel": ["R", "G", "B"],
    }
    if stokes:
        axes["stokes"] = ["S0", "S1", "S2", "S3"]
    variables = {
        "transient": (dims, light),
        "steady": (tuple(axis for axis in dims if axis != "opl"), steady),
    }
    attrs = {
        **{"start_opl": START, "bin_width_opl": WIDTH, "quantity": "radiance per bin"},
        **{"units": "W m^-2 sr^-1", "energy_outside_window": 0.2},
    }
    return labelled(xr.Dataset(variables, axes, attrs))


RATES = sensors.expected_photons(film(), photons_per_cycle=1.0, background_per_cycle=0.5)
COUNTS = sensors.Spad().histogram(RATES, 900, 1)
EXAMPLES = {
    id(labels.FILM): [film(bins=4), film(stokes=True, bins=4)],
    id(labels.TRANSIENT): [film(), film(stokes=True)],
    id(labels.RATES): [RATES],
    id(labels.COUNTS): [COUNTS.isel(x=slice(3))],
    id(labels.TAPS): [ITOF.frames(RATES, 50, 1)],
    id(labels.CAPTURE): [small_capture().isel(x=slice(3), y=slice(2), opl=slice(8))],
}
"""Small Datasets of each kind."""


def kind_of(function, parameter):
    """Return the kind in the annotation of a parameter, or None."""
    annotation = parameter.annotation
    if isinstance(annotation, str):
        found = re.search(r"Annotated\[.*, (\w+)\]", annotation)
        kind = found and inspect.unwrap(function).__globals__.get(found[1])
        return kind if isinstance(kind, Kind) else None
    kinds = [each for each in getattr(annotation, "__metadata__", ()) if isinstance(each, Kind)]
    return kinds[0] if kinds else None


def found_functions():
    """Return functions and methods with labeled data as their first parameter, by name."""
    found = {}
    for package in PACKAGES:
        for name in package.__all__:
            thing = getattr(package, name)
            methods = {name: thing} if inspect.isfunction(thing) else {}
            if inspect.isclass(thing):
                methods = {
                    f"{name}.{key}": each
                    for key, each in inspect.getmembers(thing, inspect.isfunction)
                    if not key.startswith("_") and name in INSTANCES
                }
            for key, function in methods.items():
                for parameter in inspect.signature(function).parameters.values():
                    kind = kind_of(function, parameter)
                    if kind is not None:
                        found[key] = function, kind
    return found


FUNCTIONS = found_functions()


def called(name, data, folder):
    """Call a function, with values of its other parameters by their names."""
    function, _ = FUNCTIONS[name]
    owner, _, method = name.rpartition(".")
    if owner:
        function = getattr(INSTANCES[owner], method)
    parameters = list(inspect.signature(function).parameters.values())
    options = {
        each.name: VALUES[each.name]
        for each in parameters[1:]
        if each.name in VALUES and (each.default is each.empty or each.name in ("seed", "progress"))
    }
    options |= OPTIONS.get(name, {})
    if name not in LOADERS:
        return function(data, **options)
    load, suffix = LOADERS[name]
    path = folder / f"file{suffix}"
    try:
        function(data, path, **options)
        return load(path).load()
    finally:
        shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink(missing_ok=True)


def changed(data, rng):
    """Apply one to three random operations."""
    axes = [axis for axis in data.dims if axis not in ("xyz", "laser_x", "laser_y")]
    for _ in range(rng.integers(1, 4)):
        axis = axes[rng.integers(len(axes))]
        size = data.sizes[axis]
        kind = rng.integers(6)
        if kind == 0:
            chosen = rng.permutation(size)[: rng.integers(1, size + 1)]
            data = data.isel({axis: chosen})
        elif kind == 1:
            first = rng.integers(size)
            last = rng.integers(first + 1, size + 1)
            data = data.isel({axis: slice(first, last, rng.integers(1, 3))})
        elif kind == 2:
            data = data.isel({axis: slice(None, None, -1)})
        elif kind == 3:
            data = data.transpose(*rng.permutation(list(data.dims)))
        elif kind == 4:
            data = data.astype(["float32", "float64"][rng.integers(2)])
        elif size > 1:
            cut = rng.integers(1, size)
            halves = [data.isel({axis: slice(cut, None)}), data.isel({axis: slice(cut)})]
            data = xr.concat(halves, axis, data_vars="minimal")
    return data


ORDERS = {"channel": ["R", "G", "B", "L"], "stokes": ["S0", "S1", "S2", "S3"]}


def rebuilt(data, like):
    """Make a Dataset with the same content in the order of `like`, from plain arrays."""
    orders, coordinates = {}, {}
    for axis, size in data.sizes.items():
        key = data["opl"].values if axis in ("opl", "bin") and "opl" in data.coords else None
        if key is None and axis in data.coords:
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
    if "opl" in made.coords:
        made.attrs["start_opl"] = float(made["opl"][0]) - made.attrs["bin_width_opl"] / 2
    if {"transient", "steady"} <= set(made.data_vars):
        first = {"stokes": 0} if "stokes" in made.dims else {}
        light, steady = (float(made[k].isel(first).sum()) for k in ("transient", "steady"))
        made.attrs["energy_outside_window"] = min(max(1 - light / steady, 0.0), 1.0)
    return labelled(made)


def has_gaps(data):
    """Whether bins do not follow each other."""
    if "opl" not in data.coords:
        return False
    steps = np.diff(np.sort(data["opl"].values))
    return not np.allclose(steps, data.attrs["bin_width_opl"], rtol=1e-3)


def arrays_of(result):
    """Return what a function has computed as arrays by name."""
    if isinstance(result, xr.Dataset):
        numbers = [name for name, each in result.variables.items() if each.dtype.kind in "biuf"]
        arrays = {name: result.variables[name] for name in numbers}
        names = ("start_opl", "bin_width_opl", "energy_outside_window")
        return arrays | {name: result.attrs[name] for name in names if name in result.attrs}
    if isinstance(result, xr.DataArray):
        return {"array": result}
    return dict(enumerate(result if isinstance(result, tuple) else [result]))


def outcome(name, data, folder):
    """Return arrays of a call, or the refusal."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return arrays_of(called(name, data, folder))
    except Exception as error:
        return error


def require_own_refusal(error):
    file = Path(traceback.extract_tb(error.__traceback__)[-1].filename)
    assert isinstance(error, ValueError), repr(error)
    assert "\n" not in str(error)
    assert "tofrender" in file.parts, repr(error)


def test_functions_are_found():
    assert {"rebin", "sense", "Spad.histogram", "Itof.depth"} <= set(FUNCTIONS)
    for name, (_, kind) in FUNCTIONS.items():
        assert id(kind) in EXAMPLES, f"{name}: add a small Dataset of its kind to EXAMPLES"


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_read_labels(name, tmp_path):
    examples = EXAMPLES[id(FUNCTIONS[name][1])]
    plain = [outcome(name, each, tmp_path) for each in examples]
    assert not any(isinstance(each, Exception) for each in plain), plain
    accepted = 0
    count = FEWER.get(name, SEQUENCES)
    for number, like in zip(range(count), itertools.cycle(examples), strict=False):
        data = changed(like, np.random.default_rng(number))
        found = outcome(name, data, tmp_path)
        if isinstance(found, Exception):
            require_own_refusal(found)
            continue
        assert not has_gaps(data), f"sequence {number}: bins with gaps are accepted"
        right = outcome(name, rebuilt(data, like), tmp_path)
        assert not isinstance(right, Exception), f"sequence {number}: {right!r}"
        assert found.keys() == right.keys()
        for key, values in right.items():
            np.testing.assert_allclose(
                np.asarray(found[key]),
                np.asarray(values),
                rtol=2e-5,
                atol=1e-6,
                err_msg=f"sequence {number}: {key}",
            )
        accepted += 1
    assert accepted > count / 10  # Else the test would say little
