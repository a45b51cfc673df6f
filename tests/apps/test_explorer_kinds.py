"""Light of all kinds in the report: polarized, unknown, below 0, of one bin or channel, phasors."""

import numpy as np
import pytest
import xarray as xr
from helpers import browser
from helpers.explorer_page import (
    HEIGHT,
    WIDE,
    moving,
    opened,
    picture,
    polarized,
    set_,
    settle,
    state,
    values_of,
)
from helpers.rate_films import resting_light

import tofrender
from tofrender.apps.explorer.page_contents import contents_of
from tofrender.apps.explorer.single_page import page_of
from tofrender.cli.app import main
from tofrender.io import save_exr_layers
from tofrender.motion.frames import join_frames
from tofrender.signals.color import LUMINANCE
from tofrender.vis import luminance

INK = """name => {
  const canvas = document.querySelector(name);
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  const blue = [0x00, 0x72, 0xb2];
  let found = 0;
  for (let i = 0; i < data.length; i += 4)
    found += data[i + 3] > 200 && blue.every((each, k) => Math.abs(data[i + k] - each) < 40);
  return found;
}"""


@pytest.mark.essential
def test_polarized_light_is_shown_by_component_degree_and_angle(tmp_path):
    data = polarized()
    given = data["transient"].values[..., 0]  # y, x, bins, stokes
    contents = contents_of(data, packed=True)
    s0 = values_of(contents)[..., 0]
    for k, about in enumerate(contents.header["stokes"], 1):
        found = contents.layer(about)[0].transpose(2, 3, 0, 1)[..., 0]
        off = abs(found - given[..., k]) / (abs(given[..., k]) + about["least"])
        assert off.max() < about["ratio"] ** 0.5 - 1 + 0.5 * (abs(given[..., k]) < 0.01).any()
        large = abs(given[..., k]) > 10 * about["least"]
        assert (np.sign(found) == np.sign(given[..., k]))[large].all()
    colors = {name: contents.part(f"map {name}").reshape(256, 3) for name in ("distance", "phase")}
    y, x, bin_ = 20, 10, 22
    degree, angle = np.linspace(0.2, 1, HEIGHT)[y], np.degrees(np.linspace(0, 3, WIDE)[x])
    with opened(tmp_path, contents) as page:
        page.get_by_label("Shown").select_option("S1, 0° − 90°")
        now = set_(page, bin=bin_, pixels=[[x, y]])
        assert now["curves"][0]["values"] == pytest.approx(given[y, x, :, 1], rel=0.08, abs=1e-4)
        assert min(now["curves"][0]["values"]) < 0
        tone = np.sign(given[:, :, bin_, 1]) * abs(given[:, :, bin_, 1] * now["gain"]) ** (1 / 2.2)
        red, _, blue = np.moveaxis(picture(page), 2, 0)
        assert (red > blue)[tone > 0.2].all()  # Blue below 0, red above
        assert (red < blue)[tone < -0.2].all()
        for shown, value, map_, unit in (
            ("degree", degree, "distance", 1.0),
            ("angle", angle, "phase", 180.0),
        ):
            now = set_(page, stokes=shown)
            lit = s0[y, x] > 1e-3
            curve = np.array(now["curves"][0]["values"], float)
            assert curve[lit] == pytest.approx(np.full(lit.sum(), value), rel=0.12)
            level = round(255 * value / unit)
            assert abs(picture(page)[y, x] - colors[map_][level].astype(int)).max() < 40
        assert "Angle" in page.locator(".assumes").first.inner_text()


