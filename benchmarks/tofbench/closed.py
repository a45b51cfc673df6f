"""Cases with closed forms."""

from __future__ import annotations

import numpy as np

from . import forms, scenes as s
from .cases import Case

CASES: list[Case] = []


def case(name: str, title: str, form: str, scene: dict, bins: dict, exact, *needs, **more):
    CASES.append(Case(name, title, form, scene, bins, exact, needs, **more))


# A lamp over a floor

LAMP, EYE, SPOT = (1.0, 0.3, 2.0), (0.4, 0.0, 1.5), (0.4, 0.0, 0.0)
PLANE = s.scene(
    s.camera(EYE, SPOT),
    2,
    shapes={"floor": s.floor(s.diffuse(0.5))},
    lights={"lamp": s.point(LAMP, 3.0)},
)
PLANE_BINS = s.bins(64, 0.03, 0.1)
PATH = forms.point_on_floor(EYE, SPOT, LAMP, 3.0, 0.5)
case(
    "plane",
    "One path: a lamp, a floor, a narrow camera",
    "rho/pi I cos/d² at |c-x| + |x-l|",
    PLANE,
    PLANE_BINS,
    lambda: forms.histogram(PLANE_BINS, *PATH),
)
WIDE = s.scene(
    s.camera((0, 0, 2), (0, 0, 0), 40.0),
    2,
    shapes={"floor": s.floor(s.diffuse(0.5))},
    lights={"lamp": s.point((0.5, 0.3, 3.0), 1.0)},
)


def wide(bins: dict, size: tuple[int, int] = (1, 1)) -> np.ndarray:
    """Bins of the floor in each pixel: (height, width, bins)."""
    opl, radiance, pixel = forms.floor_in_view(2.0, 40.0, size, (0.5, 0.3, 3.0), 1.0, 0.5)
    parts = [forms.histogram(bins, opl[pixel == k], radiance[pixel == k]) for k in range(np.prod(size))]
    return np.reshape(parts, (size[1], size[0], -1))


def with_camera(scene: dict, **changes) -> dict:
    return scene | {"camera": scene["camera"] | changes}


WIDE_BINS = s.bins(24, 4.925, 0.05)
case(
    "floor",
    "The same floor in a wide view",
    "mean over the film of rho/pi I h/d³ (lattice of 2^20 points)",
    WIDE,
    WIDE_BINS,
    lambda: wide(WIDE_BINS)[0, 0],
)
PIXELS_BINS = s.bins(12, 4.925, 0.1)
case(
    "pixels",
    "Its pixels: right side right, top side up",
    "as 'floor', for each of 4 x 3 pixels",
    with_camera(WIDE, width=4, height=3),
    PIXELS_BINS,
    lambda: wide(PIXELS_BINS, (4, 3)),
    samples=2048,
)
case(
    "crop",
    "A crop of the film",
    "as 'pixels', columns 1 to 2 and rows 1 to 2",
    with_camera(WIDE, width=4, height=3, crop=(1, 1, 2, 2)),
    PIXELS_BINS,
    lambda: wide(PIXELS_BINS, (4, 3))[1:3, 1:3],
    "crop",
    samples=2048,
)
WINDOW_BINS = s.bins(6, 5.175, 0.05)
case(
    "window",
    "A window that leaves early and late light out",
    "as 'floor'; light outside the window is in no bin",
    WIDE,
    WINDOW_BINS,
    lambda: wide(WINDOW_BINS)[0, 0],
    whole=False,
)

UNDER = s.camera((0.0, 0.0, 0.5), (0.0, 0.0, 0.0))


def below(light: dict) -> dict:
    return s.scene(UNDER, 2, shapes={"floor": s.floor(s.diffuse(0.5)), "light": light})


