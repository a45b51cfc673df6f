"""Write results as JSON, and tables of results as HTML and Markdown."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence

from .cases import Case
from .running import Renderer
from .verdicts import ALPHA, Verdict

Verdicts = dict[str, Verdict]
OFF = "not supported"

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem; color: #1a1a1a; background: #fff }
table { border-collapse: collapse } th, td { padding: .3rem .6rem; text-align: left }
th, td { border-bottom: 1px solid #ccc } .failed, .error { color: #a40000; font-weight: 600 }
.passed { color: #00571d } .off { color: #5a5a5a }
@media (prefers-color-scheme: dark) {
  body { color: #eee; background: #16181c } .failed, .error { color: #ff9a8f }
  .passed { color: #8ddb9c } .off { color: #aaa }
}
"""


def as_json(found: Sequence[tuple[Renderer, Verdicts]], cases: Sequence[Case], made: dict) -> dict:
    """Collect all results: `made` (date, runs, samples), the cases, and verdicts by renderer."""
    return {
        **made,
        "alpha": ALPHA,
        "cases": {case.name: {"title": case.title, "form": case.form} for case in cases},
        "renderers": {
            renderer.name: {
                "version": renderer.version,
                "verdicts": {name: each.as_dict() for name, each in verdicts.items()},
            }
            for renderer, verdicts in found
        },
    }


def short(verdict: dict | None) -> str:
    """Format a cell: verdict, form of the comparison, bias, and time to 1 %."""
    if verdict is None:
        return "not run"
    if verdict["status"] in (OFF, "error"):
        return verdict["status"]

    # Name the form if it is not the case itself
    form = f" ({verdict['form']})" if verdict["form"] in ("steady", "delays") else ""
    parts = [verdict["status"] + form]
    if verdict["bias"] is not None:
        parts.append("exact" if verdict["form"] == "delays" else f"{sigma(verdict['bias'])} σ")
    if verdict["status"] == "failed" and verdict["form"] == "delays":
        parts.pop()
    if verdict["status"] == "passed" and verdict["seconds"] is not None:
        parts.append(seconds(verdict["seconds"]))
    return ", ".join(parts)


def sigma(bias: float) -> str:
    """Format a bias in standard errors."""
    return f"{bias:+.1f}" if abs(bias) < 100 else f"{'+' if bias > 0 else '−'}>100"


def seconds(value: float) -> str:
    """Format a processor time with one digit."""
    if value < 1e-3:
        return "<1 ms"
    digits = -math.floor(math.log10(value))
    rounded = round(value, digits)
    return f"{rounded:.{max(0, digits)}f} s" if value >= 0.1 else f"{round(value * 1e3):d} ms"


def counts(verdicts: dict[str, dict]) -> str:
    """Count how many of the supported cases pass."""
    states = [each["status"] for each in verdicts.values()]
    supported = [state for state in states if state != OFF]
    return f"{states.count('passed')} of {len(supported)}"


def _rows(results: dict) -> list[list[str]]:
    """Return the cells of the table. Each renderer is a column."""
    # Head, versions and counts
    renderers = results["renderers"]
    rows = [["", *renderers]]
    rows.append(["version", *((r["version"] or "not installed") for r in renderers.values())])
    passed = [counts(r["verdicts"]) if r["version"] else "not run" for r in renderers.values()]
    rows.append(["passed, of those supported", *passed])

    # One row per case
    for name, case in results["cases"].items():
        cells = [short(r["verdicts"].get(name)) for r in renderers.values()]
        rows.append([f"{name}: {case['title']}", *cells])
    return rows


def page(results: dict) -> str:
    """Return the page in HTML."""
    # The head of the table
    head, *body = _rows(results)
    cells = "".join(f"<th scope=col>{html.escape(each)}</th>" for each in head)
    lines = [f"<thead><tr>{cells}</tr></thead><tbody>"]

    # The rows of the table, with a class for each verdict
    for first, *rest in body:
        tags = [f"<th scope=row>{html.escape(first)}</th>"]
        for cell in rest:
            kind = cell.split(",")[0].split(" (")[0]
            kind = kind if kind in ("passed", "failed", "error") else "off"
            tags.append(f'<td class="{kind}">{html.escape(cell)}</td>')
        lines.append(f"<tr>{''.join(tags)}</tr>")
    made = f"{results['date']}; {results['runs']} runs; false-alarm rate {results['alpha']:g}"
    return f"""<!doctype html>
<html lang=en><meta charset=utf-8><meta name=viewport content="width=device-width">
<title>tofbench</title><style>{STYLE}</style>
<h1>tofbench</h1>
<p>{html.escape(made)} per renderer over all its cases. σ: the largest deviation of a reading from
its exact value, in standard errors. Times: processor time to a relative error of 1 %.</p>
<table>{"".join(lines)}</tbody></table>
<h2>Failures</h2><ul>{"".join(f"<li>{html.escape(line)}</li>" for line in failures(results))}</ul>
</html>
"""


def failures(results: dict) -> list[str]:
    """Return a line for each failure, with the wrong number and the exact number."""
    lines = []
    for name, renderer in results["renderers"].items():
        for case, verdict in renderer["verdicts"].items():
            if verdict["status"] not in ("failed", "error"):
                continue

            # Compare the worst reading and the energy with the exact values
            text = verdict["note"]
            if verdict["reading"]:
                which, mean, error, exact = verdict["reading"]
                text = f"reading {which:.0f}: {mean:.5g} ± {error:.1g}, exact {exact:.5g}"
            if verdict["energy"]:
                text += f"; energy {verdict['energy'][0]:.4g} of the exact"
            lines.append(f"{name}, {case}: {text}")
    return lines


def markdown(results: dict) -> str:
    """Return tables for the documentation: a table of renderers, and a table of cases."""
    _, versions, passed, *cases = _rows(results)
    names = list(results["renderers"])
    summary = list(zip(["renderer", *names], versions, passed, strict=True))
    short_cases = [["–" if cell == OFF else cell for cell in row] for row in cases]
    return f"{_table(summary)}\n\n{_table([['case', *names], *short_cases])}"


def _table(rows: Sequence[Sequence[str]]) -> str:
    """Format a table in Markdown. The first row is the head."""
    lines = [" | ".join(row) for row in (rows[0], ["---"] * len(rows[0]), *rows[1:])]
    return "\n".join(f"| {line} |" for line in lines)
