"""Markdown that people read in a browser, too."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

STYLE = """
body { max-width: 50rem; margin: 2rem auto; padding: 0 1rem; line-height: 1.5;
  font-family: system-ui, sans-serif; color: #222; background: #fff; }
pre { background: #f4f4f4; padding: 0.6rem; overflow-x: auto; white-space: pre-wrap; }
table { border-collapse: collapse; display: block; overflow-x: auto; }
th, td { border-bottom: 1px solid #ccc; padding: 0.2rem 0.7rem; text-align: left;
  vertical-align: top; }
img { max-width: 100%; }
blockquote { margin-left: 0; padding-left: 1rem; border-left: 3px solid #ccc; }
"""
MATH = """<script>MathJax = { tex: { inlineMath: [["\\\\(", "\\\\)"]] } };</script>
<script defer src="https://cdn.jsdelivr.net/npm/mathjax@3/es5/tex-chtml.js"></script>
"""
_SPECIAL = re.compile(r"([\\`*_\[\]<>|~&$])")


def write(folder: Path, name: str, text: str) -> None:
    """Write `NAME.md` and `NAME.html` into a folder.

    Args:
        folder: It exists.
        name: Name of both files.
        text: Markdown; HTML in it stays text.
    """
    (folder / f"{name}.md").write_text(text, encoding="utf-8")
    (folder / f"{name}.html").write_text(page(text), encoding="utf-8")


def page(text: str) -> str:
    """A whole page of HTML, with formulas for MathJax if the text has any.

    Args:
        text: Markdown whose first line is its title; HTML in it stays text.
    """
    from markdown_it import MarkdownIt

    reader = MarkdownIt("commonmark", {"html": False}).enable(["table", "strikethrough"])
    kept, formulas = _without_formulas(text)
    body = reader.render(kept)
    for mark, formula in formulas.items():
        body = body.replace(mark, html.escape(formula))
    first = text.lstrip().partition("\n")[0].lstrip("# ")
    title = html.escape(re.sub(r"\\(.)", r"\1", first))
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width">\n'
        f"<title>{title}</title>\n<style>{STYLE}</style>\n{MATH if formulas else ''}</head>\n"
        f"<body>\n{body}</body>\n</html>\n"
    )


def _without_formulas(text: str) -> tuple[str, dict[str, str]]:
    """The text with marks for its formulas, so that Markdown leaves those alone."""
    formulas: dict[str, str] = {}

    def keep(found: re.Match[str]) -> str:
        if found["code"]:
            return found[0]
        mark = f"FORMULA{len(formulas)}END"
        shown, inline = found["shown"], found["inline"]
        formulas[mark] = f"\\[{shown}\\]" if shown is not None else f"\\({inline}\\)"
        return mark

    pattern = (
        r"(?P<code>^(?P<fence>```+|~~~+)[\s\S]*?^(?P=fence)|(?P<tick>`+)[^`]+(?P=tick)|\\\$)"
        r"|\$\$(?P<shown>[^$]+)\$\$|\$(?P<inline>[^$\s](?:[^$\n]*[^$\s])?)\$(?!\d)"
    )
    return re.sub(pattern, keep, text, flags=re.MULTILINE), formulas


def plain(text: str) -> str:
    r"""Text that Markdown shows as it is, in one line.

    Example:
        >>> plain("a*b*\n<c>")
        'a\\*b\\* \\<c\\>'
    """
    return _SPECIAL.sub(r"\\\1", " ".join(text.split()))


def verbatim(text: str) -> str:
    """A block that shows text as it is, whatever is in it."""
    longest = max((len(run) for run in re.findall(r"`+", text)), default=0)
    fence = "`" * max(3, longest + 1)
    return f"{fence}text\n{text}\n{fence}"


def table(header: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """A table of Markdown cells."""
    rows = [header, ["---"] * len(header), *lines]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)
