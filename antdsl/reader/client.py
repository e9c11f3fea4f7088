"""The client of the reader process. It starts the process on demand, and replaces it if it dies, hangs, or uses too much memory.

`send_request` is thread-safe. A process that was forked from this one starts its own reader."""

from __future__ import annotations

import atexit
import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

from antdsl import cpu_budget, limits
from antdsl.numerics.processor.host import get_address_space_limit
from antdsl.reader import PRELOADED_MODULES, READER_FUNCTIONS, confinement
from antdsl.reader.private_folder import PrivateFolder
from antdsl.reader.protocol import Arrays, PipeError, ProtocolError, ReaderMessage, RefusalError, read_message, write_message

_CHILD_PROGRAM = Path(__file__).with_name("child.py")
_MAX_STORED_FAILURES = 256  # failed requests that are not repeated
# Codes that the reader may give in a refusal.
REFUSAL_CODES: Final = frozenset(["bad-image", "bad-mesh", "bad-path", "bad-rig", "bad-usd", "bad-body", "missing-extra",
                          "moving-topology", "no-such-prim", "too-large"])  # fmt: skip


class ReaderFailureError(Exception):
    """Error if the reader gives no answer. It died, used too much time or memory, sent something invalid, or cannot be started.

    The message is worded to follow a file name; `help` says what to do. `is_lasting`: whether the same request would fail again.
    `is_heavy`: whether the request used so much time or memory that other requests about the same files would fail too."""

    def __init__(self, message: str, help: str | None = None, *, is_lasting: bool = True, is_heavy: bool = False) -> None:
        super().__init__(message)
        self.help, self.is_lasting, self.is_heavy = help, is_lasting, is_heavy


class _ReaderProcess:
    """A running reader process, and the layers of confinement that it has reported."""

    def __init__(self, folder: Path, modules: Sequence[str]) -> None:
        readable = [*confinement.list_readable_folders(), str(folder)]
        configuration = json.dumps({"paths": confinement.list_module_folders(), "readable": readable, "modules": modules})
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-S", str(_CHILD_PROGRAM), configuration],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            cwd=folder,
            env=confinement.build_child_environment(),
            start_new_session=True,
        )
        assert self.process.stdin is not None and self.process.stdout is not None
        self.requests, self.answers = self.process.stdin, self.process.stdout
        self.active_layers: dict[str, int] | None = None
        self._counted_cpu_seconds = 0.0

    def read_greeting(self) -> dict[str, int]:
        """Read the first message of the child, and return the layers of confinement in it."""
        if self.active_layers is None:
            active_layers = read_message(self.answers, 0).document.get("active")
            names = ("rlimits", "landlock", "seccomp")
            if not isinstance(active_layers, dict) or not all(type(active_layers.get(name)) is int for name in names):
                raise ProtocolError("the reader did not report its sandbox limits")
            self.active_layers = {name: active_layers[name] for name in names}
        return self.active_layers

    def count_new_cpu_seconds(self, reported: object = None) -> float:
        """Return the CPU seconds used since the last call. `reported`: the child's own total, for systems without one."""
        total = self._counted_cpu_seconds
        try:
            total = time.clock_gettime(~self.process.pid << 3 | 2)  # Linux: the number of a process's clock
        except (AttributeError, OSError):
            if isinstance(reported, float) and math.isfinite(reported):
                total = reported
        return self._count_cpu_seconds(total)

    def wait_for_end(self) -> tuple[int, float]:
        """Kill the child. Return its exit status, and its CPU seconds since the last call of `count_new_cpu_seconds`."""
        self.kill()
        for pipe in (self.requests, self.answers):
            with suppress(OSError):
                pipe.close()
        if self.process.returncode is None and hasattr(os, "wait4"):
            _, status, usage = os.wait4(self.process.pid, 0)
            self.process.returncode = os.waitstatus_to_exitcode(status)
            return self.process.returncode, self._count_cpu_seconds(usage.ru_utime + usage.ru_stime)
        return self.process.wait(), 0.0

    def kill(self) -> None:
        """Kill the child. Unlike `Popen.kill`, this does not reap a dead child, because reaping it later gives its CPU time."""
        if self.process.returncode is None:
            with suppress(OSError):
                os.kill(self.process.pid, getattr(signal, "SIGKILL", signal.SIGTERM))

    def _count_cpu_seconds(self, total: float) -> float:
        previous_seconds, self._counted_cpu_seconds = self._counted_cpu_seconds, max(self._counted_cpu_seconds, total)
        return self._counted_cpu_seconds - previous_seconds

    def close_pipes(self) -> None:
        """Close the pipes to the child without ending it, in a forked process: the child belongs to the parent process."""
        null_device = os.open(os.devnull, os.O_RDWR)
        for pipe in (self.requests, self.answers):
            with suppress(OSError, ValueError):
                os.dup2(null_device, pipe.fileno(), inheritable=False)  # remaining buffered data is discarded
        os.close(null_device)
        self.process.returncode = 0  # so that nothing waits for it


