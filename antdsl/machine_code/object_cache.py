"""Machine code that is kept from run to run: key → the object file that LLVM made, from memory or a folder of the user's own.

What lies there is run, so it has to be what this user's antdsl wrote. A hash finds damage and no attacker: who can write the file
can write the hash. What keeps others out is the folder: the user's own, no link, written to by nobody else, and outside of the
working directory, since a project may bring files of any content. So it is looked at before each reading and writing, and each
file by the handle it is read from. Where anything is not as it should be, `told` says so and code is kept in memory only.
Nothing is raised, whatever the file system does."""

from __future__ import annotations

import errno
import os
import re
import stat
import struct
import sys
import time
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from hashlib import blake2b
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Final

from antdsl.bounded import NotRegular, TooLarge, blocks, open_regular, read_bounded, real_path
from antdsl.limits import MIB
from antdsl.whole import PART, write_whole

if TYPE_CHECKING:
    from antdsl.machine_code.machine import Target

VARIABLE: Final = "ANTDSL_NATIVE_CACHE"
CAP: Final = 256 * MIB
_IN_MEMORY: Final = 16 * MIB
_LARGEST: Final = 64 * MIB  # of one object file
_ENDING: Final = ".object"
_KEY = re.compile("[0-9a-f]{64}")
_NAME = re.compile(f"[0-9a-f]{{64}}{re.escape(_ENDING)}")
_LEFT_OVER = re.compile(rf"\.[0-9a-f]{{40}}\.[0-9a-f]{{12}}{re.escape(PART)}")  # by a run that ended while it wrote
_ABANDONED: Final = 3600.0  # s since such a file was written to; before, another run may be at it
_PIPELINE: Final = "2"  # of text to object file: another number where that changes beside `machine.py`
_MAGIC, _VERSION = b"antdsl\r\n", 1
_HEADER = struct.Struct("<8sI32sQ32s")  # magic, version, key, bytes of the body, their hash
_OF_FOLDERS = os.O_RDONLY | sum(getattr(os, flag, 0) for flag in ("O_DIRECTORY", "O_CLOEXEC"))
_BY_HANDLE = os.open in os.supports_dir_fd and os.scandir in os.supports_fd and hasattr(os, "O_NOFOLLOW")


def key(text: str, target: Target, *, versions: tuple[str, ...]) -> str:
    """The name of the object file made from a text for a target: 64 hexadecimal digits. `versions`: what `versions()` gives. The
    layout of data follows from the triple and LLVM's version."""
    hashed = blake2b(digest_size=32)
    for part in (text, target.triple, target.cpu, target.features, *versions):
        data = part.encode("utf-8", "surrogatepass")
        hashed.update(len(data).to_bytes(8, "little"))  # or the end of one part might be the beginning of the next
        hashed.update(data)
    return hashed.hexdigest()


@cache
def versions() -> tuple[str, ...]:
    """What else machine code depends on: antdsl, the passes and how they are called, llvmlite and LLVM. Imports llvmlite."""
    import llvmlite
    import llvmlite.binding as llvm

    import antdsl
    from antdsl.machine_code import machine

    try:
        passes = blake2b(read_bounded(machine.__file__, MIB), digest_size=16).hexdigest()
    except OSError:  # shipped without its sources
        passes = ""
    return antdsl.__version__, _PIPELINE, passes, str(llvmlite.__version__), ".".join(map(str, llvm.llvm_version_info))


def usual_folder() -> Path | None:
    """Where a user's programs keep what can be made again, by the platform's custom; None where no home is known."""
    try:
        if sys.platform == "win32":
            root = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
        elif sys.platform == "darwin":
            root = Path.home() / "Library" / "Caches"
        else:
            named = os.environ.get("XDG_CACHE_HOME", "")
            root = Path(named) if os.path.isabs(named) else Path.home() / ".cache"  # the custom: one that is relative is none
    except RuntimeError:
        return None
    return root / "antdsl" / "native"


