"""Choice and change of the variant, plugins of each variant, and a bad LLVM that never aborts."""

import os
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from helpers.gallery import SCENES
from helpers.parts import diffuse, plane, point_light
from helpers.processes import says
from helpers.support import camera, film, path_image, rendered, scene
from oracles import films as oracles

import tofrender
from tofrender.runtime import backend, llvm, plugins

LLVM_WITHOUT_CUDA = """
import tofrender, mitsuba as mi
print(mi.variant())
"""
# Mitsuba is not asked to start it
CUDA_WHERE_IT_WORKS = """
import sys
sys.argv = ["tofrender"]  # As the command, which activates later
from tofrender import backend
import drjit as dr, mitsuba as mi
chosen = []
dr.has_backend = lambda which: which == dr.JitBackend.CUDA
mi.set_variant = chosen.append
backend.plugins.register = lambda variant: None
backend.gpu.state = lambda name: backend.gpu.State(True)
backend.activate()
print(chosen)
"""
THE_ONE_THAT_IS_SET = """
import mitsuba as mi
mi.set_variant("llvm_ad_mono")
import tofrender
print(mi.variant())
print(type(mi.load_dict({"type": "transient_path"})) is tofrender.TransientPath)
"""
SCALAR = """
import mitsuba as mi
mi.set_variant("scalar_rgb")
import tofrender
print(mi.variant())
for work in (lambda: tofrender.render("cornell_box"), lambda: tofrender.TransientPath):
    try:
        work()
    except Exception as error:
        print(type(error).__name__, error)
mi.set_variant("llvm_ad_rgb")
scene = tofrender.cornell_box(width=4, height=4, temporal_bins=120, bin_width_opl=0.25)
print(tofrender.render(scene, spp=1, progress=False).attrs["variant"])
"""
REFUSED = (
    "BackendError variant = 'scalar_rgb': cannot render in time, must be an llvm_*, cuda_* "
    "or metal_* variant; call mi.set_variant('llvm_ad_rgb') first"
)
NOT_THERE = (
    "AttributeError tofrender.TransientPath needs an llvm_*, cuda_* or metal_* variant; the "
    "active one is 'scalar_rgb'"
)
LIGHT = """
import sys, tofrender
heavy = "xarray matplotlib rich typer OpenEXR PIL tqdm pandas"
print([name for name in heavy.split() if name in sys.modules])
"""
HELP_WITHOUT_MITSUBA = """
import os, sys
sys.argv = ["/usr/bin/tofrender", "render", "--help"]
import tofrender.cli
sys.stdout = open(os.devnull, "w")
status = tofrender.cli.main()
heavy = [name for name in ("mitsuba", "drjit", "numpy") if name in sys.modules]
print(status, heavy, file=sys.__stdout__)
"""


@pytest.mark.parametrize(
    ("code", "lines"),
    [
        (LLVM_WITHOUT_CUDA, ["llvm_ad_rgb"]),
        (CUDA_WHERE_IT_WORKS, ["['cuda_ad_rgb']"]),
        (THE_ONE_THAT_IS_SET, ["llvm_ad_mono", "True"]),
        (SCALAR, ["scalar_rgb", REFUSED, NOT_THERE, "llvm_ad_rgb"]),
        (LIGHT, ["[]"]),
        (HELP_WITHOUT_MITSUBA, ["0 []"]),
    ],
    ids=["llvm", "cuda", "set", "scalar", "light", "help"],
)
def test_at_import(code, lines):
    assert says(code, CUDA_VISIBLE_DEVICES="-1") == lines


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="needs Linux")
def test_pictures_are_written_on_one_core(tmp_path):
    """With a single thread of Dr.Jit, Mitsuba would wait for its own picture forever."""
    code = f"""
import os
os.sched_setaffinity(0, [min(os.sched_getaffinity(0))])
import tofrender, drjit as dr, mitsuba as mi
print(dr.thread_count())
path = {str(tmp_path / "picture.exr")!r}
mi.Bitmap(dr.ones(mi.TensorXf, (4, 4, 3))).write(path)
print(mi.Bitmap(path).size())
"""
    assert says(code) == ["2", "[4, 4]"]


