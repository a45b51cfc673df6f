"""The table of gradients: ten parameters, two scenes of each, and what closed forms say of them."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import mitsuba as mi
import numpy as np
from oracles import gradients as forms
from oracles.nlos import Rectangle, Setup, confocal, picture_film, single

from helpers.gradient_of import PULSE_KEY, Case
from helpers.parts import area_light, diffuse, plane, point_light, rotate, translate
from helpers.support import camera, film, scene

Z = np.array([0.0, 0.0, 1.0])
SINGLE_PATH = {"light_samples": 1}


def moved(v, base: Callable[[], Any] | None = None) -> Callable[[Any], Any]:
    """θ -> a transform: `base`, then moved by θ v."""

    def value(theta):
        x, y, z = (theta * float(a) for a in v)
        return mi.Transform4f().translate(mi.Vector3f(x, y, z)) @ mi.Transform4f(
            np.eye(4) if base is None else base()
        )

    return value


def scaled(v=(0, 0, 0)) -> Callable[[Any], Any]:
    """θ -> a transform: larger by θ, then moved by v."""
    return lambda theta: (
        mi.Transform4f().translate(mi.Vector3f(*map(float, v))).scale(mi.Vector3f(mi.Float(theta)))
    )


def matrix(to_world) -> np.ndarray:
    return np.array(to_world.matrix, dtype=np.float64)


def flat_film(seen: forms.Bins, size: int = 1, **more) -> dict:
    return film(size, size, bins=seen.count, start=seen.start, bin_width=seen.width, **more)


def eye(view: forms.View, the_film: dict) -> dict:
    sampled = {"sampler": "padded_sobol", "fov": view.fov}
    return camera(view.origin, view.target, the_film, up=view.up, **sampled)


def facing(p, d, size: float = 1.0) -> Any:
    """Transform of a square at p that looks along d."""
    up = [0, 1, 0] if abs(d[1]) < 0.9 * np.linalg.norm(d) else [1, 0, 0]
    look = mi.ScalarTransform4f().look_at(list(p), list(np.add(p, d)), up)
    return look @ mi.ScalarTransform4f().scale(size)


def direct(seen: forms.Bins) -> dict:
    """An integrator for light of a single bounce."""
    return {"max_depth": 2, "pulse_width_opl": seen.sigma} | SINGLE_PATH


BINS = forms.Bins(3.4, 0.05, 32, 0.05)
ABOVE = forms.View((0, 0, 2), (0, 0, 0))
LAMP = (0.5, 0.0, 2.0)


def floor_scene(view: forms.View = ABOVE, lamp: Any = LAMP, seen: forms.Bins = BINS) -> dict:
    parts = {"floor": plane(bsdf=diffuse(0.5)), "lamp": point_light(lamp, 1)}
    return scene(parts, eye(view, flat_film(seen)), **direct(seen))


UP = ("floor.to_world", moved((0, 0, 1), lambda: np.diag([10.0, 10, 1, 1])), 0.0, 0.002)
"""Key, θ -> its value, θ, and the step of differences."""


def floor_form(z, view: forms.View = ABOVE, lamp: Any = LAMP) -> tuple[Any, Any]:
    return forms.lit_plane(view, z * Z, Z, lamp, 1.0, 0.5)


PLANE = Case("plane", "a floor, moved up", floor_scene, *UP, floor_form, BINS)
CENTER = forms.View((0, 0, 2), (0, 0, 0), 0.001)
PLANE_CENTER = replace(
    PLANE,
    scene="a floor, moved up, one ray",
    describe=partial(floor_scene, view=CENTER),
    form=partial(floor_form, view=CENTER),
    spp=1 << 8,
)

TILT = math.radians(25)
NORMAL = np.array([math.sin(TILT), 0, math.cos(TILT)])
ASIDE = forms.View((0.4, -0.3, 1.8), (0.1, 0.1, 0.0), 30)
TILTED_BINS = forms.Bins(2.1, 0.06, 48, 0.06)
TILTED_LAMP = (-0.3, 0.6, 1.5)


def tilted_scene() -> dict:
    lies = mi.ScalarTransform4f().rotate([0, 1, 0], 25)
    parts = {"floor": plane(lies, bsdf=diffuse(0.7)), "lamp": point_light(TILTED_LAMP, 2)}
    return scene(parts, eye(ASIDE, flat_film(TILTED_BINS, 2)), **direct(TILTED_BINS))


def tilted_base() -> np.ndarray:
    return matrix(mi.ScalarTransform4f().rotate([0, 1, 0], 25).scale(10))


def tilted_form(z, moved=0) -> tuple[Any, Any]:
    return forms.lit_plane(ASIDE, z * NORMAL, NORMAL, TILTED_LAMP, 2.0, 0.7, moved)


ALONG = ("floor.to_world", moved(NORMAL, tilted_base), 0.0, 0.002)
PLANE_2 = Case(
    *("plane", "a tilted plane, moved along its normal", tilted_scene, *ALONG),
    *(tilted_form, TILTED_BINS),
)

LIGHT = replace(
    PLANE,
    row="light",
    scene="a point light over a floor, moved up",
    key="lamp.position",
    value=lambda z: mi.Point3f(LAMP[0], LAMP[1], LAMP[2] + z),
    form=lambda z: floor_form(0.0, lamp=np.array(LAMP) + z * Z),
)

DISK = forms.Bins(2.6, 0.05, 34, 0.05)
DISK_EYE = (1.5, 0.0, 1.0)


def disk_base(h: float = 1.2) -> np.ndarray:
    return matrix((translate(0, 0, h) @ rotate((1, 0, 0), 180)).scale(0.8))


def disk_scene() -> dict:
    place = mi.ScalarTransform4f(disk_base())
    lamp = {"type": "disk", "to_world": place, "bsdf": diffuse(0), "emitter": area_light(4.0)}
    view = forms.View(DISK_EYE, (0, 0, 0), 0.001)
    integrator = {"max_depth": 2, "pulse_width_opl": DISK.sigma}
    parts = {"floor": plane(bsdf=diffuse(0.6)), "lamp": lamp}
    return scene(parts, eye(view, flat_film(DISK)), **integrator)


LIGHT_2 = Case(
    *("light", "a disk over a receiver, moved up", disk_scene),
    *("lamp.to_world", moved((0, 0, 1), lambda: disk_base(0)), 1.2, 0.01),
    lambda h: forms.disk_light(h, 0.8, 4.0, 0.6, math.hypot(*DISK_EYE)),
    DISK,
    spp=1 << 13,
)

WIDE = forms.View((0, 0, 2), (0, 0, 0), 40)
NEAR_LAMP = (0.1, 0.2, 0.9)
NEAR_BINS = forms.Bins(2.4, 0.05, 40, 0.05)
CAMERA = replace(
    PLANE,
    row="camera",
    scene="moved along its axis over a floor",
    describe=partial(floor_scene, WIDE, NEAR_LAMP, NEAR_BINS),
    key="sensor.to_world",
    value=moved((0, 0, 1), lambda: matrix(eye(WIDE, {})["to_world"])),
    form=lambda z: forms.lit_plane(WIDE, 0 * Z, Z, NEAR_LAMP, 1.0, 0.5, z * Z),
    seen=NEAR_BINS,
)

SIDEWAYS = np.array([0.8, 0.6, 0.0])
CAMERA_2 = replace(
    PLANE_2,
    row="camera",
    scene="moved sideways over a tilted plane",
    key="sensor.to_world",
    value=moved(SIDEWAYS, lambda: matrix(eye(ASIDE, {})["to_world"])),
    form=lambda x: tilted_form(0.0, x * SIDEWAYS),
)

LONG = forms.Bins(3.4, 0.15, 120, 0.15)


def corridor_scene(seen: forms.Bins, view: forms.View, *room: Any) -> dict:
    ceiling, lamp, intensity, albedos = room
    above = translate(0, 0, ceiling) @ rotate((1, 0, 0), 180)
    parts = {
        "floor": plane(bsdf=diffuse(albedos[0]), size=40.0),
        "ceiling": plane(above, bsdf=diffuse(albedos[1]), size=40.0),
        "lamp": point_light(lamp, intensity),
    }
    return scene(parts, eye(view, flat_film(seen)), **direct(seen) | {"max_depth": 3})


ROOM = (3.0, LAMP, 1.0, (0.5, 0.4))
CORRIDOR = Case(
    *("corridor", "a floor under a ceiling, moved up"),
    partial(corridor_scene, LONG, ABOVE, *ROOM),
    *("floor.to_world", moved((0, 0, 1), lambda: np.diag([40.0, 40, 1, 1])), 0.0, 0.02),
    lambda z: forms.corridor(ABOVE, z, *ROOM),
    LONG,
    spp=1 << 15,
)

LOW = forms.View((0.2, 0.1, 1.0), (0.0, 0.2, 0.0), 30, (0, 1, 0))
LOW_BINS = forms.Bins(1.2, 0.15, 120, 0.15)
LOW_LAMP = (-0.2, 0.3, 0.9)


def low_corridor(ceiling, albedo=0.8) -> tuple[Any, Any]:
    return forms.corridor(LOW, 0.0, ceiling, LOW_LAMP, 3.0, (0.6, albedo))


CORRIDOR_2 = Case(
    *("corridor", "a ceiling over a floor, moved up"),
    partial(corridor_scene, LOW_BINS, LOW, 1.6, LOW_LAMP, 3.0, (0.6, 0.8)),
    *("ceiling.to_world", moved((0, 0, 1), lambda: np.diag([40.0, -40, -1, 1])), 1.6, 0.02),
    low_corridor,
    LOW_BINS,
    spp=1 << 15,
)


def of_albedo(case: Case, scene: str, shape: str, form: Callable) -> Case:
    """The case with the albedo of a shape for θ."""
    key, value = f"{shape}.bsdf.reflectance.value", lambda a: mi.Color3f(a)
    changed = {"scene": scene, "key": key, "value": value, "theta": 0.8, "step": 0.01}
    return replace(case, row="albedo", form=form, **changed)


ALBEDO_2 = of_albedo(CORRIDOR_2, "a ceiling's over a floor", "ceiling", partial(low_corridor, 1.6))

HOLLOW = forms.Bins(0.5, 0.1, 132, 0.1)


def hollow_scene(radius: float = 1.2) -> dict:
    ball = {"type": "sphere", "to_world": mi.ScalarTransform4f().scale(radius)}
    ball |= {"flip_normals": True, "bsdf": diffuse(0.8)}
    view = forms.View((0, 0, 0), (0, 0, -1), 60)
    parts = {"ball": ball, "lamp": point_light((0, 0, 0), 2.0)}
    return scene(parts, eye(view, flat_film(HOLLOW)), **direct(HOLLOW) | {"max_depth": 4})


RADIUS = Case(
    *("sphere radius", "light and camera within a diffuse sphere", hollow_scene),
    *("ball.to_world", scaled(), 1.2, 0.01),
    lambda radius: forms.inside_sphere(radius, 0.8, 2.0, 2),
    HOLLOW,
    spp=1 << 14,
)

BALL = forms.Bins(2.8, 0.05, 32, 0.05)
BALL_EYE = (-1.0, 0.0, 1.5)


def ball_scene(radius: float = 0.5) -> dict:
    """A sphere light 2 m from what the camera sees, whose normal is at the cosine of 0.6."""
    place = translate(1.6, 0, 1.2).scale(radius)
    lamp = {"type": "sphere", "to_world": place, "bsdf": diffuse(0), "emitter": area_light(3.0)}
    parts = {"floor": plane(bsdf=diffuse(0.7)), "lamp": lamp}
    view = forms.View(BALL_EYE, (0, 0, 0), 0.001)
    integrator = {"max_depth": 2, "pulse_width_opl": BALL.sigma}
    return scene(parts, eye(view, flat_film(BALL)), **integrator)


RADIUS_2 = Case(
    *("sphere radius", "a sphere light over a receiver", ball_scene),
    *("lamp.to_world", scaled((1.6, 0, 1.2)), 0.5, 0.01),
    lambda radius: forms.sphere_light(radius, 2.0, 0.6, 3.0, 0.7, math.hypot(*BALL_EYE)),
    BALL,
    spp=1 << 13,
)


def hollow_form(albedo) -> tuple[Any, Any]:
    return forms.inside_sphere(1.2, albedo, 2.0, 2)


ALBEDO = of_albedo(RADIUS, "of a sphere around light and camera", "ball", hollow_form)

SLAB = forms.Bins(1.5, 0.05, 76, 0.05)
ALPHA = 1e-3
"""Roughness of the glass: Mitsuba's smooth `dielectric` keeps its index as a plain number."""


