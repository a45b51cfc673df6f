"""Scenes that come with the package as files: Mitsuba XML, and the meshes that it reads."""

from __future__ import annotations

from importlib import resources
from pathlib import Path, PurePosixPath

FOLDER = "scenes"
"""Where they are in a checkout, and what their names begin with."""


def folder() -> Path | None:
    """The folder that holds them: in an installed package, or in a checkout; None if neither."""
    package = resources.files("tofrender")
    for place in (package / FOLDER / "xml", package / ".." / FOLDER):
        if isinstance(place, Path) and (place / "cornell_box.xml").is_file():
            return place.resolve()
    return None


def packaged(name: str) -> Path | None:
    """The scene of this name, if the package has it.

    Example:
        >>> packaged("scenes/nlos/nlos_z.xml").name
        'nlos_z.xml'
    """
    path, place = PurePosixPath(name), folder()
    if place is None or path.parts[:1] != (FOLDER,) or ".." in path.parts:
        return None
    found = place.joinpath(*path.parts[1:])
    return found if found.suffix == ".xml" and found.is_file() else None
