"""The warp tester without its window: this package's warps, a student's, and the command."""

from __future__ import annotations

import os
import time

import mitsuba as mi
import numpy as np
import psutil
import pytest
from helpers.student_warps import HOSTILE, RIGHT, WRONG, write_warps

from tofrender import sampling
from tofrender.apps.warptest import engine, subjects
from tofrender.apps.warptest.engine import Engine
from tofrender.apps.warptest.sources import Library, Module, find_module
from tofrender.apps.warptest.subjects import SUBJECTS
from tofrender.cli.app import main
from tofrender.course.judge.client import NoAnswer
from tofrender.runtime.withheld import Withheld
from tofrender.sampling.warps import WARPS

SMALL = {"samples": 20_000, "resolution": 32}


@pytest.fixture(scope="module")
def theirs(tmp_path_factory):
    module = Module(write_warps(tmp_path_factory.mktemp("theirs")))
    yield module
    module.close()


def test_a_module_whose_name_is_not_utf8(tmp_path):
    path = tmp_path / os.fsdecode(b"m\xff.py")
    path.write_text(RIGHT)
    for each in (path, tmp_path):
        with pytest.raises(ValueError, match=r"^module = 'm\\udcff.py': must be the name of a"):
            Module(each)


def test_every_warp_of_the_package_is_there():
    for name, warp in WARPS.items():
        subject = SUBJECTS[name]
        assert subject.domain == warp.domain
        takes = [each.name for each in subject.parameters] + ["image"] * subject.takes_image
        assert takes == ([warp.parameter] if warp.parameter else [])


@pytest.mark.parametrize("name", list(SUBJECTS))
def test_every_subject_passes(name):
    """One in a thousand would fail by chance, with another seed."""
    case = Library().case(name, SUBJECTS[name].values({}))
    assert case.test(**SMALL).passed
    drawn = engine.draw(case, "stratified", 64, 0)
    assert drawn.points.shape == (SUBJECTS[name].dimensions, 64)
    assert np.isfinite(drawn.lines).mean() > 0.95
    assert drawn.points.dtype == drawn.lines.dtype == np.float32


def test_verdicts_are_those_of_the_library():
    for name, given in (("beckmann", {"alpha": 0.7}), ("tent", {})):
        ours = Library().case(name, SUBJECTS[name].values(given)).test(**SMALL)
        library = sampling.warp_case(name, **given).test(**SMALL)
        assert (ours.p_value, ours.chi2, ours.name) == (library.p_value, library.chi2, library.name)


@pytest.mark.parametrize("name", ["quad_light", "sphere_light", "two_lights"])
@pytest.mark.parametrize("distance", [0.6, 5.0])
def test_lights_near_and_far(name, distance):
    assert Library().case(name, {"distance": distance}).test(**SMALL).passed


def test_values():
    assert SUBJECTS["hierarchical"].values({})["image"].tolist() == [[4, 4], [1, 1]]
    for given, said in (
        ({"beta": 1}, "beta = 1: must be left out; beckmann has the parameters: alpha"),
        ({"alpha": 0}, "alpha = 0: must be a finite number from 1e-06 to 1e"),
        ({"alpha": "rough"}, "alpha = 'rough': must be a finite number"),
    ):
        with pytest.raises(ValueError, match=said.replace("+", r"\+")):
            SUBJECTS["beckmann"].values(given)


def test_images_are_made_square_and_not_too_large():
    assert subjects.density_of(np.ones((3, 5, 3))).shape == (8, 8)
    large = np.ones((700, 40))
    large[:350] = 3
    small = subjects.density_of(large)
    assert small.shape == (512, 512)
    assert small.mean() == pytest.approx(2)
    with pytest.raises(ValueError, match="all pixels are 0"):
        subjects.density_of(np.zeros((2, 2)))


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
    library = Library().case("tent", {}).test(**SMALL)
    assert verdict.passed
    assert verdict.name == "tent of tent.py"
    assert verdict.p_value == pytest.approx(library.p_value, abs=1e-3)
    drawn = engine.draw(theirs.case("tent", {}), "grid", 16, 0)
    ours = engine.draw(Library().case("tent", {}), "grid", 16, 0)
    assert drawn.points == pytest.approx(ours.points, abs=1e-6)


