"""Six scenes without closed form: bins with error bars, computed once.

`python -m benchmarks.tofbench.references [NAME ...]` computes them again, with tofrender; the other
renderers' columns of the table show whether they agree.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

import numpy as np

from . import scenes as s
from .cases import Case
from .verdicts import grouped

DATA = Path(__file__).with_name("data")
SIZE, BLOCK, RUNS, SAMPLES = 16, 4, 16, 8192


def room(**more: dict) -> dict:
    """An open box of half-width 1, as in the Cornell box, without its contents."""
    white, grey, dark = s.diffuse(0.75), s.diffuse(0.45), s.diffuse(0.3)
    return {
        "floor": s.rectangle((0, -1, 0), (1, 0, 0), (0, 0, -1), white),
        "ceiling": s.rectangle((0, 1, 0), (1, 0, 0), (0, 0, 1), white),
        "back": s.rectangle((0, 0, -1), (1, 0, 0), (0, 1, 0), white),
        "right": s.rectangle((1, 0, 0), (0, 0, 1), (0, 1, 0), grey),
        "left": s.rectangle((-1, 0, 0), (0, 0, -1), (0, 1, 0), dark),
    } | more


def lamp(radiance: float = 10.0, half: float = 0.3) -> dict:
    down = (0, 0.98, 0), (half, 0, 0), (0, 0, half)
    return s.rectangle(*down, s.BLACK, radiance=radiance)


VIEW = s.camera((0, 0, 3.9), (0, 0, 0), 39.3, width=SIZE, height=SIZE)
LOW = s.camera((0, -0.6, 3.6), (0, -0.6, 0), 24.0, width=SIZE, height=SIZE)  # No lamp in view
BLOCKS = {
    "small": s.box((0.35, -0.7, 0.3), (0.3, 0.3, 0.3), s.diffuse(0.75)),
    "large": s.box((-0.35, -0.4, -0.3), (0.3, 0.6, 0.3), s.diffuse(0.75)),
}
BALL = {"ball": s.sphere((0.3, -0.6, 0.2), 0.4, s.glass(1.5))}
ROUGH = {"kind": "rough", "alpha": 0.2}
FOG = {"fog": s.medium(0.05, 0.5, "hg", g=0.5)}
WINDOW = s.bins(64, 4.0, 0.15)

REFERENCES = {
    "cornell": ("Boxes in a room", s.scene(VIEW, 6, shapes=room(lamp=lamp(), **BLOCKS))),
    "glass": ("A glass ball and its caustic", s.scene(LOW, 7, shapes=room(lamp=lamp(), **BALL))),
    "mirror-wall": (
        "A room with a mirror as its left wall",
        s.scene(
            LOW,
            5,
            shapes=room(lamp=lamp(), **BLOCKS)
            | {"left": s.rectangle((-1, 0, 0), (0, 0, -1), (0, 1, 0), s.MIRROR)},
        ),
    ),
    "rough-ball": (
        "A rough metal ball under two lamps",
        s.scene(
            LOW,
            5,
            shapes=room(lamp=lamp(), ball=s.sphere((0.3, -0.6, 0.2), 0.4, ROUGH)),
            lights={"second": s.point((0.6, 0.2, 0.8), 1.0)},
        ),
    ),
    "cloud": (
        "A cloud in a room",
        s.scene(
            LOW,
            6,
            shapes=room(lamp=lamp())
            | {"cloud": s.box((0, -0.4, 0), (0.6, 0.3, 0.6), s.BOUNDARY, inside="fog")},
            media=FOG,
        ),
    ),
    "around-corner": (
        "A room lit from behind a partition",
        s.scene(
            LOW,
            5,
            shapes=room(
                partition=s.box((0.2, 0.1, 0.2), (0.02, 0.7, 0.8), s.diffuse(0.5)),
                lamp=s.rectangle((0.98, 0, 0), (0, 0, 0.3), (0, 0.3, 0), s.BLACK, radiance=10.0),
            ),
        ),
    ),
}
ABILITIES = {"mirror": "mirror", "glass": "glass", "rough": "rough", "none": "medium"}


def _blocks(bins: int) -> np.ndarray:
    """Weights of the sums over time of blocks of pixels."""
    index = np.arange(SIZE) // BLOCK
    block = index[:, None] * (SIZE // BLOCK) + index
    rows = (block[None] == np.arange((SIZE // BLOCK) ** 2)[:, None, None]).astype(float)
    return np.repeat(rows[..., None], bins, axis=-1).reshape(len(rows), -1)


def _file(name: str) -> dict[str, np.ndarray]:
    with np.load(DATA / f"{name}.npz") as file:
        return {key: file[key].astype(float) for key in ("mean", "standard_error")}


def reference_case(name: str, mean: np.ndarray) -> Case:
    """The case of a reference whose mean is known."""
    title, scene = REFERENCES[name]
    kinds = {each["material"]["kind"] for each in scene["shapes"].values()}
    in_time = grouped(mean.sum(axis=(0, 1)))  # The film's mean
    return Case(
        f"reference-{name}",
        title,
        f"{RUNS} runs of {SAMPLES} samples per pixel, with their standard error",
        scene,
        WINDOW,
        lambda: mean,
        tuple(sorted(ABILITIES[kind] for kind in kinds & set(ABILITIES))),
        readings=np.vstack([np.tile(in_time, (1, SIZE * SIZE)), _blocks(mean.shape[-1])]),
        steady_readings=np.vstack([np.ones((1, SIZE * SIZE)), _blocks(1)]),
        samples=64,
        standard_error=lambda: _file(name)["standard_error"],
    )


def reference_cases() -> list[Case]:
    """The references whose data are there."""
    names = [name for name in REFERENCES if (DATA / f"{name}.npz").exists()]
    return [reference_case(name, _file(name)["mean"]) for name in names]


def main(names: list[str]) -> None:
    """Compute references and write them as NPZ, JSON and XML."""
    from .running import WORKER, describe

    DATA.mkdir(exist_ok=True)
    versions = describe("tofrender").version
    for name in names or REFERENCES:
        case = reference_case(name, np.ones((SIZE, SIZE, WINDOW["count"])))
        request = case.request(RUNS, SAMPLES / case.samples)
        with tempfile.TemporaryDirectory() as folder:
            work = partial(subprocess.run, check=True)
            (Path(folder) / "cases.json").write_text(json.dumps([request]))
            work([sys.executable, WORKER, "tofrender", folder])
            with np.load(Path(folder) / f"{case.name}.npz") as file:
                runs = file["runs"]
            described = request | {"xml": str(DATA / f"{name}.xml")}
            (Path(folder) / "cases.json").write_text(json.dumps([described]))
            work([sys.executable, WORKER, "mitsuba", folder])
        error = runs.std(axis=0, ddof=1) / np.sqrt(RUNS)
        arrays = {"mean": runs.mean(axis=0), "standard_error": error}
        arrays = {key: each.astype(np.float32) for key, each in arrays.items()}
        np.savez_compressed(DATA / f"{name}.npz", **arrays)
        parts = {"scene": case.scene, "bins": case.bins, "title": case.title, "by": versions}
        (DATA / f"{name}.json").write_text(json.dumps(parts, indent=1) + "\n")
        print(name, f"{arrays['mean'].sum():.6g}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
