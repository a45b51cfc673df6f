"""`render(scene, params=...)`: the tensors of `mi.render(scene, params)`, with derivatives."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import xarray as xr

import tofrender

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


def test_has_the_light_of_a_dataset():
    scene = box()
    steady, transient = tofrender.render(scene, params=mi.traverse(scene), spp=1024)
    dataset = tofrender.render(scene, spp=1024)
    assert isinstance(dataset, xr.Dataset)
    assert transient.shape == dataset.transient.shape
    assert steady.shape == dataset.steady.shape
    assert np.mean(np.array(steady)) == pytest.approx(float(dataset.steady.mean()), rel=0.02)
    assert np.mean(np.array(transient)) == pytest.approx(float(dataset.transient.mean()), rel=0.02)


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
    **{"scheduler": "tcp://localhost:1", "client": 1, "settings": {}, "temporal_bins": 4},
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


def test_what_has_no_derivative():
    scene = box()
    params = mi.traverse(scene)
    dr.enable_grad(params[ALBEDO])
    with pytest.raises(RuntimeError, match=r"^integrator = AmbientOcclusion: has no derivatives"):
        tofrender.render(scene, params=params, integrator="ao")