def test_a_wrong_density_fails(theirs):
    verdict = theirs.case("cosine_hemisphere", {}).test(**SMALL)
    assert not verdict.passed
    assert verdict.reason.startswith("counts do not follow the pdf")


def test_what_goes_wrong_is_said_with_the_students_line(theirs):
    with pytest.raises(NoAnswer) as raised:
        engine.draw(theirs.case("uniform_disk", {}), "grid", 4, 0)
    assert str(raised.value).splitlines() == [
        "RuntimeError: <b>no</b> & never",
        "  disk.py, line 2: return radius_of(sample)",
        '  disk.py, line 6: raise RuntimeError("<b>no</b> & never")',
    ]
    with pytest.raises(NoAnswer) as raised:
        engine.draw(theirs.case("uniform_sphere", {}), "grid", 4, 0)
    assert str(raised.value).splitlines() == [
        "not written yet: a1.sphere_and_hemispheres: square_to_uniform_sphere",
        "  sphere.py, line 1: def square_to_uniform_sphere(sample):",
    ]


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("return None", "square_to_tent returns a value of type NoneType; must be mi.Point2f"),
        ("return 3 * sample.x", "square_to_tent returns a value of type Float; must be mi.Point2f"),
        ("return mi.Vector3f(0)", "returns a value of type Vector3f; must be mi.Point2f"),
        ("return sample[", "SyntaxError in line 6"),
        ("import sys; sys.exit(0)", r"the submission called sys.exit\(0\)"),
        ("import os; os._exit(0)", "the process ended itself with status 0"),
    ],
)
def test_answers_that_are_none(tmp_path, body, said):
    first = "    return mi.Point2f(dr.select"
    line = next(line for line in RIGHT.splitlines() if line.startswith(first))
    module = Module(write_warps(tmp_path / "a", tent=RIGHT.replace(line, f"    {body}")))
    try:
        with pytest.raises(NoAnswer, match=said):
            engine.draw(module.case("tent", {}), "grid", 4, 0)
    finally:
        module.close()


def test_a_module_may_write_nowhere_and_end_only_itself(tmp_path):
    from tofrender.course.judge import sandbox

    folder = write_warps(tmp_path / "a", tent=HOSTILE)
    module = Module(folder)
    try:
        if sandbox.landlock_version():
            with pytest.raises(NoAnswer, match="PermissionError"):
                engine.draw(module.case("tent", {}), "grid", 4, 0)
            assert not (folder / "written.txt").exists()
        with pytest.raises(NoAnswer, match="ended itself with status 0"):
            module.case("tent", {}).pdf(mi.Point2f(0.5))
    finally:
        before = set(psutil.Process().children())
        module.close()
    assert len(before - set(psutil.Process().children())) <= 1


def test_a_module_that_never_answers_is_ended(tmp_path, monkeypatch):
    monkeypatch.setattr("tofrender.apps.warptest.sources.ANSWER_S", 1.0)
    forever = "def square_to_tent(sample):\n    while True:\n        pass\n"
    forever += "\n\ndef square_to_tent_pdf(p): ...\n"
    module = Module(write_warps(tmp_path / "a", tent=forever))
    begin = time.monotonic()
    try:
        with pytest.raises(NoAnswer, match="no answer within 1 s; the process was ended"):
            engine.draw(module.case("tent", {}), "grid", 4, 0)
    finally:
        module.close()
    assert time.monotonic() - begin < 60


def test_a_saved_file_counts_at_once(tmp_path):
    folder = write_warps(tmp_path / "a")
    module = Module(folder)
    try:
        assert not module.case("cosine_hemisphere", {}).test(**SMALL).passed
        assert not module.refresh()
        better = WRONG.replace("dr.inv_two_pi", "v.z * dr.inv_pi")
        (folder / "cosine.py").write_text(better)
        assert module.refresh()
        assert module.case("cosine_hemisphere", {}).test(**SMALL).passed
    finally:
        module.close()


