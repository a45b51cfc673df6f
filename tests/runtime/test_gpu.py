"""A GPU is chosen only if it can trace a ray; otherwise one line names the reason and the remedy.

These tests need no GPU. They let Dr.Jit claim that it has started one.
"""

import ctypes
import platform
import sys

import drjit as dr
import mitsuba as mi
import pytest
from helpers.limits import lower
from helpers.processes import says

from tofrender.cli import completion
from tofrender.integrators import passes
from tofrender.runtime import backend, doctor, gpu, llvm
from tofrender.runtime.child_processes import run_code
from tofrender.runtime.variants import BackendError

WORKS = "print('{{}}')"
NOWHERE = "DRJIT_LIBOPTIX_PATH = '/nowhere': OptiX cannot be loaded from there"
UNSET = "unset DRJIT_LIBOPTIX_PATH, or name the file libnvoptix.so.1"


@pytest.fixture
def machine(monkeypatch, tmp_path):
    """Return a function that lets this machine have a GPU, on which a test process runs `code`."""
    monkeypatch.setenv("DRJIT_CACHE_DIR", str(tmp_path))
    monkeypatch.delenv(gpu.VARIABLE, raising=False)
    monkeypatch.delenv("PYTHONFAULTHANDLER", raising=False)  # Adds a line
    kinds = {gpu.CUDA: dr.JitBackend.CUDA, gpu.METAL: dr.JitBackend.Metal}
    variants = [*mi.variants(), "metal_ad_rgb", "metal_ad_mono"]
    has_backend = dr.has_backend

    def has(name: str, code: str) -> list[str]:
        """Start a backend; returns the list of the test processes that were run so far."""
        runs: list[str] = []

        def run(text):
            runs.append(text)
            return run_code(text)

        kind = kinds[name]
        monkeypatch.setattr(dr, "has_backend", lambda which: which == kind or has_backend(which))
        monkeypatch.setattr(mi, "variants", lambda: variants)
        monkeypatch.setattr(gpu, "_missing_optix", lambda: None)
        monkeypatch.setattr(gpu, "_TRACE_A_RAY", code)
        monkeypatch.setattr(gpu, "run_code", run)
        return runs

    return has


def test_the_test_process_traces_a_ray():
    assert run_code(gpu._TRACE_A_RAY.format(variant="llvm_ad_rgb")).problem == ""
    # The test fails if the ray ends elsewhere
    wrong = gpu._TRACE_A_RAY.replace("0.2, 3]", "0.2, 4]").format(variant="llvm_ad_rgb")
    assert "a ray of length 2 has length 3" in run_code(wrong).problem


RENDER = """
import sys
sys.argv = ["tofrender", "render", "cornell_box", "--size", "8x6", "--bins", "100", "--spp", "1"]
sys.argv += ["--out", {out!r}]
import drjit as dr
has_backend = dr.has_backend
dr.has_backend = lambda which: which == dr.JitBackend.CUDA or has_backend(which)
import tofrender.cli
sys.stderr = sys.stdout
status = tofrender.cli.main()
import mitsuba as mi
print(status, mi.variant())
"""


def test_without_optix_a_render_uses_llvm_and_says_why_in_one_line(tmp_path):
    lines = says(RENDER.format(out=str(tmp_path / "out")), DRJIT_LIBOPTIX_PATH="/nowhere")
    assert lines[0] == f"tofrender: rendering on the CPU: {NOWHERE}; {UNSET}"
    assert lines[-1] == "0 llvm_ad_rgb"
    assert sum("OptiX" in line for line in lines) == 1


def test_without_optix_the_doctor_names_the_remedy(monkeypatch, tmp_path):
    monkeypatch.setenv("DRJIT_CACHE_DIR", str(tmp_path))
    monkeypatch.setenv(gpu.VARIABLE, "/nowhere")
    monkeypatch.setattr(
        doctor, "_ASK_DRJIT", 'print(\'{"cuda": true, "metal": false, "threads": 2}\')'
    )
    monkeypatch.setattr(doctor, "_TEST_RENDER", 'print(\'{"variant": "none", "rate": 1}\')')
    monkeypatch.setattr(sys, "platform", "linux")
    checks = doctor.diagnose()
    (check,) = [each for each in checks if each.name == "CUDA, OptiX"]
    assert (check.ok, check.required, check.remedy) == (False, False, UNSET)
    assert check.detail.startswith(NOWHERE)
    assert check.detail.endswith("rendering on the CPU")
    assert doctor.works(checks)
    # Without OptiX and without LLVM, rendering does not work
    monkeypatch.setattr(llvm, "choose", lambda: None)
    assert not doctor.works(doctor.diagnose())