DISK = {"kind": "disk", "center": (0, 0, 1.5), "u": (0.8, 0, 0), "v": (0, -0.8, 0)}
DISK_BINS = s.bins(12, 1.97, 0.02)
case(
    "disk-light",
    "On the axis of a disk light",
    "dE/dr = 2 pi Le h²/r³, r in [h, sqrt(h²+R²)]",
    below(DISK | {"material": s.BLACK, "radiance": 2.0}),
    DISK_BINS,
    lambda: forms.disk_light(DISK_BINS, 0.5, 1.5, 0.8, 2.0, 0.5),
)
RECTANGLE_BINS = s.bins(14, 1.97, 0.02)
case(
    "rectangle-light",
    "Beside the axis of a rectangle light",
    "dE/dr = Le h²/r³ phi(s), phi from four signed corners",
    below(s.rectangle((0.2, -0.1, 1.5), (0.5, 0, 0), (0, -0.4, 0), s.BLACK, radiance=2.0)),
    RECTANGLE_BINS,
    lambda: forms.rectangle_light(RECTANGLE_BINS, 0.5, 1.5, (-0.3, 0.7), (-0.5, 0.3), 2.0, 0.5),
)
SPHERE_BINS = s.bins(10, 1.605, 0.04)
case(
    "sphere-light",
    "Under a sphere light",
    "E = pi Le cos R²/D², equal parts for equal steps of sin²",
    below(s.sphere((0.3, 0.2, 1.5), 0.4, s.BLACK, radiance=2.0)),
    SPHERE_BINS,
    lambda: forms.sphere_light(SPHERE_BINS, 0.5, (0.3, 0.2, 1.5), 0.4, 2.0, 0.5),
)


# Inside of a diffuse sphere, light and camera at its centre

FURNACES = (("0", 0, 0.8, 40), ("1", 1, 0.8, 40), ("3", 3, 0.8, 60), ("all", 60, 0.5, 200))
for name, bounces, albedo, count in FURNACES:
    furnace_bins = s.bins(count, 1.95, 0.2)
    case(
        f"furnace-{name}",
        "Inside a diffuse sphere, "
        + ("all bounces" if name == "all" else f"up to {bounces} bounces between points of it"),
        "rho^(n+1) I/(pi R²) at 2R plus n chords, density r/(2R²)",
        s.scene(
            s.camera((0, 0, 0), (0, 0, 1), 60.0),
            -1 if name == "all" else bounces + 2,
            shapes={"wall": s.sphere((0, 0, 0), 1.0, s.diffuse(albedo), inward=True)},
            lights={"lamp": s.point((0, 0, 0), 1.0)},
        ),
        furnace_bins,
        lambda b=furnace_bins, n=bounces, a=albedo: forms.furnace(b, n, 1.0, a, 1.0),
        rounding=1e-3,  # Exact values of small spheres are right to some 1e-4 in single precision
    )
EAR, EAR_BINS = 0.3, s.bins(48, 0.0, 0.2)
case(
    "furnace-ear",
    "Inside a diffuse sphere, heard from all sides beside a lamp at its centre",
    "as 'furnace-3', the last leg sqrt(R²-o²(1-mu²)) - o mu for mu even in [-1, 1]",
    s.scene(
        {"kind": "ear", "origin": (EAR, 0, 0), "width": 1, "height": 1},
        4,
        shapes={
            "wall": s.sphere((0, 0, 0), 1.0, s.diffuse(0.8), inward=True),
            "lamp": s.sphere((0, 0, 0), 0.01, s.BLACK, radiance=1.0 / (np.pi * 0.01**2)),
        },
    ),
    EAR_BINS,
    lambda: forms.furnace(EAR_BINS | {"start": 0.01}, 2, 1.0, 0.8, 1.0, EAR),
    "ear",
    rounding=3e-3,  # Light starts at the lamp's surface; the lamp hides a part of the wall
)


# Mirrors, glass, a lens

EMITTER = s.floor(s.BLACK, height=-1.0, radiance=1.0)


def slab_scene(n: float, angle: float, thickness: float, **view) -> tuple[dict, float]:
    """A slab above a plane emitter, seen under an angle, and the depth of air on the way."""
    a = np.radians(angle)
    eye = (float(np.sin(a)), 0.1, thickness + float(np.cos(a)))
    camera = s.camera(eye, (0.0, 0.1, thickness), **view)
    slab = s.box((0, 0, thickness / 2), (8, 8, thickness / 2), s.glass(n))
    shapes = {"slab": slab, "light": EMITTER}
    return s.scene(camera, 24, shapes=shapes), float(np.cos(a)) + 1.0


