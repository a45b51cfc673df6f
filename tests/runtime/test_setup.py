"""The set-up script, in a copy of the project whose Python, pip and apt only pretend."""

import json
import os
import re
import shutil
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
if os.name != "posix":
    pytest.skip("the set-up is a POSIX shell script", allow_module_level=True)

# A Python that makes an environment with itself in it, whose pip leaves the command behind.
FAKE_PYTHON = """#!/bin/sh
echo "python $*" >>"{calls}"
case "$*" in
  *ensurepip*) [ ! -e "{base}/no-venv" ] ;;
  "-m venv .venv") mkdir -p .venv/bin && cp "$0" .venv/bin/python ;;
  "-m pip --version") ;;
  "-m pip install"*" -r .venv/uv.txt")
    grep -q "^uv==" .venv/uv.txt && cp "{base}/bin/uv" .venv/bin/uv ;;
  "-m pip install"*)
    [ -e "{base}/pip-says" ] && cat "{base}/pip-says" && exit 1
    touch .venv/bin/tofrender ;;
  *llvm.py*) shift; exec "{python}" "{base}/llvm_here.py" "$@" ;;
  *) exec "{python}" "$@" ;;
esac
"""

# A uv that leaves the command behind, except where pip fails too.
FAKE_UV = """#!/bin/sh
echo "uv $*" >>"{calls}"
[ ! -e "{base}/pip-says" ] && [ ! -e "{base}/uv-fails" ] && touch .venv/bin/tofrender
"""

# tofrender/runtime/llvm.py on a machine of ours.
LLVM_HERE = """
import functools, os, pathlib, sys
sys.path.insert(0, "tofrender/runtime")
import llvm
llvm.System = functools.partial(
    llvm.System, root=pathlib.Path("{base}"), platform="linux", prefixes=(), euid={euid}
)
llvm.loading_error = lambda path: ""
sys.exit(llvm.main())
"""

# An apt-get that knows two packages, once it has an index: LLVM 19, and what makes venv work.
APT_GET = """#!/bin/sh
echo "$DEBIAN_FRONTEND apt-get $*" >>"{calls}"
[ -e "{base}/apt-fails" ] && echo E: no such luck && exit 100
case "$*" in
  update) cp "{base}/offers" "{base}/index" ;;
  *libllvm19) head -c 64 "{python}" >"{base}/usr/lib/x86_64-linux-gnu/libLLVM.so.19.1" ;;
  *-venv) rm "{base}/no-venv" ;;
esac
"""

APT_CACHE = """#!/bin/sh
case $1 in pkgnames) cat "{base}/index" ;; *) echo "  Candidate: 1:19.1.7" ;; esac
"""


