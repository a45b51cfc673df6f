"""A submission harms nobody: what the sandbox refuses, as root and as an ordinary user."""

import inspect
import json
import os
import secrets
import shutil
import socket
import subprocess
import sys
import tempfile
from contextlib import closing, suppress
from pathlib import Path
from socket import AF_INET, AF_UNIX, SOCK_DGRAM, SOCK_STREAM
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
from helpers import hostile, tiny_assignment
from helpers.course_assignment import PULSE, write, write_submission
from helpers.limits import lower
from helpers.processes import GUARD_S, wait_for
from helpers.tiny_assignment import ADD0, rows

pytest.importorskip("resource", reason="a grading machine runs Linux or macOS")

from tofrender.cli import main
from tofrender.course.assignments import find
from tofrender.course.grade import grading
from tofrender.course.judge import processes, sandbox, system_calls, wire
from tofrender.course.judge.client import MAX_REASON, NoAnswer, SubmissionLimits, Worker
from tofrender.course.judge.running import read_report

if sandbox.landlock_version() < 6 or not system_calls.available():
    pytest.skip("this machine protects from less", allow_module_level=True)

NOBODY = 65534
IS_ROOT = os.geteuid() == 0
USERS = ["root", "nobody"] if IS_ROOT else ["ordinary"]
ENDED = ("dead", "stopped", "tracing-stop", "zombie")
CHECKOUT = Path(__file__).resolve().parents[2]


def identity(user: str) -> dict:
    return {"user": NOBODY, "group": NOBODY, "extra_groups": []} if user == "nobody" else {}


@pytest.fixture
def open_tmp():
    folder = Path(tempfile.mkdtemp(prefix="tofrender-hostile-"))
    folder.chmod(0o755)
    yield folder
    shutil.rmtree(folder, ignore_errors=True)


def state_of(folder: Path) -> dict:
    """Modes, owners, names, times and content of all files."""
    found = {}
    for path in (folder, *sorted(folder.rglob("*"))):
        kept = path.lstat()
        content = path.read_bytes() if path.is_file() else b""
        times = kept.st_mtime, kept.st_ctime
        found[str(path)] = (kept.st_mode, kept.st_uid, kept.st_nlink, times, content)
    return found


class Targets:
    """Targets of attacks, which all belong to the user who grades, and their state."""

    def __init__(self, top: Path, user: str) -> None:
        self.folder = top / "others"
        self.folder.mkdir(parents=True)
        self.canary = self.folder / "canary"
        self.canary.write_text("as it was")
        self.abstract = f"tofrender-{secrets.token_hex(8)}"
        self.servers = {}
        local = ("127.0.0.1", 0)
        for name, place, *kind in (
            ("TCP", local, AF_INET, SOCK_STREAM),
            ("UDP", local, AF_INET, SOCK_DGRAM),
            ("UNIX", f"{self.folder}/unix", AF_UNIX, SOCK_STREAM),
            ("DATAGRAM", f"{self.folder}/datagram", AF_UNIX, SOCK_DGRAM),
            ("ABSTRACT", f"\0{self.abstract}", AF_UNIX, SOCK_STREAM),
            ("MPTCP", local, AF_INET, SOCK_STREAM, 262),
        ):
            with suppress(OSError):  # few kernels have no MPTCP
                server = socket.socket(*kind)
                server.bind(place)
                server.setblocking(False)
                if kind[1] == SOCK_STREAM:
                    server.listen()
                self.servers[name] = server
        self.victim = subprocess.Popen(["sleep", "1000000"], **identity(user))
        with suppress(OSError):
            os.setxattr(self.canary, "user.kept", b"x")
        owner = NOBODY if user == "nobody" else os.geteuid()
        for path in (top, *top.rglob("*")):
            os.chown(path, owner, -1)
            path.chmod(0o777 if path.name in ("unix", "datagram") else path.stat().st_mode)

    def named(self) -> dict:
        about = {"CANARY": str(self.canary), "FOLDER": str(self.folder), "VICTIM": self.victim.pid}
        places = {name: server.getsockname() for name, server in self.servers.items()}
        return {"MPTCP": places["TCP"]} | places | about | {"ABSTRACT": self.abstract}

    def state(self) -> dict:
        victim = psutil.Process(self.victim.pid)
        proc = Path("/proc")
        of_system_v = [(proc / "sysvipc" / kind).read_text() for kind in ("shm", "sem", "msg")]
        return {
            "files": state_of(self.folder),
            "limits": (proc / str(victim.pid) / "limits").read_text(),
            "ended": victim.status() in ENDED,
            "victim": (victim.nice(), victim.ionice(), victim.cpu_affinity()),
            "memory": (proc / str(victim.pid) / "oom_score_adj").read_text(),
            "shared": [name for name in os.listdir("/dev/shm") if "hostile" in name],
            "system v": [" 28769 " in text for text in of_system_v],
            "host": os.uname().nodename,
        }

    def heard(self) -> list[str]:
        found = []
        for name, server in self.servers.items():
            with suppress(BlockingIOError):
                if name in ("UDP", "DATAGRAM"):
                    server.recv(10)
                else:
                    server.accept()[0].close()
                found.append(name)
        return found

    def close(self) -> None:
        self.victim.kill()
        self.victim.wait()
        for server in self.servers.values():
            server.close()