SLAB, SLAB_AIR = slab_scene(3.0, 0.0, 0.25)
SLAB_BINS = s.bins(40, 2.0, 0.5)


def slab_orders() -> tuple[np.ndarray, np.ndarray]:
    opl, light, _ = forms.slab(3.0, SLAB_AIR, 0.25)
    return opl, light


case(
    "slab",
    "Orders of reflection in a glass slab of index 3",
    "(1-F)² F^2m at air + (2m+1) n d",
    SLAB,
    SLAB_BINS,
    lambda: forms.histogram(SLAB_BINS, *slab_orders()),
    "glass",
    readings=[[1] * 40, *np.eye(40)[[1, 4, 7]], [1] + [0] * 39],
)
TILTED, TILTED_AIR = slab_scene(1.5, 40.0, 0.3)
TILTED_BINS = s.bins(16, 2.0, 0.25)


def tilted() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    opl, light, difference = forms.slab(1.5, TILTED_AIR, 0.3, 40.0)
    return opl, light, difference


TILTED_OPL = tilted()[0]
ORDERS = [np.eye(16)[int((opl - 2.0) / 0.25)] for opl in TILTED_OPL[:2]]
case(
    "slab-tilted",
    "Lengths through a slab of index 1.5 at 40°",
    "(1-F)² F^2m, F the mean of r_s and r_p; n d/cos of the refracted angle",
    TILTED,
    TILTED_BINS,
    lambda: forms.histogram(TILTED_BINS, TILTED_OPL, forms.slab_unpolarised(1.5, 40.0)),
    "glass",
    readings=[[1] * 16, *ORDERS],
    samples=1 << 15,
)
BALL_BINS = s.bins(12, 4.5, 1.0)
case(
    "glass-ball",
    "Through the centre of a glass ball of index 2",
    "(1-F)² F^2m at air + (2m+1) n 2R",
    s.scene(
        s.camera((0, 0, 3), (0, 0, 0), 0.001),
        24,
        shapes={
            "ball": s.sphere((0, 0, 0), 0.5, s.glass(2.0)),
            "light": s.floor(s.BLACK, height=-3.0, radiance=1.0),
        },
    ),
    BALL_BINS,
    lambda: forms.histogram(BALL_BINS, *forms.slab(2.0, 5.0, 1.0)[:2]),
    "glass",
    readings=[[1] * 12, np.eye(12)[2], np.eye(12)[6]],
    samples=1 << 15,
)
ON_FLOOR, BY_MIRROR = (0.8, -0.3, 0.0), (1.0, 0.6, 1.6)
IMAGE = (-1.0, 0.2, 3.3)  # Of the camera (-1, .2, .7) in the mirror z = 2
MIRROR_BINS = s.bins(64, 0.03, 0.1)
SEEN = tuple(
    float(e + (o - e) * (2 - 3.3) / (0 - 3.3)) for e, o in zip(IMAGE, ON_FLOOR, strict=True)
)
PATH_BY_MIRROR = forms.point_on_floor(IMAGE, ON_FLOOR, BY_MIRROR, 3.0, 0.5)
MIRROR = s.scene(
    s.camera((-1.0, 0.2, 0.7), SEEN),
    3,
    shapes={
        "mirror": s.ceiling(s.MIRROR, height=2.0),
        "floor": s.floor(s.diffuse(0.5)),
    },
    lights={"lamp": s.point(BY_MIRROR, 3.0)},
)
case(
    "mirror",
    "A lamp's spot on a floor, seen in a mirror",
    "as 'plane', from the camera's mirror image",
    MIRROR,
    MIRROR_BINS,
    lambda: forms.histogram(MIRROR_BINS, *PATH_BY_MIRROR),
    "mirror",
)
SIZE, SOURCE, RECEIVER = (4.0, 3.0, 2.5), (3.2, 2.5, 1.8), (1.5, 1.2, 0.0)
ROOM_BINS = s.bins(48, 0.04, 0.15)


