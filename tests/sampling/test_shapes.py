"""Shapes that emit light: densities, closed forms, and wrong densities that must be found."""

import itertools
import math
from functools import partial

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers import support
from helpers.parts import rotate, translate, unit
from helpers.support import COMPARISONS, agree, over_seeds, refused

from tofrender.sampling import (
    Quad,
    Sphere,
    SurfaceGroup,
    Triangle,
    chi_square_test,
    sample_sphere_cap,
    sample_sphere_cap_pdf,
    sample_triangle,
    sample_triangle_pdf,
)
from tofrender.sampling.domains import Domain, sphere as all_directions
from tofrender.sampling.emitter_records import visible
from tofrender.sampling.scene_emitters import emitters_of

TILT = translate(0.3, -0.4, 1.5) @ rotate((0.6, 0.8, 0), 50)
QUAD = Quad((1, 2), emission=(1, 2, 3), transform=TILT)
TRIANGLE = Triangle([0, 0, 2], [1, 0, 1], [0.2, 1, 1.5], emission=2)
ORIGINS = {"below": (0, 0, 0), "near": (0.4, -0.2, 1.2), "behind": (0, 0, 4.5), "side": (-3, 2, 1)}
MOVED = translate(0, 0, 1) @ rotate((0.6, 0, 0.8), 40) @ mi.ScalarTransform4f().scale(2)
SPHERES = {
    "plain": Sphere((0, 0, 3), 1, emission=2),
    "moved": Sphere((0, 1, 0), 0.5, emission=1, transform=MOVED),
}
SHAPES = [QUAD, TRIANGLE, *SPHERES.values()]


def point(o, n: int = 1) -> mi.Point3f:
    """Return the same point in n lanes."""
    return mi.Point3f(*(float(x) for x in o)) + dr.zeros(mi.Float, n)


def numpy(array, n: int = 1) -> np.ndarray:
    return np.array(array + dr.zeros(mi.Float, n), dtype=np.float64).T


def chi_square(sample, pdf, domain, **options):
    options = {"samples": 50_000, "resolution": 24, "tests": COMPARISONS} | options
    return chi_square_test(sample, pdf, domain, **options)


def verdict(shape, o, domain=None):
    """Return the result of the chi-square test of a shape's directions from `o`."""

    def sample(u):
        record = shape.sample(point(o, dr.width(u)), u)
        return record.d, dr.select(record.valid, mi.Float(1), 0), record.pdf

    return chi_square(sample, lambda v: shape.pdf(point(o), v), domain or domain_of(shape, o))


def patch_domain(patch, o) -> Domain:
    """Return the domain of directions from `o` to a patch, by smooth coordinates (a, b).

    For a triangle, (b1, b2) is (a, (1 - a) b). The solid angle of da db is the solid angle of the
    area that it covers: cos(theta) / r^2 dA.
    """
    o = np.array(o, dtype=np.float64)
    triangle = isinstance(patch, Triangle)
    basis = np.column_stack([patch.e0, patch.e1, patch.normal])

    def place(ab):
        a, b = ab[0], ab[1] * (1 - ab[0] if triangle else 1)
        return (patch.corner + np.outer(a, patch.e0) + np.outer(b, patch.e1)) - o

    def to_points(ab):
        to_p = place(ab)
        return (to_p / np.linalg.norm(to_p, axis=1, keepdims=True)).T

    def area(ab):
        to_p = place(ab)
        r = np.linalg.norm(to_p, axis=1)
        cos_theta = np.abs(to_p @ patch.normal) / r
        jacobian = np.linalg.norm(np.cross(patch.e0, patch.e1)) * (1 - ab[0] if triangle else 1)
        return jacobian * cos_theta / r**2

    def coordinates(v):
        t = ((patch.corner - o) @ patch.normal) / (v.T @ patch.normal)
        a, b, _ = np.linalg.solve(basis, (o + t[:, None] * v.T - patch.corner).T)
        return np.stack([a, b / (1 - a) if triangle else b])

    def contains(v):
        ahead = ((patch.corner - o) @ patch.normal) / (v.T @ patch.normal) > 0
        ab = coordinates(v)
        return ahead & np.all((ab > -1e-3) & (ab < 1 + 1e-3), axis=0)

    return Domain(
        labels=("a", "b"),
        low=(0.0, 0.0),
        high=(1.0, 1.0),
        aspect=1.0,
        to_plane=lambda v: np.clip(coordinates(v), 0, 1),
        to_points=to_points,
        area=area,
        contains=contains,
    )


