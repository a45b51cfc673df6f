"""Renders cases with one adapter, in a process of its own: worker.py ADAPTER FOLDER.

FOLDER has `cases.json`; for each case, NAME.npz with its runs and their processor time is written
there, or NAME.txt with an error. With no FOLDER, the adapter's version and abilities are printed.
"""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import sys
import traceback
from pathlib import Path

HERE = Path(__file__).resolve().parent


def adapter(name: str):
    """The adapter's module: one of this folder, or a file."""
    sys.path[0] = str(HERE.parent)  # In place of this folder, whose names must not hide others
    sys.path.append(sys.path.pop(0))
    if name.endswith(".py"):
        importlib.import_module(f"{HERE.name}.adapters")
        spec = importlib.util.spec_from_file_location(f"{HERE.name}.adapters.of_user", name)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module
    return importlib.import_module(f"{HERE.name}.adapters.{name}")


def main() -> None:
    import numpy as np

    module = adapter(sys.argv[1])
    if len(sys.argv) == 2:
        try:
            version = module.version()
        except ImportError as error:
            version = None
            print(f"{error}", file=sys.stderr)
        abilities = sorted(module.ABILITIES)
        print(json.dumps({"version": version, "abilities": abilities, "install": module.INSTALL}))
        return
    folder = Path(sys.argv[2])
    module.version()
    for case in json.loads((folder / "cases.json").read_text()):
        (folder / "now.txt").write_text(case["name"])
        try:
            runs = []
            seconds = 0.0
            for seed in range(case["runs"] + 1):  # The first one compiles
                start = sum(os.times()[:4])  # Of programs that it starts, too
                run = module.render(case["scene"], case["bins"], case["samples"], seed)
                seconds = seconds + sum(os.times()[:4]) - start if seed else 0.0
                runs.append(np.asarray(run, np.float64))
            np.savez(folder / f"{case['name']}.npz", runs=runs[1:], cpu_s=seconds / case["runs"])
        except Exception as error:
            last = traceback.format_exc().strip().splitlines()
            (folder / f"{case['name']}.txt").write_text(f"{type(error).__name__}: {error}")
            (folder / f"{case['name']}.log").write_text("\n".join(last))
    sys.stdout.flush()
    os._exit(0)  # Some renderers crash when they unload


if __name__ == "__main__":
    main()
