"""Functions of arrays find the axes of DataArrays by their names."""

import numpy as np
import pytest
import xarray as xr
from helpers.support import refused

from tofrender import four_bucket, from_four_bucket, multipath_error, sum_channels, unwrap

FREQUENCIES = (20e6, 50e6)
AXES = {"y": [5, 6], "x": [2, 3], "channel": ["R", "G"]}
DIMS = ("frequency", "y", "x", "channel")


def phasors():
    """Return I and Q whose axes all have two entries, so that axes could be confused."""
    rng = np.random.default_rng(3)
    axes = {"frequency": list(FREQUENCIES), **AXES}
    return [xr.DataArray(rng.normal(size=(2, 2, 2, 2)), axes, DIMS) for _ in range(2)]


def test_sums_of_channels():
    real, imaginary = phasors()
    right = sum_channels(real.values, imaginary.values, FREQUENCIES)
    mixed = real.transpose("channel", "x", "y", "frequency")
    found = sum_channels(mixed, imaginary.transpose("x", "frequency", ...), FREQUENCIES)
    for one, other in zip(found, right, strict=True):
        np.testing.assert_array_equal(one.swapaxes(1, 2), other)
    refused("axes of I", sum_channels, real.rename(channel="color"), imaginary, FREQUENCIES)
    refused("without freq", sum_channels, real[0], imaginary[0], FREQUENCIES)
    refused("frequencies", sum_channels, real, imaginary, FREQUENCIES[::-1])


def test_unwrapped_phases():
    real, imaginary = (each.isel(channel=0) for each in phasors())
    phases = xr.apply_ufunc(np.arctan2, imaginary, real)
    weights = xr.apply_ufunc(np.hypot, real, imaginary)
    right = unwrap(phases.values, FREQUENCIES, amplitudes=weights.values)
    found = unwrap(phases.transpose(..., "frequency"), FREQUENCIES, amplitudes=weights)
    np.testing.assert_array_equal(found, right)
    refused("frequencies", unwrap, phases, FREQUENCIES[::-1])
    other = weights.isel(x=[1, 0])
    refused("labels along the axis x", unwrap, phases, FREQUENCIES, amplitudes=other)


def test_buckets():
    real, imaginary = (each.isel(frequency=0) for each in phasors())
    offset = 9 + real.isel(channel=0)
    whole = offset.expand_dims(channel=AXES["channel"], axis=2)
    right = four_bucket(real.values, imaginary.values, offset=whole.values)
    turned = imaginary.transpose("x", "channel", "y")
    found = four_bucket(real, turned, offset=whole.transpose("channel", "x", "y"))
    np.testing.assert_array_equal(found, right)
    labeled = [real.copy(data=each) for each in right]
    again = from_four_bucket(labeled[0], *(each.transpose("x", ...) for each in labeled[1:]))
    np.testing.assert_allclose(again, [real, imaginary, whole.broadcast_like(real)])
    refused("labels along the axis x", from_four_bucket, *labeled[:3], labeled[3].isel(x=[1, 0]))
    refused("Q has", four_bucket, real, imaginary.rename(x="row"), offset=9.0)


def test_errors_of_depths():
    depth = phasors()[0].isel(frequency=0, channel=0)
    truth = depth + xr.DataArray([[0.1, 0.2], [0.3, 0.4]], dims=("y", "x"))
    right = multipath_error(depth.values, truth.values)
    found = multipath_error(depth, truth.transpose("x", "y"))
    np.testing.assert_array_equal(found.error, right.error)
    assert found.median == pytest.approx(-0.25)
    with_channels = depth.expand_dims(channel=["L"], axis=2)
    assert multipath_error(with_channels, truth.T).median == pytest.approx(-0.25)
    refused("labels along the axis y", multipath_error, depth, truth.isel(y=[1, 0]))
