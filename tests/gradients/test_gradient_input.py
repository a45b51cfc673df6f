"""What has no derivative is refused in one line, and `render(scene, params=...)`.

That gives the tensors of `mi.render(scene, params)`, with derivatives.
"""

import traceback
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import xarray as xr
from helpers.gradient_cases import GATED_PLANE, INDEX, MIRROR_2, PLANE
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
    text = refusal(lambda: attached(case, spp=16, options={"integrator": gated}))
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
    text = refusal(lambda: mi.render(loaded, params=parameters, spp=1))
    assert text.startswith("lit.vertex_positions: ")
    assert "smooth normals" in text


ALBEDO = "green.reflectance.value"
BINS = {"temporal_bins": 20, "start_opl": 3.0, "bin_width_opl": 0.5}


def box(**more: Any) -> mi.Scene:
    size = {"width": 4, "height": 4, "spp": 4, "max_depth": 3, "pulse_width_opl": 0.2}
    return tofrender.load_scene("cornell_box", **size | BINS | more)


def gradient(render: Any, **options: Any) -> tuple[Any, np.ndarray]:
    """What is rendered, and how an albedo changes the mean of each."""
    scene = box()
    params = mi.traverse(scene)
    dr.enable_grad(params[ALBEDO])
    rendered = render(scene, params=params, **options)
    assert all(dr.grad_enabled(each) for each in rendered)
    dr.backward(sum(dr.mean(each, axis=None) for each in rendered))
    return rendered, np.array(dr.grad(params[ALBEDO]))


@pytest.mark.parametrize("options", [{}, {"seed": 3, "spp": 16}, {"sensor": 0}])
def test_is_mitsubas_render(options):
    ours, found = gradient(tofrender.render, progress=False, **options)
    its, expected = gradient(mi.render, **options)
    for one, other in zip(ours, its, strict=True):
        assert isinstance(one, mi.TensorXf)
        assert np.allclose(np.array(one), np.array(other), rtol=1e-5, atol=1e-9)
    assert np.allclose(found, expected, rtol=1e-5)
    assert np.all(found > 0)


def test_of_another_integrator():
    described = {"type": "transient_path", "max_depth": 2, "pulse_width_opl": 0.2}
    given = (described, mi.load_dict(described), "transient_volpath")
    scene = box()
    params = mi.traverse(scene)
    found = [
        float(np.sum(np.array(tofrender.render(scene, params=params, spp=64, integrator=each)[0])))
        for each in given
    ]
    assert found[0] == pytest.approx(found[1], rel=1e-5)
    assert found[2] > 1.05 * found[0]


DATASETS = {
    **{"size": (4, 4), "bins": 4, "start_opl": 0.0, "bin_width": 0.1, "window": (3.0, 5.0)},
    **{"pulse_width": 0.1, "max_depth": 2, "sampler": "independent", "define": {}, "errors": True},
    **{"resume": xr.Dataset(), "checkpoint": "a.npz", "out": "a.zarr", "workers": 2},
    **{"scheduler": "tcp://localhost:1", "client": 1, "settings": {}, "bins": 4},
}


def test_what_only_datasets_have(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scene = box()
    for name, value in DATASETS.items():
        with pytest.raises(ValueError, match=rf"^{name} = .*: must be left out with `params`$"):
            tofrender.render(scene, params=mi.traverse(scene), **{name: value})
    assert not list(tmp_path.iterdir())


def test_scenes_and_parameters_of_another_kind():
    for described in ("cornell_box", tofrender.cornell_box()):
        with pytest.raises(ValueError, match=r"^scene = .*: must be a loaded scene with `params`"):
            tofrender.render(described, params=mi.traverse(box()))
    with pytest.raises(ValueError, match=r"^params = {'a': 1}: must be those of mi.traverse"):
        tofrender.render(box(), params={"a": 1})
