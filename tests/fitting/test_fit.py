"""`fit`: results, ends and errors; and its losses against NumPy."""

import os
import signal
from functools import partial

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import xarray as xr
from helpers.made_dataset import make_dataset
from helpers.parts import diffuse, plane, translate
from helpers.support import camera, scene as described
from oracles.lamp_above_floor import INTENSITY, POSITION, scene

import tofrender
from tofrender.rendering.labels import labeled

TRUE, START = (0.2, -0.1, 1.5), (-0.3, 0.2, 1.2)
RATES = {POSITION: 0.05, INTENSITY: 0.1}


def measured(**more):
    return mi.render(scene(TRUE, 2.0, **more))


def find(target=None, params=None, **options):
    made = options.pop("scene", None) or scene(START, 3.0)
    params = {POSITION: START, INTENSITY: 3.0} if params is None else params
    options = {"learning_rate": RATES, "progress": False} | options
    return tofrender.fit(made, params, measured() if target is None else target, **options)


@pytest.mark.parametrize(
    ("loss", "frequency_hz"), [("l2", None), ("wasserstein", None), ("phasor", [5e7, 1e8])]
)
def test_finds_a_lamp(loss, frequency_hz):
    made = scene(START, 3.0)
    found = find(scene=made, loss=loss, frequency_hz=frequency_hz, steps=200)
    assert np.abs(found.values[POSITION] - TRUE).max() < 1e-3
    assert np.abs(found.values[INTENSITY] - 2).max() < 5e-3
    assert found.loss < 1e-4 * found.losses[0]
    assert found.history[POSITION].shape == (found.steps, 3)
    assert np.allclose(found.history[POSITION][0], START)
    written = np.array(mi.traverse(made)[POSITION]).ravel()
    assert np.array_equal(written, found.values[POSITION])


def test_finds_what_other_values_follow_from():
    def apply(params, values):
        params[POSITION] = mi.Point3f(TRUE[0], TRUE[1], 0) + values["up"] * mi.Vector3f(0, 0, 1)
        params[INTENSITY] = mi.Color3f(values["power"])

    params = {"up": 1.2, "power": mi.Float(3)}
    found = find(params=params, apply=apply, learning_rate={"up": 0.02, "power": 0.1}, steps=150)
    assert isinstance(found.values["up"], float)
    assert abs(found.values["up"] - 1.5) < 2e-3
    assert abs(found.values["power"] - 2) < 1e-2
    assert repr(find(steps=1)).startswith(
        "Fit(1 step, loss 3.88 to 3.88, lamp.position = (-0.3, 0.2, 1.2), "
    )
    assert "\n" not in repr(found)


def test_albedo_and_power_from_a_picture_of_mitsubas():
    """Fit a steady picture by `prb`. Half of the picture is a wall of known albedo."""
    picture = {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}}
    walls = {"known": (1, 0.8), "wall": (-1, 0.3)}
    parts = {k: plane(translate(x, 0, 0), 1, bsdf=diffuse(a)) for k, (x, a) in walls.items()}
    parts["lamp"] = {"type": "point", "position": [0, 0, 2], "intensity": 5.0}
    sensor = camera((0, 0, 3), (0, 0, 0), picture, fov=30)
    made = mi.load_dict(described(parts, sensor, type="prb", max_depth=2))
    target = mi.render(made, spp=64)
    wall = "wall.bsdf.reflectance.value"
    params, rates = {wall: 0.6, INTENSITY: 3.0}, {wall: 0.03, INTENSITY: 0.2}
    options = {"learning_rate": rates, "bounds": {wall: (0, 1)}, "spp": 64, "progress": False}
    found = tofrender.fit(made, params, target, **options)
    assert np.abs(found.values[wall] - 0.3).max() < 3e-3
    assert np.abs(found.values[INTENSITY] - 5).max() < 0.05


