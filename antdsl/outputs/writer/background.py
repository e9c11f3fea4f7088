"""Work that goes on behind the caller's back, in order: in a process of its own where the system has processes that go on from
a copy of another, in a thread elsewhere. A process leaves the caller its whole core; a thread takes turns with it."""

from __future__ import annotations

import errno
import gc
import os
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import NoReturn

from antdsl.outputs.writer.process_memory import own_peak_memory
from antdsl.outputs.writer.shared_memory import Arrays, Channel, Message, Pipes, Slot, two_pipes, two_queues

# Windows has no fork; on macOS the system's own libraries may break in a process that was forked and did not begin anew.
OWN_PROCESS = sys.platform == "linux"
_SLOTS = 3  # states that may be under way at once: one in work, two that wait
_STOPS = ("SIGINT", "SIGTERM", "SIGHUP")
_forking = threading.Lock()
_held: list[Pipes] = []  # the caller's ends of all channels to processes; one that is forked later must not keep them open

Work = Callable[[Sequence[str], Arrays], Message]


class Behind:
    """Does `work(jobs, arrays)`, one after the other, for as long as it lives. `told` gets what it gave, in the caller's thread:
    when the next work is handed over, or at the end.

    `arrays` are the caller's own no longer than that call lasts; `work` sees copies, and must be done with them when it returns.
    After an error nothing more is done; it is raised by what is called next, an OSError as it was, a MemoryError as one, any
    other as a RuntimeError. A process that is gone is a ChildProcessError."""

    def __init__(self, work: Work, told: Callable[[Message], None]) -> None:
        self._told = told
        self._problem: Exception | None = None
        self.memory = 0  # the most that the process of its own used besides what it shares, in bytes; known at the end
        self._child: int | None = None
        self._through = False  # it said its last word
        self._slots: list[Slot] = []
        try:
            if OWN_PROCESS:
                self._slots = [Slot(shared=True) for _ in range(_SLOTS)]
                self._fork(work)
        except OSError:  # no process may be made, or no memory shared: a thread needs neither
            self._close_slots()
        if self._child is None:
            self._slots = [Slot(shared=False) for _ in range(_SLOTS)]
            self._start_thread(work)
        self._free = list(range(_SLOTS))
        self._open = True

    def hand_over(self, jobs: Sequence[str], arrays: Arrays) -> None:
        """Have work done; waits where too much is under way."""
        self._hear(wait=False)
        while not self._free and self._open:
            self._hear(wait=True)
        self.check()
        number = self._free.pop()
        try:
            self._channel.send({"slot": number, "jobs": list(jobs), "layout": self._slots[number].fill(arrays)})
        except BrokenPipeError:
            while self._open:
                self._hear(wait=True)
            self.check()

    def finish(self) -> None:
        """Wait until all is done and the process or thread has ended; raises nothing of its own."""
        if self._open:
            self._channel.close()
        while self._open:
            self._hear(wait=True)
        self._close_slots()

    def check(self) -> None:
        """Raise what went wrong."""
        if self._problem is not None:
            raise self._problem

    def _hear(self, *, wait: bool) -> None:
        """Take in what was told: all that is there, or, with `wait`, at least one thing."""
        while self._open:
            try:
                message = self._channel.receive(wait=wait)
            except EOFError:
                self._ended()
                return
            if message is None:
                return
            if "memory" in message:
                self.memory, self._through = message["memory"], True
                continue
            self._free.append(message.pop("slot"))
            if "problem" in message:
                self._problem = self._problem or _problem(message["problem"])
            elif self._problem is None:
                self._told(message)
            wait = False

    def _ended(self) -> None:
        self._open = False
        if self._child is None:
            self._thread.join()
            return
        if isinstance(self._channel, Pipes):
            with _forking:
                _held.remove(self._channel)
                self._channel.drop()
        try:
            code = os.waitstatus_to_exitcode(os.waitpid(self._child, 0)[1])
        except ChildProcessError:  # its exit code is kept from us, as where SIGCHLD was ignored when we were started
            code = None
        if code or not self._through:
            how = f"was ended by signal {-code}" if code and code < 0 else f"ended with {code}" if code else "is gone"
            self._problem = self._problem or ChildProcessError(errno.ECHILD, f"the process that writes it {how}")

    def _close_slots(self) -> None:
        for slot in self._slots:
            slot.close()
        self._slots = []

    def _start_thread(self, work: Work) -> None:
        self._channel: Channel
        self._channel, there = two_queues()

        def live() -> None:
            try:
                _serve(there, self._slots, work)
            finally:
                there.close()

        self._thread = threading.Thread(target=live, name="cache writer", daemon=True)
        self._thread.start()

    def _fork(self, work: Work) -> None:
        with _forking:
            self._fork_alone(work)

    def _fork_alone(self, work: Work) -> None:
        here, there = two_pipes()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, ())
        try:
            # until the new process ignores them, so that no handler of the caller's ever runs in it
            signal.pthread_sigmask(signal.SIG_BLOCK, _stops())
            with warnings.catch_warnings():
                # Python warns where there are threads: a lock that one of them held would stay locked for ever in the new
                # process. It takes none of theirs: it computes with NumPy element by element, hashes and writes files.
                warnings.simplefilter("ignore", DeprecationWarning)
                child = os.fork()
            if child == 0:
                _live(here, there, self._slots, work)
        except OSError:
            here.drop()
            there.drop()
            raise
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        there.drop()
        _held.append(here)
        self._child, self._channel = child, here


