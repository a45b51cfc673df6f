"""a1.deliverables: what the notebook has written, checked by physics. And the bonus' points."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

TRIANGLE = np.array([[0.0, 0, 0], [1, 1, 1], [0.5, 1, 2]])
LIGHT = {"position": np.array([-0.9, 1.5, 1.3]), "energy": 110.0}  # of bust_simple
VIEW = {"origin": [0.55, 1.05, 2.45], "target": [0, 0.325, 0], "fov_degrees": 16}


def arrays(submission, name, wanted):
    """Arrays of a file, all there, finite and of the right number of axes."""
    content = submission.arrays(f"deliverables/{name}.npz")
    for key, axes in wanted.items():
        expect.true(
            key in content,
            f"deliverables/{name}.npz has no array {key!r}; it has "
            + (", ".join(sorted(content)) or "none"),
        )
        array = content[key]
        expect.true(
            array.ndim == axes,
            f"{key} of {name}.npz must have {axes} axes; its shape is {array.shape}",
        )
        expect.finite(array, f"{key} of {name}.npz")
    return content


def renders(submission, name, keys):
    """Pictures of shape (S, H, W, 3), S independent renders of each, equally large."""
    content = arrays(submission, name, dict.fromkeys(keys, 4))
    for key in keys:
        s, h, w, c = content[key].shape
        right = s >= 16 and h >= 8 and w >= 12 and c == 3
        expect.true(
            right,
            f"{key} of {name}.npz must have the shape (S, H, W, 3) with S >= 16, "
            f"H >= 8, W >= 12; it is {(s, h, w, c)}",
        )
        expect.shape(content[key][0], content[keys[0]].shape[1:], f"renders of {key}")
        expect.true(content[key].min() >= 0, f"{key} of {name}.npz must be radiance, 0 or more")
        hint = "each of the S renders needs a seed of its own"
        different = len(np.unique(content[key].reshape(s, -1), axis=0)) == s
        expect.true(different, f"the renders of {key} must be independent", hint=hint)
    return content


def picture(submission, name):
    """A PNG file of some size that shows more than one color."""
    path = submission.path(f"deliverables/{name}.png")
    from PIL import Image

    try:
        with Image.open(path) as image:
            expect.true(image.format == "PNG", f"{name}.png must be a PNG file")
            width, height = image.size
            expect.true(
                300 <= width <= 10000 and 200 <= height <= 10000,
                f"{name}.png must have from 300 x 200 to 10000 x 10000 pixels; it has "
                f"{width} x {height}",
            )
            low, high = image.convert("L").getextrema()
    except (OSError, ValueError, SyntaxError) as error:
        raise expect.Failure(f"{name}.png is damaged: {error}") from None
    expect.true(high > low, f"{name}.png must show points; all its pixels are equal")


@pytest.mark.a1_deliverables
def test_point_sets(submission):
    """warps.png, and warps.npz: each set follows its density."""
    picture(submission, "warps")
    keys = (
        "tent",
        "uniform_disk",
        "uniform_sphere",
        "uniform_hemisphere",
        "cosine_hemisphere",
        "beckmann",
        "triangle",
        "sphere_cap",
    )
    p = arrays(submission, "warps", dict.fromkeys(keys, 2))
    for key in keys:
        columns = 2 if key in ("tent", "uniform_disk") else 3
        n = len(p[key])
        expect.shape(p[key], (n, columns), f"points of {key}")
        expect.true(1000 <= n <= 100_000, f"{key} must have 1000 to 100000 points, not {n}")
    z = {key: p[key][:, -1].astype(float) for key in keys}
    cap = 1 - np.cos(np.pi / 4)
    tan2 = (
        np.sum(p["beckmann"][:, :2].astype(float) ** 2, axis=1)
        / np.maximum(z["beckmann"], 1e-9) ** 2
    )
    uniform = {
        "tent": formulas.tent_cdf(np.clip(p["tent"][:, 0], -1, 1)),
        "uniform_disk": np.sum(p["uniform_disk"].astype(float) ** 2, axis=1),
        "uniform_sphere": 0.5 * (1 + z["uniform_sphere"]),
        "uniform_hemisphere": z["uniform_hemisphere"],
        "cosine_hemisphere": z["cosine_hemisphere"] ** 2,
        "beckmann": np.exp(-tan2 / 0.5**2),
        "triangle": formulas.triangle_square(TRIANGLE, p["triangle"].astype(float))[0][:, 0],
        "sphere_cap": (1 - z["sphere_cap"]) / cap,
    }
    for key, u in uniform.items():
        inside = u.min() >= -1e-4 and u.max() <= 1 + 1e-4
        expect.true(inside, f"points of {key} must lie in its domain")
        counts, _ = np.histogram(np.clip(u, 0, 1), 10, (0, 1))
        hint = "the points must come from independent random numbers, and alpha be 0.5"
        expect.histogram(counts, np.full(10, 0.1), f"points of {key} in ten equal parts", hint=hint)


@pytest.mark.a1_deliverables
def test_bust(submission):
    """simple.npz and ao.npz: the ground around the bust has known values."""
    image = arrays(submission, "simple", {"image": 3})["image"]
    ground, _ = ground_radiance(image)
    hint = "tofrender.bust_simple, linear radiance, no tone mapping; rows from the top"
    share = np.mean(np.abs(image[..., 1] - ground) <= 0.05 * ground)
    expect.true(
        share > 0.3,
        "in simple.npz at least 30 % of the pixels must show the lit ground at "
        f"Phi cos / (4 pi^2 d^2); {100 * share:.0f} % do",
        hint=hint,
    )
    expect.true(
        (image[..., 1] == 0).any() or image[..., 1].min() < 0.2 * ground.min(),
        "simple.npz must show a shadow",
        hint="is the shadow ray tested?",
    )
    ao = arrays(submission, "ao", {"image": 3})["image"]
    expect.true(ao.min() >= 0 and ao.max() <= 1 + 1e-4, "ao.npz must hold values from 0 to 1")
    _, far = ground_radiance(ao)
    expect.true(
        ao[far].mean() > 0.9,
        "in ao.npz the ground far from the bust must be open; the mean "
        f"there is {ao[far].mean():.3g}",
        hint="cosine-weighted directions, shadow rays",
    )
    half = np.mean(ao[..., 1] < 0.75)
    expect.true(
        0.05 < half < 0.6,
        "in ao.npz 5 % to 60 % of the pixels must be hidden from a "
        f"quarter of the sky; {100 * half:.0f} % are",
        hint="is visibility tested?",
    )


def ground_radiance(image):
    """Radiance of the unshadowed ground in each pixel, and mask of pixels far from the bust."""
    height, width = image.shape[:2]
    expect.true(
        width >= 12 and height >= 12, "pictures of the bust must have 12 x 12 pixels or more"
    )
    d = formulas.camera_rays(**VIEW, width=width, height=height)
    origin = np.array(VIEW["origin"])
    x = origin - d * (origin[1] / d[..., 1:2])
    up = np.array([0, 1.0, 0])
    flat = formulas.point_light(x=x.reshape(-1, 3), normal=up, **LIGHT)
    return flat.reshape(height, width), np.hypot(x[..., 0], x[..., 2]) > 2.0


@pytest.mark.a1_deliverables
@pytest.mark.parametrize("name", ["veach", "small_box"])
def test_three_path_tracers(submission, name):
    """veach.npz and small_box.npz: three estimators of one picture."""
    content = renders(submission, name, ("mats", "nee", "mis"))
    means = {key: content[key].astype(float).mean(axis=(1, 2)) for key in ("mats", "nee", "mis")}
    hint = "same scene, size and max_bounces; is light counted once, in each of them?"
    for key in ("mats", "nee"):
        what = f"mean color of {name}.npz, {key} against mis"
        expect.same(means[key], means["mis"], what, rounding=2e-3, hint=hint)
    expect.true(means["mis"].mean() > 0.05, f"{name}.npz must show the lit scene")
    if name == "veach":
        noise = {key: relative_noise(content[key], content["mis"]) for key in means}
        for key in ("mats", "nee"):
            expect.true(
                noise["mis"] < noise[key],
                f"over the picture of veach.npz, mis must have less noise than {key}; root mean "
                f"square of the relative deviation: {noise['mis']:.3g} and {noise[key]:.3g}",
                hint="the same number of samples for all three; are the weights right?",
            )


def relative_noise(content, reference):
    """Root mean square over the pixels of the deviation between renders, as a part of the mean."""
    mean = reference.astype(float).mean(axis=(0, 3))
    deviation = content.astype(float).mean(axis=3).std(axis=0, ddof=1)
    bright = mean > 0.01 * mean.mean()
    return float(np.sqrt(np.mean((deviation[bright] / mean[bright]) ** 2)))


@pytest.mark.a1_deliverables
def test_equal_lights(submission):
    """sphere_lights.npz and rectangle_light.npz: lights that give the same light."""
    sizes = ("small", "medium", "large")
    content = renders(submission, "sphere_lights", sizes)
    hint = "spheres of one power give the same light at any radius, if the whole sphere is seen"
    parts = {key: content[key].astype(float).mean(axis=(1, 2)) for key in sizes}
    for key in ("small", "large"):
        what = f"mean color of sphere_lights.npz, {key} against medium"
        expect.same(parts[key], parts["medium"], what, rounding=2e-3, hint=hint)
    expect.true(parts["medium"].mean() > 0.05, "sphere_lights.npz must show the lit scene")
    content = renders(submission, "rectangle_light", ("quad", "triangles"))
    quad, triangles = (
        content[key].astype(float).mean(axis=(1, 2)) for key in ("quad", "triangles")
    )
    hint = "two triangles are one rectangle: are all lights asked, each with its chance?"
    what = "mean color of rectangle_light.npz, triangles against quad"
    expect.same(triangles, quad, what, rounding=2e-3, hint=hint)
    expect.true(quad.mean() > 0.05, "rectangle_light.npz must show the lit scene")


@pytest.mark.a1_hierarchical
def test_points_of_an_image(submission):
    """hierarchical.npz and hierarchical.png: points against the image that they come from."""
    picture(submission, "hierarchical")
    content = arrays(submission, "hierarchical", {"image": 2, "points": 2})
    image = content["image"].astype(float)
    p = content["points"].astype(float)
    n = len(image)
    right = image.shape == (n, n) and n >= 8 and n & (n - 1) == 0 and image.min() >= 0
    expect.true(
        right and image.max() > image.min(),
        "image of hierarchical.npz must be n x n "
        f"numbers, n a power of two, 8 or more; its shape is {image.shape}",
    )
    expect.true(
        p.shape[1] == 2 and 10_000 <= len(p) <= 1_000_000,
        "points of hierarchical.npz must "
        f"have the shape (N, 2), N from 10000 to 1000000; it is {p.shape}",
    )
    counts, *_ = np.histogram2d(p[:, 1], p[:, 0], n, [(0, 1), (0, 1)])
    expect.true(counts.sum() == len(p), "all points must lie in the unit square")
    hint = "independent random numbers; rows run down with y"
    expect.histogram(counts, image / image.sum(), "points in each texel of the image", hint=hint)