def slab_scene(degrees: float, seen: forms.Bins) -> dict:
    """Glass 0.3 m thick between z = 0 and -0.3, a lamp at z = -1, the camera at 1 / cos."""
    s, c = math.sin(math.radians(degrees)), math.cos(math.radians(degrees))
    view = forms.View((s / c, 0, 1.0), (0, 0, 0), 0.001)
    glass = {"type": "roughdielectric", "int_ior": 1.5, "ext_ior": 1.0, "alpha": ALPHA}
    under = translate(0, 0, -0.3) @ rotate((1, 0, 0), 180)
    material = {"bsdf": {"type": "ref", "id": "material"}}
    lamp = plane(translate(0, 0, -1), size=40.0, bsdf=diffuse(0), emitter=area_light(1.0))
    sides = {"glass": plane(size=20.0, **material), "back": plane(under, size=20.0, **material)}
    parts = sides | {"lamp": lamp}
    integrator = {"max_depth": 10, "rr_depth": 99, "emitter_sampling": False}
    integrator["pulse_width_opl"] = seen.sigma
    described = scene(parts, eye(view, flat_film(seen)), **integrator)
    return {"type": "scene", "material": glass | {"id": "material"}} | described


INDEX = Case(
    *("index", "a glass slab before a lamp", partial(slab_scene, 0.0, SLAB)),
    *("material.eta", mi.Float, 1.5, 0.02),
    lambda n: forms.slab(n, 0.3, 0.0, 1.7, 1.0, 3),
    SLAB,
    spp=1 << 14,
    sampling="attached",
    until=2.8,
)

