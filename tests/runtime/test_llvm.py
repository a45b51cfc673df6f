"""Search and choice of LLVM, and the recommended command, on simulated machines."""

import stat
import sys
from pathlib import Path

import pytest

from tofrender.runtime import llvm

DEBIAN = {"debian"}
UBUNTU = {"ubuntu", "debian"}
MINT = {"linuxmint", "ubuntu", "debian"}
ROCKY = {"rocky", "rhel", "centos", "fedora"}

ROOT = {"euid": 0}

MULTIARCH = "usr/lib/x86_64-linux-gnu"

if sys.platform != "linux":
    pytest.skip("the made-up machines have Linux libraries", allow_module_level=True)


class Machine:
    """A file system in a temporary folder, and the commands that exist on it."""

    def __init__(self, root: Path, distributions: set = DEBIAN):
        self.root, self.distributions = root, distributions
        (root / "etc").mkdir()
        (root / "etc/os-release").write_text("ID=debian\n")
        self.bin = root / "bin"
        self.bin.mkdir()
        self.packages()

    def library(self, name: str, *, links: tuple[str, ...] = ()) -> Path:
        """Create a file that starts like a library of this machine, and links to this file."""
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with open("/proc/self/exe", "rb") as file:
            path.write_bytes(file.read(64))
        for link in links:
            (path.parent / link).symlink_to(path.name)
        return path

    def command(self, name: str, script: str = "") -> None:
        path = self.bin / name
        path.write_text(f"#!/bin/sh\n{script}\n")
        path.chmod(path.stat().st_mode | stat.S_IXUSR)

    def packages(self, *names: str) -> None:
        """Create an apt-cache that offers these packages."""
        listed = " ".join(names)
        self.command(
            "apt-cache",
            f"[ $1 = pkgnames ] && printf '%s\\n' {listed}\n"
            f'case " {listed} " in *" $2 "*) echo \'  Candidate: 1:1.0\';; esac',
        )

    def system(self, *, euid: int = 1000, platform: str = "linux", **environ: str) -> llvm.System:
        environ = {"PATH": f"{self.bin}:/bin:/usr/bin", **environ}
        venv = self.root / "venv"
        return llvm.System(self.root, environ, platform, (venv,), euid, self.distributions)


@pytest.fixture
def machine(tmp_path):
    return Machine(tmp_path)


@pytest.fixture
def debian12(machine):
    """Install LLVM 14 and 15 with their links, as Debian 12 does."""
    machine.library(f"{MULTIARCH}/libLLVM-14.so.1", links=("libLLVM-14.so", "libLLVM-14.0.6.so.1"))
    machine.library(f"{MULTIARCH}/libLLVM-15.so.1", links=("libLLVM-15.so",))
    folder = machine.root / "usr/lib/llvm-14/lib"
    folder.mkdir(parents=True)
    (folder / "libLLVM.so").symlink_to("../../x86_64-linux-gnu/libLLVM-14.so.1")
    (folder / "libLLVMSupport.a").write_bytes(b"!<arch>")
    return machine


def test_old_versions_are_found_and_refused(debian12):
    debian12.packages("libllvm14", "libllvm15", "libllvm19", "libllvm-19-ocaml-dev")
    system = debian12.system()
    found = llvm.candidates(system)
    assert [library.major for library in found] == [14, 15]
    assert [library.problem for library in found] == ["is LLVM 14", "is LLVM 15"]
    assert llvm.choose(system) is None
    line = "no LLVM 17 or newer found, only 14, 15; run: sudo apt-get install -y libllvm19"
    assert llvm.refusal(system) == line
    path = debian12.library(f"{MULTIARCH}/libLLVM.so.19.1", links=("libLLVM-19.so",))
    assert llvm.choose(system) == llvm.Library(path, 19)


