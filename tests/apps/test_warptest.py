"""The warp tester without its window: this package's warps, a student's, and the command."""

import os
import re
import subprocess
import sys
from contextlib import closing

import mitsuba as mi
import numpy as np
import psutil
import pytest
from helpers.limits import lower
from helpers.student_warps import HOSTILE, RIGHT, WRONG, write_warps
from helpers.support import refused

import tofrender
from tofrender import sampling
from tofrender.apps.warptest import engine, probes, subjects
from tofrender.apps.warptest.engine import Engine
from tofrender.apps.warptest.subjects import SUBJECTS
from tofrender.apps.warptest.warp_sources import Module, PackageWarps, find_module
from tofrender.cli.app import main
from tofrender.course.judge import sandbox
from tofrender.course.judge.client import NoAnswer
from tofrender.runtime.editions import LeftOut
from tofrender.sampling.table import WARPS

SMALL = {"samples": 20_000, "resolution": 32}


@pytest.fixture(scope="module")
def theirs(tmp_path_factory):
    with closing(Module(write_warps(tmp_path_factory.mktemp("theirs")))) as module:
        yield module


def draw(module: Module, name: str, points: int = 4):
    return engine.draw(module.case(name, {}), "grid", points, 0)


def test_a_module_whose_name_is_not_utf8(tmp_path):
    path = tmp_path / os.fsdecode(b"m\xff.py")
    path.write_text(RIGHT)
    for each in (path, tmp_path):
        refused(r"^module = 'm\\udcff.py': must be the name of a", Module, each)


def test_every_warp_of_the_package_is_there():
    for name, warp in WARPS.items():
        subject = SUBJECTS[name]
        assert subject.domain == warp.domain
        takes = [each.name for each in subject.parameters] + ["image"] * subject.takes_image
        assert takes == ([warp.parameter] if warp.parameter else [])


@pytest.mark.parametrize("name", list(SUBJECTS))
def test_every_subject_is_drawn(name):
    case = PackageWarps().case(name, SUBJECTS[name].values({}))
    drawn = engine.draw(case, "stratified", 64, 0)
    assert drawn.points.shape == (SUBJECTS[name].dimensions, 64)
    assert np.isfinite(drawn.lines).mean() > 0.95
    assert drawn.points.dtype == drawn.lines.dtype == np.float32


@pytest.mark.parametrize("name", ["quad_light", "sphere_light", "two_lights"])
@pytest.mark.parametrize("distance", [0.6, 5.0])
def test_lights_near_and_far(name, distance):
    assert PackageWarps().case(name, {"distance": distance}).test(**SMALL).passed


def test_values():
    assert SUBJECTS["hierarchical"].values({})["image"].tolist() == [[4, 4], [1, 1]]
    for given, said in (
        ({"beta": 1}, "beta = 1: must be left out; beckmann has the parameters: alpha"),
        ({"alpha": 0}, "alpha = 0: must be a finite number from 1e-06 to 1e"),
        ({"alpha": "rough"}, "alpha = 'rough': must be a finite number"),
    ):
        refused(re.escape(said), SUBJECTS["beckmann"].values, given)


def test_images_are_made_square_and_not_too_large():
    assert subjects.density_of(np.ones((3, 5, 3))).shape == (8, 8)
    large = np.ones((700, 40))
    large[:350] = 3
    small = subjects.density_of(large)
    assert small.shape == (512, 512)
    assert small.mean() == pytest.approx(2)
    refused("all pixels are 0", subjects.density_of, np.zeros((2, 2)))


def test_sobol_points_fill_the_square():
    p = np.array(engine.sobol(256, 3))
    cells = np.floor(16 * p[0]) + 16 * np.floor(16 * p[1])
    assert len(set(cells)) == 256
    assert not np.array_equal(p, np.array(engine.sobol(256, 4)))


def test_names_of_a_module(theirs):
    assert theirs.names() == ["tent", "uniform_disk", "uniform_sphere", "cosine_hemisphere"]
    assert theirs.file_of("cosine_hemisphere") == "cosine.py"
    assert theirs.file_of("no_op") == theirs.file_of("beckmann") == ""