class Project:
    """A copy of what the set-up reads, and a PATH of fakes."""

    def __init__(self, base: Path, *, root: bool):
        self.base, self.calls = base, base / "calls"
        self.folder = base / "my clone"
        copied = ".ci/setup .ci/requirements.txt .ci/strip_notebooks.py .gitattributes"
        for name in f"{copied} pyproject.toml tofrender/runtime/llvm.py".split():
            (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, self.folder / name)
        (base / "usr/lib/x86_64-linux-gnu").mkdir(parents=True)
        (base / "etc").mkdir()
        (base / "etc/os-release").write_text("ID=debian\n")
        self.bin = base / "bin"
        self.bin.mkdir()
        (base / "llvm_here.py").write_text(self.fill(LLVM_HERE, euid=0 if root else 1000))
        self.command("python3", FAKE_PYTHON)
        self.command("uv", FAKE_UV)
        self.command("apt-get", APT_GET)
        self.command("id", f"#!/bin/sh\necho {0 if root else 1000}\n")
        self.command("dpkg", "#!/bin/sh\n")
        self.command("apt-cache", APT_CACHE)
        for name in ("index", "offers"):
            (base / name).write_text("libllvm14\nlibllvm19\n")

    def fill(self, text: str, **values: object) -> str:
        python = Path(sys.executable)
        return text.format(base=self.base, calls=self.calls, python=python, **values)

    def command(self, name: str, script: str) -> None:
        path = self.bin / name
        path.write_text(self.fill(script))
        path.chmod(0o755)

    def library(self, name: str) -> None:
        with open(sys.executable, "rb") as file:
            (self.base / "usr/lib/x86_64-linux-gnu" / name).write_bytes(file.read(64))

    def start(self, wanted: str = "all", **environ: str) -> subprocess.Popen:
        """Begin a run of the set-up."""
        environ = {"PATH": f"{self.bin}:/usr/bin:/bin", "TMPDIR": str(self.base), **environ}
        pipes: dict = dict.fromkeys(("stdout", "stderr"), subprocess.PIPE) | {"text": True}
        command = ["/bin/sh", str(self.folder / ".ci/setup"), wanted]
        return subprocess.Popen(command, env=environ, stdin=subprocess.DEVNULL, **pipes)

    def setup(self, wanted: str = "all", **environ: str) -> tuple[int, str, str]:
        """Status, stdout and stderr; `self.ran` then tells which fakes it called, in order."""
        self.calls.write_text("")
        process = self.start(wanted, **environ)
        out, err = process.communicate()
        self.ran = self.calls.read_text()
        return process.returncode, out, err

    def works(self, wanted: str = "all", **environ: str) -> str:
        """What a set-up says on stdout that comes to its end."""
        status, out, err = self.setup(wanted, **environ)
        assert status == 0, err
        return out

    def refuses(self, wanted: str = "all", **environ: str) -> str:
        """The one line of a set-up that fails, after its name."""
        status, _, err = self.setup(wanted, **environ)
        assert (status, err.count("\n"), err[:7]) == (1, 1, "setup: ")
        return err[7:-1]


@pytest.fixture
def user(tmp_path):
    """A user who has LLVM 19."""
    project = Project(tmp_path, root=False)
    project.library("libLLVM.so.19.1")
    return project


@pytest.fixture
def root(tmp_path):
    return Project(tmp_path, root=True)


def apt_calls(project: Project) -> list[str]:
    """The calls of apt-get, each after its DEBIAN_FRONTEND."""
    return [line for line in project.ran.splitlines() if "apt-get" in line]


needs_linux = pytest.mark.skipif(sys.platform != "linux", reason="apt-get is Debian's")
NVIDIA = Path("/proc/driver/nvidia/version").exists() or bool(shutil.which("nvidia-smi"))
needs_llvm = pytest.mark.skipif(
    sys.platform != "linux" or NVIDIA,
    reason="with an NVIDIA driver the set-up goes on without LLVM; apt-get is Debian's",
)


@needs_llvm
def test_without_root_and_llvm_one_line_before_anything_is_installed(tmp_path):
    user = Project(tmp_path, root=False)
    user.library("libLLVM-15.so.1")
    line = "no LLVM 17 or newer found, only 15; run: sudo apt-get install -y libllvm19"
    assert user.setup() == (1, "", f"setup: {line}\n")
    assert "pip" not in user.ran


@needs_llvm
@pytest.mark.parametrize("system", ["nvidia", "mac"])
def test_with_a_gpu_the_set_up_continues_and_names_the_test(tmp_path, system):
    user = Project(tmp_path, root=False)
    if system == "nvidia":
        user.command("nvidia-smi", "#!/bin/sh\n")
    else:
        user.command("uname", "#!/bin/sh\necho Darwin arm64\n")
    status, _, errors = user.setup()
    assert status == 0
    before, _, after = errors.partition(": no LLVM 17 or newer found; ")
    assert before == "setup: without LLVM, only a GPU can render (see .venv/bin/tofrender doctor)"
    assert after.startswith("run: ")
    assert "pip install" in user.ran