@pytest.mark.parametrize("name", gpu.BACKENDS)
def test_a_gpu_that_traces_rays_is_chosen_and_tested_once(machine, capsys, name):
    runs = machine(name, WORKS)
    assert backend.default_variant() == f"{name}_ad_rgb"
    backend.require_gpu(f"{name}_ad_mono")
    assert len(runs) == 1
    assert gpu.state(name, anew=True) == gpu.State(True)
    assert len(runs) == 2
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("name", "message", "reason", "remedy", "tests"),
    [
        (
            gpu.CUDA,
            "jit_optix_api_init(): DrJit considers the driver of your graphics card buggy and ...",
            "drivers from 565 to 569",
            "driver 570 or newer",
            1,
        ),
        (
            gpu.CUDA,
            "Very likely, your NVIDIA graphics driver is too old and not compatible",
            "too old for OptiX",
            "driver 535 or newer",
            1,
        ),
        # A lack of memory may go away and is tested again
        (gpu.CUDA, "jit_malloc(): out of memory!", "no free memory", "CUDA_VISIBLE_DEVICES", 2),
        (gpu.CUDA, "surprise", "OptiX cannot trace a ray (Error)", "run `tofrender doctor`", 1),
        (gpu.METAL, "surprise", "Metal cannot trace a ray (Error)", "update macOS", 1),
    ],
)
def test_a_gpu_that_traces_no_rays(machine, capsys, name, message, reason, remedy, tests):
    code = f"import sys; sys.exit({message + chr(10) + 'Error'!r})"
    runs = machine(name, code)
    assert backend.default_variant() == "llvm_ad_rgb"
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("tofrender: rendering on the CPU: ")
    assert reason in line
    assert remedy in line
    with pytest.raises(BackendError, match=f"variant = '{name}_ad_mono': .*use an llvm_"):
        backend.activate(f"{name}_ad_mono")
    assert len(runs) == tests


@pytest.mark.parametrize(
    ("code", "problem"),
    [
        ("import time; time.sleep(60)", "not finished after 0.2 seconds"),
        ("import os; os.abort()", "ended by SIGABRT"),
        ("", "ended without a result"),
        ("print('noise')", "ended without a result"),
    ],
)
def test_a_test_that_hangs_or_crashes_is_not_repeated(machine, monkeypatch, capsys, code, problem):
    if "sleep" in code:
        lower(monkeypatch, child_timeout_s=0.2)
    runs = machine(gpu.CUDA, code)
    for _ in range(2):
        assert backend.default_variant() == "llvm_ad_rgb"
        assert f"OptiX cannot trace a ray ({problem})" in capsys.readouterr().err
    assert len(runs) == 1


def test_a_gpu_for_one_process_is_used(machine, capsys):
    """The test process has no access to it, because Dr.Jit has started CUDA in this process."""
    error = 'cuda_check(): API error 0046 (CUDA_ERROR_DEVICE_UNAVAILABLE): "busy or unavailable"'
    machine(gpu.CUDA, f"import os, sys; print({error!r}, file=sys.stderr, flush=True); os.abort()")
    assert backend.default_variant() == "cuda_ad_rgb"
    assert capsys.readouterr().err == ""


def test_results_of_processes_that_test_at_once_are_all_stored(machine, monkeypatch):
    machine(gpu.CUDA, WORKS)
    run = gpu.run_code

    def run_while_another_process_stores(code):
        gpu._store({"another": gpu.State(True)})
        return run(code)

    monkeypatch.setattr(gpu, "run_code", run_while_another_process_stores)
    assert gpu.state(gpu.CUDA).works
    assert len(gpu._stored()) == 2


def test_the_file_of_results_stays_small(machine):
    machine(gpu.CUDA, WORKS)
    gpu._store({str(number): gpu.State(True) for number in range(300)})
    assert gpu.state(gpu.CUDA).works
    assert len(gpu._stored()) == gpu.MOST_STORED
    assert gpu._key(gpu.CUDA) in gpu._stored()


def test_a_folder_that_is_a_file_costs_a_test_only(machine, monkeypatch, tmp_path):
    runs = machine(gpu.CUDA, WORKS)
    (tmp_path / "file").touch()
    monkeypatch.setenv("DRJIT_CACHE_DIR", str(tmp_path / "file" / "folder"))
    for count in (1, 2):
        assert gpu.state(gpu.CUDA).works
        assert len(runs) == count


IMPORT = """
import subprocess
def refuse(*arguments, **options):
    raise AssertionError("starts a process")
subprocess.Popen = refuse
import drjit as dr
has_backend = dr.has_backend
dr.has_backend = lambda which: which == dr.JitBackend.LLVM and has_backend(which)
import tofrender, mitsuba as mi
print(mi.variant())
"""


def test_without_a_gpu_an_import_starts_no_process():
    assert says(IMPORT) == ["llvm_ad_rgb"]


def test_another_driver_is_tested_again(machine, monkeypatch):
    runs = machine(gpu.CUDA, WORKS)
    for driver, count in (("580.95", 1), ("580.95", 1), ("590.1", 2), ("580.95", 2)):
        monkeypatch.setattr(gpu, "driver_version", lambda found=driver: found)
        assert gpu.state(gpu.CUDA).works
        assert len(runs) == count