def room() -> np.ndarray:
    """Direct light and its images in five walls, of a sphere of radius .05 that radiates 400."""
    images = [SOURCE]
    for axis in range(3):
        for wall in (0.0, SIZE[axis])[axis == 2 :]:
            image = list(SOURCE)
            image[axis] = 2 * wall - image[axis]
            images.append(tuple(image))
    return sum(
        forms.sphere_light(ROOM_BINS, 0.5, np.subtract(image, RECEIVER), 0.05, 400.0, 0.5)
        for image in images
    )


def wall_of_room(center, u, v) -> dict:
    return s.rectangle(center, u, v, s.MIRROR)


case(
    "mirror-room",
    "First images of a source in a room of mirrors",
    "as 'sphere-light', for the source and its images in four walls and the ceiling",
    s.scene(
        s.camera((1.5, 1.2, 0.5), RECEIVER),
        3,
        shapes={
            "floor": s.rectangle((2, 1.5, 0), (2, 0, 0), (0, 1.5, 0), s.diffuse(0.5)),
            "ceiling": wall_of_room((2, 1.5, 2.5), (2, 0, 0), (0, -1.5, 0)),
            "west": wall_of_room((0, 1.5, 1.25), (0, 1.5, 0), (0, 0, 1.25)),
            "east": wall_of_room((4, 1.5, 1.25), (0, 1.5, 0), (0, 0, -1.25)),
            "south": wall_of_room((2, 0, 1.25), (2, 0, 0), (0, 0, -1.25)),
            "north": wall_of_room((2, 3, 1.25), (2, 0, 0), (0, 0, 1.25)),
            "source": s.sphere(SOURCE, 0.05, s.BLACK, radiance=400.0),
        },
        room={"size": SIZE, "source": SOURCE, "receiver": RECEIVER, "extra_opl": 0.5},
    ),
    ROOM_BINS,
    room,
    "mirror",
    samples=1 << 17,
)
LENS_BINS = s.bins(10, 1.985, 0.01)
case(
    "thin-lens",
    "A square emitter out of focus",
    "L a/(A z²); lengths between points of patch and lens (lattice)",
    s.scene(
        s.camera((0, 0, 0), (0, 0, 1), 40.0, aperture_radius=0.2, focus_distance=3.0),
        1,
        shapes={
            "light": s.rectangle(
                (0.1, 0.05, 2.0), (0.15, 0, 0), (0, -0.15, 0), s.BLACK, radiance=5.0
            )
        },
    ),
    LENS_BINS,
    lambda: forms.lens_patch(LENS_BINS, 0.15, (0.1, 0.05, 2.0), 0.2, 40.0, 5.0),
    "lens",
    samples=1 << 15,
)
CHORD_BINS = s.bins(22, -0.05, 0.1)
SHELL = s.sphere((0, 0, 0), 1.0, s.BLACK, inward=True, radiance=1.0)
METER = {"kind": "meter", "on": "shell", "width": 1, "height": 1}
case(
    "chords",
    "Mean chord of a sphere that glows inside",
    "irradiance pi Le; density of chords r/(2R²)",
    s.scene(METER, 1, shapes={"shell": SHELL}),
    CHORD_BINS,
    lambda: np.pi * np.diff(np.clip(forms.edges(CHORD_BINS), 0, 2) ** 2 / 4),
    "meter",
)
case(
    "sky",
    "A diffuse ball under an even sky",
    "rho Le; a sky has no distance, so only the sum is compared",
    s.scene(
        s.camera((0, 0, 3), (0, 0, 0), 10.0),
        2,
        shapes={"ball": s.sphere((0, 0, 0), 1.0, s.diffuse(0.8))},
        lights={"sky": {"kind": "sky", "radiance": 1.0}},
    ),
    s.bins(100, 0.0, 10.0),
    lambda: np.array([0.8] + [0.0] * 99),
    "sky",
    readings=[[1] * 100],
)


# Media


def by_readings(weights, values) -> np.ndarray:
    """Numbers that have these readings; only their readings are compared."""
    return np.linalg.lstsq(np.asarray(weights, float), np.asarray(values, float))[0]


