"""Gradients as users ask for them: in any order, by any parameter, and with nothing left behind."""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.gradient_of import from_above, grid_of, moved_render, tracked
from helpers.parts import plane, point_light
from helpers.refusals import innermost_message
from oracles.gradients import Bins

import tofrender
from tofrender.runtime.plugins import qualified_name

T = mi.ScalarTransform4f
ALBEDO, FLOOR = "floor.bsdf.reflectance.value", "floor.to_world"
WIDTH = "integrator.pulse_width_opl"
SEEN = Bins(3.4, 0.05, 32, 0.1)


def described(film: dict | None = None, **parts: Any) -> dict:
    """A floor 2 m below a camera and a lamp."""
    above = {"floor": plane(size=10), "lamp": point_light((0.5, 0, 2), 5.0)}
    made = from_above(2, 20, SEEN, above, size=2, max_depth=2)
    if film is not None:
        sizes = {"width": 2, "height": 2, "rfilter": {"type": "box"}}
        made["sensor"]["film"] = sizes | film
    return made | parts


def load(**parts: Any) -> mi.Scene:
    return tofrender.load_scene(described(**parts), optimize=False)


def lifted(scene: mi.Scene) -> mi.SceneParameters:
    """Parameters of the scene, whose floor's height tracks gradients."""
    parameters = mi.traverse(scene)
    parameters[FLOOR] = mi.Transform4f().translate([0, 0, tracked(0.0)]).scale(10)
    parameters.update()
    return parameters


def attached_to(scene: mi.Scene, key: str) -> mi.SceneParameters:
    parameters = mi.traverse(scene)
    dr.enable_grad(parameters[key])
    return parameters


def derivative(scene: mi.Scene, key: str, **options: Any) -> float:
    """How all light changes."""
    parameters = attached_to(scene, key)
    rendered = mi.render(scene, parameters, **options)
    dr.backward(dr.sum((rendered[1] if isinstance(rendered, tuple) else rendered).array))
    return dr.grad(parameters[key])[0]


def gate(target: float, pixels: str = "rgb") -> dict:
    """A film and an integrator."""
    kind = qualified_name("time_gated_transient_path")
    return {
        "film": {"type": "hdrfilm", "pixel_format": pixels},
        "integrator": {"type": kind, "target_time": target, "max_depth": 2},
    }


def square_of_bins(scene: mi.Scene, parameters: Any) -> Any:
    return dr.sum(dr.square(mi.render(scene, parameters, spp=64)[1]), axis=None)


def test_width_is_set_and_tracks_gradients_after_a_render():
    scene = load()
    mi.render(scene, spp=1)
    parameters = attached_to(scene, WIDTH)
    dr.backward(square_of_bins(scene, parameters))
    found = dr.grad(parameters[WIDTH])[0]
    dr.disable_grad(parameters[WIDTH])
    sides = []
    for width in (0.101, 0.099):
        parameters[WIDTH] = mi.Float(width)
        parameters.update()
        assert scene.integrator().pulse.width_opl == pytest.approx(width)
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
        self.width, self.support = width, (-width, width)

    def eval(self, t):
        return dr.maximum(1 - dr.abs(t) / self.width, 0) / self.width

    def cdf(self, t):
        x = dr.clip(t / self.width, -1, 1)
        return 0.5 + x - 0.5 * x * dr.abs(x)


class Stairs(Tent):
    """One that is constant in many pieces."""

    def eval(self, t):
        return super().eval(dr.floor(t / self.width * 200) * self.width / 200)


def test_other_pulses_have_no_width_of_a_gaussian():
    scene = load()
    scene.integrator().pulse = Tent(0.2)
    assert WIDTH not in mi.traverse(scene)
    assert derivative(scene, ALBEDO, spp=4) > 0


