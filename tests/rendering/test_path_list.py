"""Lists of paths: their vertices, lengths and radiance against closed forms and the film."""

import mitsuba as mi
import numpy as np
import pytest
from helpers.parts import diffuse, gray, plane
from helpers.refusals import refused
from helpers.support import ALPHA, COMPARISONS, camera, film
from scipy.stats import norm

import tofrender
from tofrender import paths_of

HEIGHT, LAMP = 2.0, (1.5, 0.0, 1.0)
ALBEDO, INTENSITY = 0.6, 5.0


def floor_and_point(**integrator):
    """A sensor above a floor, which a point light beside it lights."""
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "transient_path", "max_depth": 2} | integrator,
            "sensor": camera((0, 0, HEIGHT), (0, 0, 0), film(3, 3), fov=1),
            "floor": plane(bsdf=diffuse(ALBEDO)),
            "bulb": {"type": "point", "position": LAMP, "intensity": gray(INTENSITY)},
        }
    )


def names(paths, k):
    return [name for name in paths["shape"].values[k] if name]


def test_direct_light_of_a_point():
    """L = albedo / pi I cos / d^2 along sensor, floor, bulb, of length h + d."""
    paths = paths_of(floor_and_point(), (1, 1), count=8, spp=64)
    d2 = LAMP[0] ** 2 + LAMP[2] ** 2
    radiance = ALBEDO / np.pi * INTENSITY * LAMP[2] / d2**1.5
    assert paths.attrs["found"] == 64
    np.testing.assert_allclose(paths["total"], radiance, rtol=5e-3)
    np.testing.assert_allclose(paths["radiance"], radiance / 64, rtol=0.02)
    np.testing.assert_allclose(paths["opl"], HEIGHT + d2**0.5, rtol=5e-3)
    np.testing.assert_allclose(paths["position"][:, 0], 8 * [[0, 0, HEIGHT]], atol=1e-6)
    np.testing.assert_allclose(paths["position"][:, 1], np.zeros((8, 3)), atol=0.01)
    np.testing.assert_allclose(paths["position"][:, 2], 8 * [LAMP], rtol=1e-6)
    for k in range(8):
        assert names(paths, k) == ["sensor", "floor", "bulb"]
    on_film = paths["on_film"].values
    assert ((on_film[:, 1] >= 1) & (on_film[:, 1] <= 2)).all()  # Within the pixel (1, 1)
    assert np.isnan(on_film[:, 0]).all()


@pytest.mark.parametrize("pixel", [(6, 3), (12, 13)])
def test_lengths_are_those_of_the_segments_and_paths_end_at_a_lamp(pixel):
    paths = paths_of("cornell_box", pixel_of(pixel), opl=(4, 9), count=200, spp=512)
    assert paths.sizes["path"] == min(200, paths.attrs["found"]) > 20
    assert ((paths["opl"] >= 4) & (paths["opl"] < 9)).all()
    steps = np.linalg.norm(paths["position"].diff("vertex"), axis=2)
    np.testing.assert_allclose(np.nansum(steps, axis=1), paths["opl"], rtol=1e-5)
    lengths = paths["vertex_opl"].diff("vertex").values
    np.testing.assert_allclose(lengths, np.where(np.isfinite(steps), steps, np.nan), atol=1e-4)
    assert (np.diff(paths["radiance"].sum("channel")) <= 0).all()
    walls = {
        "floor",
        "ceiling",
        "back",
        "red-wall",
        "green-wall",
        "small-box",
        "large-box",
        "light",
    }
    for k in range(paths.sizes["path"]):
        first, *inner, last = names(paths, k)
        assert (first, last) == ("sensor", "light")
        assert set(inner) <= walls
        vertices = np.isfinite(paths["vertex_opl"].values[k]).sum()
        assert len(inner) + 2 == vertices <= 9  # max_depth of 8 segments


def pixel_of(pixel):
    """A pixel of the built-in film by sixteenths of its sides."""
    return tuple(16 * each + 8 for each in pixel)


