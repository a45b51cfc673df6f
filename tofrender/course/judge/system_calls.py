"""System calls that a submission may make: a filter that the kernel runs (seccomp-BPF).

Calls that are not in the tables below are refused with EPERM. Examples are sockets; changes of
modes, owners, times and attributes of files; shared memory, semaphores and queues of System V and
POSIX; limits, memory and signals of other processes; mounts, namespaces, keys, io_uring and BPF.
A refused call does not end the process, so Python raises an exception in the student's line.

Calls that are newer than the tables return ENOSYS, and C libraries then use an older call.
`clone3` returns ENOSYS, too, because a filter cannot read its arguments.

This file imports only the standard library, see `sandbox`.
"""

import ctypes
import os
import re
import struct
import sys
from collections.abc import Iterable, Sequence

# Name, number on x86_64, number on aarch64; `-` if the architecture lacks the call
ALLOWED = """
-- Files, which Landlock guards
read 0 63, write 1 64, readv 19 65, writev 20 66, pread64 17 67, pwrite64 18 68, preadv 295 69,
pwritev 296 70, preadv2 327 286, pwritev2 328 287, lseek 8 62, open 2 -, openat 257 56,
openat2 437 437, creat 85 -, close 3 57, close_range 436 436, dup 32 23, dup2 33 -, dup3 292 24,
pipe 22 -, pipe2 293 59, stat 4 -, fstat 5 80, lstat 6 -, newfstatat 262 79, statx 332 291,
access 21 -, faccessat 269 48, faccessat2 439 439, readlink 89 -, readlinkat 267 78,
getdents 78 -, getdents64 217 61, getcwd 79 17, chdir 80 49, fchdir 81 50, rmdir 84 -,
unlink 87 -, unlinkat 263 35, rename 82 -, renameat 264 38,
renameat2 316 276, link 86 -, linkat 265 37, symlink 88 -, symlinkat 266 36, truncate 76 45,
ftruncate 77 46, fallocate 285 47, fsync 74 82, fdatasync 75 83,
fadvise64 221 223, readahead 187 213, copy_file_range 326 285, sendfile 40 71, splice 275 76,
tee 276 77, flock 73 32, statfs 137 43, fstatfs 138 44, getxattr 191 8, lgetxattr 192 9,
fgetxattr 193 10, listxattr 194 11, llistxattr 195 12, flistxattr 196 13
-- Reducing the process's own rights
landlock_create_ruleset 444 444, landlock_add_rule 445 445, landlock_restrict_self 446 446
-- The process's own memory
mmap 9 222, munmap 11 215, mprotect 10 226, mremap 25 216, madvise 28 233, brk 12 214,
msync 26 227, membarrier 324 283, mbind 237 235, get_mempolicy 239 236, set_mempolicy 238 237
-- The process's own threads and children, and information about them
fork 57 -, vfork 58 -, execve 59 221, execveat 322 281, exit 60 93, exit_group 231 94,
wait4 61 260, waitid 247 95, futex 202 98, futex_waitv 449 449, set_robust_list 273 99,
rseq 334 293, set_tid_address 218 96, gettid 186 178, getpid 39 172, getppid 110 173,
getpgrp 111 -, getpgid 121 155, getsid 124 156, setsid 112 157, getuid 102 174, geteuid 107 175,
getgid 104 176, getegid 108 177, getresuid 118 148, getresgid 120 150, getgroups 115 158,
sched_yield 24 124, sched_getaffinity 204 123, sched_getparam 143 121,
sched_getscheduler 145 120, sched_get_priority_max 146 125, sched_get_priority_min 147 126,
getcpu 309 168, getpriority 140 141, getrlimit 97 163, getrusage 98 165, times 100 153,
sysinfo 99 179, uname 63 160, capget 125 90, arch_prctl 158 -
-- Receiving signals, time, waiting, random numbers
rt_sigaction 13 134, rt_sigprocmask 14 135, rt_sigreturn 15 139, rt_sigsuspend 130 133,
rt_sigpending 127 136, rt_sigtimedwait 128 137, sigaltstack 131 132, pause 34 -,
restart_syscall 219 128, alarm 37 -, setitimer 38 103, getitimer 36 102, timer_create 222 107,
timer_settime 223 110, timer_gettime 224 108, timer_getoverrun 225 109, timer_delete 226 111,
timerfd_create 283 85, timerfd_settime 286 86, timerfd_gettime 287 87, clock_gettime 228 113,
clock_getres 229 114, clock_nanosleep 230 115, nanosleep 35 101, gettimeofday 96 169,
time 201 -, poll 7 -, ppoll 271 73, select 23 -, pselect6 270 72, epoll_create 213 -,
epoll_create1 291 20, epoll_ctl 233 21, epoll_wait 232 -, epoll_pwait 281 22, eventfd 284 -,
eventfd2 290 19, getrandom 318 278
"""

