"""Find the LLVM library that Dr.Jit compiles its CPU kernels with.

Dr.Jit loads LLVM at run time: the file that `DRJIT_LIBLLVM_PATH` names, else the first
`libLLVM.so` that the linker finds. With LLVM 15 or 16 it starts, and then the *process aborts*
("Cannot select: fminimum") at the first kernel with a minimum on a CPU with AVX-512; an older
LLVM it refuses. Debian 12 ships 14 and 15. So the library is chosen here, before Dr.Jit is
imported, and never below `MINIMUM_MAJOR`.

Versions are read from file names, else by loading the library in a subprocess. This uses only the
standard library, because the set-up runs the file before anything is installed:

    python tofrender/runtime/llvm.py
"""

import os
import platform
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

VARIABLE = "DRJIT_LIBLLVM_PATH"
MINIMUM_MAJOR = 17  # The oldest whose code generator knows all that Dr.Jit emits
NEWEST_TRIED = 22  # Newer ones are used for want of others
PREFERRED = 19  # The one to install: all published figures were measured with it

_FILE_NAME = re.compile(r"libLLVM(?:[-.]\d[\d.]*)?\.(?:so|dylib)[\d.]*|LLVM-C\.dll")
_MAJOR = re.compile(r"libLLVM(?:-|\.so\.|\.)(\d+)")
_APT_PACKAGE = re.compile(r"libllvm(\d+)(?:t64)?")
_ASK_VERSION = """
import ctypes, sys
library = ctypes.CDLL(sys.argv[1])
parts = [ctypes.c_uint() for _ in range(3)]
library.LLVMGetVersion(*map(ctypes.byref, parts))
print(parts[0].value)
"""


@dataclass(frozen=True)
class Library:
    """A libLLVM on this machine."""

    path: Path  # Symbolic links resolved
    major: int | None  # None if the version is unknown
    problem: str = ""  # Why Dr.Jit must not load it; empty if it can render with it


def _distributions() -> set[str]:
    """ID and ID_LIKE of this Linux, such as {"ubuntu", "debian"}."""
    try:
        release = platform.freedesktop_os_release()
    except (OSError, ValueError):  # None, or not in UTF-8
        return set()
    return {release["ID"], *release.get("ID_LIKE", "").split()}


@dataclass(frozen=True)
class System:
    """Machine that is searched; tests pass another one."""

    root: Path = Path("/")
    environ: Mapping[str, str] = field(default_factory=lambda: os.environ)
    platform: str = sys.platform
    prefixes: tuple[Path, ...] = (Path(sys.prefix), Path(sys.base_prefix))  # venv, and its base
    euid: int = field(default_factory=lambda: getattr(os, "geteuid", lambda: 1)())  # 0 is root
    distributions: set[str] = field(default_factory=_distributions)


def candidates(system: System | None = None) -> list[Library]:
    """List every libLLVM on this machine, that of `DRJIT_LIBLLVM_PATH` first.

    Unusable files are listed with their problem. Nothing is loaded into this process.
    """
    system = system or System()
    named = _named(system)
    found = {named.path: named} if named else {}
    for folder in _folders(system):
        try:
            names = sorted(path for path in folder.iterdir() if _FILE_NAME.fullmatch(path.name))
        except OSError:
            continue
        for path in names:
            library = _inspect(path)
            found.setdefault(library.path, library)
    return list(found.values())


def choose(system: System | None = None) -> Library | None:
    """Choose the library that Dr.Jit should load, None if there is none that it can use.

    A library named by `DRJIT_LIBLLVM_PATH` is the only choice, even if it is unusable.
    """
    system = system or System()
    named = _named(system)
    return _best([named] if named else candidates(system))


def refusal(system: System | None = None) -> str:
    """Message for when `choose` finds nothing: the problem and the command that helps."""
    system = system or System()
    named, found = _named(system), candidates(system)
    if named:
        line = (
            f"{VARIABLE} = '{system.environ[VARIABLE]}' {named.problem}: must name the file of "
            f"LLVM {MINIMUM_MAJOR} or newer; "
        )
        if best := _best(found):
            return f"{line}`unset {VARIABLE}` to use {best.path}"
        return f"{line}unset it and run: {install_command(system)}"
    majors = sorted({library.major for library in found if library.major})
    only = f", only {', '.join(map(str, majors))}" if majors else ""
    return f"no LLVM {MINIMUM_MAJOR} or newer found{only}; run: {install_command(system)}"


def loading_error(path: Path) -> str:
    """Problem of loading the library (a missing dependency, say), empty if there is none."""
    return _load_in_subprocess(path)[1]


def install_command(system: System | None = None) -> str:
    """Command that installs a usable LLVM on this system."""
    system = system or System()
    sudo = "" if system.euid == 0 else "sudo "
    names, path = ("mamba", "conda", "micromamba"), system.environ.get("PATH", "")
    conda = next((name for name in names if shutil.which(name, path=path)), "conda")
    from_conda = f"{conda} install -y -c conda-forge libllvm19"
    if system.platform == "win32":
        return "winget install LLVM.LLVM"
    if system.environ.get("CONDA_PREFIX") and system.euid != 0:
        return from_conda
    if system.platform == "darwin":
        return "brew install llvm"
    like = system.distributions
    if like & {"debian", "ubuntu"}:
        package, index = _apt_package(system)
        if package:
            return f"{sudo}apt-get install -y {package}"
        if index:  # a release older than LLVM 17 itself: LLVM's own archive serves it
            return f"wget -qO- https://apt.llvm.org/llvm.sh | {sudo}bash -s -- 19"
        package = "libllvm18" if "ubuntu" in like else "libllvm19"
        return f"{sudo}apt-get update && {sudo}apt-get install -y {package}"
    if like & {"fedora", "rhel", "centos"}:
        return f"{sudo}dnf install -y llvm-libs"
    if "arch" in like:
        return f"{sudo}pacman -S --noconfirm llvm-libs"
    return from_conda


