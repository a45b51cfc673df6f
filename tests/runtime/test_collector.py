"""Python's garbage collector and kernels: it must wait while one is traced."""

import gc
import threading
import traceback
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import tofrender
from tofrender.runtime import backend

HERE = str(Path(tofrender.__file__).parent)
TRACED = {
    mi.Scene: (
        *("ray_intersect", "ray_intersect_preliminary", "ray_test", "sample_emitter"),
        *("sample_emitter_direction", "pdf_emitter_direction", "eval_emitter_direction"),
    ),
    mi.BSDFPtr: ("eval", "pdf", "eval_pdf", "sample", "flags"),
    mi.EmitterPtr: ("eval", "flags", "sample_direction", "pdf_direction"),
    mi.MediumPtr: ("sample_interaction", "get_scattering_coefficients", "get_majorant"),
    mi.PhaseFunctionPtr: ("sample", "eval_pdf"),
}


@pytest.fixture(autouse=True)
def _collector():
    """Turn the collector on, which the tests otherwise only run between two of them."""
    gc.enable()
    yield
    gc.disable()


@pytest.fixture
def seen(monkeypatch):
    """Calls of a scene's parts, and those of them during which scenes might be collected."""
    calls: list[str] = []
    open_calls: set[str] = set()

    def watch(owner, name):
        real = getattr(owner, name)

        def watched(*args, **kwargs):
            calls.append(name)
            if gc.isenabled():
                stack = [f for f in traceback.extract_stack() if f.filename.startswith(HERE)]
                where = f"{stack[-1].filename[len(HERE) + 1 :]}:{stack[-1].lineno}" if stack else ""
                open_calls.add(f"{owner.__name__}.{name} at {where}")
            return real(*args, **kwargs)

        monkeypatch.setattr(owner, name, watched)

    for owner, names in TRACED.items():
        for name in names:
            watch(owner, name)
    return calls, open_calls


def small(**changes):
    return mi.load_dict(tofrender.cornell_box(width=4, height=4, **changes))


def foggy():
    return tofrender.load_scene("cornell_box_fog", width=4, height=4)


def rendered(scene, integrator):
    kind = {"type": integrator, "max_depth": 4}
    tofrender.render(scene, spp=2, integrator=kind, progress=False, window="auto")


def at(render, when):
    scene, tracer = small(), tofrender.TimeGatedTransientPath()
    render(scene, tracer, scene.sensors()[0], when, spp=2, progress=False)


FILM = {"temporal_bins": 3, "start_opl": 4, "bin_width_opl": 1}


def gated(asked):
    """Render with a pulse that calls `asked` when it is evaluated, while a kernel is traced."""

    class Pulse:
        def eval(self, t):
            asked()
            return tofrender.GaussianPulse(0.1).eval(t)

    scene, tracer = small(), tofrender.TimeGatedTransientPath()
    tracer.pulse = Pulse()
    tofrender.render_at_time(scene, tracer, scene.sensors()[0], 6.0, spp=4)


def as_phasors():
    scene = small()
    camera, tracer = scene.sensors()[0], scene.integrator()
    tofrender.render_amcw_phasor(scene, camera, [20e6], 2, 0, tracer, progress=False)


def derived(reverse):
    scene = small()
    tracer = mi.load_dict({"type": "transient_path", "pulse_width_opl": 0.1, "max_depth": 3})
    params = mi.traverse(scene)
    name = "white.reflectance.value"
    dr.enable_grad(params[name])
    params.update()
    _, transient = mi.render(scene, params, integrator=tracer, spp=2)
    if reverse:
        dr.backward(dr.sum(transient.array))
    else:
        dr.forward(params[name])


def captured(mode):
    data = tofrender.capture("nlos_plane", mode=mode, grid=(2, 2), spp=2, progress=False)
    tofrender.hidden_depth("nlos_plane", data)


def seen_in_truth():
    scene = small()
    tofrender.true_depth(scene)
    tofrender.true_normals(scene)


INTEGRATORS = ("transient_path", "transient_bdpt", "transient_light_tracer", "path_tracer_mis")
WORK = {
    **{name: lambda name=name: rendered(small(), name) for name in INTEGRATORS},
    "fog": lambda: rendered(foggy(), "transient_path"),
    "fog from both ends": lambda: rendered(foggy(), "transient_bdpt"),
    "mi.render": lambda: mi.render(small(), spp=2),
    "gate": lambda: at(tofrender.render_at_time, 6.0),
    "gates": lambda: at(tofrender.render_transient, FILM),
    "phasors": as_phasors,
    "gradient": lambda: derived(reverse=True),
    "rate": lambda: derived(reverse=False),
    **{mode: lambda mode=mode: captured(mode) for mode in ("single", "confocal", "exhaustive")},
    "truth": seen_in_truth,
}


@pytest.mark.parametrize("work", WORK)
@pytest.mark.filterwarnings("ignore:.*arrives outside the window")
def test_nothing_is_collected_while_a_kernel_is_traced(work, seen):
    """A scene that goes in the middle would leave a kernel that LLVM ends the process over."""
    calls, open_calls = seen
    WORK[work]()
    assert calls
    assert not open_calls
    assert gc.isenabled()


def test_who_watches_sees_a_collector_that_does_not_wait(seen):
    calls, open_calls = seen
    scene = small()
    scene.ray_test(mi.Ray3f([0, 0, 3], [0, 0, -1]))
    assert calls == ["ray_test"]
    assert open_calls


def test_pulses_are_asked_while_the_collector_waits():
    collects = []
    gated(lambda: collects.append(gc.isenabled()))
    assert collects
    assert not any(collects)
    assert gc.isenabled()


def test_who_has_turned_the_collector_off_finds_it_off():
    gc.disable()
    try:
        with backend.tracing_lock():
            assert not gc.isenabled()
        assert not gc.isenabled()
    finally:
        gc.enable()
    with pytest.raises(RuntimeError), backend.tracing_lock():
        raise RuntimeError
    assert gc.isenabled()


def test_threads_that_trace_take_turns():
    begun = threading.Event()

    def trace():
        with backend.tracing_lock(), backend.tracing_lock():
            begun.set()

    other = threading.Thread(target=trace)
    with backend.tracing_lock():
        other.start()
        assert not begun.wait(0.1)
    other.join()
    assert begun.is_set()
    assert gc.isenabled()


def test_a_scene_that_is_dropped_lives_to_the_end_of_a_kernel():
    """LLVM would end the process: the other scene's parts are in the first calls only."""
    held = [foggy(), foggy()]
    gated(lambda: held and held.pop())
    assert not held


def test_threads_render_what_one_renders():
    def phasors(seed):
        scene = tofrender.load_scene(tofrender.cornell_box(width=8, height=8))
        return tofrender.render_amcw_phasor(scene, scene.sensors()[0], 2e7, 4, seed)[0]

    alone = [phasors(seed) for seed in range(6)]
    with ThreadPoolExecutor(6) as threads:
        for seed, together in enumerate(threads.map(phasors, 4 * list(range(6)))):
            np.testing.assert_allclose(together, alone[seed % 6], rtol=1e-4, atol=1e-6)


def test_a_scene_that_is_dropped_while_a_kernel_is_traced_stays_until_the_end():
    with backend.tracing_lock():
        living = len(backend._scenes)
    scene = tofrender.load_scene("cornell_box")
    with backend.tracing_lock():
        del scene
        gc.collect()
        assert len(backend._scenes) == living + 1
    with backend.tracing_lock():
        assert len(backend._scenes) == living
