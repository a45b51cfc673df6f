"""Formulas as MathML, which browsers draw themselves: no script, no font, no network."""

from __future__ import annotations

import html
import re

REPLACED = (
    (r"\\dots\b", r"\\ldots"),
    (r"\\[Bb]ig[lrm]?\b", ""),
    (r"°", r"^{\\circ}"),
    (r"\\frac(\d)", r"\\frac{\1}"),
    (r"(\\frac\{[^{}]*\})(\d)", r"\1{\2}"),
    (r"([\^_]|\\sqrt)(\d)", r"\1{\2}"),
)
"""What docutils does not know or reads otherwise than TeX, and what says the same."""


def mathml(formula: str, *, block: bool = False) -> str:
    r"""A formula of TeX as a `<math>` element, whose alternative text is the TeX.

    Args:
        formula: TeX, without dollars.
        block: Whether it stands on a line of its own.

    Raises:
        ValueError: docutils cannot read it; one line.

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
