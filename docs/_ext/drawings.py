"""Replace pictures by inline drawings, films or interactive pages.

A drawing (.svg) becomes part of the page, so that its lines have the color of the text. If the
folder `_static/made` contains a film or an HTML page with the name of a picture, the film or the
page replaces the picture.
"""

from __future__ import annotations

import re
import shutil
from html import escape
from pathlib import Path
from typing import Any

from docutils import nodes
from PIL import Image
from sphinx.application import Sphinx

PLAYS = "matchMedia('(prefers-reduced-motion: reduce)').matches || this.play()"


def inlined(svg: str, words: str) -> str:
    """Return the text of an SVG file without its own colors."""
    svg = re.sub(r"<\?xml.*?\?>|<style>.*?</style>", "", svg, flags=re.DOTALL)
    role = f'role="img" aria-label="{escape(words)}"' if words else 'aria-hidden="true"'
    return svg.replace("<svg ", f'<svg class="drawing" {role} ', 1)


def film(folder: str, name: str, words: str) -> str:
    """Return the HTML of a silent film with a caption.

    The film starts automatically, unless the reader has asked for reduced motion.
    """
    return (
        f'<figure class="film"><video src="{folder}/{name}.mp4" poster="{folder}/{name}.png" '
        f'loop muted playsinline controls onloadeddata="{PLAYS}"></video>'
        f"<figcaption>{escape(words)}</figcaption></figure>"
    )


def page_within(root: str, picture: Path, words: str) -> str:
    """Return the HTML of an interactive page.

    The picture is visible until the page has loaded, and if scripts are disabled.
    """
    source = f"{root}_static/made/{picture.stem}"
    title = escape(words)
    return (
        f'<iframe class="touch" src="{source}.html" title="{title}" loading="lazy" '
        f'style="background-image: url({source}.png)"></iframe><noscript>'
        "<style>iframe.touch { display: none }</style>"
        f'<img src="{source}.png" alt="{title}"></noscript>'
    )


def add_dark_thumbnail(app: Sphinx, image: nodes.image, path: Path) -> None:
    """Add a thumbnail for dark pages to a thumbnail of the gallery, if a dark figure exists."""
    image["alt"] = ""  # The link below the thumbnail contains the text
    figure = path.parents[1] / path.name.replace("_thumb", "_001_dark")
    if not figure.exists():
        return

    # Shrink the dark figure to the size of the thumbnail
    dark = path.with_stem(f"{path.stem}_dark")
    with Image.open(figure) as picture, Image.open(path) as light:
        picture.thumbnail(light.size)
        picture.save(dark)

    # Show each thumbnail on pages of its theme only
    other = image.deepcopy()
    other["uri"] = str(Path(image["uri"]).with_name(dark.name))
    other["candidates"] = {"*": other["uri"]}
    app.env.images.add_file(app.env.docname, other["uri"])
    image["classes"].append("only-light")
    other["classes"].append("only-dark")
    image.parent.insert(image.parent.index(image) + 1, other)


def draw(app: Sphinx, doctree: nodes.document) -> None:
    """Replace the pictures of a page by drawings, films and interactive pages."""
    made = Path(app.srcdir, "_static/made")
    for image in list(doctree.findall(nodes.image)):
        path = Path(app.srcdir, image["uri"])
        words = image.get("alt", "")
        if path.suffix == ".svg" and path.is_file():
            html = inlined(path.read_text(encoding="utf-8"), words)
        elif (made / f"{path.stem}.mp4").exists() and path.parent.name != "pictures":
            depth = app.env.docname.count("/")
            html = film("../" * depth + "_static/made", path.stem, words)
        elif (made / f"{path.stem}.html").exists():
            shutil.copy(path, made)
            html = page_within("../" * app.env.docname.count("/"), path, words)
        elif path.stem.endswith("_thumb"):
            add_dark_thumbnail(app, image, path)
            continue
        else:
            continue
        app.env.images.pop(image["uri"], None)
        image.replace_self(nodes.raw("", html, format="html"))


def setup(app: Sphinx) -> dict[str, Any]:
    """Replace pictures when Sphinx reads a page."""
    app.connect("doctree-read", draw)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