@pytest.mark.parametrize(
    ("which", "before"),
    [
        *((which, "") for which in ("missing", "text", "folder", "another library", "old")),
        ("text", "import mitsuba"),
    ],
)
def test_an_unusable_llvm_is_refused_in_one_line(tmp_path, which, before):
    """Also if Mitsuba is already imported without a variant. The process is not aborted."""
    old = [one for one in llvm.candidates() if one.major and one.major < llvm.MINIMUM_MAJOR]
    text = tmp_path / "libLLVM-19.so"
    text.write_text("not a library")
    library = {
        "missing": tmp_path / "libLLVM.so",
        "text": text,
        "folder": tmp_path,
        "another library": Path(mi.__file__).parent / "libmitsuba.so",
        "old": old[0].path if old else None,
    }[which]
    if library is None or not (which == "missing" or library.exists()):
        pytest.skip("not on this machine")
    code = f"""
{before}
try:
    import tofrender
except Exception as error:
    print(type(error).__name__, error)
"""
    environment = {llvm.VARIABLE: str(library), "CUDA_VISIBLE_DEVICES": "-1"}
    (line,) = says(code, **environment)
    assert line.startswith("BackendError ")
    assert str(library) in line


def test_an_environment_variable_keeps_the_import_from_activating_a_variant():
    script = "import sys, tofrender; print('mitsuba' in sys.modules)"
    assert says(script, **{backend.NO_VARIANT: "1"}) == ["False"]
    assert says(script) == ["True"]


def test_activate_switches_and_keeps_the_active_variant():
    assert backend.activate("llvm_ad_mono") == mi.variant() == "llvm_ad_mono"
    assert backend.activate() == mi.variant() == "llvm_ad_mono"
    assert mi.load_dict({"type": "transient_path"}).max_depth == 6


@pytest.mark.parametrize("variant", ["llvm_rgb", "", 5])
def test_unknown_variant(variant):
    before = mi.variant()
    with pytest.raises(ValueError, match="ust be one of scalar_rgb") as error:
        backend.activate(variant)
    assert str(error.value).startswith(f"variant = {variant!r}: ")
    assert "\n" not in str(error.value)
    assert mi.variant() == before


KINDS = ("Integrator", "Film", "Sampler", "Emitter", "BSDF", "Sensor")
REQUIRED = {"simple": {"position": [0, 0, 1], "energy": 1.0}}
"""Parameters that a plugin cannot do without."""


def test_plugins_follow_the_variant():
    classes = {}
    for variant in ("llvm_ad_rgb", "llvm_ad_mono", "llvm_ad_rgb", "llvm_ad_mono"):
        mi.set_variant(variant)
        for name, (plugin, *_) in plugins.PLUGINS.items():
            found = getattr(tofrender, name)
            assert found is plugins.plugin(name)
            assert issubclass(found, tuple(getattr(mi, kind) for kind in KINDS))
            for called in (plugin, plugins.qualified_name(plugin)):
                assert type(mi.load_dict({"type": called} | REQUIRED.get(plugin, {}))) is found
            assert classes.setdefault((variant, name), found) is found  # The same as before
    assert len(set(classes.values())) == 2 * len(plugins.PLUGINS)


def test_rendering_between_switches_gives_the_same():
    scene = tofrender.cornell_box(width=4, height=4, temporal_bins=120, bin_width_opl=0.25)
    films = []
    for variant in ("llvm_ad_rgb", "llvm_ad_mono", "llvm_ad_rgb"):
        mi.set_variant(variant)
        films.append(tofrender.render(scene, spp=4, progress=False).transient)
    assert abs(films[0] - films[2]).max() < 1e-5