def test_what_is_not_finite_or_below_0_is_said(tmp_path):
    data = moving()
    data["transient"].values[4:7, 8:12, 3] = np.nan
    data["transient"].values[12:14, 3, 5] = -0.25
    with opened(tmp_path, contents_of(data)) as page:
        warnings = page.locator(".warning").all_inner_texts()
        assert warnings == [
            "12 of 768 pixels have values that are NaN or infinite; they are hatched.",
            "6 values below 0, down to -0.25, are shown as 0.",
        ]
        legend = page.locator(".assumes:has(.hatch)")
        for view in ("light", "gate", "peak"):
            set_(page, view=view)
            assert "not finite" in legend.inner_text()
            gray = picture(page)[4:7, 8:12]
            assert (gray[..., 0] == gray[..., 2]).all()
        page.locator("summary").click()
        assert page.get_by_text("All pixels and bins are there").count() == 0
    with opened(tmp_path, contents_of(moving())) as page:
        assert page.locator(".warning").count() == 0
        assert page.locator(".hatch").is_hidden()
        page.locator("summary").click()
        assert page.get_by_text("All pixels and bins are there").count() == 1


def test_a_block_with_a_pixel_that_is_not_finite_is_hatched(tmp_path):
    data = moving()
    data["transient"].values[3, 7] = np.nan  # The last pixel of a block of two by two
    contents = contents_of(data, most_bytes=40_000)
    step = contents.header["grid"]["step"]
    assert step > 1
    with opened(tmp_path, contents) as page:
        set_(page, bin=1, smooth=False)
        assert tuple(picture(page)[3 // step, 7 // step]) in ((108,) * 3, (148,) * 3)


def test_a_film_of_one_channel_says_its_colors(tmp_path):
    data = moving().isel(channel=slice(0, 1)).assign_coords(channel=["L"])
    with opened(tmp_path, contents_of(data)) as page:
        colors = page.get_by_label("Colors")
        assert colors.evaluate("select => select.selectedOptions[0].label") == "gray"


def test_a_reconstruction_opens_at_its_largest_voxel(tmp_path):
    rng = np.random.default_rng(3)
    noise = rng.uniform(0.3, 0.6, (40, 16, 16)) * np.linspace(0.2, 1.5, 40)[:, None, None]
    noise[12, 4:9, 8] = 3.0
    axes = {
        axis: np.arange(size) * 0.05 + 0.5 for axis, size in zip("zyx", noise.shape, strict=True)
    }
    volume = xr.Dataset({"intensity": (tuple("zyx"), noise.astype(np.float32))}, axes)
    with opened(tmp_path, contents_of(volume)) as page:
        assert state(page)["bin"] == 12


def test_one_bin_draws_a_point(tmp_path):
    data = moving().isel(opl=slice(20, 21))
    with opened(tmp_path, contents_of(data)) as page:
        set_(page, pixels=[[9, 9]])
        assert page.evaluate(INK, "canvas.plot") >= 9
        assert page.get_by_role("radio").all_inner_texts() == ["Light", "All time"]
        assert page.get_by_label("Play").is_hidden()
        assert page.get_by_text("Phasors").is_hidden()


def test_an_empty_selection_is_refused(tmp_path):
    for axis in ("x", "y", "opl"):
        with pytest.raises(ValueError, match=f"the axis {axis} is empty"):
            tofrender.report(moving().isel({axis: slice(0, 0)}), tmp_path / "page.html")


def test_reports_of_phasors(tmp_path, capsys):
    data = moving().assign_attrs(energy_outside_window=0.0)
    frequencies = [2e7, 7.5e7]
    parts = tofrender.transient_to_phasor(data, frequencies)
    for k, frequency in enumerate(frequencies):
        layers = {name: part[k].copy() for name, part in zip("IQ", parts, strict=False)}
        layers["I"][0, 0] = np.nan
        file = tmp_path / f"phasor_{frequency:.15g}Hz.exr"
        save_exr_layers(file, layers, {"frequency_hz": frequency})
    path = tmp_path / "page.html"
    assert main(["report", str(tmp_path), "-o", str(path)]) == 0
    with browser.page(offline=True) as page:
        page.goto(path.as_uri())
        page.wait_for_selector(".tof-explorer canvas.plane")
        now = set_(page, pixels=[[20, 5]])
        light = np.array([(parts[0] + 1j * parts[1])[k, 5, 20] @ LUMINANCE for k in range(2)])
        depth, _ = tofrender.unwrap(np.angle(light), frequencies, amplitudes=abs(light))
        assert now["phasors"][0]["unwrapped"] == pytest.approx(float(depth), abs=0.01)
        assert page.get_by_text("unwrapped (below").is_visible()
        for k, frequency in enumerate(frequencies):
            now = state(page)
            light = parts[0][k, 5, 20] @ LUMINANCE + 1j * (parts[1][k, 5, 20] @ LUMINANCE)
            assert now["frequency"] == frequency
            assert now["phasors"][0]["amplitude"] == pytest.approx(abs(light), rel=1e-3)
            assert now["phasors"][0]["phase"] == pytest.approx(np.angle(light), abs=1e-3)
            page.get_by_label("Frequency").focus()
            page.keyboard.press("ArrowRight")
        assert page.locator("canvas.plot").is_hidden()
        assert page.locator("canvas.plane").is_visible()
        assert "1 of" in page.locator(".warning").first.inner_text()
        page.evaluate("location.hash = '#f=75000000&laser=0.5'")
        settle(page)
        assert state(page)["frequency"] == frequencies[1]
        assert state(page)["laser"] == 0
        assert page.errors == []
    capsys.readouterr()
    small = {"I": np.zeros((2, 3, 3)), "Q": np.zeros((2, 3, 3))}
    save_exr_layers(tmp_path / "phasor_1000000Hz.exr", small, {"frequency_hz": 1e6})
    assert main(["report", str(tmp_path), "-o", str(tmp_path / "other.html")]) == 2
    assert "Pass files of one render" in capsys.readouterr().err
    (tmp_path / "phasor_20000000Hz.exr").write_bytes(b"text")
    assert main(["report", str(tmp_path), "-o", str(path)]) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert "must be" in said


def test_reports_of_a_gate(tmp_path):
    image = moving()["transient"].values[:, :, 22]
    attrs = {"opl": 6.2, "pulse_width_opl": 0.03, "units": "W m^-3 sr^-1", "spp": 4}
    save_exr_layers(tmp_path / "gate.exr", {"": image}, attrs)
    path = tmp_path / "page.html"
    assert main(["report", str(tmp_path), "-o", str(path), "--title", "A gate"]) == 0
    with browser.page(offline=True) as page:
        page.goto(path.as_uri())
        page.wait_for_selector(".tof-explorer canvas.plot")
        now = state(page)
        assert now["opl"] == pytest.approx(6.2)
        off = picture(page) - 255 * np.minimum(1, now["gain"] * image) ** (1 / 2.2)
        assert abs(off[image * now["gain"] > 0.01]).max() < 8
        assert page.errors == []


def test_a_page_that_was_cut_off_says_so(tmp_path):
    text = page_of(contents_of(moving(), packed=True))
    data = text.index('id="data"')
    for cut in (data - 40, data + 200, (data + len(text)) // 2, text.rindex("</script>") - 5):
        path = tmp_path / "cut.html"
        path.write_text(text[:cut], encoding="utf-8")
        with browser.page(offline=True) as page:
            page.goto(path.as_uri())
            settle(page)
            page.wait_for_function("!document.body.innerText.includes('Unpacking')")
            assert "missing or damaged" in page.locator("body").inner_text()
            assert page.locator(".tof-explorer").count() == 0


def test_numbers_of_axes_are_short(tmp_path):
    """Titles of axes have the power of ten, so that no number is as wide as to run into them."""
    data = moving()
    for name in ("transient", "steady"):
        data[name] = data[name] * 3.3e-9
    width = """() => {
      const written = [];
      const write = CanvasRenderingContext2D.prototype.fillText;
      CanvasRenderingContext2D.prototype.fillText = function (text, x, y) {
        written.push([text, this.measureText(text).width, x]);
        write.call(this, text, x, y);
      };
      document.getElementById("explorer").explorer.set({});
      return new Promise((done) => setTimeout(() => done(written), 100));
    }"""
    with opened(tmp_path, contents_of(data)) as page:
        written = page.evaluate(width)
        assert any("[10⁻¹² W m⁻² sr⁻¹]" in text for text, *_ in written)
        numbers = [(size, x) for text, size, x in written if x == 57]
        assert len(numbers) >= 3
        assert max(size for size, _ in numbers) < 35  # The title ends at 20


def test_counts_are_dots_beside_their_expectation(tmp_path):
    sensor = {"cycles": 500, "photons": {"photons_per_cycle": 0.5}, "spad": {"mode": "multi_hit"}}
    measured = tofrender.sensors.sense(moving(), sensor, seed=1)
    contents = contents_of(measured, packed=True)
    assert contents.header["quantity"] == "counts"
    found = values_of(contents)[..., 0]
    counts = measured["counts"].values
    assert found[counts > 0] == pytest.approx(counts[counts > 0], rel=0.05)
    y, x = (int(n) for n in np.unravel_index(counts.sum(axis=-1).argmax(), (HEIGHT, WIDE)))
    with opened(tmp_path, contents) as page:
        (curve,) = set_(page, pixels=[[x, y]])["curves"]
        small = counts[y, x] < 20
        assert np.array(curve["values"])[small].tolist() == counts[y, x][small].tolist()
        assert curve["values"] == pytest.approx(counts[y, x], rel=0.05)
        (line,) = curve["orders"]
        expected = measured["expected"].values[y, x]
        assert line["name"] == "expectation"
        assert line["values"] == pytest.approx(expected, rel=0.05, abs=0.01 * expected.max())
        legend = page.locator(".legend").inner_text()
        assert "Dots are counts, the line is of pixel 1" in legend
        assert page.evaluate(INK, ".plot") > 9 * np.unique(counts[y, x]).size  # Dots of 3 x 3


def test_frames_of_an_animation(tmp_path):
    frames = [moving().assign_attrs(time_s=0.25 * k + 0.5) for k in range(3)]
    for k, frame in enumerate(frames):
        for name in ("transient", "steady"):
            frame[name].values[:] = np.roll(frame[name].values, 3 * k, axis=0) * (1 + k)
    contents = contents_of(join_frames(frames, complete=True), packed=True)
    with opened(tmp_path, contents) as page:
        slider = page.get_by_label("Frame")
        assert slider.get_attribute("max") == "2"
        for k, frame in enumerate(frames):
            now = set_(page, laser=k, view="light", bin=25, pixels=[[20, 11]])
            given = luminance(frame["transient"].values[11, 20])
            np.testing.assert_allclose(
                now["curves"][0]["values"], given, rtol=0.08, atol=1e-3 * given.max()
            )
            now = set_(page, view="total", colors="color")
            expected = 255 * np.minimum(1, now["gain"] * frame["steady"].values) ** (1 / 2.2)
            assert np.abs(picture(page) - expected).max() < 12
            assert f"{k + 1} of 3 at {0.25 * k + 0.5:g} s" in page.locator(".look").inner_text()


@pytest.mark.parametrize("pixels", [[], [[2, 1]]])
def test_light_at_rest_is_a_bright_row_of_the_range_velocity_map(tmp_path, pixels):
    """80 % of the light lies in one of 2003 rows, and the map has fewer rows of dots."""
    with opened(tmp_path, contents_of(resting_light())) as page:
        set_(page, pixels=pixels)
        map_ = page.locator("canvas[aria-label^='Light over range']")
        found = map_.evaluate(
            """canvas => {
              const { width, height } = canvas;
              const { data } = canvas.getContext("2d").getImageData(0, 0, width, height);
              return { width, height, bytes: [...data] };
            }"""
        )
        dots = np.array(found["bytes"]).reshape(found["height"], found["width"], 4)
        bright = (dots[..., :3].sum(axis=2) > 450) & (dots[..., 3] > 0)
        bright &= dots[..., 0] > dots[..., 2] + 60  # Yellow and orange, not letters on the page
        assert (bright.sum(axis=1) > 0.6 * found["width"]).sum() in (1, 2, 3)
