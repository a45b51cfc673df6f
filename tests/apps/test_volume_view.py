"""Volumes in three dimensions: voxels, walls and ellipsoids are drawn where closed forms say."""

import base64
import io

import numpy as np
import pytest
from helpers.accessible import hindrances
from helpers.explorer_page import fragment, opened, saved, set_, state
from helpers.hidden_scenes import Wall, capture_of, rectangle, turned
from PIL import Image, ImageSequence

import tofrender
from tofrender.apps.explorer.page_contents import contents_of

EYE = 4  # Distance of the eye, in radii
SIZES = [(1400, 900), (800, 600), (390, 844)]
AXES = {"x": (-1.0, 1.0, 16), "y": (-0.8, 0.8, 12), "z": (0.6, 1.6, 10)}
VIEWS = [(0.0, 0.0, 1.0), (-0.5, 0.35, 1.0), (2.4, -0.6, 1.4), (1.2, 1.0, 0.8)]
"""Across, tilt [rad], zoom."""
CANVAS = "document.querySelector('.volume canvas').toDataURL().split(',')[1]"


def made(mode="single", wall=None, **options):
    """A capture, and a dark volume in the frame of its wall."""
    patch = rectangle((-0.1, 0.1), (-0.1, 0.1), 1.0, 0.1)
    capture = capture_of(patch, wall or Wall(8), mode, bins=100, width=0.02, **options)
    volume = tofrender.reconstruct(capture, "bp", volume=tuple(AXES.values()), progress=False)
    volume["intensity"][:] = 0
    return capture, volume


def center(*voxel):
    """Center of a voxel (x, y, z) in the wall's frame [m]."""
    ends = zip(voxel, AXES.values(), strict=True)
    return np.array([low + (k + 0.5) * (high - low) / count for k, (low, high, count) in ends])


def picture(page):
    image = Image.open(io.BytesIO(base64.b64decode(page.evaluate(CANVAS))))
    return np.asarray(image.convert("RGB"), float)


def projected(points, size, view, volume):
    """Pixels (x, y) of points (n, 3) in the wall's frame; of the world, not of a mirror image."""
    across, tilt, zoom = view
    up = 1 if float(volume["frame_axes"].values[1, 1]) >= 0 else -1
    handed = up * np.linalg.det(volume["frame_axes"].values)
    deep = AXES["z"][1]
    sides = np.array([np.ptp(AXES["x"][:2]), np.ptp(AXES["y"][:2]), deep])
    radius = np.linalg.norm(sides) / 2
    from_middle = (np.atleast_2d(points) - [0, 0, deep / 2]) * [1, up, handed]
    c, s = np.cos(across), np.sin(across)
    about_y = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    c, s = np.cos(tilt), np.sin(tilt)
    about_x = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    x, y, near = (from_middle @ (about_x @ about_y).T).T
    width, height = size
    scale = zoom * min(width, height) / (2 * radius) * EYE / (EYE - near / radius)
    return np.stack([width / 2 + scale * x, height / 2 - scale * y], axis=-1)


def bright(page):
    """Places (x, y) of pixels in the color of the largest voxels."""
    red, green, blue = np.moveaxis(picture(page), 2, 0)
    rows, columns = np.nonzero((red > 110) & (green > 110) & (blue < 0.85 * green))
    return np.stack([columns, rows], axis=-1) + 0.5


@pytest.mark.parametrize(
    ("size", "wall"), [*zip(SIZES, 3 * [Wall(8)], strict=True), (SIZES[1], turned(8))]
)
def test_voxels_are_where_the_truth_is(tmp_path, size, wall):
    capture, volume = made(wall=wall)
    voxel = 12, 3, 4
    volume["intensity"].values[voxel[::-1]] = 1
    viewport = {"width": size[0], "height": size[1]}
    with opened(tmp_path, contents_of(volume, capture=capture), viewport=viewport) as page:
        for across, tilt, zoom in VIEWS:
            set_(page, pixels=[], across=across, tilt=tilt, zoom=zoom)
            height, width, _ = picture(page).shape
            view = across, tilt, zoom
            expected = projected(center(*voxel), (width, height), view, volume)[0]
            np.testing.assert_allclose(bright(page).mean(axis=0), expected, atol=3)
        label = page.locator(".volume canvas").first.get_attribute("aria-label")
        assert "3D" in label
        assert page.evaluate("document.documentElement.scrollWidth") <= size[0]


def test_a_plane_covers_what_its_corners_enclose(tmp_path):
    _, volume = made()
    volume["intensity"].values[3] = 1
    with opened(tmp_path, contents_of(volume)) as page:
        for across, tilt, zoom in VIEWS[1:]:
            set_(page, view="space", pixels=[], across=across, tilt=tilt, zoom=zoom, bin=0)
            height, width, _ = picture(page).shape
            z = center(0, 0, 3)[2]
            corners = [(x, y, z) for x in AXES["x"][:2] for y in AXES["y"][:2]]
            view = across, tilt, zoom
            places = projected(corners, (width, height), view, volume)
            found = bright(page)
            margin = 0.05 * min(width, height)  # A voxel's depth
            np.testing.assert_allclose(found.min(axis=0), places.min(axis=0), atol=margin)
            np.testing.assert_allclose(found.max(axis=0), places.max(axis=0), atol=margin)


