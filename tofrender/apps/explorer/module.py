"""JavaScript and CSS of the explorer as text, its modules joined to one without imports."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

MODULES = ("recording", "picture", "plot", "parts", "explorer")
"""In the order of their imports; only the exports of the last one are kept."""

_IMPORT = re.compile(r'^import \{[^}]*\} from "\./\w+\.js";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(async )?(class|const|function))", re.MULTILINE)


@cache
def text_of(name: str) -> str:
    """Text of a file below the folder of `tofrender.apps`."""
    return (Path(__file__).parents[1] / name).read_text(encoding="utf-8")


@cache
def javascript() -> str:
    """Join the scripts to an ES module that exports `mount(element, {header, bytes})`."""
    *others, last = (_IMPORT.sub("", text_of(f"explorer/{name}.js")) for name in MODULES)
    return "\n".join([*(_EXPORT.sub("", text) for text in others), last])


def style() -> str:
    """Style sheet whose rules only apply inside of an explorer."""
    return text_of("explorer/explorer.css")
