"""`render`: the Dataset, samplers and seeds, windows, steps, Ctrl-C, and every bad input."""

import json
import re
import signal

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.films_in_parts import watch_steps
from helpers.limits import lower
from helpers.parts import area_light, gray, plane, point_light, translate
from helpers.refusals import refused
from helpers.support import camera, film, scene, with_film, with_integrator, with_sampler

import tofrender
from tofrender.integrators import passes as base
from tofrender.runtime.settings import SAMPLERS

ALL_TIME = {"start_opl": 3.5, "temporal_bins": 120, "bin_width_opl": 0.25}
"""A window that holds all light of the Cornell box."""


def box(size: int = 8, **more) -> dict:
    return tofrender.cornell_box(**({"width": size, "height": size, "spp": 4} | ALL_TIME | more))


def render(what, **options):
    return tofrender.render(what, **({"spp": 4, "progress": False} | options))


def outside(dataset) -> float:
    return dataset.attrs["energy_outside_window"]


SUN = {"type": "directional", "direction": [0.2, -0.3, -0.9]}
CHANGES = {
    "plain": lambda described: described,
    "pulse": lambda described: with_integrator(described, pulse_width_opl=0.2),
    "sky": lambda described: described | {"sky": {"type": "constant", "radiance": gray(0.5)}},
    "sun": lambda described: described | {"light": SUN | {"irradiance": gray(3)}},
}


def two_walls(near: float = 2.0, apart: float = 2.0, **window) -> dict:
    """Two glowing walls, each in half of the picture: light arrives at exactly two lengths."""
    left = mi.ScalarTransform4f().translate([-1, 0, 0])
    walls = {
        "near": plane(left, size=1.0, emitter=area_light(1.0)),
        "far": plane(translate(0, 0, -apart), emitter=area_light(1.0)),
    }
    sensor = camera((0, 0, near), (0, 0, 0), film(4, 4, **window), kind="orthographic")
    return scene(walls, sensor, max_depth=1)


@pytest.mark.parametrize(
    ("variant", "channels"), [("llvm_ad_rgb", [*"RGB"]), ("llvm_ad_mono", ["L"])]
)
def test_dataset_is_labeled(variant, channels):
    mi.set_variant(variant)
    described = with_film(
        box(16), width=12, crop_width=5, crop_height=3, crop_offset_x=4, crop_offset_y=7
    )
    dataset = render(described)
    assert dataset.transient.dims == ("y", "x", "opl", "channel")
    assert dataset.steady.dims == ("y", "x", "channel")
    assert dataset.transient.dtype == dataset.steady.dtype == np.float32
    assert dataset.x.values.tolist() == [4, 5, 6, 7, 8]
    assert dataset.y.values.tolist() == [7, 8, 9]
    assert dataset.channel.values.tolist() == channels
    assert [dataset[axis].dtype.kind for axis in ("x", "y", "opl")] == ["i", "i", "f"]
    np.testing.assert_allclose(dataset.opl, 3.5 + 0.25 * (np.arange(120) + 0.5), rtol=1e-12)
    assert (dataset.attrs["variant"], dataset.attrs["pulse"]) == (variant, "none")
    assert (dataset.attrs["film_width"], dataset.attrs["film_height"]) == (12, 16)
    assert np.isfinite(dataset.transient).all()
    assert float(dataset.steady.min()) > 0


def test_attributes_say_how_it_was_made():
    described = with_integrator(box(), pulse_width_opl=0.03, max_depth=5)
    dataset = render(described, spp=np.int64(8), seed=3)
    attrs = dataset.attrs
    assert {type(value) for value in attrs.values()} <= {str, int, float}
    expected = {
        **{"quantity": "radiance per bin", "units": "W m^-2 sr^-1", "variant": "llvm_ad_rgb"},
        **{"start_opl": 3.5, "bin_width_opl": 0.25, "pulse": "GaussianPulse(width_opl=0.03)"},
        **{"scene": "scene", "integrator": "TransientPath", "sampler": "PaddedSobolSampler"},
        **{"max_depth": 5, "spp": 8, "seed": 3, "complete": 1},
    }
    assert {name: attrs[name] for name in expected} == expected
    modules = {"tofrender": tofrender, "mitsuba": mi, "drjit": dr}
    assert json.loads(attrs["versions"]) == {name: m.__version__ for name, m in modules.items()}
    assert 0 < attrs["render_seconds"] < 100
    json.dumps(attrs)


