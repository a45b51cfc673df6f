"""The notebooks run from start to end at small size, and their key numbers come out."""

import importlib.util
import json
import re
import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest

import tofrender

ROOT = Path(__file__).parents[2]
NOTEBOOKS = ROOT / "notebooks"

# What must hold of a notebook's variables after its last cell
KEY_NUMBERS = {
    "00_sampling_and_path_tracing": """
        assert -0.6 < slopes["independent"] < -0.4, slopes
        assert -0.9 < slopes["stratified"] < -0.6, slopes
        assert suite.passed and passing.passed and image_verdict.passed
        assert all(verdict.passed for verdict in light_verdicts.values())
        assert not broken.passed and "integrates to 1.043" in broken.reason, broken.reason
        assert consistent.passed and "mean of z (known)" in known.reason, known.reason
        (by_cosine_mean, by_cosine_sd), (by_light_mean, by_light_sd) = irradiance.values()
        assert abs(by_cosine_mean - by_light_mean) < 5 * by_cosine_sd / 256, irradiance
        assert by_light_sd < 0.2 * by_cosine_sd, irradiance
        assert 0 < occlusion.min() < 0.3 and occlusion.max() == 1, occlusion
        assert agreement > 0.9, agreement
        large_in_smooth = deviation["smooth plate", "large lights"]
        assert large_in_smooth["nee"] > 20 * large_in_smooth["mats"], large_in_smooth
        small_in_rough = deviation["roughest plate", "small lights"]
        assert small_in_rough["mats"] > 5 * small_in_rough["nee"], small_in_rough
        for row in deviation.values():
            assert row["mis"] < 1.4 * min(row["mats"], row["nee"]), deviation
        assert max(sphere_means) < 1.002 * min(sphere_means), sphere_means
        assert max(wall_light.values()) < 1.01 * min(wall_light.values()), wall_light
        assert all(error < 0.2 for error in sphere_errors.values()), sphere_errors
        for means in growth.values():
            assert all(np.diff(means) > 0), growth
        for noise in (veach_noise, box_noise):
            for name, row in noise.items():
                for mean, spread in row.values():
                    error = np.hypot(spread, row["mis"][1]) / SEEDS**0.5
                    assert abs(mean - row["mis"][0]) < 5 * error, (name, row)
        assert veach_noise["wall"]["mats"][1] > 3 * veach_noise["wall"]["nee"][1], veach_noise
        glossy = veach_noise["glossy plate, large light"]
        assert glossy["nee"][1] > 10 * glossy["mats"][1], veach_noise
        assert box_noise["back wall"]["mats"][1] > 5 * box_noise["back wall"]["nee"][1], box_noise
        spot = [spread for _, spread in box_noise["below the glass sphere"].values()]
        assert max(spot) < 2.5 * min(spot), box_noise
    """,
    "01_pulses_and_gates": """
        assert all(abs(integral - 1) < 2e-3 for integral in integrals.values()), integrals
        assert cube.shape == (SIZE, SIZE, 300, 3)
        assert abs(difference) < 0.15, difference
        assert 0.93 < ratio_text < 0.98, ratio_text
        assert abs(ratio_longer - 1) < 0.01, ratio_longer
    """,
    "02_amcw_and_phasors": """
        medians = [result.median for result in errors]
        assert 0.15 < medians[0] < 0.40 and medians[0] > medians[1] > medians[2], medians
        assert all(abs(result.median) < 0.005 for result in errors_direct), errors_direct
        assert 0 < offset_pair < 0.2, offset_pair
        assert abs(reach_pair - 14.99) < 0.01, reach_pair
        assert abs(far_unwrapped - 11) < 1e-6, far_unwrapped
        assert apart["half the path, ceiling light"] > 2 * apart["half the path, flash"], apart
        assert 0 < 2 * spread[0.0] < spread[20.0], spread
    """,
    "03_film_and_transient_path": """
        assert 0.02 < lost < 0.06 and abs(kept + lost - 1) < 1e-4, (kept, lost)
        assert whole.attrs["energy_outside_window"] < 1e-6
        assert task_1 < 0.003, task_1
        assert max(same_seed) < 0.005, same_seed
        assert len(ratios) == 6 and all(0.7 < ratio < 1.4 for ratio in ratios.values()), ratios
        assert all(abs(score) < 5 for score in scores.values()), scores
        assert shifts[0] < -0.04e3, shifts
        assert all(abs(found / expected - 1) < 2e-4 for found, expected in dimming), dimming
        assert film_gap < 1e-4, film_gap
    """,
    "04_confocal_nlos": """
        for tilt, (found, formula, mean_opl, length) in patch.items():
            assert abs(found / formula - 1) < 5e-3, (tilt, found, formula)
            assert abs(mean_opl - length) < 2e-3, (tilt, mean_opl, length)
        first_hidden = 2 * d + 2.0  # the letter is 1 m from the wall
        assert max(abs(arrives["filter_bounces = 1"][k] - 2 * d) for k in (1, 2)) < 0.03, arrives
        for name in ("use_nlos_only", "filter_bounces = 3"):
            assert abs(arrives[name][1] - first_hidden) < 0.03, arrives
        assert arrives["filter_bounces = 5"][1] > first_hidden + 1.9, arrives
        parts = [arrives[f"filter_bounces = {n}"][0] for n in (3, 5)]
        assert abs(sum(parts) / arrives["use_nlos_only"][0] - 1) < 0.01, arrives
        assert 1e5 < relay_over_hidden < 1e7, relay_over_hidden
        assert all(abs(a / b - 1) < 0.01 for a, b in spots.values()), spots
        assert spots[0.3][0] < 0.75 * spots[0.0][0], spots
        assert variance_ratio > 50, variance_ratio
        assert abs(means[True] / means[False] - 1) < 0.2, means
        assert early == 0 and sphere_ratio > 1e6, (early, sphere_ratio)
        assert min(first_light) > -0.12 and np.median(first_light) < 0.05, first_light
        assert all(error < 6e-3 for error in arrival_error.values()), arrival_error
        assert place_error < 2e-3, place_error
    """,
    "05_reconstruction": """
        assert file_error < 1e-5, file_error
        assert all(error.median < 0.02 for error in errors.values()), errors
        assert all(errors[name].median < 1.5e-3 for name in ("lct", "fk")), errors
        assert all(errors[name].found > 0.8 for name in ("bp", "fbp", "lct", "fk")), errors
        for name in ("fbp", "lct", "fk", "phasor"):
            assert errors[name].extra < 0.7 * errors["bp"].extra, errors
        assert abs(np.nanmedian(truth) - 1) < 1e-4, truth
        for name in ("lct", "fk"):
            assert noise_errors[name, 1000].median < 2e-3, noise_errors
            assert noise_errors[name, 1].median < 0.05, noise_errors
            assert bin_errors[name, 1].median < 1.5e-3, bin_errors
            assert bin_errors[name, 10].median < 0.015, bin_errors
        assert "a single capture on an even plane grid allows bp, fbp, phasor" in refused, refused
        assert all(error.median < 0.03 for error in single_errors.values()), single_errors
        assert bunny_error.median < 0.01 and bunny_error.found > 0.4, bunny_error
    """,
    "06_light_tracing_in_time": """
        assert abs(found - predicted) < 0.1, (found, predicted)
        assert gain > 20, errors
        assert min(mask.sum() for mask in regions.values()) > 3, regions
        light = pyramid["steady"].sel(weighting="none").sum(("y", "x", "channel"))
        assert float(light.sel(strategy="4,1")) > 0, light
        assert abs(float(shares.sum()) - 1) < 1e-5, shares
    """,
    "07_fog_and_polarization": """
        assert in_gap["clear"] < 0.005 and in_gap["fog"] > 0.05, in_gap
        assert len(moments) == 12
        for found, exact, error in moments:
            assert abs(found - exact) < 4.5 * error < 0.2 * exact, moments
        assert too_far[2] > 0.4 and gaps[2] > 0.3 and walked[2] < 0.6, (too_far, gaps, walked)
        assert too_far[20] < 1e-3 and gaps[20] < 0.06, (too_far, gaps)
        assert 0.92 < walked[20] < 0.98, walked
        for (thickness, g), (found, expected) in rates.items():
            if thickness == 1.0:
                assert abs(found / expected - 1) < 0.1, rates
        assert rates[0.1, 0.0][0] > 1.02 * rates[0.1, 0.0][1], rates
        assert all(abs(ratio - 1) < 0.06 for ratio in absorbed.values()), absorbed
        assert abs(contrast_steady) < 0.15 and contrast_gated > 0.8, contrast_gated
        assert 0.001 < in_gate < 0.01, in_gate
        assert sky_error < 0.04, sky_error
        assert first_degree > 0.93 and sign_degree < 0.2, degrees
        for plate, vectors in by_plate.values():
            assert abs(plate / vectors - 1) < 0.15, by_plate
        plain, crossed = (seen["steady"][key] for key in ("no analyzer", "crossed"))
        assert plain < 0.15 and crossed > 0.45, seen
        gate_row = seen["gate 8.0 to 8.2 m"]
        assert gate_row["crossed"] > max(0.95, gate_row["no analyzer"]), seen
        assert dense[0.05][1] > 0.85 and dense[0.5][1] < 0.3, dense
        assert all(steady < 0.4 < timed for steady, _, timed in dense.values()), dense
    """,
    "08_gradients_in_time": """
        assert 2.05 < later < 2.12, later
        assert derivative_error < 0.01, derivative_error
        assert np.all(np.diff(on_the_way["Wasserstein"]) < 0), on_the_way
        assert np.all(np.diff(on_the_way["bins"])[:6] > 0), on_the_way
        assert np.all(np.diff(on_the_way["phasors, 100 MHz"]) < 0), on_the_way
        assert walls["l2"].values["albedo"] < 0.05 and walls["l2"].values["depth"] > 2.5, walls
        assert wall_error["depth"] < 2e-3 and wall_error["albedo"] < 5e-3, wall_error
        assert lamp_error < 0.02 and power_error < 0.15, (lamp_error, power_error)
        assert 0.0995 < start_off < 0.1005, start_off
        assert place_error < 2e-3 and tilt_error < 0.2, (place_error, tilt_error)
    """,
    "09_photons": """
        assert 0.94 < chi_square < 1.06, chi_square
        assert lost > 0.8 and abs(left) < 0.05, (lost, left)
        ratios = np.array(errors) / bounds
        assert ((0.9 < ratios) & (ratios < 1.4)).all(), ratios
        assert abs(bias["SPAD"]) < 0.003 and bias["iToF"] > 0.02, bias
        assert 0.98 < ratio < 1.02, ratio
    """,
    "10_motion": """
        assert 20 < fastest < 31, fastest
        assert peaks[2 * SPEED] > 3 * peaks[0] > 0 and peaks[4 * SPEED] > 0, peaks
        assert typical > 10 and error < 0.3 and still < 0.01, (typical, error, still)
        assert rest == 0, rest
        assert 1 < float(np.abs(rolling - sharp.isel(frame=[0]))["steady"].max()) * 20
    """,
}

