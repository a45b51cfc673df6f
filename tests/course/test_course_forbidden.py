"""What a handout does not allow is found, whatever it is called, and nothing else is."""

import pytest
from helpers.processes import says

from tofrender.course import rubric

WAYS = {
    "load_dict": "mi.load_dict({'type': 'pa' + 'th'})",
    "exec": "eval(\"mi.load_dict({'type': 'pa' + 'th'})\")",
    "load_string": "mi.load_string('<integrator version=\"3.0.0\" type=\"$t\"/>', t='path')",
    "manager": "mi.PluginManager.instance().create_object(mi.Properties('pa' + 'th'))",
    "scene": "mi.load_dict({'type': 'scene', 'i': {'type': 'pa' + 'th'}}).integrator()",
    "package": "mi.load_dict({'type': 'transient_' + 'path'})",
    "its class too": "tofrender.TransientPath(mi.Properties())",
    "derivatives": "mi.load_dict({'type': 'pr' + 'b'})",
    "thread": "ThreadPoolExecutor().submit(mi.load_dict, {'type': 'pa' + 'th'}).result()",
    "its class": "sys.modules[AD + '.prb'].PRBIntegrator(mi.Properties())",
}
WARPS = {
    "attribute": "mi.warp.square_to_tent",
    "import": "exec('from mitsuba.warp import square_to_tent')",
    "module": "importlib.import_module('mitsuba.warp').square_to_tent",
    "put together": "getattr(mi, 'wa' + 'rp').square_to_tent",
    "eval": "eval('mi.warp.square_to_tent')",
    "by the package": "beam.sample_cone(mi.Vector3f(0, 0, 1), mi.Point2f(0.5), 0.1)",
    "thread": "ThreadPoolExecutor().submit(getattr, mi.warp, 'square_to_tent').result()",
}
LIGHTS = {
    "scene": "mi.load_dict({'type': 'scene'}).sample_emitter(0.5)",
    "shape": "getattr(mi.load_dict({'type': 'sphere'}), 'sample_' + 'position')(0, [0.5, 0.5])",
    "emitter": "mi.load_dict({'type': 'point'}).sample_ray(0, 0, [0.5, 0.5], [0.5, 0.5])",
}
GUARDED = """
import importlib
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
import mitsuba as mi
import tofrender
mi.set_variant("llvm_ad_rgb")
from tofrender.course.judge import forbidden
from tofrender.scanning import beam
problem = SimpleNamespace(forbids=["light sampling"])
rubric = SimpleNamespace(forbids=["integrators", "warps"], problems=[problem])
rubric.problem_by_name = {"Triangle": problem, "Path": SimpleNamespace(forbids=[])}
used = set()
forbidden.guard(Path("/student"), rubric, used)
def run(text, file):
    space = globals() | {"AD": "mitsuba.python.ad.integrators"}
    exec(compile(text, file, "exec"), space)
    try:
        return str(space["f"]())[:0] or "allowed"
    except Exception as error:
        return "refused" if "not allowed" in str(error) else repr(error)
"""


def test_light_sampling_is_refused_in_its_problem_also_to_helpers():
    calls = []
    for name in ("Triangle", "Path"):
        calls.append(f"used.clear(); used.add({name!r})")
        calls += [
            f"print(run('f = lambda: ' + {way!r}, '/student/a.py'))" for way in LIGHTS.values()
        ]
    count = len(LIGHTS)
    assert says(GUARDED + "\n".join(calls)) == ["refused"] * count + ["allowed"] * count


def test_mitsuba_refuses_integrators_and_warps_however_they_are_reached():
    ways = [*WAYS.values(), *WARPS.values()]
    calls = [f"print(run('f = lambda: ' + {way!r}, '/student/a.py'))" for way in ways]
    own = "class Own(mi.SamplingIntegrator): pass\nmi.register_integrator('own', Own)\n"
    own += "f = lambda: [mi.load_dict({'type': each}) for each in ('own', 'sphere')] != []"
    calls += [f"print(run({own!r}, '/student/a.py'))"]
    ways = [way for way in ways if "Thread" not in way]  # whose caller nobody knows
    calls += [f"print(run('f = lambda: ' + {way!r}, '/ours/a.py'))" for way in ways]
    told = says(GUARDED + "\n".join(calls))
    count = len(WAYS) + len(WARPS)
    assert told == ["refused"] * count + ["allowed"] * (1 + len(ways))


def test_the_rubric_knows_the_words(tmp_path):
    (tmp_path / "rubric.toml").write_text(
        '[assignment]\nid = "a0"\ntitle = "T"\nforbids = ["magic"]\n'
        '[[problem]]\nid = "a0.x"\ntitle = "X"\ntests = [{ id = "t.py::t", points = 1 }]\n'
    )
    with pytest.raises(ValueError, match=r"forbids 'magic': must be one of warps, integrators, li"):
        rubric.read(tmp_path)
