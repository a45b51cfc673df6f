"""Formulas of handouts: each is converted to MathML with the content of its TeX."""

import re
from pathlib import Path

import pytest
from markdown_it import MarkdownIt
from mdit_py_plugins.dollarmath import dollarmath_plugin

from tofrender.course.pages import mathml, page

ROOT = Path(__file__).parents[2]
PAGES = sorted((*ROOT.glob("assignments/*/**/*.md"), *ROOT.glob("docs/**/*.md")))

# TeX commands whose result is not a text or symbol of the same name
STRUCTURE = {"frac": "mfrac", "tfrac": "mfrac", "dfrac": "mfrac", "sqrt": "msqrt"}


def formulas(path: Path) -> list[tuple[str, bool]]:
    """Return the formulas of a Markdown page, each with whether it is on its own line."""
    found = []

    def collect(formula: str, options: dict) -> str:
        found.append((formula, options["display_mode"]))
        return ""

    reader = MarkdownIt("commonmark", {"html": False}).enable("table")
    strict = {"allow_labels": False, "allow_space": False, "allow_digits": False}
    reader.use(dollarmath_plugin, double_inline=True, renderer=collect, **strict)
    reader.render(path.read_text(encoding="utf-8"))
    return found


def test_fraction_in_text_style_is_a_fraction():
    for command in (r"\tfrac12", r"\frac12", r"\frac{1}{2}"):
        assert "<mn>1</mn><mn>2</mn></mfrac>" in mathml(command), command


def test_index_stands_behind_the_hat():
    element = mathml(r"\hat\lambda_k")
    base, _, index = element.partition("</mover>")
    assert "λ" in base
    assert "<msub><mover" in base
    assert "<mi>k</mi>" in index
    assert "<mi>k</mi>" not in base


def test_each_formula_of_all_pages_is_converted():
    """No TeX command is left as text, and there are as many fractions and roots as in the TeX."""
    number = 0
    for path in PAGES:
        for formula, block in formulas(path):
            element = mathml(formula, block=block)
            number += 1
            content = element.partition(">")[2]
            where = f"{path.name}: {formula}"
            assert "\\" not in content, where
            assert "merror" not in content, where
            for command, tag in STRUCTURE.items():
                used = re.findall(rf"\\{command}(?![a-z])", formula)
                assert content.count(f"<{tag}") >= len(used), where
    assert number > 500


def test_page_has_the_formula_and_its_source():
    html = page("# Title\n\nThe mass is $m_k = \\tfrac12$.\n")
    assert r'alttext="m_k = \tfrac12"' in html
    assert "</mfrac>" in html


def test_unknown_command_is_named():
    with pytest.raises(ValueError, match="nosuchcommand"):
        mathml(r"\nosuchcommand{x}")
