"""Frames of an animation: poses, exposures, rolling shutters, and what they refuse."""

import os
import signal

import mitsuba as mi
import numpy as np
import pytest
from helpers.scenes import load, refusal

import tofrender
from tofrender import Motion, moving, render, render_frames
from tofrender.motion import frames as module
from tofrender.scenes.motion import posed


def square(speed: float = 1.0, half: float = 0.5, **film: int) -> mi.Scene:
    """A square that goes upwards before a camera that sees 2 x 2 m, lit from there."""
    lens = {"type": "orthographic", "sampler": {"type": "independent"}}
    lens["to_world"] = mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
    lens["film"] = {"type": "transient_hdr_film", "width": 20, "height": 20, **film}
    lens["film"] |= {"temporal_bins": 1, "start_opl": 0.0, "bin_width_opl": 40.0}
    lens["film"] |= {"rfilter": {"type": "box"}}
    shape = {"type": "rectangle", "velocity": [0, speed, 0]}
    shape["to_world"] = mi.ScalarTransform4f().scale([5, half, 1])
    light = {"type": "directional", "direction": [0, 0, -1], "irradiance": np.pi}
    integrator = {"type": "transient_path", "max_depth": 2}
    return load({"type": "scene", "i": integrator, "s": lens, "shape": shape, "light": light})


def small_fan() -> mi.Scene:
    bins = {"temporal_bins": 20, "start_opl": 5.0, "bin_width_opl": 0.5}
    return load(tofrender.scenes.fan(width=12, height=8, max_depth=2, **bins))


def column(frame) -> np.ndarray:
    """Means of a frame's rows, over the brightness of the square."""
    return frame["steady"].mean(("x", "channel")).values


def test_a_frame_is_the_render_of_its_pose():
    scene = small_fan()
    found = render_frames(scene, [0.0, 0.013], spp=4, seed=3, progress=False)
    assert found["frame"].values.tolist() == [0.0, 0.013]
    assert found["frame"].attrs["units"] == "s"
    for k, time in enumerate((0.0, 0.013)):
        with posed(scene, time):
            alone = render(scene, spp=4, seed=3, progress=False)
        np.testing.assert_allclose(found["transient"][k], alone["transient"], rtol=1e-4, atol=1e-6)
    assert np.abs(found["steady"][0] - found["steady"][1]).max() > 0.1
    np.testing.assert_array_equal(found["steady"][0][0], found["steady"][1][0])  # The wall rests


def test_an_exposure_is_the_mean_of_poses():
    """The square's edges pass 16 rows of .1 m with 32 poses: a ramp, half-way in the middle."""
    scene = square(speed=1.0, half=0.3)
    sharp, blurred = (
        render_frames(scene, [-0.4], exposure_s=s, spp=64, progress=False, **more).isel(frame=0)
        for s, more in ((0.0, {}), (0.8, {"poses": 32}))
    )
    bright = column(sharp).max()
    y = 0.95 - 0.1 * np.arange(20)  # Middles of the rows [m], from above
    time = np.linspace(-0.4, 0.4, 8001)[:, None]
    covered = np.abs(y[None, :] - time) < 0.3
    assert ((column(sharp) > 0.1 * bright) == (np.abs(y + 0.4) < 0.3)).all()
    np.testing.assert_allclose(column(blurred) / bright, covered.mean(0), atol=0.08)
    assert column(blurred).sum() == pytest.approx(column(sharp).sum(), rel=0.01)


def test_poses_are_in_the_middles_of_their_parts():
    """One pose of an exposure from -.4 to .4 s is that of 0 s, two are those of -.2 and .2 s."""
    scene = square(speed=1.0, half=0.3)

    def seen(start: float, exposure: float, poses: int) -> np.ndarray:
        more = {"exposure_s": exposure, "poses": poses, "spp": 16, "progress": False}
        return column(render_frames(scene, [start], **more).isel(frame=0)) > 1e-3

    still = {time: np.abs(0.95 - 0.1 * np.arange(20) - time) < 0.3 for time in (-0.2, 0.0, 0.2)}
    assert (seen(-0.4, 0.8, 1) == still[0.0]).all()
    assert (seen(-0.4, 0.8, 2) == (still[-0.2] | still[0.2])).all()