# Allowed with certain arguments, see `_conditions`
CONDITIONAL = """
clone 56 220, fcntl 72 25, ioctl 16 29, kill 62 129, mkdir 83 -, mkdirat 258 34, prctl 157 167,
prlimit64 302 261, sched_setaffinity 203 122, tgkill 234 131, umask 95 166
"""

# Allowed in addition for the judge, which confines and ends a submission
FOR_THE_JUDGE = """
kill 62 129, tgkill 234 131, prctl 157 167, capset 126 91, chmod 90 -, fchmod 91 52,
fchmodat 268 53, chown 92 -, fchown 93 55, fchownat 260 54, seccomp 317 277, setgid 106 144,
setgroups 116 159, setpgid 109 154, setresgid 119 149, setresuid 117 147, setuid 105 146
"""

NEWEST = 450  # largest number that the tables cover
CLONE3 = 435
INSTALL = {"x86_64": 317, "aarch64": 277}  # number of the call seccomp
ARCHITECTURE = {"x86_64": 0xC000003E, "aarch64": 0xC00000B7}  # AUDIT_ARCH_*
EPERM = 1
ENOSYS = 38

# Flags of clone
NEW_NAMESPACES = 0x7E020000
SIBLING = 0x8000

# Allowed values of an argument
IOCTLS = (0x5401, 0x5413, 0x541B, 0x5421, 0x5450, 0x5451)  # TCGETS to FIOCLEX: only queries
FCNTLS = (0, 1, 2, 3, 4, 5, 6, 7, 36, 37, 38, 1030, 1032)  # copies, flags, locks; no signals
PRCTLS = (3, 15, 16, 21, 23, 39, 0x53564D41)  # names of threads and memory, and queries

# Classic BPF. The input of the filter contains the number of the call, the architecture, and the
# arguments, at these offsets [bytes]
NUMBER_AT = 0
ARCHITECTURE_AT = 4
ARGUMENTS_AT = 16

# Instructions
LOAD = 0x20
IF_EQUAL = 0x15
IF_ABOVE = 0x25
IF_ANY_BIT = 0x45
RETURN = 0x06
EACH_BIT = -1  # not an instruction, but a comparison of `_check`

# Results of the filter
ALLOW = 0x7FFF0000
REFUSE = 0x00050000  # plus the error number

# Operations and flags of seccomp
FILTER = 1
SPEC_ALLOW = 1 << 2  # keep the processor as fast as without a filter
QUERY_ACTION = 2
Condition = tuple[int, int, Sequence[int]]  # 32-bit word of the arguments, comparison, values


def available() -> bool:
    """Return whether this kernel can filter system calls, and the tables cover its architecture."""
    if not sys.platform.startswith("linux") or struct.calcsize("P") != 8:
        return False
    number = INSTALL.get(os.uname().machine)
    action = ctypes.c_uint32(REFUSE)
    libc = ctypes.CDLL(None)
    return number is not None and libc.syscall(number, QUERY_ACTION, 0, ctypes.byref(action)) == 0


