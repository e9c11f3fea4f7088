"""Permanent confinement of a process: system limits and, on Linux, Landlock and seccomp if available.

This module imports only the standard library, so that all other code is loaded after the confinement.

- rlimits: limits of CPU time, address space and open files; no core dumps, and no byte can be written to a file.
- Landlock (ABI 1 and later): files can be opened only below the given folders, and only for reading. From ABI 4 on, no TCP; from
  ABI 6 on, no signals to other processes and no abstract sockets.
- seccomp (x86-64 and ARM64): no new processes or programs, no sockets, no files opened for writing, no tracing. Names, owners
  and modes cannot be changed, and other processes get no signals. `io_uring` is forbidden, because it would bypass the filter.
"""

from __future__ import annotations

import ctypes
import errno
import os
import struct
import sys
from collections.abc import Sequence

MAX_MEMORY_BYTES = 8 << 30  # maximum address space of any request
_MAX_OPEN_FILES = 256
_STACK_BYTES = 8 << 20

# ---- limits of the system


def limit_resources() -> bool:
    """Set the limits that apply to all requests. Return False if the system has no such limits (Windows)."""
    try:
        import resource
    except ImportError:
        return False
    _reduce_process_limit("RLIMIT_AS", MAX_MEMORY_BYTES, is_permanent=True)
    _reduce_process_limit("RLIMIT_NOFILE", _MAX_OPEN_FILES, is_permanent=True)
    _reduce_process_limit("RLIMIT_FSIZE", 0, is_permanent=True)
    _reduce_process_limit("RLIMIT_CORE", 0, is_permanent=True)
    _reduce_process_limit("RLIMIT_STACK", _STACK_BYTES)
    del resource
    return True


def limit_request(seconds: int, memory: int) -> None:
    """Set the limits for the next request. `seconds`: CPU time. `memory`: bytes of address space."""
    try:
        import resource
    except ImportError:
        return
    usage = resource.getrusage(resource.RUSAGE_SELF)
    _reduce_process_limit("RLIMIT_CPU", int(usage.ru_utime + usage.ru_stime) + 1 + seconds)
    _reduce_process_limit("RLIMIT_AS", memory)


def raise_memory_limit(extra_bytes: int) -> None:
    """Allow this request to use `extra_bytes` more bytes of address space, for work of known size. Do nothing if the process has
    no limit."""
    try:
        import resource
    except ImportError:
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    if soft != resource.RLIM_INFINITY:
        limit = soft + max(extra_bytes, 0)
        resource.setrlimit(resource.RLIMIT_AS, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))


def _reduce_process_limit(name: str, limit: int, *, is_permanent: bool = False) -> None:
    import resource

    resource_number = getattr(resource, name, None)
    if resource_number is None:
        return
    soft_limit, upper = resource.getrlimit(resource_number)
    present = soft_limit if is_permanent else upper  # after a permanent reduction, no request exceeds the user's limit
    value = limit if present == resource.RLIM_INFINITY else min(limit, present)
    try:
        resource.setrlimit(resource_number, (value, value if is_permanent else upper))
    except (ValueError, OSError):  # macOS rejects a limit of the address space
        return


# ---- Landlock

_LANDLOCK_CREATE_CALL, _LANDLOCK_ADD_CALL, _LANDLOCK_RESTRICT_CALL = 444, 445, 446  # the same numbers on every processor
_READ_FILE_RIGHT, _READ_FOLDER_RIGHT = 1 << 2, 1 << 3
_FILE_RIGHT_BITS_BY_ABI = {1: 13, 2: 14, 3: 15, 4: 15, 5: 16}  # rights that each ABI supports


def restrict_files(folders: Sequence[str]) -> int:
    """Allow files to be opened only for reading, and only if they are in `folders` or are one of these paths. Return the
    Landlock ABI in use, or 0 if Landlock is not available."""
    libc = _load_libc()
    if libc is None or sys.platform != "linux":
        return 0
    abi = int(libc.syscall(_LANDLOCK_CREATE_CALL, None, 0, 1))
    if abi < 1:
        return 0
    files = (1 << _FILE_RIGHT_BITS_BY_ABI[min(abi, 5)]) - 1
    rules = struct.pack("<QQQ", files, 3 if abi >= 4 else 0, 3 if abi >= 6 else 0)[: 8 if abi < 4 else 16 if abi < 6 else 24]
    ruleset = int(libc.syscall(_LANDLOCK_CREATE_CALL, rules, len(rules), 0))
    if ruleset < 0:
        return 0
    try:
        for folder in folders:
            _allow_path(libc, ruleset, folder)
        if libc.prctl(38, 1, 0, 0, 0) or libc.syscall(_LANDLOCK_RESTRICT_CALL, ruleset, 0):
            return 0
    finally:
        os.close(ruleset)
    return abi


