"""Checks of files on which Mitsuba crashes or hangs: deeply nested XML, PLY with wrong indices.

Mitsuba reports all other errors in files.
"""

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.parsers import expat

import mitsuba as mi
import numpy as np

from ..runtime import checks
from ..runtime.plugins import require_safe_type

MAX_NESTING = 200
"""Largest depth of nested tags or dicts. Mitsuba's parser recurses until the stack overflows."""

MAX_INCLUDES = 15  # Largest depth of nested includes that Mitsuba reads
MAX_INCLUDED = 1000  # Largest number of files that a scene includes; repeated includes count

# NumPy types of the types in headers of PLY files
_PLY_TYPES = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
_HEADER = re.compile(rb"\Aply\s.*?\bend_header\r?\n", re.DOTALL)


def require_shallow_xml(path: Path, parameters: Mapping[str, str]) -> None:
    """Raise a ValueError if Mitsuba's parser would crash or hang on an XML file or its includes.

    The causes are tags that are nested too deeply, a second root, a file that includes itself, and
    too many includes.

    Args:
        path: The XML file.
        parameters: Values of the parameters, which names of included files may contain.

    Raises:
        ValueError: If the parser would crash or hang, or a file cannot be read.
    """
    _require_shallow(path, parameters, (), [])


def _require_shallow(
    path: Path, parameters: Mapping[str, str], owners: tuple[Path, ...], included: list[Path]
) -> None:
    """Check one file of a scene, and the files that it includes.

    Args:
        path: The file.
        parameters: Values of the names that start with $.
        owners: Files that include this one, the outermost first.
        included: All files that were included so far. This function appends to the list.
    """
    depth = 0
    known = dict(parameters)
    reader = expat.ParserCreate()
    chain = (*owners, path.resolve())

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > MAX_NESTING:
            raise ValueError(
                f"scene = {str(path)!r}: more than {MAX_NESTING} tags are nested in line "
                f"{reader.CurrentLineNumber}. Use fewer levels"
            )
        if tag == "default":
            known.setdefault(attributes.get("name", ""), attributes.get("value", ""))
        if tag == "include" and attributes.get("filename"):
            include(attributes["filename"])

    def include(filename: str) -> None:
        # Find the file; one that does not exist is left to Mitsuba's message
        name = re.sub(r"\$(\w+)", lambda found: known.get(found[1], found[0]), filename)
        inner = resolved_path(str(checks.path("include: filename", name)))
        if not inner.is_file():
            return

        # Refuse includes without end
        if inner.resolve() in chain:
            raise ValueError(
                f"scene = {str(chain[0])!r}: {inner.name} includes itself, in line "
                f"{reader.CurrentLineNumber} of {path.name}. Remove that <include>"
            )
        included.append(inner)
        if len(included) > MAX_INCLUDED:
            raise ValueError(
                f"scene = {str(chain[0])!r}: includes more than {MAX_INCLUDED} files. Use fewer "
                "<include> tags"
            )
        if len(chain) <= MAX_INCLUDES:
            _require_shallow(inner, known, chain, included)

    def end(_tag: str) -> None:
        nonlocal depth
        depth -= 1

    reader.StartElementHandler = start
    reader.EndElementHandler = end
    try:
        # `ParseFile` reads small blocks, and reads a long attribute again for each of them
        reader.Parse(path.read_bytes(), True)
    except expat.ExpatError as error:
        if error.code == expat.errors.codes[expat.errors.XML_ERROR_JUNK_AFTER_DOC_ELEMENT]:
            raise ValueError(
                f"scene = {str(path)!r}: the scene ends before line {error.lineno}, but the file "
                "continues. Remove the rest of the file"
            ) from None
        return  # Mitsuba reports the error and its line


def require_utf8(name: str, text: str | os.PathLike[str]) -> None:
    """Raise a ValueError if a path or text is not valid UTF-8, which Mitsuba cannot read."""
    text = os.fspath(text)
    try:
        text.encode()
    except UnicodeEncodeError:
        raise ValueError(
            f"{name} = {text!r}: is not valid UTF-8, which Mitsuba cannot read. Rename the file or "
            "the folder"
        ) from None


