"""Gradients as users ask for them: in any order, by any parameter, and with nothing left behind."""

from __future__ import annotations

import warnings
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import tofrender
from tofrender.runtime.plugins import own_name

T = mi.ScalarTransform4f
ALBEDO, FLOOR = "floor.bsdf.reflectance.value", "floor.to_world"
WIDTH = "integrator.pulse_width_opl"


def described(film: dict | None = None, **parts: Any) -> dict:
    """A floor 2 m below a camera and a lamp."""
    bins = {"temporal_bins": 32, "start_opl": 3.4, "bin_width_opl": 0.05}
    film = film or {"type": own_name("transient_hdr_film")} | bins
    film = {"width": 2, "height": 2, "rfilter": {"type": "box"}} | film
    look = T().look_at([0, 0, 2], [0, 0, 0], [0, 1, 0])
    return {
        "type": "scene",
        "integrator": {"type": own_name("transient_path"), "pulse_width_opl": 0.1, "max_depth": 2},
        "sensor": {"type": "perspective", "fov": 20, "to_world": look, "film": film},
        "floor": {"type": "rectangle", "to_world": T().scale(10), "bsdf": {"type": "diffuse"}},
        "lamp": {"type": "point", "position": [0.5, 0, 2], "intensity": 5.0},
    } | parts


def load(**parts: Any) -> mi.Scene:
    return tofrender.load_scene(described(**parts), optimize=False)


def refused(scene: mi.Scene, params: Any, **options: Any) -> str:
    """The one line that says why `render` has no derivatives."""
    with pytest.raises((ValueError, RuntimeError)) as caught:
        tofrender.render(scene, params=params, spp=1, **options)
    text = str(caught.value)
    assert "\n" not in text
    return text


# ------------------------------------------------------------------------------ pulse width


def test_width_is_set_after_a_render():
    scene = load()
    parameters = mi.traverse(scene)
    for width in (0.3, 0.5, 0.2):
        parameters[WIDTH] = mi.Float(width)
        parameters.update()
        assert scene.integrator().pulse.width_opl == pytest.approx(width)
        mi.render(scene, spp=1)


def square_of_bins(scene: mi.Scene, parameters: Any) -> Any:
    return dr.sum(dr.square(mi.render(scene, parameters, spp=64)[1]), axis=None)


def test_width_tracks_gradients_by_enable_grad_alone():
    scene = load()
    mi.render(scene, spp=1)
    parameters = mi.traverse(scene)
    dr.enable_grad(parameters[WIDTH])
    dr.backward(square_of_bins(scene, parameters))
    found = dr.grad(parameters[WIDTH])[0]
    dr.disable_grad(parameters[WIDTH])
    sides = []
    for width in (0.101, 0.099):
        parameters[WIDTH] = mi.Float(width)
        parameters.update()
        sides.append(float(square_of_bins(scene, None).array[0]))
    assert found < 0
    assert found == pytest.approx((sides[0] - sides[1]) / 0.002, rel=1e-2)


def test_a_fit_of_width_compiles_no_kernel_anew():
    scene = load()
    target = mi.render(scene, spp=16)[1]
    anew: list[int] = []

    def count(*_: Any) -> None:
        jit = [each for each in dr.kernel_history() if each["type"] == dr.KernelType.JIT]
        anew.append(sum(not each["cache_hit"] for each in jit))
        dr.kernel_history_clear()

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        options = {"spp": 16, "steps": 5, "progress": False, "callback": count}
        tofrender.fit(scene, {WIDTH: 0.08}, target, **options)
    assert anew[2:] == [0, 0, 0]


class Tent:
    """A student's own pulse, of a width that is not a Gaussian's."""

    def __init__(self, width: float) -> None:
        self.width = width
        self.support = (-width, width)

    def eval(self, t):
        return dr.maximum(1 - dr.abs(t) / self.width, 0) / self.width

    def cdf(self, t):
        x = dr.clip(t / self.width, -1, 1)
        return 0.5 + x - 0.5 * x * dr.abs(x)

    def sample(self, xi):
        raise NotImplementedError


class Jump(Tent):
    """One that is open or shut."""

    def eval(self, t):
        return dr.select(dr.abs(t) < self.width, 0.5 / self.width, 0)


class Stairs(Tent):
    """One that is constant in many pieces."""

    def eval(self, t):
        return super().eval(dr.floor(t / self.width * 200) * self.width / 200)


