"""What has no derivative is refused in one line that names it."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.gradient_cases import (
    GATED_PLANE,
    INDEX,
    MIRROR_2,
    PLANE,
    picture_film,
)
from helpers.gradient_of import attached, forward, reverse
from helpers.support import with_film

import tofrender


def refusal(call: Callable[[], Any]) -> str:
    """What the first error says. Dr.Jit wraps those of an operation into its own."""
    with pytest.raises((ValueError, TypeError, RuntimeError)) as caught:
        call()
    error: BaseException = caught.value
    traceback.clear_frames(error.__traceback__)  # They hold a scene that tracks gradients
    while error.__cause__ is not None:
        error = error.__cause__
        traceback.clear_frames(error.__traceback__)
    text = str(error)
    assert text
    assert "\n" not in text.strip()
    return text


def both(case, **integrator: Any) -> tuple[str, str]:
    """What forward and reverse mode say."""
    weights = np.ones(case.expected()[0].size)
    return (
        refusal(lambda: forward(case, spp=16, **integrator)),
        refusal(lambda: reverse(case, weights, spp=16, **integrator)),
    )


def with_described(case, change: Callable[[dict], dict]):
    return replace(case, describe=lambda: change(case.describe()))


def without_pulse(described: dict) -> dict:
    kept = {k: v for k, v in described["integrator"].items() if k != "pulse_width_opl"}
    return described | {"integrator": kept}


def test_bins_without_a_pulse():
    for text in both(with_described(PLANE, without_pulse)):
        assert "pulse" in text
        assert "pulse_width_opl" in text


@pytest.mark.parametrize("rfilter", ["gaussian", "tent"])
def test_films_whose_filter_is_not_a_box(rfilter):
    case = with_described(PLANE, lambda d: with_film(d, rfilter={"type": rfilter}))
    for text in both(case):
        assert "rfilter" in text
        assert "box" in text


OTHERS = {
    "simple": {"position": [0.5, 0, 2], "energy": 1.0},
    "ao": {},
    "transient_light_tracer": {},
    "transient_bdpt": {},
}


def other_integrator(kind: str) -> Callable[[dict], dict]:
    def change(described: dict) -> dict:
        if kind == "path_tracer_mis":  # Knows no time
            described = described | {"sensor": described["sensor"] | {"film": picture_film()}}
        return described | {"integrator": {"type": f"tofrender_{kind}"} | OTHERS[kind]}

    return change


@pytest.mark.parametrize("kind", OTHERS)
def test_integrators_without_derivatives(kind):
    case = with_described(PLANE, other_integrator(kind))
    loaded = tofrender.load_scene(case.describe(), optimize=False)
    name = type(loaded.integrator()).__name__

    def call(backward: bool) -> None:
        theta, tensor = mi.Float(0.0), None
        dr.enable_grad(theta)
        parameters = mi.traverse(loaded)
        case.set(parameters, theta)
        tensor = case.output(mi.render(loaded, parameters, spp=16))
        if backward:
            dr.backward(dr.sum(tensor.array))
        else:
            dr.forward(theta)

    for backward in (False, True):
        text = refusal(lambda backward=backward: call(backward))
        assert "derivative" in text
        assert name in text or kind in text


def test_nothing_that_is_attached():
    """Dr.Jit itself says so: the picture depends on nothing."""
    loaded = PLANE.load()
    parameters = mi.traverse(loaded)
    _, transient = mi.render(loaded, parameters, spp=16)
    assert not dr.grad_enabled(transient)
    with pytest.raises(RuntimeError):
        dr.backward(dr.sum(transient.array))


def test_an_index_that_is_a_plain_number():
    """Mitsuba's smooth `dielectric` keeps a plain float, which no gradient fits into."""
    loaded = INDEX.load()
    smooth = mi.load_dict({"type": "dielectric", "int_ior": 1.5})
    parameters = mi.traverse(smooth)
    theta = mi.Float(1.5)
    dr.enable_grad(theta)
    with pytest.raises(RuntimeError):
        parameters["eta"] = theta
    assert dr.grad_enabled(mi.traverse(loaded)["material.eta"]) is False


