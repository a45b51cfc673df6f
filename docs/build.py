"""Build the documentation: `make docs`, or `python docs/build.py`; `--help` lists the options.

Notebooks and examples run in parallel, but only if a change affects them: see
`docs/_ext/running.py`. Pages come from docs/, notebooks/, scenes/README.md, assignments/README.md,
CHANGELOG.md and CONTRIBUTING.md. The build writes to build/docs: Sphinx reads the folder `source`
and writes the site to `html`. Neither the build nor the site needs a network. The build fails if
Sphinx warns, if a link is dead, or if a page would load a file from another site.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BUILD = ROOT / "build" / "docs"
SOURCE = BUILD / "source"
EXAMPLES = BUILD / "examples"
HTML = BUILD / "html"
EXTENSIONS = ROOT / "docs/_ext"
MOST_BYTES = 3e6  # Limit of a page with all files that it loads at once, for phones
MOST_BYTES_OF_FRAME = 2e6  # Limit of a page in an iframe, which loads when it becomes visible
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^()\s:]+)\)")
TEXT = (".md", ".ipynb")
FILM = "the film of the start page"


def places() -> dict[str, Path]:
    """Map the path of each file that belongs to the site to its place in the build."""
    found: dict[str, Path] = {}
    for path in sorted((ROOT / "docs").rglob("*")):
        inside = path.relative_to(ROOT / "docs")
        if path.is_file() and "__pycache__" not in inside.parts and path != Path(__file__):
            gallery = inside.parts[0] == "gallery"
            found[f"docs/{inside}"] = EXAMPLES / inside.name if gallery else SOURCE / inside
    for folder in ("notebooks", "scenes/pictures"):
        for path in filter(Path.is_file, sorted((ROOT / folder).glob("*.*"))):
            found[f"{folder}/{path.name}"] = SOURCE / folder / path.name
    found["docs/gallery"] = SOURCE / "gallery/index.rst"  # Made by sphinx-gallery
    found["scenes/cornell_box.png"] = SOURCE / "scenes/cornell_box.png"
    found["scenes/README.md"] = SOURCE / "scenes/README.md"
    found["assignments/README.md"] = SOURCE / "guides/teacher.md"
    found["CHANGELOG.md"] = SOURCE / "changelog.md"
    found["SECURITY.md"] = SOURCE / "security.md"
    found["CONTRIBUTING.md"] = SOURCE / "contributing.md"
    return found


def relinked(text: str, path: str, known: dict[str, Path]) -> str:
    """Change links to files of the repository into links to pages of the site.

    If a file is not part of the site, only the words of the link remain.

    Args:
        text: Text of the file: Markdown, or the JSON of a notebook.
        path: Path of the file in the repository.
        known: Result of `places`.
    """

    def replace(found: re.Match[str]) -> str:
        words = found[2]
        target, _, anchor = found[3].partition("#")
        if not target:
            return found[0]
        aim = os.path.normpath(os.path.join(os.path.dirname(path), target))
        if aim not in known:
            return found[0] if found[1] else words
        there = os.path.relpath(known[aim], known[path].parent)
        return f"{found[1]}[{words}]({there}{'#' + anchor if anchor else ''})"

    return LINK.sub(replace, text)


def assemble() -> None:
    """Update the folders `source` and `examples`. Unchanged files keep their times."""
    known = places()
    for name, target in known.items():
        if target.suffix == ".rst" and not (ROOT / name).is_file():
            continue
        content = (ROOT / name).read_bytes()
        if target.suffix in TEXT:
            content = relinked(content.decode(), name, known).encode()
        if not target.exists() or target.read_bytes() != content:
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(content)
    ours = set(known.values())
    for folder in (SOURCE, EXAMPLES):
        for path in folder.rglob("*"):
            made = path.is_relative_to(SOURCE / "gallery") or path.parent == SOURCE / "_static/made"
            if path.is_file() and path not in ours and not made:
                path.unlink()  # Its page is gone


def make_film(folder: Path) -> None:
    """The film of the start page, the picture that is there until it plays, and the explorers."""
    import running
    from PIL import Image

    import tofrender

    folder.mkdir(parents=True, exist_ok=True)
    box = {"window": (3.5, 12.5), "progress": False}
    film = tofrender.render(
        "cornell_box", spp=384, size=(144, 144), bins=140, pulse_width=0.06, **box
    )
    tofrender.save_video(film, folder / "cornell_box.mp4", fps=22, min_size=288, progress=False)
    frame = film["transient"].sel(opl=5.9, method="nearest").values
    exposure = tofrender.vis.auto_exposure(film["transient"].values)
    poster = Image.fromarray(tofrender.tonemap(frame, exposure=exposure))
    poster.quantize(256).resize((288, 288)).save(folder / "cornell_box.png")
    whole = {"title": "The Cornell box", "overwrite": True}
    tofrender.report(film, folder / "explorer.html", megabytes=2.5, **whole)
    small = tofrender.render(
        "cornell_box", spp=768, size=(96, 96), bins=75, pulse_width=0.08, **box
    )
    # A smaller report would average blocks of pixels, which looks blurred
    tofrender.report(small, folder / "landing.html", megabytes=1.6, **whole)
    running.record(FILM)


STARTUP = """
import os
import sys
from pathlib import Path

