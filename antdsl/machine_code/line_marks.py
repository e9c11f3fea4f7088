"""What an emitter tells of each instruction that it writes: nothing, or where its line is timed, all that the marks need."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import Any, Protocol

from antdsl.machine_code.lanes import Lanes


class Marks(Protocol):
    """What is told of each instruction that is emitted, where its line is timed."""

    def of(self, instruction: Any) -> AbstractContextManager[None]:
        """What is emitted within belongs to an instruction."""

    def elsewhere(self) -> AbstractContextManager[None]:
        """What is emitted within belongs to no line."""

    def count(self) -> None:
        """Add what has passed since the last mark."""

    def before(self) -> None:
        """An instruction is emitted next."""

    def emitted(self, text: str, value: Lanes | None = None) -> None:
        """An instruction has been emitted, with the value that it gives."""

    def block(self) -> None:
        """Another block begins."""


class NoMarks:
    """Of code that is not timed: nothing is written."""

    def of(self, instruction: Any) -> AbstractContextManager[None]:
        return nullcontext()

    def elsewhere(self) -> AbstractContextManager[None]:
        return nullcontext()

    def count(self) -> None:
        pass

    def before(self) -> None:
        pass

    def emitted(self, text: str, value: Lanes | None = None) -> None:
        pass

    def block(self) -> None:
        pass


NO_MARKS = NoMarks()
