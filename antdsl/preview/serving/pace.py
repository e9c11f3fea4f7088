"""How much one client may ask in a time."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic


class Bucket:
    """Holds up to `most` and fills at `rate` a second; each thing takes one out. `clock` counts seconds."""

    def __init__(self, rate: float, most: float, clock: Callable[[], float] = monotonic) -> None:
        self._rate, self._most, self._clock = rate, most, clock
        self._holds, self._at = most, clock()

    def take(self) -> bool:
        """Take one; False where there is none."""
        now = self._clock()
        self._holds = min(self._most, self._holds + (now - self._at) * self._rate)
        self._at = now
        if self._holds < 1:
            return False
        self._holds -= 1
        return True
