"""What an earlier check found about parts of a program, for a check of nearly the same program: an editor checks at every key."""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from antdsl.diagnostics import Diagnostic
from antdsl.program.names.bindings import Use
from antdsl.source import Span

if TYPE_CHECKING:
    from antdsl.program.names.scope import Declared

T = TypeVar("T")
_Key = tuple[tuple[Any, ...], int]  # what a part is and depends on, and a number for all that it can see of the others


def part(declared: Declared, key: tuple[Any, ...], make: Callable[[], T]) -> T:
    """What `make` gives, or gave in an earlier check of which somebody kept the memo. The key holds all that it depends on
    besides `declared.outside`."""
    return make() if declared.memo is None else declared.memo.part(declared, (key, declared.outside), make)


def seen(declared: Declared, outside: Hashable) -> int:
    """Sets `declared.outside` to a number for all that parts can see of the others from here on, and gives it. What there is to
    see may be long: it is looked at once, not with each part's key."""
    declared.outside = 0 if declared.memo is None else declared.memo.number(outside)
    return declared.outside


@dataclass(frozen=True, slots=True)
class _Known:
    """What came out of a part. `expanded`: the operations of behaviours that were put in place for it."""

    result: Any
    said: tuple[Diagnostic, ...]
    used: frozenset[tuple[str, str]]
    written: frozenset[str]
    expanded: int
    bound: tuple[Use, ...]


class _Unknown(dict[tuple[str, ...], list[Span]]):
    """Unknown names that were told. A part that kept silent because of them may have to speak another time."""

    silenced = False

    def __contains__(self, name: object) -> bool:
        found = super().__contains__(name)
        self.silenced = self.silenced or found
        return found


class Memo:
    """Results of parts by all that they depend on. What was not asked for in a whole check is forgotten after it."""

    def __init__(self) -> None:
        self.known: dict[_Key, _Known] = {}
        self.asked: set[_Key] = set()
        self.numbers: dict[Hashable, int] = {}
        self.seen: set[int] = set()
        self.given = 0

    def number(self, value: Hashable) -> int:
        """A number for a value: the same for an equal one, as long as neither it nor a part that saw it is forgotten."""
        if value not in self.numbers:
            self.given += 1
            self.numbers[value] = self.given
        self.seen.add(self.numbers[value])
        return self.numbers[value]

    def part(self, declared: Declared, key: _Key, make: Callable[[], T]) -> T:
        """What `make` gives, or gave for the same key; with it goes what it complained about, what it resolved names to, and what
        it counted as used and written."""
        self.asked.add(key)
        known = self.known.get(key)
        if known is None:
            return self._made(declared, key, make)
        declared.used |= known.used
        declared.written |= known.written
        declared.expanded += known.expanded
        declared.bound += known.bound
        declared.report.extend(known.said)
        return known.result  # type: ignore[no-any-return]

    def _made(self, declared: Declared, key: _Key, make: Callable[[], T]) -> T:
        said, expanded, told = len(declared.report.diagnostics), declared.expanded, len(declared.unknown)
        bound = len(declared.bound)
        used, written, names = declared.used, declared.written, declared.unknown
        declared.used, declared.written, declared.unknown = set(), set(), _Unknown(names)
        try:
            result = make()
        finally:
            own_used, own_written, own_unknown = declared.used, declared.written, declared.unknown
            declared.used, declared.written, declared.unknown = used | own_used, written | own_written, names | own_unknown
        if len(own_unknown) == told and not (isinstance(own_unknown, _Unknown) and own_unknown.silenced):
            complaints = tuple(declared.report.diagnostics[said:])
            spent = declared.expanded - expanded
            names_there = tuple(declared.bound[bound:])
            self.known[key] = _Known(result, complaints, frozenset(own_used), frozenset(own_written), spent, names_there)
        return result

    def keep(self, kinds: Collection[Hashable]) -> None:
        """Count what is known of some kinds of parts, by the first of their key, as asked for: it was left out this time."""
        self.asked |= {key for key in self.known if key[0][0] in kinds}

    def forget(self) -> None:
        """Drop what the check that has ended did not ask for."""
        self.known = {key: value for key, value in self.known.items() if key in self.asked}
        seen = self.seen.union(outside for _, outside in self.known)
        self.numbers = {value: number for value, number in self.numbers.items() if number in seen}
        self.asked, self.seen = set(), set()