def _allow_path(libc: ctypes.CDLL, ruleset: int, path: str) -> None:
    """Allow reading at and below a path. `ruleset`: the handle of a Landlock rule set. A missing path is ignored."""
    try:
        handle = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except OSError:
        return
    try:
        rights = _READ_FILE_RIGHT | (_READ_FOLDER_RIGHT if os.path.isdir(path) else 0)
        libc.syscall(_LANDLOCK_ADD_CALL, ruleset, 1, struct.pack("<Qi", rights, handle), 0)
    finally:
        os.close(handle)


# ---- seccomp

# Numbers of rejected system calls, by processor: x86-64, ARM64 (None: no such call).
_REFUSED_CALL_NUMBERS: dict[str, tuple[int | None, int | None]] = {
    "fork": (57, None), "vfork": (58, None), "execve": (59, 221), "execveat": (322, 281),
    "socket": (41, 198), "connect": (42, 203), "accept": (43, 202), "sendto": (44, 206), "sendmsg": (46, 211),
    "bind": (49, 200), "listen": (50, 201), "socketpair": (53, 199), "accept4": (288, 242), "sendmmsg": (307, 269),
    "creat": (85, None), "rename": (82, None), "renameat": (264, 38), "renameat2": (316, 276), "mkdir": (83, None),
    "mkdirat": (258, 34), "rmdir": (84, None), "link": (86, None), "linkat": (265, 37), "unlink": (87, None),
    "unlinkat": (263, 35), "symlink": (88, None), "symlinkat": (266, 36), "mknod": (133, None), "mknodat": (259, 33),
    "chmod": (90, None), "fchmod": (91, 52), "fchmodat": (268, 53), "fchmodat2": (452, 452), "chown": (92, None),
    "fchown": (93, 55), "lchown": (94, None), "fchownat": (260, 54), "truncate": (76, 45), "utime": (132, None),
    "utimes": (235, None), "utimensat": (280, 88), "futimesat": (261, None), "setxattr": (188, 5), "lsetxattr": (189, 6),
    "fsetxattr": (190, 7), "removexattr": (197, 14), "lremovexattr": (198, 15), "fremovexattr": (199, 16),
    "kill": (62, 129), "tkill": (200, 130), "rt_sigqueueinfo": (129, 138), "pidfd_open": (434, 434),
    "pidfd_send_signal": (424, 424), "pidfd_getfd": (438, 438), "ptrace": (101, 117), "process_vm_readv": (310, 270),
    "process_vm_writev": (311, 271), "mount": (165, 40), "umount2": (166, 39), "pivot_root": (155, 41), "chroot": (161, 51),
    "move_mount": (429, 429), "open_tree": (428, 428), "fsopen": (430, 430), "unshare": (272, 97), "setns": (308, 268),
    "bpf": (321, 280), "perf_event_open": (298, 241), "userfaultfd": (323, 282), "add_key": (248, 217),
    "request_key": (249, 218), "keyctl": (250, 219), "io_uring_setup": (425, 425), "io_uring_enter": (426, 426),
    "io_uring_register": (427, 427), "open_by_handle_at": (304, 265), "init_module": (175, 105), "finit_module": (313, 273),
    "kexec_load": (246, 104), "reboot": (169, 142), "swapon": (167, 224), "acct": (163, 89), "setuid": (105, 146),
    "setgid": (106, 144), "setreuid": (113, 145), "setregid": (114, 143), "setresuid": (117, 147), "setresgid": (119, 149),
    "setgroups": (116, 159), "shmget": (29, 194), "shmat": (30, 196), "msgget": (68, 186), "semget": (64, 190),
    "mq_open": (240, 180), "memfd_create": (319, 279), "inotify_init1": (294, 26), "fanotify_init": (300, 262),
}  # fmt: skip
# Calls that are allowed by their arguments: opening a file, creating a thread, process limits, a signal to a thread, terminal
# control.
_OPEN_CALLS, _OPENAT_CALLS, _OPENAT2_CALLS = (2, None), (257, 56), (437, 437)
_CLONE_CALLS, _CLONE3_CALLS, _PRLIMIT_CALLS, _TGKILL_CALLS, _IOCTL_CALLS = (56, 220), (435, 435), (302, 261), (234, 131), (16, 29)
_ARCHITECTURE_BY_MACHINE = {"x86_64": (0, 0xC000003E), "aarch64": (1, 0xC00000B7)}
_WRITE_FLAGS = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_CLONE_THREAD_FLAG = 0x10000  # CLONE_THREAD
_TIOCSTI_REQUEST = 0x5412
_KILL_ACTION, _ALLOW_ACTION, _FAIL_ACTION = 0x80000000, 0x7FFF0000, 0x00050000
_LOAD_OPCODE, _JUMP_EQUAL_OPCODE, _JUMP_ABOVE_OPCODE, _JUMP_BITS_OPCODE, _RETURN_OPCODE = 0x20, 0x15, 0x35, 0x45, 0x06

BpfInstruction = tuple[int, int, int, int]


