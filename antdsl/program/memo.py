"""What an earlier check found about parts of a program, for a check of nearly the same program: an editor checks at every key."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from antdsl.program.scope import Declared

T = TypeVar("T")


class Memo:
    """Results of parts that had nothing to complain about, by all that they depend on. What was not asked for in a whole check is
    forgotten after it."""

    def __init__(self) -> None:
        self.known: dict[Hashable, tuple[Any, frozenset[tuple[str, str]], frozenset[str], int]] = {}
        self.asked: set[Hashable] = set()
        self.world: Hashable = None  # what the whole program declares, by which parts depend on each other

    def part(self, declared: Declared, key: Hashable, make: Callable[[], T]) -> T:
        """What `make` gives, or gave for the same key; with it goes what it counted as used and written."""
        self.asked.add(key)
        known = self.known.get(key)
        if known is not None:
            result, used, written, expanded = known
            declared.used |= used
            declared.written |= written
            declared.expanded += expanded
            return result  # type: ignore[no-any-return]
        report, told, expanded = declared.report, len(declared.told), declared.expanded
        before, used_before, written_before = len(report.diagnostics), declared.used, declared.written
        declared.used, declared.written = set(), set()
        try:
            result = make()
        finally:
            used, written = frozenset(declared.used), frozenset(declared.written)
            declared.used, declared.written = used_before, written_before
            declared.used |= used
            declared.written |= written
        if len(report.diagnostics) == before and len(declared.told) == told:
            self.known[key] = result, used, written, declared.expanded - expanded
        return result

    def forget(self) -> None:
        """Drop what the check that has ended did not ask for."""
        self.known = {key: value for key, value in self.known.items() if key in self.asked}
        self.asked = set()
