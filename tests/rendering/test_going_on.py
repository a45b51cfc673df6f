"""Work that is stopped, and goes on from its file: the same result as in one go, or a refusal.

"The same" is to float rounding, 1e-5 of the brightest value, for samplers that can skip what was
drawn. For Mitsuba's it is another part of the random numbers: the same on average, and as noisy.
"""

import os
import signal
import threading
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.films_in_parts import watch_steps
from helpers.limits import lower
from helpers.refusals import refused
from helpers.support import agree, largest

import tofrender
from tofrender import nlos
from tofrender.rendering import job, work_items
from tofrender.rendering.renderer import make_job
from tofrender.rendering.settings import RenderSettings
from tofrender.runtime import checkpoints
from tofrender.runtime.checkpoints import Checkpoint

SIZE, SPP, STEP = 16, 128, 16
"""Pixels on a side, samples per pixel, and those of a step, which the lanes of a step allow."""

NOW = 1e-9  # Seconds between savings that mean: after every step, whatever that takes

ROUNDING = 1e-5

pytestmark = pytest.mark.filterwarnings("ignore:.*of the energy arrives outside")


class Cut(Checkpoint):
    """Stops the work after some of its steps, as Ctrl-C does; counts the steps."""

    def __init__(self, path, after: int = 0, by: int = signal.SIGINT, seconds: float = 1e6) -> None:
        self.told: list[str] = []
        self.times: list[float] = []
        super().__init__(path, seconds, self.told.append)
        self.after, self.by, self.steps, self.savings = after, by, 0, 0

    @property
    def due(self) -> bool:
        self.steps += 1
        self.times.append(time.process_time())
        if self.steps == self.after:
            signal.raise_signal(self.by)
        return self.seconds == NOW or super().due

    def save(self, *arguments) -> None:
        self.savings += 1
        super().save(*arguments)


@pytest.fixture
def path(tmp_path) -> Path:
    return tmp_path / "work.npz"


@pytest.fixture
def small_steps(monkeypatch):
    def use(samples: int = SIZE * SIZE * STEP) -> None:
        lower(monkeypatch, step_samples=samples, first_samples=samples)

    return use


def arrays(result) -> list[np.ndarray]:
    """What results are compared by; phases and depths may wrap."""
    if isinstance(result, tuple):
        return list(result[:3])
    if isinstance(result, np.ndarray):
        return [result]
    return [result[name].values for name in ("transient", "steady") if name in result]


def difference(result, expected) -> float:
    both = zip(arrays(result), arrays(expected), strict=True)
    return max(largest(a, b) for a, b in both)