LEG = 1.0 + forms.distance(SPOT, LAMP) / LAMP[2]  # Through a metre of height, both ways
case(
    "absorption",
    "'plane' through a metre of an absorbing medium",
    "e^(-mu_a s)",
    PLANE
    | {
        "shapes": PLANE["shapes"] | {"fog": s.box((0, 0, 0.7), (9, 9, 0.5), s.BOUNDARY, inside="fog")},
        "media": {"fog": s.medium(0.3, 0.0)},
    },
    PLANE_BINS,
    lambda: forms.histogram(PLANE_BINS, PATH[0], PATH[1] * np.exp(-0.3 * LEG)),
    "medium",
)
FOG_BINS = s.bins(24, 2.6, 0.15)


def fog(phase: str, **more) -> dict:
    return s.scene(
        s.camera((0, 0, 0), (1, 0, 0)),
        2,
        shapes={"fog": s.box((2.5, 0, 0), (1.5, 20, 20), s.BOUNDARY, inside="fog")},
        lights={"lamp": s.point((2.5, 0.8, 0), 2.0)},
        media={"fog": s.medium(0.2, 0.3, phase, **more)},
    )


DENSE = {"low": (-40, -40, -40), "size": 80, "corner": 2.5}
PHASES = (
    ("isotropic", fog("isotropic"), forms.hg(0.0)),
    ("forward", fog("hg", g=0.6), forms.hg(0.6)),
    ("rayleigh", fog("rayleigh"), forms.rayleigh),
    ("null", fog("isotropic", grid=DENSE), forms.hg(0.0)),
)
for name, scene_, phase in PHASES:
    case(
        f"fog-{name}",
        "Single scattering in a slab of fog, "
        + ("with null collisions" if name == "null" else f"phase function {name}"),
        "mu_s I p(cos) e^(-mu_t (l-x0))/d² dt, l = t + d",
        scene_,
        FOG_BINS,
        lambda p=phase: forms.single_scattering(FOG_BINS, (2.5, 0.8), 2.0, 0.3, 0.5, (1, 4), p),
        "medium",
        *(["grid"] if name == "null" else []),
    )
MEAN_BINS = s.bins(240, 0.0, 0.1)
MOMENTS = [[1] * 240, forms.centres(MEAN_BINS)]
BODIES = (
    ("mean-path", "of transport mean free path 5/3", s.medium(0.0, 3.0, "hg", g=0.8)),
    ("mean-path-null", "with null collisions", s.medium(0.0, 3.0, grid=DENSE)),
)
for name, title, body in BODIES:
    case(
        name,
        f"Mean path in a sphere of fog, {title}",
        "irradiance pi Le, mean length 4V/S = 4/3 R for any fog that does not absorb",
        s.scene(
            METER | {"medium": "fog"},
            -1,
            shapes={"shell": SHELL | {"outside": "fog"}},
            media={"fog": body},
        ),
        MEAN_BINS,
        lambda: by_readings(MOMENTS, [np.pi, 4 / 3 * np.pi]),
        "meter",
        "medium",
        "inside",
        *(["grid"] if "grid" in body else []),
        readings=MOMENTS,
    )
case(
    "fog-room",
    "Fog that does not absorb, in a shell that glows",
    "every pixel sees Le",
    s.scene(
        s.camera((0.2, 0.1, 0), (1, 0.3, 0.2), 60.0, medium="fog"),
        -1,
        shapes={"shell": SHELL | {"outside": "fog"}},
        media={"fog": s.medium(0.0, 1.5)},
    ),
    s.bins(40, 0.0, 2.0),
    lambda: by_readings([[1] * 40], [1.0]),
    "medium",
    "inside",
    readings=[[1] * 40],
)
HALF_BINS = s.bins(2400, 0.0, 0.025)
RATES = (0.0, 0.25, 1.0, 2.0)
DAMPED = np.exp(-np.outer(RATES, forms.centres(HALF_BINS)))
case(
    "half-space",
    "Diffuse reflection of a half-space, in time",
    "1 - sqrt(1-a) H_a(1), a = mu_s/(mu_t+x): Laplace transform at x = 0, .25, 1, 2 per metre",
    s.scene(
        s.camera((0, 0, -2e-4), (0, 0, -1), medium="fog"),
        -1,
        shapes={"light": s.ceiling(s.BLACK, size=300.0, radiance=1.0)},
        media={"fog": s.medium(0.2, 1.8)},
    ),
    HALF_BINS,
    lambda: by_readings(DAMPED, [forms.half_space(1.8 / (2.0 + x), 1.0) for x in RATES]),
    "half-space",
    readings=DAMPED,
)