class ObjectCache:
    """`folder`: None for the one that ANTDSL_NATIVE_CACHE names (none at all where that is empty), or else the usual one; `cap`:
    bytes of all files in it, of which those go first that were used longest ago. `told`: sentences for the user on why something
    is not kept or was not used, each once. May be used by several threads, and a folder by several processes: files are put in
    their place whole, and two of one name are the same."""

    def __init__(self, folder: Path | None = None, *, cap: int = CAP) -> None:
        self.told: list[str] = []
        self._cap = cap
        self._memory: OrderedDict[str, bytes] = OrderedDict()
        self._lock = Lock()
        self._folder = folder
        self._own_parts = 1  # how many of the folder's last parts are looked at; those before are made, if need be
        if folder is None:
            named = os.environ.get(VARIABLE)
            if named is not None:
                self._folder = Path(named) if named else None
            else:
                self._folder, self._own_parts = usual_folder(), 2
                if self._folder is None:
                    self._tell(f"compiled code is not kept: no home folder is known; name a folder for it in {VARIABLE}")

    def get(self, key: str) -> bytes | None:
        """The object file of a key of `key`, or None. ValueError for what is no key."""
        name, found = _name(key), None
        if self._folder is not None:
            try:
                with self._opened(self._folder, make=False) as folder:
                    found = self._read(folder, name, bytes.fromhex(key))
            except FileNotFoundError:  # nothing was kept yet
                pass
            except (OSError, ValueError) as problem:
                self._not_kept(self._folder, problem)
        with self._lock:
            if found is None and key in self._memory:
                self._memory.move_to_end(key)
                return self._memory[key]
        return found

    def put(self, key: str, code: bytes) -> None:
        """Keep an object file, in memory where that is the only place. ValueError for what is no key."""
        name = _name(key)
        data = _HEADER.pack(_MAGIC, _VERSION, bytes.fromhex(key), len(code), _hash(code)) + code
        if self._folder is not None:
            try:
                if len(code) > _LARGEST or len(data) > self._cap:
                    raise _Unused(f"{len(code):,} bytes of one program are more than are kept", "it is compiled in each run")
                with self._opened(self._folder, make=True) as folder:
                    write_whole(folder.path / name, data, sync=False, mode=0o600)
                    _make_room(folder, self._cap, name)
                return
            except (OSError, ValueError) as problem:
                self._not_kept(self._folder, problem)
        with self._lock:
            self._memory[key] = code
            self._memory.move_to_end(key)
            while sum(map(len, self._memory.values())) > _IN_MEMORY:
                self._memory.popitem(last=False)

    @contextmanager
    def _opened(self, named: Path, *, make: bool) -> Iterator[_Folder]:
        """The folder, looked at, and made if need be. FileNotFoundError where it is not there; _Unused or another OSError says
        why it is not used."""
        path = Path(os.path.normpath(named))
        _demand_outside(path)
        root = path.parents[self._own_parts - 1]
        if make:
            for each in reversed([each for each in (root, *root.parents) if not os.path.exists(each)]):
                with suppress(FileExistsError):
                    os.mkdir(each, 0o700)
        with ExitStack() as opened:
            folder = _Folder(root, _open_folder(opened, root) if _BY_HANDLE else None)
            _demand_settled(root)
            for part in path.parts[len(root.parts) :]:
                folder = _below(opened, folder, part, make)
            yield folder

    def _read(self, folder: _Folder, name: str, key: bytes) -> bytes | None:
        """The body of a file; None where there is none, or it is not to be used, which is told."""
        try:
            handle = open_regular(folder.named(name), follow=False, folder=folder.handle)
        except FileNotFoundError:
            return None
        except OSError as problem:
            return self._refused(folder, name, _words(problem))
        try:
            about = os.fstat(handle)
            # none at all: another run has just put the same in its place
            wrong = _not_own(about) or ("it is a link, of which there is another" if about.st_nlink > 1 else "")
            data = b"" if wrong else b"".join(blocks(handle, _HEADER.size + _LARGEST))
            if wrong := wrong or _damage(data, key):
                return self._refused(folder, name, wrong)
            with suppress(OSError):  # a disk that is only read
                os.utime(handle if os.utime in os.supports_fd else folder.named(name))
            return data[_HEADER.size :]
        except TooLarge as problem:
            return self._refused(folder, name, str(problem.strerror))
        finally:
            os.close(handle)

    def _refused(self, folder: _Folder, name: str, why: str) -> bytes | None:
        """Tell of a file that is not used, and take it away if it is ours. A link is taken away, what it leads to is not."""
        left = "left where it is"
        with suppress(OSError):
            if not _strange(os.stat(folder.named(name), dir_fd=folder.handle, follow_symlinks=False)):
                os.unlink(folder.named(name), dir_fd=folder.handle)
                left = "removed"
        self._tell(f"compiled code in {_shown(folder.path / name)} is not used: {why}; it is {left}, and made anew")
        return None

    def _not_kept(self, folder: Path, problem: OSError | ValueError) -> None:
        advice = f"name another folder in {VARIABLE}"
        if isinstance(problem, _Unused):
            advice = problem.advice
        elif isinstance(problem, OSError) and problem.errno == errno.ENOSPC:
            advice = f"make room there, or {advice}"
        self._tell(f"compiled code is not kept in {_shown(folder)}: {_words(problem)}; {advice}")

    def _tell(self, sentence: str) -> None:
        with self._lock:
            if sentence not in self.told:
                self.told.append(sentence)