def test_parameters_of_mitsubas_do():
    made = scene(START, 2.0)
    params = mi.traverse(made)
    params.keep([POSITION])
    found = find(scene=made, params=params, learning_rate=0.05, steps=100)
    assert list(found.values) == [POSITION]
    assert np.abs(found.values[POSITION] - TRUE).max() < 0.01


def test_takes_a_dataset():
    target = np.array(measured()[1])
    of_dataset, of_tensor = (
        find(each, steps=3).losses.tolist() for each in (along_opl(target, 0.5), target)
    )
    assert of_dataset == of_tensor
    said = r"^target with bins of 0.05 m from 0.4 m on: must be 0.05"
    with pytest.raises(ValueError, match=said):
        find(along_opl(target, 0.4), steps=3)
    dataset = along_opl(target, 0.5)
    backwards = slice(None, None, -1)
    mixed = dataset.isel(y=backwards, opl=backwards, channel=backwards).transpose("x", "opl", ...)
    for each in (mixed, mixed["transient"]):
        assert find(each, steps=3).losses.tolist() == of_tensor


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d.assign_coords(x=d["x"] + 2), r"the axis x has the labels \[2, 3, 4, 5\]"),
        (lambda d: d.assign_coords(y=d["y"] * 2), r"the axis y has the labels \[0, 2, 4, 6\]"),
        (lambda d: d.isel(x=slice(0, 3)), r"the axis x has the labels \[0, 1, 2\]"),
        (lambda d: d.isel(channel=[0]), r"the axis channel has the labels \['R'\]"),
        (lambda d: d.isel(opl=slice(None, None, 2)), "the bins are 0.1 m apart"),
        (lambda d: d["transient"].isel(opl=slice(None, None, 2)), "the bins are 0.1 m apart"),
        (lambda d: d.expand_dims(frame=1), "the additional axis frame"),
        (lambda d: d.assign_attrs(camera_unwarp=1), "lack the segment to the camera"),
        (lambda d: d.assign_attrs(quantity="radiance per meter"), "radiance per bin"),
    ],
)
def test_other_pixels_bins_and_path_lengths_are_refused(change, said):
    dataset = along_opl(np.array(measured()[1]), 0.5)
    with pytest.raises(ValueError, match=f"^target: .*{said}") as error:
        find(change(dataset), steps=3)
    assert "\n" not in str(error.value)


def test_phasors_are_found_by_their_labels():
    target = along_opl(np.array(measured()[1]), 0.5)
    frequencies = [5e7, 1e8]
    bare = tofrender.transient_to_phasor(target.drop_vars("steady"), frequencies)[:2]
    axes = {"frequency": frequencies, **{axis: target[axis].values for axis in ("y", "x")}}
    dims = ("frequency", "y", "x", "channel")
    axes["channel"] = target["channel"].values
    parts = [xr.DataArray(each, axes, dims).transpose("x", "channel", ...) for each in bare]
    options = {"loss": "phasor", "steps": 3}
    right = find(bare, frequency_hz=frequencies, **options).losses
    found = find(tuple(parts), frequency_hz=frequencies, **options).losses
    np.testing.assert_allclose(found, right, rtol=1e-6)
    with pytest.raises(ValueError, match=r"Pass them as frequency_hz"):
        find(tuple(parts), frequency_hz=frequencies[::-1], **options)
    moved = tuple(each.assign_coords(x=each["x"] + 1) for each in parts)
    with pytest.raises(ValueError, match=r"^target: the axis x has the labels"):
        find(moved, frequency_hz=frequencies, **options)


def along_opl(target: np.ndarray, start: float):
    dataset = make_dataset(4, 4, 60, start_opl=start, bin_width_opl=0.05)
    opl = start + (np.arange(60) + 0.5) * 0.05
    dataset = dataset.assign(transient=(("y", "x", "opl", "channel"), target))
    return labeled(dataset.drop_vars("time").assign_coords(opl=opl))


