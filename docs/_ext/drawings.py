"""Pictures that are more: drawings in the colors of their page, films, pages within pages.

A drawing (.svg) becomes part of the page, so that its lines have the color of the text. A picture
becomes a film, or a page to touch, if there is one of its name in `_static/made`.
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
    """An SVG file's text without its own colors, which are for pages that show it as a file."""
    svg = re.sub(r"<\?xml.*?\?>|<style>.*?</style>", "", svg, flags=re.DOTALL)
    role = f'role="img" aria-label="{escape(words)}"' if words else 'aria-hidden="true"'
    return svg.replace("<svg ", f'<svg class="drawing" {role} ', 1)


def film(folder: str, name: str, words: str) -> str:
    """A film that plays by itself, silently, unless motion is unwanted, with its words below."""
    return (
        f'<figure class="film"><video src="{folder}/{name}.mp4" poster="{folder}/{name}.png" '
        f'loop muted playsinline controls onloadeddata="{PLAYS}"></video>'
        f"<figcaption>{escape(words)}</figcaption></figure>"
    )


def page_within(root: str, picture: Path, words: str) -> str:
    """A page to touch; the picture is there until it has come, and where scripts do not run."""
    source, title = f"{root}_static/made/{picture.stem}", escape(words)
    return (
        f'<iframe class="touch" src="{source}.html" title="{title}" loading="lazy" '
        f'style="background-image: url({source}.png)"></iframe><noscript>'
        "<style>iframe.touch { display: none }</style>"
        f'<img src="{source}.png" alt="{title}"></noscript>'
    )


def add_dark_thumbnail(app: Sphinx, image: nodes.image, path: Path) -> None:
    """Put beside a thumbnail of the gallery the one for dark pages, if there is such a figure."""
    image["alt"] = ""  # The link below it has the words
    figure = path.parents[1] / path.name.replace("_thumb", "_001_dark")
    if not figure.exists():
        return
    dark = path.with_stem(f"{path.stem}_dark")
    with Image.open(figure) as picture, Image.open(path) as light:
        picture.thumbnail(light.size)
        picture.save(dark)
    other = image.deepcopy()
    other["uri"] = str(Path(image["uri"]).with_name(dark.name))
    other["candidates"] = {"*": other["uri"]}
    app.env.images.add_file(app.env.docname, other["uri"])
    image["classes"].append("only-light")
    other["classes"].append("only-dark")
    image.parent.insert(image.parent.index(image) + 1, other)


def draw(app: Sphinx, doctree: nodes.document) -> None:
    """Put drawings and films in the places of the pictures that name them."""
    made = Path(app.srcdir, "_static/made")
    for image in list(doctree.findall(nodes.image)):
        path, words = Path(app.srcdir, image["uri"]), image.get("alt", "")
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
    """Draw when a page is read."""
    app.connect("doctree-read", draw)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
