"""`make release-check`: what must be in a release, what must not, and one version everywhere."""

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

import tofrender

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def release():
    spec = importlib.util.spec_from_file_location("release", ROOT / ".ci/release.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def built(release, tmp_path_factory):
    """Names in wheel and source archive of the files as they are, and both files."""
    pytest.importorskip("hatchling")
    folder = tmp_path_factory.mktemp("built")
    environment = os.environ | {"SOURCE_DATE_EPOCH": "1700000000"}
    command = [sys.executable, "-m", "hatchling", "build", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, env=environment, check=True, capture_output=True)
    wheel, archive = sorted(folder.iterdir(), key=lambda path: path.suffix != ".whl")
    return release.names_in(wheel), release.names_in(archive), wheel, archive


def test_archives_have_what_they_must(release, built):
    wheel, archive, *files = built
    release.check_contents(wheel, archive)
    release.check_texts(*files)
    assert {"docs/datasets/boxes.toml", "CITATION.cff", ".zenodo.json", "SECURITY.md"} <= archive
    assert "tofrender/datasets/examples/boxes.toml" in wheel


@pytest.mark.parametrize(
    ("where", "name"),
    [
        (0, "tofrender/datasets/examples/boxes.toml"),
        (0, "tofrender/scenes/xml/cornell_box.xml"),
        (0, f"tofrender-{tofrender.__version__}.dist-info/licenses/LICENSE"),
        (1, "CITATION.cff"),
        (1, "docs/pictures/first_film.webp"),
    ],
)
def test_missing_files_are_found(release, built, where, name):
    names = [set(each) for each in built[:2]]
    names[where].remove(name)
    with pytest.raises(release.Problem, match="missing: "):
        release.check_contents(*names)


@pytest.mark.parametrize(
    ("where", "name"), [(1, ".venv/bin/python"), (1, "notes.log"), (0, "tests/conftest.py")]
)
def test_what_is_private_is_found(release, built, where, name):
    names = [set(each) for each in built[:2]]
    names[where].add(name)
    with pytest.raises(release.Problem, match="must not be in it: "):
        release.check_contents(*names)


def test_names_of_this_machine_are_found(release, tmp_path):
    import zipfile

    with zipfile.ZipFile(tmp_path / "a.whl", "w") as file:
        file.writestr("a.py", f"PATH = '{Path.home()}/data'")
    with pytest.raises(release.Problem, match=r"a\.py has .*, which is of this machine"):
        release.check_texts(tmp_path / "a.whl")


def test_builds_that_differ_are_found(release, tmp_path):
    for folder, content in (("a", "1"), ("b", "1"), ("c", "2")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "x.whl").write_text(content)
    a, b, c = ([tmp_path / folder / "x.whl"] for folder in "abc")
    release.require_equal(a, b)
    with pytest.raises(release.Problem, match=r"two builds of x\.whl differ"):
        release.require_equal(a, c)
    with pytest.raises(release.Problem, match="two builds made"):
        release.require_equal(a, [])


@pytest.mark.parametrize("name", ["CITATION.cff", ".zenodo.json", "docs/cite.md"])
def test_one_version(release, tmp_path, name):
    files = ("CITATION.cff", ".zenodo.json", "docs/cite.md", "CHANGELOG.md")
    for each in (*files, "tofrender/__init__.py"):
        (tmp_path / each).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / each, tmp_path / each)
    assert release.check_versions(tmp_path) == tofrender.__version__
    text = (tmp_path / name).read_text("utf-8")
    (tmp_path / name).write_text(text.replace(tofrender.__version__, "9.9.9"), "utf-8")
    with pytest.raises(release.Problem, match="is not that of"):
        release.check_versions(tmp_path)


def test_citation_and_workflow_are_complete():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert {"cff-version", "message", "title", "authors", "version", "license"} <= set(citation)
    workflow = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text("utf-8"))
    steps = [step.get("run", "") for step in workflow["jobs"]["check"]["steps"]]
    assert ".ci/run" in steps
    assert "make docs-full" in steps


def test_a_tag_is_published_by_a_reviewer_without_a_stored_secret():
    text = (ROOT / ".github/workflows/release.yml").read_text("utf-8")
    assert "secrets." not in text
    jobs = yaml.safe_load(text)["jobs"]
    commands = [step.get("run", "") for step in jobs["build"]["steps"]]
    assert "make release-check" in commands
    publish = jobs["publish"]
    assert publish["needs"] == "build"
    assert publish["environment"] == "release"
    assert publish["permissions"] == {"id-token": "write"}
    assert not any("run" in step for step in publish["steps"])  # Only files that were checked
    assert "id-token" not in jobs["build"].get("permissions", {})


def test_commands_of_the_readme_are_known(release):
    commands = release.commands_of((ROOT / "README.md").read_text("utf-8"))
    assert len(commands) > 10
    known = {name for names in tofrender_groups().values() for name in names}
    assert {command[1] for command in commands} <= known


def tofrender_groups() -> dict[str, tuple[str, ...]]:
    from tofrender.cli.app import GROUPS

    return GROUPS


def test_a_command_that_fails_without_a_word_is_found(release, tmp_path):
    program = tmp_path / "venv/bin/tofrender"
    program.parent.mkdir(parents=True)
    (tmp_path / "work").mkdir()
    for line, extras, good in (
        ("exit 0", False, True),
        ("echo \"run: pip install 'tofrender[cluster]'\"; exit 2", False, True),
        ("echo \"run: pip install 'tofrender[cluster]'\"; exit 2", True, False),
        ("echo 'error: no'; exit 2", False, False),
    ):
        program.write_text(f"#!/bin/sh\n{line}\n")
        program.chmod(0o755)
        if good:
            release.outcome(tmp_path, ["tofrender", "dataset"], extras)
        else:
            with pytest.raises(release.Problem, match="ended with status 2"):
                release.outcome(tmp_path, ["tofrender", "dataset"], extras)


def test_a_command_that_warns_is_found(release, tmp_path):
    program = tmp_path / "venv/bin/tofrender"
    program.parent.mkdir(parents=True)
    (tmp_path / "work").mkdir()
    program.write_text("#!/bin/sh\necho 'warning: 2 % of the energy is lost'\n")
    program.chmod(0o755)
    with pytest.raises(release.Problem, match="warns: warning: 2 %"):
        release.outcome(tmp_path, ["tofrender", "scenes"], False)