# Each warning that a notebook is to show, in order
WARNINGS = {
    "03_film_and_transient_path": ["arrives outside", "missing from the phasors"],
    "04_confocal_nlos": ["arrives outside"] * 3,
    "05_reconstruction": ["arrives outside"] * 2,
    "08_gradients_in_time": ["leave out what becomes visible or hidden"],
}


def read(name: str) -> dict:
    return json.loads((NOTEBOOKS / f"{name}.ipynb").read_text(encoding="utf-8"))


def test_all_notebooks_are_tested():
    assert sorted(path.stem for path in NOTEBOOKS.glob("*.ipynb")) == sorted(KEY_NUMBERS)


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="not a clone")
@pytest.mark.parametrize("name", KEY_NUMBERS)
def test_git_has_no_outputs(name):
    """Those of the file in the working folder stay there."""
    command = ["git", "show", f":notebooks/{name}.ipynb"]
    stored = subprocess.run(command, cwd=ROOT, capture_output=True, check=True).stdout
    notebook = json.loads(stored)
    assert set(notebook["metadata"]) <= {"kernelspec", "language_info"}
    for cell in notebook["cells"]:
        assert cell["metadata"] == {}
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            assert cell["execution_count"] is None


@pytest.mark.parametrize("name", KEY_NUMBERS)
def test_tells_what_it_is_about(name):
    cells = read(name)["cells"]
    text = "\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "markdown")
    for part in ("**Overview.**", "**What you will learn**", "## Set-up", "## See also"):
        assert part in text
    for target in re.findall(r"\]\(([^():\s]+)\)", text):
        assert (NOTEBOOKS / target).exists(), target
    assert not re.search(r"`\S+\.(ipynb|md)`", text)  # Links instead