@pytest.mark.parametrize("content", ["", "[]", '{"key": 1}', '{"key": {"other": 1}}'])
def test_damaged_and_unwritable_results_cost_a_test_only(machine, tmp_path, content):
    machine(gpu.CUDA, WORKS)
    (tmp_path / "tofrender_gpu.json").write_text(content)
    assert gpu.state(gpu.CUDA).works
    assert gpu._stored()
    (tmp_path / "tofrender_gpu.json").unlink()
    (tmp_path / "tofrender_gpu.json").mkdir()
    assert gpu.state(gpu.CUDA).works


@pytest.mark.parametrize("name", gpu.BACKENDS)
def test_a_gpu_that_is_missing(monkeypatch, capsys, name):
    before = mi.variant()
    has_backend = dr.has_backend
    monkeypatch.setattr(
        dr, "has_backend", lambda which: which == dr.JitBackend.LLVM and has_backend(which)
    )
    monkeypatch.setattr(mi, "variants", lambda: ["llvm_ad_rgb", f"{name}_ad_rgb"])
    assert backend.default_variant() == "llvm_ad_rgb"
    assert capsys.readouterr().err == ""
    device = {"cuda": "CUDA", "metal": "Metal"}[name]
    with pytest.raises(BackendError, match=f"variant = '{name}_ad_rgb': no {device} device or"):
        backend.activate(f"{name}_ad_rgb")
    assert mi.variant() == before


@pytest.mark.parametrize(
    ("system", "remedy"),
    [
        ({"release": "6.6.87-microsoft-standard-WSL2"}, "WSL 2 does not bring OptiX; copy it"),
        ({"file": ".dockerenv"}, "start the container with NVIDIA_DRIVER_CAPABILITIES=all"),
        ({"capabilities": "compute"}, "start the container with NVIDIA_DRIVER_CAPABILITIES=all"),
        ({"distributions": {"ubuntu", "debian"}}, "sudo apt-get install -y libnvidia-gl-580"),
        ({"distributions": {"debian"}}, "sudo apt-get install -y libnvoptix1"),
        ({"distributions": {"arch"}}, "install the part of the NVIDIA driver that contains"),
    ],
)
def test_how_to_get_optix(monkeypatch, tmp_path, system, remedy):
    uname = platform.uname()._replace(release=system.get("release", "6.1.0"))
    found = llvm.System(euid=1000, distributions=system.get("distributions", set()))
    monkeypatch.setattr(platform, "uname", lambda: uname)
    monkeypatch.setattr(llvm, "System", lambda: found)
    monkeypatch.setattr(gpu, "driver_version", lambda: "580.95.05")
    monkeypatch.delenv("NVIDIA_DRIVER_CAPABILITIES", raising=False)
    if "capabilities" in system:
        monkeypatch.setenv("NVIDIA_DRIVER_CAPABILITIES", system["capabilities"])
    if "file" in system:
        (tmp_path / system["file"]).touch()
    assert gpu._optix_remedy(tmp_path).startswith(remedy)


def test_the_version_of_the_driver(monkeypatch, tmp_path):
    line = "NVRM version: NVIDIA UNIX x86_64 Kernel Module  580.95.05  Tue Sep 23 2025"
    monkeypatch.setattr(gpu, "DRIVER_FILE", tmp_path / "version")
    gpu.DRIVER_FILE.write_text(f"{line}\nGCC version: gcc version 12.2.0 (Debian)\n")
    assert gpu.driver_version() == "580.95.05"
    gpu.DRIVER_FILE.unlink()
    monkeypatch.setattr(ctypes, "CDLL", lambda name: Driver(0))
    assert gpu.driver_version() == "CUDA 12.4"


class Driver:
    """A CUDA driver that finds some devices."""

    def __init__(self, count: int) -> None:
        self.count = count

    def cuInit(self, flags):
        return 0

    def cuDeviceGetCount(self, count):
        count._obj.value = self.count
        return 0

    def cuDriverGetVersion(self, number):
        number._obj.value = 12040
        return 0


@pytest.mark.parametrize(
    ("visible", "count", "names"),
    [(None, 3, ["0", "1", "2"]), ("2, 0", 2, ["2", "0"]), ("GPU-a,9", 1, ["GPU-a"]), ("", 0, [])],
)
def test_names_of_devices(monkeypatch, visible, count, names):
    monkeypatch.setattr(ctypes, "CDLL", lambda name: Driver(count))
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    if visible is not None:
        monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
    assert gpu.devices() == names


@pytest.mark.parametrize(
    ("variant", "expected"),
    [("cuda_ad_rgb", True), ("metal_ad_spectral_polarized", True), ("llvm_ad_rgb", False)],
)
def test_variants_of_gpus(monkeypatch, variant, expected):
    monkeypatch.setattr(mi, "variant", lambda: variant)
    assert passes._on_gpu() is expected
    assert variant in completion.VARIANTS


def test_no_variant_is_of_no_gpu():
    assert gpu.backend_of(None) is None
    assert gpu.backend_of("scalar_rgb") is None
