"""Pictures that are more: drawings in the colours of their page, films, pages within pages.

A drawing (.svg) becomes part of the page, so that its lines have the colour of the text. A picture
becomes a film, or a page to touch, if there is one of its name in `_static/made`.
"""

from __future__ import annotations

import re
from html import escape
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx


def inlined(svg: str, words: str) -> str:
    """An SVG file's text without its own colours, which are for pages that show it as a file."""
    svg = re.sub(r"<\?xml.*?\?>|<style>.*?</style>", "", svg, flags=re.DOTALL)
    return svg.replace("<svg ", f'<svg class="drawing" role="img" aria-label="{escape(words)}" ', 1)


def film(folder: str, name: str, words: str) -> str:
    """A film that plays by itself, silently, and can be stopped, with its words below."""
    return (
        f'<figure class="film"><video src="{folder}/{name}.mp4" poster="{folder}/{name}.png" '
        f"autoplay loop muted playsinline controls></video>"
        f"<figcaption>{escape(words)}</figcaption></figure>"
    )


def draw(app: Sphinx, doctree: nodes.document) -> None:
    """Put drawings and films in the places of the pictures that name them."""
    for image in list(doctree.findall(nodes.image)):
        path, words = Path(app.srcdir, image["uri"]), image.get("alt", "")
        if path.suffix == ".svg" and path.is_file():
            html = inlined(path.read_text(encoding="utf-8"), words)
        elif Path(app.srcdir, "_static/made", f"{path.stem}.mp4").exists():
            depth = app.env.docname.count("/")
            html = film("../" * depth + "_static/made", path.stem, words)
        elif Path(app.srcdir, "_static/made", f"{path.stem}.html").exists():
            source = "../" * app.env.docname.count("/") + f"_static/made/{path.stem}.html"
            html = f'<iframe class="touch" src="{source}" title="{escape(words)}"></iframe>'
        else:
            continue
        app.env.images.pop(image["uri"], None)
        image.replace_self(nodes.raw("", html, format="html"))


def setup(app: Sphinx) -> dict[str, Any]:
    """Draw when a page is read."""
    app.connect("doctree-read", draw)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
