"""Write the page, the figure and the table of the README from the results of `make bench-full`."""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tofrender.runtime.canvas import new_figure

from . import denoising

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
PAGE = ROOT / "docs" / "performance.md"
GPU = ROOT / "benchmarks" / "gpu.json"
"""Results of `python -m benchmarks.gpu --out benchmarks/gpu.json` on a GPU."""

FIGURE = ROOT / "docs" / "pictures" / "performance.png"
BEGIN = "<!-- made by make bench-full -->"
END = "<!-- end -->"
WIDTH = 112
PEER = "mitransient"
MEASURES = ("cube", "without lamps", "relative per bin")

Results = Mapping[str, Any]


def digits(value: float) -> str:
    """Format a number with two digits, the precision of the measurements."""
    return f"{float(f'{value:.2g}'):g}"


def over_ours(row: Mapping[str, Any], who: str, measure: str) -> str:
    """Return the figure of another renderer divided by ours."""
    return digits(row[who][measure] / row["ours"][measure]) if who in row else "-"


def rows_of(cells: list[list[str]]) -> str:
    """Format a table in Markdown. The first row is the head."""
    head, *rest = cells
    lines = [head, ["---"] * len(head), *rest]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def scenes_table(results: Results, who: str) -> str:
    """Return a table of all scenes, with the figures of `who` divided by ours."""
    head = ["scene", *MEASURES]
    rows = [
        [name, *(over_ours(row, who, measure) for measure in MEASURES)]
        for name, row in results["scenes"].items()
        if who in row
    ]
    return rows_of([head, *rows])


def paragraph(text: str) -> str:
    """Wrap text to lines of equal length. Empty lines separate paragraphs."""
    return "\n\n".join(
        textwrap.fill(" ".join(p.split()), WIDTH, break_on_hyphens=False)
        for p in text.split("\n\n")
    )


def readme_block(results: Results) -> str:
    """Return the text and the table of the README."""
    scenes = results["scenes"]
    large = results["times"]["size"]["256"]
    machine = results["machine"]
    box = scenes["Cornell box"]
    mirror, glass = (
        over_ours(scenes[name], PEER, "without lamps") for name in ("mirror", "glass sphere")
    )
    before = f"""`make bench-full` renders the Cornell box with 64 x 64 pixels, 300 bins and 256
        samples per pixel on {machine["threads"]} threads, alternating between tofrender and
        mitransient {machine["versions"][PEER]} (with its defaults) in one process. The last
        measurement was made at commit {results["commit"]} on {machine["processor"]}. The table
        shows variance times CPU time of mitransient, divided by the same product of tofrender.
        Above 1, tofrender is more efficient:"""
    rows = [
        ["variance of", "mitransient / tofrender"],
        ["all bins of all pixels", over_ours(box, PEER, "cube")],
        ["all bins, without pixels that see the lamp", over_ours(box, PEER, "without lamps")],
        ["the same, each bin relative to its squared mean", over_ours(box, PEER, MEASURES[2])],
    ]
    after = f"""In the first row, nearly all of mitransient's variance is in the few pixels that
        show the lamp. The second ratio is {mirror} in a scene with a mirror, and {glass} with a
        glass sphere. At 256 x 256 pixels, a sample of tofrender needs {digits(large["ours"])} times
        as long as a sample of Mitsuba's steady `path`. With `light_samples = 1` and without the
        techniques for indirect light and caustics, this factor is
        {digits(large["one light point"])}; for mitransient, it is {digits(large[PEER])}.
        [Performance](docs/performance.md) contains all measurements."""
    return f"{paragraph(before)}\n\n{rows_of(rows)}\n\n{paragraph(after)}"


