"""Caches results about parts of a program, for the next check of an edited program. An editor checks at every key press."""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from antdsl.diagnostics import Diagnostic
from antdsl.program.names.bindings import NameUse
from antdsl.source import Span

if TYPE_CHECKING:
    from antdsl.program.names.scope import Declarations

T = TypeVar("T")
_PartKey = tuple[tuple[Any, ...], int]  # the inputs of a part, and the number of the declarations that it can see


def cached_part(declared: Declarations, key: tuple[Any, ...], make: Callable[[], T]) -> T:
    """Return the cached result of an earlier check if there is one; otherwise compute it by `make`.

    `key`: all inputs of `make`, except `declared.outside`."""
    return make() if declared.memo is None else declared.memo.cached_part(declared, (key, declared.outside), make)


def update_outside(declared: Declarations, outside: Hashable) -> int:
    """Set `declared.outside` to a number that stands for the value `outside`, and return it. Equal values have equal numbers.

    `outside`: all declarations that a part can see of other parts. It may be large, so the keys of parts contain
    its number only."""
    declared.outside = 0 if declared.memo is None else declared.memo.number(outside)
    return declared.outside


@dataclass(frozen=True, slots=True)
class _CachedPart:
    """The cached result of a part, with its effects on the declarations.

    - `said`: the findings.
    - `used`, `written`: the names that it uses, and the attributes that it writes.
    - `expanded`: the number of operations in the behaviours that were expanded for it.
    - `bound`: the names that it resolved."""

    result: Any
    said: tuple[Diagnostic, ...]
    used: frozenset[tuple[str, str]]
    written: frozenset[str]
    expanded: int
    bound: tuple[NameUse, ...]


class _UnknownNames(dict[tuple[str, ...], list[Span]]):
    """The unknown names that were reported. If `silenced`, a part omitted a finding because of an earlier one. Its result must
    not be cached."""

    silenced = False

    def __contains__(self, name: object) -> bool:
        is_known = super().__contains__(name)
        self.silenced = self.silenced or is_known
        return is_known


class CheckMemo:
    """Cached results of parts by their inputs. Entries that a complete check did not use are removed after it."""

    def __init__(self) -> None:
        self.known: dict[_PartKey, _CachedPart] = {}
        self.asked: set[_PartKey] = set()
        self.numbers: dict[Hashable, int] = {}
        self.seen: set[int] = set()
        self.given = 0

    def number(self, value: Hashable) -> int:
        """Return a number for a value. Equal values get the same number as long as the value, or a part that used it, is
        cached."""
        if value not in self.numbers:
            self.given += 1
            self.numbers[value] = self.given
        self.seen.add(self.numbers[value])
        return self.numbers[value]

    def cached_part(self, declared: Declarations, key: _PartKey, make: Callable[[], T]) -> T:
        """Return the result of `make`, or the cached result for the same key. A cached result also restores its findings,
        resolved names, uses and writes."""
        self.asked.add(key)
        known = self.known.get(key)
        if known is None:
            return self._compute(declared, key, make)
        declared.used |= known.used
        declared.written |= known.written
        declared.expanded += known.expanded
        declared.bound += known.bound
        declared.report.extend(known.said)
        return known.result  # type: ignore[no-any-return]

    def _compute(self, declared: Declarations, key: _PartKey, make: Callable[[], T]) -> T:
        said, expanded, unknown_count = len(declared.report.diagnostics), declared.expanded, len(declared.unknown)
        bound = len(declared.bound)
        used, written, names = declared.used, declared.written, declared.unknown
        declared.used, declared.written, declared.unknown = set(), set(), _UnknownNames(names)
        try:
            result = make()
        finally:
            own_used, own_written, own_unknown = declared.used, declared.written, declared.unknown
            declared.used, declared.written, declared.unknown = used | own_used, written | own_written, names | own_unknown
        if len(own_unknown) == unknown_count and not (isinstance(own_unknown, _UnknownNames) and own_unknown.silenced):
            complaints = tuple(declared.report.diagnostics[said:])
            spent = declared.expanded - expanded
            names_there = tuple(declared.bound[bound:])
            self.known[key] = _CachedPart(result, complaints, frozenset(own_used), frozenset(own_written), spent, names_there)
        return result

    def mark_used(self, kinds: Collection[Hashable]) -> None:
        """Mark all results of some kinds of parts as used, because this check left them out. The kind is the first element of the
        key."""
        self.asked |= {key for key in self.known if key[0][0] in kinds}

    def drop_unused(self) -> None:
        """Remove entries that the completed check did not use."""
        self.known = {key: value for key, value in self.known.items() if key in self.asked}
        used_numbers = self.seen.union(outside for _, outside in self.known)
        self.numbers = {value: number for value, number in self.numbers.items() if number in used_numbers}
        self.asked, self.seen = set(), set()