def main() -> int:
    """Print which LLVM Dr.Jit should load, or on stderr the problem; returns the exit status."""
    library = choose()
    if library is None:
        problem = refusal()
    elif error := loading_error(library.path):
        problem = f"{library.path}: {error}; run: {install_command()}"
    else:
        print(f"LLVM {library.major}: {library.path}")
        return 0
    print(problem, file=sys.stderr)
    return 1


def _best(libraries: list[Library]) -> Library | None:
    usable = [library for library in libraries if not library.problem]
    return max(usable, key=lambda library: _preference(library.major or 0), default=None)


def _preference(major: int) -> tuple[bool, int]:
    """Sort key: the newest that was tried, then the least new of those that were not."""
    return (True, major) if major <= NEWEST_TRIED else (False, -major)


def _named(system: System) -> Library | None:
    """Library that the variable names; a bare file name is looked up as the linker does."""
    value = system.environ.get(VARIABLE, "")
    if not value:
        return None
    path = Path(value).expanduser()
    if not path.is_absolute() and len(path.parts) == 1:
        path = next((d / path for d in _folders(system) if (d / path).exists()), path)
    return _inspect(path)


def _folders(system: System) -> Iterator[Path]:
    """Folders that may hold libLLVM, those of this environment before the system's."""
    conda = system.environ.get("CONDA_PREFIX")
    environments = [*([Path(conda)] if conda else []), *system.prefixes]
    if system.platform == "win32":
        for prefix in environments:
            yield prefix / "Library" / "bin"
        yield Path(system.environ.get("ProgramFiles", r"C:\Program Files")) / "LLVM" / "bin"
        return
    for prefix in environments:
        yield prefix / "lib"
    for folder in filter(None, system.environ.get("LD_LIBRARY_PATH", "").split(":")):
        yield Path(folder)
    patterns = [
        *("usr/lib/*-linux-gnu", "usr/lib64", "usr/lib", "usr/local/lib", "usr/local/lib64"),
        *("usr/lib/llvm*/lib", "usr/lib64/llvm*/lib", "usr/lib64/llvm*/lib64"),
        *("opt/homebrew/opt/llvm*/lib", "usr/local/opt/llvm*/lib", "opt/local/libexec/llvm-*/lib"),
        "home/linuxbrew/.linuxbrew/opt/llvm*/lib",
    ]
    for pattern in patterns:
        yield from sorted(system.root.glob(pattern))


def _inspect(path: Path) -> Library:
    """Check one file without loading it into this process."""
    try:
        real = path.resolve(strict=True)
        with real.open("rb") as file:
            head = file.read(20)
    except FileNotFoundError:
        return Library(path, None, "does not exist")
    except IsADirectoryError:
        return Library(path, None, "is a folder")
    except (OSError, RuntimeError) as error:  # RuntimeError: a circle of links
        return Library(path, None, f"cannot be read ({getattr(error, 'strerror', error)})")
    if not _is_native(head):
        return Library(real, None, "is not a shared library for this machine")
    match = _MAJOR.match(real.name) or _MAJOR.match(path.name)
    major, problem = (int(match[1]), "") if match else _load_in_subprocess(real)
    if major and major < MINIMUM_MAJOR:
        problem = f"is LLVM {major}"
    return Library(real, major, problem)


def _is_native(head: bytes) -> bool:
    """Whether a file that starts with these bytes is a library for this platform."""
    if head[:4] == b"\x7fELF" and sys.platform == "linux":
        with Path("/proc/self/exe").open("rb") as file:
            own = file.read(20)
        return len(head) == 20 and head[4:6] == own[4:6] and head[18:20] == own[18:20]
    mach_o = (b"\xcf\xfa\xed\xfe", b"\xca\xfe\xba\xbe", b"\xca\xfe\xba\xbf")
    if sys.platform == "darwin":
        return head[:4] in mach_o
    return sys.platform == "win32" and head[:2] == b"MZ"


def _load_in_subprocess(path: Path) -> tuple[int | None, str]:
    """Major version of a library and "", or None and why it cannot be loaded."""
    command = [sys.executable, "-I", "-S", "-c", _ASK_VERSION, str(path)]
    try:
        result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    except (OSError, subprocess.SubprocessError) as error:
        return None, f"cannot be loaded ({error})"
    if result.returncode == 0:
        return int(result.stdout), ""
    lines = result.stderr.strip().splitlines() or [f"exit status {result.returncode}"]
    if "AttributeError" in lines[-1]:
        return None, "is older than LLVM 16"  # LLVMGetVersion came with 16
    return None, f"cannot be loaded ({lines[-1]})"


def _apt_package(system: System) -> tuple[str, bool]:
    """Best libllvm package that apt can install, if any, and whether apt has an index at all."""
    env = {**system.environ, "LC_ALL": "C"}

    def query(*arguments: str) -> str:
        command = ["apt-cache", *arguments]
        try:
            return subprocess.run(command, capture_output=True, text=True, env=env).stdout
        except OSError:
            return ""

    names = query("pkgnames", "libllvm").split()
    majors = {name: int(match[1]) for name in names if (match := _APT_PACKAGE.fullmatch(name))}
    by_preference = sorted(majors, key=lambda n: (majors[n] == PREFERRED, _preference(majors[n])))
    for name in reversed(by_preference):
        known = majors[name] >= MINIMUM_MAJOR and query("policy", name)
        if known and re.search(r"Candidate: (?!\(none\))", known):
            return name, True
    return "", bool(majors)


if __name__ == "__main__":
    sys.exit(main())