def stopped(work: Callable, checkpoint: Cut):
    """What a call that is stopped returns, None if it raises."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "interrupted")
        try:
            result = work(checkpoint)
        except KeyboardInterrupt as error:
            message = str(error)
            if not message.startswith("interrupted after ") or "\n" in message:
                raise AssertionError(message) from error
            return None
    return result if getattr(result, "attrs", {}).get("complete", 1) else None


def in_parts(work: Callable, path: Path, after: int = 1):
    """The result of calls that are stopped after some steps each, and how many these were."""
    for count in range(1, 40):
        result = stopped(work, Cut(path, after))
        if result is not None:
            return result, count
        assert os.listdir(path.parent) == [path.name]
    raise AssertionError("it does not end")


def box(integrator: str = "transient_path", film=(), pulse=None, **options) -> dict:
    """The Cornell box, with its lamp in view."""
    scene = tofrender.cornell_box(
        **{"width": SIZE, "height": SIZE, "temporal_bins": 60, "bin_width_opl": 0.2, **options}
    )
    scene["integrator"]["type"] = integrator
    if pulse:
        scene["integrator"]["pulse_width_opl"] = pulse
    scene["sensor"]["film"] |= dict(film)
    return scene


def calling(function: Callable, *arguments, **options) -> Callable:
    """Work: the call, given a checkpoint."""
    options["progress"] = False
    return lambda checkpoint: function(*arguments, checkpoint=checkpoint, **options)


def rendered(scene, spp: int = SPP, **options) -> Callable:
    return calling(tofrender.render, scene, spp=spp, **options)


def loaded(**options):
    scene = mi.load_dict(box(**options), parallel=False)
    return scene, scene.sensors()[0]


def plugin(kind: str, **parameters):
    return mi.load_dict({"type": kind, **parameters}, parallel=False)


HALF = tofrender.GaussianPulse(0.5)


class OwnSample(mi.SamplingIntegrator):
    """A student's, of nothing of the package: one reflection through a Gaussian gate."""

    def __init__(self, pulse=HALF) -> None:
        super().__init__(mi.Properties())
        self.pulse = pulse

    def sample(self, scene, sampler, ray, target_time, medium=None, active=True):
        si = scene.ray_intersect(ray, active)
        ds, weight = scene.sample_emitter_direction(si, sampler.next_2d(), True, si.is_valid())
        value = si.bsdf().eval(mi.BSDFContext(), si, si.to_local(ds.d), si.is_valid())
        there = dr.select(si.is_valid(), si.t + ds.dist, 0)
        return value * weight * self.pulse.eval(target_time - there), si.is_valid(), []


class OwnCorrelation(OwnSample):
    def set_modulation(self, modulation):
        self.modulation = modulation

    def sample(self, scene, sampler, ray, medium=None, active=True):
        return super().sample(scene, sampler, ray, 5.0, medium, active)


class Plain:
    """Any object with a `sample`."""

    sample, pulse = OwnSample.sample, HALF


def gate(integrator=None, at: float = 5.9, spp: int = SPP, seed: int = 0, **options) -> Callable:
    scene, sensor = loaded(**options)
    integrator = integrator or plugin("time_gated_transient_path", pulse_width_opl=0.3)
    return calling(tofrender.render_at_time, scene, integrator, sensor, at, spp, seed)


def gates(spp: int = SPP, width: float = 0.1, integrator=None, **window) -> Callable:
    scene, sensor = loaded()
    window = {"temporal_bins": 30, "start_opl": 3.5, "bin_width_opl": 0.2, **window}
    integrator = integrator or plugin("time_gated_transient_path", pulse_width_opl=width)
    return calling(tofrender.render_transient, scene, integrator, sensor, window, spp)


def phasors(frequency=(20e6, 50e6), spp: int = SPP, **parameters) -> Callable:
    scene, sensor = loaded(integrator="transient_path")
    integrator = plugin("amcw_transient_path", **parameters)
    return calling(tofrender.render_amcw_phasor, scene, sensor, frequency, spp, 0, integrator)


def correlation(pulse=(20e6, 0.0), integrator=None, spp: int = SPP) -> Callable:
    scene, sensor = loaded()
    integrator = integrator or plugin("amcw_transient_path")
    integrator.set_modulation(tofrender.AMCWPulse(*pulse) if isinstance(pulse, tuple) else pulse)
    return calling(tofrender.render_single_amcw, scene, integrator, sensor, spp)


def rates(window=(3.5, 15.0)) -> Callable:
    axes = {"bins": 40, "window": window, "rate_bins": 3, "rates": (-1.0, 1.0)}
    return calling(partial(tofrender.range_rate, **axes, spp=SPP), loaded()[0])


GRIDS = {"confocal": (4, 4), "single": (4, 4), "exhaustive": (2, 2)}


def captured(
    mode: str = "confocal", spp: int = 2048, grid=None, seed: int = 0, change=None
) -> Callable:
    grid = grid or GRIDS[mode]
    scene = tofrender.load_scene("nlos_z", optimize=False, width=grid[0], height=grid[1])
    if change:
        change(scene)
    return calling(nlos.capture, scene, mode=mode, spp=spp, seed=seed)


