"""`reconstruction_errors`: errors of reconstructions from noisy counts, level by level."""

import numpy as np
import pytest
from helpers.hidden_scenes import small_capture
from helpers.refusals import refused

import tofrender
from tofrender import nlos, sensors, vis

SPAD = {"cycles": 400, "photons": {"photons_per_cycle": 7.0}, "spad": {}}
LEVELS = [0.5, 0.02]
METHODS = ["bp", "fk"]


@pytest.fixture(scope="module")
def wall():
    return tofrender.capture("nlos_plane", grid=(6, 5), spp=32, progress=False)


def test_errors_are_those_of_single_reconstructions(wall):
    found = sensors.reconstruction_errors(
        wall, "nlos_plane", sensor=SPAD, photons_per_cycle=LEVELS, methods=METHODS, seeds=2
    )
    assert found["error"].dims == ("reconstruction", "photons_per_cycle", "seed")
    assert found["error"].shape == (2, 2, 2)
    sensor = SPAD | {"photons": {"photons_per_cycle": LEVELS[1]}}
    volume = nlos.reconstruct(sensors.sense(wall, sensor, seed=1), "bp", progress=False)
    expected = nlos.depth_error(volume, nlos.hidden_depth("nlos_plane", volume))
    one = found.sel(reconstruction="bp", photons_per_cycle=LEVELS[1], seed=1)
    assert float(one["error"]) == expected.median
    assert float(one["found"]) == expected.found

    # The figure has a line for each method
    figure = vis.reconstruction_errors_figure(found, title="a plane")
    assert [line.get_label() for line in figure.axes[0].lines] == METHODS
    np.testing.assert_array_equal(figure.axes[0].lines[1].get_xdata(), sorted(LEVELS))
    expected_line = found["error"].sel(reconstruction="fk").median("seed").values[::-1]
    np.testing.assert_array_equal(figure.axes[0].lines[1].get_ydata(), expected_line)


def test_what_is_not_supported(wall):
    options = {"sensor": SPAD, "photons_per_cycle": LEVELS}
    for text, changes in {
        "photons_per_cycle": {"photons_per_cycle": [0.1, 0.0]},
        "methods": {"methods": ["lct", "best"]},
        "seeds": {"seeds": 0},
        "only spad": {"sensor": "itof"},
    }.items():
        with refused(text):
            sensors.reconstruction_errors(wall, "nlos_plane", **options | changes)
    with refused("errors"):
        vis.reconstruction_errors_figure(small_capture())