def require_readable_dict(description: Mapping[str, Any]) -> None:
    """Raise a ValueError if a dict is nested too deeply, contains None, or names an unsafe plugin.

    Raises:
        ValueError: If the dict is not supported. The message contains the path of the entry.
    """
    level: list[Any] = [("", description)]
    for _ in range(MAX_NESTING):
        values = [(f"{at}{name}", v) for at, each in level for name, v in each.items()]
        for name, value in values:
            if value is None:
                raise ValueError(f"{name} = None: pass a value or omit the entry")
            if isinstance(value, str):
                require_utf8(name, value)
            if isinstance(value, str) and name.rpartition(".")[2] == "type":
                require_safe_type(value)
                if value == "resources" and name.count(".") != 1:
                    raise ValueError(
                        f"{name} = 'resources': nested in another part. Move it to the top level "
                        "of the scene"
                    )
        level = [(f"{name}.", v) for name, v in values if isinstance(v, Mapping)]
        if not level:
            return
    raise ValueError(f"scene: more than {MAX_NESTING} dicts are nested. Use fewer levels")


def require_indices(filename: str) -> None:
    """Raise a ValueError if a face of a PLY file refers to a vertex that does not exist."""
    path = resolved_path(filename)
    if not path.is_file():
        return
    try:
        vertices, faces = _vertices_and_faces(path)
    except (KeyError, TypeError, ValueError):
        return  # Mitsuba cannot read this file and reports why
    wrong = np.argwhere((faces < 0) | (faces >= vertices))
    if len(wrong):
        face, corner = wrong[0]
        raise ValueError(
            f"{filename}: face {face} refers to vertex {int(faces[face, corner])}, but the file "
            f"has vertices 0 to {vertices - 1}. Repair the mesh"
        )


def _vertices_and_faces(path: Path) -> tuple[int, np.ndarray]:
    """Return the number of vertices in a PLY file, and the vertex indices of its triangles (n, 3).

    Raises:
        KeyError, TypeError, ValueError: If Mitsuba cannot read the file, for example elements of
            varying size, or faces other than triangles.
    """
    # Read the header
    with path.open("rb") as file:
        head = _HEADER.match(file.read(1 << 16))
    if head is None:
        raise ValueError("no header")
    counts: dict[str, int] = {}
    fields: dict[str, list[tuple]] = {}
    order = ""  # Byte order, or "" for a text file
    element = ""

    def number(kind: str) -> str:
        """Return the NumPy type of a number in the file; numbers in text are read as doubles."""
        return order + _PLY_TYPES[kind] if order else "f8"

    # Collect the number and the fields of each element
    for line in head[0].decode("latin-1").splitlines():
        match line.split():
            case ["format", given, _]:
                order = {"binary_little_endian": "<", "binary_big_endian": ">"}.get(given, "")
            case ["element", element, count]:
                counts[element] = int(count)
                fields[element] = []
            case ["property", "list", count, index, _]:
                fields[element] += [("count", number(count)), ("corners", number(index), 3)]
            case ["property", kind, name]:
                fields[element] += [(f"{name} ", number(kind))]

    # Skip the elements before the faces, then read the faces
    start = head.end() if order else 0
    for element, count in counts.items():
        row = np.dtype(fields[element])
        if element != "face":
            start += count * row.itemsize
            continue
        if order:
            faces = np.fromfile(path, row, count, offset=start)
        else:
            numbers = np.array(path.read_bytes()[head.end() :].split(), dtype=np.float64)
            faces = np.frombuffer(numbers.tobytes(), row, count, start)
        if not np.all(faces["count"] == 3):
            break
        return counts["vertex"], faces["corners"]
    raise ValueError("no triangles")


def resolved_path(name: str) -> Path:
    """Return the path where Mitsuba finds a file."""
    untyped: Any = mi  # Mitsuba's stubs declare this function as not callable
    return Path(str(untyped.file_resolver().resolve(name)))
