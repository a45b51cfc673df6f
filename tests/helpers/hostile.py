"""What submissions try that harms others, a few lines each.

Each attack runs in a child of its own; an exception or False is a refusal.
"""

import os
import textwrap

FILES = {
    "mode": "os.chmod(CANARY, 0o4777)",
    "mode of an open file": "os.fchmod(os.open(CANARY, os.O_RDONLY), 0o666)",
    "mode of a folder": "os.chmod(FOLDER, 0)",
    "mode by a new call": "call(452, 452, -100, CANARY, 0o777, 0)",
    "owner": "os.chown(CANARY, os.getuid(), -1)",
    "owner of a link": "os.lchown(CANARY, -1, os.getgid())",
    "times": "os.utime(CANARY, (1, 1))",
    "times of an open file": "os.utime(os.open(CANARY, os.O_RDONLY))",
    "attribute": "os.setxattr(CANARY, 'user.note', b'x')",
    "attribute taken away": "os.removexattr(CANARY, 'user.kept')",
    "flag of the file system": """
        import fcntl, struct
        fcntl.ioctl(os.open(CANARY, os.O_RDONLY), 0x40086602, struct.pack("l", 0x10))
    """,
    "write": "open(CANARY, 'a').write('x')",
    "truncate": "os.truncate(CANARY, 0)",
    "remove": "os.remove(CANARY)",
    "rename": "os.rename(CANARY, CANARY + '.old')",
    "new file": "open(FOLDER + '/new', 'x')",
    "new folder": "os.mkdir(FOLDER + '/new')",
    "second name in its own folder": "os.link(CANARY, SCRATCH + '/canary')",
    "device": "os.mknod(SCRATCH + '/device', 0o60666, os.makedev(7, 0))",
    "lease": "import fcntl; fcntl.fcntl(os.open(CANARY, os.O_RDONLY), 1024, 0)",
    "hidden file": "open(HIDDEN).read()",
    "names in a folder": "os.listdir(FOLDER)",
    "names in the root": "os.listdir('/')",
    "names in the parent of its folder": "os.listdir(os.path.dirname(os.path.dirname(SCRATCH)))",
    "folder that nobody can list": "os.mkdir(SCRATCH + '/closed', 0o300)",
    "folder that nobody can list, by its file": """
        os.mkdir("closed", 0o600, dir_fd=os.open(SCRATCH, os.O_RDONLY))
    """,
    "mode of all later folders": "os.umask(0o777)",
    "names through a watch": "call(294, 26, 0)",
}

OTHERS = {
    "limit of processor time": "import resource; resource.prlimit(VICTIM, 0, (1, 1))",
    "limit of open files": "call(302, 261, VICTIM, 7, ctypes.create_string_buffer(16), None)",
    "priority": "os.setpriority(os.PRIO_PROCESS, VICTIM, 19)",
    "processors": "os.sched_setaffinity(VICTIM, {0})",
    "scheduler": "os.sched_setscheduler(VICTIM, os.SCHED_IDLE, os.sched_param(0))",
    "priority of its disk": "call(251, 30, 1, VICTIM, 3 << 13)",
    "first to end without memory": "open(f'/proc/{VICTIM}/oom_score_adj', 'w').write('1000')",
    "signal": "os.kill(VICTIM, 9)",
    "signal to a thread": "call(234, 131, VICTIM, VICTIM, 9)",
    "signal through a descriptor": "call(424, 424, call(434, 434, VICTIM, 0), 9, None, 0)",
    "signal with a value": "call(129, 138, VICTIM, 9, ctypes.create_string_buffer(128))",
    "trace": "call(101, 117, 16, VICTIM, 0, 0)",
    "memory": "call(311, 271, VICTIM, None, 0, None, 0, 0)",
    "memory as a file": "open(f'/proc/{VICTIM}/mem', 'rb').read(1)",
    "environment": "open(f'/proc/{VICTIM}/environ', 'rb').read()",
    "names of all": "os.listdir('/proc')",
    "command line": "open(f'/proc/{VICTIM}/cmdline').read()",
    "name and state": "open(f'/proc/{VICTIM}/status').read()",
    "its threads": "os.listdir(f'/proc/{VICTIM}/task')",
    "its folder": "os.readlink(f'/proc/{VICTIM}/cwd')",
    "descriptor": "call(438, 438, call(434, 434, VICTIM, 0), 0, 0)",
    "network of another": "call(308, 268, os.open(f'/proc/{VICTIM}/ns/net', os.O_RDONLY), 0)",
}

NETWORK = {
    "tcp": "socket.create_connection(TCP, timeout=2)",
    "udp": "socket.socket(socket.AF_INET, socket.SOCK_DGRAM).sendto(b'x', tuple(UDP))",
    "mptcp": "socket.socket(socket.AF_INET, socket.SOCK_STREAM, 262).connect(tuple(MPTCP))",
    "unix": "socket.socket(socket.AF_UNIX).connect(UNIX)",
    "abstract unix": "socket.socket(socket.AF_UNIX).connect('\\0' + ABSTRACT)",
    "unix datagram of a pair": """
        socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)[0].sendto(b"x", DATAGRAM)
    """,
    "netlink": "socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, 0)",
    "server": "socket.create_server(('127.0.0.1', 0))",
    "vsock": "socket.socket(40, socket.SOCK_STREAM)",
}