def cone_domain(axis, sin_theta_max: float) -> Domain:
    """Return the domain of a cone's directions, by azimuth and angle to its axis."""
    z = unit(axis)
    x = unit(np.cross(z, [0.3, 0.5, 0.9]))
    frame = np.column_stack([x, np.cross(z, x), z])
    whole = all_directions()

    def to_plane(v):
        return whole.to_plane(frame.T @ v)

    theta_max = math.asin(sin_theta_max)
    return Domain(
        labels=whole.labels,
        low=(-math.pi, 0.0),
        high=(math.pi, theta_max),
        aspect=0.5,
        to_plane=lambda v: np.minimum(to_plane(v), [[math.pi], [theta_max]]),
        to_points=lambda ab: frame @ whole.to_points(ab),
        area=whole.area,
        contains=lambda v: to_plane(v)[1] <= theta_max * (1 + 1e-5) + 1e-6,
    )


def domain_of(shape, o) -> Domain:
    if not isinstance(shape, Sphere):
        return patch_domain(shape, o)
    to_center = shape.center - np.array(o)
    far = np.linalg.norm(to_center)
    return cone_domain(to_center, shape.radius / far) if far > shape.radius else all_directions()


CORNERS = ([0, 0, 0], [1, 1, 1], [0.5, 1, 2])
FLAT = ([0, 0, 0], [1, 0, 0], [0.25, 1, 0])  # In z = 0, where the test counts
CAP = math.cos(1.0)
CAP_Z = (1 + CAP) / 2


def flat_triangle(u):
    p = sample_triangle(*FLAT, u)
    return mi.Point2f(p.x, p.y)


def flat_triangle_pdf(p):
    return sample_triangle_pdf(mi.Point3f(p.x, p.y, 0), *FLAT)


def even_angles(u):
    """Return a cap in which theta is sampled uniformly, instead of its cosine."""
    sin_phi, cos_phi = dr.sincos(dr.two_pi * u.y)
    sin_theta, cos_theta = dr.sincos(u.x)
    return mi.Vector3f(sin_theta * cos_phi, sin_theta * sin_phi, cos_theta)


DRAWN = {
    "triangle": (
        {"domain": "square", "resolution": 48, "expected_moments": {"y": 1 / 3}},
        (flat_triangle, flat_triangle_pdf),
        lambda u: flat_triangle(mi.Point2f(u.x * (2 - u.x), u.y)),  # b1 = u, not 1 - sqrt(1 - u)
        lambda p: 0.5 * flat_triangle_pdf(p),
    ),
    "cap": (
        {"domain": cone_domain([0, 0, 1], math.sin(1.0)), "expected_moments": {"z": CAP_Z}},
        (lambda u: sample_sphere_cap(u, CAP), lambda v: sample_sphere_cap_pdf(v, CAP)),
        even_angles,
        lambda v: dr.select(sample_sphere_cap_pdf(v, CAP) > 0, 1 / (4 * math.pi), 0),
    ),
}


@pytest.mark.statistical
@pytest.mark.parametrize("name", DRAWN)
def test_samples_follow_the_density_and_bugs_are_found(name):
    options, (sample, pdf), wrong_sample, wrong_pdf = DRAWN[name]
    right = chi_square(sample, pdf, **options)
    assert right.passed, right
    assert not chi_square(wrong_sample, pdf, **options).passed
    assert not chi_square(sample, wrong_pdf, **options).passed


def test_triangle_density():
    v0, v1, v2 = (np.array(each, dtype=float) for each in CORNERS)
    area = 0.5 * np.linalg.norm(np.cross(v1 - v0, v2 - v0))
    for u in (support.uniform(10_000), mi.Point2f([0, 0, 1, 1], [0, 1, 0, 1])):
        pdf = sample_triangle_pdf(sample_triangle(*CORNERS, u), *CORNERS)
        assert np.array(pdf) == pytest.approx(1 / area)
    normal = unit(np.cross(v1 - v0, v2 - v0))
    middle = (v0 + v1 + v2) / 3
    for away in (1e-3 * normal, -1e-3 * normal, 2 * (v0 - middle), 1.001 * (v1 - middle)):
        off = middle + away
        assert sample_triangle_pdf(mi.Point3f(*off.tolist()), *CORNERS)[0] == 0
    far = [[1000 + x, y, z] for x, y, z in CORNERS]
    p = sample_triangle(*far, support.uniform(1000))
    assert np.array(sample_triangle_pdf(p, *far)).min() > 0
    # Corners may be arrays; their degenerate triangles have no density
    many = mi.Point3f(0), mi.Point3f([1, 2, 0], 0, 0), mi.Point3f(0, 2, 0)
    pdf = sample_triangle_pdf(sample_triangle(*many, mi.Point2f(0.5)), *many)
    assert np.array(pdf) == pytest.approx([1, 0.5, 0])


