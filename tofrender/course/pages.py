"""Write Markdown, and HTML pages with formulas in MathML, without scripts, fonts or network."""

import html
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

STYLE = Path(__file__).with_name("style.css")
_SPECIAL = re.compile(r"([\\`*_\[\]<>|~&$])")


def write(folder: Path, name: str, text: str) -> None:
    """Write `NAME.md` and `NAME.html` into a folder; HTML in the text is escaped."""
    (folder / f"{name}.md").write_text(text, encoding="utf-8")
    (folder / f"{name}.html").write_text(page(text), encoding="utf-8")


def page(text: str) -> str:
    """Convert Markdown to an HTML page.

    The first line of the text becomes the title. HTML in the text is escaped.
    """
    from markdown_it import MarkdownIt
    from mdit_py_plugins.dollarmath import dollarmath_plugin

    # Convert the body; only $...$ and $$...$$ mark formulas
    reader = MarkdownIt("commonmark", {"html": False}).enable(["table", "strikethrough"])
    strict = dict.fromkeys(("allow_labels", "allow_space", "allow_digits"), False)
    reader.use(
        dollarmath_plugin,
        **strict,
        double_inline=True,
        renderer=lambda formula, options: mathml(formula, block=options["display_mode"]),
    )
    body = reader.render(text)

    # Use the first line, without Markdown's escapes, as the title
    first = text.lstrip().partition("\n")[0].lstrip("# ")
    title = html.escape(re.sub(r"\\(.)", r"\1", first))
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width">\n'
        f"<title>{title}</title>\n<style>\n{STYLE.read_text()}</style>\n</head>\n"
        f"<body>\n{body}</body>\n</html>\n"
    )


def plain(text: str) -> str:
    r"""Escape a text so that Markdown shows it literally, on one line.

    Example:
        >>> plain("a*b*\n<c>")
        'a\\*b\\* \\<c\\>'
    """
    return _SPECIAL.sub(r"\\\1", " ".join(text.split()))


def verbatim(text: str) -> str:
    """Return a Markdown code block that shows a text literally."""
    # The fence must be longer than any run of backticks in the text
    longest = max((len(run) for run in re.findall(r"`+", text)), default=0)
    fence = "`" * max(3, longest + 1)
    return f"{fence}text\n{text}\n{fence}"


def table(header: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table with a header and lines of cells."""
    rows = [header, ["---"] * len(header), *lines]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def mathml(formula: str, *, block: bool = False) -> str:
    r"""Convert a TeX formula to a MathML element, which browsers draw without a script.

    Args:
        formula: TeX in math mode, without the dollar signs.
        block: Draw the formula in display style, on a line of its own.

    Returns:
        A `<math>` element. Its alternative text is the TeX source.

    Raises:
        ValueError: The formula contains TeX that the converter does not support.

    Example:
        >>> mathml(r"\sigma^2")
        '<math alttext="\\sigma^2"><msup><mi>σ</mi><mn>2</mn></msup></math>'
    """
    from math_core import LatexError, LatexToMathML

    source = " ".join(formula.split())
    converter = LatexToMathML(fancy_error=False)
    try:
        element = converter.convert_with_local_state(formula, displaystyle=block)
    except LatexError as error:
        raise ValueError(f"formula {source!r} cannot be converted to MathML: {error}") from None
    alternative_text = html.escape(source, quote=True)
    return element.replace("<math", f'<math alttext="{alternative_text}"', 1)