FORTY = math.radians(40)
SLAB_2 = forms.Bins(2.2, 0.05, 76, 0.05)
INDEX_2 = replace(
    INDEX,
    scene="a glass slab, seen at 40 degrees",
    describe=partial(slab_scene, 40.0, SLAB_2),
    form=lambda n: forms.slab(n, 0.3, math.sin(FORTY), 1.7 / math.cos(FORTY), 1.0, 3),
    seen=SLAB_2,
    until=3.4,
)

MIRROR_HZ = 20e6
ONE_PIXEL = {"width": 1, "height": 1, "rfilter": {"type": "box"}}


def mirror_scene(degrees: float, the_film: dict, **integrator: Any) -> dict:
    """A mirror z = 0 seen at an angle from 1 m away, and a lamp 1.5 m along the reflected ray."""
    s, c = math.sin(math.radians(degrees)), math.cos(math.radians(degrees))
    view = forms.View((-s, 0, c), (0, 0, 0), 0.001)
    away = np.array([s, 0, c])
    lamp = {"type": "rectangle", "to_world": facing(1.5 * away, -away, 0.5), "bsdf": diffuse(0)}
    parts = {
        "mirror": plane(size=2.0, bsdf={"type": "conductor", "material": "none"}),
        "lamp": lamp | {"emitter": area_light(2.0)},
    }
    plain = {"max_depth": 3, "type": "transient_path"}
    return scene(parts, eye(view, the_film), **plain | integrator)


