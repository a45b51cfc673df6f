"""The scene builders, importable from the project's root; this folder also holds Mitsuba XML."""

from tofrender.scenes import *  # noqa: F403
from tofrender.scenes import BUILT_IN

__all__ = sorted(BUILT_IN)
