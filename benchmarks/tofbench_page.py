"""Run tofbench with all adapters and write docs/tofbench.md: python -m benchmarks.tofbench_page.

Renderers in other environments are named by --python RENDERER=PATH. With --page-only, the page is
written from the stored results. The table as HTML and the results as JSON are in out/tofbench.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from pathlib import Path

from .report import paragraph
from .tofbench.report import failures, markdown
from .tofbench.running import ADAPTERS

ROOT = Path(__file__).parents[1]
RESULTS = Path(__file__).with_name("tofbench.json")
PAGE = ROOT / "docs" / "tofbench.md"
OUT = ROOT / "out" / "tofbench"
FIRST = ("tofrender", "mitransient", "mitsuba")

REPRODUCTIONS = {
    "mitransient, crop": """a film of 4 x 3 pixels with `crop_width` and `crop_height` 2 gives a
        steady image of shape (2, 2, 3) and bins of shape (3, 4, 12, 3).""",
    "mitransient, sky": """a diffuse sphere of albedo 0.8 under `constant` radiance 1, with
        `max_depth` 2: its own steady image is 0.80, its bins from 0 to 1000 m (or to 10^8 m) sum to
        0.14.""",
    "mitransient, fog-null": """single scattering by `transient_prbvolpath` in a `heterogeneous`
        medium. Its largest density is 2.5 times the density at the light. The steady image is
        right (0.0386); 36 % of the light arrives before 2.62 m, the distance from lamp to camera.
        With a `homogeneous` medium (`fog-isotropic`), the bins are right.""",
    "mitransient, nlos-occluded": """`transient_nlos_path` with `nlos_hidden_geometry_sampling`:
        a plate adds light although another plate hides it from laser spot and sensor.""",
    "mitransient, nlos-two-sided": """the same integrator with a single `twosided` plate. The
        normal of the plate points away from the wall, and the result contains no light.""",
}
"""Description of each failure, in the terms of the other renderer."""


def page(results: dict) -> str:
    """Return the page in Markdown."""
    made = f"""`python -m benchmarks.tofbench_page` made this table on {results["date"]}, with
        {results["runs"]} runs of each case."""
    intro = """`benchmarks/tofbench/` tests transient renderers against closed forms: when does
        light arrive, and how much? It does not import tofrender, so that you can copy and use it
        separately. Its README describes scenes, cases and adapters. Its data are in the public
        domain (CC0)."""
    rows = """A renderer **passes** a case if no reading (sums of bins) deviates from its exact
        value by more than chance allows. A correct renderer fails one or more cases of its column
        with a probability of at most 0.1 %. Each cell shows the largest deviation in standard
        errors (σ). For passed cases, it also shows the processor time that the renderer needs for a
        relative error of 1 %. A dash means that the adapter does not support the case. It is not a
        fault of the renderer. **Steady**: the renderer does not resolve time, and its image is
        compared with the sum over time. **Delays**: only arrival times are compared. Times were
        measured on one machine with two cores, shared with other work."""
    rows_of_references = """A closed form does not exist for the cases named `reference`. These
        cases compare with bins rendered by tofrender, with error bars. They are meaningful only for
        the other renderers."""

    # List the failures
    wrong = []
    for line in failures(results):
        name, _, text = line.partition(": ")
        shown = " ".join(REPRODUCTIONS.get(name, "").split())
        renderer, _, case = name.partition(", ")
        again = f"`python -m benchmarks.tofbench --renderer {renderer} --case {case}`"
        wrong.append(f"- **{name}** ({text}): {shown} {again}".replace(":  ", ": "))

    # Join the parts of the page
    blocks = ["# Tests of transient renderers (tofbench)", paragraph(intro), paragraph(rows)]
    blocks += [paragraph(rows_of_references), paragraph(made)]
    blocks += ["## Results", markdown(results), "## Failures, and how to reproduce them"]
    blocks.append("\n".join(wrong) if wrong else "None.")
    return "\n\n".join(blocks) + "\n"


def main() -> None:
    """Run all adapters, except with --page-only, and write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition(":")[0])
    parser.add_argument("--python", action="append", default=[], metavar="RENDERER=PATH")
    parser.add_argument("--page-only", action="store_true", help="use the stored results")
    arguments = parser.parse_args()
    if not arguments.page_only:
        names = [*FIRST, *(name for name in ADAPTERS if name not in FIRST)]
        command = [sys.executable, "-m", "benchmarks.tofbench", "--out", str(OUT)]
        command += [part for name in names for part in ("--renderer", name)]
        command += [part for each in arguments.python for part in ("--python", each)]
        done = subprocess.run(command, cwd=ROOT)
        if done.returncode:
            sys.exit(done.returncode)
        shutil.copy(OUT / "tofbench.json", RESULTS)
    PAGE.write_text(page(json.loads(RESULTS.read_text())), encoding="utf-8")


if __name__ == "__main__":
    main()
