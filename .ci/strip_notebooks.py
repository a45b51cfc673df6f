"""Take outputs, counts and metadata out of notebooks: python .ci/strip_notebooks.py FILE.ipynb ...

The exit status is 1 if a file was changed, as pre-commit wants it.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

KEPT = ("kernelspec", "language_info")


def strip(path: Path) -> bool:
    """Strip a notebook in place; returns whether there was anything to take out."""
    before = path.read_text(encoding="utf-8")
    notebook = json.loads(before)
    notebook["metadata"] = {k: v for k, v in notebook["metadata"].items() if k in KEPT}
    if "language_info" in notebook["metadata"]:  # the rest names the version of who ran it
        notebook["metadata"]["language_info"] = {"name": "python"}
    for cell in notebook["cells"]:
        cell["metadata"] = {}
        if cell["cell_type"] == "code":
            cell.update(outputs=[], execution_count=None)
    after = json.dumps(notebook, indent=1, ensure_ascii=False) + "\n"
    if after != before:
        path.write_text(after, encoding="utf-8")
    return after != before


if __name__ == "__main__":
    changed = [path for path in sys.argv[1:] if strip(Path(path))]
    for path in changed:
        print(f"{path}: stripped")
    sys.exit(bool(changed))
