"""Order the table of packages in `docs/how_it_works.md` by the contract in `pyproject.toml`.

`python docs/_ext/packages.py` puts the rows into the order of the contract's layers. Descriptions
are written by hand in the page; a layer without a description stops the script.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs/how_it_works.md"
TABLE = re.compile(r"(\| package in `tofrender/` \| contents \|\n\|---\|---\|\n)((?:\|.*\n)+)")


def layers() -> list[tuple[str, ...]]:
    """Return the packages of each layer, the highest layer first."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contract = settings["tool"]["importlinter"]["contracts"][0]
    return [tuple(re.findall(r"\w+", layer)) for layer in contract["layers"]]


def with_table(page: str) -> str:
    """Return the text of the page with the rows of the contract, and their descriptions.

    Raises:
        ValueError: If a row is missing for a layer, or a row is not a layer of the contract.
    """
    found = TABLE.search(page)
    if found is None:
        raise ValueError("docs/how_it_works.md: the table of packages is missing")
    descriptions = {}
    for row in found[2].splitlines():
        names, contents = row.strip("| ").split(" | ", 1)
        descriptions[tuple(re.findall(r"\w+", names))] = contents
    wanted = layers()
    if set(wanted) != set(descriptions):
        differing = set(wanted) ^ set(descriptions)
        raise ValueError(f"rows without a layer, or layers without a row: {sorted(differing)}")

    rows = ""
    for packages in wanted:
        names = ", ".join(f"`{package}/`" for package in packages)
        rows += f"| {names} | {descriptions[packages]} |\n"
    return page[: found.start(2)] + rows + page[found.end(2) :]


if __name__ == "__main__":
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
