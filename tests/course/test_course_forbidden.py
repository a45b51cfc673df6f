"""Forbidden features are deleted, and submissions cannot bring them back; others stay."""

from contextlib import closing
from textwrap import dedent, indent

import pytest
from helpers import tiny_assignment
from helpers.processes import GUARD_S, says

from tofrender.course import rubric
from tofrender.course.judge import forbidden, running, sandbox, system_calls
from tofrender.course.judge.client import SubmissionLimits, Worker

confines = pytest.mark.skipif(
    sandbox.landlock_version() < 6 or not system_calls.available(),
    reason="this machine protects from less",
)
INTEGRATORS = {
    "load_dict": "mi.load_dict({'type': 'pa' + 'th'})",
    "exec": "eval(\"mi.load_dict({'type': 'pa' + 'th'})\")",
    "load_string": "mi.load_string('<integrator version=\"3.0.0\" type=\"$t\"/>', t='path')",
    "manager": "mi.PluginManager.instance().create_object(mi.Properties('pa' + 'th'))",
    "scene": "mi.load_dict({'type': 'scene', 'i': {'type': 'pa' + 'th'}}).integrator()",
    "package": "mi.load_dict({'type': 'transient_' + 'path'})",
    "its class too": "tofrender.TransientPath(mi.Properties())",
    "derivatives": "mi.load_dict({'type': 'pr' + 'b'})",
    "thread": "ThreadPoolExecutor().submit(mi.load_dict, {'type': 'pa' + 'th'}).result()",
    "its class": "PRB(mi.Properties())",
}
WARPS = {
    "attribute": "mi.warp.square_to_tent",
    "import": "exec('from mitsuba import warp; warp.square_to_tent')",
    "module": "importlib.import_module('mitsuba.llvm_ad_rgb').warp.square_to_tent",
    "put together": "getattr(mi, 'wa' + 'rp').square_to_tent",
    "eval": "eval('mi.warp.square_to_tent')",
    "by the package": "beam.sample_cone(mi.Vector3f(0, 0, 1), mi.Point2f(0.5), 0.1)",
    "thread": "ThreadPoolExecutor().submit(getattr, mi.warp, 'square_to_tent').result()",
}
SAMPLING = {
    "scene": "mi.load_dict({'type': 'scene'}).sample_emitter(0.5)",
    "shape": "getattr(mi.load_dict({'type': 'sphere'}), 'sample_' + 'position')(0, [0.5, 0.5])",
    "pointer": "mi.ShapePtr(mi.load_dict({'type': 'sphere'})).sample_position(0, [0.5, 0.5])",
    "emitter": "mi.load_dict({'type': 'point'}).sample_ray(0, 0, [0.5, 0.5], [0.5, 0.5])",
    "sensor": "mi.load_dict({'type': 'perspective'}).sample_ray(0, 0, [0.5, 0.5], [0.5, 0.5])",
    "material": "mi.load_dict({'type': 'diffuse'}).sample(mi.BSDFContext(), SI, 0.5, [0.5, 0.5])",
    "its density": "mi.load_dict({'type': 'diffuse'}).pdf(mi.BSDFContext(), SI, [0, 0, 1])",
    "its values": "mi.load_dict({'type': 'diffuse'}).eval(mi.BSDFContext(), SI, [0, 0, 1])",
    "phase function": "mi.load_dict({'type': 'hg'}).sample(None, None, 0.5, [0.5, 0.5])",
    "microfacets": "mi.MicrofacetDistribution(mi.MicrofacetType.Beckmann, 0.3).sample(0, 0)",
    "their density": "mi.MicrofacetDistribution(mi.MicrofacetType.Beckmann, 0.3).eval([0, 0, 1])",
    "picture": "mi.MarginalDiscrete2D0(mi.TensorXf([1.0] * 4, (2, 2))).sample([0.5, 0.5])",
    "micro-flakes": "mi.sggx_sample",
}
HEAD = """
import importlib
import sys
import numpy as np
from concurrent.futures import ThreadPoolExecutor
import drjit as dr
import mitsuba as mi
import tofrender
"""
REMOVED = """
mi.set_variant("llvm_ad_rgb")
from mitsuba.python.ad.integrators.prb import PRBIntegrator as PRB
from tofrender.course.judge import forbidden
from tofrender.scanning import beam
SI = dr.zeros(mi.SurfaceInteraction3f)
forbidden.remove(WORDS)
def said(way):
    try:
        return str(eval(way, globals()))[:0] or "allowed"
    except Exception as error:
        return "refused" if "not allowed" in str(error) else repr(error)
"""


