"""What made a result."""

from __future__ import annotations

import json
from importlib.metadata import version


def versions() -> str:
    """Versions of this package, Mitsuba and Dr.Jit, as JSON."""
    import mitsuba as mi

    from .. import __version__

    found = {"tofrender": __version__, "mitsuba": mi.__version__, "drjit": version("drjit")}
    return json.dumps(found)
