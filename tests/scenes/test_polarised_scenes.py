"""The window and the mirrors: files, windows of time, and light as Fresnel and Mueller have it."""

from __future__ import annotations

import pickle
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from helpers.support import parsed, require_equal, with_film

import tofrender
from tofrender.scenes import BUILT_IN, describe, polarised
from tofrender.scenes.packing import packed, unpacked

FOLDER = Path(__file__).parents[2] / "scenes" / "polarised"
ALL = ["brewster_window", "strained_mirror_corridor"]
POLARISED = "llvm_ad_mono_polarized"
ANGLES = {"brewster_window": "polariser", "strained_mirror_corridor": "angle"}


def rendered(described: dict, spp: int, seed: int = 0) -> list[np.ndarray]:
    """Steady picture and bins of one channel, (height, width, [bins,] 4), float64."""
    scene = tofrender.load_scene(described, optimize=False)
    found = mi.render(scene, spp=spp, seed=seed)
    return [np.array(each, dtype=np.float64) for each in found]


# ------------------------------------------------------------------------------------- files


def test_every_scene_has_a_file():
    assert {path.stem for path in FOLDER.glob("*.xml")} == set(ALL)


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("changed", [False, True])
def test_xml_is_the_dict(name, changed):
    changes = {"width": 7, "spp": 3, "start_opl": 1.5, "integrator": "path_tracer_nee"}
    changes = changes | {ANGLES[name]: 30.0} if changed else {}
    file, described = parsed(FOLDER / f"{name}.xml", **changes), parsed(BUILT_IN[name](**changes))
    if name == "strained_mirror_corridor":
        path = file["bitmap"][1].pop("filename")
        pixels = described["bitmap"][1].pop("bitmap")
        assert path == "retardance.exr"
        kept = np.array(mi.Bitmap(str(FOLDER / path)))
        np.testing.assert_allclose(kept, np.array(pixels), rtol=1e-6)
    require_equal(file, described)


@pytest.mark.parametrize("name", ALL)
def test_first_line_of_the_file_is_the_description(name):
    lines = (FOLDER / f"{name}.xml").read_text(encoding="utf-8").splitlines()
    assert lines[2].strip() == describe(name)
    assert len(describe(name)) <= 72


@pytest.mark.parametrize(
    "variant", ["llvm_ad_rgb", "llvm_ad_mono", POLARISED, "llvm_ad_spectral_polarized"]
)
def test_every_scene_renders_under_every_variant(variant):
    mi.set_variant(variant)
    for name in ALL:
        for source in (name, FOLDER / f"{name}.xml"):
            scene = tofrender.load_scene(source, width=8, height=8, temporal_bins=4)
            steady, transient = (np.array(each) for each in mi.render(scene, spp=16))
            assert np.isfinite(steady).all()
            assert np.isfinite(transient).all()
            assert steady[..., 0].max() > 0


@pytest.mark.parametrize("name", ALL)
def test_windows_hold_the_light(name):
    """A warning would fail the test; nothing comes before the window."""
    described = BUILT_IN[name](width=32, height=32)
    found = tofrender.render(described, spp=64)
    assert found.attrs["energy_outside_window"] < 0.01
    start = described["sensor"]["film"]["start_opl"]
    bins = {"temporal_bins": 2, "start_opl": start - 10, "bin_width_opl": 10.0}
    _, transient = rendered(with_film(described, **bins), 64)
    before, after = transient.sum(axis=(0, 1, 3))
    assert before == 0 < after


def test_strain_goes_to_another_process():
    described = BUILT_IN["strained_mirror_corridor"]()
    sent = unpacked(pickle.loads(pickle.dumps(packed("scene", described))))
    both = [np.array(each["strained"]["delta"]["bitmap"]) for each in (sent, described)]
    np.testing.assert_array_equal(*both)
    assert not polarised.retardance_of_plastic().flags.writeable


# ------------------------------------------------------------------------------------ window

SHEET = ("polariser", "sheet")
REFLECTED = ("lamp", "target", "ring", "gap", "eye")