class _Unused(OSError):
    """A folder or an object file that is not as it should be; `why` and `advice` are halves of a sentence."""

    def __init__(self, why: str, advice: str) -> None:
        super().__init__(errno.EPERM, why)
        self.advice = advice


@dataclass(frozen=True, slots=True)
class _Folder:
    """`handle`: of the folder that was looked at; None where the system opens none (Windows)."""

    path: Path
    handle: int | None

    def named(self, name: str) -> str:
        """What a file in it is called where `handle` is given along."""
        return name if self.handle is not None else str(self.path / name)


def _open_folder(opened: ExitStack, name: str | Path, parent: int | None = None, flags: int = 0) -> int:
    handle = os.open(name, _OF_FOLDERS | flags, dir_fd=parent)
    opened.callback(os.close, handle)
    return handle


def _below(opened: ExitStack, parent: _Folder, part: str, make: bool) -> _Folder:
    """A folder of our own in another; _Unused where it is anything else."""
    path, named = parent.path / part, parent.named(part)
    if make:
        with suppress(FileExistsError):
            os.mkdir(named, 0o700, dir_fd=parent.handle)
    _demand_own(path, os.stat(named, dir_fd=parent.handle, follow_symlinks=False))
    if parent.handle is None:
        return _Folder(path, None)
    handle = _open_folder(opened, part, parent.handle, os.O_NOFOLLOW)
    _demand_own(path, os.fstat(handle))  # another may have taken its place
    return _Folder(path, handle)


def _demand_own(path: Path, about: os.stat_result) -> None:
    other = f"name another folder in {VARIABLE}"
    if stat.S_ISLNK(about.st_mode) or getattr(about, "st_reparse_tag", False):
        raise _Unused(f"{_shown(path)} is a link", f"name the folder that it leads to in {VARIABLE}")
    if not stat.S_ISDIR(about.st_mode):
        raise _Unused(f"{_shown(path)} is no folder", other)
    if _strange(about):
        raise _Unused(f"{_shown(path)} belongs to another user", other)
    if _not_own(about):
        raise _Unused(f"others may write to {_shown(path)}", f"delete what is in it and take that right away, or {other}")


def _demand_settled(parent: Path) -> None:
    """Refuse a folder in which anybody may put another of the user's folders in our folder's place."""
    mode = os.stat(parent).st_mode
    if hasattr(os, "geteuid") and mode & stat.S_IWOTH and not mode & stat.S_ISVTX:
        raise _Unused(f"anybody may move what is in {_shown(parent)}", f"name another folder in {VARIABLE}")


