"""Check that a release can be made of the committed state: `make release-check`.

Builds wheel and source archive twice and compares them, looks at what they contain, compares the
versions in all files, and runs the README's commands in empty environments without the clone, one
for each Python. What has passed is left in `dist/`. Environments need the package index.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PYTHONS = ("3.11", "3.12", "3.13")
EXTRAS = "explore,cluster,course"
TOP = ("pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")
TOP += ("CITATION.cff", ".zenodo.json", "Makefile")
WHEEL = ("tofrender/py.typed", "tofrender/__init__.pyi", "tofrender/scenes/meshes.npz")
PRIVATE = re.compile(
    r"(^|/)(\.git/|\.venv|build/|dist/|out/|__pycache__|\.env|core\.\d+|[^/]*\.(pyc|log|orig|swp)$)"
)
SMALL = {
    "render": "--size 8x8 --spp 4 --no-video",
    "phasor": "--size 8x8 --spp 4",
    "gate": "--size 8x8 --spp 4",
    "capture": "--grid 8x8 --spp 4",
    "dataset": "--plan",
    "view": "--size 8x8 --spp 1 --no-browser",
    "warptest": "--no-browser",
}
"""Options that make a command of the README small."""

CLONE = ("verify", "release", "grade", "start", "submit")
"""Commands of the course, which say that they need a clone or the students' edition."""


class Problem(Exception):
    """What keeps a release back, in a line."""