def test_the_index_around_the_camera():
    """Behind a third face, the camera is in glass."""
    above = {"to_world": mi.ScalarTransform4f().translate([0, 0, 2]).scale(20)}
    case = with_described(
        INDEX,
        lambda d: (
            d | {"above": d["glass"] | above, "glass": {"type": "sphere", "center": [0, 50, 0]}}
        ),
    )
    for text in both(case):
        assert "sensor: is in glass or water" in text


@pytest.mark.parametrize("value", ["attach", "", 1, True])
def test_unknown_kinds_of_sampling(value):
    text = refusal(lambda: attached(PLANE, spp=16, gradient_sampling=value))
    assert "gradient_sampling" in text
    assert "attached" in text
    assert "detached" in text


def test_a_scene_without_integrator():
    described = {k: v for k, v in PLANE.describe().items() if k != "integrator"}
    loaded = mi.load_dict(described, parallel=False, optimize=False)
    parameters = mi.traverse(loaded)
    with_default = mi.load_dict(PLANE.describe()["integrator"])
    theta = mi.Float(0.0)
    dr.enable_grad(theta)
    PLANE.set(parameters, theta)
    _, transient = mi.render(loaded, parameters, integrator=with_default, spp=1 << 12)
    dr.forward(theta)
    expected = PLANE.weights()["sum"] @ PLANE.expected()[1]
    found = PLANE.mean(dr.grad(transient))
    assert found.sum() == pytest.approx(expected, rel=5e-3)


def test_a_gate_without_target():
    def change(described: dict) -> dict:
        kept = {k: v for k, v in described["integrator"].items() if k != "target_time"}
        return described | {"integrator": kept}

    for text in both(with_described(GATED_PLANE, change)):
        assert "target_time" in text


@pytest.mark.parametrize("bins", [False, True])
def test_gates_with_hard_edges(bins):
    case = PLANE if bins else GATED_PLANE
    loaded = tofrender.load_scene(case.describe(), optimize=False)
    gated = tofrender.load_scene(GATED_PLANE.describe(), optimize=False).integrator()
    gated.pulse = tofrender.BoxPulse(0.1)
    parameters, theta = mi.traverse(loaded), mi.Float(case.theta)
    dr.enable_grad(theta)
    case.set(parameters, theta)
    text = refusal(lambda: mi.render(loaded, parameters, integrator=gated, spp=16))
    assert "BoxPulse" in text
    assert "hard edges" in text


def test_a_correlation_without_modulation():
    def change(described: dict) -> dict:
        kept = {k: v for k, v in described["integrator"].items() if k != "frequency_hz"}
        return described | {"integrator": {k: v for k, v in kept.items() if k != "phase_offset"}}

    for text in both(with_described(MIRROR_2, change)):
        assert "modulation" in text


def test_discrete_parameters():
    """Faces of a mesh are whole numbers: Dr.Jit has no gradient of them."""
    cube = mi.load_dict({"type": "cube"})
    faces = mi.traverse(cube)["faces"]
    dr.enable_grad(faces)  # Without effect
    assert not dr.grad_enabled(faces)


def test_the_corners_of_a_lamp_with_smooth_normals():
    props = mi.Properties()
    props["emitter"] = mi.load_dict({"type": "area"})
    mesh = mi.Mesh("lit", 3, 1, has_vertex_normals=True, props=props)
    corners = mi.traverse(mesh)
    corners["vertex_positions"] = [0, 0, 1, 1, 0, 1, 0, 1, 1]
    corners["vertex_normals"] = [-0.6, 0, 0.8, 0.6, 0, 0.8, 0, 0.6, 0.8]
    corners["faces"] = [0, 1, 2]
    corners.update()
    loaded = mi.load_dict(PLANE.describe() | {"lit": mesh}, optimize=False)
    parameters = mi.traverse(loaded)
    key = next(name for name in parameters.keys() if name.endswith("lit.vertex_positions"))  # noqa: SIM118
    dr.enable_grad(parameters[key])
    text = refusal(lambda: mi.render(loaded, params=parameters, spp=1))
    assert text.startswith("lit.vertex_positions: has no derivative, the lamp's normals are smooth")
