"""Script that tests a student edition: withheld names must be missing, other parts must work.

    PYTHONPATH=EDITION python -P smoke_test.py '{"modules": {...}, "names": [...], ...}'

The script prints the errors as a line of JSON. It is a script and not a module, so that it imports
only the edition and not the package that contains it.
"""

import importlib
import json
import pkgutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

NOT_PART = "is not part of the student edition"


def main(expected: dict[str, Any]) -> list[str]:
    """Import all modules of the edition, and try its parts.

    Args:
        expected: Withheld "modules"; withheld "names", each with its module and problem; names
            that handout and notebook have "used"; id of the "assignment".

    Returns:
        A message for each error.
    """
    import tofrender

    home = Path.cwd().resolve() / "tofrender"
    if Path(tofrender.__file__).resolve().parent != home:
        return [f"tofrender was imported from {tofrender.__file__}, not from the edition"]

    # Withheld modules and names must be missing
    reasons = []
    for module in expected["modules"]:
        reasons += _not_withheld(f"import {module}", module, "")
    for module, name, problem in expected["names"]:
        reasons += _not_withheld(f"from {module} import {name}", f"{module}.{name}", problem)

    # Names that handout and notebook use must exist
    for name in expected["used"]:
        try:
            getattr(tofrender, name)
        except (AttributeError, ImportError) as error:
            reasons.append(f"tofrender.{name}: is used by handout or notebook: {error}")

    # All modules must be importable
    for module in pkgutil.walk_packages(tofrender.__path__, "tofrender.", onerror=lambda _: None):
        if module.name.endswith("__main__") or module.name.startswith("tofrender.course.material"):
            continue
        try:
            importlib.import_module(module.name)
        except Exception as error:
            advice = "; withhold this module, too" if isinstance(error, ImportError) else ""
            reasons.append(f"{module.name}: cannot be imported: {error}{advice}")

    # Central parts must work
    for part, check in (
        ("a scene", _scenes),
        ("the film", _film),
        ("the assignment", lambda: _assignment(expected["assignment"])),
    ):
        try:
            check()
        except Exception as error:
            reasons.append(f"{part}: does not work: {type(error).__name__}: {error}")
    return reasons


def _not_withheld(statement: str, name: str, problem: str) -> Iterator[str]:
    """Check that an import statement raises an error that names the problem."""
    try:
        exec(statement, {})
    except ImportError as error:
        text = str(error)
        if "is yours to write: problem " not in text and NOT_PART not in text:
            yield f"{name}: is missing, but the error does not name the problem: {text}"
        elif problem and f"problem {problem}" not in text:
            yield f"{name}: the error {text!r} must name problem {problem}"
    else:
        yield f"{name}: can be imported, but must be withheld"


def _scenes() -> None:
    """Load all built-in scenes."""
    from tofrender.scenes import BUILT_IN
    from tofrender.scenes.loading import load_scene

    for name in BUILT_IN:
        load_scene(name)


def _film() -> None:
    """Make a transient film, unless it is withheld, and check its shape."""
    import mitsuba as mi

    import tofrender
    from tofrender.runtime import editions

    if editions.refusal("tofrender.films.transient"):
        return
    size = {"width": 4, "height": 2, "temporal_bins": 3}
    film: Any = mi.load_dict({"type": "transient_hdr_film", **size})
    assert isinstance(film, tofrender.TransientHDRFilm)
    assert tuple(film.shape)[:3] == (2, 4, 3), film.shape


def _assignment(name: str) -> None:
    """Check that this edition finds the assignment `name`, and that it has no `solutions/`."""
    from tofrender.course import assignments

    found = assignments.find(name)
    assert found.folder.is_relative_to(Path.cwd().resolve()), found.folder
    assert not found.solutions.exists()


if __name__ == "__main__":
    print("\n" + json.dumps({"reasons": main(json.loads(sys.argv[1]))}))
