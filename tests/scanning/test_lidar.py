"""Energy and distance of a lidar's echoes against closed forms and rays traced in NumPy."""

import math

import mitsuba as mi
import numpy as np
import pytest
from helpers.refusals import refused

import tofrender
from tofrender.scanning import lidar, point_cloud, scan_pattern
from tofrender.sensors import Response, Spad

RHO = 0.5
PHOTONS = 5e8 * math.pi * 0.025**2 / 4  # Times the aperture's area
DIFFUSE = {
    "type": "twosided",
    "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": RHO}},
}
MIRROR = {"type": "conductor", "material": "none"}
ONE = scan_pattern(shots=(1, 1))
QUIET = {"progress": False, "max_range": 30.0}


def wall(at, axis=(0, 1, 0), angle=180.0, size=50.0, bsdf=DIFFUSE):
    pose = mi.ScalarTransform4f().translate(list(at)).rotate(list(axis), angle).scale(size)
    return {"type": "rectangle", "to_world": pose, "bsdf": bsdf}


def shoot(pattern=ONE, spp=64, /, scene=None, **options):
    """Return waveforms of a lidar at the origin that looks along z at the shapes `scene`."""
    described = {"type": "scene", "sensor": {"type": "perspective"}, **scene}
    return lidar(described, pattern, spp=spp, **QUIET | options)


def energy(shots):
    return shots["rate"].sum("bin").values / PHOTONS


def distance(shots):
    return (shots["rate"] @ shots["opl"]).values / shots["rate"].sum("bin").values / 2


@pytest.mark.parametrize("divergence", [0.0, 1e-3])
@pytest.mark.parametrize("tilt", [0.0, 50.0])
def test_a_plane(tilt, divergence):
    """N A rho cos / (pi r^2) at 2 r, for all beams that the plane fills."""
    shots = shoot(
        scan_pattern(shots=(5, 3), fov_deg=(20, 10)),
        scene={"wall": wall((0, 0, 5), angle=180 + tilt)},
        divergence_rad=divergence,
    )
    normal = np.array([math.sin(math.radians(tilt)), 0, math.cos(math.radians(tilt))])
    cos = shots["direction"].values @ normal
    r = 5 * normal[2] / cos
    assert shots["true_range"].values == pytest.approx(r, rel=1e-5)
    assert energy(shots) == pytest.approx(RHO * cos / (math.pi * r**2), rel=1e-4)
    assert distance(shots) == pytest.approx(r, rel=1e-4)
    found = point_cloud(shots)
    assert np.abs(found["range"] - found["true_range"]).max() < 0.01
    points = np.stack([found[name] for name in "xyz"], axis=1)
    assert points @ normal == pytest.approx(5 * normal[2], abs=0.02)


def test_directions():
    """Azimuth is to the left of the camera, which is x in its space; elevation is up."""
    shots = shoot(
        ONE.assign(azimuth=("shot", [0.3]), elevation=("shot", [0.2])),
        scene={"wall": wall((0, 0, 5))},
    )
    expected = [math.cos(0.2) * math.sin(0.3), math.sin(0.2), math.cos(0.2) * math.cos(0.3)]
    assert shots["direction"].values[0] == pytest.approx(expected)


