"""What hinders readers of a page, found by axe-core."""

from typing import Any

import pytest

TAGS = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]
SERIOUS = ("serious", "critical")


def hindrances(page: Any, *, within: str = "html", ignored: tuple[str, ...] = ()) -> list[str]:
    """Serious findings of axe-core below an element, and headings and landmarks that lack."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    options = {"runOnly": {"type": "tag", "values": TAGS}}
    found = axe.run(page, context=within, options=options).response["violations"]
    required = ("page-has-heading-one", "landmark-one-main", "target-size")
    return [
        f"{each['id']}: {each['help']}: {[node['html'][:160] for node in each['nodes'][:4]]}"
        for each in found
        if (each["impact"] in SERIOUS or each["id"] in required) and each["id"] not in ignored
    ]
