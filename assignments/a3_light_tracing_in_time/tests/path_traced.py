"""What the package's path tracer says of a room, in which nothing has a formula.

`python tests/path_traced.py` writes `path_traced.npz` anew, in about a minute.
"""

from __future__ import annotations

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
    """(steady, bins) of `transient_path`, means over the film, seeds in front."""
    with np.load(FILE) as archive:
        return archive[f"{case}_steady"], archive[f"{case}_bins"]


def main() -> None:
    """Render all cases."""
    import mitsuba as mi
    import worlds

    import tofrender  # noqa: F401 (chooses the variant)

    arrays = {}
    for case, (room, options) in CASES.items():
        scene = worlds.room(worlds.camera(**ROOM), **room)
        tracer = mi.load_dict({"type": "transient_path", "max_depth": MAX_DEPTH} | options)
        found = [mi.render(scene, integrator=tracer, spp=1 << 15, seed=k) for k in range(32)]
        for name, part in (("steady", 0), ("bins", 1)):
            film = np.stack([np.array(each[part], float) for each in found])
            arrays[f"{case}_{name}"] = film.mean((1, 2))
    np.savez_compressed(FILE, **arrays)


if __name__ == "__main__":
    main()