def test_own_losses_and_optimizers():
    def loss(rendered, target):
        return dr.sum(dr.abs(rendered - target), axis=None)

    found = find(loss=loss, optimizer=mi.ad.Adam(lr=1.0, beta_1=0.8), steps=60)
    assert found.loss < 0.2 * found.losses[0]
    slow = find(optimizer="sgd", learning_rate=0.01, steps=30)
    assert np.all(np.diff(slow.losses) < 0)


def test_seeds():
    steps = {"steps": 4, "learning_rate": 1e-6}
    one, same, other = (
        find(scene=scene(START, 3.0, noise=0.1), seed=seed, **steps).losses for seed in (1, 1, 2)
    )
    assert np.array_equal(one, same)
    assert not np.isclose(one, other).any()
    assert len(set(np.round(one, 6))) == 4


def test_ends_where_the_loss_no_longer_falls():
    """Each learning rate is half of the previous one, until the tolerance."""
    options = {"learning_rate": 0.01, "patience": 4, "params": {POSITION: TRUE}}

    def until(tolerance: float, steps: int):
        noisy = {"scene": scene(TRUE, 2.0, noise=0.05), "tolerance": tolerance, "steps": steps}
        return find(measured(noise=0.05), **noisy, **options)

    found = until(0.2, 500)
    assert found.converged
    assert 3 * 8 <= found.steps < 200
    assert repr(found).endswith("; the loss no longer falls)")
    assert 8 <= until(1.0, 500).steps < found.steps
    endless = until(0.0, 100)
    assert endless.steps == 100
    assert not endless.converged


def test_the_best_of_noisy_losses():
    """The best step has ten low losses in a row, instead of a single low loss by chance."""
    noisy = {"scene": scene(START, 3.0, noise=0.3), "steps": 60, "learning_rate": 0.02}
    found = find(measured(noise=0.3), **noisy)
    means = np.convolve(found.losses, np.full(10, 0.1), "valid")
    assert found.loss == pytest.approx(means.min())
    assert np.array_equal(found.values[POSITION], found.history[POSITION][means.argmin() + 9])


def test_ctrl_c_keeps_the_best():
    def interrupt(step, loss, values):
        if step == 5:
            os.kill(os.getpid(), signal.SIGINT)

    found = find(callback=interrupt, steps=50)
    assert (found.steps, found.why, found.converged) == (6, "stopped", False)
    assert found.loss == found.losses.min()


def test_callback_sees_each_step_and_may_end_it():
    seen = []

    def callback(step, loss, values):
        seen.append((step, loss, values[POSITION]))
        return step == 3

    found = find(callback=callback, steps=50)
    assert [step for step, _, _ in seen] == [0, 1, 2, 3]
    assert [loss for _, loss, _ in seen] == found.losses.tolist()
    assert np.array_equal([p for _, _, p in seen], found.history[POSITION])
    assert found.why == "the callback ended it"


def test_values_stay_within_bounds():
    said = r"^fit: lamp.position at 1.3, lamp.intensity.value at 2.5, which is a bound"
    with pytest.warns(UserWarning, match=said):
        found = find(bounds={POSITION: (None, 1.3), INTENSITY: (2.5, None)}, steps=40)
    assert found.history[POSITION].max() == np.float32(1.3)
    assert found.history[INTENSITY].min() == 2.5


@pytest.mark.parametrize(("loss", "frequency_hz"), [("scale_free", None), ("phase", [5e7, 1e8])])
def test_an_unknown_gain_of_the_target_does_not_matter(loss, frequency_hz):
    target = 2.5 * np.array(measured()[1])
    options = {"params": {POSITION: START}, "learning_rate": 0.05, "steps": 200}
    found = find(target, loss=loss, frequency_hz=frequency_hz, **options)
    assert np.abs(found.values[POSITION] - TRUE).max() < 2e-3


