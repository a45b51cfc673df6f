"""`tofrender doctor` reports the true state, and survives the errors that it checks for."""

import io
import subprocess
from pathlib import Path

import pytest
from helpers.limits import lower
from helpers.processes import python
from rich.console import Console

from tofrender.runtime import doctor, llvm
from tofrender.runtime.child_processes import run_code
from tofrender.runtime.doctor import Check

DOCTOR = """
import sys
sys.argv = ["tofrender"]  # As the command runs it: without a variant
import tofrender.runtime.doctor as d
sys.exit(d.main())
"""


def run_doctor(library: str) -> subprocess.CompletedProcess:
    return python(DOCTOR, **{llvm.VARIABLE: library, "COLUMNS": "200"})


def test_where_rendering_works():
    chosen = llvm.choose()
    result = run_doctor(str(chosen.path) if chosen else "")
    assert result.returncode == 0, result.stdout + result.stderr
    assert "Rendering will work." in result.stdout
    assert "million samples/s with" in result.stdout
    for name in ("Python", "Mitsuba", "Dr.Jit", "LLVM", "CUDA", "Threads", "Memory", "ffmpeg"):
        assert name in result.stdout


def test_an_unusable_llvm_is_named_with_its_remedy(tmp_path):
    works_without = run_code(doctor._ASK_DRJIT).answer["cuda"]
    library = tmp_path / "libLLVM-15.so"
    library.write_text("not a library")
    result = run_doctor(str(library))
    assert result.returncode == (0 if works_without else 1)
    assert result.stderr == ""
    assert f"LLVM: {llvm.VARIABLE} = '{library}' is not a shared library" in result.stdout
    assert "unset" in result.stdout


@pytest.mark.parametrize(
    ("code", "error"),
    [
        ("import os; os.abort()", "ended by SIGABRT"),
        ("raise ValueError('spp = 0')", "ValueError: spp = 0"),
    ],
)
def test_how_a_process_ends_is_a_result(monkeypatch, code, error):
    monkeypatch.delenv("PYTHONFAULTHANDLER", raising=False)  # Adds a line
    outcome = run_code(code)
    assert (outcome.answer, outcome.problem) == ({}, error)


@pytest.mark.parametrize(
    ("package", "detail", "remedy"),
    [
        ("numpy", "but something needs numpy<1", "numpy<1"),
        ("no-such-package", "not installed", "no-such-package"),
    ],
)
def test_a_package_that_is_another_or_missing_is_a_problem(monkeypatch, package, detail, remedy):
    monkeypatch.setattr(doctor.metadata, "requires", lambda name: ["numpy<1", "numpydoc"])
    check = doctor._package("Numbers", package, "something")
    assert not check.ok
    assert check.detail.endswith(detail)
    assert check.remedy.endswith(f'-m pip install "{remedy}"')


REFUSED = "from tofrender.runtime.variants import BackendError\nraise BackendError('ulimit -v = 1')"


@pytest.mark.parametrize(
    ("code", "detail", "remedy"),
    [
        ("import os; os.kill(os.getpid(), 11)", "ended by SIGSEGV", "install it"),
        (REFUSED, "ulimit -v = 1", ""),  # Names its remedy and gets no other
    ],
)
def test_a_test_render_that_fails(monkeypatch, code, detail, remedy):
    monkeypatch.delenv("PYTHONFAULTHANDLER", raising=False)  # Adds a line
    monkeypatch.setattr(doctor, "_TEST_RENDER", code)
    monkeypatch.setattr(llvm, "choose", lambda: llvm.Library(Path("libLLVM.so.19"), 19))
    monkeypatch.setattr(llvm, "install_command", lambda: "install it")
    check = doctor._check_render()
    assert (check.ok, check.required, check.detail) == (False, True, detail)
    assert remedy in check.remedy
    assert bool(check.remedy) == bool(remedy)


def test_memory_is_what_the_limits_leave(monkeypatch):
    lower(monkeypatch, free_memory=3 << 30)
    check = doctor._check_memory()
    assert check.ok
    assert check.detail.startswith("3.0 of ")
    lower(monkeypatch, free_memory=1 << 29)
    assert (doctor._check_memory().ok, doctor._check_memory().required) == (False, False)


@pytest.mark.parametrize(
    ("check", "status"),
    [
        (Check("LLVM", True, "19"), 0),
        (Check("LLVM", False, "none", "apt-get install -y libllvm19"), 1),
        (Check("ffmpeg", False, "none", "unset IMAGEIO_FFMPEG_EXE", required=False), 0),
    ],
)
def test_the_status_counts_what_rendering_needs(check, status):
    output = io.StringIO()
    console = Console(file=output, width=60)
    assert doctor.report([Check("Python", True, "3.11"), check], console) == status
    if check.remedy:
        assert f"{check.name}: {check.remedy}\n" in output.getvalue()


def test_pipes_get_one_line_for_each_check():
    output = io.StringIO()
    detail = "19 at " + "/usr/lib/a-long-folder" * 12
    checks = [Check("Python", True, "3.11"), Check("LLVM", True, detail)]
    doctor.report(checks, Console(file=output, width=60))
    assert output.getvalue().splitlines()[:2] == [
        "ok      Python       3.11",
        f"ok      LLVM         {detail}",
    ]