def test_an_exposure_spreads_over_bins():
    """A wall that comes 0.6 m nearer is in all bins between, alike."""
    described = {"type": "scene", "i": {"type": "transient_path", "max_depth": 2}}
    film = {"type": "transient_hdr_film", "width": 2, "height": 2, "temporal_bins": 6}
    film |= {"start_opl": 6.8, "bin_width_opl": 0.2, "rfilter": {"type": "box"}}
    described["s"] = {"type": "perspective", "fov": 1.0, "film": film}
    described["wall"] = {"type": "rectangle", "velocity": [0, 0, -3.0]}
    described["wall"]["to_world"] = mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
    described["light"] = {"type": "point", "position": [0.0, 0, 0], "intensity": 10.0}
    found = render_frames(load(described), [0.0], exposure_s=0.2, poses=60, spp=60, progress=False)
    light = found["transient"].mean(("frame", "y", "x", "channel")).values
    center = found["opl"].values / 2
    np.testing.assert_allclose(light * center**2 / (light * center**2).mean(), 1, atol=0.02)


def test_rows_of_a_rolling_shutter_have_their_own_time():
    """A vertical edge that goes sideways leans; each row is that of a frame at its time."""
    scene = small_fan()
    rolling = render_frames(scene, [0.01], row_time_s=0.004, spp=4, progress=False)
    for y in (0, 3, 7):
        still = render_frames(scene, [0.01 + 0.004 * y], spp=4, progress=False)
        np.testing.assert_allclose(
            rolling["transient"][0, y], still["transient"][0, y], rtol=1e-4, atol=1e-6
        )
    late = render_frames(scene, [0.01], spp=4, progress=False)
    assert np.abs(rolling["steady"][0, 1:] - late["steady"][0, 1:]).max() > 0.1


def test_rows_of_a_crop_window_keep_their_times():
    whole = render_frames(square(), [0.0], row_time_s=0.02, spp=4, progress=False)
    crop = {"crop_offset_y": 8, "crop_height": 6, "crop_offset_x": 0, "crop_width": 20}
    part = render_frames(square(**crop), [0.0], row_time_s=0.02, spp=4, progress=False)
    assert column(part.isel(frame=0)).std() > 0.1
    edges = [(column(f.isel(frame=0)) > 0.3).tolist() for f in (whole, part)]
    assert edges[0][8:14] == edges[1]


def test_the_window_holds_the_light_of_all_frames():
    scene = moving(square(0.0), {"shape": Motion(velocity=(0, 0, -100))})
    found = render_frames(scene, [0.0, 0.1], window="auto", spp=1, progress=False)
    assert found.attrs["energy_outside_window"] < 0.01
    assert found["opl"].values[-1] - found["opl"].values[0] >= 0


def test_fingerprints_tell_poses_and_shutters_apart():
    scene = square()
    options = [((0.0,), {}), ((0.1,), {}), ((0.0,), {"exposure_s": 0.1, "poses": 1})]
    options += [((0.0,), {"row_time_s": 0.1}), ((0.0,), {})]
    *found, again = (
        render_frames(scene, times, spp=1, progress=False, **more)["fingerprint"].item()
        for times, more in options
    )
    assert len(set(found)) == 4
    assert again == found[0]


