"""System calls of this process on files below a folder, seen from below: they are counted, made to fail, or recorded.

`antdsl/atomic_write.py` writes all files, so what is patched here is under every writer of caches, checkpoints, exports,
pictures and tables. `Faults` fails one call; `Disk` keeps what is durable and says what a power loss leaves."""

from __future__ import annotations

import errno
import os
import random
import signal
import threading
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, field
from io import FileIO
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar
from unittest.mock import patch

Result = TypeVar("Result")
Do = Callable[[], Result]
_BY_PATH = ("replace", "rename", "link", "unlink", "remove", "mkdir", "rmdir")
_BY_HANDLE = ("fsync", "ftruncate", "write", "writev")


class SystemCalls(AbstractContextManager["SystemCalls"]):
    """Hands each call on a path or an open file below a folder to `call`, from any thread."""

    def __init__(self, root: Path) -> None:
        self.root = os.path.realpath(root)
        self.handles: dict[int, str] = {}
        self._lock = threading.RLock()
        self._patches = ExitStack()
        self.real: dict[str, Callable[..., Any]] = {name: getattr(os, name) for name in (*_BY_PATH, *_BY_HANDLE, "open", "close")}

    def call(self, name: str, path: str, do: Do[Result], *arguments: Any) -> Result:
        """One call of the system, `name` on `path`: what `do` does. `arguments`: the other path of a move, the data of a
        write."""
        return do()

    def _below(self, path: Any) -> str | None:
        """A path as a whole one, where it is the folder or lies below it."""
        if isinstance(path, int):
            return None
        full_path = os.path.normpath(os.path.join(os.getcwd(), os.fsdecode(path)))
        return full_path if full_path == self.root or full_path.startswith(self.root + os.sep) else None

    def _passed(self, name: str, path: str, do: Do[Result], *arguments: Any) -> Result:
        with self._lock:
            return self.call(name, path, do, *arguments)

    def __enter__(self) -> SystemCalls:
        for name in _BY_PATH:
            self._patches.enter_context(patch.object(os, name, self._of_path(name)))
        for name in _BY_HANDLE:
            self._patches.enter_context(patch.object(os, name, self._of_handle(name)))
        self._patches.enter_context(patch.object(os, "open", self._open))
        self._patches.enter_context(patch.object(os, "close", self._close))
        calls = self

        class Written(FileIO):
            def write(self, data: Any) -> int:
                os_write = calls._of_handle("write")
                written: int = os_write(self.fileno(), data)
                return written

        self._patches.enter_context(patch("antdsl.atomic_write.FileIO", Written))
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None) -> None:
        self._patches.close()

    def _of_path(self, name: str) -> Callable[..., Any]:
        real = self.real[name]

        def called(path: Any, *words: Any, **keywords: Any) -> Any:
            below = None if keywords.get("dir_fd") is not None else self._below(path)
            if below is None:
                return real(path, *words, **keywords)
            others = [os.path.abspath(os.fsdecode(words[0]))] if name in ("replace", "rename", "link") else []
            return self._passed(name, below, lambda: real(path, *words, **keywords), *others)

        return called

    def _of_handle(self, name: str) -> Callable[..., Any]:
        real = self.real[name]

        def called(handle: Any, *words: Any) -> Any:
            path = self.handles.get(handle) if isinstance(handle, int) else None
            if path is None:
                return real(handle, *words)
            data = [b"".join(words[0]) if name == "writev" else bytes(words[0])] if name in ("write", "writev") else list(words)
            return self._passed(name, path, lambda: real(handle, *words), handle, *data)

        return called

    def _open(self, path: Any, flags: int, mode: int = 0o777, *, dir_fd: int | None = None) -> int:
        real = self.real["open"]
        below = None if dir_fd is not None else self._below(path)
        if below is None:
            handle: int = real(path, flags, mode, dir_fd=dir_fd)
            return handle
        handle = self._passed("open", below, lambda: real(path, flags, mode), flags)
        self.handles[handle] = below
        return handle

    def _close(self, handle: int) -> None:
        self.handles.pop(handle, None)
        self.real["close"](handle)


