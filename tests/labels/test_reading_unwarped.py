"""Camera unwarping of films in any order, with errors, and with labeled distances."""

import numpy as np
import pytest
import xarray as xr
from helpers.made_dataset import make_dataset
from helpers.support import refused

from tofrender import merge, render, unwarp_camera

DISTANCES = np.linspace(0.1, 1.3, 24).reshape(4, 6)


def film():
    return make_dataset(4, 6, 12, x0=6, y0=2, film_width=15, film_height=9)


def turned(data):
    """Return the same data in another order of axes and labels."""
    mixed = data.isel(x=[3, 0, 5, 1, 2, 4], y=slice(None, None, -1), opl=slice(None, None, -1))
    return mixed.isel(channel=[1, 2, 0]).transpose("opl", "x", "channel", "y")


def test_distances_stay_with_their_pixels():
    data = film()
    right = unwarp_camera(data, DISTANCES)
    axes = {"y": data["y"].values, "x": data["x"].values}
    labeled = xr.DataArray(DISTANCES, axes, ("y", "x"))
    xr.testing.assert_identical(unwarp_camera(data, labeled), right)
    xr.testing.assert_identical(unwarp_camera(turned(data), labeled.transpose("x", "y")), right)
    in_its_order = DISTANCES[::-1][:, [3, 0, 5, 1, 2, 4]]
    xr.testing.assert_identical(unwarp_camera(turned(data), in_its_order), right)
    refused("distance_m: the axis x has other", unwarp_camera, data, labeled.isel(x=slice(5)))
    moved = labeled.assign_coords(y=labeled["y"] + 1)
    refused("distance_m: the axis y has other", unwarp_camera, data, moved)


def test_a_part_of_the_window_starts_where_it_is():
    data = film()
    part = unwarp_camera(data.isel(opl=slice(4, 9)), np.full((4, 6), 0.06))
    start = data["opl"].values[4] - data.attrs["bin_width_opl"] / 2 - 0.06
    assert part.attrs["start_opl"] == pytest.approx(start)
    np.testing.assert_allclose(part["transient"], data["transient"][:, :, 4:9])


def test_films_with_errors():
    """Their errors are left out, as `rebin` leaves them out."""
    data = film()
    errors = {f"{name}_error": 0.1 * data[name] for name in ("transient", "steady")}
    found = unwarp_camera(data.assign(errors), DISTANCES)
    xr.testing.assert_identical(found, unwarp_camera(data, DISTANCES))


def test_polarized_films():
    """Each component moves as the intensity does."""
    data = film()
    axis = xr.DataArray([1.0, 0.5, -0.25, 0.0], {"stokes": ["S0", "S1", "S2", "S3"]}, "stokes")
    stokes = data.assign({name: (data[name] * axis).astype(np.float32) for name in data})
    assert unwarp_camera(stokes, DISTANCES)["transient"].dims[-2:] == ("stokes", "channel")
    found = unwarp_camera(stokes.isel(stokes=[2, 0, 3, 1]), DISTANCES)
    for name, scale in zip(["S0", "S1", "S2", "S3"], axis.values, strict=True):
        right = scale * unwarp_camera(data, DISTANCES)["transient"]
        np.testing.assert_allclose(found["transient"].sel(stokes=name), right, rtol=1e-6)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d.expand_dims(frame=2), "axis frame"),
        (lambda d: d.isel(x=0), "axis x"),
        (lambda d: d.isel(opl=slice(None, None, 2)), "rebin"),
        (lambda d: d.assign_attrs(camera_unwarp=1), "lack the camera's segment already"),
        (lambda d: d["transient"], "pass the whole Dataset"),
    ],
)
def test_what_is_refused(change, said):
    refused(said, unwarp_camera, change(film()), DISTANCES)


def test_unwarped_renders_are_not_continued():
    unwarped = [
        unwarp_camera(film().assign_attrs(fingerprint="2-a", seed=seed), DISTANCES)
        for seed in (0, 1)
    ]
    refused("before unwarp_camera", merge, unwarped)
    options = {"spp": 128, "resume": unwarped[0], "size": (6, 4), "progress": False}
    refused("resume: was rendered with", render, "cornell_box", **options)
