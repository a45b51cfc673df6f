"""Run adapters in separate processes, and judge their renders."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .cases import Case
from .verdicts import Verdict, judge, readings_of, threshold

WORKER = Path(__file__).with_name("worker.py")
ADAPTERS = sorted(
    path.stem
    for path in (WORKER.parent / "adapters").glob("*.py")
    if path.stem not in ("__init__", "mitsuba_scenes")
)
CASE_LIMIT_S = 600  # Time limit of a case [s]


@dataclass
class Renderer:
    """Adapter with the Python in which its renderer is installed.

    Attributes:
        name: Name of the adapter, or path of its file.
        python: Path of the interpreter.
        version: Names and versions of the renderer; None if it is not installed.
        abilities: Abilities that the adapter declares.
        install: How to install the renderer.
    """

    name: str
    python: str
    version: str | None
    abilities: frozenset[str]
    install: str


def describe(name: str, python: str = sys.executable) -> Renderer:
    """Start an adapter, and read its version and abilities."""
    done = subprocess.run([python, WORKER, name], capture_output=True, text=True)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise RuntimeError(f"{name}: adapter does not start: {last}")
    told = json.loads(done.stdout.splitlines()[-1])
    return Renderer(name, python, told["version"], frozenset(told["abilities"]), told["install"])


def run(
    renderer: Renderer,
    cases: Sequence[Case],
    runs: int = 16,
    samples: float = 1.0,
    progress: Callable[[str], None] = lambda line: None,
    among: Sequence[Case] = (),
) -> dict[str, Verdict]:
    """Render cases and judge them; returns verdicts by name.

    Args:
        renderer: The renderer.
        cases: Cases to render.
        runs: Number of independent runs of each case, at least 2.
        samples: Factor of the samples per pixel of each case.
        progress: Function that is called with a line for each case.
        among: All cases that share the false-alarm rate; `cases` by default.
    """
    # Which cases are supported, and in which form?
    forms = {case.name: case.form_for(renderer.abilities) for case in cases}
    found = {
        case.name: Verdict(
            "not supported", note=", ".join(sorted(case.missing(renderer.abilities)))
        )
        for case in cases
        if forms[case.name] is None
    }

    # Render and judge
    todo = [form for form in forms.values() if form is not None]
    allowed = threshold(sum(len(readings_of(case)) for case in among or cases))
    with tempfile.TemporaryDirectory() as folder:
        for name, result in rendered(renderer, todo, runs, samples, Path(folder)):
            case = forms[name]
            if isinstance(result, str):
                found[name] = Verdict("error", case.bins["quantity"], note=result)
            else:
                found[name] = judge(case, *result, allowed)
            verdict = found[name]
            bias = "" if verdict.bias is None else f" {verdict.bias:+.1f} sigma"
            progress(f"{renderer.name:16s} {name:24s} {verdict.status}{bias} {verdict.note}")
    return {case.name: found[case.name] for case in cases}


def rendered(renderer: Renderer, cases: list[Case], runs: int, samples: float, folder: Path):
    """Yield the name of each case with (runs, processor time), or with an error.

    If the process crashes, the remaining cases are rendered in a new process.
    """
    left = {case.name: case for case in cases}
    while left:
        # Polarized light needs another variant of Mitsuba, and therefore another process
        polarized = next(iter(left.values())).bins["quantity"] == "stokes"
        now = [c for c in left.values() if (c.bins["quantity"] == "stokes") == polarized]

        # Start the process
        described = [case.request(runs, samples) for case in now]
        (folder / "cases.json").write_text(json.dumps(described))
        command = [renderer.python, WORKER, renderer.name, folder]
        try:
            limit = CASE_LIMIT_S * len(now)
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=limit, env=_env()
            )
            last = (done.stderr.strip().splitlines() or [""])[-1]
        except subprocess.TimeoutExpired:
            last = f"no answer within {limit} s"

        # Read the results
        ended = []
        for name in (case.name for case in now):
            if (folder / f"{name}.npz").exists():
                with np.load(folder / f"{name}.npz") as file:
                    yield name, (file["runs"], float(file["cpu_s"]))
                ended.append(name)
            elif (folder / f"{name}.txt").exists():
                yield name, (folder / f"{name}.txt").read_text().splitlines()[0][:300]
                ended.append(name)

        # In which case did the process end early?
        if len(ended) < len(now):
            at = folder / "now.txt"
            name = at.read_text() if at.exists() else now[0].name
            name = name if name in left and name not in ended else now[len(ended)].name
            yield name, f"the process ended: {last[:200]}"
            ended.append(name)
        left = {name: case for name, case in left.items() if name not in ended}


def _env() -> Mapping[str, str]:
    """Return an environment without Python warnings."""
    return os.environ | {"PYTHONWARNINGS": "ignore"}
