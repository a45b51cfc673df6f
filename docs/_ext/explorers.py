"""Show the explorer on pages without a Python kernel, as an HTML page in an `iframe`."""

from __future__ import annotations

import hashlib
import html
import os
from pathlib import Path
from typing import Any

MEGABYTES = 0.6  # Largest size of an explorer, because a page may show several explorers
SHOWN: list[Any] = []  # Datasets that an example of the gallery has explored


class Explorer:
    """The explorer as the output of a notebook or an example."""

    def __init__(self, address: str, title: str) -> None:
        self.address = address
        self.title = title

    def _repr_html_(self) -> str:
        return (
            f'<iframe class="touch" src="{self.address}" title="{html.escape(self.title)}" '
            'loading="lazy"></iframe>'
        )


def use_pages(folder: Path) -> None:
    """Replace `tofrender.explore` by a function that writes HTML pages into a folder."""
    import tofrender

    def explore(data: Any, *, megabytes: float = MEGABYTES, **options: Any) -> Explorer:
        SHOWN.append(data)
        page = folder / f"explorer.{os.getpid()}.tmp.html"
        tofrender.report(data, page, megabytes=min(megabytes, MEGABYTES), overwrite=True, **options)
        name = f"explorer_{hashlib.sha256(page.read_bytes()).hexdigest()[:16]}.html"
        page.replace(folder / name)
        title = f"The explorer: {options.get('title') or data.attrs.get('scene', 'a transient')}"
        return Explorer(f"../_static/made/{name}", title)

    tofrender.explore = explore  # pyright: ignore[reportAttributeAccessIssue]