def test_without_the_sandbox_attacks_succeed(tmp_path):
    """A few attacks of each kind succeed without the sandbox, which shows that they are real."""
    targets = Targets(tmp_path / "of", "root" if IS_ROOT else "ordinary")
    try:
        names = {"mode", "times", "write", "tcp", "udp", "unix", "abstract unix"}
        names |= {"priority", "limit of open files", "signal", "memory without a file", "server"}
        chosen = {n: text for n, text in hostile.ATTACKS.items() if n.partition(": ")[2] in names}
        space: dict = {}
        exec(hostile.source(chosen, targets.named()), space)
        outcomes = {name: hostile.outcome(attack) for name, attack in space["attacks"].items()}
        assert set(outcomes.values()) == {"done"}, outcomes
        assert {"TCP", "UDP", "UNIX", "ABSTRACT"} <= set(targets.heard())
    finally:
        targets.close()


@pytest.mark.parametrize("machine", system_calls.ARCHITECTURE)
def test_filter_is_one_that_a_kernel_takes(machine):
    """All jumps land inside, it ends by refusing, and it is not too long."""
    for judge in (False, True):
        code = system_calls.program(machine, 4711, judge)
        steps = [code[at : at + 8] for at in range(0, len(code), 8)]
        assert len(steps) < 4096
        for number, step in enumerate(steps[:-1]):
            assert number + 1 + max(step[2], step[3]) < len(steps)
        refusal = system_calls.REFUSE | system_calls.EPERM
        assert steps[-1] == system_calls._step(system_calls.RETURN, refusal)


LONG = {
    "text of an exception": "raise ValueError('x' * 100_000_000)",
    "text of a cause": "raise ValueError('x') from OSError('y' * 100_000_000)",
    "exception without a text": "class E(Exception):\n    __str__ = None\nraise E()",
    "status": "import sys; sys.exit('x' * 100_000_000)",
    "line": f"x = 1 / 0  # {'x' * 1_000_000}",
}
REPLIES = {
    "list": [1, 2],
    "number": 3,
    "no answer": {},
    "error that is none": {"error": [1]},
    "uses that are none": {"uses": 5},
    "long error": {"error": "x" * 10_000_000},
    "many names": {"error": "x", "uses": ["y" * 1000] * 100_000},
}


@pytest.mark.parametrize("name", LONG)
def test_texts_of_any_length_are_cut_before_they_are_sent(name, tmp_path):
    submission = write_submission(tmp_path / "bad", LONG[name])
    worker = Worker(write(tmp_path / "a0").folder, submission, limits=SubmissionLimits(2**30))
    with closing(worker) as asked, pytest.raises(NoAnswer) as error:
        asked.ask("density", {"width_opl": 0.1, "t": np.zeros(1)}, GUARD_S)
    assert len(str(error.value)) < 5000


