"""Filter a notebook: the same without outputs, counts and metadata.

    python .ci/strip_notebooks.py < FILE.ipynb

Git runs it on what it stores (see .gitattributes; .ci/setup turns it on), so that a notebook in
the working folder keeps what it shows.
"""

from __future__ import annotations

import json
import sys
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


if __name__ == "__main__":
    text = json.dumps(stripped(json.load(sys.stdin.buffer)), indent=1, ensure_ascii=False)
    sys.stdout.buffer.write(f"{text}\n".encode())