@pytest.mark.parametrize("cosine", [-1.0, -0.5, 0.0, math.cos(math.pi / 4), 0.999, 1 - 1e-9])
def test_cap_samples_and_density(cosine):
    height = 1 - cosine
    v = numpy(sample_sphere_cap(support.uniform(1 << 16), cosine))
    assert np.linalg.norm(v, axis=1) == pytest.approx(1, abs=1e-6)
    # sin^2(theta) has the mean height - height^2 / 3, known to all digits where the cosine is not
    sin2 = v[:, 0] ** 2 + v[:, 1] ** 2
    assert sin2.mean() == pytest.approx(height - height**2 / 3, rel=0.02)
    assert np.abs(v[:, :2].mean(axis=0)).max() < 0.02 * math.sqrt(height)
    pdf = np.array(sample_sphere_cap_pdf(mi.Vector3f(*v.T), cosine))
    assert pdf == pytest.approx(1 / (2 * math.pi * height), rel=1e-5)
    if cosine > -1:
        wide = sample_sphere_cap(mi.Point2f(1, 0.3), cosine - 0.01 * height)
        assert sample_sphere_cap_pdf(wide, cosine)[0] == 0
        assert sample_sphere_cap_pdf(mi.Vector3f(0, 0, -1), cosine)[0] == 0
    ends = sample_sphere_cap(mi.Point2f([0, 0, 1, 1], [0, 1, 0, 1]), cosine)
    assert np.isfinite(np.array(ends)).all()
    assert np.array(sample_sphere_cap_pdf(ends, cosine)).min() > 0


def test_cap_of_one_direction_and_arrays():
    v = sample_sphere_cap(mi.Point2f(0.7, 0.2), 1.0)
    assert np.array(v).ravel() == pytest.approx([0, 0, 1])
    assert sample_sphere_cap_pdf(mi.Vector3f(0, 0, 1), 1)[0] == 0
    cosines = mi.Float([0, 0.5])
    pdf = np.array(sample_sphere_cap_pdf(sample_sphere_cap(mi.Point2f(0.5), cosines), cosines))
    assert pdf == pytest.approx([1 / (2 * math.pi), 1 / math.pi])


@pytest.mark.statistical
@pytest.mark.parametrize("origin", ORIGINS)
@pytest.mark.parametrize("shape", SHAPES, ids=repr)
def test_directions_follow_the_density(shape, origin):
    result = verdict(shape, ORIGINS[origin])
    assert result.passed, result


@pytest.mark.statistical
@pytest.mark.parametrize("o", [(0, 0, 3), (0.3, 0.2, 2.5), (0, 0.99, 3)])
def test_directions_from_inside_a_sphere(o):
    """All directions are valid, with the density 1 / (4 pi)."""
    sphere = SPHERES["plain"]
    result = verdict(sphere, o)
    assert result.passed, result
    # The cone's formula, cut where its root is negative, would give the hemisphere
    half = with_pdf(sphere, lambda o, v, pdf: mi.Float(1 / (2 * math.pi)))
    assert not verdict(half, o, "sphere").passed
    record = sphere.sample(point(o, 1000), support.uniform(1000))
    assert np.array(record.pdf) == pytest.approx(1 / (4 * math.pi))
    assert np.array(record.valid).all()
    assert not np.any(np.array(record.radiance))  # Light leaves outwards
    inwards = Sphere((0, 0, 3), 1, emission=2, flip_normals=True)
    assert np.array(inwards.sample(point(o, 9), support.uniform(9)).radiance) == pytest.approx(2)
    assert not np.any(np.array(inwards.sample(point((0, 0, 0), 9), support.uniform(9)).radiance))


@pytest.mark.statistical
def test_directions_from_the_surface_of_a_sphere():
    """Half of the directions enter the sphere, and only these are valid."""
    result = verdict(SPHERES["plain"], (0, 0, 2))
    assert result.passed, result
    assert result.valid == pytest.approx(0.5, abs=0.02)
    assert result.pdf_integral == pytest.approx(0.5, abs=2e-3)
    # Half of the directions from a point a micrometer above: a cone of almost a hemisphere
    record = SPHERES["plain"].sample(point((0, 0, 2 - 1e-6), 1000), support.uniform(1000))
    assert np.array(record.pdf) == pytest.approx(1 / (2 * math.pi), rel=5e-3)
    assert np.array(record.distance).max() < 5e-3