class FileReader:
    """A reader of foreign formats, such as USD, with a child process and a private folder. `send_request` uses it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._reader_process: _ReaderProcess | None = None
        self._folder: PrivateFolder | None = None
        self._failures: OrderedDict[str, tuple[str, str | None]] = OrderedDict()  # messages and help
        self._heavy_failures: dict[str, tuple[str, str | None]] = {}  # the same, by `files`
        self._used_cpu_seconds, self._allowed_cpu_seconds = 0.0, float(limits.READER_CPU_SECONDS_PER_SCENE)  # for this scene
        self._scene_file_digests: set[str] = set()  # `files` of this scene

    def begin_scene(self) -> None:
        """Start a new scene, as the function `begin_scene` describes."""
        with self._lock:
            self._heavy_failures.clear()
            self._scene_file_digests.clear()
            self._used_cpu_seconds, self._allowed_cpu_seconds = 0.0, float(limits.READER_CPU_SECONDS_PER_SCENE)

    def folder(self) -> Path:
        """Return a new empty folder for files that the child may open. Raises OSError if it cannot be created."""
        with self._lock:
            return self._open_private_folder().create_folder()

    def find_active_layers(self) -> dict[str, int]:
        """Return the layers that confine the child: `rlimits`, `landlock` (with its ABI) and `seccomp`; 0 for a missing layer."""
        with self._lock:
            try:
                running = self._start_process()
                with _kill_after_deadline(running, limits.READER_BASE_WALL_SECONDS):
                    return running.read_greeting()
            except (OSError, ProtocolError) as problem:
                self._end_process()
                if get_address_space_limit() < limits.READER_BASE_MEMORY_BYTES:
                    raise MemoryError("the reader process has too little memory to start") from None
                raise ReaderFailureError("the reader process cannot be started") from problem

    def send_request(
        self, kind: str, document: Mapping[str, Any], arrays: Arrays, *, size: int, seconds: int, digest: str, files: str
    ) -> ReaderMessage:
        """Return the answer to a request; see the function `send_request`."""
        with self._lock:
            if files and files not in self._scene_file_digests:
                self._scene_file_digests.add(files)
                self._allowed_cpu_seconds += size / limits.READER_BYTES_PER_CPU_SECOND
            self._reject_repeated_request(digest, files)
            try:
                return self._exchange_messages(kind, document, arrays, size, seconds)
            except ReaderFailureError as error:
                if files and error.is_heavy:
                    self._heavy_failures[files] = (str(error), error.help)
                if digest and error.is_lasting:
                    self._failures[digest] = (str(error), error.help)
                    if len(self._failures) > _MAX_STORED_FAILURES:
                        self._failures.popitem(last=False)
                raise
            except RefusalError:
                raise
            except BaseException:  # interrupted between a request and its answer, or out of memory or time
                self._end_process(is_counted=False)
                raise

    def _reject_repeated_request(self, digest: str, files: str) -> None:
        """Raise ReaderFailureError for a request that failed before. Also raise it for every request once the scene has used its
        CPU time."""
        for failures, key in ((self._failures, digest), (self._heavy_failures, files)):
            if key and key in failures:
                raise ReaderFailureError(*failures[key])
        allowed = self._allowed_cpu_seconds
        if self._used_cpu_seconds > allowed:
            words = f"cannot be read: reading the files of this scene took more than {allowed:,.0f} s of processor time"
            raise ReaderFailureError(words, "use smaller files, or fewer files", is_lasting=False)

    def _exchange_messages(
        self, kind: str, document: Mapping[str, Any], arrays: Arrays, size: int, seconds: int
    ) -> ReaderMessage:
        assert kind in READER_FUNCTIONS
        allowed = seconds + limits.READER_BASE_CPU_SECONDS + size // limits.READER_BYTES_PER_CPU_SECOND
        left = cpu_budget.compute_remaining_cpu_seconds()
        memory = min(limits.READER_BASE_MEMORY_BYTES + limits.READER_MEMORY_PER_FILE_BYTE * size, limits.MAX_READER_MEMORY_BYTES)
        request_document = {**document, "kind": kind, "seconds": allowed if left > allowed else math.ceil(left), "memory": memory}
        previous, late, previous_seconds = self._reader_process, threading.Event(), self._used_cpu_seconds
        try:
            running = self._start_process()
        except OSError as problem:
            words = "cannot be read: the reader process cannot be started"
            raise ReaderFailureError(words, "run `antdsl doctor`", is_lasting=False) from problem
        try:
            with _kill_after_deadline(running, limits.READER_BASE_WALL_SECONDS + 4 * allowed, late):
                running.read_greeting()
                write_message(running.requests, request_document, arrays)
                answer = read_message(running.answers, limits.MAX_READER_ARRAY_BYTES)
        except (PipeError, BrokenPipeError):
            status = self._end_process()
            if status == _KILLED_STATUS and running is previous and not late.is_set():
                # it may have been killed before the request reached it
                return self._exchange_messages(kind, document, arrays, size, seconds)
            if status == _OVERDUE_STATUS and left <= allowed:
                cpu_budget.charge_cpu_seconds(math.inf)  # the budget ended the process, not the limit of a request
            failure = _explain_death(running, status, late.is_set(), memory)
            failure.is_heavy |= self._used_cpu_seconds - previous_seconds > limits.READER_BASE_CPU_SECONDS / 2
            raise failure from None
        except ProtocolError:
            self._end_process()
            raise ReaderFailureError(_INVALID_ANSWER_MESSAGE, _DAMAGED_FILE_HELP) from None
        self._count_cpu_seconds(running.count_new_cpu_seconds(answer.document.get("cpu")))
        return self._check_answer(answer, memory)

    def _count_cpu_seconds(self, seconds: float) -> None:
        """Add CPU seconds of the child to the total of this scene, and charge them to the budget of the check."""
        self._used_cpu_seconds += seconds
        cpu_budget.charge_cpu_seconds(seconds)

    def _check_answer(self, answer: ReaderMessage, memory: int) -> ReaderMessage:
        document = answer.document
        if isinstance(document.get("answer"), dict):
            return ReaderMessage(document["answer"], answer.arrays)
        if "refusal" in document:
            refusal = RefusalError.from_document(document["refusal"], REFUSAL_CODES)
            if refusal is not None:
                raise refusal
        if document.get("failure") == "memory":
            self._end_process()
            raise _make_memory_failure(memory)
        if document.get("failure") == "exception":
            raise ReaderFailureError("cannot be read: the file is damaged", _DAMAGED_FILE_HELP)
        self._end_process()
        raise ReaderFailureError(_INVALID_ANSWER_MESSAGE, _DAMAGED_FILE_HELP)

    def start_early(self, format: str) -> None:
        """Start the reader in advance; see the function `start_reader_early`."""
        with self._lock, suppress(OSError):  # the next request reports why the process cannot be started
            self._start_process(PRELOADED_MODULES[format])

    def _start_process(self, modules: Sequence[str] = ()) -> _ReaderProcess:
        if self._reader_process is not None and self._reader_process.process.poll() is not None:
            self._end_process()  # it died between two requests
        if self._reader_process is None:
            self._reader_process = _ReaderProcess(self._open_private_folder().path, modules)
        return self._reader_process

    def _open_private_folder(self) -> PrivateFolder:
        if self._folder is None:
            self._folder = PrivateFolder()
            if "multiprocessing.util" in sys.modules:  # a process of a pool exits without calling the functions of `atexit`
                from multiprocessing.util import Finalize

                Finalize(None, self.end_reader_process, exitpriority=1)
        return self._folder

    def _end_process(self, *, is_counted: bool = True) -> int:
        """End the child and return its exit status. `is_counted`: whether its CPU time counts."""
        running, self._reader_process = self._reader_process, None
        status, seconds = (0, 0.0) if running is None else running.wait_for_end()
        if is_counted:
            self._count_cpu_seconds(seconds)
        return status

    def end_reader_process(self) -> None:
        """End the child and remove the private folder."""
        with self._lock:
            self._end_process()
            if self._folder is not None:
                self._folder.remove()
            self._folder = None

    def forget_child(self) -> None:
        """Stop using the child after a fork, because it belongs to the parent process."""
        if self._reader_process is not None:
            self._reader_process.close_pipes()


_DAMAGED_FILE_HELP = "export it again"
_SMALLER_FILE_HELP = "use a smaller file, or only a part of this one"
_OVERDUE_STATUS = -getattr(signal, "SIGXCPU", 1 << 20)  # exit statuses
_KILLED_STATUS = -getattr(signal, "SIGKILL", 1 << 20)  # killed by the system when memory runs out
_INVALID_ANSWER_MESSAGE = "cannot be read: the reader process sent an invalid answer"


@contextmanager
def _kill_after_deadline(
    reader_process: _ReaderProcess, seconds: float, late_event: threading.Event | None = None
) -> Iterator[None]:
    """While the context is active, kill a child that has not finished after `seconds` of elapsed time, and set `late_event`."""

    def kill_process() -> None:
        if late_event is not None:
            late_event.set()
        reader_process.kill()

    timer = threading.Timer(seconds, kill_process)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def _explain_death(reader_process: _ReaderProcess, status: int, is_late: bool, memory: int) -> ReaderFailureError:
    """Return the failure for a child that ended without answering a request. `memory`: the bytes that the request may use.

    Raises MemoryError if this process cannot provide that much."""
    if is_late or status == _OVERDUE_STATUS:
        words = "cannot be read: reading the file takes too long"
        return ReaderFailureError(words, _SMALLER_FILE_HELP, is_lasting=not is_late, is_heavy=True)
    if status == _KILLED_STATUS or get_address_space_limit() < memory:
        return _make_memory_failure(memory)
    if reader_process.active_layers is None:
        words = "cannot be read: the reader process exits at its start"
        return ReaderFailureError(words, "run `antdsl doctor`", is_lasting=False)
    words = "the library for its format crashes; the file may be damaged, too large or nested too deeply"
    return ReaderFailureError(f"cannot be read: {words}", _DAMAGED_FILE_HELP)


def _make_memory_failure(needed_bytes: int) -> ReaderFailureError:
    """Return the failure for a request that ran out of memory. Raises MemoryError if the cause is the limit of this process, not
    the limit of the request."""
    if get_address_space_limit() < needed_bytes:
        raise MemoryError("the reader process has no memory")
    return ReaderFailureError("cannot be read: reading the file needs too much memory", _SMALLER_FILE_HELP, is_heavy=True)


_file_reader = FileReader()
atexit.register(lambda: _file_reader.end_reader_process())


def send_request(
    kind: str, document: Mapping[str, Any], arrays: Arrays | None = None, *, file_bytes: int = 0, extra_cpu_seconds: int = 0,
    request_digest: str = "", files_digest: str = "",
) -> ReaderMessage:  # fmt: skip
    """Return the answer to a request. `kind`: a key of READER_FUNCTIONS.

    - `file_bytes`: the total size of its files; large files get more time and memory
    - `extra_cpu_seconds`: additional CPU time
    - `request_digest`: a hash of all inputs of the request, so that a request that failed is not repeated
    - `files_digest`: a hash of the files alone; if one request uses too much, others about them fail until the next scene

    Raises RefusalError if the child reports why it does not read something, and ReaderFailureError if it gives no answer. Raises
    MemoryError if this process cannot provide enough memory, and CpuBudgetSpentError if the budget of a check is spent. The
    caller must not trust the answer."""
    return _file_reader.send_request(
        kind, document, arrays or {}, size=file_bytes, seconds=extra_cpu_seconds, digest=request_digest, files=files_digest
    )


def begin_scene() -> None:
    """Start a new scene. Later requests belong to it and have the full `limits.READER_CPU_SECONDS_PER_SCENE`."""
    _file_reader.begin_scene()


def start_reader_early(format: str) -> None:
    """Start the reader in advance, with the libraries for `format` (a key of PRELOADED_MODULES). Return immediately."""
    _file_reader.start_early(format)


def create_reader_folder() -> Path:
    """Return a new empty folder that the reader may open. The caller may remove it before this process ends."""
    return _file_reader.folder()


def find_active_layers() -> dict[str, int]:
    """Return the layers that confine the reader on this system. Raises ReaderFailureError if the reader cannot be started."""
    return _file_reader.find_active_layers()


_inherited_readers: list[FileReader] = []  # never freed: a thread of the parent process may hold their locks


def end_reader() -> None:
    """End the reader and remove the private folder now. Call this in a process that exits without running `atexit` functions."""
    _file_reader.end_reader_process()


def _forget_inherited_readers() -> None:
    global _file_reader
    _file_reader.forget_child()
    _inherited_readers.append(_file_reader)
    _file_reader = FileReader()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_inherited_readers)