@pytest.mark.parametrize("frequency_hz", [5e7, [5e7, 1e8]])
@pytest.mark.parametrize("loss", ["phasor", "phase"])
def test_takes_phasors_and_phases(loss, frequency_hz):
    """I and Q, the whole result of `transient_to_phasor`, or phases have the same loss as bins."""
    bins = np.array(measured()[1])
    phasors = tofrender.transient_to_phasor(bins, frequency_hz, 0.5, 0.05)
    targets = [bins, phasors[:2], tuple(phasors)]
    if loss == "phase":
        targets.append(phasors[3])
    options = {"loss": loss, "frequency_hz": frequency_hz, "steps": 3}
    expected, *others = [find(target, **options).losses for target in targets]
    for each in others:
        np.testing.assert_allclose(each, expected, rtol=1e-3)


def test_phasors_that_do_not_fit():
    bins = np.array(measured()[1])
    i, q = tofrender.transient_to_phasor(bins, 5e7, 0.5, 0.05)[:2]
    with pytest.raises(ValueError, match=r"^target: I with shape \(4, 3, 3\): must be"):
        find((i[:, :3], q[:, :3]), loss="phasor", frequency_hz=5e7, steps=1)
    with pytest.raises(ValueError, match=r"^target: I with shape .* for one frequency, or \(2, 4"):
        find((i, q), loss="phasor", frequency_hz=[5e7, 1e8], steps=1)


def test_equal_walls_that_were_merged():
    """The name of another wall is not recommended, because it may belong to both walls."""
    walls = {k: plane(translate(x, 0, 0), 1, bsdf=diffuse(0.5)) for k, x in (("a", -1), ("b", 1))}
    lamp = {"type": "point", "position": [0, 0, 2]}
    picture = {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}}
    parts = walls | {"lamp": lamp}
    described_scene = described(parts, camera((0, 0, 3), (0, 0, 0), picture), type="prb")
    missing = "a.bsdf.reflectance.value"
    made = mi.load_dict(described_scene)
    with pytest.raises(ValueError, match=r"^params\['.*does not have this.*optimize=False$"):
        tofrender.fit(made, {missing: 0.3, "b.bsdf.reflectance.value": 0.3}, np.ones((4, 4, 3)))
    kept = tofrender.load_scene(described_scene, optimize=False)
    assert missing in mi.traverse(kept)


@pytest.mark.parametrize("moves", [False, True])
def test_films_without_a_pulse(moves):
    """An albedo is found. A position is refused in one line."""
    lamp = {"type": "point", "position": [0.1, 0, 0], "intensity": 5.0}
    bins = {"temporal_bins": 40, "start_opl": 3.0, "bin_width_opl": 0.1}
    film = {"type": "transient_hdr_film", "width": 4, "height": 3, "rfilter": {"type": "box"}}

    def room(albedo: float) -> mi.Scene:
        turned = translate(0, 0, 2) @ mi.ScalarTransform4f().rotate([0, 1, 0], 180)
        parts = {"wall": plane(turned, 3, bsdf=diffuse(albedo)), "lamp": lamp}
        return mi.load_dict(
            described(parts, camera((0, 0, 0), (0, 0, 1), film | bins), max_depth=2)
        )

    target = mi.render(room(0.8), spp=256)
    wall = "wall.bsdf.reflectance.value"
    options = {"spp": 64, "steps": 60, "progress": False}
    if moves:
        with pytest.raises(ValueError, match=r"\Apulse = None: .*\Z"):
            tofrender.fit(room(0.4), {POSITION: (0, 0, 0)}, target, **options)
        return
    found = tofrender.fit(room(0.4), {wall: 0.4}, target, learning_rate=0.05, **options)
    assert found.values[wall] == pytest.approx(0.8, abs=0.05)


def test_a_loss_that_is_no_number_ends_it():
    def loss(rendered, target):
        loss.steps += 1
        apart = tofrender.l2_loss(rendered, target)
        return apart * (float("nan") if loss.steps == 4 else 1)

    loss.steps = 0
    with pytest.warns(UserWarning, match=r"^fit: the loss is nan in step 3$"):
        found = find(loss=loss, steps=10)
    assert found.steps == 4
    assert np.isfinite(found.loss)
    assert found.loss == np.nanmin(found.losses)