def middle_of_the_window(reflected: bool) -> np.ndarray:
    """The Stokes vector of a ray through the window's middle, in a window of time."""
    described = BUILT_IN["brewster_window"](width=2, height=2)
    left_out = (*SHEET, *(("room-lamp",) if reflected else REFLECTED))
    described = {name: part for name, part in described.items() if name not in left_out}
    described["sensor"]["fov"] = 0.1
    start = 3.0 if reflected else 6.2
    film = {"temporal_bins": 1, "start_opl": start, "bin_width_opl": 3.2 if reflected else 20.0}
    _, transient = rendered(with_film(described, **film), 1 << 15)
    return transient.sum(axis=(0, 1, 2))


def test_reflected_light_is_polarised_wholly():
    """At Brewster's angle both faces of the pane reflect what oscillates along `up` only."""
    mi.set_variant(POLARISED)
    s0, *rest = middle_of_the_window(reflected=True)
    assert s0 > 0
    np.testing.assert_allclose(np.array(rest) / s0, [-1, 0, 0], atol=2e-3)


@pytest.mark.statistical
def test_light_from_the_room_lacks_what_is_reflected():
    """S1 / S0 = R, with R = ((n² - 1) / (n² + 1))² of one face.

    All orders of a pane pass (1 - R) / (1 + R) of the one polarisation, and all of the other, so
    the degree is (1 - T) / (1 + T) = R. The bound is 5 % of R, the noise below 1 %.
    """
    mi.set_variant(POLARISED)
    n = polarised.INDEX
    reflected = ((n**2 - 1) / (n**2 + 1)) ** 2
    s0, *rest = middle_of_the_window(reflected=False)
    assert abs(reflected - 0.147929) < 1e-6
    np.testing.assert_allclose(np.array(rest) / s0, [reflected, 0, 0], atol=0.05 * reflected)


def through_the_sheet(angle: float) -> np.ndarray:
    """Light of the reflection and of the room, S0 of the pixels before which the polariser is."""
    described = BUILT_IN["brewster_window"](width=32, height=32, polariser=angle)
    film = {"temporal_bins": 2, "start_opl": 3.0, "bin_width_opl": 3.2}
    _, transient = rendered(with_film(described, **film), 256)
    return transient[10:22, 6:14, :, 0].mean(axis=(0, 1))


def test_a_polariser_takes_the_reflection_away():
    mi.set_variant(POLARISED)
    (crossed, room), (kept, room_as_well) = through_the_sheet(0.0), through_the_sheet(90.0)
    assert crossed < 0.05 * kept
    assert 0.5 < room_as_well / room < 1


# ----------------------------------------------------------------------------------- mirrors


PERIOD = 2 * polarised.CORRIDOR


def images(spp: int = 4, bins: int = 6, width: int = 33, **plastic: float) -> np.ndarray:
    """The first images of the lamp, in bins of their own, (height, width, bins, 4)."""
    described = BUILT_IN["strained_mirror_corridor"](width=width, height=width)
    described["strained"] |= {k: {"type": "uniform", "value": v} for k, v in plastic.items()}
    film = {"temporal_bins": bins, "start_opl": PERIOD - 0.1, "bin_width_opl": PERIOD}
    _, transient = rendered(with_film(described, **film), spp)
    return transient.reshape(width, width, bins, -1)


def plate(angle: float, retardance: float) -> np.ndarray:
    """The Mueller matrix of a wave plate, angles in degrees, with Mitsuba's sign of S3."""
    a, d = 2 * np.radians(angle), np.radians(retardance)
    c, s = np.cos(a), np.sin(a)
    return np.array(
        [
            [1, 0, 0, 0],
            [0, c * c + s * s * np.cos(d), c * s * (1 - np.cos(d)), -s * np.sin(d)],
            [0, c * s * (1 - np.cos(d)), s * s + c * c * np.cos(d), c * np.sin(d)],
            [0, s * np.sin(d), -c * np.sin(d), np.cos(d)],
        ]
    )