@pytest.mark.parametrize("origin", ORIGINS)
@pytest.mark.parametrize("shape", SHAPES, ids=repr)
def test_records(shape, origin):
    """The fields of a record agree with an intersection of its ray."""
    o = point(ORIGINS[origin], 2000)
    record = shape.sample(o, support.uniform(2000))
    again = shape.record(o, record.d)
    dr.eval(record, again)
    inner = np.array(record.valid & again.valid)
    assert inner.mean() > 0.998  # Rounding carries a few past the edge
    assert np.array(dr.norm(record.d)) == pytest.approx(1, abs=1e-6)
    assert np.array(dr.norm(record.n)) == pytest.approx(1, abs=1e-5)
    assert numpy(record.o + record.distance * record.d) == pytest.approx(numpy(record.p), abs=1e-5)
    lit = np.array(dr.dot(record.d, record.n) < 0)
    emission = np.resize(np.array(shape.emission), 3)
    assert numpy(record.radiance) == pytest.approx(np.outer(lit, emission))
    assert numpy(record.weight * record.pdf) == pytest.approx(numpy(record.radiance), rel=1e-5)
    close = 2e-3 if isinstance(shape, Sphere) else 2e-5  # A sphere's edge is tangential
    for name in ("p", "n"):
        a, b = (numpy(getattr(each, name), 2000)[inner] for each in (record, again))
        assert a == pytest.approx(b, abs=close)
    for name in ("distance", "pdf"):
        a, b = (np.array(getattr(each, name))[inner] for each in (record, again))
        assert a == pytest.approx(b, rel=close)
    assert np.array(shape.pdf(o, record.d)) == pytest.approx(np.array(again.pdf))
    distance, valid, n = shape.intersect(o, record.d)
    assert np.array_equal(np.array(distance), np.array(again.distance))
    assert np.array_equal(np.array(valid), np.array(again.valid))
    assert np.array_equal(numpy(n), numpy(again.n))
    behind = shape.record(o, -record.d)
    dr.eval(behind)
    assert not np.any(np.array(behind.valid) | (np.array(behind.pdf) > 0))
    assert not np.any(np.array(behind.weight))


@pytest.mark.parametrize("shape", SHAPES, ids=repr)
def test_edges_of_the_unit_square_are_finite(shape):
    u = mi.Point2f([0, 0, 1, 1, 0.5], [0, 1, 0, 1, 0])
    origins = [*ORIGINS.values(), (0, 0, 3), (0, 0, 2)]
    if isinstance(shape, Triangle | Quad):
        origins += [shape.corner, shape.corner + shape.e0, shape.corner - shape.e0]
    for o in origins:
        record = shape.sample(point(o, 5), u)
        for each in (record.pdf, record.weight, record.radiance):
            assert np.isfinite(np.array(each)).all()
    for o in ((3, 0, 0), (0.2, 0.1, 0), (1, 1, 0)):  # In the plane of a patch
        record = Quad((2, 2), emission=1).sample(point(o, 100), support.uniform(100))
        assert not np.any(np.array(record.valid) | (np.array(record.pdf) != 0))


@pytest.mark.parametrize(
    ("distance", "radius"), [(1e3, 1e-1), (1e5, 1.0), (1e6, 100.0), (1e-3, 1e-6)]
)
def test_far_and_small_spheres_keep_their_digits(distance, radius):
    direction = unit([0.3, -0.5, 0.8])
    sphere = Sphere(distance * direction, radius, emission=1)
    n = 20_000
    record = sphere.sample(point((0, 0, 0), n), support.uniform(n))
    s2 = (radius / distance) ** 2
    solid_angle = 2 * math.pi * s2 / (1 + math.sqrt(1 - s2))
    assert np.array(record.pdf) == pytest.approx(1 / solid_angle, rel=1e-5)
    lost = np.mean(np.array(sphere.pdf(record.o, record.d)) == 0)
    assert lost < 4e-7 * distance / radius
    off = np.linalg.norm(numpy(record.p) - sphere.center, axis=1)
    assert off == pytest.approx(radius, rel=1e-5, abs=2e-7 * distance)
    # Uniform over the cone: the projected disk of the sphere is valid_ray evenly
    b = numpy(record.p) - sphere.center
    b -= np.outer(b @ direction, direction)
    assert np.mean(np.sum(b**2, axis=1)) / radius**2 == pytest.approx(0.5, abs=0.02)


def test_area_and_emission():
    group = SurfaceGroup([QUAD, SPHERES["moved"]])
    areas = [
        (QUAD, 2),
        (Quad((1, 2), emission=1, transform=np.diag([2.0, 3, 1, 1])), 12),
        (SPHERES["moved"], 4 * math.pi),
        (TRIANGLE, 0.5 * np.linalg.norm(np.cross(TRIANGLE.e0, TRIANGLE.e1))),
        (group, 2 + 4 * math.pi),
    ]
    for shape, area in areas:
        assert shape.area == pytest.approx(area), shape
        assert shape.is_emissive
    for dark in (Quad((1, 1)), SurfaceGroup([Quad((1, 1)), Sphere()])):
        assert not dark.is_emissive


def test_a_sheared_quad_is_a_parallelogram():
    shear = np.eye(4)
    shear[:3] = [[1.2, 0.8, 0.1, 0.4], [0.0, 0.9, 0.3, -0.2], [0.3, -0.5, 1.1, 1.6]]
    quad = Quad((1.5, 0.7), emission=1, transform=shear)
    sides = 1.5 * shear[:3, 0], 0.7 * shear[:3, 1]
    normal = np.cross(*sides)
    assert quad.area == pytest.approx(np.linalg.norm(normal))

    # The density by solid angle of the middle, from a point that is not above it
    origin = np.array([0.2, -0.3, 3.1])
    d = shear[:3, 3] - origin
    density = np.linalg.norm(d) ** 3 / abs(d @ normal)
    record = quad.sample(point(origin), mi.Point2f(0.5))
    assert float(record.pdf[0]) == pytest.approx(density, rel=1e-5)