sys.path.insert(0, "EXTENSIONS")
import explorers
import running

explorers.use_pages(Path("MADE"))
get_ipython().events.register("post_run_cell", lambda _: running.record(os.environ[running.PAGE]))
"""
"""Code that runs at the start of notebooks. It shows the explorer without a kernel."""


def quiet_kernels(folder: Path) -> None:
    """Run notebooks without the user's settings and without log messages of kernels."""
    profile = folder / "profile_default"
    profile.joinpath("startup").mkdir(parents=True, exist_ok=True)
    profile.joinpath("ipython_kernel_config.py").write_text(
        "get_config().Application.log_level = 40\n"
    )
    profile.joinpath("startup/explorer.py").write_text(
        STARTUP.replace("MADE", str(SOURCE / "_static/made")).replace("EXTENSIONS", str(EXTENSIONS))
    )
    os.environ |= {"IPYTHONDIR": str(folder), "JUPYTER_RUNTIME_DIR": str(folder)}
    os.environ["TQDM_DISABLE"] = "1"  # Pages do not show progress bars
    os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])


def shrink_pictures() -> None:
    """Reduce the pictures of the site to 256 colors, which need a third of the size."""
    from PIL import Image

    for path in (HTML / "_images").glob("*.png"):
        with Image.open(path) as image:
            image.load()
        if image.mode == "RGBA" and image.getextrema()[3][0] == 255:
            image = image.convert("RGB")
        if image.mode in ("RGB", "RGBA"):
            method = Image.Quantize.FASTOCTREE if image.mode == "RGBA" else None
            image.quantize(256, method).save(path, optimize=True)


def pages() -> Iterator[tuple[Path, list[tuple[str, str, str]], set[str]]]:
    """Yield each page of the site with the (tag, attribute, address) in it, and its anchors.

    The tag of a frame that loads when a reader scrolls to it is "lazy iframe".
    """
    from html.parser import HTMLParser

    class Reader(HTMLParser):
        def __init__(self) -> None:
            super().__init__()
            self.addresses: list[tuple[str, str, str]] = []
            self.anchors: set[str] = {""}

        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            if ("loading", "lazy") in attrs and tag == "iframe":
                tag = "lazy iframe"
            for name, value in attrs:
                if name in ("href", "src", "poster") and value:
                    self.addresses.append((tag, name, value))
                elif name in ("id", "name") and value:
                    self.anchors.add(value)

    for path in sorted(set(HTML.rglob("*.html")) - set(HTML.glob("_static/**/*.html"))):
        reader = Reader()
        reader.feed(path.read_text(encoding="utf-8"))
        yield path, reader.addresses, reader.anchors


def faults() -> list[str]:
    """Dead links, addresses that pages and styles would load from elsewhere, pages too large."""
    from urllib.parse import unquote, urlsplit

    read = list(pages())
    anchors = {path: found for path, _, found in read}
    wrong = []
    for path, addresses, _ in read:
        here = path.relative_to(HTML)
        loaded = {path}
        for tag, name, address in addresses:
            parts = urlsplit(address)
            if parts.scheme in ("http", "https") or address.startswith("//"):
                if tag != "a":
                    wrong.append(f"{here}: loads {address}")
                continue
            if parts.scheme or not (parts.path or parts.fragment):
                continue
            aim = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if tag == "lazy iframe" and aim.is_file():
                size = aim.stat().st_size
                if size > MOST_BYTES_OF_FRAME:
                    most = f"{MOST_BYTES_OF_FRAME / 1e6:g} MB"
                    wrong.append(f"{here}: {address}: {size / 1e6:.1f} MB, must be at most {most}")
            elif tag != "a" and aim.is_file():
                loaded.add(aim)
            if not aim.is_file():
                wrong.append(f"{here}: {name} {address}: no such file")
            elif aim in anchors and unquote(parts.fragment) not in anchors[aim]:
                wrong.append(f"{here}: {name} {address}: no such place on that page")
        size = sum(each.stat().st_size for each in loaded)
        if size > MOST_BYTES:
            wrong.append(f"{here}: {size / 1e6:.1f} MB, must be at most {MOST_BYTES / 1e6:g} MB")
    for style in HTML.rglob("*.css"):
        for address in re.findall(
            r"(?:@import\s*|url\()[\"']?(https?:[^\"')]*)", style.read_text()
        ):
            wrong.append(f"{style.relative_to(HTML)}: loads {address}")
    return wrong


