"""tofrender: light in flight on Mitsuba 3 and Dr.Jit.

Importing the package makes a Mitsuba variant active if none is: `cuda_ad_rgb` or, on a Mac,
`metal_ad_rgb` if the GPU can trace a ray, otherwise `llvm_ad_rgb`. A variant that is set stays, and
switching later works. If the environment variable `TOFRENDER_NO_VARIANT` is set, the import makes
no variant active.

    import tofrender
    dataset = tofrender.render("cornell_box", spp=64)
    tofrender.save_exr_stack(dataset, "out")
"""

import os
import sys
from pathlib import PurePath
from typing import Any

from .runtime import backend, plugins
from .runtime.lazy import attach_stub

__version__ = "0.1.0"

_get, __dir__, __all__ = attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    """Import a name at its first use. Plugin classes follow the active variant."""
    return plugins.plugin(name) if name in plugins.PLUGINS else _get(name)


def _is_command() -> bool:
    """Return whether Python runs for the `tofrender` command, or for one of our modules by -m."""
    program = sys.argv[0] if sys.argv else ""
    if program != "-m":
        return PurePath(program).stem == "tofrender"
    options = sys.orig_argv
    return "-m" in options and options[options.index("-m") + 1].split(".")[0] == "tofrender"


# The command answers --help without Mitsuba, and activates a variant when it needs one. Other
# programs that do so set the environment variable.
if not (_is_command() or os.environ.get(backend.NO_VARIANT)):
    backend.activate()