def main() -> int:
    """Run all checks; returns the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--python", action="append", default=[], help="a Python, by its path")
    parser.add_argument("--no-install", action="store_true", help="only build and compare")
    arguments = parser.parse_args()
    try:
        with tempfile.TemporaryDirectory() as folder:
            wheel, archive = build_twice(Path(folder))
            check_contents(names_in(wheel), names_in(archive))
            check_texts(wheel, archive)
            check_versions(ROOT, wheel)
            say("contents and versions are right")
            if not arguments.no_install:
                commands = commands_of((ROOT / "README.md").read_text("utf-8"))
                for version, python in pythons(arguments.python).items():
                    check_commands(wheel, python, version, commands, Path(folder) / version)
            (ROOT / "dist").mkdir(exist_ok=True)
            for each in (wheel, archive):
                shutil.copy(each, ROOT / "dist")
                say(f"dist/{each.name}")
    except Problem as problem:
        print(f"release-check: {problem}", file=sys.stderr)
        return 1
    return 0


def say(line: str) -> None:
    """Print a line at once."""
    print(f"release-check: {line}", flush=True)


# ------------------------------------------------------------------------------------- archives


def build_twice(folder: Path) -> tuple[Path, Path]:
    """Build wheel and source archive in two copies of the committed state, and compare them."""
    made = []
    git = {"cwd": ROOT, "check": True, "capture_output": True}
    files = subprocess.run(["git", "archive", "HEAD"], **git).stdout
    when = subprocess.run(["git", "log", "-1", "--format=%ct"], **git).stdout.decode().strip()
    for number in (1, 2):
        copy, out = folder / f"copy{number}" / "tofrender", folder / f"built{number}"
        copy.mkdir(parents=True)
        command = ["tar", "-x", "-C", str(copy), *(["--touch"] if number == 2 else [])]
        subprocess.run(command, input=files, check=True)
        environment = os.environ | {"SOURCE_DATE_EPOCH": when}
        command = [sys.executable, "-m", "hatchling", "build", "-d", str(out)]
        subprocess.run(command, cwd=copy, env=environment, check=True, capture_output=True)
        made.append(sorted(out.iterdir()))
    require_equal(*made)
    say(f"two builds of {', '.join(each.name for each in made[0])} are equal")
    wheel, archive = sorted(made[0], key=lambda path: path.suffix != ".whl")
    return wheel, archive


def require_equal(first: Iterable[Path], second: Iterable[Path]) -> None:
    """Require that two builds have the same files, byte by byte."""
    both = [{path.name: path.read_bytes() for path in paths} for paths in (first, second)]
    if both[0].keys() != both[1].keys():
        raise Problem(f"two builds made {sorted(both[0])} and {sorted(both[1])}")
    for name, content in both[0].items():
        if content != both[1][name]:
            raise Problem(f"two builds of {name} differ")


def names_in(archive: Path) -> set[str]:
    """Names of the files in a wheel, or in a source archive without its outermost folder."""
    if archive.suffix == ".whl":
        with zipfile.ZipFile(archive) as file:
            return set(file.namelist())
    with tarfile.open(archive) as packed:
        return {each.name.partition("/")[2] for each in packed if each.isfile()}


def check_contents(wheel: set[str], archive: set[str], root: Path = ROOT) -> None:
    """Require what the README uses, and nothing that is private."""
    readme = (root / "README.md").read_text("utf-8")
    linked = {each for each in re.findall(r"\]\(([^():#]+)", readme) if (root / each).is_file()}
    used = {path for path in re.findall(r"[\w/]+\.(?:toml|xml)", readme) if (root / path).is_file()}
    packed = {packed_name(path) for path in used if packed_name(path)}
    lost = (set(TOP) | linked | used) - archive
    lost |= (set(WHEEL) | packed) - wheel
    if not any(name.endswith(".dist-info/licenses/LICENSE") for name in wheel):
        lost.add("licenses/LICENSE")
    if lost:
        raise Problem(f"missing: {', '.join(sorted(lost))}")
    private = sorted(name for name in wheel | archive if PRIVATE.search(name))
    more = sorted(n for n in wheel if not n.startswith("tofrender/") and ".dist-info/" not in n)
    if private or more:
        raise Problem(f"must not be in it: {', '.join((private + more)[:5])}")


def packed_name(path: str) -> str:
    """Where the wheel has a file of the checkout, "" if it has not."""
    for folder, inside in (("scenes/", "scenes/xml/"), ("docs/datasets/", "datasets/examples/")):
        if path.startswith(folder):
            return f"tofrender/{inside}{path.removeprefix(folder)}"
    return ""


def check_texts(*archives: Path) -> None:
    """Require that no text has the name of this machine, of its user, or of the checkout."""
    home, host = str(Path.home()), socket.gethostname()
    words = [f"{home}/", f"{ROOT}/", *([host] if len(host) > 5 else [])]
    pattern = re.compile("|".join(map(re.escape, words)).encode())
    for archive in archives:
        for name, content in contents_of(archive):
            if b"\0" not in content[:1024] and (found := pattern.search(content)):
                raise Problem(f"{name} has {found[0].decode()!r}, which is of this machine")


def contents_of(archive: Path) -> Iterable[tuple[str, bytes]]:
    """Names and contents of the files in a wheel or a source archive."""
    if archive.suffix == ".whl":
        with zipfile.ZipFile(archive) as file:
            yield from ((name, file.read(name)) for name in file.namelist())
        return
    with tarfile.open(archive) as file:
        for each in filter(tarfile.TarInfo.isfile, file):
            opened = file.extractfile(each)
            yield each.name, opened.read() if opened else b""


def check_versions(root: Path, wheel: Path | None = None) -> str:
    """Require one version everywhere, and return it."""
    patterns = {
        "tofrender/__init__.py": r'^__version__ = "(.*)"$',
        "CITATION.cff": r"^version: (.*)$",
        ".zenodo.json": r'^  "version": "(.*)",$',
        "docs/cite.md": r"^  version = \{(.*)\},$",
    }
    found = {}
    for name, pattern in patterns.items():
        match = re.search(pattern, (root / name).read_text("utf-8"), re.MULTILINE)
        found[name] = match[1] if match else "none"
    if wheel is not None:
        found[wheel.name] = wheel.name.split("-")[1]
    version = found["tofrender/__init__.py"]
    wrong = {name: other for name, other in found.items() if other != version}
    if wrong:
        raise Problem(f"version {version} of tofrender/__init__.py is not that of {wrong}")
    if not re.search(rf"^## {re.escape(version)}\b", (root / "CHANGELOG.md").read_text(), re.M):
        raise Problem(f"CHANGELOG.md has no section {version}")
    json.loads((root / ".zenodo.json").read_text("utf-8"))
    return version


# ------------------------------------------------------------------------------------- commands


def commands_of(readme: str) -> list[list[str]]:
    """Arguments of each `tofrender` in the shell blocks of a page."""
    blocks = re.findall(r"```sh\n(.*?)```", readme, re.DOTALL)
    lines = [line for block in blocks for line in block.splitlines()]
    return [shlex.split(line, comments=True) for line in lines if line.startswith("tofrender ")]


def pythons(given: list[str]) -> Mapping[str, str]:
    """A Python for each version, from the arguments, the path, or uv."""
    found = {}
    for python in [*given, *(f"python{version}" for version in PYTHONS)]:
        code = "import sys; print('%d.%d' % sys.version_info[:2])"
        asked = run_quietly([python, "-c", code])
        if asked is not None and asked.strip() in PYTHONS:
            found.setdefault(asked.strip(), python)
    for version in PYTHONS:
        if version not in found:
            run_quietly(["uv", "python", "install", version])
            path = run_quietly(["uv", "python", "find", version])
            if path is None:
                raise Problem(f"no Python {version}: name it by --python, or install uv")
            found[version] = path.strip()
    return {version: found[version] for version in PYTHONS}


def run_quietly(command: list[str]) -> str | None:
    """Output of a command, None if it fails or does not exist."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, cwd="/")
    except OSError:
        return None
    return done.stdout if done.returncode == 0 else None


