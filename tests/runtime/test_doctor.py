"""`tofrender doctor` tells the truth, and survives what it looks at."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import Console

from tofrender.runtime import doctor, llvm, memory
from tofrender.runtime.doctor import Check


def run_doctor(library: str) -> subprocess.CompletedProcess:
    """As the command runs it: without a variant, in a process of its own."""
    code = (
        "import sys; sys.argv = ['tofrender']; "
        "import tofrender.runtime.doctor as d; sys.exit(d.main())"
    )
    return subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, llvm.VARIABLE: library, "COLUMNS": "200"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.mark.slow
def test_where_rendering_works():
    chosen = llvm.choose()
    result = run_doctor(str(chosen.path) if chosen else "")
    assert result.returncode == 0, result.stdout + result.stderr
    assert "Rendering will work." in result.stdout
    assert "million samples/s with" in result.stdout
    for name in ("Python", "Mitsuba", "Dr.Jit", "LLVM", "CUDA", "Threads", "Memory", "ffmpeg"):
        assert name in result.stdout


def test_an_unusable_llvm_is_named_with_its_remedy(tmp_path):
    works_without = doctor._in_process(doctor._ASK_DRJIT)[0]["cuda"]
    library = tmp_path / "libLLVM-15.so"
    library.write_text("not a library")
    result = run_doctor(str(library))
    assert result.returncode == (0 if works_without else 1)
    assert result.stderr == ""
    assert f"LLVM: {llvm.VARIABLE} = '{library}' is not a shared library" in result.stdout
    assert "unset" in result.stdout


def test_the_end_of_a_process_is_a_result(monkeypatch):
    monkeypatch.delenv("PYTHONFAULTHANDLER", raising=False)  # Adds a line
    answer, error = doctor._in_process("import os; os.abort()")
    assert answer == {}
    assert error == "ended by SIGABRT"


def test_an_exception_in_a_process_is_a_result():
    assert doctor._in_process("raise ValueError('spp = 0')") == ({}, "ValueError: spp = 0")


@pytest.mark.slow
def test_an_abort_while_rendering_fails_with_a_remedy(monkeypatch):
    monkeypatch.setattr(doctor, "_TEST_RENDER", "import os; os.kill(os.getpid(), 11)")
    check = doctor._check_render()
    assert not check.ok
    assert check.required
    assert "SIGSEGV" in check.detail
    if llvm.choose():
        assert llvm.install_command() in check.remedy


def test_a_package_in_another_version_is_a_problem(monkeypatch):
    monkeypatch.setattr(doctor.metadata, "requires", lambda name: ["numpy<1", "numpydoc"])
    check = doctor._package("Numbers", "numpy", "something")
    assert not check.ok
    assert check.detail.endswith("but something needs numpy<1")
    assert check.remedy.endswith('-m pip install "numpy<1"')


def test_a_missing_package_is_a_problem():
    check = doctor._package("Nothing", "no-such-package", "tofrender")
    assert (check.ok, check.detail) == (False, "not installed")
    assert check.remedy.endswith('-m pip install "no-such-package"')


def test_a_refusal_that_names_its_remedy_gets_no_other(monkeypatch):
    refused = (
        "from tofrender.runtime.backend import BackendError\nraise BackendError('ulimit -v = 1')"
    )
    monkeypatch.setattr(doctor, "_TEST_RENDER", refused)
    monkeypatch.setattr(llvm, "choose", lambda: llvm.Library(Path("libLLVM.so.19"), 19))
    check = doctor._check_render()
    assert (check.ok, check.detail, check.remedy) == (False, "ulimit -v = 1", "")


def test_memory_is_what_the_limits_leave(monkeypatch):
    monkeypatch.setattr(memory, "free_on_host", lambda: 3 << 30)
    check = doctor._check_memory()
    assert check.ok
    assert check.detail.startswith("3.0 of ")
    monkeypatch.setattr(memory, "free_on_host", lambda: 1 << 29)
    check = doctor._check_memory()
    assert (check.ok, check.required) == (False, False)


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