@needs_linux
@pytest.mark.parametrize("index", [None, ""])
def test_root_gets_the_package(root, index):
    root.library("libLLVM-15.so.1")
    if index is not None:
        (root.base / "index").write_text(index)
    said = [line.split()[0] for line in root.works().splitlines()]
    assert said == ["Installing", "Creating", "Installing"]
    *renewed, install = apt_calls(root)
    assert [each.split()[-1] for each in renewed] == ["update"] * (index == "")
    assert install.startswith("noninteractive apt-get install -y ")
    assert install.endswith(" libllvm19")


@needs_llvm
@pytest.mark.parametrize("index", ["", "libllvm14\n"])
def test_a_release_without_a_usable_package_is_told_of_another_archive(root, index):
    (root.base / "index").write_text(index)
    (root.base / "offers").write_text("libllvm14\n")
    command = "wget -qO- https://apt.llvm.org/llvm.sh | bash -s -- 19"
    assert root.setup() == (1, "", f"setup: no LLVM 17 or newer found; run: {command}\n")
    assert "install" not in root.ran


@needs_llvm
def test_a_failing_apt_names_log_and_command(root):
    (root.base / "apt-fails").touch()
    said = root.refuses()
    assert said.endswith("run: apt-get update && apt-get install -y libllvm19")
    log = Path(said.split("log: ")[1].split(")")[0])
    assert "no such luck" in log.read_text()
    install, update, again = apt_calls(root)
    assert install == again
    assert install.startswith("noninteractive apt-get install -y ")
    assert update.endswith(" update")


@needs_llvm
def test_what_the_environment_names_is_not_replaced(root):
    assert root.refuses(DRJIT_LIBLLVM_PATH="/nope") == (
        "DRJIT_LIBLLVM_PATH = '/nope' does not exist: must name the file of LLVM 17 or "
        "newer; unset it and run: apt-get install -y libllvm19"
    )
    assert apt_calls(root) == []


def test_the_second_run_does_nothing_but_install_new_pins(user):
    user.works()
    assert "-m pip install" in user.ran
    assert user.setup() == (0, "", "")
    assert "venv" not in user.ran
    assert "pip" not in user.ran
    with (user.folder / ".ci/requirements.txt").open("a") as file:
        file.write("another==1.0\n")
    user.works()
    assert "-m pip install" in user.ran
    assert "-m venv" not in user.ran


def installs(project: Project) -> list[str]:
    """The calls of uv and pip that install packages, except the one that installs uv."""
    calls = [line for line in project.ran.splitlines() if "pip install" in line]
    return [call for call in calls if ".venv/uv.txt" not in call]


def test_rendering_needs_fewer_packages_than_tests(user):
    user.works("render")
    (install,) = installs(user)
    assert install.startswith("uv ")
    assert "-e . --constraints .ci/requirements.txt" in install
    assert "--build-constraints .ci/requirements.txt" in install

    # The environment has what rendering needs, and lacks the rest.
    assert user.works("render") == ""
    user.works()
    everything, package = installs(user)
    assert "--require-hashes -r .ci/requirements.txt" in everything
    assert "--no-deps" in package

    # An environment for tests renders, too.
    assert user.works("render") == ""
    assert user.works() == ""


def test_a_set_with_another_name_is_refused(user):
    assert user.refuses("docs").startswith("docs is not a set of packages")
    assert user.ran == ""


@pytest.mark.parametrize("is_pinned", [True, False])  # Not in the edition of an assignment
def test_pip_installs_where_uv_does_not(user, is_pinned):
    (user.base / "uv-fails").touch()
    pins = user.folder / ".ci/requirements.txt"
    if not is_pinned:
        pins.write_text(re.sub(r"^uv==.*?\n(?=\w|\Z)", "", pins.read_text(), flags=re.M | re.S))
    user.works("render")
    tried = ["uv"] if is_pinned else []
    assert [call.split()[0] for call in installs(user)] == [*tried, "python", "python"]
    assert "--require-hashes -r .ci/requirements.txt" in installs(user)[-2]