def changed(since: str) -> set[str]:
    """Names of notebooks and examples that have changed since a commit."""
    command = ["git", "diff", "--name-only", since, "--", "notebooks", "docs/gallery"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"--since {since}: must be a commit of this repository")
    return {Path(line).name for line in done.stdout.splitlines()}


def remove_unused_explorers() -> None:
    """Remove the pages with explorers that no page shows any more."""
    shown = {address.rpartition("/")[2] for _, found, _ in pages() for _, _, address in found}
    for folder in (SOURCE, HTML):
        for path in (folder / "_static/made").glob("explorer_*.html"):
            if path.name not in shown:
                path.unlink()


def run_notebooks(names: set[str] | None) -> list[str]:
    """Run the notebooks that a change concerns, and make the film of the start page.

    Args:
        names: Names of notebooks; no others run. None for all notebooks.

    Returns:
        The names of the notebooks that failed.
    """
    import running

    quiet_kernels(BUILD / "ipython")
    notebooks = sorted(SOURCE.glob("notebooks/*.ipynb"))
    chosen = [path for path in notebooks if names is None or path.name in names]
    stale = running.stale_notebooks(chosen)
    jobs: dict[str, tuple] = {path.name: (running.run_notebook, path) for path in stale}
    if not running.is_current(FILM):
        jobs[FILM] = (make_film, SOURCE / "_static/made")
    failed = running.run_jobs(jobs, cores())

    # A newer time makes Sphinx read the notebook again, with its new outputs.
    for path in stale:
        path.touch()
    return failed


def cores() -> int:
    """Return the number of cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1


def build(full: bool = False, quick: bool = False, since: str | None = None) -> int:
    """Build the site; returns Sphinx's exit status, or 1 if a notebook fails or a link is dead."""
    import running
    from sphinx.cmd.build import build_main

    os.environ["TOFRENDER_NOTEBOOK_SIZE"] = "" if full else "small"
    assemble()
    HTML.joinpath("_static").mkdir(parents=True, exist_ok=True)
    options = ["-W", "--keep-going", "-j", str(cores()), "-d", str(BUILD / "doctrees")]
    if quick:
        options += ["-D", "nb_execution_mode=off", "-D", "plot_gallery=False"]
    else:
        names = None if since is None else changed(since)
        if names is not None:
            os.environ["DOCS_ONLY"] = " ".join(names)
        if run_notebooks(names):
            return 1

        # Without the file with its digest, sphinx-gallery runs an example again.
        for example in EXAMPLES.glob("*.py"):
            if not running.is_current(example.name):
                (SOURCE / "gallery" / f"{example.name}.md5").unlink(missing_ok=True)

    # The pages of the API show docstrings, so that Sphinx reads them again each time.
    for page in (SOURCE / "api").glob("*.md"):
        page.touch()
    status = build_main([*options, "-b", "html", str(SOURCE), str(HTML)])
    for example in EXAMPLES.glob("*.py"):
        if (SOURCE / "gallery" / f"{example.name}.md5").exists():  # It ran to its end
            running.keep(example.name)
    if status:
        return status
    if not quick:
        remove_unused_explorers()
    shrink_pictures()
    wrong = faults()
    for line in wrong:
        print(f"docs: {line}", file=sys.stderr)
    if not wrong:
        print(f"The documentation is in {HTML.relative_to(ROOT)}/index.html")
    return bool(wrong)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Build the documentation in build/docs/html.")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--full", action="store_true", help="run notebooks at their full size")
    which.add_argument("--quick", action="store_true", help="run no notebooks and no examples")
    which.add_argument(
        "--since", metavar="COMMIT", help="run the notebooks and examples changed since a commit"
    )
    sys.path[:0] = [str(ROOT), str(EXTENSIONS)]
    sys.exit(build(**vars(parser.parse_args())))
