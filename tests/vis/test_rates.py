"""Figures of moving scenes: no bright bin is lost, and each map states which rate it shows."""

import io

import numpy as np
import pytest
import xarray as xr
from helpers.rate_films import REST, resting_light
from PIL import Image

from tofrender import vis
from tofrender.motion.doppler_camera import doppler_rate
from tofrender.motion.fmcw import Fmcw
from tofrender.vis import rate_figures

BRIGHT = 500  # Sum of red, green and blue of the upper half of the map's colors


def drawn(figure, dpi):
    stream = io.BytesIO()
    figure.savefig(stream, dpi=dpi)
    return np.asarray(Image.open(stream).convert("RGB")).astype(int)


@pytest.mark.parametrize("dpi", [72, 100, 163])
@pytest.mark.parametrize("pixel", [None, (2, 6)])
def test_light_at_rest_is_a_bright_row(dpi, pixel):
    """80 % of the light lies in one of 2003 rows, and a picture has a few hundred rows."""
    film = resting_light()
    figure = vis.range_velocity_map(film, pixel=pixel)
    picture = drawn(figure, dpi)
    axes = figure.axes[0]
    rest_m_s = 0.0
    across, down = axes.transData.transform((film["opl"].values.mean() / 2, rest_m_s))
    scale = dpi / figure.dpi
    row = picture.shape[0] - 1 - round(down * scale)
    column = round(across * scale)
    strip = picture[row - 3 : row + 4, column - 60 : column + 60].sum(axis=2)
    assert (strip.max(axis=0) > BRIGHT).all()
    assert axes.images[0].get_array().max() == pytest.approx(float(shown_light(film, pixel).max()))


def shown_light(film, pixel):
    light = film["radiance"].sum("channel")
    if pixel is None:
        return light.sum(("y", "x"))
    return light.sel(x=pixel[0], y=pixel[1])


@pytest.mark.parametrize("most", [(1, 1), (3, 5), (7, 4), (7, 40), (9, 9)])
def test_each_cell_has_its_largest_value(most):
    values = np.random.default_rng(2).normal(size=(7, 11))
    found = rate_figures.largest_of_cells(values, most)
    assert found.shape == (min(7, most[0]), min(11, most[1]))
    # A value lies in the cells that contain its bin
    expected = np.full(found.shape, -np.inf)
    fine = values.repeat(found.shape[0], 0).repeat(found.shape[1], 1)
    for (row, column), value in np.ndenumerate(fine):
        cell = row // 7, column // 11
        expected[cell] = max(expected[cell], value)
    assert np.array_equal(found, expected)


def test_maps_of_velocities_state_which_rate_they_show():
    lidar = Fmcw(bandwidth_hz=1e9, chirp_s=1e-5, wavelength_m=1.55e-6)
    film = resting_light().isel(rate=slice(REST - 50, REST + 51))
    estimates = lidar.estimates(lidar.spectra(film))
    parts = (("y", "x", "part", "channel"), np.ones((2, 3, 2, 1)))
    about = {"waveform": "sine", "cycles": 1, "frequency_hz": 3e7, "exposure_s": 1e-3}
    variables = {"homodyne": parts, "heterodyne": (parts[0], 0.01 * parts[1])}
    measured = xr.Dataset(variables, {"part": ["I", "Q"]}, about)
    titles = [
        vis.velocity_map(rate, title="fan").axes[0].get_title()
        for rate in (doppler_rate(measured), estimates["rate"])
    ]
    colors = "receding (red), approaching (blue)"
    assert titles == [
        f"change of path length at a fixed pixel\n{colors}",
        f"change of path length of the material\n{colors}",
    ]