@pytest.mark.parametrize("damage", ["moved", "interrupted", "no python", "folder only"])
def test_a_broken_environment_is_made_anew(user, damage):
    venv = user.folder / ".venv"
    if damage == "folder only":  # Killed between its folder and its Python
        venv.mkdir()
        (venv / "folder").write_text(f"{user.folder}\n")
    else:
        user.setup()
    (venv / "leftover").touch()
    if damage == "moved":
        user.folder = user.folder.rename(user.base / "elsewhere")
    elif damage == "interrupted":
        (venv / "stamp").unlink()
        (venv / "unfinished").touch()
    elif damage == "no python":
        (venv / "bin/python").unlink()
    user.works()
    assert "-m venv .venv" in user.ran
    assert not (user.folder / ".venv/leftover").exists()
    assert user.setup()[1] == ""


@pytest.mark.parametrize(
    ("pip_says", "reason"),
    [
        ("WARNING: NewConnectionError: refused\nERROR: No matching x", "cannot reach the package"),
        ("ERROR: Could not install: [Errno 28] No space left on device", "the disk is full"),
        ("ERROR: No matching distribution found for numpy==9", "No matching distribution"),
        (  # A build that fails; pip names no cause of its own
            "  x did not run\n      FileNotFoundError: Forced include not found: scenes/a1\n"
            "ERROR: Failed to build installable wheels",
            "FileNotFoundError: Forced include not found: scenes/a1",
        ),
        (  # Its own words of a package with another hash
            "ERROR: THESE PACKAGES DO NOT MATCH THE HASHES FROM THE REQUIREMENTS FILE. If you have",
            "a package is not the one of .ci/requirements.txt: its hash is another",
        ),
    ],
)
def test_pip_fails_in_one_line_and_the_next_run_goes_on(user, pip_says, reason):
    (user.base / "pip-says").write_text(f"{pip_says}\n")
    said = user.refuses()
    assert said.startswith(f"pip: {reason}")
    assert str(user.folder / ".venv/pip.log") in said
    (user.base / "pip-says").unlink()
    user.works()


VENV = f"python3.{sys.version_info.minor}-venv"


@needs_linux
def test_missing_venv_module(user):
    (user.base / "no-venv").touch()
    said = user.refuses()
    assert said == f"this Python has no venv; run: sudo apt-get install -y {VENV}"


@pytest.mark.skipif(not Path("/etc/debian_version").exists(), reason="apt-get is Debian's")
def test_root_gets_the_venv_module(root):
    root.library("libLLVM.so.19.1")
    (root.base / "no-venv").touch()
    root.works()
    assert f"-o DPkg::Lock::Timeout=120 {VENV}\n" in root.ran


def test_python_that_is_too_old_is_refused(user):
    user.command("python3.10", "#!/bin/sh\nexit 1\n")
    said = user.refuses(PYTHON="python3.10")
    assert said == "PYTHON = 'python3.10': must be Python 3.11 or newer"


def test_somebodys_own_environment_is_used(user):
    user.command("venv-python", FAKE_PYTHON)
    (user.folder / ".venv/bin").mkdir(parents=True)
    shutil.copy(user.bin / "venv-python", user.folder / ".venv/bin/python")
    (user.folder / ".venv/mine").write_text("mine")
    user.works()
    assert "-m pip install" in user.ran
    assert "-m venv" not in user.ran
    assert (user.folder / ".venv/mine").read_text() == "mine"
    assert (user.setup()[1], user.ran.count("pip")) == ("", 0)


@pytest.mark.parametrize("kind", ["empty", "old python", "no pip", "a file", "a link astray"])
def test_somebodys_own_environment_that_does_not_work_stays(user, kind):
    venv = user.folder / ".venv"
    if kind == "a file":
        venv.write_text("mine")
    elif kind == "a link astray":
        venv.symlink_to(user.base / "nowhere")
    else:
        (venv / "bin").mkdir(parents=True)
        (venv / "mine").write_text("mine")
    if kind in ("old python", "no pip"):
        refuse = "*version_info*" if kind == "old python" else "*pip*"
        script = f'#!/bin/sh\ncase "$*" in {refuse}) exit 1 ;; esac\n'
        (venv / "bin/python").write_text(script)
        (venv / "bin/python").chmod(0o755)
    assert user.refuses() == (
        f"{venv} was not made here and has no Python 3.11 or newer with pip; move it away"
    )
    assert "pip install" not in user.ran
    assert (venv / "mine").exists() or venv.is_symlink() or venv.is_file()


