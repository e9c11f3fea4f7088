"""What one input may do: end with a report or a documented error, within a time and a memory limit, and open nothing outside its
folder. `Oracle.run` feeds one input and returns an `Outcome`."""

from __future__ import annotations

import os
import resource
import sys
import threading
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from types import CodeType, FrameType
from typing import Any
from zlib import crc32

from antdsl.limits import MIB

ROOT = Path(__file__).resolve().parents[2]
CPU_SECONDS = 2.0  # of one input, in the units of `machine_scale`
MEMORY_BYTES = 256 * MIB  # above the memory in use before the input
_PROGRAMS = ("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.spawn", "os.fork", "pty.spawn")
_NETWORK = ("socket.connect", "socket.bind", "socket.getaddrinfo", "socket.gethostbyname", "socket.sendto")
_DELETIONS = (
    "os.remove",
    "os.rename",
    "os.rmdir",
    "os.mkdir",
    "os.link",
    "os.symlink",
    "os.truncate",
    "os.chmod",
    "shutil.rmtree",
)
_SYSTEM = ("/dev/null", "/dev/urandom", "/proc/", "/sys/")

Feed = Callable[[bytes], str]


class Violation(Exception):
    """A feed found a broken promise: `kind` names it, such as `layout` for a format that is not idempotent."""

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(text)
        self.kind = kind


@dataclass(frozen=True)
class Finding:
    """A broken promise. `signature` is the same for inputs with the same cause."""

    kind: str
    signature: str
    detail: str


@dataclass(frozen=True)
class Outcome:
    """What one input did: the report text (empty after an exception), CPU seconds, bytes of memory above the start."""

    report: str
    seconds: float
    memory: int
    findings: tuple[Finding, ...]


class Paths:
    """Call sites executed: each pair of a call site and a called function that no earlier input reached."""

    def __init__(self, known: set[int]) -> None:
        self.known = known
        self._seen: set[int] = set()
        self._fresh: list[int] = []

    def _called(self, frame: FrameType, event: str, arg: object) -> None:
        back = frame.f_back
        key = id(frame.f_code) << 20 ^ (back.f_lasti if back is not None else 0)
        if key not in self._seen:
            self._seen.add(key)
            site = crc32(f"{_name(frame.f_code)}<{_name(back.f_code) if back else ''}:{back.f_lasti if back else 0}".encode())
            if site not in self.known:
                self._fresh.append(site)

    def start(self) -> None:
        self._fresh = []
        threading.settrace(self._called)
        sys.settrace(self._called)

    def stop(self) -> list[int]:
        """The call sites that are new since `start`, which are known from now on."""
        sys.settrace(None)
        threading.settrace(None)  # type: ignore[arg-type]
        fresh = [each for each in dict.fromkeys(self._fresh) if each not in self.known]
        self.known.update(fresh)
        return fresh


def _name(code: CodeType) -> str:
    return f"{code.co_filename}:{code.co_firstlineno}:{code.co_name}"


