"""What a handout does not allow is found, whatever it is called, and nothing else is."""

from pathlib import Path

import mitsuba as mi
import pytest
from helpers.processes import says

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
    forbidden.guard(tmp_path, ["warps"])
    assert callable(ours["f"]())
    with pytest.raises(forbidden.Forbidden, match="is not allowed in this assignment"):
        theirs["f"]()


WAYS = {
    "load_dict": "mi.load_dict({'type': 'pa' + 'th'})",
    "exec": "eval(\"mi.load_dict({'type': 'pa' + 'th'})\")",
    "load_string": "mi.load_string('<integrator version=\"3.0.0\" type=\"$t\"/>', t='path')",
    "manager": "mi.PluginManager.instance().create_object(mi.Properties('pa' + 'th'))",
    "scene": "mi.load_dict({'type': 'scene', 'i': {'type': 'pa' + 'th'}}).integrator()",
    "derivatives": "mi.load_dict({'type': 'pr' + 'b'})",
    "its class": "sys.modules[AD + '.prb'].PRBIntegrator(mi.Properties())",
}
GUARDED = """
import sys
from pathlib import Path
import mitsuba as mi
mi.set_variant("llvm_ad_rgb")
from tofrender.course.judge import forbidden
forbidden.guard(Path("/student"), ["integrators"])
def run(text, file):
    space = {"mi": mi, "sys": sys, "AD": "mitsuba.python.ad.integrators"}
    exec(compile(text, file, "exec"), space)
    try:
        return str(space["f"]())[:0] or "allowed"
    except Exception as error:
        return "refused" if "integrators are not allowed" in str(error) else repr(error)
"""


def test_mitsubas_integrators_are_refused_however_they_are_loaded():
    calls = [f"print(run('f = lambda: ' + {way!r}, '/student/a.py'))" for way in WAYS.values()]
    calls += [f"print(run('f = lambda: ' + {way!r}, '/ours/a.py'))" for way in WAYS.values()]
    own = "class Own(mi.SamplingIntegrator): pass\nmi.register_integrator('own', Own)\n"
    own += "f = lambda: [mi.load_dict({'type': each}) for each in ('own', 'sphere')] != []"
    calls += [f"print(run({own!r}, '/student/a.py'))"]
    told = says(GUARDED + "\n".join(calls))
    assert told == ["refused"] * len(WAYS) + ["allowed"] * (len(WAYS) + 1)


def test_the_rubric_knows_the_words(tmp_path):
    (tmp_path / "rubric.toml").write_text(
        '[assignment]\nid = "a0"\ntitle = "T"\nforbids = ["magic"]\n'
        '[[problem]]\nid = "a0.x"\ntitle = "X"\ntests = [{ id = "t.py::t", points = 1 }]\n'
    )
    with pytest.raises(ValueError, match=r"forbids 'magic': must be one of warps, integrators, li"):
        rubric.read(tmp_path)
