"""The case `first-film`: time of the command `render` without the rendering itself."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import time
from statistics import median

from .timing import Row

BEYOND_S = 3.0  # Target [s]


def first_film(runs: int, quick: bool) -> list[Row]:
    """Run `tofrender render` on the Cornell box with its defaults, or with few samples if quick."""
    beyond = []
    for _ in range(runs):
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, "-m", "tofrender", "render", "cornell_box"]
            command += ["--out", f"{folder}/box", *(["--spp", "16"] if quick else [])]

            # Run the command
            start = time.perf_counter()
            said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
            took = time.perf_counter() - start

        # Subtract the time that the command reports
        rendering = re.search(r"^([\d.]+) s, ", said, re.MULTILINE)
        assert rendering is not None, said
        beyond.append(took - float(rendering[1]))
    return [("command, from start to files, beyond the rendering [s]", median(beyond), BEYOND_S)]