def test_a_transformed_sphere_is_where_mitsuba_has_it():
    center = (0.4, 1.0, -0.3)
    found = Sphere(center, 0.5, transform=MOVED)
    described = {"type": "sphere", "center": list(center), "radius": 0.5, "to_world": MOVED}
    box = mi.load_dict(described).bbox()
    assert found.center == pytest.approx(np.ravel(np.array(box.center())), abs=1e-5)
    assert found.radius == pytest.approx(float(box.extents()[0]) / 2)


@pytest.mark.parametrize("mirror", [False, True])
def test_normals_are_those_of_mitsuba(mirror):
    transform = TILT @ mi.ScalarTransform4f().scale([1, -2 if mirror else 2, 1])
    theirs = mi.load_dict({"type": "rectangle", "to_world": transform})
    n = np.array(theirs.sample_position(0.0, mi.Point2f(0.3)).n).ravel()
    assert Quad((2, 2), transform=transform).normal == pytest.approx(n, abs=1e-5)


def test_monochrome():
    mi.set_variant("llvm_ad_mono")
    record = QUAD.sample(point((0, 0, 4)), mi.Point2f(0.5))
    luminance = 0.212671 * 1 + 0.715160 * 2 + 0.072169 * 3
    assert np.array(record.radiance).ravel() == pytest.approx([luminance])
    weight = SurfaceGroup(SHAPES).sample(point((0, 0, 4)), mi.Point2f(0.5)).weight
    assert np.isfinite(np.array(weight)).all()


def irradiance(shape, o, n, seed: int, samples: int = 4096) -> float:
    """Estimate the irradiance at `o` on a surface with the normal `n`, by sampling the shape."""
    record = shape.sample(point(o, samples), support.uniform(samples, seed))
    cosine = dr.maximum(dr.dot(record.d, mi.Vector3f(*(float(x) for x in n))), 0)
    return float(np.array(record.weight[0] * cosine, dtype=np.float64).mean())


def polygon_irradiance(patch, o, n) -> float:
    """Return the irradiance by a patch of radiance 1, completely above the horizon (Lambert)."""
    a, b, c = patch.corner, patch.corner + patch.e0, patch.corner + patch.e1
    corners = [a, b, c] if isinstance(patch, Triangle) else [a, b, b + patch.e1, c]
    v = [unit(np.subtract(each, o)) for each in corners]
    total = 0.0
    for a, b in zip(v, v[1:] + v[:1], strict=True):
        total += math.acos(np.clip(a @ b, -1, 1)) * (unit(np.cross(a, b)) @ np.asarray(n))
    return abs(total) / 2


@pytest.mark.statistical
@pytest.mark.parametrize(
    ("patch", "o"), [(Quad((1, 2), emission=1, transform=TILT), (0, 0, 4)), (TRIANGLE, (1, 1, -1))]
)
def test_irradiance_of_patches(patch, o):
    """Light is emitted only on the side of the normal, as in Mitsuba."""
    n = unit(patch.corner + 0.3 * patch.e0 + 0.3 * patch.e1 - np.array(o))
    exact = patch.emission[0] * polygon_irradiance(patch, o, n)
    away = (np.array(o) - patch.corner) @ patch.normal
    mirrored = np.array(o) - 2 * away * patch.normal
    back = n - 2 * (n @ patch.normal) * patch.normal
    sides = [(o, n), (mirrored, back)]
    for lit, (at, normal) in zip((True, False), sides if away > 0 else sides[::-1], strict=True):
        means = over_seeds(lambda seed: irradiance(patch, at, normal, seed), range(16))  # noqa: B023
        assert agree(means, np.array(exact)) if lit else not means.any()


@pytest.mark.statistical
@pytest.mark.parametrize("radius", [0.01, 0.5, 2.9])
def test_irradiance_of_a_sphere(radius):
    """The irradiance is pi Le (r / d)^2 cos(theta) while the sphere is above the horizon."""
    sphere = Sphere((0, 0, 3), radius, emission=2)
    cosine = 1.0 if radius > 1 else 0.8
    n = (math.sqrt(1 - cosine**2), 0, cosine)
    exact = math.pi * 2 * (radius / 3) ** 2 * cosine
    means = over_seeds(lambda seed: irradiance(sphere, (0, 0, 0), n, seed), range(16))
    assert agree(means, np.array(exact))
    assert not agree(means, np.array(1.05 * exact))
    distance = np.array(sphere.sample(point((0, 0, 0), 4096), support.uniform(4096)).distance)
    assert distance.min() == pytest.approx(3 - radius, rel=1e-2)
    assert distance.max() == pytest.approx(math.sqrt(9 - radius**2), rel=1e-2)