def test_public_names():
    for name in tofrender.__all__:
        assert getattr(tofrender, name) is not None
    assert {*tofrender.__all__} <= {*dir(tofrender)}
    with pytest.raises(AttributeError, match="no attribute 'TransientPaht'"):
        tofrender.TransientPaht  # noqa: B018
    with pytest.raises(AttributeError, match=r"tofrender\.Path"):
        plugins.plugin("Path")


VARIANTS = [n for n in mi.variants() if n.startswith("llvm") and "polarized" not in n]
assert {"llvm_ad_rgb", "llvm_ad_mono", "llvm_ad_spectral"} <= set(VARIANTS)


@pytest.mark.parametrize("variant", VARIANTS)
def test_closed_form(variant):
    mi.set_variant(variant)
    eye, x, lamp = (0.4, 0, 1.5), (0.4, 0, 0), (1.0, 0.3, 2.0)
    parts = {"floor": plane(bsdf=diffuse(0.5)), "lamp": point_light(lamp, 3.0)}
    sensor = camera(eye, x, film(bins=640, bin_width=2**-6), fov=0.001)
    radiance, opl = oracles.point_light_on_plane(eye, x, (0, 0, 1), lamp, 3.0, 0.5)
    steady, transient = rendered(scene(parts, sensor), spp=4096)
    channels = 1 if "mono" in variant else 3
    assert transient.shape == (1, 1, 640, channels)
    assert np.flatnonzero(transient[0, 0, :, 0]).tolist() == [int(opl * 2**6)]
    # Spectral variants draw wavelengths: gray has noise in its color
    tolerance = 0.03 if "spectral" in variant else 1e-4
    assert transient[0, 0].sum(axis=0) == pytest.approx([radiance] * channels, rel=tolerance)
    assert steady[0, 0] == pytest.approx(transient[0, 0].sum(axis=0), rel=1e-4)


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", ["cornell", "glass"])
@pytest.mark.usefixtures("mitsubas_steps")
def test_mitsubas_result(variant, name):
    mi.set_variant(variant)
    expected = path_image(SCENES[name](), spp=16, seed=1)
    steady, transient = rendered(SCENES[name](), spp=16, seed=1)
    assert steady.shape == expected.shape
    assert np.abs(steady - expected).max() < 1e-4 * expected.max()
    assert np.abs(transient.sum(axis=2) - steady).max() < 1e-4 * expected.max()


_EXCHANGE = """
import warnings
warnings.simplefilter("ignore")
{imports}
import mitsuba as mi
print(type(mi.load_dict({{"type": "transient_path"}})).__module__.partition(".")[0])
print(type(mi.load_dict({{"type": "tofrender_transient_path"}})) is tofrender.TransientPath)
steady = tofrender.cornell_box_steady_state(width=4, height=4)
for scene in ("cornell_box", tofrender.cornell_box(width=4, height=4)):
    print(tofrender.render(scene, spp=1, progress=False).attrs["integrator"])
options = dict(integrator="transient_path", sampler="padded_sobol", temporal_bins=9, window="auto")
print(tofrender.render(steady, spp=1, progress=False, **options).sizes["opl"])
mi.set_variant("llvm_ad_mono")
mi.set_variant("llvm_ad_rgb")
print(tofrender.render(steady, spp=1, progress=False, **options).sizes["opl"])
"""


@pytest.mark.parametrize(
    ("imports", "owner"),
    [
        ("import tofrender, mitransient", "mitransient"),
        ("import mitsuba as mi; mi.set_variant('llvm_ad_rgb'); import mitransient, tofrender", ""),
    ],
    ids=["after", "before"],
)
def test_mitransient_in_the_same_process(imports, owner):
    """Names that both packages register belong to the last import. Our integrator still renders."""
    lines = says(_EXCHANGE.format(imports=imports), CUDA_VISIBLE_DEVICES="-1")
    path = "TransientPath"
    assert lines == [owner or "tofrender", "True", path, path, "9", "9"]
