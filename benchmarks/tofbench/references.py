"""Six scenes without closed form. Bins and error bars in data/ were computed by tofrender."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from .cases import Case
from .verdicts import grouped

DATA = Path(__file__).with_name("data")
BLOCKS = 4  # Number of blocks of pixels in each direction
ABILITIES = {"mirror": "mirror", "glass": "glass", "rough": "rough", "none": "medium"}


def _blocks(height: int, width: int, bins: int) -> np.ndarray:
    """Return the weights of sums over time in 4 x 4 blocks of pixels."""
    row, column = (np.arange(n) * BLOCKS // n for n in (height, width))
    block = row[:, None] * BLOCKS + column
    rows = (block[None] == np.arange(BLOCKS**2)[:, None, None]).astype(float)
    return np.repeat(rows[..., None], bins, axis=-1).reshape(len(rows), -1)


def reference(path: Path) -> Case:
    """Make the case of a reference, with readings of the mean in time and of blocks of pixels."""
    # Read scene, mean and standard error
    described = json.loads(path.read_text(encoding="utf-8"))
    with np.load(path.with_suffix(".npz")) as file:
        mean, error = (file[key].astype(float) for key in ("mean", "standard_error"))
    scene = described["scene"]
    pixels = mean[..., 0].size

    # Which materials and readings does the case need?
    kinds = {each["material"]["kind"] for each in scene["shapes"].values()}
    in_time = np.tile(grouped(mean.sum(axis=(0, 1))), (1, pixels))
    return Case(
        f"reference-{path.stem}",
        described["title"],
        f"rendered by {described['by']}, with its standard error",
        scene,
        described["bins"],
        lambda: mean,
        tuple(sorted(ABILITIES[kind] for kind in kinds & set(ABILITIES))),
        readings=np.vstack([in_time, _blocks(*mean.shape)]),
        steady_readings=np.vstack([np.ones((1, pixels)), _blocks(*mean.shape[:2], 1)]),
        samples=64,
        standard_error=lambda: error,
    )


def reference_cases() -> list[Case]:
    """Return the cases of all references."""
    return [reference(path) for path in sorted(DATA.glob("*.json"))]