def test_a_right_module_passes_with_the_librarys_numbers(theirs):
    verdict = theirs.case("tent", {}).test(**SMALL)
    library = PackageWarps().case("tent", {}).test(**SMALL)
    assert verdict.passed
    assert verdict.name == "tent of tent.py"
    assert verdict.p_value == pytest.approx(library.p_value, abs=1e-3)
    ours = draw(PackageWarps(), "tent", 16).points
    assert draw(theirs, "tent", 16).points == pytest.approx(ours, abs=1e-6)


def test_what_goes_wrong_is_said_with_the_students_line(theirs):
    raises, stub = 'raise RuntimeError("<b>no</b> & never")', "square_to_uniform_sphere"
    calls = "  disk.py, line 2: return radius_of(sample)", f"  disk.py, line 6: {raises}"
    yet = f"not written yet: a1.sphere_and_hemispheres: {stub}"
    for name, said, *lines in (
        ("uniform_disk", "RuntimeError: <b>no</b> & never", *calls),
        ("uniform_sphere", yet, f"  sphere.py, line 1: def {stub}(sample):"),
    ):
        with pytest.raises(NoAnswer) as raised:
            draw(theirs, name)
        assert str(raised.value).splitlines() == [said, *lines]


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("return None", "square_to_tent returns a value of type NoneType; must be mi.Point2f"),
        ("return 3 * sample.x", "square_to_tent returns a value of type Float; must be mi.Point2f"),
        ("return mi.Vector3f(0)", "returns a value of type Vector3f; must be mi.Point2f"),
    ],
)
def test_answers_that_are_none(tmp_path, body, said):
    first = "    return mi.Point2f(dr.select"
    line = next(line for line in RIGHT.splitlines() if line.startswith(first))
    folder = write_warps(tmp_path / "a", tent=RIGHT.replace(line, f"    {body}"))
    with closing(Module(folder)) as module, pytest.raises(NoAnswer, match=said):
        draw(module, "tent")


def test_a_module_may_write_nowhere_and_end_only_itself(tmp_path):
    folder = write_warps(tmp_path / "a", tent=HOSTILE)
    with closing(Module(folder)) as module:
        if sandbox.landlock_version():
            with pytest.raises(NoAnswer, match="PermissionError"):
                draw(module, "tent")
            assert not (folder / "written.txt").exists()
        with pytest.raises(NoAnswer, match="ended itself with status 0"):
            module.case("tent", {}).pdf(mi.Point2f(0.5))
        before = set(psutil.Process().children())
    assert len(before - set(psutil.Process().children())) <= 1


def test_a_module_that_never_answers_is_ended(tmp_path, monkeypatch):
    lower(monkeypatch, warp_answer_s=1.0)
    forever = "def square_to_tent(sample):\n    while True:\n        pass\n"
    forever += "\n\ndef square_to_tent_pdf(p): ...\n"
    folder, said = write_warps(tmp_path / "a", tent=forever), "no answer within 1 s; the process"
    with closing(Module(folder)) as module, pytest.raises(NoAnswer, match=said):
        draw(module, "tent")


def test_a_saved_file_counts_at_once(tmp_path):
    folder = write_warps(tmp_path / "a")
    with closing(Module(folder)) as module:
        assert not module.case("cosine_hemisphere", {}).test(**SMALL).passed
        assert not module.refresh()
        better = WRONG.replace("dr.inv_two_pi", "v.z * dr.inv_pi")
        (folder / "cosine.py").write_text(better)
        assert module.refresh()
        assert module.case("cosine_hemisphere", {}).test(**SMALL).passed


def test_modules_that_cannot_be_used(tmp_path):
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / "empty.py").write_text("x = 1")
    for path, said in (
        (tmp_path / "none.py", "must be a Python file or a folder that exists"),
        (tmp_path / "notes.txt", r"must be a file that ends in \.py, or a folder"),
        (tmp_path / "empty.py", "must define functions of the course, like square_to_tent"),
        (tmp_path, "must define functions of the course"),
    ):
        refused(f"^module = .*{said}", Module, path)
    assert find_module(tmp_path) is None


