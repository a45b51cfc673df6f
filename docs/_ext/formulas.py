"""Write formulas as MathML. Browsers draw MathML without scripts, fonts or a network."""

from __future__ import annotations

from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util import logging

from tofrender.course.pages import mathml

logger = logging.getLogger(__name__)


def _mathml(formula: str, node: nodes.Element, block: bool) -> str:
    try:
        return mathml(formula, block=block)
    except ValueError as error:
        logger.warning("%s", error, location=node)
        return ""


def inline(translator: Any, node: nodes.Element) -> None:
    """Write an inline formula."""
    translator.body.append(_mathml(node.astext(), node, False))
    raise nodes.SkipNode


def block(translator: Any, node: nodes.Element) -> None:
    """Write a formula on a separate line."""
    translator.body.append(f'<div class="formula">{_mathml(node.astext(), node, True)}</div>')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the renderer `mathml`."""
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