def texture(params, values):
    params[POSITION] = mi.Point3f(0, 0, 1)


BAD_PARAMS = {
    "params['lamp.positon'] = 1.0: did you mean 'lamp.pos": {"lamp.positon": 1.0},
    "params['sensor.to_world'] = 1.0: is of type Affine": {"sensor.to_world": 1.0},
    "params['sensor.film.size'] = 4: is of type Scalar": {"sensor.film.size": 4},
    "params['lamp.position'] with shape (2,): must be a numbe": {POSITION: [1, 2]},
    "params['lamp.position'] = [1, 2, nan]: must be a": {POSITION: [1, 2, np.nan]},
}
BAD_OPTIONS = {
    "bounds['lamp'] = (0, 1): must": {"params": {POSITION: START}, "bounds": {"lamp": (0, 1)}},
    "params['lamp.position'] = [-0.30000001192092896, 0.2000": {"bounds": {POSITION: (0, 1)}},
    "bounds['lamp.position'] = (1, 0): must be (low, high), ": {"bounds": {POSITION: (1, 0)}},
    "learning_rate = {'lamp.position': 0.1}: must have 'l": {"learning_rate": {POSITION: 0.1}},
    "learning_rate['x'] = 1: must be of lamp.position, ": {"learning_rate": RATES | {"x": 1}},
    "frequency_hz = None: must be given with loss='phasor', in hertz": {"loss": "phasor"},
    "frequency_hz = 10000000.0: must be left out; only loss='phasor' and": {"frequency_hz": 1e7},
    "frequency_hz = 1e+10: must be below 2.99792e+": {"loss": "phasor", "frequency_hz": 1e10},
    "target with shape (4, 4, 61, 3): must be (4, 4, 60, ": {"target": np.ones((4, 4, 61, 3))},
    "target: 2880 of 2880 values are not finite,": {"target": np.full((4, 4, 60, 3), np.nan)},
    "params['x'] with shape (1, 1): must be a n": {"params": {"x": [[1.0]]}, "apply": texture},
    "params['x'] = <class 'drjit.llvm.ad.UIn": {"params": {"x": mi.UInt32}, "apply": texture},
} | {said: {"params": params} for said, params in BAD_PARAMS.items()}


@pytest.mark.parametrize("said", BAD_OPTIONS)
def test_refused_before_any_render(said):
    made = scene(START, 3.0)
    options = {"params": {POSITION: START, INTENSITY: 3.0}, "learning_rate": 0.1}
    options |= {"target": np.ones((4, 4, 60, 3))} | BAD_OPTIONS[said]
    with pytest.raises(ValueError) as error:  # noqa: PT011 (the text is compared below)
        tofrender.fit(made, **options)
    assert str(error.value).startswith(said)
    assert "\n" not in str(error.value)
    assert made.integrator().renders == 0


def test_starts_and_optimizers_of_another_kind():
    with pytest.raises(ValueError, match=r"^params\['x'\] = UInt: must be of floats with deriva"):
        find(params={"x": mi.UInt32(1)}, apply=texture, learning_rate=0.1)
    with pytest.raises(ValueError, match=r"^optimizer = Adam: it has the variables a. Pass"):
        find(optimizer=mi.ad.Adam(lr=1.0, params={"a": mi.Float(1)}))


def test_what_light_does_not_depend_on():
    where = "the loss does not depend on"
    with pytest.raises(ValueError, match=rf"^params = x: {where} them at the start. Choose"):
        find(params={"x": 1.0}, apply=texture, learning_rate=0.1)
    params = {POSITION: START, "sensor.x_fov": 30.0}
    with pytest.warns(UserWarning, match=rf"^params\['sensor.x_fov'\]: {where} it at the start"):
        find(params=params, learning_rate=0.1, steps=2)


def test_loss_that_is_no_number():
    with pytest.raises(ValueError, match=r"^loss: returned .*TensorXf.*; must return a Dr.Jit"):
        find(loss=lambda rendered, target: rendered - target)


