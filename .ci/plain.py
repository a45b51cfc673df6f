"""Check that code is unpacked and that docstrings and messages use plain words.

    python .ci/plain.py [PATH ...]    checks tofrender/ by default

Each line of the output names a place and what to write instead. The exit status is 1 if the check
fails.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

WORDS = {
    r"\b(tells?|told)\b": "report, print or describe",
    r"\b(go|goes|going|gone|went) on\b": "continue or resume",
    r"\b(but|save) for\b": "except",
    r"[,;] else\b": "otherwise",
    r"\bbesides?\b": "next to, or in addition to",
    r"\bstands? for\b": "means",
    r"\b(likewise|whence|thereby|therein|whereof|thereof)\b": "a complete sentence",
}
"""Patterns that must not occur in docstrings and messages, and what to write instead."""

MESSAGES = ("Error", "Warning", "warn", "require", "Option", "Argument")
"""Ends of the names of functions and classes whose arguments are messages."""

SKIPPED = re.compile(r"`[^`]*`|^ *(>>>|\.\.\.) .*$|^ +\w+: ", re.MULTILINE)
"""Code in text: names in backticks, lines of examples, and names of parameters."""

LIMITS = {"tofrender/datasets": 2}
"""Number of old places that are still allowed in a package. Lower a limit when you mend a place."""

Found = tuple[int, str]  # line, and what to write instead


def packed_assignments(tree: ast.AST) -> Iterator[Found]:
    """Find `a, b = x, y`, except where a value needs the old value of another target."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Assign) or not isinstance(node.value, ast.Tuple):
            continue
        read = [{ast.unparse(part) for part in ast.walk(value)} for value in node.value.elts]
        for target in node.targets:
            if not isinstance(target, ast.Tuple):
                continue
            names = [ast.unparse(each) for each in target.elts]
            depends = any(
                name in values
                for i, name in enumerate(names)
                for j, values in enumerate(read)
                if i != j
            )
            if not depends:
                yield node.lineno, "packed assignment: write one assignment per line"


def starred_literals(tree: ast.AST) -> Iterator[Found]:
    """Find `*(a, b)` and `*[a, b]`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Starred) and isinstance(node.value, ast.Tuple | ast.List):
            yield node.lineno, "starred literal: write its entries one by one, without *( )"


def texts(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield the first line and the text of each docstring and of each part of a message."""
    for node in ast.walk(tree):
        parts: list[ast.AST] = []
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            if ast.get_docstring(node) is not None:
                parts = [node.body[0]]
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith(MESSAGES):
            parts = [*node.args, *(each.value for each in node.keywords if each.arg == "help")]
        for part in parts:
            for each in ast.walk(part):
                if isinstance(each, ast.Constant) and isinstance(each.value, str):
                    yield each.lineno, each.value


def odd_words(tree: ast.AST) -> Iterator[Found]:
    """Find words of `WORDS` in docstrings and messages, outside of code."""
    for first_line, text in texts(tree):
        prose = SKIPPED.sub(lambda code: "\n" * code[0].count("\n"), text)
        for pattern, instead in WORDS.items():
            for match in re.finditer(pattern.replace(" ", r"\s+"), prose, re.IGNORECASE):
                line = first_line + prose[: match.start()].count("\n")
                word = " ".join(match[0].split())
                yield line, f'"{word}": write {instead}'


def places(path: Path) -> list[str]:
    """Return the lines of output for a file."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found = [*packed_assignments(tree), *starred_literals(tree), *odd_words(tree)]
    return [f"{path.as_posix()}:{line}: {instead}" for line, instead in sorted(found)]


def main(arguments: list[str]) -> int:
    """Print the places in files and folders, and return the exit status."""
    failed = False
    for argument in arguments or ["tofrender"]:
        root = Path(argument)
        files = [root] if root.is_file() else sorted(root.rglob("*.py"))
        lines = [line for file in files for line in places(file)]

        # Old places of some packages are allowed, up to a limit
        for package, limit in LIMITS.items():
            old = [line for line in lines if line.startswith(f"{package}/")]
            if len(old) <= limit:
                lines = [line for line in lines if line not in old]
        for line in lines:
            print(line)
        failed = failed or bool(lines)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