@pytest.mark.parametrize(
    ("words", "ways"),
    [
        (["integrators"], INTEGRATORS),
        (["warps"], WARPS),
        (["sampling"], {n: way for n, way in SAMPLING.items() if n != "micro-flakes"}),
    ],
)
def test_features_are_gone_however_they_are_reached(words, ways):
    calls = [f"print(said({way!r}))" for way in ways.values()]
    head = HEAD + REMOVED.replace("WORDS", repr(words))
    assert says(head + "\n".join(calls)) == ["refused"] * len(ways)


def test_own_integrators_and_everything_else_stay():
    """Also path lengths in shapes, and what the next problems allow: lights of a scene."""
    code = """
    class Own(mi.SamplingIntegrator):
        def sample(self, scene, sampler, ray, medium=None, active=True):
            si = scene.ray_intersect(ray, active)
            ds, weight = scene.sample_emitter_direction(si, sampler.next_2d(), True, active)
            bs, _ = si.bsdf().sample(mi.BSDFContext(), si, 0.5, sampler.next_2d(), active)
            return weight + bs.pdf, si.is_valid(), []
    mi.register_integrator('own', Own)
    scene = mi.load_dict(mi.cornell_box() | {'integrator': {'type': 'own'}})
    mi.set_variant("llvm_ad_rgb")
    print(float(np.mean(mi.render(scene, spp=1))) > 0)
    """
    head = HEAD + REMOVED.replace("WORDS", "['integrators', 'warps']")
    assert says(head + dedent(code)) == ["True"]


def test_all_integrators_of_mitsuba_are_known():
    """The list of native integrators, which the sandbox hides, is complete."""
    code = """
    from pathlib import Path
    mi.set_variant("llvm_ad_rgb")
    names = [path.stem for path in (Path(mi.__file__).parent / "plugins").iterdir()]
    manager = mi.PluginManager.instance()
    print(*sorted(n for n in names if manager.plugin_type(n) == mi.ObjectType.Integrator))
    """
    (line,) = says(HEAD + dedent(code))
    assert line.split() == sorted(forbidden.NATIVE_INTEGRATORS)


# ------------------------------------------------------------------------- inside the sandbox

HIDDEN_WAYS = {
    "closure of what stands there": """
        cells = [c.cell_contents for c in mi.warp.__getattr__.__closure__ or ()]
        return any(hasattr(each, "square_to_tent") for each in cells)
    """,
    "code of another file": """
        space = dict(globals())
        exec(compile("f = lambda: mi.warp.square_to_tent", "/usr/lib/x.py", "exec"), space)
        return space["f"]()
    """,
    "child": """
        import subprocess
        code = "import mitsuba as mi; mi.set_variant('llvm_ad_rgb'); print(mi.warp.square_to_tent)"
        return subprocess.check_output([sys.executable, "-c", code])
    """,
    "forked child": """
        read, write = os.pipe()
        if os.fork() == 0:
            os.write(write, b"xy"[hasattr(mi.warp, "square_to_tent"):][:1])
            os._exit(0)
        return os.read(read, 1) == b"y"
    """,
    "garbage collector": """
        import gc
        names = {"square_to_tent", "sample_position", "sample_emitter"}
        found = [o for o in gc.get_objects() if getattr(o, "__name__", "") in names]
        return [o for o in found if type(o).__name__ in ("nb_func", "nb_method")]
    """,
    "method of a shape": "mi.load_dict({'type': 'sphere'}).sample_position(0, [0.5, 0.5])",
    "loader of the closure": """
        return loader()({"type": "path"})
    """,
    "loader under another name": """
        return loader()({"type": "./path"})
    """,
    "copy of a plugin": """
        import shutil
        shutil.copy(os.path.join(MITSUBA, "plugins", "path.so"), "mine.so")
        return True
    """,
    "library of a plugin": "ctypes.CDLL(os.path.join(MITSUBA, 'plugins', 'volpath.so'))",
    "method with a stand-in": """
        from mitsuba.python.ad.integrators.prb import PRBIntegrator
        return PRBIntegrator.sample.__code__
    """,
    "methods by the garbage collector": """
        import gc
        kinds = [o for o in gc.get_objects() if type(o).__name__ == "function"]
        named = [o for o in kinds if o.__module__ and "ad.integrators.prb" in o.__module__]
        return [o for o in named if o.__name__ == "sample"]
    """,
    "module again": """
        from mitsuba.python.ad.integrators import prb
        return importlib.reload(prb).PRBIntegrator.sample.__code__
    """,
    "source of the module": """
        return open(os.path.join(MITSUBA, "python", "ad", "integrators", "prb.py")).read()
    """,
    "another variant": """
        mi.set_variant("scalar_rgb")
        return mi.warp.square_to_tent
    """,
    "variant from its file": """
        name = mi.variant()
        file, = [n for n in os.listdir(MITSUBA) if n.startswith("scalar_rgb.")]
        loader = importlib.machinery.ExtensionFileLoader(
            "mitsuba.scalar_rgb", os.path.join(MITSUBA, file))
        spec = importlib.util.spec_from_loader("mitsuba.scalar_rgb", loader)
        return importlib.util.module_from_spec(spec).warp.square_to_tent
    """,
    "integrator of the package": "tofrender.TransientPath(mi.Properties())",
    "path loop of the package": "importlib.import_module('tofrender.paths.walk').walk",
    "path loop again": """
        return importlib.reload(importlib.import_module("tofrender.paths.walk")).walk
    """,
}
TRIES = """
import ctypes, importlib.machinery, importlib.util, os, signal
MITSUBA = os.path.dirname(mi.__file__)

def loader():
    cells = [cell.cell_contents for cell in mi.load_dict.__closure__]
    (found,) = [each for each in cells if type(each).__name__ == "nb_func"]
    return found

def tries():
    found = []
    for name, way in WAYS.items():
        read, write = os.pipe()
        if os.fork() == 0:  # what one way finds must not help the next
            signal.alarm(30)
            try:
                os.write(write, b"1" if way() else b"0")
            except BaseException:
                os.write(write, b"0")
            os._exit(0)
        os.close(write)
        said = os.read(read, 1)
        if said != b"0":
            found.append(name if said else f"{name}: no answer")
        os.close(read)
        os.wait()
    return found

def add0(a, b):
    return tries()
"""