@pytest.mark.parametrize("edge", [0.0, 0.5])
def test_two_echoes_at_an_edge(edge):
    """Energies depend on the fraction of the disk on each side of an edge, over r^2 of each wall.

    The half plane x > edge h covers (acos(edge) - edge sqrt(1 - edge^2)) / pi of a disk.
    """
    h, near, far = 5e-3, 4.0, 7.0
    front = wall((50 + edge * near * math.tan(h), 0, near))
    shots = shoot(ONE, 1 << 12, scene={"a": front, "b": wall((0, 0, far))}, divergence_rad=h)
    part = (math.acos(edge) - edge * math.sqrt(1 - edge**2)) / math.pi
    is_near = shots["opl"] < near + far
    found = [energy(shots.isel(bin=is_near.values == each)).item() for each in (True, False)]
    expected = [part * RHO / (math.pi * near**2), (1 - part) * RHO / (math.pi * far**2)]
    assert found == pytest.approx(expected, rel=5e-3)
    cloud = point_cloud(shots, pulses=1000)
    assert point_cloud(shots.transpose(), pulses=1000).identical(cloud)
    assert cloud["return_number"].values.tolist() == [1, 2]
    assert cloud["number_of_returns"].values.tolist() == [2, 2]
    assert cloud["range"].values == pytest.approx([near, far], abs=2e-3)
    share = cloud["intensity"].values / (1000 * PHOTONS)
    assert share == pytest.approx(expected, rel=2e-2)
    strongest = (near, far)[int(np.argmax(expected))]
    assert point_cloud(shots, max_returns=1)["range"].item() == pytest.approx(strongest, abs=0.01)


def test_a_mirror():
    """The echo has the squared reflectance, at the length of the whole way, along the axis."""
    gray = {"type": "conductor", "material": "none"}
    gray |= {"specular_reflectance": {"type": "rgb", "value": 0.8}}
    mirror = wall((0, 0, 4), angle=225.0, size=1, bsdf={"type": "twosided", "bsdf": gray})
    target = wall((-6, 0, 4), angle=90.0, size=3)
    shots = shoot(scene={"mirror": mirror, "target": target})
    assert shots["true_range"].item() == pytest.approx(4)
    assert distance(shots) == pytest.approx([10.0], rel=1e-5)
    assert energy(shots) == pytest.approx([0.8**2 * RHO / (math.pi * 10**2)], rel=1e-4)
    assert point_cloud(shots)["z"].item() == pytest.approx(10, abs=0.01)
    assert not energy(shoot(scene={"mirror": mirror, "target": target}, max_depth=2)).any()


def fresnel(degrees, index=1.5):
    """Reflectance of unpolarized light at an angle of incidence."""
    c = math.cos(math.radians(degrees))
    inside = math.sqrt(1 - (1 - c**2) / index**2)
    s = (c - index * inside) / (c + index * inside)
    p = (index * c - inside) / (index * c + inside)
    return (s**2 + p**2) / 2


GRAY = {**MIRROR, "specular_reflectance": {"type": "rgb", "value": 0.7}}
BLACK = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
PLASTIC = {"type": "plastic", "int_ior": 1.5, "ext_ior": 1.0}
GLASS = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
PANE = {"type": "thindielectric", "int_ior": 1.5, "ext_ior": 1.0}
DARK = {**MIRROR, "specular_reflectance": {"type": "rgb", "value": 0.2}}


def two_sided(*bsdfs):
    return {"type": "twosided", **dict(zip("ab", bsdfs, strict=False))}


def blend(a, b, weight=0.4):
    return {"type": "blendbsdf", "weight": weight, "a": a, "b": b}