# Around the corner

WALL = {"albedo": 0.8, "power": 5.0, "device": (-0.5, 0.0, 0.25), "lit": (0.3, -0.2, 0.0)}
FACING = {"center": (0.1, 0.1, 0.9), "u": (-0.3, 0, 0), "v": (0, 0.25, 0)}  # u x v: towards -z
TURNED = {"center": (-0.1, 0.2, 0.8), "u": (-0.15, 0, -0.1), "v": (0, 0.2, -0.05)}
BEHIND = {"center": (0.1, 0.1, 1.0), "u": (-0.2, 0, 0), "v": (0, 0.15, 0)}
CORNER_BINS = s.bins(40, 1.225, 0.05)


def plate(where: dict, **more) -> dict:
    return s.rectangle(**where, material=s.diffuse(0.7) | more)


def hidden(bins: dict, where: dict, lit) -> np.ndarray:
    nodes = forms.nodes(where["center"], where["u"], where["v"], 1000)
    opl, light = forms.around_corner(lit, (0, 0, 0), nodes, 0.7, 5.0 * 0.8**2 / np.pi**2)
    return forms.histogram(bins, opl, light)


AWAY = FACING | {"u": (0.3, 0, 0)}
CORNERS = (
    ("nlos-single", "a tilted plate", "single", TURNED, {"plate": plate(TURNED)}),
    ("nlos-confocal", "a plate, confocal", "confocal", FACING, {"plate": plate(FACING)}),
    (
        "nlos-occluded",
        "a plate that hides another",
        "single",
        FACING,
        {"plate": plate(FACING), "second": plate(BEHIND)},
    ),
    (
        "nlos-two-sided",
        "a two-sided plate, its front away from the wall",
        "single",
        FACING,
        {"plate": plate(AWAY, two_sided=True)},
    ),
)
for name, title, capture, where, shapes in CORNERS:
    wall = WALL | {"capture": capture}
    case(
        name,
        f"Around the corner: {title}",
        "Phi rho_w² rho_h/pi³ int cos cos cos cos/(r1² r2²) dA at r1 + r2",
        s.scene({"width": 1, "height": 1}, 4, shapes=shapes, wall=wall),
        CORNER_BINS | {"quantity": "nlos"},
        lambda at=where, lit=(0, 0, 0) if capture == "confocal" else WALL["lit"]: hidden(
            CORNER_BINS, at, lit
        ),
        samples=1 << 14,
    )
OVER, CORNER_LAMP = (-0.5, 0.0, 1.0), (0.8, 0.2, 0.6)
ABOVE = {"center": (-0.2, 0.1, 1.2), "u": (-0.25, 0, 0.1), "v": (0, 0.25, 0)}
ROUND_BINS = s.bins(30, 3.0, 0.05)


def around() -> np.ndarray:
    nodes = forms.nodes(ABOVE["center"], ABOVE["u"], ABOVE["v"], 1000)
    opl, light = forms.around_corner(
        CORNER_LAMP, (0, 0, 0), nodes, 0.7, 2.0 * 0.5 / np.pi, wall_cosine=False
    )
    return forms.histogram(ROUND_BINS, opl + forms.distance(OVER, (0, 0, 0)), light)