@pytest.mark.parametrize("there", [True, False])
@pytest.mark.parametrize("name", KEY_NUMBERS)
def test_installs_itself_on_hosted_services(name, there, monkeypatch):
    """The first code cell installs an uploaded wheel, if the package is missing."""
    transformer = pytest.importorskip("IPython.core.inputtransformer2")
    cell = next(cell for cell in read(name)["cells"] if cell["cell_type"] == "code")
    program = transformer.TransformerManager().transform_cell("".join(cell["source"]))
    found = None if not there else importlib.util.find_spec("tofrender")
    monkeypatch.setattr("importlib.util.find_spec", lambda package: found)
    done = []
    shell = SimpleNamespace(
        run_line_magic=lambda *words: done.append(" ".join(words)), system=done.append
    )
    exec(program, {"get_ipython": lambda: shell})
    wheel = '"$(ls tofrender-*.whl)[explore]"'
    llvm = "tofrender doctor || (wget -qO- https://apt.llvm.org/llvm.sh | bash -s -- 19)"
    assert done == ([] if there else [f"pip install -q {wheel}", llvm])


def test_jupyter_asks_nothing_over_the_figures():
    loader = pytest.importorskip("traitlets.config.loader")
    settings = loader.PyFileConfigLoader("jupyter_config.py", str(ROOT / ".ci")).load_config()
    page = settings.ServerApp.tornado_settings["page_config_hook"](None, {"disabledExtensions": []})
    assert page["disabledExtensions"] == ["@jupyterlab/apputils-extension:announcements"]
    assert "pre_save_hook" not in settings.ContentsManager  # What is saved keeps its outputs