@pytest.mark.parametrize(
    ("angle", "retardance"), [(45, 17), (45, 40), (30, 25), (-20, 50), (0, 30)]
)
def test_each_pass_turns_the_state(angle, retardance):
    """The k-th image has passed the plate 2 k times, whose axis is the same for both ways.

    Above and below the axis only: plates that are tilted the other way turn theirs in Mitsuba.
    """
    mi.set_variant(POLARISED)
    found = images(theta=float(angle), delta=float(retardance))[:, 16].sum(axis=0)
    for k, (s0, *rest) in enumerate(found, 1):
        state = np.linalg.matrix_power(plate(angle, retardance), 2 * k) @ [1, 1, 0, 0]
        np.testing.assert_allclose(np.array(rest) / s0, state[1:], atol=0.02, err_msg=str(k))


def test_mirrors_lose_what_they_lose():
    """The k-th image has seen 2 k - 1 mirrors of reflectance 0.85; the polariser takes half."""
    mi.set_variant(POLARISED)
    found = images(spp=1, bins=3, width=64)[..., 0]
    for k in (1, 2, 3):
        lit = found[:, :, k - 1]
        assert lit.max() == pytest.approx(0.5 * 0.85 ** (2 * k - 1), rel=1e-3)
        # Each pixel has one sample, which hits an image or none
        assert np.mean(np.abs(lit[lit > 0] - lit.max()) < 1e-3 * lit.max()) > 0.95


def test_the_picture_has_no_noise_and_is_polarised_wholly():
    mi.set_variant(POLARISED)
    first, second = (
        rendered(BUILT_IN["strained_mirror_corridor"](width=33, height=33), 64, seed)[0]
        for seed in (0, 1)
    )
    inside = np.s_[1:6, 1:-1]  # of the first image
    np.testing.assert_allclose(first[inside], second[inside], atol=0.01)
    degree = tofrender.degree_of_polarisation(first[inside], axis=-1)
    assert degree.min() > 0.97
    assert np.ptp(first[inside][..., 3]) > 0.1


def test_without_polarisation_plates_are_filters():
    mi.set_variant("llvm_ad_mono")
    found = images(spp=1, bins=1, width=16)
    assert np.median(found[found > 0]) == pytest.approx(0.5 * 0.85, rel=1e-3)


# --------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"width": 0}, "width = 0: must be an integer from 1 to 65536"),
        ({"temporal_bins": 0}, "temporal_bins = 0: must be an integer from 1"),
        ({"start_opl": float("nan")}, "start_opl = nan: must be a finite number of metres"),
        ({"bin_width_opl": 0}, "bin_width_opl = 0: must be a finite number of metres above 0"),
        ({"spp": 0}, "spp = 0: must be an integer from 1 to 16777216"),
        ({"max_depth": 0}, r"max_depth = 0: must be -1 \(no limit\) or an integer"),
        ({"integrator": "transient_pat"}, "did you mean 'transient_path'?"),
    ],
)
def test_bad_arguments_are_one_line(name, arguments, text):
    with pytest.raises(ValueError, match=text) as error:
        BUILT_IN[name](**arguments)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("value", [-181, 200, float("nan"), float("inf"), "steep", None, True])
@pytest.mark.parametrize("name", ALL)
def test_bad_angles_are_one_line(name, value):
    allowed = "must be a finite number of degrees from -180 to 180"
    with pytest.raises(ValueError, match=rf"\A{ANGLES[name]} = .*: {allowed}\Z"):
        BUILT_IN[name](**{ANGLES[name]: value})


# ------------------------------------------------------------------------------ around the corner


def test_the_wall_behind_fog_loads():
    described = BUILT_IN["nlos_behind_fog"](width=4, height=4, temporal_bins=8, sigma_t=1.5)
    path = FOLDER.parent / "nlos" / "nlos_behind_fog.xml"
    found = []
    for scene in (
        tofrender.load_scene(described, optimize=False),
        tofrender.load_scene(path, parameters={"sigma_t": 1.5}, width=4, height=4),
    ):
        (end,) = (each for each in scene.shapes() if each.id() == "fog-end")
        medium = mi.traverse(end.interior_medium())
        found.append(float(np.ravel(medium["sigma_t.value.value"])[0]))
        low, high = np.array(end.bbox().min).ravel(), np.array(end.bbox().max).ravel()
        np.testing.assert_allclose([low, high], [[-2, -2, 0.45], [2, 2, 0.9]], atol=1e-6)
    assert found == [1.5, 1.5]