case(
    "occluder",
    "A lamp behind an occluder lights a floor by a plate",
    "rho_w rho_h I/pi² int cos cos cos/(r1² r2²) dA",
    s.scene(
        s.camera(OVER, (0, 0, 0)),
        3,
        shapes={
            "floor": s.floor(s.diffuse(0.5)),
            "plate": plate(ABOVE),
            "occluder": s.floor(s.BLACK, 0.1) | {"center": (0.6, 0.15, 0.45)},
        },
        lights={"lamp": s.point(CORNER_LAMP, 2.0)},
    ),
    ROUND_BINS,
    around,
    samples=1 << 15,
)


# Polarised light


def turned(v, axis, degrees: float) -> np.ndarray:
    a, axis = np.radians(degrees), np.asarray(axis)
    across, along = np.cross(axis, v), axis * (axis @ v) * (1 - np.cos(a))
    return np.asarray(v) * np.cos(a) + across * np.sin(a) + along


def facing(p, d, up, size: float, material: dict, **more) -> dict:
    """A square at p that faces d."""
    u = size * np.cross(up, d)
    v = np.cross(d, u)
    return s.rectangle(list(p), u.tolist(), v.tolist(), material, **more)


def mirrors(*turns: tuple[float, float]) -> dict:
    """Faces of glass after each other, at angles of incidence and twists, before an emitter."""
    p, d, across = np.zeros(3), np.array([0, 0, -1.0]), np.array([0, 1.0, 0])
    shapes = {"light": facing(p, d, across, 0.3, s.BLACK, radiance=1.0)}
    for k, (incidence, twist) in enumerate(turns):
        p, across = p + d, turned(across, d, twist)
        n = turned(-d, across, incidence)
        shapes[f"face{k}"] = facing(p, n, across, 0.3, s.glass(1.5))
        d = d - 2 * n * (n @ d)
    eye = p + d
    return s.scene(s.camera(eye.tolist(), p.tolist(), up=across.tolist()), 8, shapes=shapes)


def stokes(bins: dict, opl, *light) -> np.ndarray:
    """S0, S1, S2, S3 in bins; what is not given is 0."""
    parts = [forms.histogram(bins, opl, each) for each in light]
    return np.concatenate([*parts, np.zeros(bins["count"] * (4 - len(parts)))])


def components(bins: dict) -> np.ndarray:
    return np.kron(np.eye(4), np.ones(bins["count"]))


FACE_BINS = s.bins(4, 1.25, 0.5)
TWO_BINS = s.bins(4, 2.25, 0.5)
R_S, R_P = forms.fresnel(1.5, float(np.cos(np.radians(45))))
case(
    "reflection",
    "Stokes vector of a reflection by glass at 45°",
    "r_s, r_p of Fresnel; S1 < 0 along the camera's up",
    mirrors((45.0, 0.0)),
    FACE_BINS | {"quantity": "stokes"},
    lambda: stokes(FACE_BINS, 2.0, (R_S + R_P) / 2, (R_P - R_S) / 2),
    "glass",
    readings=np.vstack([components(FACE_BINS), np.eye(16)[0]]),
    samples=1 << 15,
)
BREWSTER, TWO = float(np.degrees(np.arctan(1.5))), (1.25 / 3.25) ** 4 * 0.75 / 2
case(
    "two-mirrors",
    "Two reflections at Brewster's angle, twisted by 30°",
    "R² cos²/2, R = ((n²-1)/(n²+1))², fully polarised",
    mirrors((BREWSTER, 0.0), (BREWSTER, 30.0)),
    TWO_BINS | {"quantity": "stokes"},
    lambda: stokes(TWO_BINS, 3.0, TWO, -TWO),
    "glass",
    readings=components(TWO_BINS),
    samples=1 << 17,
)
case(
    "slab-stokes",
    "Stokes vectors of a slab's orders at 40°",
    "mean and difference of (1-r)² r^2m over r_s and r_p",
    TILTED,
    TILTED_BINS | {"quantity": "stokes"},
    lambda: stokes(TILTED_BINS, TILTED_OPL, tilted()[1], -tilted()[2]),
    "glass",
    readings=[*(np.concatenate([o, np.zeros(48)]) for o in ORDERS)]
    + [np.concatenate([np.zeros(16), o, np.zeros(32)]) for o in ORDERS]
    + [*components(TILTED_BINS)[2:]],
    samples=1 << 15,
)