PHASOR_FILM = {"type": "phasor_hdr_film", "frequencies_hz": repr(MIRROR_HZ), **ONE_PIXEL}
MIRROR = Case(
    *("mirror phase", "a lamp in a mirror moved towards it"),
    partial(mirror_scene, 0.0, PHASOR_FILM),
    *("mirror.to_world", moved((0, 0, 1), lambda: np.diag([2.0, 2, 1, 1])), 0.0, 0.03),
    lambda z: forms.seen_in_mirror(z, 2.5, 1.0, 2.0),
    forms.Phasor(MIRROR_HZ),
    spp=1 << 8,
)
CORRELATED = {"type": "amcw_transient_path", "frequency_hz": MIRROR_HZ}
CORRELATED |= {"phase_offset": -math.pi / 2}
MIRROR_2 = replace(
    MIRROR,
    scene="a lamp in a mirror at 40 degrees",
    describe=partial(mirror_scene, 40.0, picture_film(), **CORRELATED),
    form=lambda z: forms.seen_in_mirror(z, 2.5, math.cos(FORTY), 2.0),
    seen=forms.Correlation(MIRROR_HZ, -math.pi / 2),
)

SETUP = Setup(sensor=(-0.6, 0.3, 1.2), power=2.5)
PATCH = Rectangle.turned((0.2, -0.1, 0.9), 35, 0)
HIDDEN = forms.Bins(2.6, 0.1, 26, 0.1)
SEEN = (0.0, 0.0, 0.0)  # What a meter of one pixel looks at: the middle of the wall


