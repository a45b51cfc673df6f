"""The explorer's JavaScript and CSS."""

from ..ui import bundle

MODULES = (
    "recording",
    "words",
    "stokes",
    "paint",
    "plot",
    "space",
    "pictures",
    "volume",
    "frame",
    "input",
    "controls",
    "responses",
    "link",
    "gif",
    "save",
    "paths",
    "explorer",
)


def javascript() -> str:
    """Return an ES module that exports `mount(element, {header, bytes})`."""
    return bundle.javascript("ui/parts", *(f"explorer/{name}" for name in MODULES))


def style() -> str:
    """Return the style sheet. Its rules apply inside an explorer only."""
    return bundle.style("explorer/explorer")
