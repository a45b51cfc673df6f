"""Twenty-four questions of a new user: each is answered at most two clicks from the first page."""

import re
from pathlib import Path

import pytest
from helpers import browser

ROOT = Path(__file__).parents[2]
HTML = ROOT / "build/docs/html"
SITE = {  # Pages that the site has from elsewhere, see `docs/build.py`
    "assignments/README.md": "guides/teacher",
    "scenes/README.md": "scenes/README",
}
QUESTIONS = {
    "How do I install it on macOS?": ("install", "brew install llvm"),
    "And on Windows?": ("install", "wsl --install"),
    "And without root?": ("install", "Any of these is enough"),
    "On Debian?": ("install", "python3-venv"),
    "In Colab?": ("install", "upload the wheel|Upload the wheel"),
    "Does it use my GPU?": ("install", "Linux with an NVIDIA GPU"),
    "Which Python do I need?": ("versions", r"3\.11, 3\.12, 3\.13"),
    "How do I cite it?": ("cite", "@software"),
    "May I use it at work?": ("license", "BSD-3-Clause"),
    "Why is there no light?": ("faq", "no light in my window"),
    "How do I compare two renders?": ("faq", "compare two renders"),
    "What is light_samples?": ("faq", "What does `light_samples` do"),
    "How do I get less noise?": ("faq", "How do I get less noise"),
    "How much memory does it need?": ("faq", "How much memory"),
    "Can I go on after a crash?": ("checkpoints", "--resume"),
    "How do I change bins later?": ("faq", "rebin"),
    "Where is a bug reported?": ("faq", "Something is wrong"),
    "What is a transient?": ("glossary", "### Transient"),
    "How do I render my own scene?": ("guides/researcher", "our own scene"),
    "I know mitransient; what differs?": ("coming_from_mitransient", "mitransient 1.3.1"),
    "How do I make training data?": ("datasets", "records"),
    "How do I hand in?": ("guides/student", "tofrender submit"),
    "How do I grade a class?": ("guides/teacher_grade", "tofrender grade"),
    "What has changed?": ("changelog", "## 0.1.0"),
}


def source(page: str) -> Path:
    """The file that a page of the site is made of."""
    tops = {"changelog": "CHANGELOG", "contributing": "CONTRIBUTING", "security": "SECURITY"}
    elsewhere = {name: path for path, name in SITE.items()}
    if page in elsewhere or page in tops:
        return ROOT / elsewhere.get(page, f"{tops.get(page)}.md")
    return ROOT / f"docs/{page}.md"


def links(page: str) -> set[str]:
    """Pages that a page links to: in its text, its list of pages, and the bar above every page."""
    file = source(page)
    text = file.read_text("utf-8")
    found = set()
    for target in re.findall(r"\]\(([^():#\s]+\.md)", text):
        path = (file.parent / target).resolve().relative_to(ROOT).as_posix()
        top = path.removesuffix(".md").lower()
        found.add(SITE.get(path, path.removeprefix("docs/").removesuffix(".md")))
        if "/" not in path:
            found.add(top)
    for block in (*contents(text), *contents((ROOT / "docs/index.md").read_text("utf-8"))):
        found |= {re.sub(r".*<(.*)>", r"\1", line) for line in block.split("\n") if line}
    return {each for each in found if source(each).is_file()}


def contents(text: str) -> list[str]:
    """The lists of pages in a page."""
    return re.findall(r"```\{toctree\}\n(?::\w+:\n)*\n(.*?)```", text, re.DOTALL)


@pytest.fixture(scope="module")
def near():
    """Pages by the clicks that lead to them."""
    clicks = {"index": 0}
    for number in (1, 2):
        for page in [page for page, count in clicks.items() if count == number - 1]:
            clicks |= dict.fromkeys(links(page) - clicks.keys(), number)
    return clicks


@pytest.mark.parametrize("question", QUESTIONS)
def test_answers_are_two_clicks_away(near, question):
    page, words = QUESTIONS[question]
    assert page in near
    assert re.search(words, source(page).read_text("utf-8"))


def test_clicks_are_counted(near):
    assert near["faq"] == 1
    assert near["contributing"] == 2
    assert len(QUESTIONS) >= 20


@pytest.mark.skipif(not (HTML / "index.html").exists(), reason="no site; run: make docs")
def test_answers_are_two_clicks_away_on_the_built_site():
    """By links that a reader sees, none of them in a menu that is opened first."""
    seen = "a => a.checkVisibility({visibilityProperty: true, opacityProperty: true})"
    address = "a => a.href.split('#')[0]"
    with browser.page(offline=True, viewport={"width": 1360, "height": 800}) as page:

        def at(name: str) -> str:
            return (HTML / f"{name}.html").as_uri()

        def shown(url: str) -> list[str]:
            page.goto(url)
            found = page.locator("a[href]").evaluate_all(f"x => x.filter({seen}).map({address})")
            return [each for each in dict.fromkeys(found) if each.startswith(HTML.as_uri())]

        def click(url: str) -> None:
            one = page.evaluate_handle(
                f"u => [...document.links].find(a => ({seen})(a) && ({address})(a) === u)", url
            )
            with page.expect_navigation(url=re.compile(re.escape(url))):
                one.as_element().click()

        first = shown(at("index"))
        second = {url: shown(url) for url in first if url.endswith(".html")}

        def text(name: str) -> str:
            """Of a page, found by clicks from the first one; empty if two do not lead to it."""
            between = next((url for url in second if at(name) in second[url]), None)
            if at(name) not in first and between is None:
                return ""
            page.goto(at("index"))
            if at(name) not in first:
                click(between)
            click(at(name))
            return page.locator("main").inner_text()

        texts = {name: text(name) for name in {name for name, _ in QUESTIONS.values()}}
    answers = {q: (re.sub("#+ |`", "", words), name) for q, (name, words) in QUESTIONS.items()}
    lost = [q for q, (words, name) in answers.items() if not re.search(words, texts[name])]
    assert lost == []