GROUP = SurfaceGroup([QUAD, TRIANGLE, SPHERES["plain"]])
NESTED = SurfaceGroup(
    [GROUP, Sphere((0, 0, 0), 9, emission=1, flip_normals=True), SPHERES["plain"]]
)


def seen_by_chance(shape, o, n, seed: int, samples: int = 1 << 16) -> float:
    """Estimate the irradiance with uniform directions, without sampling the shape."""
    v = mi.warp.square_to_uniform_sphere(support.uniform(samples, seed))
    cosine = dr.maximum(dr.dot(v, mi.Vector3f(*(float(x) for x in n))), 0)
    seen = shape.record(point(o, samples), v).radiance[0]
    return float(np.mean(np.array(seen * cosine, dtype=np.float64)) * 4 * math.pi)


@pytest.mark.statistical
@pytest.mark.parametrize("origin", ["below", "near", "behind"])
@pytest.mark.parametrize("group", [GROUP, NESTED], ids=["group", "nested"])
def test_groups_are_unbiased_where_lights_hide_each_other(group, origin):
    o, n = ORIGINS[origin], unit([0.2, 0.1, -1 if origin == "behind" else 1])
    sampled = over_seeds(lambda seed: irradiance(group, o, n, seed, 16384), range(16))
    by_chance = over_seeds(lambda seed: seen_by_chance(group, o, n, seed), range(50, 66))
    assert agree(sampled, by_chance)
    assert not agree(2 * sampled, by_chance)


@pytest.mark.statistical
@pytest.mark.parametrize(
    ("group", "o", "integral"),
    [
        (GROUP, ORIGINS["below"], 1),
        (NESTED, ORIGINS["below"], 1),
        # From the surface of a sphere, its share of half is lost
        (SurfaceGroup([QUAD, SPHERES["plain"]]), (0, 0, 2), 1 - 0.5 / 2),
    ],
    ids=["group", "nested", "surface"],
)
def test_directions_of_groups_follow_the_density(group, o, integral):
    result = verdict(group, o, "sphere")
    assert result.passed, result
    assert result.pdf_integral == pytest.approx(integral, abs=5e-3)
    first = lambda o, v, pdf: group.shapes[0].pdf(o, v)  # noqa: E731
    assert not verdict(with_pdf(group, first), o, "sphere").passed


def test_a_near_light_hides_a_far_one():
    """Two spheres of the same solid angle: only radiance of the near sphere arrives."""
    near, far = Sphere((0, 0, 2), 0.5, emission=1), Sphere((0, 0, 8), 2, emission=7)
    o, u = point((0, 0, 0), 4000), support.uniform(4000)
    for shapes in ([near, far], [far, near]):
        group = SurfaceGroup(shapes)
        record = group.sample(o, u)
        on_near = np.array(record.distance) < 3
        assert on_near.mean() > 0.998  # But for the rounding of their common edge
        assert np.array(record.radiance)[0] == pytest.approx(np.where(on_near, 1, 7))
        assert np.array(visible(group, record)).all()
    record = far.sample(o, u)
    assert np.array(visible(group, record)).mean() < 0.002
    assert np.array(visible(far, record)).all()
    assert np.array(visible(near, near.sample(o, u))).all()


def test_the_dark_side_of_a_light_hides_others():
    """Light from behind a quad does not pass through the quad."""
    screen = Quad((9, 9), emission=5, transform=translate(0, 0, 1))
    group = SurfaceGroup([screen, Sphere((0, 0, 3), 0.5, emission=7)])
    record = group.sample(point((0, 0, 0), 1000), support.uniform(1000))
    assert not np.any(np.array(record.radiance))
    assert np.array(record.valid).all()


def test_visibility_in_a_scene():
    area = {"type": "area"}
    parts = {
        "floor": {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(20)},
        "wall": {"type": "rectangle", "to_world": translate(-3, 0, 2)},
        "near": {"type": "sphere", "center": [2, 0, 2], "radius": 0.4, "emitter": area},
        "far": {"type": "sphere", "center": [4, 0, 4], "radius": 0.8, "emitter": area},
        "lamp": {"type": "rectangle", "to_world": translate(0, 3, 2), "emitter": area},
    }
    scene = support.load({"type": "scene", **parts})
    near, far = Sphere((2, 0, 2), 0.4), Sphere((4, 0, 4), 0.8)
    hidden, lamp = Sphere((-4.5, 0, 3), 0.3), Quad((2, 2), transform=translate(0, 3, 2))
    o, u = point((0, 0, 0), 2000), support.uniform(2000)
    for floor in (mi.Vector3f(0, 0, 1), None):
        for light, share in ((near, 1), (far, 0), (hidden, 0), (lamp, 1)):
            seen = np.array(visible(scene, light.sample(o, u), floor)).mean()
            assert seen == pytest.approx(share, abs=2e-3)
    record = emitters_of(scene).sample(o, u)
    assert np.array(visible(scene, record, mi.Vector3f(0, 0, 1))).all()