def test_processes_of_this_session_stay_when_a_module_ends(tmp_path):
    """A notebook may start others beside it."""
    with closing(Module(write_warps(tmp_path / "a"))) as module:
        draw(module, "tent")
        beside = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    try:
        assert beside.poll() is None
    finally:
        beside.communicate(b"\n")


@pytest.fixture
def edition(monkeypatch):
    wanted = {name for subject in SUBJECTS.values() for name in subject.names}

    class Sampling:
        def __getattr__(self, name):
            if name in wanted:
                raise LeftOut(f"tofrender.sampling.{name} is yours to write: problem a1.tent")
            return getattr(sampling, name)

    monkeypatch.setattr(tofrender, "sampling", Sampling())


@pytest.mark.usefixtures("edition")
def test_in_a_student_edition_the_students_own_file_stands_in(tmp_path, monkeypatch):
    assert PackageWarps().names() == ["no_op"]
    refused(r"yours to write: problem a1\.tent", PackageWarps().case, "tent", {}, kind=LeftOut)
    monkeypatch.chdir(write_warps(tmp_path / "a"))
    with closing(Engine()) as it:
        assert [*it.sources] == ["library", "module"]
        assert it.sources["module"].case("tent", {}).test(**SMALL).passed
    (tmp_path / "b").mkdir()
    monkeypatch.chdir(tmp_path / "b")
    with closing(Engine()) as it:
        assert [*it.sources] == ["library"]


def test_figures():
    case = PackageWarps().case("tent", {})
    verdict, drawn = case.test(**SMALL), engine.draw(case, "grid", 64, 0)
    svg = engine.panels(verdict)
    assert svg.startswith('<svg role="img" aria-label="Observed density')
    assert "currentColor" in svg
    assert "<script" not in svg
    assert engine.save(drawn, verdict, "64 points", "png").startswith(b"\x89PNG")
    assert engine.save(drawn, verdict, "64 points", "pdf").startswith(b"%PDF")


def test_headless_tests_what_a_module_has(tmp_path, capsys):
    folder = write_warps(tmp_path / "a")
    arguments = ["warptest", "--headless", "--samples", "20000"]
    assert main([*arguments, "--module", str(folder)]) == 1
    said = capsys.readouterr().out
    assert "tent of tent.py: passed" in said
    assert "cosine_hemisphere of cosine.py: FAILED, counts do not follow the pdf" in said
    assert "uniform_disk: FAILED, RuntimeError: <b>no</b> & never" in said
    assert "uniform_sphere: FAILED, not written yet" in said
    assert said.endswith("1 of 4 passed\n")
    assert main([*arguments, "--module", str(folder / "tent.py")]) == 0
    assert "tent of tent.py: passed" in capsys.readouterr().out


def test_headless_tests_all_of_the_package(tmp_path, capsys):
    assert main(["warptest", "--headless", "--samples", "20000"]) == 0
    assert capsys.readouterr().out.endswith("14 of 14 passed\n")
    figure = tmp_path / "light.pdf"
    arguments = ["two_lights", "-D", "distance=2", "--headless", "--samples", "20000"]
    assert main(["warptest", *arguments, "--out", str(figure)]) == 0
    assert capsys.readouterr().out.startswith("two_lights (distance = 2): passed")
    assert figure.read_bytes().startswith(b"%PDF")


def test_bad_options_of_the_command(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for arguments, said in (
        ("--out a.png", "--out = a.png requires --headless"),
        ("--headless --out a.png", "--out = a.png requires the argument NAME"),
        ("--headless --alpha 1", "--alpha, --image and -D require the argument NAME"),
        ("tent -D alpha=1", "alpha = 1: must be left out; tent has the parameters: none"),
    ):
        assert main(["warptest", *arguments.split()]) == 2
        err = capsys.readouterr().err
        assert err.startswith(f"error: {said}")
        assert err.count("\n") == 1


def test_other_parameters_count_at_once():
    points = np.array([[0.0], [0.0], [1.0]])
    densities = [probes.density(sampling, "beckmann", {"alpha": a}, points)[0] for a in (0.3, 0.6)]
    assert densities[0] == pytest.approx(4 * densities[1])