def _demand_outside(path: Path) -> None:
    """Refuse a folder that a project may have brought along: one in the working directory, unless that holds the user's home and
    so is no project's folder."""
    other = f"name a folder elsewhere in {VARIABLE}"
    if not path.is_absolute():
        raise _Unused("the path does not begin at the root", f"write a whole path in {VARIABLE}")
    if not path.name:
        raise _Unused("it is the root of all folders", other)
    try:
        working = os.stat(os.curdir)
    except OSError:  # it was deleted
        return
    if _within(path, working):
        with suppress(RuntimeError):  # no home
            if _within(Path.home(), working):
                return
        raise _Unused("it lies in the working directory, and a project might have brought it along", other)


def _within(path: Path, folder: os.stat_result) -> bool:
    """Whether a path, or the one without links that it stands for, is a folder or lies in it."""
    real = real_path(path)
    for each in {path, *path.parents, real, *real.parents}:
        with suppress(OSError):
            if os.path.samestat(os.stat(each), folder):
                return True
    return False


def _strange(about: os.stat_result) -> bool:
    """Whether something belongs to another user. On Windows access lists say who may write, and those of a user's own folders are
    made so by the system."""
    return hasattr(os, "geteuid") and about.st_uid != os.geteuid()


def _not_own(about: os.stat_result) -> str:
    """Why something may not be what the user's own programs wrote, or nothing."""
    if _strange(about):
        return "it belongs to another user"
    return "others may write to it" if hasattr(os, "geteuid") and about.st_mode & (stat.S_IWGRP | stat.S_IWOTH) else ""


def _damage(data: bytes, key: bytes) -> str:
    """Why a file's content is not the object file of a key, or nothing."""
    if len(data) < _HEADER.size:
        return "it is cut short"
    magic, version, of, size, hashed = _HEADER.unpack_from(data)
    body = data[_HEADER.size :]
    if (magic, version) != (_MAGIC, _VERSION):
        return "it is in another form"
    if of != key:
        return "it is another program's"
    if size != len(body) or hashed != _hash(body):
        return "it is damaged"
    return ""


def _make_room(folder: _Folder, cap: int, keep: str) -> None:
    """Remove what was used longest ago until at most `cap` bytes are left, and what runs that were killed left behind. Files of
    other names are nobody's business here; what another run removes meanwhile is removed."""
    found: list[tuple[int, str, int]] = []
    with os.scandir(folder.path if folder.handle is None else folder.handle) as entries:
        for entry in entries:
            kept = _NAME.fullmatch(entry.name)
            if not (kept or _LEFT_OVER.fullmatch(entry.name)):
                continue
            with suppress(FileNotFoundError):
                about = entry.stat(follow_symlinks=False)
                if kept:
                    found.append((about.st_mtime_ns, entry.name, about.st_size))
                elif time.time() - about.st_mtime > _ABANDONED:
                    os.unlink(folder.named(entry.name), dir_fd=folder.handle)
    above = sum(size for _, _, size in found) - cap
    for _, name, size in sorted(found):
        if above <= 0:
            break
        if name != keep:
            with suppress(FileNotFoundError):
                os.unlink(folder.named(name), dir_fd=folder.handle)
            above -= size


def _name(key: str) -> str:
    if not _KEY.fullmatch(key):
        raise ValueError(f"{key!r} is not 64 hexadecimal digits")
    return key + _ENDING


def _hash(body: bytes) -> bytes:
    return blake2b(body, digest_size=32).digest()


def _words(problem: OSError | ValueError) -> str:
    if isinstance(problem, NotRegular):
        return f"it is {problem.kind}"
    if isinstance(problem, OSError):
        return problem.strerror or "the system refuses it"
    return "no folder has such a name"  # one with a zero character


def _shown(path: Path) -> str:
    return "`" + "".join(c if c.isprintable() else "\ufffd" for c in str(path)) + "`"
