"""Each step of a render follows its paths once: one kernel of their width is large."""

from types import SimpleNamespace

import drjit as dr
import mitsuba as mi
import pytest
from helpers.films_in_parts import replace_launch
from helpers.limits import lower

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
    lower(
        monkeypatch,
        first_samples=1 << 9,
        step_samples=1 << 9,
        lanes={"llvm": 1 << 8, "cuda": 1 << 8},
    )
    scene, steps = SCENES[name](), []

    def counted(launch):
        def count(*args, **kwargs):
            dr.kernel_history_clear()
            result = launch(*args, **kwargs)
            history = dr.kernel_history([dr.KernelType.JIT])
            steps.append([each["operation_count"] for each in history])
            return result

        return count

    replace_launch(monkeypatch, counted)
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


@pytest.mark.parametrize(
    ("lane_sample_s", "taken"),
    [(0.1, [2, 10, 10, 10, 8]), (0.3, [2] * 20), (1.5, [2, 2, *[1] * 36])],
    ids=["quick", "as long as allowed", "slow"],
)
def test_steps_fill_their_time(lane_sample_s, taken, monkeypatch):
    """By a clock that knows what a sample takes; the first step, which compiles, stays as it is."""
    lower(monkeypatch, step_s=1.0, first_samples=2 * 64 * 64, lanes={"llvm": 64 * 64})
    now, steps = [0.0], []

    def timed(launch):
        def step(pixels, pixel, count, *more):
            steps.append(count)
            now[0] += count * lane_sample_s
            return launch(pixels, pixel, count, *more)

        return step

    replace_launch(monkeypatch, timed)
    monkeypatch.setattr(passes, "time", SimpleNamespace(perf_counter=lambda: now[0]))
    dr.eval(mi.render(picture("path_tracer_mis"), spp=40 * 64))
    assert steps == taken