class Nameless:
    """A student's pulse, that prints its address only, which another process does not have."""

    def __init__(self, width) -> None:
        self._width = width

    def eval(self, t):
        return dr.exp(-dr.square(t / self._width))


def nameless(width: float = 0.5) -> Callable:
    """Each call has a pulse of its own."""
    return lambda checkpoint: gate(OwnSample(Nameless(width)))(checkpoint)


CROP = {"crop_width": 9, "crop_height": 11, "crop_offset_x": 4, "crop_offset_y": 0}
GAUSSIAN = {"rfilter": {"type": "gaussian"}}

WORKS = {
    "transient_path": lambda: rendered(box()),
    "transient_bdpt": lambda: rendered(box("transient_bdpt", max_depth=4)),
    "transient_light_tracer": lambda: rendered(box("transient_light_tracer")),
    "gaussian": lambda: rendered(box(film=GAUSSIAN)),
    "gaussian_splats": lambda: rendered(box("transient_light_tracer", GAUSSIAN, max_depth=3)),
    "crop": lambda: rendered(box(film=CROP)),
    "sample_border": lambda: rendered(box(film=CROP | GAUSSIAN | {"sample_border": True})),
    "window_auto": lambda: rendered(box(), window="auto"),
    "pulse": lambda: rendered(box(pulse=0.3)),
    "another_seed": lambda: rendered(box(), seed=7),
    "odd_number": lambda: rendered(box(), spp=117),
    "gate": gate,
    "gate_gaussian": lambda: gate(film=GAUSSIAN),
    "gates": gates,
    "phasors": phasors,
    "one_phasor": lambda: phasors(20e6),
    "correlation": correlation,
    "own_sample": lambda: gate(OwnSample()),
    "plain_object": lambda: gate(Plain()),
    "own_correlation": lambda: correlation(integrator=OwnCorrelation()),
    "nameless_pulse": nameless,
}


def in_variant(name: str, make: Callable) -> Callable:
    mi.set_variant(name)
    return make()


@pytest.mark.essential
@pytest.mark.parametrize(
    ("make", "after", "options"),
    [
        *[pytest.param(make, 1 if n == "crop" else 3, {}, id=n) for n, make in WORKS.items()],
        *[pytest.param(WORKS["transient_path"], n, {"least": 2}, id=f"after {n}") for n in (1, 7)],
        *[
            pytest.param(partial(in_variant, name, WORKS[work]), 3, {}, id=f"{work}, {name}")
            for name in ("llvm_ad_mono", "llvm_ad_spectral")
            for work in ("transient_path", "phasors")
        ],
        *[
            pytest.param(
                partial(captured, mode),
                *(after, {"samples": int(np.prod(grid)) * 256}),
                id=f"{mode}, after {after}",
            )
            for mode, grid in GRIDS.items()
            for after in (1, 3)
        ],
    ],
)
def test_parts_are_the_whole(path, small_steps, make, after, options):
    work, least = make(), options.get("least", 3)
    whole = work(None)
    assert any(np.any(each) for each in arrays(whole))
    small_steps(options.get("samples", SIZE * SIZE * STEP))
    result, count = in_parts(work, path, after)
    assert count >= least
    assert difference(result, whole) < ROUNDING


@pytest.mark.parametrize("after", [1, 3])
@pytest.mark.parametrize("name", ["transient_path", "transient_bdpt", "gates"])
def test_more_samples_than_float32_adds(path, small_steps, monkeypatch, name, after):
    """They are added in portions of at most 2^16, here of 32."""
    whole = WORKS[name]()(None)
    lower(monkeypatch, max_added=2 * STEP)
    small_steps()
    result, count = in_parts(WORKS[name](), path, after)
    assert count > 1
    assert difference(result, whole) < ROUNDING


