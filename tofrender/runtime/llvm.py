"""Search for the LLVM library with which Dr.Jit compiles its CPU kernels.

Dr.Jit loads LLVM at run time: the file in `DRJIT_LIBLLVM_PATH`, otherwise the first `libLLVM.so`
that the linker finds. Dr.Jit refuses LLVM 14 and older. LLVM 15 and 16 start, but on a CPU with
AVX-512 the *process aborts* at the first kernel with a minimum ("Cannot select: fminimum"). Debian
12 contains 14 and 15. Therefore the library is chosen here, before Dr.Jit is imported, and its
version is at least `MINIMUM_MAJOR`.

Versions are read from file names, or by loading the library in a subprocess. This module uses only
the standard library, because the set-up runs it before anything is installed:

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

# Oldest version with a code generator that supports all of Dr.Jit's output
MINIMUM_MAJOR = 17

# Newer versions are used only if no other version is found
NEWEST_TRIED = 22

# Version to install. All published figures were measured with it
PREFERRED = 19

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

    # Its file, with symbolic links resolved
    path: Path

    # Major version, None if it is unknown
    major: int | None

    # Why Dr.Jit must not load the library, "" if it is usable
    problem: str = ""


def _distributions() -> set[str]:
    """Return ID and ID_LIKE of this Linux distribution, such as {"ubuntu", "debian"}."""
    try:
        release = platform.freedesktop_os_release()
    except (OSError, ValueError):
        # The file is missing, or is not encoded in UTF-8
        return set()
    return {release["ID"], *release.get("ID_LIKE", "").split()}


@dataclass(frozen=True)
class System:
    """Machine that is searched. Tests pass another machine."""

    # Root of the file system, and environment variables
    root: Path = Path("/")
    environ: Mapping[str, str] = field(default_factory=lambda: os.environ)
    platform: str = sys.platform

    # Folders of the virtual environment and of its base
    prefixes: tuple[Path, ...] = (Path(sys.prefix), Path(sys.base_prefix))

    # User, 0 for root
    euid: int = field(default_factory=lambda: getattr(os, "geteuid", lambda: 1)())

    # Names of the Linux distribution
    distributions: set[str] = field(default_factory=_distributions)


def candidates(system: System | None = None) -> list[Library]:
    """List all libLLVM files on this machine, starting with the file in `DRJIT_LIBLLVM_PATH`.

    Unusable files are listed with their problem. No library is loaded into this process.
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
    """Choose the library that Dr.Jit should load. Return None if no library is usable.

    If `DRJIT_LIBLLVM_PATH` names a library, no other library is chosen, even if it is unusable.
    """
    system = system or System()
    named = _named(system)
    return _best([named] if named else candidates(system))


def refusal(system: System | None = None) -> str:
    """Return the message for a missing library: the problem and the command that helps."""
    # The variable names an unusable file
    system = system or System()
    named = _named(system)
    found = candidates(system)
    if named:
        line = (
            f"{VARIABLE} = '{system.environ[VARIABLE]}' {named.problem}: must name the file of "
            f"LLVM {MINIMUM_MAJOR} or newer; "
        )
        if best := _best(found):
            return f"{line}`unset {VARIABLE}` to use {best.path}"
        return f"{line}unset it and run: {install_command(system)}"

    # No library is new enough
    majors = sorted({library.major for library in found if library.major})
    only = f", only {', '.join(map(str, majors))}" if majors else ""
    return f"no LLVM {MINIMUM_MAJOR} or newer found{only}; run: {install_command(system)}"


def loading_error(path: Path) -> str:
    """Return why a library cannot be loaded, e.g. a missing dependency, or "" if it can."""
    return _load_in_subprocess(path)[1]


def install_command(system: System | None = None) -> str:
    """Return the command that installs a usable LLVM on this system."""
    # Which conda is available?
    system = system or System()
    sudo = "" if system.euid == 0 else "sudo "
    names = ("mamba", "conda", "micromamba")
    path = system.environ.get("PATH", "")
    conda = next((name for name in names if shutil.which(name, path=path)), "conda")
    from_conda = f"{conda} install -y -c conda-forge libllvm19"

    # Windows, conda environments, and macOS
    if system.platform == "win32":
        return "winget install LLVM.LLVM"
    if system.environ.get("CONDA_PREFIX") and system.euid != 0:
        return from_conda
    if system.platform == "darwin":
        return "brew install llvm"

    # Linux distributions
    like = system.distributions
    if like & {"debian", "ubuntu"}:
        package, index = _apt_package(system)
        if package:
            return f"{sudo}apt-get install -y {package}"
        if index:
            # The release is older than LLVM 17. LLVM's archive supports it
            return f"wget -qO- https://apt.llvm.org/llvm.sh | {sudo}bash -s -- 19"
        package = "libllvm18" if "ubuntu" in like else "libllvm19"
        return f"{sudo}apt-get update && {sudo}apt-get install -y {package}"
    if like & {"fedora", "rhel", "centos"}:
        return f"{sudo}dnf install -y llvm-libs"
    if "arch" in like:
        return f"{sudo}pacman -S --noconfirm llvm-libs"
    return from_conda