def check_commands(
    wheel: Path, python: str, version: str, commands: list[list[str]], folder: Path
) -> None:
    """Run the README's commands in an empty environment, then again with the extras."""
    folder.mkdir()
    subprocess.run([python, "-m", "venv", str(folder / "venv")], check=True)
    for extras in ("", f"[{EXTRAS}]"):
        shutil.rmtree(folder / "work", ignore_errors=True)
        (folder / "work/submissions").mkdir(parents=True)
        install(folder / "venv", [f"{wheel}{extras}"])
        for command in commands:
            outcome(folder, command, bool(extras))
        said = f"with {EXTRAS}" if extras else "without extras"
        say(f"Python {version}, {said}: {len(commands)} commands of the README do what they say")


def install(venv: Path, packages: list[str]) -> None:
    """Install packages into an environment, by uv if it is there, which is faster."""
    python = str(venv / "bin/python")
    with_uv = ["uv", "pip", "install", "-q", "--python", python]
    command = with_uv if shutil.which("uv") else [python, "-m", "pip", "install", "-q"]
    subprocess.run([*command, *packages], check=True)


def outcome(folder: Path, command: list[str], has_extras: bool) -> None:
    """Run a command of the README at small size; a Problem unless it works or says why not."""
    name = command[1]
    arguments = [str(folder / "venv/bin/tofrender"), *command[1:]]
    if "--help" not in command:
        arguments += SMALL.get(name, "").split()
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    is_server = "--no-browser" in arguments
    with subprocess.Popen(
        arguments,
        cwd=folder / "work",
        env=environment | {"PYTHONUNBUFFERED": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        said = ""
        for line in process.stdout or ():
            said += line
            if is_server and "http://" in line:
                process.send_signal(signal.SIGINT)
                process.wait()
                return
    status, shown = process.returncode, f"`{shlex.join(command)}`"
    warning = re.search(r"^warning: .*", said, re.MULTILINE)
    if warning:
        raise Problem(f"{shown} warns: {warning[0]}")
    if status == 0:
        return
    last = said.strip().splitlines()[-1] if said.strip() else ""
    needs_extra = re.search(r"pip install 'tofrender\[(\w+)\]'", last)
    if (needs_extra and not has_extras) or (name in CLONE and "checkout" in last):
        return
    raise Problem(f"{shown} ended with status {status}: {last}")


if __name__ == "__main__":
    sys.exit(main())
