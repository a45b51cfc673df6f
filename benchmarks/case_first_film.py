"""What a first try waits for beyond the rendering itself: the command, from start to files."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import time
from statistics import median

from .timing import Row

BEYOND_S = 3.0


def first_film(runs: int, quick: bool) -> list[Row]:
    """The Cornell box by `tofrender render` with its defaults, few samples in a quick run."""
    beyond = []
    for _ in range(runs):
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, "-m", "tofrender", "render", "cornell_box"]
            command += ["--out", f"{folder}/box", *(["--spp", "16"] if quick else [])]
            start = time.perf_counter()
            said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
            took = time.perf_counter() - start
        rendering = re.search(r"^([\d.]+) s, ", said, re.MULTILINE)
        assert rendering is not None, said
        beyond.append(took - float(rendering[1]))
    return [("command, from start to files, beyond the rendering [s]", median(beyond), BEYOND_S)]