@pytest.mark.parametrize("pulse", [Tent, Stairs, tofrender.BoxPulse])
def test_gates_of_any_pulse_are_smooth_or_refused(pulse):
    scene = load(**gate(4.0))
    scene.integrator().pulse = pulse(0.2)
    if pulse is Tent:
        assert derivative(scene, ALBEDO, spp=4) > 0
        return
    with pytest.raises(RuntimeError) as caught:
        derivative(scene, ALBEDO, spp=1)
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


SKIES = {
    "constant": {"type": "constant"},
    "directional": {"type": "directional"},
    "envmap": {"type": "envmap", "bitmap": mi.Bitmap(np.ones((4, 8, 3), np.float32))},
}


@pytest.mark.parametrize("sky", SKIES)
def test_things_that_move_under_light_from_afar(sky):
    scene = load(sky=SKIES[sky])
    text = innermost_message(lambda: mi.render(scene, lifted(scene), spp=1))
    assert "a sphere around the moving scene" in text


def test_things_that_move_before_a_sensor_in_a_grid():
    smoke = grid_of(np.full((2, 2, 2, 1), 0.1), [-9, -9, -9], 18, 0.5)
    scene = load(sensor=described()["sensor"] | {"medium": smoke})
    text = innermost_message(lambda: mi.render(scene, lifted(scene), spp=1))
    assert "in scenes with grids" in text


def test_integrators_refuse_by_themselves_too():
    film = {"type": qualified_name("phasor_hdr_film"), "wl_mean": 10.0, "wl_sigma": 5.0}
    bins = {"temporal_bins": 64, "bin_width_opl": 0.5, "start_opl": 0.0}
    scene = load(film=film | bins)
    parameters, own = attached_to(scene, WIDTH), scene.integrator()
    with pytest.raises(ValueError, match=r"pulse_width_opl: .* on a phasor_hdr_film"):
        own.render_forward(scene, parameters, spp=1)
    with pytest.raises(ValueError, match=r"pulse_width_opl: .* on a phasor_hdr_film"):
        own.render_backward(scene, parameters, mi.TensorXf(0.0), spp=1)


def test_a_refusal_says_what_tracks_gradients_and_has_no_loop_of_causes():
    scene = load()
    scene.integrator().pulse = None
    with pytest.raises(RuntimeError) as caught:
        mi.render(scene, lifted(scene), spp=1)
    seen: list[BaseException | None] = [caught.value]
    while seen[-1] is not None:
        seen.append(seen[-1].__cause__ or seen[-1].__context__)
        assert seen[-1] not in seen[:-1]
    text = str(seen[-2])
    assert text.startswith("pulse = None")
    assert f"'{FLOOR}' tracks gradients" in text


@pytest.mark.statistical
@pytest.mark.parametrize("mode", ["forward", "reverse"])
def test_an_albedo_needs_no_pulse(mode):
    """Light of one bounce is proportional to the albedo a: its derivative in each bin is L / a."""
    albedo = [0.3, 0.5, 0.7]
    color = {"type": "rgb", "value": albedo}
    scene = load(floor=plane(size=10, bsdf={"type": "diffuse", "reflectance": color}))
    scene.integrator().pulse = None
    parameters = attached_to(scene, ALBEDO)
    rendered = mi.render(scene, parameters, spp=4096)[1]
    light = np.array(dr.detach(rendered), float)
    weights = np.random.default_rng(0).random(light.shape).astype(np.float32)
    if mode == "reverse":
        dr.backward(dr.sum(rendered * mi.TensorXf(weights), axis=None))
        found = np.array(dr.grad(parameters[ALBEDO])).ravel()
    else:
        dr.set_grad(parameters[ALBEDO], mi.Color3f(1.0))
        dr.forward_to(rendered)
        found = (weights * np.array(dr.grad(rendered))).sum((0, 1, 2))
    assert found == pytest.approx((weights * light).sum((0, 1, 2)) / np.array(albedo), rel=0.02)