@pytest.mark.parametrize(
    ("floor", "turned", "reflectance"),
    [
        (two_sided(PLASTIC), 0, fresnel(80)),
        (two_sided(blend(BLACK, GRAY, 0.3)), 0, 0.3 * 0.7),
        (two_sided(blend(GRAY, DIFFUSE["bsdf"], 0.6)), 0, 0.4 * 0.7),
        (two_sided(blend(GRAY, PLASTIC, 0.6)), 0, 0.4 * 0.7 + 0.6 * fresnel(80)),
        (two_sided(blend(GRAY, PLASTIC, 0.6)), 180, 0.4 * 0.7 + 0.6 * fresnel(80)),
        (two_sided(GRAY, PLASTIC), 180, fresnel(80)),
        (two_sided(blend(GRAY, DARK), DARK), 180, 0.2),
        (blend(GRAY, DARK), 0, 0.6 * 0.7 + 0.4 * 0.2),
        (blend(GRAY, GLASS), 0, 0.6 * 0.7 + 0.4 * fresnel(80)),
        (blend({"type": "null"}, GRAY), 0, 0.4 * 0.7),
        ({"type": "mask", "opacity": 0.6, "bsdf": GRAY}, 0, 0.6 * 0.7),
    ],
    ids=[
        *("plastic", "black", "diffuse", "mirror_and_plastic", "behind", "plastic_behind"),
        *("mirror_behind", "two_mirrors", "mirror_and_glass", "null_and_mirror", "mask"),
    ],
)
def test_a_mirror_with_other_lobes(floor, turned, reflectance):
    """The echo of the mirrored wall has the squared reflectance of all mirror lobes together."""
    # The floor is 1 m ahead, and faces the lidar at 80 degrees
    normal = np.array([math.sin(math.radians(80)), 0, -math.cos(math.radians(80))])
    out = np.array([0, 0, 1]) - 2 * normal[2] * normal
    target = wall(np.array([0, 0, 1]) + 3 * out, angle=math.degrees(math.atan2(-out[0], -out[2])))
    angle = math.degrees(math.atan2(normal[0], normal[2])) + turned
    tilted = wall((0, 0, 1), angle=angle, size=2, bsdf=floor)
    shots = shoot(ONE, 1 << 12, scene={"floor": tilted, "wall": target}, max_depth=3)
    late = np.abs(shots["opl"].values - 2 * 4) < 0.2
    echo = shots["rate"].values[:, late].sum() / PHOTONS
    assert echo == pytest.approx(reflectance**2 * RHO / (math.pi * 4**2), rel=0.02)


def test_under_water():
    """T^2 rho / (pi (n a + b)^2) from b below a surface at a: radiance in water is n^2 as high."""
    n, a, b = 1.33, 3.0, 2.0
    water = wall((0, 0, a), bsdf={"type": "dielectric", "int_ior": n, "ext_ior": 1.0})
    shots = shoot(ONE, 1 << 12, scene={"water": water, "floor": wall((0, 0, a + b))}, max_depth=3)
    transmitted = 1 - ((n - 1) / (n + 1)) ** 2
    expected = transmitted**2 * RHO / (math.pi * (n * a + b) ** 2)
    assert energy(shots) == pytest.approx([expected], rel=3e-3)
    assert distance(shots) == pytest.approx([a + n * b], rel=1e-4)


CENTER = np.array([0, 0, 5.0])


def reflected(d):
    """Return where a ray lands after reflection by a ball of radius 1, its direction and length."""
    b = d @ CENTER
    t = b - math.sqrt(1 - CENTER @ CENTER + b**2)
    n = t * d - CENTER
    out = d - 2 * (d @ n) * n
    s = (-3 - t * d[2]) / out[2]
    return t * d + s * out, out, t + s


def refracted(d, index=1.5):
    """Return the same as `reflected`, for a path through a glass ball."""
    b = d @ CENTER
    t = b - math.sqrt(1 - CENTER @ CENTER + b**2)
    p, η = t * d, 1 / index
    n = p - CENTER
    c = -d @ n
    inside = η * d + (η * c - math.sqrt(1 - η**2 * (1 - c**2))) * n
    chord = 2 * (inside @ -n)
    q = p + chord * inside
    m, cos = CENTER - q, -inside @ (CENTER - q)
    out = index * inside + (index * cos - math.sqrt(1 - index**2 * (1 - cos**2))) * m
    s = (8 - q[2]) / out[2]
    return q + s * out, out, t + index * chord + s