def test_other_pulses_have_no_width_of_a_gaussian():
    scene = load()
    scene.integrator().pulse = Tent(0.2)
    assert WIDTH not in mi.traverse(scene)
    parameters = mi.traverse(scene)
    dr.enable_grad(parameters[ALBEDO])
    _, transient = tofrender.render(scene, params=parameters, spp=4)
    dr.backward(dr.sum(transient.array))
    assert dr.grad(parameters[ALBEDO])[0] > 0


@pytest.mark.parametrize("pulse", [Tent, Jump, Stairs, tofrender.BoxPulse])
def test_gates_of_any_pulse_are_smooth_or_refused(pulse):
    film = {"type": "hdrfilm", "pixel_format": "rgb"}
    gate = {"type": own_name("time_gated_transient_path"), "target_time": 4.0, "max_depth": 2}
    scene = load(film=film, integrator=gate)
    scene.integrator().pulse = pulse(0.2)
    parameters = mi.traverse(scene)
    dr.enable_grad(parameters[ALBEDO])
    if pulse is Tent:
        dr.backward(dr.sum(mi.render(scene, parameters, spp=4).array))
        assert dr.grad(parameters[ALBEDO])[0] > 0
    else:
        with pytest.raises(RuntimeError) as caught:
            mi.render(scene, parameters, spp=1)
        assert "has hard edges" in str(caught.value.__cause__)


def test_pulses_of_integrators_are_their_own():
    pulse = tofrender.GaussianPulse(0.1)
    one, two = load(), load()
    one.integrator().pulse = two.integrator().pulse = pulse
    parameters = mi.traverse(one)
    parameters[WIDTH] = mi.Float(0.4)
    parameters.update()
    widths = [each.width_opl for each in (pulse, one.integrator().pulse, two.integrator().pulse)]
    assert widths == pytest.approx([0.1, 0.4, 0.1])


# ------------------------------------------------------------------------- what is refused


@pytest.mark.parametrize("sky", ["constant", "directional", "envmap"])
def test_things_that_move_under_light_from_afar(sky):
    light = {"type": sky}
    if sky == "envmap":
        light["bitmap"] = mi.Bitmap(np.ones((4, 8, 3), np.float32))
    scene = load(sky=light)
    parameters, theta = mi.traverse(scene), mi.Float(0)
    dr.enable_grad(theta)
    parameters[FLOOR] = mi.Transform4f().translate([0, 0, theta]).scale(10)
    parameters.update()
    assert "starts at a sphere around all that moves" in refused(scene, parameters)


def test_things_that_move_before_a_sensor_in_a_grid():
    cells = mi.VolumeGrid(np.full((2, 2, 2, 1), 0.1, np.float32))
    volume = {"type": "gridvolume", "to_world": T().translate([-9, -9, -9]).scale(18)}
    smoke = {"type": "heterogeneous", "albedo": 0.5, "sigma_t": volume | {"grid": cells}}
    scene = load(sensor=described()["sensor"] | {"medium": smoke})
    parameters, theta = mi.traverse(scene), mi.Float(0)
    dr.enable_grad(theta)
    parameters[FLOOR] = mi.Transform4f().translate([0, 0, theta]).scale(10)
    parameters.update()
    assert "media that are grids" in refused(scene, parameters)


@pytest.mark.parametrize("forwards", [True, False])
def test_integrators_refuse_by_themselves_too(forwards):
    film = {"type": own_name("phasor_hdr_film"), "wl_mean": 10.0, "wl_sigma": 5.0} | {
        "temporal_bins": 64, "bin_width_opl": 0.5, "start_opl": 0.0,
    }  # fmt: skip
    scene = load(film=film)
    parameters = mi.traverse(scene)
    dr.enable_grad(parameters[WIDTH])
    own, grad = scene.integrator(), mi.TensorXf(0.0)
    call = partial(own.render_forward, scene, parameters)
    if not forwards:
        call = partial(own.render_backward, scene, parameters, grad)
    with pytest.raises(ValueError, match="no derivative on a phasor_hdr_film"):
        call(spp=1)


def test_a_refusal_says_what_tracks_gradients_and_has_no_loop_of_causes():
    scene = load()
    scene.integrator().pulse = None
    parameters = mi.traverse(scene)
    dr.enable_grad(parameters[ALBEDO])
    with pytest.raises(ValueError, match="pulse = None") as caught:
        tofrender.render(scene, params=parameters, spp=1)
    assert f"as '{ALBEDO}' tracks gradients" in str(caught.value)
    error: BaseException | None = caught.value
    seen: list[BaseException] = []
    while error is not None:
        assert error not in seen
        seen.append(error)
        error = error.__cause__ or error.__context__


