"""What a handout does not allow is found, whatever it is called, and nothing else is."""

from pathlib import Path

import mitsuba as mi
import pytest

from tofrender.course import rubric
from tofrender.course.judge import forbidden

ALL = frozenset(rubric.FORBIDDEN)

USES = {
    "mi.warp": [
        "import mitsuba as mi\ndef f(u): return mi.warp.square_to_tent(u)",
        "from mitsuba import warp",
        "from mitsuba.warp import square_to_tent",
        "import mitsuba.warp as w",
        "import mitsuba as mi\nw = getattr(mi, 'warp')",
        "import importlib\nw = importlib.import_module('mitsuba.warp')",
    ],
    "Mitsuba's integrator 'path'": [
        "x = {'type': 'path', 'max_depth': 4}",
        "x = {'integrator': {'max_depth': 4, 'type': 'path'}}",
        "x = dict(type='path')",
    ],
    "mi.ad": ["import mitsuba as mi\nB = mi.ad.common.ADIntegrator", "from mitsuba.ad import x"],
    "sample_emitter_direction": ["def f(scene): return scene.sample_emitter_direction(1, 2)"],
    "pdf_direction": ["def f(x): return getattr(x, 'pdf_direction')(1)"],
}


@pytest.mark.parametrize(
    ("said", "text"), [(said, text) for said, texts in USES.items() for text in texts]
)
def test_uses_are_found_with_their_line(said, text, tmp_path):
    path = tmp_path / "tent.py"
    path.write_text("\n" + text)
    found = forbidden.find(path, ALL)
    assert found.startswith("tent.py, line ")
    assert found.endswith(said)


@pytest.mark.parametrize(
    "text",
    [
        "import warp_of_mine\nwarp = 3\ndef square_to_tent(u): return u",
        "class A:\n    def warp(self): return 1\n    def f(self): return self.warp()",
        "# mi.warp\nx = 'mi.warp is not allowed'",
        "x = {'type': 'diffuse'}\ny = {'kind': 'path'}",
        "class L:\n  def pdf_direction(self): ...\ndef f(light): return light.pdf_direction()",
        "def broken(:",
    ],
)
def test_what_only_looks_like_it_is_allowed(text, tmp_path):
    path = tmp_path / "tent.py"
    path.write_text(text)
    assert forbidden.find(path, ALL) == ""


def test_helpers_are_read_too_and_words_choose(tmp_path):
    (tmp_path / "tent.py").write_text("from worlds import f")
    (tmp_path / "worlds.py").write_text("import tent\nfrom mitsuba import warp as w\nf = w")
    assert forbidden.find(tmp_path / "tent.py", ALL) == "worlds.py, line 2: mi.warp"
    assert forbidden.find(tmp_path / "tent.py", frozenset({"integrators"})) == ""


def test_a_name_put_together_is_refused_when_it_is_used(tmp_path, monkeypatch):
    monkeypatch.setattr(mi, "warp", mi.warp)
    code = "import mitsuba as mi\nf = lambda: getattr(mi, 'wa' + 'rp').square_to_tent\n"
    theirs, ours = {}, {}
    exec(compile(code, str(tmp_path / "tent.py"), "exec"), theirs)
    exec(compile(code, str(Path(__file__)), "exec"), ours)
    forbidden.guard(tmp_path)
    assert callable(ours["f"]())
    with pytest.raises(forbidden.Forbidden, match="is not allowed in this assignment"):
        theirs["f"]()


def test_the_rubric_knows_the_words(tmp_path):
    (tmp_path / "rubric.toml").write_text(
        '[assignment]\nid = "a0"\ntitle = "T"\nforbids = ["magic"]\n'
        '[[problem]]\nid = "a0.x"\ntitle = "X"\ntests = [{ id = "t.py::t", points = 1 }]\n'
    )
    with pytest.raises(ValueError, match=r"forbids 'magic': must be one of warps, integrators, li"):
        rubric.read(tmp_path)