def test_modules_that_cannot_be_used(tmp_path):
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / "empty.py").write_text("x = 1")
    for path, said in (
        (tmp_path / "none.py", "must be a Python file or a folder that exists"),
        (tmp_path / "notes.txt", r"must be a file that ends in \.py, or a folder"),
        (tmp_path / "empty.py", "must define functions of the course, like square_to_tent"),
        (tmp_path, "must define functions of the course"),
    ):
        with pytest.raises(ValueError, match=said) as raised:
            Module(path)
        assert str(raised.value).startswith("module = ")
    assert find_module(tmp_path) is None


def test_processes_of_this_session_stay_when_a_module_ends(tmp_path):
    """A notebook may start others beside it."""
    import subprocess
    import sys

    module = Module(write_warps(tmp_path / "a"))
    engine.draw(module.case("tent", {}), "grid", 4, 0)
    beside = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    try:
        module.close()
        assert beside.poll() is None
    finally:
        beside.communicate(b"\n")


@pytest.fixture
def edition(monkeypatch):
    """A package that has none of the course's warps."""
    from tofrender.apps.warptest import sources

    wanted = {name for subject in SUBJECTS.values() for name in subject.names}

    class Sampling:
        def __getattr__(self, name):
            if name in wanted:
                raise Withheld(f"tofrender.sampling.{name} is yours to write: problem a1.tent")
            return getattr(sampling, name)

    import tofrender

    monkeypatch.setattr(tofrender, "sampling", Sampling())
    return sources


@pytest.mark.usefixtures("edition")
def test_in_a_student_edition_the_students_own_file_stands_in(tmp_path, monkeypatch):
    assert Library().names() == ["no_op"]
    with pytest.raises(Withheld, match=r"yours to write: problem a1\.tent"):
        Library().case("tent", {})
    monkeypatch.chdir(write_warps(tmp_path / "a"))
    it = Engine()
    try:
        assert it.sources == ["library", "module"]
        assert it.case("module", "tent", {}).test(**SMALL).passed
    finally:
        it.close()
    (tmp_path / "b").mkdir()
    monkeypatch.chdir(tmp_path / "b")
    it = Engine()
    assert it.sources == ["library"]
    it.close()


def test_figures():
    case = Library().case("tent", {})
    verdict, drawn = case.test(**SMALL), engine.draw(case, "grid", 64, 0)
    svg = engine.panels(verdict)
    assert svg.startswith('<svg role="img" aria-label="Observed density')
    assert "currentColor" in svg
    assert "<script" not in svg
    assert engine.save(drawn, verdict, "64 points", "png").startswith(b"\x89PNG")
    assert engine.save(drawn, verdict, "64 points", "pdf").startswith(b"%PDF")
    for kind in ("pdf", "svg"):  # Without dates: the same bytes each time
        saved = engine.save(drawn, verdict, "64 points", kind)
        assert b"Date" not in saved
        assert engine.save(drawn, verdict, "64 points", kind) == saved


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


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--out", "a.png"], "--out = a.png: must be left out without --headless"),
        (["--headless", "--out", "a.png"], "--out = a.png: must be left out without NAME"),
        (["--headless", "--alpha", "1"], "NAME: must be given with --alpha, --image or -D"),
        (["--module", "no.py"], "--module = no.py: must be a Python file or a folder that exists"),
        (["tent", "-D", "alpha=1"], "alpha = 1: must be left out; tent has the parameters: none"),
        (["--port", "0"], "--port = 0: must be an integer from 1 to 65535"),
        (["tent", "--samples", "10"], "--samples = 10: must be an integer from 1000 to 16777216"),
        (
            ["--host", "not a host", "--no-browser"],
            "--host = 'not a host': must be an address to listen",
        ),
    ],
)
def test_bad_options_of_the_command(capsys, tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    assert main(["warptest", *arguments]) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"error: {said}")
    assert err.count("\n") == 1
