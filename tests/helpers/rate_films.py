"""A film over path length and range rate, most of whose light rests."""

import numpy as np
import xarray as xr

RATE_BINS = 2003
REST = 801  # Bin of the rate 0


def resting_light() -> xr.Dataset:
    """A film of `range_rate` in which 80 % of the light has the rate 0, and the rest a faint haze.

    Its axes start anywhere, and the bin of the rate 0 is neither in the middle nor even.
    """
    rng = np.random.default_rng(5)
    light = np.zeros((2, 3, 37, RATE_BINS, 1), np.float32)
    light[..., REST, 0] = rng.uniform(0.5, 1, light.shape[:3])
    haze = rng.uniform(0, 1, (*light.shape[:3], 400)).astype(np.float32)
    resting = light.sum()
    light[..., 100:500, 0] = haze * (resting / 4 / haze.sum())
    axes = {
        "y": np.arange(2) + 5,
        "x": np.arange(3) + 1,
        "opl": 4.2 + 0.15 * (np.arange(37) + 0.5),
        "rate": 0.08 * (np.arange(RATE_BINS) - REST),
        "channel": ["L"],
    }
    units = {"units": "W m^-2 sr^-1"}
    dims = ("y", "x", "opl", "rate", "channel")
    steady = light.sum(axis=(2, 3))
    variables = {"radiance": (dims, light, units), "steady": (("y", "x", "channel"), steady)}
    about = {"scene": "a fan", "start_opl": 4.2, "bin_width_opl": 0.15, "quantity": "radiance"}
    return xr.Dataset(variables, axes, about)
