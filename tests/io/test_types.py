"""Each writer stores the values of each type, or refuses the type before it writes a file."""

import numpy as np
import pytest
import xarray as xr
from helpers.bad_inputs import one_clear_line
from helpers.hidden_scenes import small_capture
from helpers.made_dataset import make_dataset
from helpers.point_cloud_files import read_ply
from helpers.refusals import refused

from tofrender import io
from tofrender.io.exr import load_exr_layers
from tofrender.io.netcdf import load_measurement, save_measurement

VALUES = {
    "bool": [0, 1, 1],
    "int8": [-128, 0, 127],
    "uint8": [0, 200, 255],
    "int16": [-30000, 1, 30000],
    "uint16": [0, 300, 60000],
    "int32": [-(2**31), 1, 2**31 - 1],
    "uint32": [0, 300, 2**32 - 1],
    "int64": [-(2**60), 1, 2**60 + 1],
    "uint64": [0, 300, 2**64 - 1],
    "float16": [0.1, -1, 6e4],
    "float32": [0.1, -1, 3e38],
    "float64": [0.1, -1, 1e300],
    ">f8": [0.1, -1, 2],
    ">i2": [-1, 300, 7],
    "longdouble": [0.1, -1, 2],
    "complex64": [1j, 1, 2],
    "U3": ["a", "bc", "def"],
    "datetime64[ns]": [0, 1, 10**18],
    "timedelta64[ns]": [0, 1, 10**18],
    "object": ["a", 2, None],
}


def cloud_with(values):
    """A cloud in generic position with one more column."""
    columns = {name: ("point", np.array([0.25, -3.5, 12.0]) + k) for k, name in enumerate("xyz")}
    return xr.Dataset({**columns, "v": ("point", values)})


def by_ply(values, folder):
    return read_ply(io.save_point_cloud(cloud_with(values), folder / "a.ply"))["v"]


def by_cloud_in_netcdf(values, folder):
    path = io.save_point_cloud(cloud_with(values), folder / "a.nc")
    return xr.load_dataset(path, engine="scipy")["v"].values


def by_las(values, folder):
    laspy = pytest.importorskip("laspy")
    cloud = cloud_with(values).rename(v="time")
    return np.asarray(laspy.read(io.save_point_cloud(cloud, folder / "a.las")).gps_time)


def by_measurement(values, folder):
    measured = cloud_with(values).assign_coords(w=("point", values)).assign_attrs(quantity="v")
    save_measurement(measured, folder / "a.nc")
    found = load_measurement(folder / "a.nc")
    assert np.array_equal(found["w"], found["v"])
    return found["v"].values


def by_layers(values, folder):
    path = io.save_exr_layers(folder / "a.exr", {"v": values.reshape(1, 3, 1)})
    return load_exr_layers(path)[0]["v"].ravel()


def transient_of(values):
    """A render whose light has these values and their type."""
    dataset = make_dataset(1, 3, 2, channels="L")
    light = np.broadcast_to(values[None, :, None, None], (1, 3, 2, 1))
    return dataset.assign(transient=dataset["transient"].copy(data=light))


def by_npz(values, folder):
    path = io.save_npz(transient_of(values), folder / "a.npz")
    return io.load_npz(path)["transient"].values[0, :, 1, 0]


def by_stack(values, folder):
    path = io.save_exr_stack(transient_of(values), folder / "a", progress=False)
    return io.load_exr_stack(path)["transient"].values[0, :, 1, 0]


def by_capture(values, folder):
    capture = small_capture()
    light = np.resize(values, capture["transient"].shape)
    capture = capture.assign(transient=capture["transient"].copy(data=light))
    path = io.save_capture(capture, folder / "a.h5")
    return io.load_capture(path)["transient"].values.ravel()[:3]


WRITERS = {
    "PLY": by_ply,
    "a cloud in NetCDF": by_cloud_in_netcdf,
    "LAS": by_las,
    "a measurement": by_measurement,
    "EXR layers": by_layers,
    "NPZ": by_npz,
    "an EXR stack": by_stack,
    "a capture": by_capture,
}
FLOATS = {"float16", "float32", "float64", ">f8"}
SMALL = {"int8", "uint8", "int16", "uint16", ">i2"}
STORED = {
    "PLY": FLOATS | SMALL | {"bool", "int32", "uint32"},
    "a cloud in NetCDF": FLOATS | SMALL | {"bool", "int32", "uint32", "U3"},
    "LAS": FLOATS | SMALL | {"int32", "uint32", "longdouble"},
    "a measurement": FLOATS | SMALL | {"bool", "int32", "uint32", "U3"},
    "EXR layers": {"float16", "float32", ">f8", "longdouble"} | SMALL,
    "NPZ": {"float32"},
    "an EXR stack": {"float32"},
    "a capture": {"float32"},
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("kind", VALUES)
@pytest.mark.parametrize("writer", WRITERS)
def test_a_writer_keeps_values_or_refuses_them(tmp_path, writer, kind):
    values = np.array(VALUES[kind], kind)
    if kind in STORED[writer]:
        found = WRITERS[writer](values, tmp_path)
        expected = values.astype(np.float32) if writer == "EXR layers" else values
        assert np.array_equal(found.astype(expected.dtype), expected)
        return
    with pytest.raises(ValueError, match="must") as error:
        WRITERS[writer](values, tmp_path)
    assert not one_clear_line(error.value, "")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"my v": ("point", np.zeros(3))}, "name of a variable = 'my v': must be printable"),
        ({"v": ("other", np.zeros(2))}, r"dimensions of v = \('other',\): must be point"),
        ({"v": (("point", "axis"), np.zeros((3, 2)))}, "dimensions of v"),
        ({"v": ((), 1.0)}, "dimensions of v"),
    ],
)
def test_ply_refuses_other_columns(tmp_path, change, said):
    with refused(said):
        io.save_point_cloud(cloud_with(np.zeros(3)).assign(change), tmp_path / "a.ply")
    assert not list(tmp_path.iterdir())


def test_shots_are_kept_as_integers(tmp_path):
    """The index of shots is a 64-bit integer in Python, and PLY has 32 bits at most."""
    found = by_ply(np.array([0, 300, 70_000]), tmp_path)
    assert found.tolist() == [0, 300, 70_000]
    assert found.dtype == np.int32
