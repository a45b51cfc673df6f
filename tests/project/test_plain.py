"""The check of `make lint` for unpacked code and plain words."""

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

VIOLATIONS = {
    "x, y = 1, 2": "1: packed assignment",
    "a = 0\nself.x, b = [], a": "2: packed assignment",
    "x = [*(1, 2)]": "1: starred literal",
    "x = f(*[1, 2])": "1: starred literal",
    'def f():\n    """Return what\n    the file tells."""': '3: "tells"',
    'def f():\n    """Return all but\n    for one."""': '2: "but for"',
    'raise ValueError(f"{x}: will go on")': '1: "go on"',
    'warnings.warn("use y, else z")': '1: ", else"',
    'x = Option(help="Size beside the box.")': '1: "beside"',
}

ALLOWED = '''"""Continue with `tell`.

    tell: Function that is called.

    >>> print("go on")
"""
x, y = y, x
sine, cosine = sine * a, sine + cosine
low, high = f(x)
z = [*x, 1]
print("tells")
'''


@pytest.fixture
def plain():
    """Import the check."""
    spec = importlib.util.spec_from_file_location("plain", ROOT / ".ci/plain.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("source", VIOLATIONS)
def test_each_kind_of_violation_is_found(plain, source, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("made.py").write_text(source)
    assert plain.main(["made.py"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith(f"made.py:{VIOLATIONS[source]}")


def test_swaps_code_and_names_of_parameters_are_allowed(plain, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("made.py").write_text(ALLOWED)
    assert plain.main(["made.py"]) == 0
    assert not capsys.readouterr().out


def test_old_places_are_allowed_up_to_the_limit(plain, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(plain, "LIMITS", {"tofrender/old": 2})
    Path("tofrender/old").mkdir(parents=True)
    for count, status in ((2, 0), (3, 1)):
        Path("tofrender/old/made.py").write_text("x, y = 1, 2\n" * count)
        assert plain.main([]) == status
        assert len(capsys.readouterr().out.splitlines()) == count * status


def test_limits_are_of_packages_that_exist(plain):
    assert all((ROOT / package).is_dir() for package in plain.LIMITS)
