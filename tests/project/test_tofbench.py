"""tofbench: its verdicts under the null and with planted bugs, its data, commands and page."""

import ast
import json
import math
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.tofbench import closed, forms, report, running, verdicts
from benchmarks.tofbench.table import all_cases

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "benchmarks" / "tofbench"
STAND_IN = str(ROOT / "tests" / "helpers" / "tofbench_stand_in.py")
BY_NAME = {case.name: case for case in all_cases()}


def command(*options: str, cwd=ROOT, **env: str) -> subprocess.CompletedProcess:
    line = [sys.executable, "-m", "benchmarks.tofbench", *options]
    settings = os.environ | {"PYTHONPATH": str(ROOT)} | env
    return subprocess.run(line, cwd=cwd, env=settings, capture_output=True, text=True)


def by_stand_in(names: list[str], **env: str) -> dict:
    with pytest.MonkeyPatch.context() as patch:
        for key, value in (env | {"PYTHONPATH": str(ROOT)}).items():
            patch.setenv(key, value)
        renderer = running.describe(STAND_IN)
        cases = [BY_NAME[name] for name in names]
        return running.run(renderer, cases, 16, among=list(BY_NAME.values()))


@pytest.mark.statistical
def test_false_alarms_over_all_cases():
    """200 suites by photon noise: with alpha at .2, no more than that fail, and not none."""
    cases = [case for case in closed.CASES if case.expected.size < 500]
    weights = [verdicts.readings_of(case) for case in cases]
    allowed = verdicts.threshold(sum(map(len, weights)), 0.2)
    rng, failed, suites = np.random.default_rng(5), 0, 200
    for _ in range(suites):
        for case in cases:
            expected = np.broadcast_to(case.expected, (*case.pixels, case.expected.shape[-1]))
            unit = np.abs(expected).sum() / 40000
            runs = rng.poisson(np.abs(expected) / unit, (8, *expected.shape)) * unit
            found = verdicts.judge(case, np.sign(expected) * runs, 0.1, allowed)
            if found.status != "passed":
                failed += 1
                break
    assert 0.02 * suites < failed < 0.2 * suites + 3 * math.sqrt(0.16 * suites)


def test_a_right_stand_in_passes_all_closed_forms():
    found = by_stand_in([case.name for case in closed.CASES])
    assert {verdict.status for verdict in found.values()} == {"passed"}


BUGS = {
    "factor 2": ["plane", "pixels", "furnace-all", "nlos-single", "gates", "gradient-height"],
    "one bin": ["plane", "floor", "furnace-3", "slab", "fog-isotropic", "moving-mirror"],
    "missing index": ["slab", "slab-tilted", "glass-ball", "phasors", "slab-stokes"],
    "energy lost": ["plane", "floor", "furnace-1", "chords", "half-space", "two-mirrors"],
}


@pytest.mark.parametrize("bug", BUGS)
def test_planted_bugs(bug):
    found = by_stand_in([*BUGS[bug], "mirror"], STAND_IN_BUG=bug)
    expected = dict.fromkeys(BUGS[bug], "failed")
    expected["mirror"] = "passed" if bug == "missing index" else "failed"
    assert {name: verdict.status for name, verdict in found.items()} == expected


def test_a_crash_ends_one_case_only():
    found = by_stand_in(["plane", "fog-null", "mirror"], STAND_IN_BUG="abort")
    assert [v.status for v in found.values()] == ["passed", "error", "passed"]
    assert "process ended" in found["fog-null"].note


BUGS_OF_A_COPY = {
    "none": ("", "", "passed"),
    "factor 2": ("return found.values[..., 0]", "return 2 * found.values[..., 0]", "failed"),
    "one bin": (
        "return found.values[..., 0]",
        "return np.roll(found.values[..., 0], 1, axis=-1)",
        "failed",
    ),
}


