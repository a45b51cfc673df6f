"""What README and docs print of speed is what was measured last."""

import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def report(monkeypatch):
    monkeypatch.syspath_prepend(ROOT)
    return importlib.import_module("benchmarks.report")


@pytest.fixture
def results() -> dict:
    return json.loads((ROOT / "benchmarks" / "results.json").read_text(encoding="utf-8"))


def test_the_readme_and_the_page_have_the_figures(report, results):
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    page = report.PAGE.read_text(encoding="utf-8")
    assert report.with_block(readme, results) == readme
    assert report.readme_block(results) in readme
    assert report.page(results) == page
    results["scenes"]["Cornell box"]["mitransient"]["cube"] *= 2  # would be another page
    assert report.with_block(readme, results) != readme
    assert report.page(results) != page


def test_what_is_known_of_gpus(report, tmp_path):
    assert "was not measured on a GPU" in report.gpu_section(tmp_path / "missing.json")
    row = {"64": {"over_path": 1.234}, "1024": {"over_path": 1.1}}
    programs = {"path": row, "one light point": row, "ours": row, "mitransient": "not installed"}
    machine = {"cards": ["NVIDIA X1, 80 GiB"], "driver": "580.1", "variant": "cuda_ad_rgb"}
    found = {
        "small": False,
        "machine": machine | {"versions": {"tofrender": "0.1.0"}},
        "parts": {"times": {"results": {"mirror": programs, "targets": []}}},
    }
    file = tmp_path / "gpu.json"
    file.write_text(json.dumps(found))
    section = report.gpu_section(file)
    assert "not measured" not in section
    assert "on NVIDIA X1, 80 GiB, driver 580.1" in " ".join(section.split())
    assert "| mirror | 64 | 1.2 | 1.2 | - |" in section
    file.write_text(json.dumps(found | {"small": True}))
    with pytest.raises(ValueError, match="has small sizes"):
        report.gpu_section(file)


@pytest.mark.parametrize(
    ("value", "shown"), [(1.0, "1"), (253.1, "250"), (0.984, "0.98"), (12.4, "12"), (2.05, "2")]
)
def test_two_digits(report, value, shown):
    assert report.digits(value) == shown


def test_the_page_on_what_is_lost_has_its_figures(monkeypatch):
    monkeypatch.syspath_prepend(ROOT)
    lost = importlib.import_module("benchmarks.lost")
    results = json.loads((ROOT / "benchmarks" / "lost.json").read_text(encoding="utf-8"))
    page = (ROOT / "docs" / "checkpoints.md").read_text(encoding="utf-8")
    assert lost.with_tables(page, results) == page
    assert lost.table(results) in page
    results["found"]["saving"]["save_s"] *= 2
    assert lost.with_tables(page, results) != page


def test_figures_are_those_of_the_code():
    """In a process of its own: kernels contain what other scenes of a process have, too."""
    command = [sys.executable, "-m", "benchmarks.full", "--check"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_stale_figures_are_found(monkeypatch):
    monkeypatch.syspath_prepend(ROOT)
    stale = importlib.import_module("benchmarks.operations").stale
    assert not stale({"box": [1000, 500]}, {"box": [1010, 500]})
    assert stale({"box": [1000, 500]}, {"box": [1030, 500]})
    assert stale({"box": [1000]}, {"box": [1000, 500]})
    assert stale({}, {"box": [1000]})