@pytest.mark.parametrize("name", KEY_NUMBERS)
def test_runs_from_start_to_end(name, tmp_path, monkeypatch):
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    monkeypatch.setenv("TOFRENDER_NOTEBOOK_SIZE", "small")
    monkeypatch.setenv("PYTHONWARNINGS", "default")
    for folder in ("IPYTHONDIR", "JUPYTER_RUNTIME_DIR"):  # nothing of the user's
        monkeypatch.setenv(folder, str(tmp_path))
    notebook = nbformat.read(NOTEBOOKS / f"{name}.ipynb", as_version=4)
    same_package = f"assert tofrender.__file__ == {tofrender.__file__!r}, tofrender.__file__"
    for code in (same_package, "if True:" + KEY_NUMBERS[name]):
        notebook.cells.append(nbformat.v4.new_code_cell(code))
    nbclient.NotebookClient(notebook, resources={"metadata": {"path": str(NOTEBOOKS)}}).execute()

    outputs = [o for c in notebook.cells if c.cell_type == "code" for o in c.outputs]
    errors = "".join(o.text for o in outputs if o.get("name") == "stderr")
    shown = re.findall(r"\w*Warning: .*", errors)
    expected = WARNINGS.get(name, [])
    assert len(shown) == len(expected), shown
    assert all(text in line for text, line in zip(expected, shown, strict=True)), shown
    assert sum("image/png" in o.get("data", {}) for o in outputs) >= 5
