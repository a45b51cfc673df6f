"""Test renderers and write a table: python -m benchmarks.tofbench --renderer NAME ..."""

from __future__ import annotations

import argparse
import datetime
import json
import sys
from pathlib import Path

from .cases import Case
from .report import as_json, counts, page
from .running import ADAPTERS, Renderer, describe, run
from .table import all_cases
from .verdicts import Verdict

QUICK = {"runs": 8, "samples": 1 / 16}


def parser() -> argparse.ArgumentParser:
    """Return the parser of the options."""
    result = argparse.ArgumentParser(prog="tofbench", description=__doc__)
    add = result.add_argument
    known = ", ".join(ADAPTERS)
    add("--renderer", action="append", metavar="NAME", help=f"{known}, or the file of an adapter")
    add("--case", action="append", metavar="NAME", help="some of the cases")
    add("--python", action="append", default=[], metavar="RENDERER=PATH", help="its interpreter")
    add("--runs", type=int, help="independent runs of each case (16)")
    add("--samples", type=float, help="multiplies the samples per pixel of all cases (1)")
    add("--quick", action="store_true", help="few runs and samples: finds only what is far off")
    add("--out", type=Path, default=Path("out/tofbench"), help="folder (out/tofbench)")
    add("--list", action="store_true", help="print the cases and adapters")
    return result


def refuse(line: str) -> None:
    """Print an error and exit."""
    print(f"tofbench: error: {line}", file=sys.stderr)
    sys.exit(2)


def chosen(names: list[str] | None, cases: list[Case]) -> list[Case]:
    """Choose cases by name; by default all cases."""
    by_name = {case.name: case for case in cases}
    for name in names or ():
        if name not in by_name:
            refuse(f"--case = {name!r}: must be one of {', '.join(by_name)}")
    return [by_name[name] for name in names] if names else cases


def renderers(names: list[str], pythons: list[str]) -> list[Renderer]:
    """Start each adapter and read its version. Exit if no renderer is installed."""
    # Read the interpreters
    paths = {}
    for each in pythons:
        name, equals, path = each.partition("=")
        if not equals or name not in names or not Path(path).exists():
            refuse(f"--python = {each!r}: must be RENDERER=PATH, one of --renderer and a program")
        paths[name] = path

    # Start the adapters
    found = []
    for name in names:
        if name not in ADAPTERS and not (name.endswith(".py") and Path(name).exists()):
            known = ", ".join(ADAPTERS)
            refuse(f"--renderer = {name!r}: must be one of {known}, or the file of an adapter")
        try:
            found.append(describe(name, paths.get(name, sys.executable)))
        except RuntimeError as error:
            refuse(str(error))

    # Report renderers that are not installed
    missing = [each for each in found if each.version is None]
    for each in missing:
        print(f"tofbench: {each.name}: not installed ({each.install})", file=sys.stderr)
    if len(missing) == len(found):
        sys.exit(2)
    return found


def main() -> None:
    """Run the command."""
    # Read the options
    options = parser().parse_args()
    cases = all_cases()
    if options.list:
        for case in cases:
            print(f"{case.name:24s} {case.title}: {case.form}")
        print("adapters:", ", ".join(ADAPTERS))
        return
    if not options.renderer:
        refuse(f"--renderer: must be one or more of {', '.join(ADAPTERS)}, or files of adapters")

    # How many runs and samples?
    size = QUICK if options.quick else {"runs": 16, "samples": 1.0}
    size = {k: v if getattr(options, k) is None else getattr(options, k) for k, v in size.items()}
    if size["runs"] < 4:
        refuse(f"--runs = {size['runs']}: must be 4 or more")
    if not size["samples"] > 0:
        refuse(f"--samples = {size['samples']}: must be above 0")

    # Run the renderers
    among = chosen(options.case, cases)
    found: list[tuple[Renderer, dict[str, Verdict]]] = []
    for renderer in renderers(list(dict.fromkeys(options.renderer)), options.python):
        verdicts = {}
        if renderer.version is not None:
            tell = lambda line: print(line, flush=True)  # noqa: E731
            verdicts = run(renderer, among, **size, progress=tell, among=cases)
        found.append((renderer, verdicts))

    # Write the results
    made = {"date": f"{datetime.date.today()}", **size}
    results = as_json(found, among, made)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "tofbench.json").write_text(json.dumps(results, indent=1) + "\n")
    (options.out / "tofbench.html").write_text(page(results), encoding="utf-8")
    for name, each in results["renderers"].items():
        if each["version"]:
            print(f"{name} ({each['version']}): passes {counts(each['verdicts'])}")
    print(f"written: {options.out / 'tofbench.html'}, {options.out / 'tofbench.json'}")


if __name__ == "__main__":
    main()
