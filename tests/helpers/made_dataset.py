"""A Dataset like the ones that `render` returns, without a render."""

import json

import numpy as np
import xarray as xr

from tofrender.rendering.labels import labeled

START, WIDTH = 3.5, 0.02


def make_dataset(height=6, width=10, bins=5, channels="RGB", x0=0, y0=0, **attrs) -> xr.Dataset:
    """A Dataset like the ones that `render` returns: a bright spot that moves to the right."""
    rng = np.random.default_rng(1)
    transient = rng.gamma(0.5, 1e-3, (height, width, bins, len(channels))).astype(np.float32)
    for index in range(bins):
        transient[height // 3, (2 * index) % width, index] = 0.1
    standard = {
        **{"quantity": "radiance per bin", "units": "W m^-2 sr^-1"},
        **{"start_opl": START, "bin_width_opl": WIDTH, "pulse": "GaussianPulse(width_opl=0.03)"},
        **{"scene": "bördér", "integrator": "transient_path", "sampler": "multijitter"},
        **{"spp": 64, "seed": 2**32 - 1, "variant": "llvm_ad_rgb"},
        "versions": json.dumps({"tofrender": "0.1.0", "mitsuba": "3.9.1"}),
        **{"energy_outside_window": 1e-3 / 3, "complete": 1, "render_seconds": 0.1},
    }
    arrays = {
        "transient": (("y", "x", "opl", "channel"), transient, {"long_name": "radiance"}),
        "steady": (("y", "x", "channel"), transient.sum(axis=2)),
    }
    opl = ("opl", START + (np.arange(bins) + 0.5) * WIDTH, {"units": "m"})
    axes = {"y": y0 + np.arange(height), "x": x0 + np.arange(width), "opl": opl}
    return labeled(xr.Dataset(arrays, axes | {"channel": list(channels)}, standard | attrs))


def assert_same(a: xr.Dataset, b: xr.Dataset) -> None:
    """Equal bit by bit, with equal types of everything."""
    assert a.identical(b)
    assert {k: type(v) for k, v in a.attrs.items()} == {k: type(v) for k, v in b.attrs.items()}
    for name in a.variables:
        assert a[name].dtype == b[name].dtype
        assert a[name].values.tobytes() == b[name].values.tobytes()
