"""Make the pages of the API from lists of names, and convert docstrings for Sphinx.

This block of a page

    ```{names} tofrender
    render
    merge
    ```

becomes a table of these names with their docstrings. A block of `{commands}` becomes the help of
these commands. Docstrings contain Markdown's tables, indented code and single backquotes, and
Google's sections.
"""

from __future__ import annotations

import importlib
import inspect
import re
from typing import Any

from sphinx.application import Sphinx

from tofrender.runtime.lazy import public_names

NAMES = re.compile(r"^```\{names\} (\S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
COMMANDS = re.compile(r"^```\{commands\}\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SIGNATURE = re.compile(r'<dt class="sig .*?</dt>', re.DOTALL)


def _entry(home: Any, name: str) -> tuple[str, str]:
    """Return the kind of a name, and the name that autodoc needs to find its documentation."""
    value = getattr(home, name)
    if inspect.ismodule(value):
        return "module", value.__name__
    kind = "class" if inspect.isclass(value) else "function" if callable(value) else "data"
    module = public_names(home.__name__, home.__file__)[name]
    return kind, f"{module}.{name}" if kind == "data" else name


def _within(name: str, module: str) -> str:
    return name.removeprefix(f"{module}.")


def _expand(found: re.Match[str]) -> str:
    home = importlib.import_module(found[1])
    entries = [_entry(home, name) for name in found[2].split()]
    lines = ["````{eval-rst}", f".. currentmodule:: {found[1]}", "", ".. autosummary::"]
    lines += [
        "   :nosignatures:",
        "",
        *(f"   ~{_within(name, found[1])}" for _, name in entries),
        "",
    ]
    for kind, name in entries:
        lines += [f".. auto{kind}:: {name}"]
        lines += ["   :members:", ""] if kind in ("class", "module") else [""]
    return "\n".join([*lines, "````"])


def _commands(found: re.Match[str]) -> str:
    import typer.main

    from tofrender.cli.app import app

    group: Any = typer.main.get_command(app)
    lines = []
    for name in found[1].split():
        command = group.commands[name]
        context = command.context_class(command, info_name=name)
        usage = " ".join(command.collect_usage_pieces(context))
        lines += [f"## {name}", "", f"```sh\ntofrender {name} {usage}\n```", ""]
        lines += [_plain(inspect.cleandoc(command.help)), "", "| | |", "|---|---|"]
        for parameter in command.params:
            record = parameter.get_help_record(context)
            if record and "--help" not in record[0]:
                option, text = (" ".join(cell.split()).replace("|", "\\|") for cell in record)
                lines.append(f"| `{option}` | {_plain(text)} |")
        lines.append("")
    return "\n".join(lines)


def _plain(text: str) -> str:
    """Escape a text so that Markdown does not interpret it."""
    text = re.sub(r"([\[\]<>*_])", r"\\\1", text)
    return re.sub(r"(?<![\w`-])--[a-z][a-z-]*", r"`\g<0>`", text)


def expand(app: Sphinx, docname: str, source: list[str]) -> None:
    """Expand the blocks of names and commands on a page."""
    source[0] = COMMANDS.sub(_commands, NAMES.sub(_expand, source[0]))


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in re.split(r"(?<=\s)\|(?=\s)", line.strip()[1:-1])]


def _table(rows: list[str]) -> list[str]:
    indent = re.match(r" *", rows[0])[0]  # pyright: ignore[reportOptionalSubscript]
    lines = [".. list-table::", "   :header-rows: 1", ""]
    for row in (rows[0], *rows[2:]):
        for number, cell in enumerate(_cells(row)):
            lines.append(f"   {'*' if number == 0 else ' '} - {cell}")
    return ["", *(indent + line if line else "" for line in lines), ""]


def markdown(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Convert the Markdown in a docstring to reStructuredText, in place."""
    out: list[str] = []
    rows: list[str] = []
    code = False
    for line in [*lines, ""]:
        if line.lstrip().startswith("|") and line.rstrip().endswith("|"):
            rows.append(line)
            continue
        if rows:
            out += _table(rows)
            rows = []
        deep = line.startswith("    ")
        in_text = not any(re.match(r"[A-Z]\w+:$", before) for before in out)
        if deep and not code and in_text and out and not out[-1]:
            out += ["::", ""]
            code = True
        elif line and not deep:
            code = False
        out.append(line if code or ">>>" in line else line.replace("|", r"\|"))
    lines[:] = out


def _without_annotations(text: str) -> str:
    """Replace each `Annotated[X, ...]` in a signature by X."""
    found = re.search(r"(?:~?typing\.)?Annotated\[", text)
    if found is None:
        return text

    # Find the comma after X, and the bracket that ends the annotation
    depth = 1
    comma = None
    end = found.end()
    while depth:
        letter = text[end]
        depth += (letter in "[({") - (letter in "])}")
        if letter == "," and depth == 1 and comma is None:
            comma = end
        end += 1
    kept = text[found.end() : comma if comma is not None else end - 1]
    return _without_annotations(f"{text[: found.start()]}{kept}{text[end:]}")


def signature(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, arguments: str, returned: str
) -> tuple[str | None, str | None]:
    """Show types without the descriptions of Datasets that the package keeps in annotations."""
    return (
        arguments and _without_annotations(arguments),
        returned and _without_annotations(returned),
    )


def without_lists(app: Sphinx, page: str, template: str, context: dict, doctree: Any) -> None:
    """Make the lines of a long signature blocks: lists without terms confuse screen readers."""

    def blocks(found: re.Match[str]) -> str:
        text = found[0].replace("<dl>", '<div class="sig-lines">').replace("</dl>", "</div>")
        return text.replace("<dd>", "<div>").replace("</dd>", "</div>")

    context["body"] = SIGNATURE.sub(blocks, context.get("body", ""))


def setup(app: Sphinx) -> dict[str, Any]:
    """Connect the functions of this module to the events of Sphinx."""
    app.connect("source-read", expand)
    app.connect("html-page-context", without_lists)
    app.connect("autodoc-process-signature", signature)
    app.connect("autodoc-process-docstring", markdown, priority=100)  # Before napoleon
    return {"parallel_read_safe": True, "parallel_write_safe": True}