class Guard:
    """Notes what is opened, started or connected outside of what is allowed. An audit hook stays until the process ends."""

    def __init__(self, folder: Path, allowed: tuple[str, ...]) -> None:
        self.allowed = allowed
        self.active = False
        self.noted: list[str] = []
        folders = [str(folder), os.path.realpath(folder), str(ROOT), sys.prefix, sys.base_prefix, os.path.realpath(sys.prefix)]
        folders += [os.path.realpath(path) for path in sys.path if path]
        folders += [os.environ[name] for name in ("ANTDSL_NATIVE_CACHE",) if name in os.environ]
        self.readable = tuple(place.rstrip("/") + "/" for place in folders)
        self.writable = tuple(
            place.rstrip("/") + "/" for place in (str(folder), os.path.realpath(folder), *folders[6 + len(sys.path) :])
        )
        sys.addaudithook(self._hook)

    def _hook(self, event: str, args: tuple[Any, ...]) -> None:
        if not self.active:
            return
        if event == "open":
            self._opened(args[0], args[2] if len(args) > 2 else 0)
        elif event == "exec" and isinstance(args[0], CodeType):
            file = args[0].co_filename
            if not file.startswith("<") and not self._is_below(file, self.readable):
                self.noted.append(f"exec {file}")
        elif ((event in _PROGRAMS or event in _NETWORK) and event not in self.allowed) or (
            event in _DELETIONS and isinstance(args[0], str | bytes) and not self._is_below(os.fsdecode(args[0]), self.writable)
        ):
            self.noted.append(f"{event} {str(args)[:120]}")

    def _opened(self, path: object, flags: object) -> None:
        if not isinstance(path, str | bytes | os.PathLike):
            return
        name = os.fsdecode(path)
        writes = isinstance(flags, int) and bool(flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))
        if not self._is_below(name, self.writable if writes else self.readable) and not name.startswith(_SYSTEM):
            self.noted.append(f"open {name}{' for writing' if writes else ''}")

    @staticmethod
    def _is_below(name: str, folders: tuple[str, ...]) -> bool:
        """A relative path counts as one inside the folder unless it leads upwards: the working directory is the folder."""
        if not os.path.isabs(name):
            return ".." not in name.split("/")
        return (os.path.normpath(name) + "/").startswith(folders)


class Oracle:
    """Feeds inputs one after the other in this process, with the working directory `folder`."""

    def __init__(self, feed: Feed, folder: Path, allowed: tuple[str, ...] = ()) -> None:
        self.feed, self.guard = feed, Guard(folder, allowed)

    def run(self, data: bytes, paths: Paths | None = None) -> Outcome:
        """Feed one input. `paths` notes the call sites, which makes the time longer."""
        findings: list[Finding] = []
        report = ""
        start_memory, high = _memory(reset=True)
        self.guard.noted.clear()
        began = process_time() + _of_children()
        with warnings.catch_warnings():
            warnings.filterwarnings("error", category=RuntimeWarning, module=r"antdsl(\.|$)")
            if paths is not None:
                paths.start()
            self.guard.active = True
            try:
                report = self.feed(data)
            except Violation as why:
                findings.append(Finding(why.kind, f"{why.kind} {str(why)[:60]}", str(why)))
            except RuntimeWarning as why:
                findings.append(_exception("warning", why))
            except Exception as why:
                findings.append(_exception("memory" if isinstance(why, MemoryError) else "exception", why))
            finally:
                self.guard.active = False
        seconds = process_time() + _of_children() - began
        _, high = _memory()
        findings += [Finding("outside", f"outside {each}", each) for each in dict.fromkeys(self.guard.noted)]
        if high - start_memory > MEMORY_BYTES:
            findings.append(Finding("memory", "memory", f"{(high - start_memory) // MIB} MiB above the start"))
        return Outcome(report, seconds, max(0, high - start_memory), tuple(findings))


def _exception(kind: str, why: BaseException) -> Finding:
    """The signature is the type and the last line inside the product, so that each cause counts once."""
    stack = traceback.extract_tb(why.__traceback__)
    own = [each for each in stack if "/antdsl/" in each.filename] or list(stack)
    last = own[-1]
    place = f"{Path(last.filename).name}:{last.lineno} {last.name}"
    return Finding(kind, f"{type(why).__name__} at {place}", "".join(traceback.format_exception(why))[-4000:])


def _memory(reset: bool = False) -> tuple[int, int]:
    """The memory in use and the greatest since the last reset, in bytes; where the system has no reset, since the start."""
    if reset:
        try:
            with open("/proc/self/clear_refs", "w") as file:
                file.write("5")
        except OSError:
            pass
    high = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    try:
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * resource.getpagesize(), high
    except OSError:
        return high, high


def _of_children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def machine_scale() -> float:
    """How much slower this machine is now than the one for which `CPU_SECONDS` holds; at least 1."""
    began = process_time()
    total = 0
    for number in range(300_000):
        total += number & 7
    return max(1.0, (process_time() - began) / 0.03)
