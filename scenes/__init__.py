"""Scene builders, importable from the project's root, next to Mitsuba XML files of the scenes."""

from tofrender.scenes import *  # noqa: F403
from tofrender.scenes import BUILT_IN

__all__ = sorted(BUILT_IN)
