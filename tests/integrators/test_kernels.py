"""Each step of a render follows its paths once: one kernel of their width is large."""

import drjit as dr
import mitsuba as mi
import pytest

import tofrender
from tofrender.integrators import passes

LARGE = 300
"""Operations of a kernel that traces paths; those that only move numbers have fewer than 40."""

BOX = {"type": "box"}
SIZE = {"width": 8, "height": 8}


def box(film: dict, integrator: dict) -> mi.Scene:
    scene = tofrender.cornell_box(**SIZE)
    scene["sensor"]["film"] |= film
    scene["integrator"] = integrator
    return mi.load_dict(scene)


def picture(integrator: str, **more) -> mi.Scene:
    scene = tofrender.cornell_box(**SIZE)
    scene["sensor"]["film"] = {"type": "hdrfilm", "rfilter": BOX, **SIZE}
    scene["integrator"] = {"type": integrator, **more}
    return mi.load_dict(scene)


SCENES = {
    "bins": lambda: box({}, {"type": "transient_path"}),
    "gaussian filter": lambda: box({"rfilter": {"type": "gaussian"}}, {"type": "transient_path"}),
    "light tracer": lambda: box({}, {"type": "transient_light_tracer"}),
    "both ends": lambda: box({}, {"type": "transient_bdpt", "max_depth": 4}),
    "gate": lambda: picture("time_gated_transient_path", pulse_width_opl=0.1, target_time=6.0),
    "picture": lambda: picture("path_tracer_mis"),
    "around the corner": lambda: mi.load_dict(tofrender.nlos_z(**SIZE), optimize=False),
}


@pytest.mark.parametrize("name", SCENES)
def test_each_step_has_one_large_kernel(name, monkeypatch):
    monkeypatch.setattr(passes, "FIRST_SAMPLES", 1 << 9)
    monkeypatch.setattr(passes, "STEP_SAMPLES", 1 << 9)
    monkeypatch.setattr(passes, "LANES", {"llvm": 1 << 8, "cuda": 1 << 8})
    scene, steps = SCENES[name](), []
    take_step = passes._step

    def counted(*args, **kwargs):
        dr.kernel_history_clear()
        result = take_step(*args, **kwargs)
        history = dr.kernel_history([dr.KernelType.JIT])
        steps.append([each["operation_count"] for each in history])
        return result

    monkeypatch.setattr(passes, "_step", counted)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.eval(mi.render(scene, spp=64))
    assert len(steps) > 2
    assert [sum(count > LARGE for count in each) for each in steps] == [1] * len(steps), steps


def test_a_step_on_a_gpu_adds_no_more_than_single_precision_can(monkeypatch):
    sampler = passes.best_sampler(1 << 20)
    monkeypatch.setattr(mi, "variant", lambda: "cuda_ad_rgb")
    lanes, most, private = passes._lanes(sampler, 1, 1 << 20)
    assert (lanes, most, private) == (passes.MAX_ADDED, 1, False)
    assert passes._lanes(sampler, 256 * 256, 64) == (16, 4, False)