def test_the_total_is_that_of_the_film():
    pixel, spp = (130, 200), 1 << 14
    window = (0.0, 30.0)
    listed = [
        paths_of("cornell_box", pixel, opl=window, count=1, spp=spp // 8, seed=seed)["total"]
        for seed in range(8)
    ]
    x, y = pixel
    crop = {"crop_width": 1, "crop_height": 1, "crop_offset_x": x, "crop_offset_y": y}
    scene = tofrender.cornell_box()
    scene["sensor"]["film"] |= crop | {"rfilter": {"type": "box"}}
    scene["sensor"]["film"] |= {"temporal_bins": 1, "start_opl": 0.0, "bin_width_opl": 30.0}
    scene["integrator"].pop("pulse_width_opl", None)
    loaded = mi.load_dict(scene)
    films = [
        tofrender.render(loaded, spp=spp // 8, seed=8 + seed, progress=False)["transient"]
        for seed in range(8)
    ]
    a, b = (np.array(each).reshape(8, 3) for each in (listed, films))
    spread = np.sqrt((a.var(axis=0, ddof=1) + b.var(axis=0, ddof=1)) / 8)
    off = abs(a.mean(axis=0) - b.mean(axis=0)) / spread
    assert off.max() < norm.isf(ALPHA / COMPARISONS) * 2  # Few degrees of freedom


def test_points_of_media_are_vertices():
    fog = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "transient_path", "max_depth": 3},
            "sensor": camera((0, 0, HEIGHT), (0, 0, 0), film(1, 1), fov=1),
            "floor": plane(bsdf=diffuse(ALBEDO)),
            "bulb": {"type": "point", "position": LAMP, "intensity": gray(INTENSITY)},
            "fog": {
                "type": "cube",
                "to_world": mi.ScalarTransform4f().translate([0, 0, 0.8]).scale([9, 9, 0.5]),
                "bsdf": {"type": "null"},
                "interior": {"type": "homogeneous", "albedo": gray(0.9), "sigma_t": 0.5},
            },
        }
    )
    paths = paths_of(fog, (0, 0), count=100, spp=512)
    found = {name for k in range(paths.sizes["path"]) for name in names(paths, k)}
    assert {"sensor", "medium", "floor", "bulb"} <= found
    steps = np.linalg.norm(paths["position"].diff("vertex"), axis=2)
    np.testing.assert_allclose(np.nansum(steps, axis=1), paths["opl"], rtol=1e-4)


@pytest.mark.parametrize("max_depth", [1, 2])
def test_light_from_infinity_ends_where_its_length_starts(max_depth):
    """Straight into the sky, and by way of the floor: ends are that far away, not at the origin."""
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "transient_path", "max_depth": max_depth},
            "sensor": camera((0, 0, 2), (0, 0, 5 if max_depth == 1 else 0), film(1, 1), fov=1),
            "floor": plane(bsdf=diffuse(ALBEDO)),
            "sky": {"type": "constant", "radiance": gray(1.0)},
        }
    )
    paths = paths_of(scene, (0, 0), count=20, spp=64)
    assert paths.sizes["path"] == 20
    steps = np.linalg.norm(paths["position"].diff("vertex"), axis=2)
    np.testing.assert_allclose(np.nansum(steps, axis=1), paths["opl"], rtol=1e-4)
    for k in range(20):
        assert names(paths, k) == ["sensor", *["floor"] * (max_depth - 1), "sky"]


def test_it_has_the_same_paths_again_and_others_with_another_seed():
    scene = floor_and_point()
    first, again, other = (paths_of(scene, (1, 1), count=3, spp=32, seed=s) for s in (1, 1, 2))
    assert first.identical(again)
    assert not first["position"].equals(other["position"])


def test_nothing_in_range_is_an_empty_list():
    paths = paths_of(floor_and_point(), (1, 1), opl=(0, 1))
    assert paths.sizes["path"] == 0
    assert paths["total"].values.tolist() == [0, 0, 0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"pixel": (3, 0)}, "pixel column = 3: must be"),
        ({"pixel": 4}, "pixel = 4: must be"),
        ({"opl": (2, 1)}, "opl = .*: must be .least, greatest."),
        ({"opl": (float("nan"), 1)}, "opl = nan: must be"),
        ({"count": 0}, "count = 0: must be"),
        ({"spp": 0}, "spp = 0: must be"),
        ({"seed": -1}, "seed = -1: must be"),
        ({"sensor": 1}, "sensor = 1: must be"),
    ],
)
def test_bad_input(options, message):
    arguments = {"pixel": (1, 1)} | options
    with refused(message):
        paths_of(floor_and_point(), arguments.pop("pixel"), **arguments)


def test_integrators_without_camera_paths_are_refused():
    scene = tofrender.load_scene("nlos_z", width=4, height=4)
    with refused("integrator = .*: must be one whose paths begin at a camera"):
        paths_of(scene, (1, 1))
    with refused("integrator = .*: must be one of this package"):
        paths_of(mi.load_dict(mi.cornell_box()), (1, 1))