def hidden_scene() -> dict:
    described = confocal(SETUP, {"hidden": PATCH.shape()}, flat_film(HIDDEN))
    described["integrator"]["pulse_width_opl"] = HIDDEN.sigma
    return described


def hidden_form(setup: Setup, patch: Rectangle, lit, z) -> tuple[Any, Any]:
    scale = setup.power * setup.albedo**2 * patch.albedo / math.pi**3
    legs = setup.length(lit, SEEN)
    return forms.hidden_patch(z * Z, patch.center, patch.u, patch.v, lit, SEEN, legs, scale)


DEPTH = Case(
    *("hidden depth", "a tilted patch, confocal", hidden_scene),
    *("hidden.to_world", moved((0, 0, 1), PATCH.matrix), 0.0, 0.004),
    partial(hidden_form, SETUP, PATCH, SEEN),
    HIDDEN,
    spp=1 << 13,
)

SINGLE = Setup(sensor=(-0.6, 0.3, 1.2), laser=(-0.8, -0.5, 0.6), power=1.5)
LIT = (-0.3, 0.25, 0.0)
PATCH_2 = Rectangle.turned((0.3, 0.3, 1.1), 30, 200, half=(0.15, 0.05))
HIDDEN_2 = forms.Bins(2.9, 0.1, 30, 0.1)


def single_scene() -> dict:
    described = single(SINGLE, {"hidden": PATCH_2.shape()}, LIT, flat_film(HIDDEN_2))
    described["integrator"]["pulse_width_opl"] = HIDDEN_2.sigma
    return described


DEPTH_2 = Case(
    *("hidden depth", "a patch, lit from another point", single_scene),
    *("hidden.to_world", moved((0, 0, 1), PATCH_2.matrix), 0.0, 0.004),
    partial(hidden_form, SINGLE, PATCH_2, LIT),
    HIDDEN_2,
    spp=1 << 13,
)

PULSE = replace(
    PLANE,
    row="pulse width",
    scene="bins of a lit floor",
    key=PULSE_KEY,
    value=lambda s: mi.Float(s),
    theta=BINS.sigma,
    step=0.001,
    form=lambda s: floor_form(0.0),
    of_pulse=True,
)

GATE = forms.Gate(3.4, 0.1)


def gate_scene() -> dict:
    described = floor_scene(WIDE, NEAR_LAMP, NEAR_BINS)
    gate = {"type": "time_gated_transient_path", "max_depth": 2, "target_time": GATE.target}
    described["integrator"] = gate | {"pulse_width_opl": GATE.sigma}
    described["sensor"]["film"] = picture_film()
    return described


wide_form = partial(floor_form, view=WIDE, lamp=NEAR_LAMP)
PULSE_2 = replace(
    PULSE,
    scene="a gate over a lit floor",
    describe=gate_scene,
    theta=GATE.sigma,
    form=lambda s: wide_form(0.0),
    seen=GATE,
)
GATED_PLANE = replace(
    PLANE, scene="a gate over a floor", describe=gate_scene, form=wide_form, seen=GATE
)

TABLE = (
    *(PLANE, PLANE_2, RADIUS, RADIUS_2, LIGHT, LIGHT_2, ALBEDO, ALBEDO_2, INDEX, INDEX_2),
    *(DEPTH, DEPTH_2, MIRROR, MIRROR_2, CORRIDOR, CORRIDOR_2, CAMERA, CAMERA_2, PULSE, PULSE_2),
)
"""Ten parameters, two scenes of each."""

MORE = (PLANE_CENTER, GATED_PLANE)
CASES = {case.name: case for case in (*TABLE, *MORE)}