def page(results: Results) -> str:
    """The page."""
    machine = results["machine"]
    versions = ", ".join(f"{name} {number}" for name, number in machine["versions"].items())
    made = f"""`make bench-full` measured this page in {results["minutes"]:.0f} minutes at commit
        {results["commit"]}:
        {machine["processor"]}, {machine["threads"]} threads, `{machine["variant"]}`; {versions}.
        All numbers are in `benchmarks/results.json`."""
    errors = """Variance times CPU time measures how long a renderer needs to reach a given error.
        The tables show this product for mitransient's `transient_path`, with its defaults, divided
        by the product for `tofrender.render`. Above 1, mitransient needs longer. Settings: 64 x 64
        pixels, 300 bins of 2 cm, 256 samples per pixel, `max_depth` 6. No film is filtered."""
    measures = "\n".join(
        textwrap.fill(f"- **{name}**: {' '.join(what.split())}", WIDTH, subsequent_indent="  ")
        for name, what in (
            ("cube", "mean variance of all bins of all pixels."),
            (
                "without lamps",
                """the same, without pixels that see a lamp and their neighbors. These few pixels
                dominate the cube's variance, because their light arrives in few bins.""",
            ),
            (
                "relative per bin",
                """variance of each bin, summed over the pixels of "without lamps" and divided by
                the sum of squared means; then the mean over all bins with at least 1 % of the
                brightest bin's light. Late light counts as much as early light.""",
            ),
        )
    )
    parts = """Four techniques explain the gain. Directly visible lamps are sampled separately, by
        many short rays. In scenes with diffuse surfaces only, neighboring pixels share the paths of
        indirect light. In scenes with mirrors or clear glass, photons and additional rays find
        caustics ([kinds of paths](how_it_works.md#kinds-of-paths)). Each vertex uses several
        emitter samples (`light_samples`). The next table shows variance times CPU time without
        shared paths and without the techniques for caustics, divided by the default. The table
        after it shows the same with `light_samples = 1` in addition:"""
    filtered = f"""The table shows the mean squared error of the plain render divided by the error
        with `denoise=True`. The first two columns use {denoising.SPP} samples per pixel for both
        renders. In the columns at equal time, the plain render uses additional samples, until it
        needs as much CPU time as the denoised render. Errors are differences from a render with
        {denoising.MANY * denoising.PARTS} samples per pixel. The noise of this reference lowers
        the figures. [Denoising](denoising.md) contains more scenes."""
    gains = "all", "without lamps", "all at equal time", "at equal time"
    filtered_heads = "cube", "without lamps", "cube, equal time", "without lamps, equal time"
    filtered_rows = [["scene", *filtered_heads]] + [
        [name, *(digits(row[gain]) for gain in gains)] for name, row in results["filtered"].items()
    ]
    samplers = results["samplers"]
    sampler_rows = [["sampler", "energy relative to ours", *(f"{m}, over ours" for m in MEASURES)]]
    for name, row in samplers.items():
        if name != "ours":
            bias = f"{100 * row['bias']:+.2f} % ± {100 * row['bias error']:.2f} %"
            ratios = [digits(row[m] / samplers["ours"][m]) for m in MEASURES]
            sampler_rows.append([name, bias, *ratios])
    capture_rows = [["capture", "cube", "relative per bin"]] + [
        [name, over_ours(row, PEER, "cube"), over_ours(row, PEER, MEASURES[2])]
        for name, row in results["captures"].items()
    ]
    captures = """The table shows variance times CPU time of mitransient divided by the same product
        of tofrender, for a hidden letter. Settings: 64 x 64 points of a relay wall, 300 bins of
        6 mm, 256 samples, all bounces."""
    lower = results["times"]["no lamp in view"]
    seconds = f"""The figure shows CPU time divided by the CPU time of Mitsuba's steady `path`, at
        equal samples per pixel. For 256 x 256 pixels of the box's lower half, without a lamp in
        view, `light_samples = 1` without shared paths needs {lower["one light point"]:.2f} times as
        long as `path`."""
    return "\n\n".join(
        [
            "# Performance",
            paragraph(made),
            "## Error at equal time",
            paragraph(errors),
            measures,
            scenes_table(results, PEER),
            paragraph(parts),
            scenes_table(results, "without techniques"),
            scenes_table(results, "one light point"),
            "## Filtered",
            paragraph(filtered),
            rows_of(filtered_rows),
            "## mitransient's samplers",
            paragraph(
                """The table shows mitransient with each of Mitsuba's samplers on the Cornell box:
                how much the energy in all bins differs from tofrender's energy, and variance times
                CPU time divided by the same product of tofrender."""
            ),
            rows_of(sampler_rows),
            "## Around the corner (NLOS)",
            paragraph(captures),
            rows_of(capture_rows),
            "## Time per sample",
            paragraph(seconds),
            "![Time over path by size, bins and samples](pictures/performance.png)",
            "## On a GPU",
            gpu_section(),
        ]
    )