def test_a_loaded_scene_is_left_as_it_was():
    loaded = mi.load_dict(box(temporal_bins=300))
    render(loaded, spp=16, window=(3.0, 30.0), bins=7, sampler="independent")
    sensor = loaded.sensors()[0]
    assert sensor.film().temporal_bins == 300
    assert sensor.film().start_opl == 3.5
    assert sensor.sampler().sample_count() == 4


@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "llvm_ad_mono"])
def test_equals_mitsuba_render(variant, rfilter):
    mi.set_variant(variant)
    described = with_integrator(box(), temporal_filter="box")
    loaded = mi.load_dict(with_film(described, rfilter={"type": rfilter}))
    steady, transient = mi.render(loaded, spp=16, seed=5)
    dataset = render(loaded, spp=16, seed=5)
    scale = float(dataset.transient.max())
    np.testing.assert_allclose(dataset.transient, np.array(transient), atol=1e-5 * scale)
    np.testing.assert_allclose(dataset.steady, np.array(steady), rtol=1e-4)


def test_default_sampler_overrides_the_scene():
    described = with_sampler(box())
    default, sobol = render(described), render(described, sampler="padded_sobol")
    assert default.attrs["sampler"] == "PaddedSobolSampler"
    np.testing.assert_allclose(default.transient, sobol.transient, atol=1e-5)
    assert not np.allclose(default.steady, render(described, sampler="independent").steady)


@pytest.mark.parametrize("name", SAMPLERS)
def test_sampler_by_name(name):
    dataset = render(box(), spp=64, sampler=name)
    words = {"ldsampler": "lowdiscrepancy", "padded_sobol": "paddedsobol"}
    assert dataset.attrs["sampler"].lower() == words.get(name, name) + "sampler"
    assert dataset.attrs["complete"] == 1
    assert dataset.attrs["spp"] >= 64
    assert float(dataset.steady.mean()) == pytest.approx(0.147, rel=0.3)


@pytest.mark.parametrize("name", ["independent", "padded_sobol", "multijitter"])
def test_sampler_as_an_object(name):
    sampler = mi.load_dict({"type": name, "sample_count": 9})
    by_object, by_name = (render(box(), spp=16, sampler=which) for which in (sampler, name))
    assert by_object.attrs["sampler"] == by_name.attrs["sampler"]
    np.testing.assert_allclose(by_object.transient, by_name.transient, atol=1e-5)
    assert sampler.sample_count() == 9


@pytest.mark.parametrize(("given", "used"), [(None, 12), (8, 8), (np.int32(3), 3), (1, 1), (7, 7)])
def test_spp(given, used):
    dataset = tofrender.render(box(spp=12), spp=given, progress=False)
    assert dataset.attrs["spp"] == used
    assert 0.03 < float(dataset.steady.mean()) < 0.3  # 0.147 and noise
    assert float(dataset.transient.sum() / dataset.steady.sum()) == pytest.approx(1, abs=1e-4)


def test_prime_spp_is_as_bright(monkeypatch):
    expected = float(render(box(), spp=256).steady.mean())
    for step_samples in (base.STEP_SAMPLES, 64 * 10):
        lower(monkeypatch, step_samples=step_samples)
        dataset = render(box(), spp=251)
        assert dataset.attrs["spp"] == 251
        assert float(dataset.steady.mean()) == pytest.approx(expected, rel=0.02)
        assert float(dataset.transient.sum() / dataset.steady.sum()) == pytest.approx(1, abs=1e-4)


