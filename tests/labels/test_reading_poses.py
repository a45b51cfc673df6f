"""Multi-zone sensors read renders of several poses by their labels."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from helpers.support import refused

from tofrender.fitting import calibrate
from tofrender.sensors import MultiZone

SENSOR = replace(MultiZone.preset("tmf8820"), bins=40)
START, WIDTH = 0.3, 0.01


@pytest.fixture(autouse=True)
def _keep_attributes():
    """As newer versions of xarray do by default."""
    with xr.set_options(keep_attrs=True):
        yield


def renders(scale=1.0):
    """Return a cropped render of 6 x 5 pixels in each of 3 poses."""
    rng = np.random.default_rng(2)
    light = (scale * rng.random((3, 5, 6, 60, 3))).astype(np.float32)
    axes = {
        "pose": np.arange(3),
        "y": np.arange(2, 7),
        "x": np.arange(4, 10),
        "opl": START + WIDTH * (np.arange(60) + 0.5),
        "channel": ["R", "G", "B"],
        "tan_x": ("x", np.linspace(0.4, -0.35, 6)),
        "tan_y": ("y", np.linspace(0.3, -0.32, 5)),
    }
    attrs = {"start_opl": START, "bin_width_opl": WIDTH, "quantity": "radiance per bin"}
    dims = ("pose", "y", "x", "opl", "channel")
    return xr.Dataset({"transient": (dims, light)}, axes, attrs)


def turned(data):
    """Return the same data in another order of axes and labels."""
    mixed = data.isel(x=[3, 0, 4, 1, 5, 2], y=slice(None, None, -1), opl=slice(None, None, -1))
    return mixed.transpose(*reversed(list(mixed.dims)))


def test_renders_in_any_order():
    right = SENSOR.expected(renders())
    xr.testing.assert_identical(SENSOR.expected(turned(renders())), right)
    xr.testing.assert_identical(SENSOR.measure(turned(renders()), 4), SENSOR.measure(renders(), 4))
    some = SENSOR.expected(renders().isel(pose=[2, 0]))
    xr.testing.assert_allclose(some, right.isel(pose=[2, 0]))
    light = renders()["transient"].expand_dims(stokes=["S0", "S1", "S2", "S3"], axis=4)
    scale = xr.DataArray([1.0, 9.0, 9.0, 9.0], {"stokes": light["stokes"]}, "stokes")
    stokes = renders().assign(transient=light * scale).isel(stokes=[2, 0])
    xr.testing.assert_allclose(SENSOR.expected(stokes), right)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d.isel(x=[0, 1, 3]), "axis x skips pixels"),
        (lambda d: d.isel(opl=slice(None, None, 2)), "do not skip bins"),
        (lambda d: d.coarsen(opl=2).mean(), "do not skip bins"),
        (lambda d: d.coarsen(x=2).mean(), "axis x"),
        (lambda d: d.isel(pose=0), "axis pose"),
    ],
)
def test_what_is_no_render_of_poses(change, said):
    refused(f"^renders: .*{said}", SENSOR.expected, change(renders()))


def test_poses_of_renders_and_histograms_are_the_same():
    measured = SENSOR.expected(renders())
    options: dict[str, Any] = {"parameters": ["gains"]}
    found = calibrate(SENSOR, renders(), measured.transpose("bin", "zone", "pose"), **options)
    np.testing.assert_allclose(found.sensor.gains, SENSOR.gains, rtol=1e-3)
    back = measured.isel(pose=[2, 1, 0])
    refused("histograms: the axis pose", calibrate, SENSOR, renders(), back, **options)
    parts = {"near": renders(), "far": renders(0.5).isel(pose=[2, 1, 0])}
    refused(
        "renders of far: the axis pose",
        calibrate,
        SENSOR,
        parts,
        measured["counts"].values,
        **options,
    )
    parts["far"] = renders(0.5).assign_coords(tan_x=("x", np.linspace(0.3, -0.3, 6)))
    refused("far has other pixels", calibrate, SENSOR, parts, measured["counts"].values, **options)