def gpu_section(file: Path | None = None) -> str:
    """Text on GPUs: the measured times, or a statement that they were not measured.

    Args:
        file: Results of the check of a GPU, by default `GPU`.
    """
    file = file or GPU
    if not file.exists():
        return paragraph(NOT_MEASURED) + "\n"
    found = json.loads(file.read_text(encoding="utf-8"))
    if found["small"]:
        raise ValueError(f"{file}: has small sizes, whose times mean nothing; run it on a GPU")

    # Which card, and which versions?
    machine = found["machine"]
    versions = ", ".join(f"{name} {number}" for name, number in machine["versions"].items())
    cards = ", ".join(machine["cards"]) or machine["variant"]
    made = f"""`make test-gpu` measured these times on {cards}, driver {machine["driver"]}, with
        `{machine["variant"]}`; {versions}. The table shows wall-clock time divided by the
        time of Mitsuba's `path`, after the first render. `benchmarks/gpu.json` contains all
        results."""

    # The ratios of each program and each number of samples
    scenes = dict(found["parts"]["times"]["results"])
    scenes.pop("targets", None)
    rows = [["scene", "samples", "`light_samples = 1`", "default", PEER]]
    for name, programs in scenes.items():
        for spp in programs["path"]:
            cells = []
            for who in ("one light point", "ours", PEER):
                measured = isinstance(programs[who], dict)
                cells.append(digits(programs[who][spp]["over_path"]) if measured else "-")
            rows.append([name, spp, *cells])
    return f"{paragraph(made)}\n\n{rows_of(rows)}\n"


NOT_MEASURED = """The present version was not measured on a GPU. `make test-gpu` does this in eight
    minutes: it times renders, compares their light with LLVM, and tests limits of memory.

    An earlier version was measured by hand on an NVIDIA H100. The Cornell box (256 x 256 pixels,
    300 bins) with `light_samples = 1` needed 53 ms with 64 samples per pixel, 2.4 times as long as
    Mitsuba's `path`. With 1024 samples, the ratio was 1.5. With default settings, the ratio was 5
    in both cases."""


def draw(results: Results) -> None:
    """Draw the figure of times."""
    figure = new_figure(11, 3.4)
    times = results["times"]
    axes: Any = figure.subplots(1, 3, sharey=True)
    names = {"size": "width and height [pixels]", "bins": "bins", "spp": "samples per pixel"}

    # Draw times over size, bins and samples
    for ax, (what, label) in zip(axes, names.items(), strict=True):
        for who, style in (("ours", "o-"), ("one light point", "s--"), (PEER, "^-")):
            points = [(int(n), row[who]) for n, row in times[what].items() if who in row]
            ax.plot(*zip(*points, strict=True), style, label=who)
        ax.set(xscale="log", xlabel=label)
        ax.set_xticks([int(n) for n in times[what]], list(times[what]))
        ax.minorticks_off()
        ax.grid(alpha=0.3)

    # Add a legend, and save
    axes[0].set_ylim(bottom=0)
    axes[0].set_ylabel("CPU time over path")
    axes[0].legend(frameon=False)
    FIGURE.parent.mkdir(exist_ok=True)
    figure.savefig(FIGURE, dpi=80)


def with_block(text: str, results: Results) -> str:
    """Replace the table of the README."""
    block = f"{BEGIN}\n{readme_block(results)}\n{END}"
    return re.sub(f"{BEGIN}.*?{END}", lambda _: block, text, flags=re.DOTALL)


def write(results: Results) -> None:
    """Write page, figure and README."""
    PAGE.write_text(page(results), encoding="utf-8")
    README.write_text(with_block(README.read_text(encoding="utf-8"), results), encoding="utf-8")
    draw(results)
