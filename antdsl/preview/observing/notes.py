"""Says on the terminal what is otherwise than asked, such as that there is no machine code: each sentence once, as it comes."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from antdsl.preview.session import Session

if TYPE_CHECKING:
    from antdsl.preview.observing.observer import Stop


class Notes:
    """An observer; the live thread's own."""

    def __init__(self) -> None:
        self._said: set[str] = set()

    def stepping(self, session: Session) -> None:
        """What comes is said after the step."""

    def stepped(self, session: Session) -> Stop | None:
        for sentence in session.world.backend.told():
            if sentence not in self._said:
                self._said.add(sentence)
                print(sentence, file=sys.stderr, flush=True)
        return None

    def entered(self, session: Session) -> None:
        """A world that nobody has stepped has nothing to say."""