def main() -> int:
    """Print the LLVM that Dr.Jit should load, or the problem on stderr. Return the exit status."""
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
    """Return the preferred usable library, None if no library is usable."""
    usable = [library for library in libraries if not library.problem]
    return max(usable, key=lambda library: _preference(library.major or 0), default=None)


def _preference(major: int) -> tuple[bool, int]:
    """Return the sort key of a major version of LLVM. The largest key is preferred.

    The largest key is that of the newest tested version. If all versions are newer than the tested
    versions, the largest key is that of the oldest version.
    """
    return (True, major) if major <= NEWEST_TRIED else (False, -major)


def _named(system: System) -> Library | None:
    """Return the library in the variable. A bare file name is searched as the linker does."""
    value = system.environ.get(VARIABLE, "")
    if not value:
        return None
    path = Path(value).expanduser()
    if not path.is_absolute() and len(path.parts) == 1:
        path = next((d / path for d in _folders(system) if (d / path).exists()), path)
    return _inspect(path)


def _folders(system: System) -> Iterator[Path]:
    """Yield folders that may contain libLLVM, first the folders of this environment."""
    # Environments
    conda = system.environ.get("CONDA_PREFIX")
    environments = [*([Path(conda)] if conda else []), *system.prefixes]
    if system.platform == "win32":
        for prefix in environments:
            yield prefix / "Library" / "bin"
        yield Path(system.environ.get("ProgramFiles", r"C:\Program Files")) / "LLVM" / "bin"
        return
    for prefix in environments:
        yield prefix / "lib"

    # Folders of the linker and of the system
    for folder in filter(None, system.environ.get("LD_LIBRARY_PATH", "").split(":")):
        yield Path(folder)
    patterns = [
        "usr/lib/*-linux-gnu",
        "usr/lib64",
        "usr/lib",
        "usr/local/lib",
        "usr/local/lib64",
        "usr/lib/llvm*/lib",
        "usr/lib64/llvm*/lib",
        "usr/lib64/llvm*/lib64",
        "opt/homebrew/opt/llvm*/lib",
        "usr/local/opt/llvm*/lib",
        "opt/local/libexec/llvm-*/lib",
        "home/linuxbrew/.linuxbrew/opt/llvm*/lib",
    ]
    for pattern in patterns:
        yield from sorted(system.root.glob(pattern))


def _inspect(path: Path) -> Library:
    """Check whether a file is a libLLVM that Dr.Jit can use, without loading it into this process.

    The header of the file is read, and the version is taken from the file name. If the name
    contains no version, a subprocess loads the file and asks for the version.

    Returns:
        The library with its version. If the library is not usable, `problem` contains the reason.
    """
    # Can the file be read?
    try:
        real = path.resolve(strict=True)
        with real.open("rb") as file:
            head = file.read(20)
    except FileNotFoundError:
        return Library(path, None, "does not exist")
    except IsADirectoryError:
        return Library(path, None, "is a folder")
    except (OSError, RuntimeError) as error:
        # A RuntimeError reports a cycle of links
        return Library(path, None, f"cannot be read ({getattr(error, 'strerror', error)})")
    if not _is_native(head):
        return Library(real, None, "is not a shared library for this machine")

    # Which version is it?
    match = _MAJOR.match(real.name) or _MAJOR.match(path.name)
    major, problem = (int(match[1]), "") if match else _load_in_subprocess(real)
    if major and major < MINIMUM_MAJOR:
        problem = f"is LLVM {major}"
    return Library(real, major, problem)


def _is_native(head: bytes) -> bool:
    """Return whether a file that starts with these bytes is a library for this platform."""
    if head[:4] == b"\x7fELF" and sys.platform == "linux":
        with Path("/proc/self/exe").open("rb") as file:
            own = file.read(20)
        return len(head) == 20 and head[4:6] == own[4:6] and head[18:20] == own[18:20]
    mach_o = (b"\xcf\xfa\xed\xfe", b"\xca\xfe\xba\xbe", b"\xca\xfe\xba\xbf")
    if sys.platform == "darwin":
        return head[:4] in mach_o
    return sys.platform == "win32" and head[:2] == b"MZ"


def _load_in_subprocess(path: Path) -> tuple[int | None, str]:
    """Return the major version of a library and "", or None and why it cannot be loaded."""
    command = [sys.executable, "-I", "-S", "-c", _ASK_VERSION, str(path)]
    try:
        result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    except (OSError, subprocess.SubprocessError) as error:
        return None, f"cannot be loaded ({error})"
    if result.returncode == 0:
        return int(result.stdout), ""

    # Describe the problem. LLVMGetVersion exists since LLVM 16
    lines = result.stderr.strip().splitlines() or [f"exit status {result.returncode}"]
    if "AttributeError" in lines[-1]:
        return None, "is older than LLVM 16"
    return None, f"cannot be loaded ({lines[-1]})"


def _apt_package(system: System) -> tuple[str, bool]:
    """Return the preferred libllvm package of apt, and whether apt has an index.

    The name is "" if apt has no usable package.
    """
    env = {**system.environ, "LC_ALL": "C"}

    def query(*arguments: str) -> str:
        """Return the output of apt-cache, "" if it is missing."""
        command = ["apt-cache", *arguments]
        try:
            return subprocess.run(command, capture_output=True, text=True, env=env).stdout
        except OSError:
            return ""

    # List the packages, and choose one that can be installed
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
