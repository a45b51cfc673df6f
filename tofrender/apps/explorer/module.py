"""The explorer's JavaScript and style, as text: its modules joined to one that imports nothing."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

MODULES = ("recording", "picture", "plot", "parts", "explorer")
"""In the order of what imports what; only the last one's exports stay."""

_IMPORT = re.compile(r'^import \{[^}]*\} from "\./\w+\.js";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(async )?(class|const|function))", re.MULTILINE)


@cache
def javascript() -> str:
    """One ES module that exports `mount(element, {header, bytes})`.

    Example:
        >>> "export function mount(element, data)" in javascript()
        True
    """
    here = Path(__file__).parent
    texts = [(here / f"{name}.js").read_text(encoding="utf-8") for name in MODULES]
    bare = [_IMPORT.sub("", text) for text in texts]
    return "\n".join([*(_EXPORT.sub("", text) for text in bare[:-1]), bare[-1]])


@cache
def style() -> str:
    """Its style sheet, in which every rule is for what is inside of an explorer."""
    return (Path(__file__).parent / "explorer.css").read_text(encoding="utf-8")
