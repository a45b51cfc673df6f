"""Four-bucket sensors, multipath errors in closed form, and true depth."""

# ruff: noqa: E741 (I and Q are what the field calls them)

import mitsuba as mi
import numpy as np
import pytest
from helpers.parts import area_light, diffuse, plane, point_light, rotate, translate
from helpers.support import camera, film, load, refused, scene

from tofrender.analysis import (
    four_bucket,
    from_four_bucket,
    multipath_error,
    transient_to_phasor,
    true_depth,
    true_normals,
    unambiguous_range,
)
from tofrender.runtime.variants import BackendError

C = 299_792_458.0


def test_buckets_are_what_a_pixel_integrates():
    """Light 1 + cos(wt) of paths is multiplied by a gain of (1 + cos(wt - theta)) / 2.

    The product is averaged over a period in small steps, for the four phase steps. Two sines have
    the contrast 1/2. All buckets receive the same ambient light.
    """
    f, ambient = 20e6, 0.7
    arrivals = np.array([[3.1, 0.8], [5.0, 0.3], [9.2, 0.1]])
    t = np.arange(4000) / 4000 / f
    signal = ambient + sum(a * (1 + np.cos(2 * np.pi * f * (t - opl / C))) for opl, a in arrivals)
    gains = [(1 + np.cos(2 * np.pi * f * t - k * np.pi / 2)) / 2 for k in range(4)]
    measured = [np.mean(gain * signal) for gain in gains]
    z = (arrivals[:, 1] * np.exp(2j * np.pi * f * arrivals[:, 0] / C)).sum()
    buckets = four_bucket(z.real, z.imag, offset=arrivals[:, 1].sum() + ambient, contrast=0.5)
    assert [float(b) for b in buckets] == pytest.approx(measured)


@pytest.mark.parametrize("contrast", [0.05, 0.5, 1.0])
def test_round_trip(contrast):
    rng = np.random.default_rng(1)
    I, Q = rng.normal(size=(2, 3, 4, 5, 3))
    offset = np.hypot(I, Q).max() + rng.random((4, 5, 1))
    buckets = four_bucket(I, Q, offset=offset, contrast=contrast)
    assert all((b >= 0).all() for b in buckets)
    assert [b.shape for b in buckets] == [I.shape] * 4
    back = from_four_bucket(*buckets, contrast=contrast)
    for ours, given in zip(back, (I, Q, np.broadcast_to(offset, I.shape)), strict=True):
        assert ours == pytest.approx(given, abs=1e-12)


def test_offsets_and_shapes_that_do_not_fit():
    I = np.ones((2, 2))
    for match, offset in (
        ("offset = 0.4: must be at least contrast", np.full((2, 2), 0.4)),
        ("offset with shape", np.ones((3, 2, 2))),
    ):
        refused(match, four_bucket, I, 0 * I, offset=offset)
    refused(
        "contrast = 1.01: must be a finite number above 0 and at most 1",
        four_bucket,
        I,
        I,
        offset=2.0,
        contrast=1.01,
    )
    refused("must be equal", four_bucket, I, np.ones(3), offset=9)
    refused("must be equal", from_four_bucket, I, np.ones(3), I, I)
    refused("must be equal, except", multipath_error, I, np.ones((3, 2)))
    refused("must be equal, except", multipath_error, np.ones((4, 4)), np.ones((4, 1)))


