"""Run a selection of the tests on each supported Python, and with the oldest packages.

`make test-versions`: an environment of each Python with the newest packages that `pyproject.toml`
allows, and one of the oldest Python with the oldest. Pythons and packages come from uv, which needs
the package index; environments are kept in `build/versions` until requirements change.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

from release import PYTHONS, pythons

ROOT = Path(__file__).resolve().parents[1]
OLDEST = "oldest"
TESTS = ("pytest", "pytest-timeout", "pytest-xdist", "hypothesis", "pyyaml", "hatchling")
EXTRAS = ("data", "lidar", "cluster")
SELECTION = (
    *(
        "tests/films",
        "tests/signals",
        "tests/io",
        "tests/analysis",
        "tests/runtime/test_interface.py",
    ),
    *("tests/scenes/test_meshes.py", "tests/rendering/test_labels.py", "tests/sensors"),
    *("tests/rendering/test_rendering.py", "tests/integrators/test_closed_forms.py"),
)


def main() -> int:
    """Run the selection in each environment; returns the number of those in which it fails."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    names = (*PYTHONS, OLDEST)
    parser.add_argument("--python", action="append", default=[], help="a Python, by its path")
    parser.add_argument("--only", choices=names, action="append", help="only this environment")
    parser.add_argument("tests", nargs="*", help="other tests than the selection")
    arguments = parser.parse_args()
    if shutil.which("uv") is None:
        print("test-versions: uv is not installed; run: pip install uv", file=sys.stderr)
        return 1
    failed, found = [], pythons(arguments.python)
    for name in arguments.only or names:
        python = environment(name, found[PYTHONS[0] if name == OLDEST else name])
        print(f"test-versions: {name}: {', '.join(versions(python))}", flush=True)
        command = [python, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
        if name == OLDEST:  # Old packages warn about the newer ones that they find
            command += ["-W", "ignore::DeprecationWarning"]
        command += ["-m", "not slow and not statistical", *(arguments.tests or SELECTION)]
        done = subprocess.run(command, cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)})
        failed += [name] * (done.returncode != 0)
    print(f"test-versions: {', '.join(failed) + ' failed' if failed else 'all pass'}")
    return len(failed)


def environment(name: str, base: str) -> str:
    """Python of an environment with the package's requirements, made unless it has these."""
    folder = ROOT / "build/versions" / name
    python = str(folder / "bin/python")
    complete, wanted = folder / "complete", "\n".join([base, *requirements(), *TESTS])
    if not complete.exists() or complete.read_text("utf-8") != wanted:
        subprocess.run(["uv", "venv", "-q", "--clear", "-p", base, str(folder)], check=True)
        install = ["uv", "pip", "install", "-q", "--python", python]
        oldest = ["--resolution", "lowest-direct"] if name == OLDEST else []
        subprocess.run([*install, *oldest, *requirements()], check=True)
        subprocess.run([*install, *TESTS], check=True)
        complete.write_text(wanted, "utf-8")
    return python


def requirements() -> list[str]:
    """Requirements of the package, with its extras for files and data sets."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    extras = project["optional-dependencies"]
    return [*project["dependencies"], *(each for e in EXTRAS for each in extras[e])]


def versions(python: str) -> list[str]:
    """Names and versions of what the tests rest on."""
    code = """
import sys; from importlib.metadata import version
print('Python', sys.version.split()[0])
for name in ('mitsuba', 'drjit', 'numpy', 'scipy', 'xarray'): print(name, version(name))
"""
    done = subprocess.run([python, "-c", code], check=True, capture_output=True, text=True)
    return done.stdout.splitlines()


if __name__ == "__main__":
    sys.exit(main())
