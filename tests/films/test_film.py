"""The transient film: bins and their edges, filters, operations, bad parameters."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.gallery import SCENES, emitter_grid
from helpers.support import (
    area_light,
    beam,
    camera,
    diffuse,
    film,
    follow,
    load,
    plane,
    point_light,
    rendered,
    scene,
    with_film,
    with_integrator,
)
from oracles import films as oracles

from tofrender.films.contribution import Contribution
from tofrender.films.deposit import FilmDeposit
from tofrender.signals.pulses import GaussianPulse


def empty(**parameters):
    """A prepared film."""
    made = mi.load_dict(film(**parameters), parallel=False)
    made.prepare([])
    return made


def deposit(target, opl, value=1.0, position=(0.5, 0.5)) -> None:
    opl = mi.Float(opl)
    target.add_transient_data(
        mi.Point2f(*position),
        opl,
        mi.Color0f(),
        mi.Spectrum(value),
        mi.Float(1),
        dr.full(mi.Bool, True, dr.width(opl)),
    )


def bins_of(target) -> np.ndarray:
    return np.array(target.develop()[1])


# ------------------------------------------------------------------------------- edges of bins


@pytest.mark.parametrize(
    ("start", "width"), [(0.0, 0.25), (1.0, 0.25), (3.5, 2.0**-6), (-2.0, 0.5)]
)
def test_bins_are_half_open(start, width):
    """Bin k is [start + k w, start + (k + 1) w); these numbers are exact in single precision."""
    n = 40
    edges = (start + width * np.arange(n + 1)).astype(np.float32)
    below = np.nextafter(edges, np.float32(-1e9))
    at_edge, before = (
        empty(bins=n, start=start, bin_width=width),
        empty(bins=n, start=start, bin_width=width),
    )
    deposit(at_edge, edges)  # the last edge is outside
    deposit(before, below)  # the first one is outside
    assert bins_of(at_edge)[0, 0, :, 0].tolist() == [1] * n
    # A number just below an edge is in the bin before it, unless its difference to the start rounds
    apart = below[1:] - np.float32(start) < edges[1:] - np.float32(start)
    assert apart.sum() >= 2
    assert (bins_of(before)[0, 0, :, 0][apart] >= 1).all()
    assert bins_of(before).sum() == 3 * (n + (start == 0))  # minus 1e-45 is 0


def test_outside_of_the_window_leaves_no_trace():
    target = empty(bins=4, start=1.0, bin_width=0.25, width=2, height=2)
    deposit(
        target, [-1e30, -1.0, 0.999, 2.0, 2.5, 1e9, 1e30, float("inf"), -float("inf"), float("nan")]
    )
    assert not bins_of(target).any()
    for position in [(-0.5, 0.5), (2.5, 0.5), (0.5, -0.1), (0.5, 2.0), (1e9, 0.5)]:
        deposit(target, 1.5, position=position)
    assert not bins_of(target).any()


def test_one_contribution():
    target = empty(bins=5, start=1.0, bin_width=0.5, width=4, height=3)
    deposit(target, 2.2, [1.0, 2.0, 3.0], (2.5, 1.5))
    expected = np.zeros((3, 4, 5, 3))
    expected[1, 2, 2] = [1, 2, 3]
    assert np.array_equal(bins_of(target), expected)
    assert np.array_equal(np.array(target.time_slice(2)), expected[:, :, 2])
    assert not np.array(target.time_slice(1)).any()


def test_one_contribution_in_a_crop():
    target = empty(
        bins=2,
        bin_width=1.0,
        width=8,
        height=8,
        crop_width=3,
        crop_height=2,
        crop_offset_x=4,
        crop_offset_y=5,
    )
    deposit(target, 1.5, position=(6.5, 5.5))
    deposit(target, 1.5, position=(3.9, 5.5))
    expected = np.zeros((2, 3, 2, 3))
    expected[0, 2, 1] = 1
    assert np.array_equal(bins_of(target), expected)


def test_clear_and_prepare_empty_the_film():
    target = empty(bins=2, bin_width=1.0)
    for empties in (target.clear, lambda: target.prepare([])):
        deposit(target, 0.5)
        target.fold()
        deposit(target, 0.5)
        assert bins_of(target)[0, 0, 0, 0] == 2
        empties()
        assert not bins_of(target).any()


def test_window():
    target = empty(bins=2, bin_width=0.5, start=1.0)
    assert (target.temporal_bins, target.bin_width_opl, target.start_opl) == (2, 0.5, 1.0)
    assert target.end_opl() == 2.0


def test_defaults_are_those_of_the_documentation():
    target = mi.load_dict({"type": "transient_hdr_film"})
    assert (target.temporal_bins, target.bin_width_opl, target.start_opl) == (2048, 0.003, 0.0)
    assert list(target.size()) == [768, 576]
    assert target.rfilter().is_box_filter()


# --------------------------------------------------------------------------------- operations


def test_fold_keeps_what_single_precision_would_lose():
    """2^24 ones and one more: the next is lost, unless the first were put aside."""
    target = empty(bins=1, bin_width=1.0)
    deposit(target, [0.5], value=2.0**24)
    target.fold()
    for _ in range(3):
        deposit(target, np.full(64, 0.5))
    assert bins_of(target)[0, 0, 0, 0] == 2**24 + 192


@pytest.mark.parametrize("rfilter", ["box", "tent"])
def test_take_hands_over_what_develop_says(rfilter):
    described = with_film(
        SCENES["cornell"](),
        rfilter={"type": rfilter},
        width=70,
        height=40,
        temporal_bins=50,
        bin_width_opl=0.2,
    )
    loaded = load(with_integrator(described, temporal_filter="box"))
    developed = [np.array(t) for t in mi.render(loaded, spp=4)]
    taken = loaded.sensors()[0].film().take()
    for one, other in zip(developed, taken, strict=True):
        assert one.shape == other.shape
        assert np.array_equal(one, other)


def test_scale_multiplies_bins_and_steady_image():
    described = with_film(SCENES["cornell"](), temporal_bins=20, bin_width_opl=0.5)
    loaded = load(described)
    steady, transient = (np.array(t) for t in mi.render(loaded, spp=4))
    target = loaded.sensors()[0].film()
    for factor, total in ((0.25, 0.25), (8.0, 2.0)):
        target.scale(factor)
        scaled_steady, scaled = (np.array(t) for t in target.develop())
        assert np.allclose(scaled_steady, total * steady, rtol=1e-6)
        assert np.allclose(scaled, total * transient, rtol=1e-6)


def test_scale_reaches_what_is_folded():
    target = empty(bins=3, bin_width=1.0)
    deposit(target, [0.5, 1.5])
    target.fold()
    deposit(target, [1.5])
    target.scale(0.25)
    assert bins_of(target)[0, 0, :, 0].tolist() == [0.25, 0.5, 0]


def test_tiles_merge_into_the_whole():
    """Four tiles of a picture without noise, rendered apart, make the picture."""
    whole_scene, expected = emitter_grid(8, 6)
    whole = mi.load_dict(whole_scene["sensor"]["film"], parallel=False)
    whole.prepare([])
    for x, y, width, height in [(0, 0, 5, 2), (5, 0, 3, 2), (0, 2, 5, 4), (5, 2, 3, 4)]:
        part, _ = emitter_grid(8, 6)
        crop = {"crop_offset_x": x, "crop_offset_y": y, "crop_width": width, "crop_height": height}
        loaded = load(with_film(part, **crop))
        mi.render(loaded, spp=4)
        whole.merge_tile(loaded.sensors()[0].film())
    steady, transient = (np.array(tensor) for tensor in whole.develop())
    assert transient[..., 0] == pytest.approx(expected, rel=1e-6)
    assert steady[..., 0] == pytest.approx(expected.sum(axis=2), rel=1e-6)


def test_tiles_merge_with_a_spatial_filter():
    """A tile as large as the film is the film."""
    described = with_film(SCENES["cornell"](), rfilter={"type": "gaussian"})
    described = with_integrator(described, temporal_filter="box")
    loaded = load(described)
    steady, transient = (np.array(t) for t in mi.render(loaded, spp=16))
    tile = loaded.sensors()[0].film()
    whole = mi.load_dict(described["sensor"]["film"], parallel=False)
    whole.prepare([])
    whole.samples_per_pixel = tile.samples_per_pixel
    whole.merge_tile(tile)
    merged_steady, merged = (np.array(t) for t in whole.develop())
    assert np.abs(merged_steady - steady).max() < 1e-5
    assert np.abs(merged - transient).max() < 1e-5


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bins": 4}, "tile.temporal_bins = 4: must be 3"),
        ({"bin_width": 0.5}, "tile.bin_width_opl = 0.5: must be 1.0"),
        ({"start": 0.5}, "tile.start_opl = 0.5: must be 0.0"),
        ({"width": 5}, "tile.size = "),
        ({"crop_offset_y": 3, "crop_height": 1}, "must lie within the film's window"),
    ],
)
def test_tiles_that_do_not_fit_are_refused(change, message):
    same = {"bins": 3, "bin_width": 1.0, "width": 4, "height": 4, "crop_height": 2}
    with pytest.raises(ValueError, match=message):
        empty(**same).merge_tile(empty(**same | change))


def test_time_slice_outside_is_refused():
    for k in (-1, 3, 1.5):
        with pytest.raises(ValueError, match=f"k = {k}: must be an integer from 0 to 2"):
            empty(bins=3).time_slice(k)


def test_develop_before_prepare_is_refused():
    with pytest.raises(RuntimeError, match=r"prepare\(\)"):
        mi.load_dict(film()).develop()


def test_time_slice_is_what_develop_says_with_a_filter():
    described = with_film(
        SCENES["cornell"](), rfilter={"type": "tent"}, temporal_bins=20, bin_width_opl=0.5
    )
    loaded = load(with_integrator(described, temporal_filter="box"))
    _, transient = mi.render(loaded, spp=16)
    sliced = np.array(loaded.sensors()[0].film().time_slice(9))
    assert sliced.max() > 0
    assert np.array(transient)[:, :, 9] == pytest.approx(sliced, rel=1e-6)


# ----------------------------------------------------------------- temporal filters and pulses


def lamp_at(opl: float, window: dict, **integrator) -> dict:
    """A lamp whose light arrives at one length exactly."""
    sensor = camera((0, 0, opl), (0, 0, 0), window, kind="orthographic", near_clip=0.01)
    return scene({"lamp": plane(emitter=area_light(2.0))}, sensor, **integrator)


WINDOW = {"bins": 64, "start": 1.0, "bin_width": 0.0625}
EDGES = 1.0 + 0.0625 * np.arange(65)


def test_temporal_filter_box_is_the_bin():
    _, transient = rendered(lamp_at(3.03, film(**WINDOW), temporal_filter="box"))
    assert transient[0, 0, :, 0] == pytest.approx(np.histogram([3.03], EDGES)[0] * 2.0)


@pytest.mark.parametrize("stddev", [0.4, 2.0, 3.5])
def test_temporal_filter_gaussian_has_exact_bin_masses(stddev):
    """Its standard deviation counts in bins; whatever the offset within a bin."""
    for opl in (3.0, 3.03, 3.05):
        made = lamp_at(opl, film(**WINDOW), temporal_filter="gaussian", gaussian_stddev=stddev)
        _, transient = rendered(made)
        expected = 2.0 * oracles.gaussian_masses(EDGES, opl, stddev * 0.0625)
        assert transient[0, 0, :, 0] == pytest.approx(expected, abs=4e-6)


def test_temporal_filter_gaussian_is_two_bins_wide_by_default():
    _, transient = rendered(lamp_at(3.03, film(**WINDOW), temporal_filter="gaussian"))
    expected = 2.0 * oracles.gaussian_masses(EDGES, 3.03, 2 * 0.0625)
    assert transient[0, 0, :, 0] == pytest.approx(expected, abs=4e-6)


@pytest.mark.parametrize("name", ["", None])
def test_temporal_filter_empty_takes_the_film_filter(name):
    """A tent of radius 1 pixel in space is one of radius 1 bin in time, normalised."""
    options = {} if name is None else {"temporal_filter": name}
    window = film(**WINDOW, rfilter={"type": "tent"})
    _, transient = rendered(lamp_at(3.03, window, **options))
    z = np.clip((EDGES - 3.03) / 0.0625, -1, 1)
    cdf = np.where(z < 0, 0.5 * (1 + z) ** 2, 1 - 0.5 * (1 - z) ** 2)
    assert transient[0, 0, :, 0] == pytest.approx(2.0 * np.diff(cdf), abs=1e-5)
    _, boxed = rendered(lamp_at(3.03, film(**WINDOW), **options))
    assert boxed[0, 0, :, 0] == pytest.approx(np.histogram([3.03], EDGES)[0] * 2.0)


def test_pulse_has_exact_bin_masses():
    _, transient = rendered(lamp_at(3.03, film(**WINDOW), pulse_width_opl=0.1))
    expected = 2.0 * oracles.gaussian_masses(EDGES, 3.03, 0.1)
    assert transient[0, 0, :, 0] == pytest.approx(expected, abs=4e-6)


def test_pulse_of_the_table():
    """At s = .03 and w = .02, the peak bin's mean is 1.86 % below the centre's value."""
    lamp = empty(bins=101, start=-1.01, bin_width=0.02)
    measure = FilmDeposit.into(
        lamp, mi.Point2f(0.5), mi.Color0f(), mi.Spectrum(1), GaussianPulse(0.03)
    )
    measure.add(Contribution(mi.Spectrum(1), mi.Float(0.0), mi.Bool(True)))
    bins = bins_of(lamp)[0, 0, :, 0]
    density = np.exp(-0.5 * (np.arange(-50, 51) * 0.02 / 0.03) ** 2) / (0.03 * np.sqrt(2 * np.pi))
    assert density[50] / (bins[50] / 0.02) == pytest.approx(1.0186, abs=2e-4)
    assert density[55] / (bins[55] / 0.02) == pytest.approx(1 - 0.16, abs=0.01)
    assert bins.sum() == pytest.approx(1, abs=2e-6)


def test_pulse_and_filter_convolve():
    made = lamp_at(
        3.03,
        film(**WINDOW),
        pulse_width_opl=0.09,
        temporal_filter="gaussian",
        gaussian_stddev=0.12 / 0.0625,
    )
    _, transient = rendered(made)
    expected = 2.0 * oracles.gaussian_masses(EDGES, 3.03, 0.15)
    assert transient[0, 0, :, 0] == pytest.approx(expected, abs=4e-6)


def test_pulse_at_the_window_edge_loses_only_what_is_outside():
    for opl in (0.95, 1.02, 4.98, 5.05):
        _, transient = rendered(lamp_at(opl, film(**WINDOW), pulse_width_opl=0.1))
        expected = 2.0 * oracles.gaussian_masses(EDGES, opl, 0.1)
        assert transient[0, 0, :, 0] == pytest.approx(expected, abs=4e-6)


def test_pulse_adds_no_variance():
    """With a pulse, the spread of a total over seeds is what it is without."""
    plain = with_integrator(SCENES["cornell"](), light_samples=2)  # "auto" is fewer with a pulse
    pulsed = with_integrator(plain, pulse_width_opl=0.05)
    totals = [
        [rendered(loaded, 8, seed)[1].sum(axis=2) for seed in range(8)]
        for loaded in (load(plain), load(pulsed))
    ]
    without, with_pulse = (np.var(t, axis=0) for t in totals)
    assert without.max() > 0.01
    assert with_pulse == pytest.approx(without, rel=1e-4, abs=1e-6)


def test_any_pulse_can_be_set():
    from tofrender.signals.pulses import SampledPulse

    loaded = load(lamp_at(3.0, film(**WINDOW)))
    loaded.integrator().pulse = SampledPulse([1.0, 3.0], start_opl=0.0, bin_width_opl=0.0625)
    _, transient = mi.render(loaded, spp=4)
    bins = np.array(transient)[0, 0, :, 0]
    assert bins[32:34] == pytest.approx([0.5, 1.5], abs=2e-4)
    assert bins.sum() == pytest.approx(2.0, abs=1e-5)


def test_negative_lobes_are_refused_in_time():
    loaded = load(lamp_at(3.0, film(**WINDOW, rfilter={"type": "mitchell"})))
    with pytest.raises(ValueError, match="negative lobes") as error:
        loaded.integrator().render(loaded)
    assert "\n" not in str(error.value)


# ------------------------------------------------------------------------------ bad parameters


FILM, PATH = "transient_hdr_film", "transient_path"
BAD = [
    *[(FILM, "temporal_bins", value) for value in (0, -3, 1.5, "many", (1 << 20) + 1)],
    *[(FILM, "bin_width_opl", value) for value in (0.0, -0.1, float("nan"), float("inf"), "wide")],
    *[(FILM, "start_opl", value) for value in (float("nan"), float("inf"), "early")],
    *[(FILM, "width", value) for value in (0, -1, 2.5)],
    *[(FILM, "crop_width", value) for value in (0, -1)],
    (FILM, "exhaustive_scan", True),
    (FILM, "laser_scan_width", 4),
    *[(PATH, "max_depth", value) for value in (-2, 1.5, "deep")],
    *[(PATH, "rr_depth", value) for value in (0, -1)],
    *[(PATH, "temporal_filter", value) for value in ("gauss", "tent")],
    *[(PATH, "gaussian_stddev", value) for value in (0.0, -1.0, float("nan"))],
    *[(PATH, "pulse_width_opl", value) for value in (0.0, -1.0, float("nan"), "short")],
]


@pytest.mark.parametrize(("kind", "name", "value"), BAD)
def test_bad_parameter(kind, name, value):
    with pytest.raises(RuntimeError) as error:
        mi.load_dict({"type": kind, name: value})
    last = str(error.value).strip().splitlines()[-1]
    assert name in last
    assert str(value) in last
    assert "ust be" in last


@pytest.mark.parametrize("kind", [FILM, PATH])
def test_unknown_parameter(kind):
    with pytest.raises(RuntimeError, match='temporal_bin"'):
        mi.load_dict({"type": kind, "temporal_bin": 4})


def test_wrong_film():
    described = lamp_at(3.0, {"type": "hdrfilm", "width": 2, "height": 2})
    loaded = load(described)
    with pytest.raises(
        TypeError, match="film = HDRFilm: must be transient_hdr_film or phasor_hdr_film"
    ) as error:
        loaded.integrator().render(loaded)
    assert "\n" not in str(error.value)


def test_a_film_larger_than_memory():
    target = mi.load_dict(film(65536, 65536, bins=1 << 20))
    with pytest.raises(MemoryError, match="would fit") as error:
        target.prepare([])
    assert "\n" not in str(error.value)


def test_a_walk_needs_no_film():
    parts = {"floor": plane(bsdf=diffuse(0.5)), "lamp": point_light((0, 0, 1), 1.0)}
    loaded = load(scene(parts, camera((0, 0, 2), (0, 0, 0), film())))
    assert follow(loaded, beam((0, 0, 2), (0, 0, 0))).all()[0] == pytest.approx([3.0])


# ------------------------------------------------------------------------------- clear refusals


def test_folding_some_pixels_copies_nothing():
    """A copy of all bins would take as much memory again, and its time in each step."""
    target = empty(bins=64, bin_width=1.0)
    target.one_writer_per_pixel = True
    pixels, places = mi.UInt32([0]), []
    for _ in range(5):
        deposit(target, [0.5, 1.5])
        before = target.bins._sums.index
        target.fold(pixels)
        places.append(target.bins._sums.index == before)
    assert all(places[1:]), places


@pytest.mark.parametrize("call", ["develop", "take", "time_slice", "scale", "fold"])
def test_an_empty_film_says_so(call):
    made = mi.load_dict(film(), parallel=False)
    arguments = {"time_slice": (0,), "scale": (2.0,)}.get(call, ())
    with pytest.raises(RuntimeError, match=r"is empty; call prepare\(\) first"):
        getattr(made, call)(*arguments)


def test_scale_keeps_the_balance():
    target = load(with_film(SCENES["cornell"]()))
    mi.render(target, spp=4)
    made = target.sensors()[0].film()
    steady, transient = (np.array(t) for t in made.develop())
    made.scale(2.5)
    scaled_steady, scaled = (np.array(t) for t in made.develop())
    np.testing.assert_allclose(scaled, 2.5 * transient, rtol=1e-6)
    np.testing.assert_allclose(scaled_steady, 2.5 * steady, rtol=1e-5)


@pytest.mark.parametrize(
    ("name", "value"), [("pixel_format", "luminance"), ("component_format", "float16")]
)
def test_only_what_is_stored_can_be_asked_for(name, value):
    mi.load_dict(film(pixel_format="rgb", component_format="float32"), parallel=False)
    with pytest.raises(RuntimeError, match=f"{name} = '{value}': .*ust be one of"):
        mi.load_dict(film(**{name: value}), parallel=False)


@pytest.mark.parametrize(
    ("parameter", "text"),
    [
        ({"timeout": 1.0}, "timeout = 1.0: must be left out"),
        ({"timeout": "long"}, "timeout = 'long': must be a finite number"),
        ({"camera_unwarp": "x"}, "camera_unwarp = 'x': must be True or False"),
        ({"gaussian_stddev": 0.0}, "gaussian_stddev = 0.0: must be a finite number of bins above"),
        ({"max_depth": 0}, "max_depth = 0: must be -1"),
        ({"temporal_filter": "tent"}, "must be one of '', box, gaussian"),
    ],
)
def test_bad_integrator_parameters(parameter, text):
    with pytest.raises(RuntimeError) as error:
        mi.load_dict({"type": "transient_path", **parameter}, parallel=False)
    assert text in str(error.value).splitlines()[-1]


def test_a_pulse_must_be_one():
    integrator = mi.load_dict({"type": "transient_path"}, parallel=False)
    with pytest.raises(TypeError, match=r"pulse = 0\.03: must be a pulse like GaussianPulse"):
        integrator.pulse = 0.03
    assert integrator.pulse is None


def test_derivatives_of_nothing_are_refused():
    loaded = load(SCENES["cornell"]())
    with pytest.raises(ValueError, match="params: track no gradients"):
        loaded.integrator().render_backward(loaded, None, None)
