"""Check a GPU: commands, times, energies, gradients, and limits of memory.

Without a GPU, the check runs with small sizes on the CPU, which tests the check itself.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from .worker import CHOSEN

ROOT = Path(__file__).parents[2]

ENDS = {
    "commands": 0.20,
    "film": 0.23,
    "times": 0.54,
    "gradients": 0.61,
    "deposits": 0.65,
    "scenes": 0.75,
    "energies": 1.0,
}
"""Fraction of all time at which each part must have ended. What a part leaves is for the next."""

MACHINE_S = 120.0  # Time to start Mitsuba, and to test whether the GPU traces rays [s]
GRACE_S = 5.0  # Time that a part gets after its end to finish what it does [s]


def main() -> int:
    """Run the parts and write the results; returns the exit status, 1 if something is wrong."""
    options = _parser().parse_args()
    names = options.part or list(ENDS)
    start = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "part.json"

        # Which variant is checked, and on which machine?
        machine = _run("machine", options.variant or CHOSEN, "small", MACHINE_S, file)
        found = machine["results"]
        if machine["failed"] or not found:
            print(f"machine: {'; '.join(machine['failed'])}", file=sys.stderr)
            return 1
        small = options.small or not found["on_gpu"]
        report: dict[str, Any] = {
            "machine": found,
            "small": small,
            "minutes": options.minutes,
            "parts": {},
        }
        print(f"{found['variant']}, {', '.join(found['cards']) or found['processor']}", flush=True)
        if small and not options.small:
            print("no GPU: small sizes on the CPU, whose times mean nothing", flush=True)

        # Run one part after the other
        for name, fraction in ENDS.items():
            if name not in names:
                continue
            seconds = fraction * 60 * options.minutes - (time.monotonic() - start)
            sizes = "small" if small else "full"
            part = _run(name, found["variant"], sizes, seconds, file)
            report["parts"][name] = part
            report["passed"] = not any(each["failed"] for each in report["parts"].values())
            report["seconds"] = time.monotonic() - start
            _write(options.out, report)
            _print(name, part)
    print(f"{'passed' if report['passed'] else 'FAILED'}; all results: {options.out}")
    return 0 if report["passed"] else 1


def _parser() -> argparse.ArgumentParser:
    """The options."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.gpu", description=__doc__)
    add = parser.add_argument
    add("--minutes", type=_minutes, default=8.0, help="time for all parts [minutes] (8)")
    add("--small", action="store_true", help="small sizes on a GPU, too")
    add("--variant", help="Mitsuba variant (the default variant of tofrender)")
    add("--part", action="append", choices=ENDS, help="run this part; may be repeated (all)")
    add("--out", type=Path, default=Path("out/gpu.json"), help="file of results (out/gpu.json)")
    return parser


def _minutes(text: str) -> float:
    """Read a number of minutes."""
    value = float(text)
    if not 0 < value <= 60:
        raise argparse.ArgumentTypeError(f"{text}: must be above 0 and at most 60")
    return value


def _run(name: str, variant: str, sizes: str, seconds: float, file: Path) -> dict[str, Any]:
    """Run a part in a separate process. The process is ended when its time is over."""
    part: dict[str, Any] = {"results": {}, "skipped": [], "failed": []}
    if seconds <= 0:
        return part | {"seconds": 0.0, "skipped": ["all: no time left"]}
    file.unlink(missing_ok=True)
    command = [sys.executable, "-m", "benchmarks.gpu.worker", name, variant, sizes]
    start = time.monotonic()
    with tempfile.TemporaryFile("w+") as errors:
        process = subprocess.Popen(
            [*command, str(seconds), str(file)],
            cwd=ROOT,
            env=_environment(),
            stdout=errors,
            stderr=errors,
            start_new_session=True,
        )
        late = False
        try:
            process.wait(seconds + GRACE_S)
        except subprocess.TimeoutExpired:
            late = True
        finally:
            _end(process)
        errors.seek(0)
        lines = [line for line in errors.read().splitlines() if line.strip()]

    # Read what the part has written
    if file.exists():
        part |= json.loads(file.read_text(encoding="utf-8"))
    if late:
        part["skipped"].append("the remaining part: it was ended, because its time was over")
    elif process.returncode != 0:
        last = lines[-1].strip() if lines else "no message"
        part["failed"].append(f"the process ended with status {process.returncode}: {last}")
    return part | {"seconds": time.monotonic() - start}


def _environment() -> dict[str, str]:
    """Environment in which also processes of processes find this checkout."""
    before = os.environ.get("PYTHONPATH")
    path = f"{ROOT}{os.pathsep}{before}" if before else str(ROOT)
    return os.environ | {"PYTHONPATH": path}


def _end(process: subprocess.Popen) -> None:
    """End a process with all processes that it has started."""
    if process.poll() is None:
        if os.name == "posix":
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
        process.wait()


def _write(path: Path, report: dict[str, Any]) -> None:
    """Write the results so far."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")


def _print(name: str, part: dict[str, Any]) -> None:
    """Print a line for each problem, and one for the part."""
    state = "FAILED" if part["failed"] else "ok"
    print(f"{state:6s} {name} ({part['seconds']:.0f} s)", flush=True)
    for line in part["failed"]:
        print(f"       {line}")
    for line in part["skipped"]:
        print(f"       skipped: {line}")


if __name__ == "__main__":
    sys.exit(main())