@pytest.mark.parametrize("bug", ["none", "factor 2", "one bin"])
def test_bugs_in_a_copy_of_an_adapter(bug, tmp_path):
    old, new, status = BUGS_OF_A_COPY[bug]
    text = (FOLDER / "adapters" / "tofrender.py").read_text()
    assert old in text
    copy = tmp_path / "copy.py"
    copy.write_text(text.replace(old, new))
    cases = [BY_NAME["plane"], BY_NAME["window"], BY_NAME["furnace-1"]]
    found = running.run(running.describe(str(copy)), cases, 4, 0.25, among=all_cases())
    assert {verdict.status for verdict in found.values()} == {status}


def test_steady_renderers_and_delays_are_judged_by_what_they_can():
    slab = BY_NAME["slab"].form_for(frozenset({"steady", "glass", "camera"}))
    assert slab.expected == pytest.approx([(1 - 0.25) / (1 + 0.25)])
    assert BY_NAME["slab"].form_for(frozenset({"steady", "camera"})) is None
    assert BY_NAME["window"].form_for(frozenset({"steady", "camera"})) is None
    room = BY_NAME["mirror-room"].form_for(frozenset({"delays", "mirror"}))
    assert room.expected.sum() == 6
    right = np.tile(room.expected, (4, 1, 1, 1))
    assert verdicts.judge(room, right, 0.1, 1e-6).status == "passed"
    assert verdicts.judge(room, np.roll(right, 1, -1), 0.1, 1e-6).status == "failed"


@pytest.mark.parametrize("wrong", [np.nan, "shape"])
def test_what_cannot_be_compared_fails(wrong):
    case = BY_NAME["plane"]
    runs = np.zeros((4, 1, 1, 63)) if wrong == "shape" else np.full((4, 1, 1, 64), wrong)
    assert verdicts.judge(case, runs, 0.1, 1e-6).status == "failed"


def test_formulas_against_known_numbers():
    """Numbers of tables, of independent integration or Monte Carlo."""
    assert BY_NAME["plane"].expected.sum() == pytest.approx(0.10172586, abs=1e-8)
    opl, light, pixel = forms.floor_in_view(2.0, 40.0, (1, 1), (0.5, 0.0, 3.0), 1.0, 0.5)
    assert pixel.max() == 0
    assert light.sum() == pytest.approx(0.016115306, rel=1e-5)
    assert (opl * light).sum() / light.sum() == pytest.approx(5.1765880, rel=1e-5)
    assert forms.slab(1.5, 1.0, 0.3, 40.0)[1][:2] == pytest.approx([0.91161175, 0.0026345074])
    assert forms.slab_unpolarized(1.5, 40.0)[:2] == pytest.approx([0.91062428, 0.0019046309])
    assert forms.half_space(0.9, 1.0) == pytest.approx(0.41495, abs=1e-5)
    assert forms.half_space(0.9, 0.6) == pytest.approx(0.48585, abs=1e-5)
    assert BY_NAME["fog-isotropic"].expected.sum() == pytest.approx(0.03865337, rel=1e-5)
    lens = 5 * 0.09 / (0.5298973 * 4)
    assert BY_NAME["thin-lens"].expected.sum() == pytest.approx(lens, rel=1e-6)
    assert BY_NAME["gradient-height"].expected == pytest.approx([0.03312451, 0.06296146], abs=1e-8)
    assert BY_NAME["two-mirrors"].expected.max() == pytest.approx(0.00820612, abs=1e-8)
    assert sum(forms.fresnel(1.5, math.cos(math.pi / 4))) / 2 == pytest.approx(0.0502399, abs=1e-7)
    ear = BY_NAME["furnace-ear"].expected.sum()
    assert ear == pytest.approx(sum(0.8**k for k in (1, 2, 3)) / math.pi)


def test_no_light_at_the_edge_of_a_bin():
    """Single paths are a hundredth of a bin or more from an edge, so that rounding moves none."""
    bins = {"plane": [closed.lamp_path(BY_NAME["plane"].scene)[0]]}
    mirror = BY_NAME["mirror"].scene
    bins["mirror"] = [closed.lamp_path(mirror, *closed.at_mirror(mirror))[0]]
    for name in ("slab", "slab-tilted", "glass-ball"):
        bins[name] = closed.slab_orders(BY_NAME[name].scene)[0][:4]
    for name, lengths in bins.items():
        window = BY_NAME[name].bins
        position = (np.array(lengths) - window["start"]) / window["width"] % 1
        assert np.all((position > 0.01) & (position < 0.99)), name