def test_a_stopped_animation_returns_its_finished_frames(monkeypatch):
    scene, count = square(), []

    def stopped(job, item, **options):
        count.append(1)
        if len(count) == 3:
            os.kill(os.getpid(), signal.SIGINT)
        return plain(job, item, **options)

    plain = module.render_item
    monkeypatch.setattr(module, "render_item", stopped)
    with pytest.warns(UserWarning, match="interrupted after 2 of 4 frames, which are returned"):
        found = render_frames(scene, [0.0, 0.1, 0.2, 0.3], spp=1, progress=False)
    assert found.sizes["frame"] == 2
    assert found.attrs["complete"] == 0
    count[:] = [1, 1]
    with pytest.raises(KeyboardInterrupt, match="interrupted after 0 of 1 frames"):
        render_frames(scene, [0.0], spp=1, progress=False)
    assert "\ntime" not in scene.id()


def test_what_frames_refuse():
    def said(times=(0.0,), **options):
        return refusal(render_frames, square(), times, spp=4, progress=False, **options)

    assert said(poses=2).startswith("poses = 2:")
    assert said(exposure_s=1.0, poses=5).startswith("poses = 5:")
    assert said(exposure_s=-1).startswith("exposure_s = -1:")
    assert said(()).startswith("times_s = ():")
    dark = {"window": (50.0, 60.0), "bins": 5}
    assert said(**dark).startswith("window = 50 m to 60 m:")
    tracer = {"row_time_s": 1e-3, "integrator": "transient_light_tracer"}
    refused = refusal(render_frames, "fan", [0.0], spp=1, size=(4, 4), progress=False, **tracer)
    assert refused.startswith("row_time_s = 0.001:")
    with pytest.raises(TypeError, match=r"'errors'"):
        render_frames(square(), [0.0], errors=True)


SPAD = {"cycles": 100, "photons": {"photons_per_cycle": 0.5}, "spad": {}}
FRAME_READERS = {
    "sense": lambda film: tofrender.sensors.sense(film, SPAD),
    "expected_photons": lambda film: tofrender.sensors.expected_photons(
        film, photons_per_cycle=0.5
    ),
    "transient_to_phasor": lambda film: tofrender.transient_to_phasor(film, 20e6),
    "light_in_flight": lambda film: tofrender.light_in_flight(film),
    "save_npz": lambda film: tofrender.io.save_npz(film, "film.npz"),
}


@pytest.mark.parametrize("name", FRAME_READERS)
def test_functions_of_one_render_refuse_several_frames(name):
    """They name the axis and how to choose a frame; a frame is accepted, also without `drop`."""
    settings = {"size": (6, 4), "bins": 8, "start_opl": 5.0, "bin_width": 1.0, "spp": 1}
    film = render_frames("fan", [0, 0.01], progress=False, **settings)
    line = refusal(FRAME_READERS[name], film)
    assert "axis" in line
    assert "isel(frame=0)" in line
    if name != "save_npz":
        FRAME_READERS[name](film.isel(frame=0))


def test_frames_of_other_times_are_not_merged(tmp_path):
    """Each frame has its own time and fingerprint."""
    settings = {"size": (6, 4), "bins": 8, "start_opl": 5.0, "bin_width": 1.0, "spp": 1}
    film, other = (
        render_frames("fan", [0, 0.01], progress=False, seed=seed, **settings) for seed in (0, 1)
    )
    assert len(set(film["fingerprint"].values)) == 2
    joined = tofrender.merge([film.isel(frame=1), other.isel(frame=1)])
    assert joined.attrs["time_s"] == 0.01
    assert joined.attrs["fingerprint"] == film["fingerprint"].values[1]
    parts = [film.isel(frame=0), other.isel(frame=1)]
    assert "time_s = 0.01; must be 0.0" in refusal(tofrender.merge, parts)
    parts = [film.isel(frame=0, drop=True), other.isel(frame=1, drop=True)]
    assert "selected without drop" in refusal(tofrender.merge, parts)
    tofrender.io.save_npz(film.isel(frame=1), tmp_path / "film.npz")
    saved = tofrender.load_npz(tmp_path / "film.npz")
    assert saved.attrs["time_s"] == 0.01
    assert saved.attrs["fingerprint"] == film["fingerprint"].values[1]
