"""Versions of the software, which results contain."""

import json
from importlib.metadata import version

from .. import __version__


def versions() -> str:
    """Return the versions of this package, Mitsuba and Dr.Jit, as JSON."""
    import mitsuba as mi

    found = {"tofrender": __version__, "mitsuba": mi.__version__, "drjit": version("drjit")}
    return json.dumps(found)