KERNEL = {
    "shared memory of System V": "call(29, 194, 0x7061, 4096, 0o1666)",
    "semaphores": "call(64, 190, 0x7061, 1, 0o1666)",
    "queue of System V": "call(68, 186, 0x7061, 0o1666)",
    "queue of POSIX": "call(240, 180, b'tofrender-hostile', 0o102, 0o666, None)",
    "shared memory of POSIX": "open('/dev/shm/tofrender-hostile', 'x')",
    "memory without a file": "os.memfd_create('x')",
    "key": "call(248, 217, b'user', b'tofrender-hostile', b'x', 1, -4)",
    "ring": "call(425, 425, 8, ctypes.create_string_buffer(120))",
    "namespace of users": "call(272, 97, 0x10000000)",
    "namespace through clone": "call(56, 220, 0x10000011, 0, 0, 0, 0) or os._exit(0)",
    "mount": "call(165, 40, b'none', SCRATCH.encode(), b'tmpfs', 0, None)",
    "another root": "os.chroot(SCRATCH)",
    "bpf": "call(321, 280, 0, ctypes.create_string_buffer(128), 128)",
    "counters": "call(298, 241, ctypes.create_string_buffer(128), 0, -1, -1, 0)",
    "faults of memory": "call(323, 282, 0)",
    "root": "os.setuid(0)",
    "name of the machine": "socket.sethostname(socket.gethostname())",
    "clock": "import time; time.clock_settime(time.CLOCK_REALTIME, time.time())",
    "ruleset": "call(444, 444, ctypes.create_string_buffer(24), 8, 0)",
    "key strokes": "import fcntl; fcntl.ioctl(0, 0x5412, b'x')",
    "numbers of x32": "return platform.machine() == 'x86_64' and call(0x40000000 | 39, 0) > 0",
    "calls of 32 bits": """
        import mmap  # mov eax, 20 (getpid); int 0x80; ret
        if platform.machine() != "x86_64":
            return False
        code = mmap.mmap(-1, 4096, prot=7)
        code.write(bytes.fromhex("b814000000cd80c3"))
        place = ctypes.addressof(ctypes.c_char.from_buffer(code))
        return ctypes.CFUNCTYPE(ctypes.c_int)(place)() > 0
    """,
}

ATTACKS = {"file: ": FILES, "process: ": OTHERS, "network: ": NETWORK, "kernel: ": KERNEL}
ATTACKS = {kind + name: text for kind, those in ATTACKS.items() for name, text in those.items()}

HARMLESS = {
    "threads": "import threading; t = threading.Thread(target=int); t.start(); t.join()",
    "child": "return os.waitpid(os.posix_spawn('/bin/true', ['true'], {}), 0)[1] == 0",
    "shell": "import subprocess; return subprocess.check_output(['echo', 'x']) == b'x\\n'",
    "names in its folder": "os.listdir(SCRATCH); os.listdir('.')",
    "names of the system": "os.listdir('/usr')",
    "folder of its own": "os.mkdir(SCRATCH + '/f', 0o700); os.rmdir(SCRATCH + '/f')",
    "temporary folder": "import tempfile; tempfile.TemporaryDirectory(dir=SCRATCH).cleanup()",
    "what it is itself": "return os.getpid() != FIRST or bool(open('/proc/self/status').read())",
    "memory of the machine": "open('/proc/meminfo').read(); open('/proc/cpuinfo').read()",
    "file of its own": "open(SCRATCH + '/own', 'w').write('x'); os.remove(SCRATCH + '/own')",
    "link of its own": "os.symlink('x', SCRATCH + '/l'); os.remove(SCRATCH + '/l')",
    "its limits": "import resource; resource.getrlimit(resource.RLIMIT_AS)",
    "random numbers": "os.urandom(8); open('/dev/urandom', 'rb').read(8)",
    "clock": "import time; time.sleep(0.001); time.perf_counter()",
    "alarm": "signal.alarm(1); signal.alarm(0)",
    "signal to itself": "os.kill(os.getpid(), 0) if os.getpid() == FIRST else None",
    "callback": "return ctypes.CFUNCTYPE(ctypes.c_int)(lambda: 3)() == 3",
    "temporary file": "import tempfile; tempfile.TemporaryFile(dir=SCRATCH).write(b'x')",
}

HELPERS = '''
def call(x86_64, aarch64, *arguments):
    """A system call by its number; numbers are as wide as registers."""
    number = x86_64 if platform.machine() == "x86_64" else aarch64
    wide = [ctypes.c_long(a) if isinstance(a, int) else a for a in arguments]
    wide = [a.encode() if isinstance(a, str) else a for a in wide]
    result = ctypes.CDLL(None, use_errno=True).syscall(ctypes.c_long(number), *wide)
    if result < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return result
'''


def source(attacks: dict[str, str], targets: dict) -> str:
    """Python code with a function `attack0`, ... of each attack, and a dict `attacks` of them."""
    lines = ["import ctypes, os, platform, signal, socket", HELPERS]
    lines += [f"{name} = {value!r}" for name, value in targets.items()]
    for number, text in enumerate(attacks.values()):
        lines += [f"def attack{number}():", textwrap.indent(textwrap.dedent(text).strip(), "    ")]
    named = (f"{name!r}: attack{number}" for number, name in enumerate(attacks))
    return "\n".join([*lines, "attacks = {" + ", ".join(named) + "}", ""])


def outcome(attack) -> str:
    """Try an attack in a child: what refused it, or "done"."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            said = "refused" if attack() is False else "done"
        except BaseException as error:
            said = f"{type(error).__name__}: {error}"
        os.write(write, said[:300].encode())
        os._exit(0)
    os.close(write)
    with os.fdopen(read) as pipe:
        said = pipe.read()
    _, status = os.waitpid(child, 0)
    return said or f"ended with status {status}"
