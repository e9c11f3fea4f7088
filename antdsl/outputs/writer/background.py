"""Work that goes on behind the caller's back, in order, in a thread of its own.

A thread, and no process: it is handed arrays as they are, where a process would need them copied into memory that both see; and
nearly all that it does (checksums, hashes, files) is done without the interpreter's lock."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from queue import SimpleQueue
from typing import Any

_MOST = 3  # works handed over that are not done: one under way, and those that wait for it

Found = Mapping[str, Any]
Work = Callable[[], Found]


class Behind:
    """Does what is handed over, one after the other. `told` gets what each gave, in the caller's thread: when the next is handed
    over, or at the end.

    After an error nothing more is done; it is raised by what is called next."""

    def __init__(self, told: Callable[[Found], None]) -> None:
        self._told = told
        self._work: SimpleQueue[Work | None] = SimpleQueue()
        self._found: SimpleQueue[Found | None] = SimpleQueue()  # one for each work, None where it was not done
        self._left = 0  # works of which nothing has been heard
        self._problem: BaseException | None = None
        # a daemon: a disk that never answers must not keep the program from ending; all it could leave is a file beside its place
        self._thread = threading.Thread(target=self._live, name="cache writer", daemon=True)
        self._thread.start()

    def hand_over(self, work: Work) -> None:
        """Have work done; waits where too much is under way."""
        self._hear(_MOST - 1)
        self.check()
        self._left += 1
        self._work.put(work)

    def finish(self) -> None:
        """Wait until all is done and the thread has ended; raises nothing of its own."""
        if self._thread.is_alive():
            self._work.put(None)
            self._thread.join()
        self._hear(self._left)

    def check(self) -> None:
        """Raise what went wrong."""
        if self._problem is not None:
            raise self._problem

    def _hear(self, most: int) -> None:
        """Tell of what was found out since; waits until nothing is to be heard of so many works at most."""
        while self._left > most or not self._found.empty():
            found = self._found.get()
            self._left -= 1
            if found is not None:
                self._told(found)

    def _live(self) -> None:
        while (work := self._work.get()) is not None:
            found = None
            if self._problem is None:
                try:
                    found = work()
                except BaseException as problem:  # raised in the caller's thread
                    self._problem = problem
            self._found.put(found)