@pytest.mark.parametrize(
    ("way", "bsdf", "screen", "depth"),
    [
        (reflected, MIRROR, wall((0, 0, -3), angle=0.0), 3),
        (refracted, {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}, wall((0, 0, 8)), 4),
    ],
)
def test_a_ball_spreads_the_beam(way, bsdf, screen, depth):
    """rho cos / (pi A) T^2, with the area A per steradian by differences of traced rays."""
    angle, h = 0.1, 1e-5
    d = np.array([math.sin(angle), 0, math.cos(angle)])
    across = np.array([[math.cos(angle), 0, -math.sin(angle)], [0, 1, 0]])
    ends = [[way((d + s * h * e) / math.sqrt(1 + h * h))[0] for s in (1, -1)] for e in across]
    du, dv = ((a - b) / (2 * h) for a, b in ends)
    _, out, length = way(d)
    transmitted = 1.0
    if way is refracted:
        cos = math.sqrt(1 - (np.linalg.norm(np.cross(d, CENTER))) ** 2)
        transmitted = 1 - float(mi.fresnel(mi.Float(cos), mi.Float(1.5))[0][0])
    expected = transmitted**4 * RHO / math.pi * abs(out[2] / (np.cross(du, dv) @ out))
    ball = {"type": "sphere", "center": CENTER.tolist(), "radius": 1.0, "bsdf": bsdf}
    shots = shoot(
        ONE.assign(azimuth=("shot", [angle])),
        1 << 12,
        scene={"ball": ball, "screen": screen},
        divergence_rad=1e-4,
        max_depth=depth,
    )
    assert energy(shots) == pytest.approx([expected], rel=3e-3)
    assert distance(shots) == pytest.approx([length], rel=1e-4)


def in_cone(rng, count, h):
    s = np.sqrt(rng.random(count)) * math.sin(h / 2)
    φ, radius = 2 * np.pi * rng.random(count), 2 * s * np.sqrt(1 - s**2)
    return np.stack([radius * np.cos(φ), radius * np.sin(φ), 1 - 2 * s**2])


def test_two_scatterings():
    """From one wall of an open groove to the other and back, against samples of both points."""
    h, count, gap, size = 0.1, 400_000, 0.15, 4.0
    x = gap + size / math.sqrt(2)
    walls = {
        side: wall((sign * x, 0, 6 - x), angle=180 + sign * 45.0, size=size)
        for side, sign in (("left", 1), ("right", -1))
    }

    def land(d):  # On z = 4 + 2 - |x|
        t = 6 / (d[2] + np.abs(d[0]))
        normal = np.stack([-np.sign(d[0]), 0 * d[0], -np.ones(d.shape[1])]) / math.sqrt(2)
        return t * d, normal

    rng = np.random.default_rng(1)
    (p, n), (q, m) = land(in_cone(rng, count, h)), land(in_cone(rng, count, h))
    to = q - p
    r2 = (to**2).sum(axis=0)
    w = to / np.sqrt(r2)
    cosines = np.maximum((n * w).sum(axis=0), 0) * np.maximum(-(m * w).sum(axis=0), 0)
    solid_angle = 4 * math.pi * math.sin(h / 2) ** 2
    values = solid_angle * (RHO / math.pi) ** 2 * cosines / r2
    values *= (np.abs(p[0]) > gap) & (np.abs(q[0]) > gap)
    options = {"scene": walls, "divergence_rad": h}
    once, twice = (energy(shoot(ONE, 1 << 16, **options, max_depth=k)).item() for k in (2, 3))
    error = values.std() * math.sqrt(1 / count + 1 / (1 << 16))
    assert abs(twice - once - values.mean()) < 4 * error
    assert error < 0.05 * values.mean()
    assert abs(twice - once - 2 * values.mean()) > 4 * error  # Power: twice the light is found out