@pytest.mark.parametrize("name", REPLIES)
def test_reply_of_any_kind_is_a_reason_of_one_line(name, tmp_path):
    with closing(Worker(tmp_path, None)) as asked, pytest.raises(NoAnswer) as error:
        asked._answer_in(REPLIES[name])
    assert len(str(error.value)) < MAX_REASON + 10
    assert "\n" not in str(error.value)
    assert sum(map(len, asked.used)) <= 100_000


def write_npz(path: Path, **arrays) -> None:
    structure = np.frombuffer(b'{"answer": {"__array__": "a0"}}', np.uint8)
    np.savez_compressed(path, structure=structure, **arrays)


def test_wire_reads_no_bombs_links_pipes_and_no_other_types(tmp_path):
    path = tmp_path / "1.npz"
    other = tmp_path / "2.npz"
    write_npz(other, a0=np.zeros(3))
    for make, said in (
        (lambda: write_npz(path, a0=np.zeros(1 << 18)), "more than 1048576"),
        (lambda: write_npz(path, a0=np.zeros(3, [("x", "f4")])), "is not an array of numbers"),
        (lambda: path.symlink_to(other), "is not an answer"),
        (lambda: os.mkfifo(path), "not a regular file"),
    ):
        make()
        with pytest.raises(ValueError, match=said):
            wire.read(path, 1 << 20)
        path.unlink()
    damaged = other.read_bytes()
    for at in range(0, len(damaged), 7):
        path.write_bytes(damaged[:at] + b"\xff\xff\xff" + damaged[at + 3 :])
        with suppress(ValueError):  # and nothing else
            wire.read(path)


def test_report_is_read_in_parts_only(tmp_path, monkeypatch):
    lower(monkeypatch, judge_report_bytes=1000)
    line = {"id": "x", "case": "", "outcome": "passed", "text": "", "share": 1.0, "seconds": 0.1}
    (tmp_path / "lines").write_text((json.dumps(line) + "\n") * 100)
    assert 0 < len(read_report(tmp_path / "lines")) < 100


def test_an_answer_of_another_kind_shows_nothing_of_the_test(tmp_path):
    """The test's own lines are shown to students who run it, not to those who are graded."""
    staff = write(tmp_path / "a0").folder
    answers = "def unambiguous_range(frequency_hz):\n    return {'x': 1}\n"
    student = write_submission(tmp_path / "bad", PULSE, answers)
    test = staff / "tests/test_range.py"
    test.write_text(test.read_text().replace("frequency_hz=100e6)", 'frequency_hz=1.0)["secret"]'))
    for option, shown in ((["--confine"], False), ([], True)):
        words = ["tests/test_range.py::test_range", f"--submission={student}", "--report=r"]
        command = [sys.executable, "-m", "pytest", "-q", *words, *option]
        subprocess.run(command, cwd=staff, capture_output=True, check=False)
        text = json.loads((staff / "r").read_text().splitlines()[-1])["text"]
        assert ("secret" in text) == shown, text
        assert shown or "the expected type (KeyError in line" in text


BEGIN = """
import os, pathlib, time, zipfile
import numpy as np
TMP = os.environ["TMPDIR"]
ANSWERS = pathlib.Path(TMP).parent / "answers"
"""