@pytest.mark.parametrize(
    ("name", "major", "environ"),
    [
        (f"{MULTIARCH}/libLLVM-17.so.1", 17, {}),
        ("usr/lib64/libLLVM.so.20.1", 20, {}),
        ("usr/lib64/llvm18/lib/libLLVM-18.so", 18, {}),
        ("usr/lib/llvm-21/lib/libLLVM.so.21.1", 21, {}),
        ("usr/local/lib/libLLVM.so.22.0", 22, {}),
        ("opt/homebrew/opt/llvm@19/lib/libLLVM.19.1.dylib", 19, {}),
        ("venv/lib/libLLVM-18.so", 18, {}),
        ("env/lib/libLLVM.so.18.1", 18, {"CONDA_PREFIX": "{root}/env"}),
        ("elsewhere/libLLVM.so.18.1", 18, {"LD_LIBRARY_PATH": "/nowhere:{root}/elsewhere"}),
    ],
)
def test_where_systems_keep_it(debian12, name, major, environ):
    path = debian12.library(name)
    environ = {key: value.format(root=debian12.root) for key, value in environ.items()}
    assert llvm.choose(debian12.system(**environ)) == llvm.Library(path, major)


def test_the_newest_tried_goes_before_untried_ones(machine):
    assert llvm.candidates(machine.system()) == []
    assert llvm.refusal(machine.system()).startswith("no LLVM 17 or newer found; run: sudo apt-get")
    for major in (llvm.MINIMUM_MAJOR - 1, 17, 19, 98, 99):
        machine.library(f"{MULTIARCH}/libLLVM.so.{major}.1")
    assert llvm.choose(machine.system()).major == 19
    for major in (17, 19):
        (machine.root / f"{MULTIARCH}/libLLVM.so.{major}.1").unlink()
    assert llvm.choose(machine.system()).major == 98


def test_garbage_is_named_and_never_taken(machine):
    folder = machine.root / MULTIARCH
    machine.library(f"{MULTIARCH}/libLLVM-19-rust-1.80.so")
    (folder / "libLLVM.so.19.1").write_text("GROUP ( libLLVM-19.so )")
    (folder / "libLLVM.so.20.1").write_bytes(b"")
    (folder / "libLLVM-21.so").mkdir()
    (folder / "libLLVM-22.so").symlink_to("gone")
    (folder / "libLLVM-17.so").symlink_to("libLLVM-17.so")
    foreign = bytearray(machine.library(f"{MULTIARCH}/libLLVM-18.so").read_bytes())
    foreign[18] ^= 0xFF  # another processor
    (folder / "libLLVM-18.so").write_bytes(foreign)
    (machine.root / "usr/lib64").write_text("a file where a folder should be")
    problems = {library.path.name: library.problem for library in llvm.candidates(machine.system())}
    assert problems.pop("libLLVM-17.so").startswith("cannot be read")
    assert problems == {
        "libLLVM.so.19.1": "is not a shared library for this machine",
        "libLLVM.so.20.1": "is not a shared library for this machine",
        "libLLVM-21.so": "is a folder",
        "libLLVM-22.so": "does not exist",
        "libLLVM-18.so": "is not a shared library for this machine",
    }
    assert llvm.choose(machine.system()) is None


def test_a_name_without_version_is_asked_elsewhere(machine):
    path = machine.library(f"{MULTIARCH}/libLLVM.so")  # a header and nothing else
    (library,) = llvm.candidates(machine.system())
    assert library.path == path
    assert library.problem.startswith("cannot be loaded")
    assert llvm.loading_error(path) == library.problem