@pytest.mark.parametrize("mode", ["single", "confocal", "exhaustive"])
@pytest.mark.parametrize("legs", [False, True])
def test_the_ellipsoid_is_where_the_path_has_its_length(tmp_path, mode, legs):
    capture, volume = made(mode, legs=legs)
    voxel = 12, 3, 4
    volume["intensity"].values[voxel[::-1]] = 1
    laser = 5 if mode == "exhaustive" else 0
    column, row = 2, 6
    grid, normal = (capture[f"sensor_{name}"].values for name in ("grid", "normals"))
    point = grid[row, column].astype(float)
    assert normal[row, column] @ [0, 0, 1] == 1
    spots = capture["laser_grid"].values.reshape(-1, 3).astype(float)
    spot = point if mode == "confocal" else spots[laser]
    length = sum(np.linalg.norm(center(*voxel) - focus) for focus in (point, spot))
    counted = length
    for end, near in (("laser", spot), ("sensor", point)):
        counted += legs * np.linalg.norm(capture[f"{end}_origin"].values - near)
    bin_ = int((counted - capture.attrs["start_opl"]) / capture.attrs["bin_width_opl"])
    with opened(tmp_path, contents_of(volume, capture=capture)) as page:
        view = {"across": -0.4, "tilt": 0.3, "zoom": 0.6}
        # Rows of the grid run upwards, and rows of the picture downwards
        shown = [column, len(grid) - 1 - row]
        now = set_(page, pixels=[shown], laser=laser, bin=bin_, **view)
        with_ellipsoid = picture(page)
        assert len(bright(page)) == 0  # The voxel is blue
        length += now["opl"] - counted
        assert f"{length:.4g} m" in page.locator(".assumes").first.inner_text()
        set_(page, bin=bin_ - 20)
        assert len(bright(page)) > 0
        set_(page, pixels=[])
        drawn = abs(with_ellipsoid - picture(page)).max(axis=2) > 20
        rows, columns = np.nonzero(drawn)
        places = np.stack([columns, rows], axis=-1) + 0.5
        # The ellipse in the plane of the wall, around a focus
        angles = np.linspace(0, 2 * np.pi, 16, endpoint=False)
        directions = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=-1)
        apart = spot - point
        r = (length**2 - apart @ apart) / (2 * (length - directions @ apart))
        height, width = drawn.shape
        ring = projected(point + r[:, None] * directions, (width, height), view.values(), volume)
        # And its point that is farthest from the wall
        apex = (point + spot) / 2 + [0, 0, np.sqrt(length**2 - apart @ apart) / 2]
        top = projected(apex, (width, height), view.values(), volume)
        seen = [
            each for each in (*ring, *top) if (each > 0).all() and (each < (width, height)).all()
        ]
        assert len(seen) >= 5
        for each in seen:
            assert np.linalg.norm(places - each, axis=1).min() < 2.5
        assert set_(page, pixels=[shown], bin=0)["view"] == "space"


def test_touch_keys_wheel_and_mouse(tmp_path):
    capture, volume = made()
    volume["intensity"].values[4, 3, 12] = 1
    contents = contents_of(volume, capture=capture)
    phone = {"viewport": {"width": 390, "height": 844}, "has_touch": True}
    with opened(tmp_path, contents, **phone) as page:
        first = set_(page, pixels=[[1, 1]])
        box = page.locator(".volume").first.bounding_box()
        x, y = box["x"] + 100, box["y"] + 100
        touch = page.context.new_cdp_session(page)
        for kind, at in (
            ("Start", [(x, y)]),
            ("Move", [(x + 20, y + 10)]),
            ("Move", [(x + 50, y + 20)]),
            ("End", []),
        ):
            points = [{"x": a, "y": b} for a, b in at]
            touch.send("Input.dispatchTouchEvent", {"type": f"touch{kind}", "touchPoints": points})
        now = state(page)
        assert now["across"] == pytest.approx(first["across"] + 0.5)
        assert now["tilt"] == pytest.approx(first["tilt"] + 0.2)
        assert now["pixels"] == [[1, 1]]
        page.keyboard.press("ArrowLeft")  # The view has the focus
        assert state(page)["across"] == pytest.approx(now["across"] - 0.1)
        assert state(page)["bin"] == now["bin"]
        page.keyboard.press("Shift+ArrowRight")
        assert state(page)["pixels"] == [[2, 1]]
        page.keyboard.press("+")
        assert state(page)["zoom"] == pytest.approx(1.1)
        page.keyboard.press("0")
        assert [state(page)[name] for name in ("across", "tilt", "zoom")] == [-0.5, 0.35, 1]
        column, row = 6, 2
        point = capture["sensor_grid"].values[row, column]
        view = -0.5, 0.35, 1
        a, b = projected(point, (box["width"], box["height"]), view, volume)[0]
        page.touchscreen.tap(box["x"] + a, box["y"] + b)
        assert state(page)["pixels"][-1] == [column, 7 - row]
        page.mouse.move(x, y)
        page.mouse.wheel(0, -100)
        assert state(page)["zoom"] > 1.1
        page.get_by_label("Threshold").first.press("End")
        assert state(page)["threshold"] == 1
        page.locator(".play").first.click()
        page.wait_for_function(
            "() => document.getElementById('explorer').explorer.state().bin != 0"
        )
        assert state(page)["view"] == "space"