def test_fog():
    """Backscatter sigma_s exp(-2 sigma_t s) / (4 pi r^2) per meter, and a dimmed wall."""
    medium = {"type": "homogeneous", "albedo": 0.5, "sigma_t": 0.1}
    pose = mi.ScalarTransform4f().translate([0, 0, 4]).scale([5, 5, 2])
    fog = {"type": "cube", "to_world": pose, "bsdf": {"type": "null"}, "interior": medium}
    shots = shoot(ONE, 1 << 14, scene={"fog": fog, "wall": wall((0, 0, 8))}, max_depth=2)
    assert shots["true_range"].item() == pytest.approx(8)
    r = shots["opl"].values / 2
    behind = energy(shots.isel(bin=r > 7)).item()
    assert behind == pytest.approx(math.exp(-2 * 0.1 * 4) * RHO / (math.pi * 64), rel=2e-2)
    inside = (r > 2.5) & (r < 5.5)
    expected = 0.05 * np.exp(-0.2 * (r - 2)) / (4 * math.pi * r**2) * (r[1] - r[0])
    found = energy(shots.isel(bin=inside)).item()
    assert found == pytest.approx(expected[inside].sum(), rel=2e-2)


def test_background_and_detectors():
    """Shots into the sky count only background. A SPAD detects the first photons."""
    sky = ONE.assign(azimuth=("shot", [math.pi]))
    shots = shoot(sky, scene={"wall": wall((0, 0, 5))}, background_hz=1e6)
    assert shots["rate"].values == pytest.approx(1e6 * 0.03 / 299792458)
    assert np.isnan(shots["true_range"].item())
    assert point_cloud(shots, pulses=100).sizes["point"] == 0
    assert tofrender.true_points(shots).sizes["point"] == 0
    dim = shoot(scene={"wall": wall((0, 0, 5))}, photons=1e5, background_hz=1e6)
    spad, jitter = Spad(jitter=Response(100e-12)), Response(math.hypot(100e-12, 0.06 / 299792458))
    found = point_cloud(dim, pulses=1000, detector=spad, response=jitter)
    with refused("detector: crosstalk_probability = 0.5: must be 0.0, of single shots"):
        point_cloud(dim, detector=Spad(mode="multi_hit", crosstalk_probability=0.5))
    assert found["range"].values == pytest.approx([5], abs=0.01)


@pytest.mark.parametrize(
    ("bsdf", "said"),
    [
        ({"type": "roughdielectric"}, r"\(bsdf .*\) is rough glass, .*; use dielectric"),
        (
            {"type": "mask", "opacity": 0.5, "bsdf": DIFFUSE, "id": "net"},
            r"\(bsdf 'net'\) transmits straight and has a smooth lobe, .*; use the material",
        ),
        (blend({"type": "null"}, BLACK), "transmits straight and has a smooth lobe"),
        (blend(PANE, BLACK), "transmits straight and has a smooth lobe"),
        ({"type": "mask", "opacity": 0.5, "bsdf": PLASTIC}, "transmits straight and has a smooth"),
        ({"type": "mask", "opacity": 0.5, "bsdf": PANE}, "is a mask over a pane"),
        ({"type": "mask", "opacity": 0.5, "bsdf": blend(GRAY, DARK)}, "or over a blend of mirrors"),
    ],
    ids=["rough_glass", "net", "null", "pane", "plastic", "masked_pane", "masked_blend"],
)
def test_what_is_refused(bsdf, said):
    with refused(f"shape 'wall' .*{said}"):
        shoot(scene={"wall": wall((0, 0, 5), bsdf=bsdf)})


def test_refused_places_and_media():
    glass = {"type": "sphere", "radius": 1.0, "bsdf": {"type": "dielectric"}}
    with refused("index around the sensor = 1.5.*:"):
        shoot(scene={"ball": glass, "wall": wall((0, 0, 5))})
    medium = {"type": "homogeneous", "albedo": 0.5, "sigma_t": 0.1}
    fog = {"type": "cube", "bsdf": {"type": "null"}, "interior": medium}
    fog["to_world"] = mi.ScalarTransform4f().translate([0, 0, 4])
    with refused("scene: media are not supported together with mirrors"):
        shoot(scene={"fog": fog, "mirror": wall((0, 0, 7), bsdf=MIRROR)})
