"""The README: its order, and its blocks, which run in order in a fresh clone without a warning.

The clone gets a small stand-in for `.venv`, because a test cannot download packages. Its
`tofrender` and its `python -m pytest` add options that make the README's commands small.
"""

import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
ONE_TEST = "tests/project/test_questions.py -k clicks_are_counted -p no:xdist"


class Step(NamedTuple):
    """One command of a shell block, or one whole Python block."""

    language: str
    text: str


def steps(page: str) -> list[Step]:
    """Return the steps of a page in order; a shell block has one step for each line."""
    found = []
    for language, block in re.findall(r"```(sh|python)\n(.*?)```", page, re.DOTALL):
        texts = block.splitlines() if language == "sh" else [block]
        found += [Step(language, text) for text in texts if text.strip()]
    return found


STEPS = steps(README)


def small_options() -> dict[str, str]:
    """Return the options that make a command of the README small, as `make release-check` does."""
    spec = importlib.util.spec_from_file_location("release", ROOT / ".ci/release.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.SMALL


def environment_of_a_user() -> dict[str, str]:
    """Return the environment without what `make test` and pytest add for the processes they start.

    `make test ARGS=...` would pass its ARGS on to `make render`.
    """
    added = re.compile("PY|MAKE|MFLAGS$|ARGS$|OUT$|SHARD$")
    return {name: text for name, text in os.environ.items() if not added.match(name)}


class Clone:
    """A folder in which the steps of the README run one after another."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.here = folder
        self.prelude: list[str] = []
        self.outputs: list[str] = []

    def run_next(self) -> str:
        """Run the next step, and return what it prints."""
        step = STEPS[len(self.outputs)]
        script = step.text.replace("ADDRESS", str(ROOT))
        if step.language == "python":
            (self.folder / "block.py").write_text(script, encoding="utf-8")
            script = f"python {shlex.quote(str(self.folder / 'block.py'))}"
        done = subprocess.run(
            ["sh", "-e", "-c", "\n".join([*self.prelude, script])],
            cwd=self.folder,
            env=environment_of_a_user(),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        assert done.returncode == 0, f"{step.text}\n{done.stdout}"
        self.outputs.append(done.stdout)

        # What later steps find: the folder, and the active environment
        if re.match(r"cd |\. ", step.text):
            self.prelude.append(script)
        if step.text.startswith("cd "):
            self.here = self.folder / step.text.split()[1]
            self.make_environment()
        return done.stdout

    def make_environment(self) -> None:
        """Put a stand-in for what `make render` and `make test` would install into the clone."""
        binaries = self.here / ".venv/bin"
        binaries.mkdir(parents=True)
        paths = f"{self.here}:{self.here / 'tests'}"
        run = f'PYTHONPATH="{paths}" exec "{sys.executable}" -W error'
        cases = [
            f'  {name}) shift; set -- {name} "$@" {options} ;;'
            for name, options in small_options().items()
        ]
        scripts = {
            "activate": f'PATH="{binaries}:$PATH"\n',
            "python": f'[ "$2" = pytest ] && set -- -m pytest -q {ONE_TEST}\n{run} "$@"\n',
            "tofrender": "\n".join(
                [
                    'case "$*" in *--help*) ;; *) case $1 in',
                    *cases,
                    "esac ;; esac",
                    f'{run.replace("-W error", "-W error::UserWarning")} -m tofrender "$@"\n',
                ]
            ),
        }
        for name, text in scripts.items():
            (binaries / name).write_text(f"#!/bin/sh\n{text}")
            (binaries / name).chmod(0o755)

        # The stamp by which `.ci/setup` knows that nothing is missing
        pins = ".ci/requirements.txt"
        command = f'(pwd -P; cat pyproject.toml "{pins}" .ci/setup) | cksum'
        stamp = subprocess.check_output(["sh", "-c", command], cwd=self.here, text=True)
        (self.here / ".venv/stamp").write_text(f"all {stamp}")


@pytest.fixture(scope="module")
def clone(tmp_path_factory) -> Clone:
    if not (ROOT / ".git").exists() or not shutil.which("git"):
        pytest.skip("this is no clone, or git is not installed")
    return Clone(tmp_path_factory.mktemp("readme"))


def name_of(number: int) -> str:
    """Return a short name of a step."""
    return re.sub(r"\W+", "_", STEPS[number].text[:30]).strip("_")


@pytest.mark.parametrize("number", range(len(STEPS)), ids=name_of)
def test_blocks_of_the_readme_run_in_order_without_warnings(clone, number):
    while len(clone.outputs) <= number:
        clone.run_next()
    said = clone.outputs[number]
    assert "warning" not in said.lower(), said
    if STEPS[number].text.startswith("make render"):
        made = {path.name for path in (clone.here / "out/cornell_box").iterdir()}
        assert {"frame_0299.exr", "steady.exr", "summary.png"} <= made


def test_the_readme_has_its_order():
    """What it is, pictures, a clone, a render, the environment, Python, the tests, commands."""
    order = [
        "first_film.webp",
        "explorer.png",
        "hidden.png",
        "caustics.png",
        "git clone",
        "make render\n",
        ". .venv/bin/activate",
        "```python",
        "make test\n",
        "tofrender scenes",
    ]
    places = [README.index(words) for words in order]
    assert places == sorted(places)


def test_every_command_of_the_readme_that_renders_is_made_small():
    options = small_options()
    for step in STEPS:
        words = shlex.split(step.text, comments=True) if step.language == "sh" else []
        if words[:1] == ["tofrender"] and words[1] in ("render", "phasor", "gate", "capture"):
            assert words[1] in options
    assert "--spp" in options["render"]
