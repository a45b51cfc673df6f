"""The window and the mirrors: light as Fresnel and Mueller have it."""

from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from helpers.scenes import load
from helpers.support import with_film

import tofrender
from tofrender.scenes import BUILT_IN, polarized

POLARIZED = "llvm_ad_mono_polarized"


@pytest.fixture(autouse=True)
def _polarized(_variant):
    mi.set_variant(POLARIZED)


def rendered(described: dict, spp: int, seed: int = 0) -> list[np.ndarray]:
    """Steady picture and bins of one channel, (height, width, [bins,] 4), float64."""
    found = mi.render(load(described), spp=spp, seed=seed)
    return [np.array(each, dtype=np.float64) for each in found]


REFLECTED = ("lamp", "target", "ring", "gap", "eye")


def middle_of_the_window(reflected: bool) -> np.ndarray:
    """The Stokes vector of a ray through the window's middle, in a window of time."""
    described = BUILT_IN["brewster_window"](width=2, height=2)
    for name in ("polarizer", "sheet", *(("room-lamp",) if reflected else REFLECTED)):
        del described[name]
    described["sensor"]["fov"] = 0.1
    start = 3.0 if reflected else 6.2
    film = {"temporal_bins": 1, "start_opl": start, "bin_width_opl": 3.2 if reflected else 20.0}
    _, transient = rendered(with_film(described, **film), 1 << 15)
    return transient.sum(axis=(0, 1, 2))


def test_reflected_light_is_polarized_wholly():
    """At Brewster's angle both faces of the pane reflect what oscillates along `up` only."""
    s0, *rest = middle_of_the_window(reflected=True)
    assert s0 > 0
    np.testing.assert_allclose(np.array(rest) / s0, [-1, 0, 0], atol=2e-3)


@pytest.mark.statistical
def test_light_from_the_room_lacks_what_is_reflected():
    """S1 / S0 = R, with R = ((n² - 1) / (n² + 1))² of one face.

    All orders of a pane pass (1 - R) / (1 + R) of the one polarization, and all of the other, so
    the degree is (1 - T) / (1 + T) = R. The bound is 5 % of R, the noise below 1 %.
    """
    n = polarized.INDEX
    reflected = ((n**2 - 1) / (n**2 + 1)) ** 2
    s0, *rest = middle_of_the_window(reflected=False)
    assert abs(reflected - 0.147929) < 1e-6
    np.testing.assert_allclose(np.array(rest) / s0, [reflected, 0, 0], atol=0.05 * reflected)


def through_the_sheet(angle: float) -> np.ndarray:
    """Light of the reflection and of the room, S0 of the pixels before which the polarizer is."""
    described = BUILT_IN["brewster_window"](width=32, height=32, polarizer=angle)
    film = {"temporal_bins": 2, "start_opl": 3.0, "bin_width_opl": 3.2}
    _, transient = rendered(with_film(described, **film), 256)
    return transient[10:22, 6:14, :, 0].mean(axis=(0, 1))


def test_a_polarizer_takes_the_reflection_away():
    (crossed, room), (kept, room_as_well) = through_the_sheet(0.0), through_the_sheet(90.0)
    assert crossed < 0.05 * kept
    assert 0.5 < room_as_well / room < 1


PERIOD = 2 * polarized.CORRIDOR


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
    found = images(theta=float(angle), delta=float(retardance))[:, 16].sum(axis=0)
    for k, (s0, *rest) in enumerate(found, 1):
        state = np.linalg.matrix_power(plate(angle, retardance), 2 * k) @ [1, 1, 0, 0]
        np.testing.assert_allclose(np.array(rest) / s0, state[1:], atol=0.02, err_msg=str(k))


def test_mirrors_lose_what_they_lose():
    """The k-th image has seen 2 k - 1 mirrors of reflectance 0.85; the polarizer takes half."""
    found = images(spp=1, bins=3, width=64)[..., 0]
    for k in (1, 2, 3):
        lit = found[:, :, k - 1]
        assert lit.max() == pytest.approx(0.5 * 0.85 ** (2 * k - 1), rel=1e-3)
        # Each pixel has one sample, which hits an image or none
        assert np.mean(np.abs(lit[lit > 0] - lit.max()) < 1e-3 * lit.max()) > 0.95


def test_the_picture_has_no_noise_and_is_polarized_wholly():
    first, second = (
        rendered(BUILT_IN["strained_mirror_corridor"](width=33, height=33), 64, seed)[0]
        for seed in (0, 1)
    )
    inside = np.s_[1:6, 1:-1]  # of the first image
    np.testing.assert_allclose(first[inside], second[inside], atol=0.01)
    degree = tofrender.degree_of_polarization(first[inside], axis=-1)
    assert degree.min() > 0.97
    assert np.ptp(first[inside][..., 3]) > 0.1


def test_without_polarization_plates_are_filters():
    mi.set_variant("llvm_ad_mono")
    found = images(spp=1, bins=1, width=16)
    assert np.median(found[found > 0]) == pytest.approx(0.5 * 0.85, rel=1e-3)


def test_the_wall_behind_fog_loads():
    described = BUILT_IN["nlos_behind_fog"](width=4, height=4, temporal_bins=8, sigma_t=1.5)
    path = Path(__file__).parents[2] / "scenes" / "nlos" / "nlos_behind_fog.xml"
    found = []
    for source, options in ((described, {}), (path, {"parameters": {"sigma_t": 1.5}})):
        scene = tofrender.load_scene(source, width=4, height=4, optimize=False, **options)
        (end,) = (each for each in scene.shapes() if each.id() == "fog-end")
        medium = mi.traverse(end.interior_medium())
        found.append(float(np.ravel(medium["sigma_t.value.value"])[0]))
        low, high = np.array(end.bbox().min).ravel(), np.array(end.bbox().max).ravel()
        np.testing.assert_allclose([low, high], [[-2, -2, 0.45], [2, 2, 0.9]], atol=1e-6)
    assert found == [1.5, 1.5]
