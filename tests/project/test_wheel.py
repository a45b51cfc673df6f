"""The wheel in an environment of its own: every main command, from an empty folder.

Its dependencies are links to those of this environment, so that nothing is fetched; what only the
extras need is not there.
"""

import json
import os
import subprocess
import sys
import venv
import zipfile
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
SMALL = ["--size", "6x5", "--spp", "1", "--no-video"]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    pytest.importorskip("hatchling")
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "-q"]
    subprocess.run([*command, "-w", str(folder), str(ROOT)], check=True)
    (made,) = folder.glob("*.whl")
    return made


@pytest.fixture(scope="module")
def home(wheel, tmp_path_factory):
    """An environment with the wheel, and an empty folder to work in."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder / "venv", symlinks=True)
    python = folder / "venv" / "bin" / "python"
    where = [sys.executable, "-m", "pip", "--python", str(python), "install", "-q", "--no-deps"]
    subprocess.run([*where, "--no-index", str(wheel)], check=True)
    ask = "import sysconfig; print(sysconfig.get_path('purelib'))"
    packages = subprocess.run([python, "-c", ask], check=True, capture_output=True, text=True)
    place = Path(packages.stdout.strip())
    for each in dependencies():
        (place / each.name).symlink_to(each)
    (folder / "work").mkdir()
    return folder


def dependencies() -> set[Path]:
    """Files and folders of all that the package depends on, without its extras."""
    found, left = {"tofrender"}, ["tofrender"]
    while left:
        asked = map(Requirement, metadata.requires(left.pop()) or [])
        needed = [each for each in asked if not each.marker or each.marker.evaluate({"extra": ""})]
        new = {canonicalize_name(each.name) for each in needed} - found
        found |= new
        left += new
    tops = set()
    for name in found - {"tofrender"}:
        for file in metadata.files(name) or []:
            if file.parts[0] not in ("..", "__pycache__"):
                tops.add(Path(str(metadata.distribution(name).locate_file(file.parts[0]))))
    return tops


def call(home: Path, *arguments: str) -> str:
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "PYTEST"))}
    command = [str(home / "venv" / "bin" / arguments[0]), *arguments[1:]]
    work = home / "work"
    done = subprocess.run(command, cwd=work, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_wheel_has_scenes_and_nothing_of_tests(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert {"tofrender/py.typed", "tofrender/scenes/xml/meshes/bunny.ply"} <= set(names)
    files = {path.relative_to(ROOT / "scenes") for path in (ROOT / "scenes").rglob("*.xml")}
    packed = {f"tofrender/scenes/xml/{path.as_posix()}" for path in files}
    assert packed <= set(names)
    beside = {p for p in (ROOT / "tofrender").rglob("*") if p.is_file() and p.suffix != ".pyc"}
    assert {path.relative_to(ROOT).as_posix() for path in beside} <= set(names)
    tops = {name.partition("/")[0] for name in names} - {"tofrender"}
    assert len(tops) == 1  # about the package


def test_every_main_command(home):
    work = home / "work"
    place = call(home, "python", "-c", "import tofrender; print(tofrender.__file__)").strip()
    assert Path(place).is_relative_to(home / "venv")

    def tofrender(*arguments: str) -> str:
        return call(home, "tofrender", *arguments)

    assert tofrender("--version").startswith("tofrender ")
    assert "cornell_box_glass" in tofrender("scenes")
    assert json.loads(tofrender("doctor", "--json"))["works"]
    for seed in ("0", "1"):
        tofrender("render", "cornell_box", *SMALL, "--seed", seed, "--out", f"box{seed}")
    assert (work / "box0" / "summary.png").exists()
    tofrender("merge", "box0", "box1", "--no-video", "--out", "both")
    tofrender("render", "bust_ao", *SMALL, "--bins", "9", "--window", "auto", "--out", "bust")
    tofrender("render", "scenes/nlos/nlos_bunny.xml", *SMALL, "--out", "bunny")
    tofrender("phasor", "box0", "--freq", "2e7", "--out", "phasor")
    tofrender("sense", "box0", "--sensor", "itof", "--out", "taps")
    tofrender("gate", "cornell_box", "--size", "6x5", "--spp", "1", "--at", "6", "--out", "gate")
    tofrender("capture", "nlos-z", "--grid", "3x3", "--spp", "1", "--out", "z.h5")
    tofrender("reconstruct", "z.h5", "--method", "lct", "--out", "z")
    tofrender("warp", "tent", "--count", "16", "--out", "tent.png")
    found = {path.name for path in work.iterdir()}
    assert {"both", "bust", "bunny", "phasor", "gate", "z", "tent.png"} <= found


def test_what_is_an_extra_says_so(home):
    code = "import tofrender; tofrender.load_zarr('.')"
    with pytest.raises(AssertionError, match=r"pip install 'tofrender\[cluster\]'"):
        call(home, "python", "-c", code)