@pytest.mark.parametrize(
    ("value", "chosen"),
    [
        ("{root}/mine/libLLVM.so.17.1", "mine/libLLVM.so.17.1"),
        ("libLLVM.so.20.1", f"{MULTIARCH}/libLLVM.so.20.1"),
        ("", f"{MULTIARCH}/libLLVM.so.20.1"),
    ],
    ids=["path", "bare name", "not set"],
)
def test_what_the_environment_names_wins(machine, value, chosen):
    for name in (f"{MULTIARCH}/libLLVM.so.20.1", "mine/libLLVM.so.17.1"):
        machine.library(name)
    system = machine.system(DRJIT_LIBLLVM_PATH=value.format(root=machine.root))
    assert llvm.choose(system).path == machine.root / chosen
    majors = [library.major for library in llvm.candidates(system)]
    assert majors == ([17, 20] if chosen.startswith("mine") else [20])


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("nope.so", "does not exist"),
        ("usr", "is a folder"),
        ("etc/os-release", "is not a shared library for this machine"),
        (f"{MULTIARCH}/libLLVM-15.so", "is LLVM 15"),
    ],
)
def test_an_unusable_one_is_refused_in_one_line(debian12, name, problem):
    value = str(debian12.root / name)
    system = debian12.system(DRJIT_LIBLLVM_PATH=value)
    said = f"DRJIT_LIBLLVM_PATH = '{value}' {problem}: must name the file of LLVM 17 or newer; "
    assert llvm.refusal(system) == f"{said}unset it and run: {llvm.install_command(system)}"
    usable = debian12.library(f"{MULTIARCH}/libLLVM.so.19.1")
    assert llvm.choose(system) is None
    assert llvm.refusal(system) == f"{said}`unset DRJIT_LIBLLVM_PATH` to use {usable}"


@pytest.mark.parametrize(
    ("distributions", "packages", "command", "system"),
    [
        (DEBIAN, ["libllvm15", "libllvm19"], "apt-get install -y libllvm19", ROOT),
        (DEBIAN, ["libllvm19", "libllvm22"], "sudo apt-get install -y libllvm19", {}),
        (DEBIAN, ["libllvm19", "libllvm98"], "sudo apt-get install -y libllvm19", {}),
        (UBUNTU, ["libllvm17t64"], "sudo apt-get install -y libllvm17t64", {}),
        (MINT, ["libllvm18", "libllvm20"], "sudo apt-get install -y libllvm20", {}),
        (DEBIAN, [], "sudo apt-get update && sudo apt-get install -y libllvm19", {}),
        (UBUNTU, [], "apt-get update && apt-get install -y libllvm18", ROOT),
        (UBUNTU, ["libllvm14"], "wget -qO- https://apt.llvm.org/llvm.sh | bash -s -- 19", ROOT),
        ({"fedora"}, [], "sudo dnf install -y llvm-libs", {}),
        (ROCKY, [], "dnf install -y llvm-libs", ROOT),
        ({"arch"}, [], "sudo pacman -S --noconfirm llvm-libs", {}),
        ({"void"}, [], "conda install -y -c conda-forge libllvm19", {}),
        (set(), [], "conda install -y -c conda-forge libllvm19", {}),
        (DEBIAN, [], "mamba install -y -c conda-forge libllvm19", {"CONDA_PREFIX": "/opt/env"}),
        (DEBIAN, [], "brew install llvm", {"platform": "darwin"}),
        (DEBIAN, [], "winget install LLVM.LLVM", {"platform": "win32"}),
    ],
)
def test_install_command(tmp_path, distributions, packages, command, system):
    machine = Machine(tmp_path, distributions)
    machine.packages(*packages)
    if "mamba" in command:
        machine.command("mamba")
    assert llvm.install_command(machine.system(**system)) == command
    assert llvm.choose(machine.system(**system)) is None


def test_a_package_without_candidate_does_not_count(machine):
    machine.command(
        "apt-cache",
        "[ $1 = pkgnames ] && printf 'libllvm19\\nlibllvm20\\n'\n"
        "[ $2 = libllvm20 ] && echo '  Candidate: (none)'\n"
        "[ $2 = libllvm19 ] && echo '  Candidate: 1:19.1.7'\nexit 0",
    )
    assert llvm.install_command(machine.system()) == "sudo apt-get install -y libllvm19"


def test_what_the_set_up_reads(debian12, monkeypatch, capsys):
    path = debian12.library(f"{MULTIARCH}/libLLVM.so.19.1")  # a header and nothing else
    system = debian12.system()
    monkeypatch.setattr(llvm, "System", lambda: system)
    assert llvm.main() == 1
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith(f"{path}: cannot be loaded")
    monkeypatch.setattr(llvm, "loading_error", lambda path: "")
    assert llvm.main() == 0
    assert capsys.readouterr() == (f"LLVM 19: {path}\n", "")
