"""Progress bars for terminal and notebook."""

from __future__ import annotations

DELAY_S = 2.0
"""A bar appears only for work that takes longer than this [s]."""


def progress_bar(description: str, total: int | None, *, unit: str = "frame", enabled: bool = True):
    """A tqdm bar, for terminal or notebook, that shows up after two seconds.

    Args:
        description: What is being done.
        total: Number of units, None if unknown.
        unit: What is counted; "B" counts bytes with prefixes.
        enabled: False makes a bar that shows nothing.
    """
    from tqdm.auto import tqdm

    return tqdm(
        desc=description,
        total=total,
        unit=unit,
        unit_scale=unit == "B",
        delay=DELAY_S,
        disable=not enabled,
        leave=False,
    )