@pytest.mark.parametrize("flip", [False, True])
def test_emitters_of_a_scene(flip):
    """Each ray finds the same light in the group as in the scene."""
    area = lambda *rgb: {"type": "area", "radiance": {"type": "rgb", "value": list(rgb)}}  # noqa: E731
    turn = rotate((0, 0.6, 0.8), 70)
    box = translate(-4, 0, 0) @ turn @ mi.ScalarTransform4f().scale([1, -1, 1])
    ball = {"center": [1, 2, 3], "radius": 0.5, "to_world": mi.ScalarTransform4f().scale(2)}
    parts = {
        "a": {"type": "rectangle", "to_world": TILT, "emitter": area(1, 2, 3)},
        "b": {"type": "sphere", **ball, "emitter": area(3, 1, 2)},
        "c": {"type": "cube", "to_world": box, "emitter": area(3, 1, 0.5)},
        "dark": {"type": "sphere", "center": [9, 9, 9]},
    }
    parts = {name: part | {"flip_normals": flip} for name, part in parts.items()}
    scene = support.load({"type": "scene", **parts})
    group = emitters_of(scene)
    assert len(group.shapes) == 14
    rng = np.random.default_rng(0)
    o, d = rng.uniform(-4, 4, (3, 20_000)), rng.normal(size=(3, 20_000))
    d /= np.linalg.norm(d, axis=0)
    o, d = mi.Point3f(*map(mi.Float, o)), mi.Vector3f(*map(mi.Float, d))
    si = scene.ray_intersect(mi.Ray3f(o, d))
    radiance = np.array(dr.select(si.is_valid(), si.emitter(scene).eval(si), 0))
    wrong = np.abs(radiance - np.array(group.record(o, d).radiance)).max(axis=0) > 1e-4
    assert (radiance.max(axis=0) > 0).mean() > 0.01
    assert wrong.mean() < 2e-4


def with_pdf(shape, change):
    """Return the same sampling with another density, change(o, v, pdf)."""

    class Wrong(type(shape)):
        def sample(self, o, sample):
            record = shape.sample(o, sample)
            record.pdf = change(o, record.d, record.pdf)
            return record

        def pdf(self, o, v):
            return change(o, v, shape.pdf(o, v))

    wrong = Wrong.__new__(Wrong)
    wrong.__dict__.update(shape.__dict__)
    return wrong


def cosine(shape, v):
    return dr.abs(dr.dot(v, mi.Vector3f(shape.normal)))


WRONG_PATCHES = {
    "no geometry factor": lambda s, o, v, pdf: dr.select(pdf > 0, 1 / s.area, 0),
    "cosine twice": lambda s, o, v, pdf: pdf / dr.maximum(cosine(s, v), 1e-6),
    "no cosine": lambda s, o, v, pdf: pdf * cosine(s, v),
    "no distance": lambda s, o, v, pdf: dr.select(pdf > 0, pdf / s.intersect(o, v)[0] ** 2, 0),
    "half the area": lambda s, o, v, pdf: 2 * pdf,
    "one side": lambda s, o, v, pdf: dr.select(dr.dot(v, mi.Vector3f(s.normal)) < 0, pdf, 0),
}


def tangent_for_sine(s, o, v, pdf):
    squared = dr.squared_norm(mi.Point3f(s.center) - o)
    wrong = 1 / (2 * math.pi * (1 - 1 / dr.sqrt(1 + s.radius**2 / squared)))
    return dr.select(pdf > 0, wrong, 0)


WRONG_SPHERES = {
    "tangent for sine": tangent_for_sine,
    "radius before the transform": lambda s, o, v, pdf: 4 * pdf,
    "not 0 beside it": lambda s, o, v, pdf: dr.maximum(pdf, 0.01),
}


@pytest.mark.statistical
@pytest.mark.parametrize(
    ("shape", "bug"),
    [
        *itertools.product([QUAD, TRIANGLE], WRONG_PATCHES),
        *((SPHERES["plain"], bug) for bug in WRONG_SPHERES),
    ],
)
def test_wrong_densities_are_found(shape, bug):
    wrong = with_pdf(shape, partial((WRONG_PATCHES | WRONG_SPHERES)[bug], shape))
    domain = "sphere" if bug == "not 0 beside it" else None
    places = ("below",) if isinstance(shape, Sphere) else ("below", "behind", "side")
    assert not all(verdict(wrong, ORIGINS[place], domain).passed for place in places)