def without_flock(project: Project) -> str:
    """A PATH of everything else."""
    tools = project.base / "tools"
    tools.mkdir()
    for folder in ("/usr/bin", "/bin"):
        for tool in Path(folder).iterdir():
            if tool.name != "flock" and not (tools / tool.name).exists():
                (tools / tool.name).symlink_to(tool)
    return f"{project.bin}:{tools}"


@pytest.mark.parametrize("flock", [True, False])
def test_two_at_once_install_once(user, flock):
    waits = 'while [ ! -e "{base}/go" ]; do sleep 0.1; done; touch .venv/bin'
    user.command("uv", FAKE_UV.replace("touch .venv/bin", waits))
    path = f"{user.bin}:/usr/bin:/bin" if flock else without_flock(user)
    user.calls.write_text("")
    first = user.start(PATH=path)
    while "uv pip install" not in user.calls.read_text() and first.poll() is None:
        time.sleep(0.01)
    second = user.start(PATH=path)
    assert "Waiting for another set-up" in second.stdout.readline()
    (user.base / "go").touch()
    said = [each.communicate() for each in (first, second)]
    assert (first.returncode, second.returncode) == (0, 0), said
    assert user.calls.read_text().count("uv pip install") == 2  # The packages, then this one
    assert "Waiting" not in said[0][0]
    assert not (user.folder / ".setup-lock.d").exists()


def test_a_lock_whose_holder_was_killed_is_taken(user):
    (user.folder / ".setup-lock.d").mkdir()
    (user.folder / ".setup-lock.d/pid").write_text("999999999")
    assert user.setup(PATH=without_flock(user))[0] == 0
    assert not (user.folder / ".setup-lock.d").exists()


def test_all_that_the_package_needs_is_pinned_with_hashes():
    pins = (ROOT / ".ci/requirements.txt").read_text()
    blocks = re.split(r"\n(?=[a-zA-Z0-9])", pins)[1:]
    names = {re.match(r"[\w.-]+", block)[0].lower().replace("_", "-") for block in blocks}
    assert all("==" in block and "--hash=sha256:" in block for block in blocks)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    extras = project["project"]["optional-dependencies"]
    wanted = [*project["project"]["dependencies"], *(d for each in extras.values() for d in each)]
    needed = {re.match(r"[\w.-]+", one)[0].lower().replace("_", "-") for one in wanted}
    assert needed - {"tofrender"} <= names


def test_git_stores_notebooks_without_outputs(user):
    """What is saved stays in the file, with its outputs; a second set-up changes nothing."""
    path = user.folder / "notebooks/a.ipynb"
    path.parent.mkdir()
    shown = {"output_type": "stream", "name": "stdout", "text": "1"}
    cell = {"cell_type": "code", "source": [], "metadata": {"trusted": True}}
    cell |= {"outputs": [shown], "execution_count": 3}
    told = {"language_info": {"name": "python", "version": "3.13.1"}}
    path.write_text(json.dumps({"cells": [cell], "metadata": told, "nbformat": 4}))
    before = path.read_text()

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(user.folder), *arguments]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout

    git("init", "-q")
    user.works()
    config = (user.folder / ".git/config").read_text()
    git("add", ".")
    stored = json.loads(git("show", ":notebooks/a.ipynb"))
    assert stored["metadata"] == {"language_info": {"name": "python"}}
    (kept,) = stored["cells"]
    assert (kept["outputs"], kept["execution_count"], kept["metadata"]) == ([], None, {})
    assert path.read_text() == before
    path.write_text(before.replace('"text": "1"', '"text": "2"'))
    assert git("diff", "--stat") == ""
    user.works()
    assert (user.folder / ".git/config").read_text() == config