def _stops() -> set[signal.Signals]:
    return {signal.Signals[name] for name in _STOPS}


def _live(here: Pipes, there: Pipes, slots: list[Slot], work: Work) -> NoReturn:
    """All that the new process does; it ends here whatever happens, and never goes back into the caller's code."""
    code = 1
    try:
        # Ctrl-C goes to all processes of a terminal: what was handed over is finished, and the caller says when to end
        for number in _stops():
            signal.signal(number, signal.SIG_IGN)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _stops())
        for pipes in (here, *_held):  # else neither it nor others would ever see that the caller is gone
            pipes.drop()
        gc.freeze()  # looking for garbage writes to every object, and so would copy every page that is shared so far
        nothing = os.open(os.devnull, os.O_RDWR)
        os.dup2(nothing, 0)
        os.dup2(nothing, 1)  # who reads the caller's words need not wait for this process
        _serve(there, slots, work)
        with suppress(BrokenPipeError):
            there.send({"memory": own_peak_memory()})
        code = 0
    finally:
        os._exit(code)


def _serve(channel: Channel, slots: list[Slot], work: Work) -> None:
    """Do what comes in until nothing more can come, because the caller is done or gone."""
    failed = False
    while True:
        try:
            message = channel.receive()
        except EOFError:
            return
        assert message is not None
        answer: Message = {"slot": message["slot"]}
        if not failed:
            try:
                answer |= work(message["jobs"], slots[message["slot"]].read(message["layout"]))
            except BaseException as problem:  # told to the caller
                answer["problem"] = _told(problem)
                failed = True
        with suppress(BrokenPipeError):  # the caller was killed: what it handed over is finished all the same
            channel.send(answer)


def _told(problem: BaseException) -> Message:
    """An exception, as can be told between processes."""
    system = isinstance(problem, OSError)
    return {
        "system": system,
        "errno": problem.errno if isinstance(problem, OSError) else None,
        "text": (problem.strerror if isinstance(problem, OSError) else None) or str(problem),
        "file": str(problem.filename) if isinstance(problem, OSError) and problem.filename is not None else None,
        "kind": type(problem).__name__,
        "where": "".join(traceback.format_exception(problem)),
    }


def _problem(told: Message) -> Exception:
    """The exception that was told of."""
    found: Exception
    if told["system"] and told["errno"] is not None:
        found = OSError(told["errno"], told["text"], *([told["file"]] if told["file"] is not None else []))
    elif told["system"]:
        found = OSError(told["text"])
    elif told["kind"] == "MemoryError":
        found = MemoryError(told["text"])
    else:
        found = RuntimeError(f"{told['kind']}: {told['text']}")
    found.add_note("behind the simulation:\n" + told["where"])
    return found