def install_call_filter() -> bool:
    """Install the seccomp filter for this process. Return False if the system does not support seccomp."""
    libc = _load_libc()
    if libc is None or sys.platform != "linux" or os.uname().machine not in _ARCHITECTURE_BY_MACHINE or sys.maxsize < 1 << 32:
        return False
    architecture_code, architecture = _ARCHITECTURE_BY_MACHINE[os.uname().machine]
    program = _build_filter(architecture_code, architecture, os.getpid())
    code = b"".join(struct.pack("<HBBI", *each) for each in program)
    buffer = ctypes.create_string_buffer(code, len(code))
    head = struct.pack("@HxxxxxxP", len(program), ctypes.addressof(buffer))
    if libc.prctl(38, 1, 0, 0, 0):
        return False
    return not libc.prctl(22, 2, head, 0, 0)


def _build_filter(architecture_index: int, architecture: int, process: int) -> list[BpfInstruction]:
    """Return the instructions (code, jump if true, jump if false, operand) of the filter, for the classic BSD packet filter."""
    refused = _FAIL_ACTION | errno.EPERM
    lines: list[BpfInstruction] = [
        (_LOAD_OPCODE, 0, 0, 4),
        (_JUMP_EQUAL_OPCODE, 1, 0, architecture),
        (_RETURN_OPCODE, 0, 0, _KILL_ACTION),
        (_LOAD_OPCODE, 0, 0, 0),
    ]
    if architecture_index == 0:  # the x32 calls of x86-64 have separate numbers
        lines += [(_JUMP_ABOVE_OPCODE, 0, 1, 0x40000000), (_RETURN_OPCODE, 0, 0, refused)]
    for call in _REFUSED_CALL_NUMBERS.values():
        lines += _make_call_rule(call[architecture_index], [(_RETURN_OPCODE, 0, 0, refused)])
    for call in (_OPENAT2_CALLS, _CLONE3_CALLS):  # their arguments are in memory; the C library falls back to older calls
        lines += _make_call_rule(call[architecture_index], [(_RETURN_OPCODE, 0, 0, _FAIL_ACTION | errno.ENOSYS)])
    allow, refuse = (_RETURN_OPCODE, 0, 0, _ALLOW_ACTION), (_RETURN_OPCODE, 0, 0, refused)
    lines += _make_call_rule(
        _OPEN_CALLS[architecture_index],
        [(_LOAD_OPCODE, 0, 0, _find_argument_offset(1)), (_JUMP_BITS_OPCODE, 0, 1, _WRITE_FLAGS), refuse, allow],
    )
    lines += _make_call_rule(
        _OPENAT_CALLS[architecture_index],
        [(_LOAD_OPCODE, 0, 0, _find_argument_offset(2)), (_JUMP_BITS_OPCODE, 0, 1, _WRITE_FLAGS), refuse, allow],
    )
    lines += _make_call_rule(
        _CLONE_CALLS[architecture_index],
        [(_LOAD_OPCODE, 0, 0, _find_argument_offset(0)), (_JUMP_BITS_OPCODE, 1, 0, _CLONE_THREAD_FLAG), refuse, allow],
    )
    lines += _make_call_rule(
        _TGKILL_CALLS[architecture_index],
        [(_LOAD_OPCODE, 0, 0, _find_argument_offset(0)), (_JUMP_EQUAL_OPCODE, 1, 0, process), refuse, allow],
    )
    lines += _make_call_rule(
        _PRLIMIT_CALLS[architecture_index],
        [
            (_LOAD_OPCODE, 0, 0, _find_argument_offset(0)),
            (_JUMP_EQUAL_OPCODE, 2, 0, 0),
            (_JUMP_EQUAL_OPCODE, 1, 0, process),
            refuse,
            allow,
        ],
    )
    lines += _make_call_rule(
        _IOCTL_CALLS[architecture_index],
        [(_LOAD_OPCODE, 0, 0, _find_argument_offset(1)), (_JUMP_EQUAL_OPCODE, 0, 1, _TIOCSTI_REQUEST), refuse, allow],
    )
    return [*lines, allow]


def _make_call_rule(number: int | None, actions: list[BpfInstruction]) -> list[BpfInstruction]:
    """Return the instructions that apply `actions` to one system call. The call's number stays loaded for the next test."""
    return [] if number is None else [(_JUMP_EQUAL_OPCODE, 0, len(actions), number), *actions]


def _find_argument_offset(number: int) -> int:
    """Return the offset of the lower half of argument `number` of a system call in the filter's input."""
    return 16 + 8 * number


def _load_libc() -> ctypes.CDLL | None:
    """Return the C library of this process, or None if the system has none."""
    try:
        return ctypes.CDLL(None, use_errno=True)
    except (OSError, TypeError):
        return None


# ---- all of it


def confine_process(readable_folders: Sequence[str]) -> dict[str, int]:
    """Confine this process permanently to reading below `readable_folders`. Return the active layers: `rlimits`, `landlock`
    (with its ABI) and `seccomp`."""
    return {
        "rlimits": int(limit_resources()),
        "landlock": restrict_files(readable_folders),
        "seccomp": int(install_call_filter()),
    }
