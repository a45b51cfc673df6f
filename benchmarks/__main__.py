"""python -m benchmarks [--quick] [--runs N] [--variant NAME] [CASE ...]."""

from __future__ import annotations

import argparse
import logging

import drjit as dr
import mitsuba as mi

import tofrender

from .cases import CASES


def main() -> None:
    """Run the cases and print a line for each figure."""
    # Read the options
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"of {', '.join(CASES)}")
    parser.add_argument("--quick", action="store_true", help="small sizes, to see that it runs")
    parser.add_argument("--runs", type=int, default=5, help="runs of each function (5)")
    parser.add_argument("--variant", help="Mitsuba variant, e.g. llvm_ad_mono")
    options = parser.parse_args()
    unknown = [name for name in options.cases if name not in CASES]
    if unknown or options.runs < 1:
        what = (
            f"CASE = {unknown[0]!r}: must be one of {', '.join(CASES)}"
            if unknown
            else (f"--runs = {options.runs}: must be 1 or more")
        )
        parser.exit(2, f"{parser.prog}: error: {what}\n")

    # Start Mitsuba
    if options.variant:
        try:
            tofrender.runtime.backend.activate(options.variant)
        except (ValueError, tofrender.runtime.variants.BackendError) as error:
            parser.exit(2, f"{parser.prog}: error: {error}\n")
    logging.getLogger().setLevel(logging.ERROR)
    mi.set_log_level(mi.LogLevel.Error)
    print(
        f"tofrender {tofrender.__version__}, Mitsuba {mi.__version__}, {mi.variant()}, "
        f"{dr.thread_count()} threads, medians of {options.runs} runs"
    )

    # Run the cases
    for name in options.cases or CASES:
        for what, value, target in CASES[name](options.runs, options.quick):
            bound = "" if target is None else f"   target {target:g}"
            print(f"{name:7s} {what}: {value:.3f}{bound}", flush=True)


if __name__ == "__main__":
    main()