# Gates, pulses, phasors, motion, derivatives

FREQUENCIES = (20e6, 100e6)


def phasors() -> np.ndarray:
    opl, light = slab_orders()
    found = [(light * np.exp(2j * np.pi * f / forms.C * opl)).sum() for f in FREQUENCIES]
    return np.concatenate([np.real(found), np.imag(found)])


case(
    "phasors",
    "Phasors of 'slab' at 20 and 100 MHz",
    "sum of L exp(+i 2 pi f OPL/c): real, then imaginary parts",
    SLAB,
    {"quantity": "phasor", "frequencies_hz": FREQUENCIES},
    phasors,
    "glass",
)
GATES, GATE_WIDTH = (4.95, 5.2, 5.5), 0.1


def gates() -> np.ndarray:
    opl, light, _ = forms.floor_in_view(2.0, 40.0, (1, 1), (0.5, 0.3, 3.0), 1.0, 0.5)
    scaled = (np.array(GATES)[:, None] - opl) / GATE_WIDTH
    return np.exp(-0.5 * scaled**2) @ light / (GATE_WIDTH * np.sqrt(2 * np.pi))


case(
    "gates",
    "Gaussian gates on 'floor'",
    "sum of L times the gate's density, radiance per metre",
    WIDE,
    {"quantity": "gate", "opl": GATES, "width": GATE_WIDTH},
    gates,
)
PULSE_BINS = s.bins(16, 2.83, 0.1)
case(
    "pulse",
    "'plane' with a Gaussian pulse of 15 cm",
    "differences of the pulse's cumulative distribution",
    PLANE,
    PULSE_BINS | {"pulse": 0.15},
    lambda: PATH[1] * np.diff(forms.gaussian_cdf((forms.edges(PULSE_BINS) - PATH[0]) / 0.15)),
    "pulse",
)
MOVING = MIRROR | {
    "shapes": MIRROR["shapes"] | {"mirror": MIRROR["shapes"]["mirror"] | {"velocity": (0, 0, 0.7)}}
}
RATE_BINS = s.bins(20, -2.03, 0.2) | {"quantity": "rate"}
RATE = 2 * 0.7 * 3.3 / forms.distance(IMAGE, ON_FLOOR)
case(
    "moving-mirror",
    "Rate of change of length by a mirror that moves at 0.7 m/s",
    "2 v cos, all light in one bin of rates",
    MOVING,
    RATE_BINS,
    lambda: forms.histogram(RATE_BINS, RATE, PATH_BY_MIRROR[1]),
    "mirror",
)
GRADIENT = s.scene(
    s.camera((0, 0, 2), (0, 0, 0)),
    2,
    shapes={"floor": s.floor(s.diffuse(0.5))},
    lights={"lamp": s.point((0.5, 0, 2), 1.0)},
)
GRADIENT_BINS = s.bins(40, 3.0365528, 0.05) | {"quantity": "gradient"}
GRADIENT_FORM = (
    "L = rho H/(pi r³), opl = H + r: derivatives of the sum of light and of light times length"
)


def by_height() -> np.ndarray:
    """At z = 0 with H = 2 and r² = .25 + H²; dH/dz = -1."""
    h, r = 2.0, np.sqrt(4.25)
    light, slope = 0.5 * h / (np.pi * r**3), 0.5 / np.pi * (1 / r**3 - 3 * h * h / r**5)
    return np.array([-slope, -(slope * (h + r) + light * (1 + h / r))])


def by_albedo() -> np.ndarray:
    r = np.sqrt(4.25)
    return 2.0 / (np.pi * r**3) * np.array([1, 2 + r])


case(
    "gradient-albedo",
    "Derivative by the floor's albedo",
    GRADIENT_FORM,
    GRADIENT,
    GRADIENT_BINS | {"by": ("floor", "albedo", 0.5)},
    by_albedo,
)
case(
    "gradient-height",
    "Derivative by the floor's height, arrival times included",
    GRADIENT_FORM,
    GRADIENT,
    GRADIENT_BINS | {"by": ("floor", "height", 0.0)},
    by_height,
    "moving gradient",
)