@pytest.mark.parametrize("f", [20e6, 50e6])
def test_error_map_of_a_corner(f):
    """A diffuse floor next to a mirror: light arrives directly, and by way of the mirror.

    Camera and light are at (1, 0, 2), the mirror is x = 0, and the floor is z = 0. Light by way of
    the mirror comes from the image at (-1, 0, 2). With the irradiance I cos / d^2 = I h / d^3, its
    amplitude relative to direct light is a = R (d / d')^3. The phase is wrong by the angle of
    1 + a exp(i k (d' - d)), and the depth by this angle over 2 k.
    """
    reflectance, h, width = 0.8, 2.0, 1e-3
    x, y = np.meshgrid(np.linspace(0.05, 3, 8), np.linspace(-1, 1, 5))
    direct, mirrored = (np.sqrt((x - side) ** 2 + y**2 + h**2) for side in (1, -1))
    bins = np.stack([2 * direct, direct + mirrored]) // width
    light = np.stack([1 / direct**3, reflectance / mirrored**3])
    data = np.zeros((*x.shape, 9000))
    for index, value in zip(bins.astype(int), light, strict=True):
        np.add.at(data, (*np.indices(x.shape), index), value)
    depth = transient_to_phasor(data, f, 0.0, width)[4]
    near, far = (bins + 0.5) * width  # What is left after the light went into bins
    k = 2 * np.pi * f / C
    a = light[1] / light[0]
    expected = np.angle(1 + a * np.exp(1j * k * (far - near))) / (2 * k)
    result = multipath_error(depth, near / 2, unambiguous_range(f))
    assert result.error.shape == (*x.shape, 1)
    assert result.error[..., 0] == pytest.approx(expected, abs=1e-9)
    assert (result.error > 0).any()
    assert result.median == pytest.approx(np.median(expected), abs=1e-9)
    assert result.percentile_95 == pytest.approx(np.percentile(np.abs(expected), 95), abs=1e-9)
    against_truth = multipath_error(depth[..., 0], direct, unambiguous_range(f)).error
    assert against_truth == pytest.approx(expected, abs=width)


def test_error_wraps_and_is_unknown_without_truth():
    depth = np.array([[7.4, 0.1, 2.0, np.nan, 3.0]])
    truth = np.array([[0.1, 14.9, 1.5, 1.0, np.inf]])
    result = multipath_error(depth, truth, 7.5)
    assert result.error == pytest.approx(np.array([[-0.2, 0.2, 0.5, np.nan, np.nan]]), nan_ok=True)
    assert result.median == pytest.approx(0.2)
    plain = multipath_error(depth, truth)
    assert plain.error[0, :3] == pytest.approx([7.3, -14.8, 0.5])
    unknown = multipath_error(depth, np.full((1, 5), np.nan), 7.5)
    assert np.isnan([unknown.median, unknown.percentile_95, *unknown.error[0]]).all()
    half = multipath_error(np.array([3.75, 1.25]), np.array([0.0, 5.0]), 7.5)
    assert half.error == pytest.approx([-3.75, -3.75])  # Half a range has one sign
    assert half.median == pytest.approx(-3.75)
    assert half.percentile_95 == pytest.approx(3.75)


def test_depth_that_is_too_near_counts_in_the_percentile():
    depth = np.array([[1.0, 2.1, 3.0, 1.2, 2.9]])
    truth = np.array([[1.9, 2.0, 3.05, 1.7, 2.6]])
    result = multipath_error(depth, truth)
    assert result.median == pytest.approx(-0.05)
    assert result.percentile_95 == pytest.approx(0.9 - 0.2 * (0.9 - 0.5))


def perspective_rays(width, height, fov):
    """Return unit directions through pixel centers of a camera along -z, with x to the right."""
    x, y = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    half = np.tan(np.radians(fov) / 2)
    rays = np.stack([(2 * x - 1) * half, (1 - 2 * y) * half * height / width, -np.ones_like(x)], -1)
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


def room(the_film, **options):
    """Return a camera at (0.2, 0.1, 3) above the plane z = 0, and an inclined wall at the right."""
    origin = (0.2, 0.1, 3.0)
    sensor = camera(origin, (0.2, 0.1, 0.0), the_film, fov=60, near_clip=0.5, **options)
    wall = translate(0.9, 0, 0) @ rotate((0, 1, 0), -60)
    parts = {
        "floor": plane(bsdf=diffuse(0.5), size=1.2),
        "wall": plane(wall, bsdf=diffuse(0.5), size=5.0),
        "light": point_light(origin, 1.0),
    }
    return scene(parts, sensor, max_depth=2)


