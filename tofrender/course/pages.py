"""Markdown that people read in a browser, too."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from .formulas import mathml

STYLE = """
body { max-width: 50rem; margin: 2rem auto; padding: 0 1rem; line-height: 1.5;
  font-family: system-ui, sans-serif; color: #222; background: #fff; }
pre { background: #f4f4f4; padding: 0.6rem; overflow-x: auto; white-space: pre-wrap; }
table { border-collapse: collapse; display: block; overflow-x: auto; }
th, td { border-bottom: 1px solid #ccc; padding: 0.2rem 0.7rem; text-align: left;
  vertical-align: top; }
img { max-width: 100%; }
math { font-size: 1.08em;
  font-family: "Latin Modern Math", "STIX Two Math", "STIX Math", "Cambria Math", math; }
math[display="block"] { margin: 1em 0; overflow-x: auto; }
@media print {
  @page { size: A4; margin: 18mm; }
  body { max-width: none; margin: 0; font-size: 10.5pt; }
  table, pre, math[display="block"] { overflow: visible; }
  h1, h2, h3 { break-after: avoid; }
  table, pre, img, blockquote, math { break-inside: avoid; }
}
blockquote { margin-left: 0; padding-left: 1rem; border-left: 3px solid #ccc; }
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
    """A whole page of HTML that needs no network.

    Args:
        text: Markdown whose first line is its title; HTML in it stays text.

    Raises:
        ValueError: A formula cannot be read; one line.
    """
    from markdown_it import MarkdownIt

    reader = MarkdownIt("commonmark", {"html": False}).enable(["table", "strikethrough"])
    kept, formulas = _without_formulas(text)
    body = reader.render(kept)
    for mark, formula in formulas.items():
        body = body.replace(mark, formula)
    first = text.lstrip().partition("\n")[0].lstrip("# ")
    title = html.escape(re.sub(r"\\(.)", r"\1", first))
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width">\n'
        f"<title>{title}</title>\n<style>{STYLE}</style>\n</head>\n"
        f"<body>\n{body}</body>\n</html>\n"
    )


def _without_formulas(text: str) -> tuple[str, dict[str, str]]:
    """The text with marks that Markdown leaves alone, and the formulas that they stand for."""
    formulas: dict[str, str] = {}

    def keep(found: re.Match[str]) -> str:
        if found["code"]:
            return found[0]
        mark = f"FORMULA{len(formulas)}END"
        block = found["shown"] is not None
        formulas[mark] = mathml(found["shown"] if block else found["inline"], block=block)
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