def submission_that_tries(ways: dict[str, str]) -> str:
    lines = [HEAD]
    for number, way in enumerate(ways.values()):
        body = dedent(way).strip() if "\n" in way else f"return {way}"
        lines += [f"def way{number}():", indent(body, "    ")]
    named = ", ".join(f"{name!r}: way{number}" for number, name in enumerate(ways))
    return "\n".join([*lines, f"WAYS = {{{named}}}", TRIES])


@confines
@pytest.mark.parametrize("confined", [True, False])
def test_sandbox_hides_all_that_brings_features_back(confined, tmp_path):
    """Without the sandbox some attempts succeed, which shows that the attempts are real."""
    staff = tiny_assignment.write(tmp_path / "a0", tiny_assignment.wide(["sum"]))
    text = (staff / "rubric.toml").read_text()
    words = 'title = "Sums"\nforbids = ["warps", "integrators"]\n'
    (staff / "rubric.toml").write_text(text.replace('title = "Sums"\n', words, 1))
    files = {"p0.py": submission_that_tries(HIDDEN_WAYS)}
    student = tiny_assignment.write(tmp_path / "student", files)
    worker = Worker(staff, student, limits=SubmissionLimits(confine=confined), forbids=["sampling"])
    with closing(worker) as asked:
        found = asked.ask("call", {"name": "add0", "a": 2, "b": 3}, GUARD_S)
    if confined:
        assert found == []
    else:
        works = {"child", "copy of a plugin", "another variant", "module again"}
        assert works | {"loader of the closure", "loader under another name"} <= set(found)


def test_a_problem_forbids_in_its_own_tests_only(tmp_path):
    """A feature that one problem forbids is allowed in other problems."""
    files = tiny_assignment.wide(["with", "without"])
    text = files["rubric.toml"].replace(
        'names = ["add0"]', 'names = ["add0"]\nforbids = ["sampling"]'
    )
    staff = tiny_assignment.write(tmp_path / "a0", files | {"rubric.toml": text})
    uses = "import mitsuba as mi\ndef add{}(a, b):\n    mi.load_dict({{'type': 'sphere'}})"
    uses += ".sample_position(0, [0.5, 0.5])\n    return a + b\n"
    names = {f"p{k}.py": uses.format(k) for k in (0, 1)}
    student = tiny_assignment.write(tmp_path / "student", names)
    outcomes = running.run(staff, submission=student)
    assert outcomes["test_p1.py::test_numbers"].outcome == "passed"
    (reason,) = outcomes["test_p0.py::test_numbers"].texts
    assert "Shape.sample_position is not allowed in this problem: write it yourself" in reason


def test_the_rubric_knows_the_words(tmp_path):
    (tmp_path / "rubric.toml").write_text(
        '[assignment]\nid = "a0"\ntitle = "T"\nforbids = ["magic"]\n'
        '[[problem]]\nid = "a0.x"\ntitle = "X"\ntests = [{ id = "t.py::t", points = 1 }]\n'
    )
    with pytest.raises(ValueError, match=r"forbids 'magic': must be one of warps, integrators, sa"):
        rubric.read(tmp_path)