def test_attached_sampling_needs_a_pulse():
    """Sampled directions, and so path lengths, change with the material."""
    scene = load()
    scene.integrator().pulse = None
    scene.integrator().gradient_sampling = "attached"
    text = innermost_message(lambda: mi.render(scene, attached_to(scene, ALBEDO), spp=1))
    assert text.startswith("pulse = None: ")


@pytest.mark.parametrize("pixels", ["luminance", "luminance_alpha", "rgb", "rgba"])
def test_pictures_of_all_formats_have_equal_modes(pixels):
    red = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.9, 0.2, 0.1]}}
    scene = load(floor=plane(size=10, bsdf=red), **gate(4.1, pixels))
    found = []
    for forwards in (True, False):
        theta = tracked(5.0)
        picture = moved_render(scene, "lamp.intensity.value", theta, spp=16, seed=1)
        if forwards:
            dr.forward(theta)
            found.append(float(np.array(dr.grad(picture)).sum()))
        else:
            dr.backward(dr.sum(picture.array))
            found.append(dr.grad(theta)[0])
    assert found[0] > 0
    assert found[1] == pytest.approx(found[0], rel=1e-3)


@pytest.mark.parametrize("name", ["principal_point_offset_x", "x_fov"])
@pytest.mark.parametrize("apart", [False, True])
def test_what_changes_the_view_is_warned_of(name, apart):
    scene = load()
    sensor: Any = mi.load_dict(described()["sensor"]) if apart else 0
    parameters = attached_to(sensor, name) if apart else attached_to(scene, f"sensor.{name}")
    parameters.update()
    with pytest.warns(tofrender.VisibilityWarning, match=name):
        mi.render(scene, parameters, sensor=sensor, spp=1)


def lit() -> tuple[mi.Scene, Any]:
    """A scene, and what its film measures."""
    scene = load()
    return scene, mi.render(scene, spp=16)[1]


def fitted(scene: mi.Scene, params: dict, target: Any, **options: Any) -> tofrender.Fit:
    return tofrender.fit(scene, params, target, **{"spp": 4, "progress": False} | options)


def fails(*_: Any) -> None:
    raise KeyError("mine")


def test_a_fit_that_fails_leaves_a_scene_that_tracks_nothing():
    scene, target = lit()
    with pytest.raises(KeyError, match="mine"):
        fitted(scene, {ALBEDO: 0.2}, target, callback=fails)
    parameters = mi.traverse(scene)
    assert not dr.grad_enabled(parameters[ALBEDO])
    assert parameters[ALBEDO][0] == pytest.approx(0.2)
    scene.integrator().pulse = None
    mi.render(scene, spp=1)  # Not refused


def test_a_fit_that_is_refused_leaves_the_scene_as_it_was():
    scene = load()
    with pytest.raises((ValueError, RuntimeError)):
        fitted(scene, {ALBEDO: 0.2}, np.ones((2, 2, 32, 9), np.float32))
    assert mi.traverse(scene)[ALBEDO][0] == pytest.approx(0.5)


def test_an_optimizer_stays_as_it_is():
    scene, target = lit()
    engine = mi.ad.Adam(lr=0.07, beta_1=0.5)
    for _ in range(2):
        fitted(scene, {ALBEDO: 0.2}, target, optimizer=engine, steps=3)
    assert len(engine) == 0
    assert engine.lr == 0.07


def test_a_fit_that_loses_sight_of_the_light_says_so():
    def apply(params: Any, values: Any) -> None:
        params[FLOOR] = mi.Transform4f().translate([0, 0, values["z"]]).scale(10)

    options = {"apply": apply, "learning_rate": 0.3, "spp": 16, "steps": 12}
    with pytest.warns(UserWarning, match="the final film is black"):
        fitted(lit()[0], {"z": -0.55}, lit()[1], **options)


def test_plugins_under_a_scalar_variant():
    mi.set_variant("scalar_rgb")
    with pytest.raises(Exception, match="variant = 'scalar_rgb': cannot render in time"):
        mi.load_dict({"type": "transient_path"})