def test_time_losses_need_bins():
    made = mi.load_dict(mi.cornell_box())
    for loss in ("wasserstein", "phasor"):
        with pytest.raises(
            ValueError, match=rf"^loss = '{loss}': must be 'l2' or 'scale_free' for a film"
        ):
            tofrender.fit(made, {"red.reflectance.value": 0.5}, np.ones((256, 256, 3)), loss=loss)


AXIS = {"start_opl": 1.0, "bin_width_opl": 0.5}
FREQUENCIES = [20e6, 50e6]
SHAPE = (2, 3, 7, 3)
phasor_loss = partial(tofrender.phasor_loss, frequency_hz=FREQUENCIES, **AXIS)
LOSSES = {
    "l2": tofrender.l2_loss,
    "phasor": phasor_loss,
    "phase": partial(tofrender.phase_loss, frequency_hz=FREQUENCIES, **AXIS),
    "scale_free": tofrender.scale_free_loss,
    "wasserstein": tofrender.wasserstein_loss,
    "times": partial(tofrender.wasserstein_loss, energy_weight=0.0),
}


def cubes(seed: int = 0) -> np.ndarray:
    """Return rendered light and a target."""
    return np.random.default_rng(seed).random((2, *SHAPE)).astype(np.float32)


def number(value) -> float:
    return float(np.array(value).item())


def in_numpy(name: str, rendered: np.ndarray, target: np.ndarray) -> float:
    """Return the loss by its formula, in double precision."""
    r, t = rendered.astype(float), target.astype(float)
    if name == "l2":
        return np.sum((r - t) ** 2) / np.sum(t**2)
    if name == "scale_free":
        return 1 - np.sum(r * t) ** 2 / (np.sum(r**2) * np.sum(t**2))
    if name in ("phasor", "phase"):
        parts = [
            np.array(tofrender.transient_to_phasor(each, FREQUENCIES, *AXIS.values())[:2])
            for each in (r, t)
        ]
        if name == "phase":
            p, u = (each[0] + 1j * each[1] for each in parts)
            return np.sum(abs(p) ** 2 * np.sin(np.angle(p / u)) ** 2) / np.sum(abs(p) ** 2)
        return np.sum((parts[0] - parts[1]) ** 2) / np.sum(parts[1] ** 2)
    light, measured = r.sum(2), t.sum(2)
    arrived = [np.cumsum(each, axis=2) / each.sum(2, keepdims=True) for each in (r, t)]
    times = np.sum(measured / measured.sum() * np.mean((arrived[0] - arrived[1]) ** 2, axis=2))
    energy = np.sum((light - measured) ** 2) / np.sum(measured**2)
    return times + (energy if name == "wasserstein" else 0)


@pytest.mark.parametrize("name", LOSSES)
def test_is_the_formula(name):
    loss, (rendered, target) = LOSSES[name], cubes()
    found = number(loss(mi.TensorXf(rendered), target))
    assert abs(found / in_numpy(name, rendered, target) - 1) < 1e-5
    assert number(loss(target, target)) < 1e-12
    dim = number(loss(rendered * 1e-6, target * 1e-6))
    assert abs(dim / found - 1) < 1e-3
    with pytest.raises(ValueError, match=r"^target: all values are 0. Pass a target with light"):
        loss(np.ones(SHAPE), np.zeros(SHAPE))


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("name", LOSSES)
def test_derivative_is_that_of_differences(name, seed):
    rendered, target = cubes(seed)
    attached = mi.TensorXf(rendered)
    dr.enable_grad(attached)
    dr.backward(LOSSES[name](attached, target))
    gradient = np.array(dr.grad(attached), np.float64)
    direction = np.random.default_rng(seed).standard_normal(SHAPE)
    step = 1e-5
    ahead, behind = (in_numpy(name, rendered + s * direction, target) for s in (step, -step))
    expected = (ahead - behind) / (2 * step)
    assert abs(np.sum(gradient * direction) - expected) < 2e-4 * np.abs(gradient).sum()
    forward = mi.TensorXf(rendered)
    dr.enable_grad(forward)
    dr.set_grad(forward, mi.TensorXf(direction.astype(np.float32)))
    loss = LOSSES[name](forward, target)
    dr.forward_to(loss)
    assert abs(number(dr.grad(loss)) - expected) < 2e-4 * np.abs(gradient).sum()


