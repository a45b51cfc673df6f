"""Decide which notebooks and examples have to run again, and run notebooks side by side.

A page runs again if its own code has changed, or a module of the package that its last run had
imported. Comments and docstrings of modules do not count. `record` writes down the imports of a
run. jupyter-cache keeps the outputs of notebooks, and sphinx-gallery keeps the outputs of examples.
"""

from __future__ import annotations

import ast
import hashlib
import json
import os
import sys
import time
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import cache
from multiprocessing import get_context
from pathlib import Path

# This file also runs from its copy in the build.
ROOT = next(folder for folder in Path(__file__).parents if (folder / "pyproject.toml").is_file())
BUILD = ROOT / "build" / "docs"
RUNS = BUILD / "runs"
"""Folder with a file NAME.json for each page: the files that its last run used, with digests."""
NOTEBOOKS = BUILD / "notebooks"
PAGE = "TOFRENDER_DOCS_PAGE"
"""Environment variable with the name of the page that a process runs."""
TIMEOUT_S = 600
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
TEXT = (".md", ".png", ".py", ".pyc", ".pyi")
"""Endings of files that are no data."""


@cache
def digest(path: Path) -> str:
    """Return a digest of a file. Comments and docstrings of the package do not change it."""
    content = path.read_bytes()
    if path.suffix == ".py" and path.is_relative_to(ROOT / "tofrender"):
        tree = ast.parse(content)
        for node in ast.walk(tree):
            if isinstance(node, DOCUMENTED) and ast.get_docstring(node, clean=False) is not None:
                node.body = node.body[1:]
        content = ast.dump(tree).encode()
    return hashlib.sha256(content).hexdigest()[:16]


def data_files(modules: Iterable[Path]) -> set[Path]:
    """Return the data that modules may have read: scenes, and the data of their packages."""
    package = ROOT / "tofrender"
    folders = {module.parent for module in modules} - {package}
    found = [*package.rglob("*.*"), *(ROOT / "scenes").rglob("*.*")]
    data = {path for path in found if path.is_file() and path.suffix not in TEXT}
    return {path for path in data if package not in path.parents or folders & set(path.parents)}


def record(name: str) -> None:
    """Write down which modules of the package this process has imported to run a page."""
    modules = {
        Path(module.__file__)
        for module_name, module in list(sys.modules.items())
        if module_name.split(".")[0] == "tofrender" and getattr(module, "__file__", None)
    }
    RUNS.mkdir(parents=True, exist_ok=True)
    (RUNS / f"{name}.txt").write_text("\n".join(str(module) for module in sorted(modules)))


def keep(name: str) -> None:
    """Store the files and digests that the last run of a page used, if the page has just run."""
    recorded = RUNS / f"{name}.txt"
    if not recorded.exists():
        return
    modules = [Path(line) for line in recorded.read_text().splitlines()]
    files = {*modules, *data_files(modules)}
    kept = {str(path.relative_to(ROOT)): digest(path) for path in sorted(files)}
    size = os.environ.get("TOFRENDER_NOTEBOOK_SIZE", "")
    (RUNS / f"{name}.json").write_text(json.dumps({"size": size, "files": kept}, indent=0))
    recorded.unlink()


def is_current(name: str) -> bool:
    """Return whether a page has run with the present size and the present package."""
    try:
        kept = json.loads((RUNS / f"{name}.json").read_text())
    except FileNotFoundError:
        return False
    if name.endswith(".ipynb") and kept["size"] != os.environ.get("TOFRENDER_NOTEBOOK_SIZE", ""):
        return False
    paths = {ROOT / file: known for file, known in kept["files"].items()}
    return all(path.is_file() and digest(path) == known for path, known in paths.items())


def run_notebook(path: Path) -> None:
    """Run a notebook in this process's child, and put its outputs into the cache."""
    from jupyter_cache import get_cache
    from jupyter_cache.executors import load_executor

    os.environ[PAGE] = path.name
    kept = get_cache(str(NOTEBOOKS))
    done = load_executor("local-serial", kept).run_and_cache(
        filter_uris=[str(path)], timeout=TIMEOUT_S, force=True
    )
    if done.succeeded != [str(path)]:
        raise RuntimeError(kept.get_project_record(str(path)).traceback or "it did not start")


def stale_notebooks(paths: Iterable[Path]) -> list[Path]:
    """Return the notebooks that have to run: other code, or another package."""
    from jupyter_cache import get_cache

    kept = get_cache(str(NOTEBOOKS))
    uris = {path: kept.add_nb_to_project(str(path)).uri for path in paths}
    unexecuted = {record.uri for record in kept.list_unexecuted(list(uris.values()))}
    return [path for path, uri in uris.items() if uri in unexecuted or not is_current(path.name)]


def run_jobs(jobs: dict[str, tuple], processes: int) -> list[str]:
    """Run functions with arguments, each in a new process, and print the progress.

    Returns:
        The names of the jobs that failed.
    """
    failed: list[str] = []
    if not jobs:
        return failed

    with ProcessPoolExecutor(
        processes, mp_context=get_context("spawn"), max_tasks_per_child=1
    ) as pool:
        started = time.monotonic()
        futures = {pool.submit(*job): name for name, job in jobs.items()}
        for count, future in enumerate(as_completed(futures), 1):
            name = futures[future]
            clock = f"{time.monotonic() - started:.0f} s"
            if error := future.exception():
                failed.append(name)
                print(f"docs: {name} failed: {error}", file=sys.stderr, flush=True)
                continue
            keep(name)
            print(f"docs: ran {name} ({count} of {len(jobs)}, {clock})", flush=True)
    return failed
