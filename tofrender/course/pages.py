"""Markdown, and pages of HTML with formulas in MathML: no script, no font, no network."""

import html
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

STYLE = Path(__file__).with_name("style.css")
_SPECIAL = re.compile(r"([\\`*_\[\]<>|~&$])")


def write(folder: Path, name: str, text: str) -> None:
    """Write `NAME.md` and `NAME.html` into a folder; HTML in the text stays text."""
    (folder / f"{name}.md").write_text(text, encoding="utf-8")
    (folder / f"{name}.html").write_text(page(text), encoding="utf-8")


def page(text: str) -> str:
    """Page of HTML, from Markdown whose first line is the title; HTML in it stays text."""
    from markdown_it import MarkdownIt
    from mdit_py_plugins.dollarmath import dollarmath_plugin

    reader = MarkdownIt("commonmark", {"html": False}).enable(["table", "strikethrough"])
    strict = dict.fromkeys(("allow_labels", "allow_space", "allow_digits"), False)
    reader.use(
        dollarmath_plugin,
        **strict,
        double_inline=True,
        renderer=lambda formula, options: mathml(formula, block=options["display_mode"]),
    )
    body = reader.render(text)
    first = text.lstrip().partition("\n")[0].lstrip("# ")
    title = html.escape(re.sub(r"\\(.)", r"\1", first))
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width">\n'
        f"<title>{title}</title>\n<style>\n{STYLE.read_text()}</style>\n</head>\n"
        f"<body>\n{body}</body>\n</html>\n"
    )


def plain(text: str) -> str:
    r"""One line of text, escaped so that Markdown shows it literally.

    Example:
        >>> plain("a*b*\n<c>")
        'a\\*b\\* \\<c\\>'
    """
    return _SPECIAL.sub(r"\\\1", " ".join(text.split()))


def verbatim(text: str) -> str:
    """Markdown block that shows text literally."""
    longest = max((len(run) for run in re.findall(r"`+", text)), default=0)
    fence = "`" * max(3, longest + 1)
    return f"{fence}text\n{text}\n{fence}"


def table(header: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """Markdown table."""
    rows = [header, ["---"] * len(header), *lines]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


# Patterns of TeX that docutils reads otherwise or not at all, and their replacements
REPLACED = (
    (r"\\dots\b", r"\\ldots"),
    (r"\\[Bb]ig[lrm]?\b", ""),
    (r"°", r"^{\\circ}"),
    (r"\\frac(\d)", r"\\frac{\1}"),
    (r"(\\frac\{[^{}]*\})(\d)", r"\1{\2}"),
    (r"([\^_]|\\sqrt)(\d)", r"\1{\2}"),
)


def mathml(formula: str, *, block: bool = False) -> str:
    r"""A formula of TeX as a `<math>` element, whose alternative text is the TeX.

    `block` puts it on a line of its own. ValueError in one line if docutils cannot read it.

    Example:
        >>> mathml(r"\sigma^2")[:40]
        '<math alttext="\\sigma^2" xmlns="http://w'
    """
    from docutils.utils.math import MathError, latex2mathml

    text = formula
    for pattern, instead in REPLACED:
        text = re.sub(pattern, instead, text)
    try:
        made = latex2mathml.tex2mathml(text, as_block=block)
    except MathError as error:
        raise ValueError(f"formula {' '.join(formula.split())!r}: {error}") from None
    spoken = html.escape(" ".join(formula.split()), quote=True)
    return made.replace("<math ", f'<math alttext="{spoken}" ', 1)
