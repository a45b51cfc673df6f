"""What docs/ and CONTRIBUTING.md say: Python runs, links lead on, the API is whole."""

import importlib
import inspect
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
from helpers import browser
from helpers.accessible import hindrances

import tofrender
from tofrender.runtime.lazy import public_names

ROOT = Path(__file__).parents[2]
PAGES = sorted(ROOT.glob("docs/**/*.md"))
DOORS = ROOT / "docs/your_field.md"
WITH_PYTHON = [
    page for page in PAGES if page != DOORS and "```python" in page.read_text(encoding="utf-8")
]
EXAMPLES = sorted(ROOT.glob("docs/gallery/plot_*.py"))
SITE = ROOT / "build/docs/html"
NO_SITE = "the site is not built; run: make docs"


@pytest.fixture
def build(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "docs")
    module = importlib.import_module("build")
    yield module
    sys.modules.pop("build")


@pytest.fixture
def running(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(ROOT / "docs/_ext")
    module = importlib.import_module("running")
    monkeypatch.setattr(module, "ROOT", tmp_path)
    monkeypatch.setattr(module, "RUNS", tmp_path / "runs")
    monkeypatch.setenv("TOFRENDER_NOTEBOOK_SIZE", "small")
    yield module
    sys.modules.pop("running")


def test_pages_run_again_if_what_they_use_has_changed(running, tmp_path, monkeypatch):
    film = tmp_path / "tofrender/films/film.py"
    other = tmp_path / "tofrender/cli/app.py"
    data = tmp_path / "tofrender/films/data/table.csv"
    scene = tmp_path / "scenes/box.xml"
    for path in (film, other, data, scene):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("a = 1\n")
    running.RUNS.mkdir()
    for name in ("a.ipynb", "b.py"):
        (running.RUNS / f"{name}.txt").write_text(str(film))
        running.keep(name)

    def are_current() -> list[bool]:
        running.digest.cache_clear()
        return [running.is_current(name) for name in ("a.ipynb", "b.py", "c.py")]

    assert are_current() == [True, True, False]  # c.py has never run
    film.write_text('"""A film."""\na = 1  # Its bins\n')
    other.write_text("a = 2\n")
    assert are_current() == [True, True, False]
    for path in (film, data, scene):
        before = path.read_text()
        path.write_text("a = 2\n")
        assert are_current() == [False, False, False], path
        path.write_text(before)
    monkeypatch.setenv("TOFRENDER_NOTEBOOK_SIZE", "")
    assert are_current() == [False, True, False]  # Only notebooks have sizes
    film.unlink()
    assert are_current() == [False, False, False]


def test_jobs_that_fail_are_named(running, capsys):
    failed = running.run_jobs({"fine": (int, "1"), "wrong": (int, "one")}, 2)
    assert failed == ["wrong"]
    shown = capsys.readouterr()
    assert "docs: wrong failed: invalid literal" in shown.err
    assert "ran fine" in shown.out
    assert "of 2" in shown.out


def test_pages_with_python_are_found():
    names = {page.stem for page in WITH_PYTHON}
    assert {"index", "researcher", "conventions", "how_it_works", "datasets"} <= names


@pytest.mark.parametrize("page", [*WITH_PYTHON, *EXAMPLES], ids=lambda page: page.stem)
def test_python_of_a_page_runs(page, tmp_path, monkeypatch):
    """From top to bottom in one file, as a reader would type it; pages of the gallery are files."""
    monkeypatch.setenv("MPLBACKEND", "agg")
    text = page.read_text(encoding="utf-8")
    is_page = page.suffix == ".md"
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL) if is_page else [text]
    program = tmp_path / "page.py"
    program.write_text("\n".join(blocks), encoding="utf-8")
    command = [sys.executable, "-W", "error", str(program)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_the_table_of_packages_is_the_import_contract(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "docs/_ext")
    packages = importlib.import_module("packages")
    page = packages.PAGE.read_text(encoding="utf-8")
    assert packages.with_table(page) == page

    # Rows in another order are sorted, and a missing row is an error
    rows = packages.TABLE.search(page)[2].splitlines(keepends=True)
    assert packages.with_table(page.replace("".join(rows), "".join(rows[::-1]))) == page
    with pytest.raises(ValueError, match="labels"):
        packages.with_table(page.replace(next(row for row in rows if "labels" in row), ""))


def test_signatures_show_no_descriptions_of_datasets(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "docs/_ext")
    names = importlib.import_module("names")
    shown = "(a: ~typing.Annotated[xr.Dataset, Kind(axes=('y', 'x'), real=())], *, b: int = 2)"
    assert names._without_annotations(shown) == "(a: xr.Dataset, *, b: int = 2)"
    nested = "(a: Annotated[dict[str, Annotated[int, 1]], 'x'], b)"
    assert names._without_annotations(nested) == "(a: dict[str, int], b)"


def doors() -> dict[str, str]:
    """Return the example of each section of the page "For your field"."""
    sections = re.findall(r"^## (.*?)\n(.*?)(?=^## |\Z)", DOORS.read_text("utf-8"), re.M | re.S)
    found = {}
    for title, text in sections:
        (found[title],) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    return found


@pytest.mark.parametrize("title", doors())
def test_each_door_has_a_short_complete_example(title, tmp_path, monkeypatch, capsys):
    """Each example runs by itself, prints its result, and may not warn."""
    example = doors()[title]
    assert len(example.splitlines()) <= 15
    monkeypatch.chdir(tmp_path)
    exec(compile(example, title, "exec"), {})
    said = capsys.readouterr().out
    expected = {
        "Teach a course": "FAILED",
        "Render transients": "m of path",
        "Simulate a sensor": "the median depth is 3",
        "Reconstruct hidden scenes": "the letter is 1.00 m",
    }
    assert expected[title] in said
    assert len(doors()) == len(expected)


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CONTRIBUTING.md"], ids=lambda page: page.stem)
def test_files_that_a_page_names_exist(page):
    named = set(re.findall(r"`([\w./]+/[\w.]*)`", page.read_text(encoding="utf-8")))
    named -= {"package/", ".github/", ".devcontainer/"}  # What students get
    named -= {"build/docs/html", "out/cornell_box", "grades_results/"}  # What is made
    named -= {"pages/overview.html", "pages/students/", "pages/students/ID/feedback.html"}
    named -= {"CLASSROOM/autograders/ASSIGNMENT/"}  # A folder of teachers
    places = (
        "",
        "tofrender",
        "tofrender/course",
        "tofrender/nlos",
        "assignments/a2_time_of_flight",
    )
    assert not [name for name in named if not any((ROOT / p / name).exists() for p in places)]


@pytest.mark.parametrize("page", [*PAGES, ROOT / "README.md"], ids=lambda page: page.stem)
def test_numbers_of_a_page_have_a_digit_before_the_point(page):
    """Write 0.05, not .05, outside of code."""
    text = re.sub(r"```.*?```", "", page.read_text("utf-8"), flags=re.DOTALL)
    assert re.findall(r"(?<![\w.`\])/])\.\d+(?![\w`])", text) == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_of_a_page_lead_to_files(page):
    """As GitHub follows them; what they lead to on the site is looked at when it is built."""
    for target in re.findall(r"\]\(([^()#\s]+)[^)\s]*\)", page.read_text("utf-8")):
        assert ":" in target or (page.parent / target).exists(), target


def test_links_are_those_of_the_site(build, tmp_path):
    known = {"docs/a.md": tmp_path / "a.md", "notebooks/b.ipynb": tmp_path / "notebooks/b.ipynb"}

    def relinked(text: str, path: str = "docs/a.md") -> str:
        return build.relinked(text, path, known)

    assert relinked("see [b](../notebooks/b.ipynb)") == "see [b](notebooks/b.ipynb)"
    assert relinked('"[`a`](../docs/a.md#x)"', "notebooks/b.ipynb") == '"[`a`](../a.md#x)"'
    assert relinked("[code](../tofrender/paths/walk.py), [x](#x)") == "code, [x](#x)"
    web = "[Mitsuba](https://mitsuba.readthedocs.io) ![picture](none.png)"
    assert relinked(web) == web


def test_dead_links_and_what_is_loaded_from_elsewhere_are_found(build, tmp_path, monkeypatch):
    monkeypatch.setattr(build, "HTML", tmp_path)
    page = '<a href="{}">x</a><h1 id="there"></h1><script src="{}"></script>'
    good = page.format("b.html#there", "b.html") + '<a href="https://x.org">x</a>'
    (tmp_path / "a.html").write_text(good)
    (tmp_path / "b.html").write_text(page.format("#there", "a.html"))
    assert build.faults() == []
    (tmp_path / "b.html").write_text(page.format("c.html", "https://x.org/x.js"))
    (tmp_path / "c.css").write_text("@import 'https://x.org/font.css'")
    assert build.faults() == [
        "b.html: href c.html: no such file",
        "b.html: loads https://x.org/x.js",
        "c.css: loads https://x.org/font.css",
    ]
    (tmp_path / "b.html").write_text(page.format("a.html#where", "a.html"))
    assert build.faults()[0] == "b.html: href a.html#where: no such place on that page"


def test_pages_that_are_too_large_are_found(build, tmp_path, monkeypatch):
    monkeypatch.setattr(build, "HTML", tmp_path)
    (tmp_path / "picture.png").write_bytes(bytes(2_000_000))
    (tmp_path / "film.mp4").write_bytes(bytes(1_500_000))
    (tmp_path / "a.html").write_text('<img src="picture.png"><a href="film.mp4">film</a>')
    assert build.faults() == []
    (tmp_path / "b.html").write_text('<img src="picture.png"><video src="film.mp4"></video>')
    assert build.faults() == ["b.html: 3.5 MB, must be at most 3 MB"]

    # A frame that loads later does not count for the page, but has a limit of its own
    (tmp_path / "b.html").unlink()
    (tmp_path / "later.bin").write_bytes(bytes(2_500_000))
    (tmp_path / "c.html").write_text(
        '<img src="picture.png"><iframe loading="lazy" src="film.mp4"></iframe>'
    )
    assert build.faults() == []
    (tmp_path / "c.html").write_text('<iframe loading="lazy" src="later.bin"></iframe>')
    assert build.faults() == ["c.html: later.bin: 2.5 MB, must be at most 2 MB"]


def listed() -> list[str]:
    """All names of the API's pages, with the module that they are looked up in."""
    found = []
    for page in sorted(ROOT.glob("docs/api/*.md")):
        text = page.read_text(encoding="utf-8")
        for module, names in re.findall(r"```\{names\} (\S+)\n(.*?)```", text, re.DOTALL):
            found += [f"{module}.{name}" for name in names.split()]
    return found


def test_the_api_has_every_public_name_once():
    packages = re.findall(r"`(tofrender\.\w+)`", (ROOT / "docs/api/index.md").read_text("utf-8"))
    top = public_names("tofrender", tofrender.__file__)
    wanted = {f"tofrender.{name}" for name in top}
    for package in packages:
        module = importlib.import_module(package)
        if Path(module.__file__).with_suffix(".pyi").exists():
            names = set(public_names(package, module.__file__)) - set(top)
            wanted |= {f"{package}.{name}" for name in names}
    count = Counter(listed() + packages)
    assert wanted - set(count) == set()
    assert set(count) - wanted == set()
    assert max(count.values()) == 1, count.most_common(3)


def test_what_a_docstring_sends_to_is_public():
    names = public_names("tofrender", tofrender.__file__)
    sent = {}
    for name in names:
        text = inspect.getdoc(getattr(tofrender, name)) or ""
        for line in re.findall(r"See also (`.*?)\.(?:\s|$)", text, re.DOTALL):
            sent[name] = re.findall(r"`(\w+)`", line)
    assert len(sent) >= 20
    assert not {name: t for name, t in sent.items() if name in t or not set(t) <= set(names)}
    for one, other in (("save_npz", "load_npz"), ("explore", "report"), ("render", "load_scene")):
        assert other in sent[one]
        assert one in sent[other]


def test_the_api_has_every_command():
    from typer.main import get_command

    from tofrender.cli.app import app

    text = (ROOT / "docs/api/command.md").read_text(encoding="utf-8")
    names = re.search(r"```\{commands\}\n(.*?)```", text, re.DOTALL)[1].split()
    assert sorted(names) == sorted(get_command(app).commands)


@pytest.mark.skipif(not (SITE / "index.html").exists(), reason=NO_SITE)
@pytest.mark.parametrize(("dark", "width"), [(False, 390), (True, 1360)], ids=["phone", "dark"])
def test_the_site_is_read_without_a_network(dark, width):
    names = ["index", "gallery/index", "api/plugins", "conventions", "notebooks", "guides/student"]
    names += [f"notebooks/{page.stem}" for page in sorted(SITE.glob("notebooks/*.html"))[1:3]]
    with browser.page(dark=dark, offline=True, viewport={"width": width, "height": 800}) as page:
        elsewhere, own = [], ("file:", "data:", "blob:")
        page.on("request", lambda r: r.url.startswith(own) or elsewhere.append(r.url))
        for name in names:
            page.goto((SITE / f"{name}.html").as_uri())
            page.wait_for_load_state()
            theme = page.evaluate("document.documentElement.dataset.theme")
            assert theme == ("dark" if dark else "light")
            broken = "[...document.images].filter(i => i.complete && !i.naturalWidth)"
            assert page.evaluate(f"{broken}.map(i => i.src)") == []
            assert page.evaluate("document.documentElement.scrollWidth") <= width, name
        page.goto((SITE / "index.html").as_uri())
        page.wait_for_function("document.querySelector('video').currentTime > 0.2")
        assert elsewhere == []
        assert page.errors == []


@pytest.mark.skipif(not (SITE / "index.html").exists(), reason=NO_SITE)
def test_the_site_is_searched_without_a_network():
    """What is looked for is among the first three pages, or the first five of the second table."""
    sought = {
        "caustic": "plot_07_caustic.html",
        "light_samples": "faq.html",
        "compare two renders": "faq.html",
        "limits of the sensor": "limits.html",
        "no light in my window": "faq.html",
        "unambiguous range": "glossary.html",
        "without root": "install.html",
        "Colab": "install.html",
        "macOS": "install.html",
        "cite": "cite.html",
    }
    widely = {
        "dead time": "glossary.html#dead-time",
        "NumPy array": "faq.html#getting-a-numpy-array",
        "lidar": "glossary.html#lidar",
        "multipath": "glossary.html#multipath",
        "GPU": "install.html#gpu",
    }
    with browser.page(offline=True) as page:
        for words, target in (sought | widely).items():
            query = words.replace(" ", "+")
            page.goto((SITE / "search.html").as_uri() + f"?q={query}")
            page.wait_for_selector("#search-results a")
            page.wait_for_function("!document.querySelector('#search-progress')?.textContent")
            links = page.locator("#search-results li > a, #search-results li > span a")
            first = [
                link.get_attribute("href") for link in links.all()[: 5 if words in widely else 3]
            ]
            assert any(target in link for link in first), (words, first)


@pytest.mark.skipif(not (SITE / "index.html").exists(), reason=NO_SITE)
@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize(
    "name",
    [
        *("index", "gallery/index", "gallery/plot_06_depth", "faq", "glossary", "limits"),
        *("api/vis", "api/rendering", "api/command", "guides/teacher", "guides/teacher_grade"),
    ],
)
def test_nothing_hinders_readers_of_the_site(name, dark):
    with browser.page(dark=dark, offline=True, reduced_motion="reduce") as page:
        page.goto((SITE / f"{name}.html").as_uri())
        page.wait_for_load_state()
        assert hindrances(page) == []


@pytest.mark.skipif(not (SITE / "index.html").exists(), reason=NO_SITE)
def test_the_film_rests_for_readers_who_want_no_motion():
    with browser.page(offline=True, reduced_motion="reduce") as page:
        page.goto((SITE / "index.html").as_uri())
        page.wait_for_function("document.querySelector('video').readyState > 2")
        assert page.evaluate("document.querySelector('video').paused")


@pytest.mark.skipif(not (SITE / "index.html").exists(), reason=NO_SITE)
def test_the_landing_page_has_an_explorer():
    assert (SITE / "_static/made/landing.html").stat().st_size < 1.6e6
    with browser.page(offline=True, viewport={"width": 1360, "height": 800}) as page:
        page.goto((SITE / "index.html").as_uri())
        frame = page.locator("iframe.touch")
        frame.scroll_into_view_if_needed()
        assert "Cornell box" in frame.get_attribute("title")
        inside = page.frame_locator("iframe.touch")
        inside.locator("canvas.plot").first.wait_for()
        assert "96 × 96 pixels" in inside.locator("body").inner_text()
        assert "–" not in inside.locator("table").first.inner_text()  # No blocks of pixels
        assert page.errors == []