def without_occlusion(group):
    """Return a group that wrongly assumes that the selected light is visible."""

    class Wrong(SurfaceGroup):
        def sample(self, o, sample):
            record = super().sample(o, sample)
            n = len(self.shapes)
            k = dr.minimum(mi.UInt32(sample.x * n), n - 1)
            for i, shape in enumerate(self.shapes):
                radiance = shape.record(o, record.d).radiance
                record.radiance = dr.select(k == i, radiance, record.radiance)
            record.weight = record.radiance / record.pdf
            return record

    return Wrong(group.shapes)


@pytest.mark.statistical
def test_wrong_groups_are_found():
    """Seen from "below", the triangle occludes part of the sphere, and the quad part of both."""
    o, n, wrong = ORIGINS["below"], unit([0.2, 0.1, 1]), without_occlusion(GROUP)
    sampled = over_seeds(lambda seed: irradiance(wrong, o, n, seed, 16384), range(16))
    by_chance = over_seeds(lambda seed: seen_by_chance(GROUP, o, n, seed), range(50, 66))
    assert not agree(sampled, by_chance)


LINE = ([0, 0, 0], [1, 1, 1], [2, 2, 2])
BAD = {
    "triangle in a line": (lambda: sample_triangle(*LINE, mi.Point2f(0.5)), r"^v0 = .*span an are"),
    "triangle density": (lambda: sample_triangle_pdf(mi.Point3f(0), *LINE), r"^v0 = .*span an"),
    "triangle light": (lambda: Triangle(*LINE), r"^v0 = .* v2 = \[2.0, 2.0, 2.0\]: must span"),
    "triangle of NaN": (lambda: Triangle([0, 0, math.nan], *LINE[:2]), r"^v0 = .*finite"),
    "ellipsoid": (
        lambda: Sphere(transform=mi.ScalarTransform4f().scale([1, 1, 2])),
        r"^transform: scales by 2, 1, 1; must scale all directions alike$",
    ),
    "squashed sphere": (lambda: Sphere(transform=np.zeros((4, 4))), r"^transform = .*last row"),
    "point sphere": (lambda: Sphere(transform=np.diag([0.0, 0, 0, 1])), r"^transform: scales by 0"),
    "flat transform": (lambda: Quad(transform=np.diag([1.0, 0, 1, 1])), r"^transform = .*an area"),
    "projection": (lambda: Quad(transform=np.ones((4, 4))), r"^transform = .*last row 0, 0, 0, 1$"),
    "edges": (lambda: Quad.from_edges([0, 0, 0], [1, 0, 0], [3, 0, 0]), r"^e0 = .*span an area"),
    "empty group": (lambda: SurfaceGroup([]), r"^shapes = \[\]: must be a list of at least one"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input(name):
    call, message = BAD[name]
    refused(message, call)


DISK = {"type": "disk", "emitter": {"type": "area"}}
DISK_REFUSED = "emitter on the shape 'a': must be a rectangle, a sphere, or a mesh of at most 64"


@pytest.mark.parametrize(
    ("part", "said"),
    [
        ({"type": "sphere"}, "emitters are missing. Add an area light$"),
        ({"type": "point"}, "emitter 'a' has no surface; must be an area"),
        (DISK, DISK_REFUSED),
    ],
)
def test_bad_scenes(part, said):
    refused(f"^scene: {said}", emitters_of, support.load({"type": "scene", "a": part}))


def test_debug_mode_looks_at_samples_and_arrays():
    outside = mi.Point2f(0.5, -0.1)
    with dr.scoped_set_flag(dr.JitFlag.Debug, True):
        for shape in (QUAD, TRIANGLE, SPHERES["plain"], GROUP):
            with pytest.raises(AssertionError, match="must lie in"):
                shape.sample(point((0, 0, 0)), outside)
        with pytest.raises(AssertionError, match="cos_theta_max: must be a number from -1 to 1"):
            sample_sphere_cap(mi.Point2f(0.5), mi.Float([0.5, 1.5]))
        with pytest.raises(AssertionError, match="v0, v1, v2: must span an area"):
            sample_triangle(
                mi.Point3f(0), mi.Point3f([1, 0], 0, 0), mi.Point3f(0, 1, 0), support.uniform(2)
            )


def test_spectral_variants_are_refused():
    mi.set_variant("llvm_ad_spectral")
    said = "^variant = 'llvm_ad_spectral': must be an rgb or mono"
    refused(said, QUAD.sample, point((0, 0, 0)), mi.Point2f(0.5))


def test_records_are_carried_through_loops():
    """A record is a tree of arrays. It can be selected, and be the state of a symbolic loop."""
    o = point((0, 0, 0), 4)
    record = GROUP.sample(o, support.uniform(4))

    def body(i, record):
        return i + 1, GROUP.record(record.o, record.d)

    _, after = dr.while_loop((mi.UInt32(0), record), lambda i, record: i < 3, body)
    assert np.array(after.distance) == pytest.approx(np.array(record.distance), rel=1e-5)
