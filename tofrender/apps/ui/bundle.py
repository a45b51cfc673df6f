"""JavaScript and CSS of applications as text. Modules are joined to one module."""

import re
from functools import cache
from pathlib import Path

_IMPORT = re.compile(r'^import \{[^}]*\} from "\.{1,2}/[\w/]+\.js";\n', re.MULTILINE)
_COMMENT = re.compile(r"^ *(/\*.*?\*/|//[^\n]*)\n", re.MULTILINE | re.DOTALL)
_INDENT = re.compile(r"^ +", re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(async )?(class|const|function))", re.MULTILINE)


@cache
def text_of(name: str) -> str:
    """Return the text of a file below the folder of `tofrender.apps`."""
    return (Path(__file__).parents[1] / name).read_text(encoding="utf-8")


@cache
def javascript(*modules: str) -> str:
    """Join modules, named in the order of their imports, to one module.

    The result has the exports of the last module. Comments and indentation are omitted, since pages
    contain the text.
    """
    *others, last = (_IMPORT.sub("", text_of(f"{name}.js")) for name in modules)
    text = "\n".join([*(_EXPORT.sub("", text) for text in others), last])
    if re.search(r"^import ", text, re.MULTILINE):
        raise ValueError(f"{', '.join(modules)}: must import names of modules that are joined")
    return _INDENT.sub("", _COMMENT.sub("", text))


@cache
def style(*sheets: str) -> str:
    """Join the shared style sheet and others. Their rules apply inside applications only."""
    text = "\n".join(text_of(f"{name}.css") for name in ("ui/style", *sheets))
    return _INDENT.sub("", _COMMENT.sub("", text))