def test_only_adapters_import_renderers():
    """The package can be copied out: it imports itself, NumPy, SciPy and the standard library."""
    for path in FOLDER.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and not node.level:
                names = [node.module]
            known = {"numpy", "scipy", *sys.stdlib_module_names}
            if path.parent.name != "adapters":
                assert {name.split(".")[0] for name in names} <= known, path
            elif path.stem not in ("tofrender",):
                assert "tofrender" not in names, path


def test_copied_out(tmp_path):
    shutil.copytree(FOLDER, tmp_path / "bench", ignore=shutil.ignore_patterns("__pycache__"))
    line = [sys.executable, "-m", "bench", "--list"]
    done = subprocess.run(line, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "furnace-all" in done.stdout
    assert "reference-cornell" in done.stdout


def test_references_are_complete():
    assert (FOLDER / "data" / "LICENSE").read_text().startswith("CC0")
    assert sum(path.stat().st_size for path in (FOLDER / "data").glob("*.npz")) < 4e6
    paths = sorted((FOLDER / "data").glob("*.json"))
    assert len(paths) == 6
    for path in paths:
        described = json.loads(path.read_text())
        case = BY_NAME[f"reference-{path.stem}"]
        shape = (*case.pixels, described["bins"]["count"])
        assert case.expected.shape == case.error.shape == shape
        error = np.sqrt((case.error**2).sum()) / case.expected.sum()
        assert 0 < error < 1e-3, path
        xml = path.with_suffix(".xml").read_text()
        assert all(f'name="{name}"' in xml for name in described["scene"]["shapes"])


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ([], "--renderer: must be one or more of misuka, mitransient"),
        (["--renderer", "nope"], "--renderer = 'nope': must be one of misuka"),
        (["--renderer", STAND_IN, "--case", "plain"], "--case = 'plain': must be one of plane"),
        (["--renderer", STAND_IN, "--runs", "3"], "--runs = 3: must be 4 or more"),
        (["--renderer", STAND_IN, "--samples", "0"], "--samples = 0.0: must be above 0"),
        (["--renderer", STAND_IN, "--python", "x"], "--python = 'x': must be RENDERER=PATH"),
    ],
)
def test_bad_option(options, text):
    done = command(*options)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith(f"tofbench: error: {text}")
    assert len(done.stderr.splitlines()) == 1


def test_page_is_what_its_results_say():
    from benchmarks import tofbench_page

    results = json.loads(tofbench_page.RESULTS.read_text(encoding="utf-8"))
    assert tofbench_page.PAGE.read_text(encoding="utf-8") == tofbench_page.page(results)
    assert list(results["cases"]) == list(BY_NAME)
    assert sum(each["version"] is not None for each in results["renderers"].values()) >= 4


def test_missing_renderer_is_refused_in_one_line():
    done = command("--renderer", "umcx", UMCX="/nowhere/umcx")
    assert done.returncode == 2
    assert done.stderr.startswith("tofbench: umcx: not installed (build umcx")
    assert len(done.stderr.splitlines()) == 1


def test_command_writes_table_and_json(tmp_path):
    names = ["plane", "window", "slab"]
    options = [part for name in names for part in ("--case", name)]
    done = command(
        *("--renderer", STAND_IN, "--renderer", "umcx", "--quick", "--out", str(tmp_path)),
        *options,
        UMCX="/nowhere/umcx",
    )
    assert done.returncode == 0, done.stderr
    results = json.loads((tmp_path / "tofbench.json").read_text())
    found = results["renderers"][STAND_IN]
    assert {name: v["status"] for name, v in found["verdicts"].items()} == dict.fromkeys(
        names, "passed"
    )
    assert results["renderers"]["umcx"] == {"version": None, "verdicts": {}}
    text = (tmp_path / "tofbench.html").read_text()
    assert text.count("not run") == 4
    assert report.markdown(results).count("passed") >= 3
