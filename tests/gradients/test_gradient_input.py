"""What has no derivative is refused in one line."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.gradient_cases import GATED_PLANE, INDEX, MIRROR_2, PLANE
from helpers.gradient_of import attached, forward, reverse
from helpers.refusals import innermost_message
from helpers.support import with_film

import tofrender


def both(case, **integrator: Any) -> tuple[str, str]:
    """What forward and reverse mode say."""
    weights = np.ones(case.expected()[0].size)
    return (
        innermost_message(lambda: forward(case, spp=16, **integrator)),
        innermost_message(lambda: reverse(case, weights, spp=16, **integrator)),
    )


def with_described(case, change: Callable[[dict], dict]):
    return replace(case, describe=lambda: change(case.describe()))


def without(*names: str) -> Callable[[dict], dict]:
    """A scene whose integrator lacks some parameters."""

    def change(described: dict) -> dict:
        kept = {k: v for k, v in described["integrator"].items() if k not in names}
        return described | {"integrator": kept}

    return change


def in_glass(described: dict) -> dict:
    """Behind a third face, the camera is in glass."""
    above = {"to_world": mi.ScalarTransform4f().translate([0, 0, 2]).scale(20)}
    far = {"type": "sphere", "center": [0, 50, 0]}
    return described | {"above": described["glass"] | above, "glass": far}


def other_integrator(kind: str, **more: Any) -> Callable[[dict], dict]:
    return lambda described: described | {"integrator": {"type": kind} | more}


GAUSSIAN, SIMPLE = {"type": "gaussian"}, {"position": [0.5, 0, 2], "energy": 1.0}

REFUSED = {
    "bins without a pulse": (PLANE, without("pulse_width_opl"), ["pulse", "pulse_width_opl"]),
    "Gaussian filter": (PLANE, partial(with_film, rfilter=GAUSSIAN), ["rfilter", "box"]),
    "tent filter": (PLANE, partial(with_film, rfilter={"type": "tent"}), ["rfilter", "box"]),
    "simple": (PLANE, other_integrator("simple", **SIMPLE), ["Simple", "derivative"]),
    "ao": (PLANE, other_integrator("ao"), ["AmbientOcclusion", "derivative"]),
    "light tracer": (PLANE, other_integrator("transient_light_tracer"), ["Light", "derivative"]),
    "bdpt": (PLANE, other_integrator("transient_bdpt"), ["BDPT", "derivative"]),
    "camera in glass": (INDEX, in_glass, ["sensor: derivatives by eta"]),
    "gate without target": (GATED_PLANE, without("target_time"), ["target_time"]),
    "correlation": (MIRROR_2, without("frequency_hz", "phase_offset"), ["modulation"]),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_has_no_derivative(name):
    case, change, words = REFUSED[name]
    for text in both(with_described(case, change)):
        assert all(word in text for word in words), text


def test_an_integrator_beside_the_scene():
    case = with_described(PLANE, lambda d: d | {"integrator": {"type": "path"}})
    given = mi.load_dict(PLANE.describe()["integrator"])
    theta, transient = attached(case, options={"integrator": given})
    dr.forward(theta)
    expected = PLANE.weights()["sum"] @ PLANE.expected()[1]
    assert PLANE.mean(dr.grad(transient)).sum() == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize("case", [PLANE, GATED_PLANE], ids=["bins", "gate"])
def test_gates_with_hard_edges(case):
    gated = GATED_PLANE.load().integrator()
    gated.pulse = tofrender.BoxPulse(0.1)
    text = innermost_message(lambda: attached(case, spp=16, options={"integrator": gated}))
    assert "BoxPulse" in text
    assert "hard edges" in text


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
    text = innermost_message(lambda: mi.render(loaded, params=parameters, spp=1))
    assert text.startswith("lit.vertex_positions: ")
    assert "smooth normals" in text