@pytest.mark.statistical
@pytest.mark.parametrize("name", ["phase", "scale_free"])
def test_noise_does_not_bias_products_of_two_renders(name):
    """The mean over noisy pairs is the loss of clean light. A single render adds its noise."""
    rng = np.random.default_rng(3)
    clean, target = rng.random((2, 12, 10, 7, 3)).astype(np.float32)
    expected = in_numpy(name, clean, target)

    def mean_and_error(pairs: bool) -> tuple[float, float]:
        found = []
        for _ in range(40):
            first, second = clean + rng.normal(0, 0.5, (2, *clean.shape)).astype(np.float32)
            other = second if pairs else first
            found.append(number(LOSSES[name](first, target, other=other)))
        return np.mean(found), np.std(found) / np.sqrt(len(found))

    mean, error = mean_and_error(pairs=True)
    assert abs(mean - expected) < 4.5 * error + 2e-3
    mean, error = mean_and_error(pairs=False)
    assert mean - expected > 0.05 > 10 * error


@pytest.mark.parametrize("name", ["phase", "scale_free"])
@pytest.mark.parametrize("render", ["black", "noise"])
def test_renders_without_light_have_no_loss(name, render):
    """The denominator is 0 for black renders, and may be negative for independent noise."""
    target, first = cubes()
    second = -first
    if render == "black":
        first = second = np.zeros(SHAPE, np.float32)
    with pytest.warns(UserWarning, match=r"the render is black or contains only noise .*spp"):
        loss = LOSSES[name](mi.TensorXf(first), target, other=mi.TensorXf(second))
    assert np.isnan(number(loss))


def arrival(at: float, energy: float = 1.0, width: float = 0.15) -> np.ndarray:
    """Return a Gaussian pulse around a length [m], in 200 bins of 0.05 m."""
    edges = np.arange(201) * 0.05
    pulse = tofrender.GaussianPulse(width)
    masses = np.diff(np.array(pulse.cdf(mi.Float(edges - at))))
    return (energy * masses).astype(np.float32)[None, None, :, None]


def along(loss) -> np.ndarray:
    """Return losses of a pulse that approaches its place from 3 m too early."""
    return np.array([number(loss(arrival(x), arrival(6.0))) for x in np.linspace(3, 6, 16)])


def test_wasserstein_falls_from_afar_where_bins_are_flat():
    far = along(tofrender.wasserstein_loss)
    assert np.all(np.diff(far) < 0)
    # Of the window of 10 m: E|X - Y| - E|X - X'| for arrivals X, X' and Y
    assert abs(far[0] - (3 - 2 * 0.15 / np.pi**0.5) / 10) < 1e-4
    bins = along(tofrender.l2_loss)
    assert np.ptp(bins[:8]) < 1e-5
    assert abs(bins[0] - 2) < 1e-5


def test_pixels_without_light():
    """Dark pixels do not cause a division by zero, and their times are not compared."""
    rendered, target = cubes()
    rendered[0, 0], target[1, 1] = 0, 0
    attached = mi.TensorXf(rendered)
    dr.enable_grad(attached)
    loss = tofrender.wasserstein_loss(attached, target, energy_weight=0.0)
    dr.backward(loss)
    assert np.isfinite(number(loss))
    gradient = np.array(dr.grad(attached))
    assert np.isfinite(gradient).all()
    assert not gradient[1, 1].any()


def test_too_high_frequency_is_refused():
    with pytest.raises(ValueError, match=r"^frequency_hz = 3e\+08: must be below 2.99792e\+08"):
        tofrender.phasor_loss(*cubes(), frequency_hz=3e8, **AXIS)
