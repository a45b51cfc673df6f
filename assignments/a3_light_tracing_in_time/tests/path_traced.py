"""Results of the package's path tracer for a room without a closed form.

`python tests/path_traced.py` writes `path_traced.npz` anew, in about a minute; it needs the whole
package, since what the camera's end finds of two strategies is in it, too.
"""

from __future__ import annotations

import importlib
from functools import cache
from pathlib import Path

import numpy as np

FILE = Path(__file__).with_suffix(".npz")
ROOM = {"origin": (0, 0, 0.9), "target": (0, -0.1, -1), "fov": 75.0, "size": (3, 3)}
ROOM |= {"bins": (6, 1.0, 1.0)}
MAX_DEPTH = 4
CASES = {
    "mirror": ({"mirror": True}, {}),
    "glossy": ({"mirror": False}, {"discard_direct_light": True}),
}


@cache
def reference(case):
    """(steady, bins), means over the film, seeds in front; "camera" is one end of two."""
    with np.load(FILE) as archive:
        return archive[f"{case}_steady"], archive[f"{case}_bins"]


def means(case, scene, tracer):
    """Arrays of a case."""
    found = [tracer.render(scene, seed=k, spp=1 << 14) for k in range(32)]
    film = [np.stack([np.array(each[part], float) for each in found]) for part in (0, 1)]
    return dict(
        zip((f"{case}_steady", f"{case}_bins"), (f.mean((1, 2)) for f in film), strict=True)
    )


def main() -> None:
    """Render all cases."""
    import mitsuba as mi
    import worlds

    import tofrender  # noqa: F401 (chooses the variant)

    arrays = {}
    for case, (room, options) in CASES.items():
        scene = worlds.room(worlds.camera(**ROOM), **room)
        tracer = mi.load_dict({"type": "transient_path", "max_depth": MAX_DEPTH} | options)
        arrays |= means(case, scene, tracer)
    props = mi.Properties()
    props["max_depth"], props["end"] = MAX_DEPTH, "camera"
    tracer = importlib.import_module("tofrender.integrators.two_strategies")
    arrays |= means("camera", scene, tracer.TransientTwoStrategies(props))
    np.savez_compressed(FILE, **arrays)


if __name__ == "__main__":
    main()