CLOSES = """
for folder, folders, names in os.walk("@TOP@"):
    for name in [*folders, *names]:
        try:
            os.chmod(os.path.join(folder, name), 0)
        except OSError:
            pass
os.chdir(TMP)
for _ in range(50):
    os.mkdir("deep")
    os.chdir("deep")
    open("file", "w").close()
"""
NO_REPLY = """
np.savez(ANSWERS / "x", structure=np.frombuffer(b"[1, 2]", np.uint8))
os.rename(ANSWERS / "x.npz", ANSWERS / "1.npz")
time.sleep(999)
"""
BOMB = """
with zipfile.ZipFile(ANSWERS / "x", "w", 8, compresslevel=1) as archive:
    archive.writestr("structure.npy", bytes(300 << 20))
os.rename(ANSWERS / "x", ANSWERS / "1.npz")
time.sleep(999)
"""
MANY = """
for _ in range(260):
    if os.fork() == 0:
        time.sleep(999)
time.sleep(999)
"""
FORKS = """
for _ in range(9):  # 512 processes, where nothing keeps them from it
    try:
        os.fork()
    except OSError:
        pass
time.sleep(999)
"""
EMPTY_FILES = """
for number in range(2500):
    open(os.path.join(TMP, str(number)), "w").close()
time.sleep(999)
"""
LINKS_IN_FOLDERS = """
for number in range(1250):
    os.mkdir(str(number))
    os.symlink("nowhere", f"{number}/link")
time.sleep(999)
"""
KILLS = """
for pid in (os.getppid(), 0):
    try:
        os.kill(pid, 9)
    except OSError:
        pass
"""
MEMBERS = {  # What each member's file holds and why it gets no point; "" where it gets one
    "a right one": (ADD0, ""),
    "all attacks": ("@ATTACKS@", ""),
    "closes everybody's files and leaves deep folders": (CLOSES, ""),
    "long text": ("raise ValueError('x' * 100_000_000)", "ValueError: xxx"),
    "reply that is none": (NO_REPLY, "the reply does not have the worker's format"),
    "reply that unpacks to much": (BOMB, "is not an answer: the file contains"),
    "reply that is a link": (
        "os.symlink('/dev/zero', ANSWERS / '1.npz'); time.sleep(999)",
        "a link",
    ),
    "answer of another kind": ("def add0(a, b):\n    return {'x': None}", "expected: numbers"),
    "a right one between": (ADD0, ""),
    "many processes": (MANY, "started more than 200 processes"),
    "processes that start processes": (FORKS, "started more than 200 processes"),
    "many empty files": (EMPTY_FILES, "made more than 2000 files"),
    "links in many folders": (LINKS_IN_FOLDERS, "made more than 2000 files"),
    "much memory": ("x = [b'x' * (1 << 27) for _ in range(20)]; time.sleep(999)", "GiB of memory"),
    "ends its parents": (KILLS, ""),
    "a right one at the end": (ADD0, ""),
}

ATTACKS = """
SCRATCH, FIRST = TMP, os.getpid()
said = {name: outcome(attack) for name, attack in attacks.items()}
odd = ("done", "NameError", "SyntaxError", "AttributeError", "ended")
wrong = {n: s for n, s in said.items() if (s != "done" if n in HARMLESS else s.startswith(odd))}
assert not wrong, wrong
"""
DRIVER = """
import json, resource, sys
from pathlib import Path
from helpers.tiny_assignment import grade_class
from tofrender.course.assignments import find
from tofrender.course.grade import grading

top = Path(sys.argv[1])
limits = [resource.getrlimit(number) for number in range(16)]
with grading.open_grader(find(top / "a0"), memory_gib=1) as grader:
    grade_class(grader, top / "class", top / "out", jobs=2)
assert limits == [resource.getrlimit(number) for number in range(16)]
status = open("/proc/self/status").read()  # ru_maxrss would be that of who has started this
print(json.dumps(int(status.partition("VmHWM:")[2].split()[0]) / 1024))
"""

ELSEWHERE = """
set -e
closed=$1; hold=$2; user=$3; shift 3
mount -t tmpfs -o mode=755 none "$hold"
number=0
for path in $PYTHON_FOLDERS; do
    number=$((number + 1)); mkdir "$hold/$number"; mount --bind "$path" "$hold/$number"
done
mount -t tmpfs -o mode=755 none "$closed"
number=0
for path in $PYTHON_FOLDERS; do
    number=$((number + 1)); mkdir -p "$path"; mount --bind "$hold/$number" "$path"
done
exec setpriv --reuid="$user" --regid="$user" --clear-groups "$@"
"""