def restrict(judge: bool = False) -> None:
    """Filter the system calls of this process and its children.

    The filter cannot be removed. PR_SET_NO_NEW_PRIVS must have been set before.
    """
    machine = os.uname().machine
    code = program(machine, os.getpid(), judge)
    buffer = ctypes.create_string_buffer(code, len(code))
    filters = struct.pack("@HP", len(code) // 8, ctypes.addressof(buffer))
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.syscall(INSTALL[machine], FILTER, SPEC_ALLOW, filters) != 0:
        raise OSError(ctypes.get_errno(), "the kernel refused the filter of system calls")


def program(machine: str, own: int, judge: bool) -> bytes:
    """Return the instructions of the filter, 8 bytes each.

    Args:
        machine: Architecture, as in `os.uname`.
        own: Id of the process, which may send signals to itself.
        judge: Allow the calls of a judge.
    """
    allowed = _numbers(ALLOWED, machine)
    if judge:
        allowed |= _numbers(FOR_THE_JUDGE, machine)

    # Refuse other architectures, and calls whose arguments or effects are unknown
    code = [
        _step(LOAD, ARCHITECTURE_AT),
        *_unless([ARCHITECTURE[machine]]),
        _step(LOAD, NUMBER_AT),
        _step(IF_ABOVE, NEWEST, 0, 1),
        _step(RETURN, REFUSE | ENOSYS),
        _step(IF_EQUAL, CLONE3, 0, 1),
        _step(RETURN, REFUSE | ENOSYS),
    ]

    # Allow the calls of the first table
    for number in allowed.values():
        code += [_step(IF_EQUAL, number, 0, 1), _step(RETURN, ALLOW)]

    # Allow conditional calls if their arguments pass all checks
    conditions = _conditions(own, judge)
    for name, number in _numbers(CONDITIONAL, machine).items():
        if name not in allowed:
            checks = [step for each in conditions[name] for step in _check(*each)]
            code += [_step(IF_EQUAL, number, 0, len(checks) + 1), *checks, _step(RETURN, ALLOW)]
    return b"".join([*code, _step(RETURN, REFUSE | EPERM)])


def _conditions(own: int, judge: bool) -> dict[str, list[Condition]]:
    """Return the conditions on the arguments of the calls in `CONDITIONAL`.

    An argument has 64 bits. Word 2 k is the low half of argument k, word 2 k + 1 the high half.
    """
    first = 0
    second = 2
    third = 4
    third_high = 5

    # New folders must be open to their owner, because the judge may have the same user
    owner = (0o400, 0o200, 0o100)
    own_limits: list[Condition] = [(first, IF_EQUAL, [0, own])]
    if not judge:
        # A null pointer to the new limit: only read the limits
        own_limits += [(third, IF_EQUAL, [0]), (third_high, IF_EQUAL, [0])]
    return {
        "clone": [(first, IF_ANY_BIT, [NEW_NAMESPACES | SIBLING])],
        "fcntl": [(second, IF_EQUAL, FCNTLS)],
        "ioctl": [(second, IF_EQUAL, IOCTLS)],
        "kill": [(first, IF_EQUAL, [own])],
        "tgkill": [(first, IF_EQUAL, [own])],
        "prctl": [(first, IF_EQUAL, PRCTLS)],
        "prlimit64": own_limits,
        "sched_setaffinity": [(first, IF_EQUAL, [0])],
        "mkdir": [(second, EACH_BIT, owner)],
        "mkdirat": [(third, EACH_BIT, owner)],
        "umask": [(first, IF_ANY_BIT, [sum(owner)])],
    }


def _check(word: int, comparison: int, values: Sequence[int]) -> list[bytes]:
    """Return seccomp instructions (BPF) that deny a system call by one of its arguments.

    The call fails with the error EPERM if the argument does not meet the condition.

    Args:
        word: Word of the arguments, see `_conditions`.
        comparison: `IF_EQUAL` requires that the word equals one of the values, `EACH_BIT` that the
            word has the bits of all values. `IF_ANY_BIT` requires that the word contains no bit
            of the only value.
        values: Values to compare with.
    """
    load = _step(LOAD, ARGUMENTS_AT + 4 * word)
    if comparison == IF_EQUAL:
        return [load, *_unless(values)]
    if comparison == EACH_BIT:
        refuse = _step(RETURN, REFUSE | EPERM)
        steps = [(_step(IF_ANY_BIT, value, 1, 0), refuse) for value in values]
        return [load, *(step for pair in steps for step in pair)]
    return [load, _step(comparison, values[0], 0, 1), _step(RETURN, REFUSE | EPERM)]


def _unless(values: Iterable[int]) -> list[bytes]:
    """Return instructions that deny the system call unless the loaded word is one of `values`.

    The word is part of an argument, see `_check`. A denied call fails with the error EPERM.
    """
    values = list(values)
    equal = [_step(IF_EQUAL, value, len(values) - k, 0) for k, value in enumerate(values)]
    return [*equal, _step(RETURN, REFUSE | EPERM)]


def _step(code: int, value: int, if_true: int = 0, if_false: int = 0) -> bytes:
    """Return an instruction. Jumps are given as the number of instructions to skip."""
    return struct.pack("=HBBI", code, if_true, if_false, value)


def _numbers(table: str, machine: str) -> dict[str, int]:
    """Return the numbers of a table's calls on an architecture, by name."""
    column = {"x86_64": 2, "aarch64": 3}[machine]
    found = re.finditer(r"(\w+) (\d+|-) (\d+|-)", table)
    return {each[1]: int(each[column]) for each in found if each[column] != "-"}