@dataclass(frozen=True, slots=True)
class Fault:
    """What happens at a call. `number`: of the error; `short`: a write takes half of its data before that; `lasting`: each call
    after it that needs room fails too, as on a full disk; `kill`: the process is killed instead, amid a write."""

    number: int = errno.ENOSPC
    short: bool = False
    lasting: bool = False
    kill: bool = False

    def __str__(self) -> str:
        words = "kill" if self.kill else errno.errorcode[self.number]
        return words + " short" * self.short + " lasting" * self.lasting


FAULTS = (
    Fault(errno.ENOSPC, short=True, lasting=True), Fault(errno.ENOSPC), Fault(errno.EIO), Fault(errno.EIO, short=True),
    Fault(errno.EDQUOT, lasting=True), Fault(errno.EACCES), Fault(errno.EROFS, lasting=True), Fault(errno.EINTR),
    Fault(errno.ENOENT), Fault(errno.EMFILE),
)  # fmt: skip
_NEED_ROOM = ("write", "writev", "mkdir", "open", "fsync")


class Faults(SystemCalls):
    """Fails call `at` (from 0) of those below a folder; `count` says how many there were, `hit` what was failed."""

    def __init__(self, root: Path, at: int | None = None, fault: Fault = FAULTS[0]) -> None:
        super().__init__(root)
        self.at, self.fault = at, fault
        self.count = 0
        self.hit: str | None = None
        self.seen: list[str] = []

    def call(self, name: str, path: str, do: Do[Result], *arguments: Any) -> Result:
        number, self.count = self.count, self.count + 1
        self.seen.append(f"{name} {os.path.relpath(path, self.root)}")
        later = self.at is not None and number > self.at and self.fault.lasting and self._needs_room(name, arguments)
        if number != self.at and not later:
            return do()
        if number == self.at:
            self.hit = self.seen[-1]
        if self.fault.short and name in ("write", "writev") and len(arguments[1]) > 1:
            self.real["write"](arguments[0], arguments[1][: len(arguments[1]) // 2])
        if self.fault.kill:
            os.kill(os.getpid(), signal.SIGKILL)
        of_handle = name in _BY_HANDLE
        raise OSError(self.fault.number, os.strerror(self.fault.number), None if of_handle else path)

    def _needs_room(self, name: str, arguments: tuple[Any, ...]) -> bool:
        return name in _NEED_ROOM and (name != "open" or bool(arguments[0] & os.O_CREAT))


# --- power loss -----------------------------------------------------------------------------------------------------------


@dataclass(slots=True)
class _Content:
    """Of one file: what is on the disk for sure, and what was written since, each a (place, bytes) or a new length."""

    durable: bytes = b""
    since: list[tuple[int, bytes] | int] = field(default_factory=list)

    def with_changes(self, count: int | None = None) -> bytes:
        """With the first `count` changes done, all for None."""
        data = bytearray(self.durable)
        for change in self.since[:count]:
            if isinstance(change, int):
                del data[change:]
                data.extend(bytes(change - len(data)))
            else:
                place, new = change
                data.extend(bytes(max(0, place - len(data))))
                data[place : place + len(new)] = new
        return bytes(data)


Names = dict[str, int]  # of a folder: the file or folder behind each name
_Change = tuple[str, str, str, int]  # of names: what was done, the name, the other name, what is behind it

STYLES = ("nothing", "names", "zeros", "garbage", "contents", "torn")


class Disk(SystemCalls):
    """Records calls below a folder, and says what is on the disk after a power loss at any of them.

    The model allows the worst that POSIX does: a content is durable once its file was synced, a name once its folder was. In
    between any beginning of the changes of each file and each folder may be there, and a file may have its length before its
    bytes. What is there when recording begins is durable."""

    def __init__(self, root: Path) -> None:
        super().__init__(root)
        self.calls: list[tuple[Any, ...]] = []
        self._next = 1
        self._begin: tuple[dict[int, _Content], dict[int, Names]] = ({}, {0: {}})
        self._numbers = {self.root: 0}  # files and folders by path, as they are now
        self._take(Path(self.root))

    def _take(self, folder: Path) -> None:
        contents, folders = self._begin
        for path in sorted(folder.iterdir()):
            number = self._number(str(path))
            folders[self._numbers[str(folder)]][path.name] = number
            if path.is_dir():
                folders[number] = {}
                self._take(path)
            else:
                contents[number] = _Content(path.read_bytes())

    def _number(self, path: str) -> int:
        self._numbers[path], self._next = self._next, self._next + 1
        return self._numbers[path]

    def call(self, name: str, path: str, do: Do[Result], *arguments: Any) -> Result:
        place = os.path.dirname(path)
        if name == "open":
            new = bool(arguments[0] & os.O_CREAT) and path not in self._numbers
            result = do()
            if new:
                self.calls.append(("create", self._numbers[place], os.path.basename(path), self._number(path)))
            return result
        if name in ("write", "writev"):
            handle = arguments[0]
            offset = os.fstat(handle).st_size if self._appends(handle) else os.lseek(handle, 0, os.SEEK_CUR)
            result = do()
            assert isinstance(result, int)
            self.calls.append(("write", self._numbers[path], offset, arguments[1][:result]))
            return result
        result = do()
        base = os.path.basename(path)
        if name == "ftruncate":
            self.calls.append(("truncate", self._numbers[path], arguments[1]))
        elif name == "fsync":
            self.calls.append(("sync", self._numbers[path]))
        elif name == "mkdir":
            self.calls.append(("mkdir", self._numbers[place], base, self._number(path)))
        elif name in ("replace", "rename"):
            number = self._numbers.pop(path)
            self._numbers[arguments[0]] = number
            assert os.path.dirname(arguments[0]) == place
            self.calls.append(("rename", self._numbers[place], base, os.path.basename(arguments[0])))
        elif name in ("unlink", "remove", "rmdir"):
            self._numbers.pop(path, None)
            self.calls.append(("unlink", self._numbers[place], base))
        return result

    def _appends(self, handle: int) -> bool:
        import fcntl

        return bool(fcntl.fcntl(handle, fcntl.F_GETFL) & os.O_APPEND)

    def loss(self, at: int, style: str, to: Path, seed: int = 0) -> None:
        """Write into an empty folder what a power loss leaves that comes before call `at`."""
        chance = random.Random(f"{at} {style} {seed}")
        contents = {number: _Content(each.durable) for number, each in self._begin[0].items()}
        folders = {number: dict(names) for number, names in self._begin[1].items()}
        waiting: dict[int, list[_Change]] = {number: [] for number in folders}
        for what, number, *arguments in self.calls[:at]:
            if what == "write":
                contents[number].since.append((arguments[0], arguments[1]))
            elif what == "truncate":
                contents[number].since.append(arguments[0])
            elif what == "sync" and number in contents:
                contents[number] = _Content(contents[number].with_changes())
            elif what == "sync":
                _change(folders[number], waiting[number])
                waiting[number] = []
            elif what == "rename":
                waiting[number].append((what, arguments[0], arguments[1], 0))
            elif what == "unlink":
                waiting[number].append((what, arguments[0], "", 0))
            else:
                waiting[number].append(("create", arguments[0], "", arguments[1]))
                if what == "mkdir":
                    folders[arguments[1]], waiting[arguments[1]] = {}, []
                else:
                    contents[arguments[1]] = _Content()
        for number, changes in waiting.items():
            change_count = {"nothing": 0, "contents": 0, "torn": chance.randint(0, len(changes))}.get(style, len(changes))
            _change(folders[number], changes[:change_count])
        self._write(0, to, folders, {number: _left(each, style, chance) for number, each in contents.items()})

    def _write(self, number: int, to: Path, folders: Mapping[int, Names], contents: Mapping[int, bytes]) -> None:
        to.mkdir(parents=True, exist_ok=True)
        for name, each in folders[number].items():
            if each in folders:
                self._write(each, to / name, folders, contents)
            else:
                (to / name).write_bytes(contents[each])


def _change(names: Names, changes: list[_Change]) -> None:
    for what, name, other, number in changes:
        if what == "create":
            names[name] = number
        elif what == "unlink":
            names.pop(name, None)
        elif name in names:
            names[other] = names.pop(name)


def _left(content: _Content, style: str, chance: random.Random) -> bytes:
    """What is in a file after a power loss."""
    complete_data, durable = content.with_changes(), content.durable
    if style in ("nothing", "names") or not content.since:
        return durable
    if style == "contents":
        return complete_data
    if style == "torn":
        new_data = content.with_changes(chance.randint(0, len(content.since)))
        return new_data[: chance.randint(min(len(durable), len(new_data)), len(new_data))]
    fill = (lambda count: bytes(count)) if style == "zeros" else chance.randbytes
    return durable[: len(complete_data)] + fill(max(0, len(complete_data) - len(durable)))