def room_depth(width, height):
    """Return distances from the camera to the floor (2.4 m wide) or the wall, NaN next to them."""
    origin, rays = np.array([0.2, 0.1, 3.0]), perspective_rays(width, height, 60)
    normal = np.array([-np.sin(np.radians(60)), 0, np.cos(np.radians(60))])
    with np.errstate(divide="ignore"):
        floor = -origin[2] / rays[..., 2]
        wall = ((np.array([0.9, 0, 0]) - origin) @ normal) / (rays @ normal)
    on_floor = (np.abs((origin + rays * floor[..., None])[..., :2]) < 1.2).all(axis=-1)
    floor = np.where(on_floor, floor, np.inf)
    along = origin + rays * wall[..., None] - np.array([0.9, 0, 0])
    up, across = np.hypot(along[..., 0], along[..., 2]), np.abs(along[..., 1])
    on_wall = (wall > 0) & (up < 5) & (across < 5)
    nearest = np.minimum(floor, np.where(on_wall, wall, np.inf))
    return np.where(np.isfinite(nearest), nearest, np.nan)


def test_true_depth_of_planes():
    loaded, expected = load(room(film(24, 18))), room_depth(24, 18)
    depth = true_depth(loaded)
    assert np.isnan(expected).any()
    assert depth == pytest.approx(expected, abs=2e-6, nan_ok=True)
    assert depth.dtype == np.float64
    crop = {"crop_width": 7, "crop_height": 5, "crop_offset_x": 10, "crop_offset_y": 4}
    depth = true_depth(load(room(film(24, 18, sample_border=True, **crop))))
    assert depth == pytest.approx(expected[4:9, 10:17], abs=2e-6, nan_ok=True)
    refused("sensor = 1", true_depth, loaded, 1)
    refused("sensor is missing", true_depth, mi.load_dict({"type": "scene"}))


def test_true_depth_of_a_name_and_under_another_variant():
    expected = true_depth("cornell_box_flash")
    mi.set_variant("llvm_ad_spectral")
    assert true_depth("cornell_box_flash") == pytest.approx(expected, abs=1e-5, nan_ok=True)
    mi.set_variant("scalar_rgb")
    with pytest.raises(BackendError):
        true_depth("cornell_box_flash")


@pytest.mark.parametrize("kind", ["transient_path", "path"])
def test_a_hidden_lamp_has_no_depth(kind):
    described = room(film(24, 18))
    described["lamp"] = plane(translate(0.2, 0.1, 1), size=0.4, emitter=area_light(1.0))
    described["integrator"] = {"type": kind}
    expected = room_depth(24, 18)
    assert np.nanmin(true_depth(load(described)) - expected) < -0.9
    described["integrator"]["hide_emitters"] = True
    loaded = load(described)
    assert true_depth(loaded) == pytest.approx(expected, abs=2e-5, nan_ok=True)
    plain = true_normals(load(room(film(24, 18))))
    assert true_normals(loaded) == pytest.approx(plain, abs=1e-6, nan_ok=True)


def test_true_normals_of_planes():
    normals, depth = true_normals(load(room(film(24, 18)))), room_depth(24, 18)
    assert (np.isnan(normals).all(axis=-1) == np.isnan(depth)).all()
    floor, wall = np.array([0, 0, 1]), np.array([-np.sin(np.radians(60)), 0, 0.5])
    near = [np.abs(normals - each).max(axis=-1) < 1e-6 for each in (floor, wall)]
    assert all(part.any() for part in near)
    assert ((near[0] ^ near[1]) | np.isnan(depth)).all()
    turned = room(film(24, 18))
    turned["floor"]["flip_normals"] = turned["wall"]["flip_normals"] = True
    assert true_normals(load(turned)) == pytest.approx(normals, abs=1e-6, nan_ok=True)


def test_direct_light_measures_the_true_depth():
    width, f = 1e-3, 50e6
    loaded = load(room(film(24, 18, bins=6000, start=2.0, bin_width=width)))
    _, transient = mi.render(loaded, spp=4)
    depth = transient_to_phasor(transient, f, 2.0, width)[4].mean(axis=-1)
    truth = true_depth(loaded)
    lit = np.asarray(transient).sum(axis=(2, 3)) > 0
    error = multipath_error(np.where(lit, depth, np.nan), truth, unambiguous_range(f))
    inner = np.abs(error.error) < 0.12  # Not a pixel that edges or wraps mix
    assert inner.sum() > 0.9 * np.isfinite(error.error).sum()
    assert abs(error.median) < 5e-3