@pytest.mark.parametrize("sampler", [None, "independent", "multijitter"])
def test_a_seed_repeats_and_another_does_not(sampler):
    largest = (1 << 32) - 1
    one, again, other, zero = (
        render(box(), seed=seed, sampler=sampler) for seed in (5, 5, largest, 0)
    )
    np.testing.assert_allclose(one.transient, again.transient, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(one.steady, again.steady, rtol=1e-5)
    assert other.attrs["seed"] == largest
    for left, right in ((one, other), (other, zero)):
        assert not np.allclose(left.steady, right.steady, rtol=0.01)


@pytest.mark.parametrize("sampler", ["padded_sobol", "independent"])
def test_many_steps_are_one(monkeypatch, sampler):
    numbers: list[int] = []
    watch_steps(monkeypatch, numbers.append)
    whole = render(box(), spp=512, sampler=sampler)
    lower(monkeypatch, step_samples=64 * 64)
    parts = render(box(), spp=512, sampler=sampler)
    assert numbers == [0, *range(8)]
    assert parts.attrs["spp"] == whole.attrs["spp"] == 512
    np.testing.assert_allclose(parts.steady, whole.steady, rtol=1e-5)
    np.testing.assert_allclose(parts.transient, whole.transient, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("sampler", ["multijitter", "stratified"])
def test_samplers_that_cannot_loop_keep_their_strata(monkeypatch, sampler):
    """In one kernel or in many, every stratum of the pixel is sampled once."""
    described = two_walls(bins=60)  # Half of the picture is nearer: no pixel is mixed
    # Now the middle column sees both walls, in equal parts
    described = with_film(described, width=5, height=4)
    for step_samples in (base.STEP_SAMPLES, 20 * 4):
        lower(monkeypatch, step_samples=step_samples)
        dataset = render(described, spp=64, sampler=sampler, seed=2)
        near = dataset.transient.sel(opl=slice(0, 3)).sum("opl").isel(x=2, channel=0)
        np.testing.assert_allclose(near, 0.5, atol=0.51 / 8)  # 8 strata wide, one is cut


@pytest.mark.usefixtures("mitsubas_steps")
def test_long_renders_are_folded(monkeypatch):
    """Sums in single precision are put aside in time; the result is the same."""
    whole = render(box(), spp=512)
    folds = []
    fold = tofrender.TransientHDRFilm.flush
    monkeypatch.setattr(
        tofrender.TransientHDRFilm, "flush", lambda self, *_: folds.append(1) or fold(self)
    )
    lower(monkeypatch, step_samples=64 * 64, max_added=128)
    parts = render(box(), spp=512)
    assert len(folds) == 3  # After 128, 256 and 384 samples; the end needs none
    np.testing.assert_allclose(parts.transient, whole.transient, rtol=1e-4, atol=1e-6)


def test_window_by_numbers():
    dataset = render(box(), window=(3.0, 33.0))
    assert dataset.sizes["opl"] == 120
    assert dataset.attrs["start_opl"] == 3.0
    assert dataset.attrs["bin_width_opl"] == pytest.approx(0.25)
    more = render(box(), bins=200)
    assert more.sizes["opl"] == 200
    assert (more.attrs["start_opl"], more.attrs["bin_width_opl"]) == (3.5, 0.25)
    coarse = render(box(), window=(3.0, 33.0), bins=10)
    assert coarse.sizes["opl"] == 10
    assert coarse.attrs["bin_width_opl"] == pytest.approx(3.0)
    few, many = (each.transient.sum(("y", "x", "channel")).values for each in (coarse, dataset))
    np.testing.assert_allclose(few, many.reshape(10, 12).sum(1), rtol=1e-4, atol=1e-4)


@pytest.mark.statistical
@pytest.mark.parametrize("change", CHANGES)
def test_auto_window_holds_99_9_percent(change):
    """Within the accuracy of 16384 test paths: a quarter of the 0.1 % left out, at one sigma."""
    dataset = render(CHANGES[change](box(16)), spp=256, window="auto", bins=300)
    assert outside(dataset) < 0.002
    assert change == "pulse" or outside(dataset) > 0.0003  # No wider than it need be
    energy = dataset.transient.sum(("y", "x", "channel")).values
    assert energy[:10].sum() > 0  # It starts where the light does
    assert dataset.sizes["opl"] == 300


@pytest.mark.statistical
@pytest.mark.parametrize("distance", [1e4, 3e5, 1e9])
def test_windows_far_away(distance):
    """A far wall that a lamp lights: `auto` finds it, and the window that holds it is right."""
    wall = plane(translate(0, 0, -distance), size=distance)
    lamp = point_light((0, 0, 0), distance**2)
    eye = camera((0, 0, 0), (0, 0, -1), film(4, 4), fov=2, far_clip=9 * distance)
    described = scene({"wall": wall, "lamp": lamp}, eye, max_depth=2)
    for window in ("auto", (1.9 * distance, 2.1 * distance)):
        dataset = render(described, window=window, bins=50)
        assert outside(dataset) < 1e-3
        assert float(dataset.transient.sum()) > 0
        assert 1.9 * distance < dataset.opl[0] < 2.1 * distance


@pytest.mark.usefixtures("no_work")
def test_bins_that_lengths_are_too_coarse_for(monkeypatch):
    """Half of the millimeters after 10 km are no lengths in single precision."""
    far = with_film(box(), start_opl=9999.0, bin_width_opl=0.001, temporal_bins=1000)
    gate = mi.load_dict({"type": "time_gated_transient_path", "pulse_width_opl": 0.001})
    loaded = mi.load_dict(box())
    for name, work in (
        ("bin", lambda: render(far)),
        ("bin", lambda: render(box(), window=(9999.0, 10000.0), bins=1000)),
        ("bin", lambda: tofrender.TransientPath(mi.Properties()).render(mi.load_dict(far))),
        ("pulse", lambda: tofrender.render_at_time(loaded, gate, loaded.sensors()[0], 10000.0)),
    ):
        with refused(rf"^{name}_width_opl = 0\.001: must be at least 0\.00789 m, as lengths"):
            work()


def test_auto_window_of_a_pulse_starts_before_the_light():
    plain, pulsed = (render(CHANGES[change](box()), window="auto") for change in ("plain", "pulse"))
    first, second = plain.attrs["start_opl"], pulsed.attrs["start_opl"]
    support = tofrender.GaussianPulse(0.2).support[0]
    assert second == pytest.approx(first + support, rel=0.01)


def test_half_of_the_light_is_outside():
    with pytest.warns(UserWarning, match=r"50\.0 % of the energy"):
        dataset = render(two_walls(start=3.5, bins=10))
    assert outside(dataset) == pytest.approx(0.5, abs=1e-6)


@pytest.mark.statistical
@pytest.mark.parametrize("change", ["plain", "pulse", "sky"])
def test_lost_energy_is_said_with_the_window_that_would_hold_it(change):
    with pytest.warns(UserWarning, match="would hold") as record:
        dataset = render(CHANGES[change](box(16)), spp=64, window=(3.5, 8.0))
    assert len(record) == 1
    assert record[0].filename == __file__
    lost = 1 - dataset.transient.values.sum(dtype=float) / dataset.steady.values.sum(dtype=float)
    assert outside(dataset) == pytest.approx(lost, abs=1e-6 if change == "plain" else 1e-3)
    text = str(record[0].message)
    assert "\n" not in text
    assert f"{100 * outside(dataset):.1f} %" in text
    assert "window 3.5 to 8 m" in text
    start, stop = map(float, re.search(r"([\d.]+) to ([\d.]+) m would hold", text).groups())
    again = render(CHANGES[change](box(16)), spp=256, window=(start, stop))
    assert outside(again) < 0.002


def test_no_warning_where_little_is_lost():
    dataset = render(box(), window=(3.5, 14.5))  # Warnings are errors here
    assert 0 < outside(dataset) < 0.01


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize(
    ("described", "window"),
    [
        *[(two_walls(), window) for window in ((0, 1), (2.5, 3.5), (5, 100), (-5, -1))],
        (box(start_opl=0.0, temporal_bins=100, bin_width_opl=0.02), None),
    ],
)
def test_window_without_light_is_refused(described, window):
    """Before the light, between two arrivals (at 2 m and 4 m), after it, and before time 0."""
    start, stop = window or (0, 2)
    with refused(f"window = {start:g} m to {stop:g} m: no light arrives in it; must overlap"):
        render(described, window=window)


def test_a_pulse_reaches_into_a_window_before_the_light():
    described = two_walls()
    described["integrator"] = described["integrator"] | {"pulse_width_opl": 0.2}
    with pytest.warns(UserWarning, match="outside"):
        dataset = render(described, window=(1.0, 1.9))
    assert float(dataset.transient.sum()) > 0


def test_a_dark_scene_is_said():
    described = box() | {"light": point_light((0, 5, 0), 1.0)}  # Above the ceiling
    with pytest.warns(UserWarning, match="no light found on 16384 test paths"):
        dataset = render(described)
    assert float(dataset.steady.sum()) == 0
    assert outside(dataset) == 0
    with pytest.raises(ValueError, match="window = 'auto': no light found"):
        render(described, window="auto")


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"bin_width": 0.5, "bins": 3}, r"bins = 3: .* `start_opl`"),
        ({"start_opl": 3.5}, r"start_opl = 3.5: .* `bins` and `bin_width`"),
    ],
)
def test_a_steady_film_lacks_bins(options, message):
    steady = tofrender.cornell_box_steady_state(width=8, height=8)
    with pytest.raises(ValueError, match=message):
        render(steady, integrator="transient_path", **options)


