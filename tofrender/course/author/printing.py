"""Handouts as PDF: pages of HTML printed by Chromium, with headings and alternative texts kept."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
from pathlib import Path

from ...runtime.atomic import replacing

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
TIMEOUT_S = 120.0
LOCAL_LINK = re.compile(r'<a href="(?!https?:|#)[^"]*">(.*?)</a>', re.DOTALL)
"""What a PDF would keep as a place on this machine."""
INSTALL = "on Debian: apt-get install chromium fonts-stix"


def browser() -> str:
    """Where Chromium is.

    Raises:
        ValueError: It is nowhere; one line.
    """
    found = next(filter(None, map(shutil.which, NAMES)), None)
    if found is None:
        raise ValueError(f"--pdf: needs one of {', '.join(NAMES)} on the PATH; {INSTALL}")
    return found


def pdf(page: Path, path: Path) -> None:
    """Print a page of HTML, with an outline and the tags that screen readers need.

    Args:
        page: The page; pictures are taken from where it says.
        path: PDF to write, whole or not at all.

    Raises:
        ValueError: There is no Chromium, or it fails; one line.
    """
    with (
        tempfile.TemporaryDirectory() as profile,
        replacing(path) as temporary,
        tempfile.NamedTemporaryFile("w", suffix=".html", dir=page.parent, encoding="utf-8") as copy,
    ):
        copy.write(LOCAL_LINK.sub(r"\1", page.read_text(encoding="utf-8")))
        copy.flush()
        command = [
            browser(),
            "--headless=new",
            *(["--no-sandbox"] if hasattr(os, "getuid") and os.getuid() == 0 else []),
            "--disable-gpu",
            f"--user-data-dir={profile}",
            "--no-pdf-header-footer",
            "--generate-pdf-document-outline",
            f"--print-to-pdf={temporary}",
            Path(copy.name).resolve().as_uri(),
        ]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False
            )
        except subprocess.TimeoutExpired:
            raise ValueError(f"{path.name}: Chromium took over {TIMEOUT_S:g} s") from None
        if done.returncode or not temporary.is_file():
            last = (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]
            raise ValueError(f"{path.name}: Chromium has failed: {last}")