def test_contents_have_wall_and_volume():
    for mode, wall in (("confocal", Wall(8)), ("exhaustive", turned(8))):
        capture, volume = made(mode, wall=wall, legs=True)
        volume["intensity"].values[4, 3, 12] = 1
        contents = contents_of(volume, capture=capture, packed=True)
        found = contents.part("wall").reshape(8, 8, 3)
        downwards = volume["frame_axes"].values[1, 1] < 0
        np.testing.assert_allclose(found, wall.grid()[:: 1 if downwards else -1], atol=1e-6)
        origins = contents.part("origins").reshape(2, 3)
        np.testing.assert_allclose(origins, [[-0.6, 0.1, 1.4], [0.4, 0.3, 1.7]], atol=1e-6)
        assert ("spots" in contents.header["parts"]) == (mode == "exhaustive")
        inner = contents.header["volume"]
        part = inner["parts"]["light"]
        codes = np.frombuffer(contents.data, part["type"], part["length"], part["offset"])
        assert (codes > 0).sum() == 2  # Up and down again, as differences
        assert contents.header["kind"] == "capture"
        assert inner["kind"] == "volume"


def test_what_does_not_fit():
    capture, volume = made()
    elsewhere, _ = made(wall=Wall(8, origin=(1.0, 0, 0)))
    other, _ = made(wall=turned(8))
    bare = volume.drop_vars("frame_origin")
    for data, given, said in (
        (capture, {"capture": capture}, "capture = .*: must be None for a capture"),
        (volume, {"capture": volume}, "capture: expected a capture"),
        (volume, {"capture": 3}, "capture.*(expected a capture|must be an xarray.Dataset)"),
        (bare, {"capture": capture}, "data: frame_origin or frame_axes is missing"),
        (volume, {"capture": elsewhere}, r"capture with a wall at \[1.0, 0.0, 0.0\] m: must be"),
        (volume, {"capture": other}, "capture with a wall at .*: must be the wall of data"),
        (volume, {"capture": capture, "orders": {"a": capture}}, "orders = .*: must be None"),
    ):
        with pytest.raises(ValueError, match=said) as error:
            contents_of(data, **given)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_nothing_hinders_readers(tmp_path, width, height):
    capture, volume = made()
    volume["intensity"].values[4, 3, 12] = 1
    viewport = {"width": width, "height": height}
    contents = contents_of(volume, capture=capture)
    with opened(tmp_path, contents, dark=width == 800, viewport=viewport) as page:
        assert hindrances(page) == []
        box = page.locator(".play").first.bounding_box()
        assert box["y"] + box["height"] <= height


def test_links_pictures_and_films_are_of_the_view(tmp_path):
    capture, volume = made()
    volume["intensity"].values[4, 3, 12] = 1
    with opened(tmp_path, contents_of(volume, capture=capture)) as page:
        set_(page, pixels=[[1, 1]], bin=60, across=1.25, zoom=1.5, threshold=0.4)
        seen, link = picture(page), fragment(page)
        assert "across=1.25" in link
        page.evaluate("location.hash = ''")
        assert state(page)["across"] == -0.5
        page.evaluate("hash => { location.hash = hash }", link)
        assert state(page)["threshold"] == 0.4
        assert (picture(page) == seen).all()
        # The buttons of the volume's own explorer are below
        page.locator(".saves").nth(1).evaluate("saves => saves.remove()")
        image = np.asarray(Image.open(saved(page, "PNG", tmp_path)).convert("RGB"), float)
        small = np.asarray(Image.fromarray(seen.astype(np.uint8)).resize((64, 32)), float)
        high = round(image.shape[1] * seen.shape[0] / seen.shape[1])
        found = np.asarray(Image.fromarray(image[:high].astype(np.uint8)).resize((64, 32)), float)
        assert abs(found - small).mean() < 2
        with Image.open(saved(page, "GIF", tmp_path)) as film:
            frames = [
                np.asarray(each.convert("RGB"), float) for each in ImageSequence.Iterator(film)
            ]
        assert len(frames) == capture.sizes["opl"]
        assert abs(frames[60] - frames[40]).max() > 50  # The ellipsoid moves
        assert (picture(page) == seen).all()