def run_as(user: str, top: Path, command: list[str]) -> subprocess.CompletedProcess:
    environment = os.environ | {
        "PYTHONPATH": f"{CHECKOUT}{os.pathsep}{CHECKOUT / 'tests'}",
        "HOME": str(top / "home"),
        "TMPDIR": str(top / "tmp"),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    closed = sandbox.closed_to_others()
    who = identity(user)
    if closed and user == "nobody":
        if shutil.which("unshare") is None or shutil.which("setpriv") is None:
            pytest.skip("Python lies where other users cannot go")
        (top / "hold").mkdir()
        script = ["unshare", "-m", "sh", "-c", ELSEWHERE, "sh", closed, str(top / "hold")]
        command = [*script, str(NOBODY), *command]
        who = {}
        inside = [path for path in sandbox.python_folders() if path.startswith(closed + "/")]
        environment["PYTHON_FOLDERS"] = " ".join(inside)
    options = {"env": environment, "cwd": top, "capture_output": True, "text": True}
    return subprocess.run(command, **options, **who)


@pytest.mark.parametrize("user", USERS)
def test_class_with_hostile_members_is_graded_right(user, open_tmp):
    top = open_tmp
    targets = Targets(top / "victims", user)
    solution = tiny_assignment.sums(top / "a0").folder / "solutions" / "p0.py"
    aims = targets.named() | {"HIDDEN": str(solution), "HARMLESS": [*hostile.HARMLESS]}
    attacks = hostile.source(hostile.ATTACKS | hostile.HARMLESS, aims)
    attacks += inspect.getsource(hostile.outcome) + ATTACKS
    for name, (text, _) in MEMBERS.items():
        text = text.replace("@TOP@", str(top)).replace("@ATTACKS@", attacks)
        text = text if "def add0" in text else f"{text}\n{ADD0}"
        tiny_assignment.write(top / "class" / name, {"p0.py": BEGIN + text})
    for name in ("home", "tmp"):
        (top / name).mkdir()
    owner = NOBODY if user == "nobody" else os.geteuid()
    for path in (top, *top.rglob("*")):
        os.chown(path, owner, -1)
    before = targets.state()
    files = state_of(top / "class")
    try:
        done = run_as(user, top, [sys.executable, "-P", "-c", DRIVER, str(top)])
        assert done.returncode == 0, done.stdout + done.stderr
        assert targets.state() == before
        assert targets.heard() == []
    finally:
        targets.close()
    assert state_of(top / "class") == files
    assert list((top / "tmp").iterdir()) == []
    assert json.loads(done.stdout.splitlines()[-1]) < 600  # MB of the grader
    table = {row["submission"]: row for row in rows(top / "out.csv")}
    for name, (_, reason) in MEMBERS.items():
        row = table[name]
        assert float(row["total"]) == (reason == ""), row
        assert reason in row["reason"], row


FORKS_UNTIL_REFUSED = """
import os, sys, time
from tofrender.course.judge import sandbox
sandbox.MAX_TASKS = 30
uid = int(sys.argv[1]) or None
if uid is None:
    sandbox._leave_the_network()
sandbox.confine(uid=uid)
started = 0
try:
    while started < 200:
        if os.fork() == 0:
            time.sleep(999)
        started += 1
except BlockingIOError:
    pass
print(started, flush=True)
time.sleep(999)
"""


@pytest.mark.parametrize("user", USERS)
def test_number_of_processes_has_a_hard_limit(user, tmp_path):
    """The kernel refuses more, and all of them end at once."""
    with sandbox.own_user() as own:
        uid = own if user == "root" else None
        command = [sys.executable, "-c", FORKS_UNTIL_REFUSED, str(uid or 0)]
        if user == "nobody":
            setpriv = ["setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups"]
            if sandbox.closed_to_others() or shutil.which("setpriv") is None:
                pytest.skip("Python lies where other users cannot go")
            command = [*setpriv, *command]
        environment = os.environ | {"PYTHONPATH": str(CHECKOUT)}
        started = processes.Supervised(command, cwd=tmp_path, env=environment, uid=uid)
        try:
            wait_for(lambda: started.output().strip() or started.process.poll() is not None)
            assert 0 < int(started.output()) <= 30 + 4 * os.cpu_count()
        finally:
            started.end()
        assert not started._descendants()


def test_a_bomb_costs_its_own_problem_only(open_tmp):
    staff = tiny_assignment.write(open_tmp / "a0", tiny_assignment.wide(["a bomb", "a sum"]))
    right = ADD0.replace("add0", "add1")
    files = {"p0.py": f"{BEGIN}{FORKS}{ADD0}", "p1.py": right}
    student = tiny_assignment.write(open_tmp / "student", files)
    with grading.open_grader(find(staff)) as grader:
        found = grader.grade(student, open_tmp / "results.json")
    assert found.score == 1
    assert "started more than 200 processes" in found.summary()


FAILING_MACHINES = {
    "worker that cannot start": "raise OSError(28, 'No space left on device')\n",
    "judge that cannot write": None,
}


@pytest.mark.parametrize("name", FAILING_MACHINES)
def test_failure_of_the_machine_is_no_grade(name, tmp_path, capsys, monkeypatch):
    """Nobody gets points, the cells are empty instead of zero, and the exit status is 1."""
    staff = tiny_assignment.sums(tmp_path / "a0")
    if text := FAILING_MACHINES[name]:
        (staff.folder / "tests/probes.py").write_text(text)
    else:
        test = staff.folder / "tests/test_p0.py"
        broken = "def test_numbers(submission):\n    open('/dev/full', 'w', 1).write('x\\n')\n"
        test.write_text(test.read_text().partition("def test_numbers")[0] + broken)
    tiny_assignment.write(tmp_path / "class" / "ada", {"p0.py": ADD0})
    words = ["grade", str(staff.folder), "--all", str(tmp_path / "class")]
    status = main([*words, "--csv", str(tmp_path / "grades.csv")])
    assert status == 1
    assert "1 submissions were not graded" in capsys.readouterr().err
    (row,) = rows(tmp_path / "grades.csv")
    assert (row["total"], row["a0.p0"]) == ("", "")
    assert row["reason"].startswith("not graded: problem a0.p0: the judge ended with status 70")
    status = main(
        [
            "grade",
            str(staff.folder),
            "--submission",
            str(tmp_path / "class/ada"),
            "-o",
            str(tmp_path / "one.json"),
        ]
    )
    assert status == 1
    assert "score" not in json.loads((tmp_path / "one.json").read_text())


def test_failure_on_a_full_disk_is_not_the_submissions(tmp_path, monkeypatch):
    """Any failure while the machine lacks something may have this reason."""
    submission = write_submission(tmp_path / "bad", "raise OSError(28, 'No space left on device')")
    arguments = {"width_opl": 0.1, "t": np.zeros(1)}
    with closing(Worker(write(tmp_path / "a0").folder, submission)) as asked:
        with pytest.raises(NoAnswer):
            asked.ask("density", arguments, GUARD_S)
        lower(monkeypatch, judge_least_files=1 << 60)
        with pytest.raises(processes.MachineFailure, match="inodes"):
            asked.ask("density", arguments, GUARD_S)


def test_disk_that_fills_up_is_seen(tmp_path, monkeypatch):
    """Files that others write on the same disk do not count."""
    lower(monkeypatch, judge_written_bytes=1 << 20)
    started = processes.Supervised(["sleep", "999"], cwd=tmp_path, env=dict(os.environ))
    disk = SimpleNamespace(free=1 << 30)
    monkeypatch.setattr(processes.shutil, "disk_usage", lambda _: disk)
    try:
        assert started.excess(None, tmp_path) == ""
        disk.free -= 1 << 21
        assert started.excess(None, tmp_path) == ""
        (tmp_path / "inside").mkdir()
        (tmp_path / "inside/file").write_bytes(b"x" * (1 << 21))
        assert started.excess(None, tmp_path).startswith("wrote more than")
    finally:
        started.end()