@pytest.mark.parametrize("technique", ["transient_path", "transient_light_tracer"])
def test_more_samples_the_second_time(path, small_steps, technique):
    whole = rendered(box(technique), spp=2 * SPP)(None)
    small_steps()
    assert stopped(rendered(box(technique)), Cut(path, 3)) is None
    assert stopped(rendered(box(technique)), Cut(path, seconds=NOW)) is not None
    for spp, done, steps in ((2 * SPP, SPP, SPP // STEP), (2 * SPP, 2 * SPP, 0)):
        last = Cut(path, seconds=NOW)
        assert difference(rendered(box(technique), spp=spp)(last), whole) < ROUNDING
        assert last.told == [f"resuming from {done} of {spp} samples per pixel"]
        assert last.steps == steps


def test_on_top_of_an_earlier_render(path, small_steps):
    whole = rendered(box(), spp=3 * SPP)(None)
    small_steps()
    earlier = rendered(box())(None)
    work = rendered(box(), spp=3 * SPP, resume=earlier)
    assert stopped(work, Cut(path, 3)) is None
    last = Cut(path)
    result = work(last)
    assert last.told == [f"resuming from {SPP + 3 * STEP} of {3 * SPP} samples per pixel"]
    assert difference(result, whole) < ROUNDING
    assert result.attrs["spp"] == 3 * SPP


@pytest.mark.filterwarnings("ignore:interrupted")
@pytest.mark.parametrize("done", [STEP, 2 * SPP])
def test_parts_weigh_by_their_samples(done):
    """Also where a resumed render was stopped again."""
    decided = make_job(RenderSettings(box(), spp=3 * SPP), axis=(4, 0.0, 3.0))
    shape = decided.film.shape

    def taken(light: float, count: int) -> job.WorkResult:
        steady, transient = (np.ones(s, np.float32) for s in ((*shape[:2], shape[3]), shape))
        arrays = {"steady": 4 * light * steady, "transient": light * transient}
        return job.WorkResult(arrays, count)

    earlier = job.dataset_of(decided, taken(1.0, SPP))
    result = job.dataset_of(decided, taken(5.0, done), earlier)
    mean = (SPP + 5 * done) / (SPP + done)
    assert result.attrs["spp"] == SPP + done
    assert result.attrs["complete"] == (done == 2 * SPP)
    np.testing.assert_allclose(result["transient"], mean, rtol=1e-6)
    np.testing.assert_allclose(result["steady"], 4 * mean, rtol=1e-6)


def test_a_partial_result_is_gone_on_with(path, small_steps):
    whole = rendered(box())(None)
    small_steps()
    with pytest.warns(UserWarning, match="interrupted"):
        part = rendered(box())(Cut(path, 3))
    assert part.attrs["complete"] == 0
    result = rendered(box(), resume=part)(None)
    assert difference(result, whole) < ROUNDING


@pytest.mark.statistical
@pytest.mark.parametrize("sampler", ["independent", "multijitter"])
def test_other_samplers(tmp_path, small_steps, sampler):
    """Means over 12 seeds agree bin by bin (alpha as in `support`), and no part is there twice."""

    def sums(seed: int, after: int) -> np.ndarray:
        scene = box(width=8, height=8, temporal_bins=16, bin_width_opl=0.75)
        work = rendered(scene, 256, sampler=sampler, seed=seed)
        result, count = in_parts(work, tmp_path / f"{seed}-{after}.npz", after)
        assert count == (4 if after else 1)
        for each in tmp_path.iterdir():
            each.unlink()
        return result["transient"].values.astype(float).sum(axis=(0, 1)).ravel()

    small_steps(64 * 64)
    whole = np.stack([sums(seed, 0) for seed in range(12)])
    parts = np.stack([sums(seed, 1) for seed in range(100, 112)])
    lit = whole.min(axis=0) > 0
    assert lit.sum() > 20
    assert agree(parts[:, lit], whole[:, lit])
    assert not agree(1.1 * parts[:, lit], whole[:, lit])


def test_parts_of_other_samplers_differ(path, small_steps):
    small_steps()
    work = rendered(box(), sampler="independent")
    with pytest.warns(UserWarning, match="interrupted"):
        half = work(Cut(path, SPP // STEP // 2))
    assert half.attrs["spp"] == SPP // 2
    whole = work(path)
    rest = 2 * whole["transient"].values - half["transient"].values
    assert np.abs(rest - half["transient"].values).max() > 0.01 * half["transient"].values.max()


ENDINGS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]


@pytest.mark.parametrize("by", ENDINGS)
def test_a_stopped_render_is_a_render_of_fewer_samples(path, small_steps, by):
    expected = rendered(box(), spp=2 * STEP)(None)
    small_steps()
    before = signal.getsignal(by)
    with pytest.warns(UserWarning, match=rf"interrupted: .* {2 * STEP} of {SPP} samples per pixel"):
        part = rendered(box())(Cut(path, 2, by))
    assert signal.getsignal(by) is before
    assert (part.attrs["complete"], part.attrs["spp"]) == (0, 2 * STEP)
    assert difference(part, expected) < ROUNDING


@pytest.mark.parametrize("mode", ["single", "confocal"])
def test_a_stopped_capture(path, small_steps, mode):
    small_steps(16 * 256)
    with pytest.warns(UserWarning, match=r"interrupted: .* 512 of 2048 samples per pixel"):
        part = captured(mode)(Cut(path, 2))
    assert (part.attrs["complete"], part.attrs["spp"]) == (0, 512)
    small_steps()
    assert difference(part, captured(mode, 512)(None)) < ROUNDING


@pytest.mark.parametrize("by", ENDINGS)
@pytest.mark.parametrize("name", ["gate", "gates", "phasors", "correlation", "own_sample"])
def test_arrays_are_whole_or_an_error(path, small_steps, name, by):
    small_steps()
    said = rf"^interrupted after {2 * STEP} of {SPP} samples per pixel.*{path}"
    with refused(said, KeyboardInterrupt):
        WORKS[name]()(Cut(path, 2, by))


def test_without_a_file_it_says_so_too(small_steps):
    class Interrupting(OwnSample):
        def sample(self, *arguments):
            signal.raise_signal(signal.SIGINT)
            return super().sample(*arguments)

    small_steps()
    with refused(f"^interrupted after {STEP} of {SPP} samples per pixel$", KeyboardInterrupt):
        gate(Interrupting())(None)


def test_ctrl_c_in_the_last_step_of_a_laser_point(path, small_steps):
    small_steps(4 * 2048)
    for number in (1, 2, 3):
        with refused(r"^interrupted after \d+ of 4 ", KeyboardInterrupt):
            captured("exhaustive")(Cut(path, 1))
        assert np.load(path)["values"].any(axis=(2, 3, 4, 5)).sum() == number - 1
    result = captured("exhaustive")(Cut(path, 1))  # The last of all
    assert difference(result, captured("exhaustive")(None)) < ROUNDING


def test_a_second_ctrl_c_ends_at_once(path, small_steps):
    small_steps()
    assert stopped(rendered(box()), Cut(path, 2)) is None

    class Twice(Cut):
        @property
        def due(self):
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGINT)
            return False

    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt) as error:
        rendered(box())(Twice(path))
    assert str(error.value) == ""
    assert signal.getsignal(signal.SIGINT) is before
    last = Cut(path)
    rendered(box())(last)
    assert last.told == [f"resuming from {2 * STEP} of {SPP} samples per pixel"]


@pytest.mark.parametrize("by", ENDINGS)
def test_ignored_signals_stay_ignored(path, small_steps, by):
    small_steps()
    before = signal.signal(by, signal.SIG_IGN)
    try:
        assert rendered(box())(Cut(path, 2, by)).attrs["complete"] == 1
        assert signal.getsignal(by) is signal.SIG_IGN
    finally:
        signal.signal(by, before)


def test_in_another_thread(path, small_steps):
    small_steps()
    found = []
    thread = threading.Thread(target=lambda: found.append(rendered(box())(Cut(path))))
    thread.start()
    thread.join()
    assert found[0].attrs["complete"] == 1


class Slow(OwnSample):
    def sample(self, *arguments):
        values = [super(Slow, self).sample(*arguments)[0] for _ in range(16)]
        return sum(values), True, []


@pytest.mark.parametrize("integrator", [None, Slow()], ids=["many", "slow"])
def test_steps_take_about_a_second(path, integrator, monkeypatch):
    """A stop takes that long; also where a sample takes long. Of the processor, on two cores."""
    lower(monkeypatch, step_s=1.0)
    checkpoint = Cut(path, after=3)
    with pytest.raises(KeyboardInterrupt):
        gate(integrator, spp=1 << 20, width=256, height=256)(checkpoint)
    assert np.diff(checkpoint.times).max() < 10


single = partial(captured, mode="single", grid=(2, 2))
exhaustive = partial(captured, mode="exhaustive", grid=(2, 2))


def boxed(seed: int = 0, window=None, sampler=None, **scene) -> Callable:
    return rendered(box(**scene), seed=seed, window=window, sampler=sampler)


def boxed_in(variant: str = "llvm_ad_rgb") -> Callable:
    return in_variant(variant, boxed)


def gate_of(**attributes) -> Callable:
    integrator = plugin("time_gated_transient_path", pulse_width_opl=0.3)
    for name, value in attributes.items():
        setattr(integrator, name, value)
    return gate(integrator)


def own_gate(pulse=HALF) -> Callable:
    return gate(OwnSample(pulse))


BORDER = CROP | GAUSSIAN | {"sample_border": True}
REFUSED = [
    (boxed, {"seed": 1}, "seed"),
    (boxed, {"light": "flash", "start_opl": 3.5}, "fingerprint"),
    *[(boxed, change, "") for change in ({"max_depth": 4}, {"integrator": "transient_bdpt"})],
    *[(boxed, {"film": film}, "film") for film in (CROP, GAUSSIAN, BORDER)],
    *[(boxed, change, "film") for change in ({"width": 12}, {"temporal_bins": 50})],
    (boxed, {"window": (3.5, 20.0)}, "bin_width_opl"),
    (boxed, {"pulse": 0.1}, "pulse"),
    (boxed, {"sampler": "independent"}, "sampler"),
    (boxed_in, {"variant": "llvm_ad_mono"}, "variant = 'llvm_ad_rgb' instead"),
    *[(gate, change, "") for change in ({"at": 6.0}, {"seed": 1}, {"light": "flash"})],
    (gate, {"film": GAUSSIAN}, ""),
    (gate_of, {"pulse": tofrender.GaussianPulse(0.1)}, ""),
    *[(gate_of, change, "") for change in ({"max_depth": 3}, {"rr_depth": 2})],
    (gate_of, {"hide_emitters": True}, ""),
    (own_gate, {"pulse": tofrender.GaussianPulse(0.1)}, ""),
    (nameless, {"width": 0.6}, "fingerprint"),
    *[(gates, change, "") for change in ({"temporal_bins": 29}, {"start_opl": 3.6})],
    *[(gates, change, "") for change in ({"bin_width_opl": 0.21}, {"width": 0.2})],
    *[(phasors, {"frequency": frequency}, "") for frequency in ((20e6, 60e6), 20e6)],
    (phasors, {"max_depth": 3}, ""),
    *[(correlation, {"pulse": pulse}, "") for pulse in ((30e6, 0.0), (20e6, 1.0))],
    (correlation, {"pulse": tofrender.SquareWave(20e6)}, ""),
    (rates, {"window": (4.0, 15.0)}, "window"),
    *[(captured, change, "") for change in ({"mode": "single"}, {"seed": 5})],
    (single, {"mode": "confocal"}, ""),
    (single, {"change": lambda scene: nlos.focus_laser(scene, uv=(0.3, 0.6))}, ""),
    (single, {"grid": (3, 4)}, ""),
    *[(exhaustive, change, "") for change in ({"mode": "single"}, {"seed": 5}, {"spp": 1024})],
]
"""Work, what another of its kind has instead, and what is said of it."""


@pytest.mark.parametrize(("make", "change", "text"), REFUSED)
def test_other_work_of_a_kind_is_refused(path, small_steps, make, change, text):
    small_steps()
    assert stopped(make(), Cut(path, 1)) is None
    before = path.read_bytes()
    with refused(f"checkpoint = .* was made with .*{text}"):
        make(**change)(path)
    assert path.read_bytes() == before


KINDS = (boxed, gate, gates, phasors, correlation)


@pytest.mark.parametrize("first", KINDS)
def test_another_kind_of_work_is_refused(path, small_steps, first):
    small_steps()
    assert stopped(first(), Cut(path, 1)) is None
    for other in set(KINDS) - {first}:
        with refused(r"checkpoint = .* was made with "):
            other()(path)


def test_another_earlier_render_is_refused(path, small_steps):
    small_steps()
    earlier, other = (rendered(box(), spp=spp)(None) for spp in (32, 64))
    assert stopped(rendered(box(), resume=earlier), Cut(path, 1)) is None
    for resume in (None, other):
        with refused("was made with resume = 32"):
            rendered(box(), resume=resume)(path)


@pytest.mark.parametrize("make", [boxed, gate])
@pytest.mark.parametrize("cut", [False, True])
def test_a_damaged_file_is_told_at_the_callers_line_and_never_used(path, small_steps, make, cut):
    whole = make()(None)
    small_steps()
    assert stopped(make(), Cut(path, 4)) is None
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 4
    path.write_bytes(b"" if cut else content)
    with pytest.warns(UserWarning, match="damaged, starting anew") as caught:
        result = make()(path)
    assert [each.filename for each in caught] == [__file__]
    assert difference(result, whole) < ROUNDING


def test_it_is_saved_as_often_as_asked(path, small_steps):
    small_steps()
    for seconds, savings in ((1e6, 0), (NOW, SPP // STEP)):
        path.unlink(missing_ok=True)
        checkpoint = Cut(path, seconds=seconds)
        rendered(box())(checkpoint)
        assert checkpoint.savings == savings
        assert path.exists() == (savings > 0)  # It is there for whoever writes the result


def test_seconds_add_up(path, small_steps, monkeypatch):
    """By a clock that goes on by a second with each step."""
    now = [0.0]
    clock = SimpleNamespace(monotonic=lambda: now[0], perf_counter=lambda: now[0])
    for module in (checkpoints, work_items):
        monkeypatch.setattr(module, "time", clock)
    watch_steps(monkeypatch, lambda _: now.append(now.pop() + 1))
    small_steps()
    with pytest.warns(UserWarning, match="interrupted"):
        rendered(box())(Cut(path, 6))
    now[0] += 3600  # Which is not counted
    assert rendered(box())(path).attrs["render_seconds"] == SPP // STEP


@pytest.mark.parametrize("name", ["a.npz", Path("b.npz")])
def test_a_file_name_will_do(monkeypatch, tmp_path, small_steps, name, capsys):
    monkeypatch.chdir(tmp_path)
    small_steps()
    with monkeypatch.context() as patch:
        patch.setattr(Checkpoint, "due", True)
        rendered(box(), spp=STEP)(name)
    rendered(box(), spp=2 * STEP)(name)
    assert os.listdir() == [str(name)]
    assert capsys.readouterr().out == f"resuming from {STEP} of {2 * STEP} samples per pixel\n"