@pytest.mark.parametrize("pixels", ["luminance", "luminance_alpha", "rgb", "rgba"])
def test_pictures_of_all_formats_have_equal_modes(pixels):
    film = {"type": "hdrfilm", "pixel_format": pixels}
    gate = {"type": own_name("time_gated_transient_path"), "target_time": 4.1, "max_depth": 2}
    red = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.9, 0.2, 0.1]}}
    floor = described()["floor"] | {"bsdf": red}
    scene = load(film=film, integrator=gate, floor=floor)
    name, found = "lamp.intensity.value", []
    for forwards in (True, False):
        parameters, theta = mi.traverse(scene), mi.Float(5.0)
        dr.enable_grad(theta)
        parameters[name] = theta
        parameters.update()
        picture = mi.render(scene, parameters, spp=16, seed=1)
        if forwards:
            dr.forward(theta)
            found.append(float(np.array(dr.grad(picture)).sum()))
        else:
            dr.backward(dr.sum(picture.array))
            found.append(dr.grad(theta)[0])
    assert found[0] > 0
    assert found[1] == pytest.approx(found[0], rel=1e-3)


# --------------------------------------------------------------------------- what is warned of

MOVED = ("principal_point_offset_x", "x_fov")


@pytest.mark.parametrize("name", MOVED)
@pytest.mark.parametrize("apart", [False, True])
def test_what_changes_the_view_is_warned_of(name, apart):
    scene = load()
    sensor: Any = mi.load_dict(described()["sensor"]) if apart else 0
    parameters = mi.traverse(sensor if apart else scene)
    key = name if apart else f"sensor.{name}"
    dr.enable_grad(parameters[key])
    parameters.update()
    with pytest.warns(tofrender.VisibilityWarning, match=name):
        mi.render(scene, parameters, sensor=sensor, spp=1)


# ------------------------------------------------------------------------- what is left behind


def fails(*_: Any) -> None:
    raise KeyError("mine")


def test_a_fit_that_fails_leaves_a_scene_that_tracks_nothing():
    scene = load()
    target = mi.render(scene, spp=16)[1]
    with pytest.raises(KeyError, match="mine"):
        tofrender.fit(scene, {ALBEDO: 0.2}, target, spp=4, callback=fails, progress=False)
    parameters = mi.traverse(scene)
    assert not dr.grad_enabled(parameters[ALBEDO])
    assert parameters[ALBEDO][0] == pytest.approx(0.2)
    scene.integrator().pulse = None
    mi.render(scene, spp=1)  # Not refused


def test_a_fit_that_is_refused_leaves_the_scene_as_it_was():
    scene = load()
    with pytest.raises((ValueError, RuntimeError)):
        tofrender.fit(scene, {ALBEDO: 0.2}, np.ones((2, 2, 32, 9), np.float32), spp=4)
    assert mi.traverse(scene)[ALBEDO][0] == pytest.approx(0.5)


def test_an_optimiser_stays_as_it_is():
    scene = load()
    target = mi.render(scene, spp=16)[1]
    engine = mi.ad.Adam(lr=0.07, beta_1=0.5)
    for _ in range(2):
        tofrender.fit(
            scene, {ALBEDO: 0.2}, target, optimizer=engine, spp=4, steps=3, progress=False
        )
    assert len(engine) == 0
    assert engine.lr == 0.07


def test_a_fit_that_loses_sight_of_the_light_says_so():
    scene = load()
    target = mi.render(scene, spp=16)[1]

    def apply(params: Any, values: Any) -> None:
        params[FLOOR] = mi.Transform4f().translate([0, 0, values["z"]]).scale(10)

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        tofrender.fit(
            scene, {"z": -0.55}, target, apply=apply, learning_rate=0.3, spp=16, steps=12,
            progress=False,
        )  # fmt: skip
    assert any("no light is left in the film" in str(each.message) for each in caught)


def test_plugins_under_a_scalar_variant():
    before = mi.variant()
    mi.set_variant("scalar_rgb")
    try:
        with pytest.raises(Exception, match="variant = 'scalar_rgb': cannot render in time"):
            mi.load_dict({"type": "transient_path"})
    finally:
        mi.set_variant(before)
