"""What `tofrender render` shows of a scene of which nobody has said when to look at it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import options as opt

if TYPE_CHECKING:
    from ..rendering.asked import Asked
    from ..rendering.job import Job

TIME = ("start_opl", "bin_width", "window", "pulse_width")
"""Words with which somebody says when to look."""

OWN, NONE = "scene", "none"
"""Values of --window and --pulse-width that leave time to the scene."""


def at_first_sight(**words: Any) -> Asked:
    """What is asked with words of the command, where time is left open with what is to be found.

    That is a window and a pulse for the built-in scenes and for those of files whose film is
    steady, unless one of --start-opl, --bin-width, --window and --pulse-width is given.
    """
    from ..rendering.asked import Asked
    from ..rendering.renderer import suited

    own: dict[str, Any] = {word: None for word in TIME if words[word] in (OWN, NONE)}
    asked = Asked(**words | own)
    found = suited(asked)
    if found is not asked and words["window"] == OWN:
        raise ValueError(
            f"--window = {OWN}: must be auto or START,STOP, the scene's film is steady"
        )
    if found is not asked and words["pulse_width"] == NONE:
        return replace(found, pulse_width=None)
    left_open = all(words[word] is None for word in TIME) and isinstance(asked.scene, str)
    return replace(found, window="auto", pulse_width="auto") if left_open else found


def tell_first_sight(asked: Asked, job: Job) -> None:
    """Say what was found for `asked`, and how to have the scene's own."""
    if asked.pulse_width != "auto" or asked.window != "auto":
        return
    start, stop = job.film.start_opl, job.film.end_opl()
    found = f"bins from {start:.4g} to {stop:.4g} m"
    if isinstance(job.asked.pulse_width, float):
        found += f" and a pulse of {job.asked.pulse_width:g} m"
    own = "--window auto has no pulse"
    if not isinstance(asked.scene, Path):
        own = "--window scene has the scene's own, without a pulse"
    opt.note(f"note: {found} suit this scene; {own}")
