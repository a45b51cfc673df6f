"""Take outputs, counts and metadata out of notebooks: python .ci/strip_notebooks.py FILE.ipynb ...

The exit status is 1 if a file was changed, as pre-commit wants it.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

KEPT = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}


def stripped(notebook: dict[str, Any]) -> dict[str, Any]:
    """Take them out of a notebook, in place."""
    given = notebook["metadata"]  # where it is more than this, it names what somebody ran it with
    notebook["metadata"] = {name: kept for name, kept in KEPT.items() if name in given}
    for cell in notebook["cells"]:
        cell["metadata"] = {}
        if cell["cell_type"] == "code":
            cell.update(outputs=[], execution_count=None)
    return notebook


def strip(path: Path) -> bool:
    """Strip a notebook in place; returns whether there was anything to take out."""
    before = path.read_text(encoding="utf-8")
    notebook = stripped(json.loads(before))
    after = json.dumps(notebook, indent=1, ensure_ascii=False) + "\n"
    if after != before:
        path.write_text(after, encoding="utf-8")
    return after != before


if __name__ == "__main__":
    changed = [path for path in sys.argv[1:] if strip(Path(path))]
    for path in changed:
        print(f"{path}: stripped")
    sys.exit(bool(changed))
