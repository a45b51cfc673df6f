"""`python -m benchmarks` refuses what it does not know before it measures anything."""

import importlib
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def main(monkeypatch):
    monkeypatch.syspath_prepend(ROOT)
    module = importlib.import_module("benchmarks.__main__")
    for name in module.CASES:
        monkeypatch.setitem(module.CASES, name, lambda *_: pytest.fail("a case was run"))
    return module.main


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["sped"], "CASE = 'sped': must be one of speed, bins, error, memory, import"),
        (["speed", "nope"], "CASE = 'nope': must be one of speed"),
        (["--runs", "0"], "--runs = 0: must be 1 or more"),
        (["--runs", "many"], "argument --runs: invalid int value: 'many'"),
    ],
)
def test_bad_argument(main, monkeypatch, capsys, arguments, text):
    monkeypatch.setattr(sys, "argv", ["benchmarks", *arguments])
    with pytest.raises(SystemExit) as exit:
        main()
    assert exit.value.code == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines()[-1].startswith("python -m benchmarks: error: ")
    assert text in err.splitlines()[-1]
    assert err.count("error:") == 1


def test_numbers_with_their_error():
    from benchmarks.case_gradients import with_error

    assert with_error(0.032504, 0.0000012) == "0.0325040(12)"
    assert with_error(-12.34, 0.5) == "-12.34(50)"
    assert with_error(0.0325, 0.0) == "0.0325"
    assert with_error(float("nan"), 1.0) == "nan(1)"
