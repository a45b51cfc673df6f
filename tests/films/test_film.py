"""The transient film: bins and their edges, filters, operations, tiles, bad parameters."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.gallery import SCENES
from helpers.parts import area_light, plane
from helpers.support import camera, film, load, refused, rendered, scene, with_film, with_integrator
from oracles import films as oracles

from tofrender.signals.pulses import SampledPulse


def empty(**parameters):
    """A prepared film."""
    made = mi.load_dict(film(**parameters), parallel=False)
    made.prepare([])
    return made


def deposit(target, opl, value=1.0, position=(0.5, 0.5), one_writer=False) -> None:
    opl = mi.Float(opl)
    target.add_transient_data(
        mi.Point2f(*position),
        opl,
        mi.Color0f(),
        mi.Spectrum(value),
        mi.Float(1),
        dr.full(mi.Bool, True, dr.width(opl)),
        one_writer=one_writer,
    )


def bins_of(target) -> np.ndarray:
    return np.array(target.develop()[1])


@pytest.mark.parametrize(
    ("start", "width"), [(0.0, 0.25), (1.0, 0.25), (3.5, 2.0**-6), (-2.0, 0.5)]
)
def test_bins_are_half_open(start, width):
    """Bin k is [start + k w, start + (k + 1) w); these numbers are exact in single precision."""
    n = 40
    edges = (start + width * np.arange(n + 1)).astype(np.float32)
    below = np.nextafter(edges, np.float32(-1e9))
    at_edge, before = (empty(bins=n, start=start, bin_width=width) for _ in range(2))
    deposit(at_edge, edges)  # the last edge is outside
    deposit(before, below)  # the first one is outside
    assert bins_of(at_edge)[0, 0, :, 0].tolist() == [1] * n
    # A number just below an edge is in the bin before it, unless its difference to the start rounds
    apart = below[1:] - np.float32(start) < edges[1:] - np.float32(start)
    assert apart.sum() >= 2
    assert (bins_of(before)[0, 0, :, 0][apart] >= 1).all()
    assert bins_of(before).sum() == 3 * (n + (start == 0))  # minus 1e-45 is 0
    assert before.end_opl() == start + n * width


def test_outside_of_the_window_leaves_no_trace():
    target = empty(bins=4, start=1.0, bin_width=0.25, width=2, height=2)
    deposit(target, [-1e30, -1.0, 0.999, 2.0, 2.5, 1e9, 1e30, np.inf, -np.inf, np.nan])
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
    crop = {"crop_width": 3, "crop_height": 2, "crop_offset_x": 4, "crop_offset_y": 5}
    target = empty(bins=2, bin_width=1.0, width=8, height=8, **crop)
    deposit(target, 1.5, position=(6.5, 5.5))
    deposit(target, 1.5, position=(3.9, 5.5))
    expected = np.zeros((2, 3, 2, 3))
    expected[0, 2, 1] = 1
    assert np.array_equal(bins_of(target), expected)


def test_clear_and_prepare_empty_the_film():
    target = empty(bins=2, bin_width=1.0)
    for empties in (target.clear, lambda: target.prepare([])):
        deposit(target, 0.5)
        target.flush()
        deposit(target, 0.5)
        assert bins_of(target)[0, 0, 0, 0] == 2
        empties()
        assert not bins_of(target).any()


def test_defaults_are_those_of_the_documentation():
    target = mi.load_dict({"type": "transient_hdr_film"})
    assert (target.temporal_bins, target.bin_width_opl, target.start_opl) == (2048, 0.003, 0.0)
    assert list(target.size()) == [768, 576]
    assert target.rfilter().is_box_filter()


TENT, GAUSSIAN = {"rfilter": {"type": "tent", "radius": 2.0}}, {"rfilter": {"type": "gaussian"}}


def test_fold_keeps_what_single_precision_would_lose():
    """2^24 ones and one more: the next is lost, unless the first were put aside."""
    target = empty(bins=1, bin_width=1.0)
    deposit(target, [0.5], value=2.0**24)
    target.flush()
    for _ in range(3):
        deposit(target, np.full(64, 0.5))
    assert bins_of(target)[0, 0, 0, 0] == 2**24 + 192


@pytest.mark.parametrize("rfilter", ["box", "tent"])
def test_take_time_slice_and_scale_are_what_develop_says(rfilter):
    size = {"width": 70, "height": 40, "temporal_bins": 50, "bin_width_opl": 0.2}
    described = with_film(SCENES["cornell"](), rfilter={"type": rfilter}, **size)
    loaded = load(with_integrator(described, temporal_filter="box"))
    developed = [np.array(t) for t in mi.render(loaded, spp=4)]
    target = loaded.sensors()[0].film()
    sliced = np.array(target.time_slice(22))
    assert sliced.max() > 0
    assert developed[1][:, :, 22] == pytest.approx(sliced, rel=1e-6)
    for factor, total in ((0.25, 0.25), (8.0, 2.0)):
        target.scale(factor)
        for one, scaled in zip(developed, target.develop(), strict=True):
            assert np.allclose(np.array(scaled), total * one, rtol=1e-6)
    for one, other in zip(developed, target.take(), strict=True):
        assert one.shape == other.shape
        assert np.array_equal(2 * one, other)


def test_scale_reaches_what_is_folded():
    target = empty(bins=3, bin_width=1.0)
    deposit(target, [0.5, 1.5])
    target.flush()
    deposit(target, [1.5])
    target.scale(0.25)
    assert bins_of(target)[0, 0, :, 0].tolist() == [0.25, 0.5, 0]


@pytest.mark.parametrize(
    ("of_film", "change", "message"),
    [
        ({}, {"bins": 4}, "tile.temporal_bins = 4:"),
        ({}, {"bin_width": 0.5}, "tile.bin_width_opl = 0.5:"),
        ({}, {"start": 0.5}, "tile.start_opl = 0.5:"),
        ({}, {"width": 5}, "tile.size = "),
        ({}, {"crop_offset_y": 3, "crop_height": 1}, "must lie within the film's window"),
        # What their filter would take from beyond the seam is missing
        (TENT, {"crop_width": 3}, r"tile\.sample_border = False:"),
        (GAUSSIAN, {"crop_width": 3}, r"tile\.sample_border = False:"),
        # At the picture's edge, one samples beyond it and the other does not
        (
            TENT,
            {"crop_width": 3, "sample_border": True},
            r"tile\.sample_border = True:",
        ),
    ],
)
def test_tiles_that_do_not_fit_are_refused(of_film, change, message):
    same = {"bins": 3, "bin_width": 1.0, "width": 4, "height": 4, "crop_height": 2} | of_film
    refused(message, empty(**same).merge_tile, empty(**same | change))


def test_time_slice_outside_is_refused():
    for k in (-1, 3, 1.5):
        refused(f"k = {k}: must be an integer from 0 to 2", empty(bins=3).time_slice, k)


def lamp_at(opl: float, window: dict, **integrator) -> dict:
    """A lamp whose light arrives at one length exactly."""
    sensor = camera((0, 0, opl), (0, 0, 0), window, kind="orthographic", near_clip=0.01)
    return scene({"lamp": plane(emitter=area_light(2.0))}, sensor, **integrator)


WINDOW = {"bins": 64, "start": 1.0, "bin_width": 0.0625}
EDGES = 1.0 + 0.0625 * np.arange(65)


def test_temporal_filter_box_is_the_bin():
    _, transient = rendered(lamp_at(3.03, film(**WINDOW), temporal_filter="box"))
    assert transient[0, 0, :, 0] == pytest.approx(np.histogram([3.03], EDGES)[0] * 2.0)


@pytest.mark.parametrize(
    ("options", "width", "lengths"),
    [
        # The standard deviation of the filter counts in bins, and is 2 of them by default
        *[
            ({"temporal_filter": "gaussian", "gaussian_stddev": bins}, bins / 16, (3, 3.03, 3.05))
            for bins in (0.4, 2.0, 3.5)
        ],
        ({"temporal_filter": "gaussian"}, 2 / 16, (3.03,)),
        # At the window's edges, a pulse loses only what is outside
        ({"pulse_width_opl": 0.1}, 0.1, (0.95, 1.02, 3.03, 4.98, 5.05)),
        # Both convolve
        (
            {"pulse_width_opl": 0.09, "temporal_filter": "gaussian", "gaussian_stddev": 0.12 * 16},
            0.15,
            (3.03,),
        ),
    ],
)
def test_gaussians_have_exact_bin_masses(options, width, lengths):
    for opl in lengths:
        _, transient = rendered(lamp_at(opl, film(**WINDOW), **options))
        expected = 2.0 * oracles.gaussian_masses(EDGES, opl, width)
        assert transient[0, 0, :, 0] == pytest.approx(expected, abs=4e-6)


@pytest.mark.parametrize("name", ["", None])
def test_temporal_filter_empty_takes_the_film_filter(name):
    """A tent of radius 1 pixel in space is one of radius 1 bin in time, normalized."""
    options = {} if name is None else {"temporal_filter": name}
    window = film(**WINDOW, rfilter={"type": "tent"})
    _, transient = rendered(lamp_at(3.03, window, **options))
    z = np.clip((EDGES - 3.03) / 0.0625, -1, 1)
    cdf = np.where(z < 0, 0.5 * (1 + z) ** 2, 1 - 0.5 * (1 - z) ** 2)
    assert transient[0, 0, :, 0] == pytest.approx(2.0 * np.diff(cdf), abs=1e-5)
    _, boxed = rendered(lamp_at(3.03, film(**WINDOW), **options))
    assert boxed[0, 0, :, 0] == pytest.approx(np.histogram([3.03], EDGES)[0] * 2.0)


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
    loaded = load(lamp_at(3.0, film(**WINDOW)))
    tracer = loaded.integrator()
    refused(r"pulse = 0\.03:", setattr, tracer, "pulse", 0.03)
    assert tracer.pulse is None
    tracer.pulse = SampledPulse([1.0, 3.0], start_opl=0.0, bin_width_opl=0.0625)
    bins = rendered(loaded, spp=4)[1][0, 0, :, 0]
    assert bins[32:34] == pytest.approx([0.5, 1.5], abs=2e-4)
    assert bins.sum() == pytest.approx(2.0, abs=1e-5)


@pytest.mark.parametrize("start", [-1.4, 0.3])
def test_pulses_that_begin_away_from_0_keep_their_energy(start):
    """Each bin has the energy of the pulse between its edges."""
    loaded = load(lamp_at(3.03, film(**WINDOW)))
    pulse = SampledPulse([1.0, 4.0, 3.0, 2.0, 0.5], start_opl=start, bin_width_opl=0.23)
    loaded.integrator().pulse = pulse
    bins = rendered(loaded, spp=4)[1][0, 0, :, 0]
    expected = 2.0 * np.diff([pulse.cdf(edge - 3.03) for edge in EDGES])
    assert bins == pytest.approx(expected, abs=4e-4)
    assert bins.sum() == pytest.approx(2.0, abs=1e-5)


FILM, PATH = "transient_hdr_film", "transient_path"
NAN, INF = float("nan"), float("inf")
BAD = [
    *[(FILM, "temporal_bins", value) for value in (0, -3, 1.5, "many", (1 << 20) + 1)],
    *[(FILM, "bin_width_opl", value) for value in (0.0, -0.1, NAN, INF, "wide")],
    *[(FILM, "start_opl", value) for value in (NAN, INF, "early")],
    *[(FILM, "width", value) for value in (0, -1, 2.5)],
    *[(FILM, "crop_width", value) for value in (0, -1)],
    (FILM, "exhaustive_scan", True),
    (FILM, "laser_scan_width", 4),
    *[(PATH, "max_depth", value) for value in (-2, 0, 1.5, "deep")],
    *[(PATH, "rr_depth", value) for value in (0, -1)],
    *[(PATH, "temporal_filter", value) for value in ("gauss", "tent")],
    *[(PATH, "gaussian_stddev", value) for value in (0.0, -1.0, NAN)],
    *[(PATH, "pulse_width_opl", value) for value in (0.0, -1.0, NAN, "short")],
    *[(PATH, "timeout", value) for value in (1.0, "long")],
    (PATH, "camera_unwarp", "x"),
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


@pytest.mark.parametrize(
    ("window", "text"),
    [
        (film(**WINDOW, rfilter={"type": "mitchell"}), "negative lobes"),
        (
            {"type": "hdrfilm", "width": 2, "height": 2},
            "film = HDRFilm:",
        ),
        (film(65536, 65536, bins=1 << 20), "would fit"),
    ],
    ids=["negative lobes", "steady", "larger than memory"],
)
def test_films_that_cannot_be_filled(window, text):
    loaded = load(lamp_at(3.0, window))
    refused(text, loaded.integrator().render, loaded, kind=(TypeError, ValueError, MemoryError))


def test_folding_some_pixels_copies_nothing():
    """A copy of all bins would take as much memory again, and its time in each step."""
    target = empty(bins=64, bin_width=1.0)
    pixels, places = mi.UInt32([0]), []
    for _ in range(5):
        deposit(target, [0.5, 1.5], one_writer=True)
        before = target.bins._sums.index
        target.flush(pixels)
        places.append(target.bins._sums.index == before)
    assert all(places[1:]), places


@pytest.mark.parametrize("call", ["develop", "take", "time_slice", "scale", "flush"])
def test_an_empty_film_says_so(call):
    made = mi.load_dict(film(), parallel=False)
    arguments = {"time_slice": (0,), "scale": (2.0,)}.get(call, ())
    with pytest.raises(RuntimeError, match=r"is empty\. Call prepare\(\)"):
        getattr(made, call)(*arguments)


@pytest.mark.parametrize(
    ("name", "value"), [("pixel_format", "luminance"), ("component_format", "float16")]
)
def test_only_what_is_stored_can_be_asked_for(name, value):
    mi.load_dict(film(pixel_format="rgb", component_format="float32"), parallel=False)
    with pytest.raises(RuntimeError, match=f"{name} = '{value}': .*ust be one of"):
        mi.load_dict(film(**{name: value}), parallel=False)


def test_derivatives_of_nothing_are_refused():
    loaded = load(SCENES["cornell"]())
    backward = loaded.integrator().render_backward
    refused("params: no parameter tracks gradients", backward, loaded, None, None)


WIDTH, HEIGHT = 8, 6
TILES = [(0, 0, 5, 2), (5, 0, 3, 2), (0, 2, 5, 4), (5, 2, 3, 4)]
FILTERS = {"box": {"type": "box"}, "tent": {"type": "tent", "radius": 2.0}}


def centers(rfilter: str, border: bool, **crop) -> dict:
    """A wall that glows in squares, seen at the centers of pixels: no noise, whatever the tile.

    Their light arrives at lengths that differ by a few bins.
    """
    values = np.random.default_rng(3).uniform(0, 1, (HEIGHT, WIDTH, 1)).astype(np.float32)
    texture = {"type": "bitmap", "data": mi.TensorXf(values), "raw": True, "filter_type": "nearest"}
    window = film(WIDTH, HEIGHT, bins=8, start=1.0, bin_width=0.25, sample_border=border, **crop)
    meter = {
        "type": "nlos_capture_meter",
        "sensor_origin": [0.3, 0.2, 1.2],
        "film": window | {"rfilter": FILTERS[rfilter]},
        "sampler": {"type": "independent", "sample_count": 4},
    }
    wall = {"type": "rectangle", "emitter": {"type": "area", "radiance": texture}, "sensor": meter}
    integrator = {"type": "transient_path", "max_depth": 1, "temporal_filter": "box"}
    return {"type": "scene", "integrator": integrator, "wall": wall}


def developed(target) -> list[np.ndarray]:
    return [np.array(tensor, dtype=float) for tensor in target.develop()]


def merge(rfilter: str, border: bool, tiles: list):
    """Films of the whole picture: rendered at once, and merged of tiles."""
    whole = load(centers(rfilter, border))
    mi.render(whole, spp=4)
    merged = mi.load_dict(centers(rfilter, border)["wall"]["sensor"]["film"], parallel=False)
    merged.prepare([])
    for x, y, width, height in tiles:
        crop = {"crop_offset_x": x, "crop_offset_y": y, "crop_width": width, "crop_height": height}
        part = load(centers(rfilter, border, **crop))
        mi.render(part, spp=4)
        merged.merge_tile(part.sensors()[0].film())
    return whole.sensors()[0].film(), merged


@pytest.mark.parametrize(
    ("rfilter", "border", "tiles"),
    [("box", False, TILES), ("tent", True, TILES), ("tent", False, [(0, 0, WIDTH, HEIGHT)])],
    ids=["box", "tent and border", "as large as the film"],
)
def test_tiles_are_the_whole(rfilter, border, tiles):
    """A tile's pixels are complete if it samples as far beyond its border as its filter reaches."""
    for one, other in zip(*map(developed, merge(rfilter, border, tiles)), strict=True):
        assert one.std() > 0.1 * one.mean()
        assert other == pytest.approx(one, rel=2e-6, abs=2e-6 * one.max())
