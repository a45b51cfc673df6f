"""Render cases with one adapter in a separate process: worker.py ADAPTER FOLDER.

FOLDER contains `cases.json`. For each case, a file NAME.npz with runs and processor time is written
to FOLDER, or a file NAME.txt with an error. Without FOLDER, the version and the abilities of the
adapter are printed.
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
    """Import an adapter of this folder, or from a file."""
    # Remove this folder from the path, so that its modules do not hide other modules
    sys.path[0] = str(HERE.parent)
    sys.path.append(sys.path.pop(0))
    if name.endswith(".py"):
        importlib.import_module(f"{HERE.name}.adapters")
        spec = importlib.util.spec_from_file_location(f"{HERE.name}.adapters.of_user", name)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module
    return importlib.import_module(f"{HERE.name}.adapters.{name}")


def main() -> None:
    """Run the command."""
    import numpy as np

    # Print version and abilities
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

    # Render the cases
    folder = Path(sys.argv[2])
    module.version()
    for case in json.loads((folder / "cases.json").read_text()):
        (folder / "now.txt").write_text(case["name"])
        try:
            runs = []
            seconds = 0.0
            for seed in range(case["runs"] + 1):  # The first run compiles
                start = sum(os.times()[:4])  # Including started programs
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
