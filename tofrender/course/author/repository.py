"""What makes the released folder a repository that tests itself: a workflow and a container."""

from __future__ import annotations

import json
from pathlib import Path

from ..rubric import Rubric

PYTHON = "3.12"
LLVM = "libllvm19"
WORKFLOW = f"""# Runs the public tests of each student's folder in this repository.
name: tests
on: [push, pull_request, workflow_dispatch]
permissions:
  contents: read
jobs:
  tests:
    runs-on: ubuntu-24.04
    timeout-minutes: 30
    steps:
      - uses: actions/checkout@v4
      - uses: actions/setup-python@v5
        with:
          python-version: "{PYTHON}"
          cache: pip
          cache-dependency-path: package/pyproject.toml
      - run: sudo apt-get update && sudo apt-get install -y --no-install-recommends {LLVM}
      - run: pip install "./package[course]"
      - run: tofrender doctor
      - name: The public tests
        run: |
          found=
          for rubric in */rubric.toml; do
            [ -e "$rubric" ] || continue
            found=yes
            folder=$(dirname "$rubric")
            (cd "$folder" && pytest -q) || failed=yes
          done
          [ -n "$found" ] || echo "::notice::no folder yet: tofrender start ASSIGNMENT my-work"
          [ -z "${{failed:-}}" ]
"""


def write(folder: Path, rubric: Rubric, package: str) -> None:
    """Write `.github/workflows/tests.yml`, `.devcontainer/` and `.gitignore`.

    Args:
        folder: What is released.
        rubric: The assignment's.
        package: Name of the folder in it that pip installs.
    """
    workflow = folder / ".github" / "workflows" / "tests.yml"
    workflow.parent.mkdir(parents=True)
    workflow.write_text(WORKFLOW, encoding="utf-8")
    container = {
        "name": rubric.title,
        "image": f"mcr.microsoft.com/devcontainers/python:{PYTHON}-bookworm",
        "hostRequirements": {"cpus": 2, "memory": "8gb"},
        "onCreateCommand": "sudo apt-get update && sudo apt-get install -y --no-install-recommends "
        f"wget && (sudo apt-get install -y {LLVM} || wget -qO- https://apt.llvm.org/llvm.sh | "
        "sudo bash -s -- 19)",
        "postCreateCommand": f'pip install "./{package}[course]" jupyterlab && tofrender doctor',
        "customizations": {
            "vscode": {"extensions": ["ms-python.python", "ms-toolsai.jupyter"]},
        },
    }
    place = folder / ".devcontainer" / "devcontainer.json"
    place.parent.mkdir()
    place.write_text(json.dumps(container, indent=2) + "\n", encoding="utf-8")
    ignored = (".venv/", "__pycache__/", ".pytest_cache/", ".ipynb_checkpoints/", "failures/")
    (folder / ".gitignore").write_text("\n".join(ignored) + "\n", encoding="utf-8")