def test_several_sensors():
    described = box()
    window = {"start_opl": 3.0, "temporal_bins": 60, "bin_width_opl": 0.5}
    described["second"] = with_film(described, width=6, height=4, **window)["sensor"]
    shapes = [render(described, sensor=k).transient.shape for k in (0, np.int64(1))]
    assert shapes == [(8, 8, 120, 3), (4, 6, 60, 3)]


def test_integrator_by_name_dict_and_object():
    by_name = render(box(), integrator="transient_path")
    assert by_name.attrs["max_depth"] == 8  # The scene's, not the plugin's default
    description = {"type": "transient_path", "max_depth": 3}
    by_dict = render(box(), integrator=description)
    by_object = render(box(), integrator=mi.load_dict(description))
    assert by_dict.attrs["max_depth"] == by_object.attrs["max_depth"] == 3
    np.testing.assert_allclose(by_dict.transient, by_object.transient, atol=1e-5)
    assert float(by_dict.steady.sum()) < 0.98 * float(by_name.steady.sum())
    assert description == {"type": "transient_path", "max_depth": 3}


def test_a_pulse_that_was_set_is_used():
    integrator = mi.load_dict({"type": "transient_path"})
    integrator.pulse = tofrender.GaussianPulse(0.5)
    dataset = render(box(), integrator=integrator, window=(0.0, 30.0))
    assert dataset.attrs["pulse"] == "GaussianPulse(width_opl=0.5)"
    filled = dataset.transient.sum(("y", "x", "channel")).values > 0
    assert dataset.opl.values[filled].min() < 2  # Without the pulse, 3.8 m


_INTEGER = "must be an integer from"
_METERS = "must be a finite number of meters"
_BAD = [
    ("spp", 1 << 25, f"{_INTEGER} 1 to 16777216"),
    ("seed", 1 << 32, f"{_INTEGER} 0 to 4294967295"),
    *[(name, 1 << 21, f"{_INTEGER} 1 to 1048576") for name in ("bins",)],
    ("workers", 1025, f"{_INTEGER} 1 to 1024"),
    ("sampler", "padded-sobol", "did you mean 'padded_sobol'"),
    ("integrator", "path", "must be one of transient_path"),
    ("integrator", "transient_paht", "did you mean 'transient_path'"),
    ("window", 5, "must be 'auto' or (start, stop) in meters"),
    ("window", (5.0, 3.0), "must end after it starts"),
    *[("window", (3.0, v), f"window[1] = {v!r}: {_METERS}") for v in (np.inf, "a", True)],
    ("window", (np.nan, 4.0), f"window[0] = nan: {_METERS}"),
]
"""Limits, and what may be meant; `tests/inputs` has more values of each."""


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize(("name", "value", "allowed"), _BAD)
def test_bad_argument(name, value, allowed):
    start = "" if allowed.startswith("window[") else f"{name} = {value!r}: "
    with refused("^" + re.escape(start)) as error:
        render(box(), **{name: value})
    assert allowed in str(error.value)


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize(
    "integrator", [{"type": "path"}, {"type": "diffuse"}, {"type": "direct", "hide_emitters": True}]
)
@pytest.mark.parametrize("load", [dict, mi.load_dict])
def test_integrator_without_time(integrator, load):
    with refused(r"integrator = \w+: "):
        render(box(), integrator=load(integrator))


def interrupting(monkeypatch) -> None:
    """Let SIGINT come after the second step of a render."""
    lower(monkeypatch, step_samples=64 * 64)
    watch_steps(monkeypatch, lambda number: number == 1 and signal.raise_signal(signal.SIGINT))


@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_the_first_ctrl_c_ends_after_a_step(monkeypatch, rfilter):
    described = with_integrator(box(), temporal_filter="box")
    described = with_film(described, rfilter={"type": rfilter})
    interrupting(monkeypatch)
    with pytest.warns(UserWarning, match="interrupted: returning 128 of 1024 samples") as record:
        part = render(described, spp=1 << 10)
    assert [warning.filename for warning in record] == [__file__]
    assert (part.attrs["complete"], part.attrs["spp"]) == (0, 128)
    assert float(part.steady.mean()) == pytest.approx(0.147, rel=0.05)
    assert float(part.transient.sum() / part.steady.sum()) == pytest.approx(1, abs=1e-4)
    assert outside(part) == pytest.approx(0, abs=1e-4)


def test_ctrl_c_after_the_last_step_changes_nothing(monkeypatch):
    interrupting(monkeypatch)
    assert render(box(), spp=128).attrs["complete"] == 1
