"""A cache of check results for parts of a program. It makes repeated checks fast, because an editor runs a check at every key
press."""

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


def get_or_compute_part(declarations: Declarations, key: tuple[Any, ...], compute: Callable[[], T]) -> T:
    """Return the cached result of an earlier check. If there is none, compute it.

    `key`: all inputs of `compute`, except the declarations that `outside_number` stands for."""
    return (
        compute()
        if declarations.memo is None
        else declarations.memo.get_or_compute_part(declarations, (key, declarations.outside_number), compute)
    )


def update_outside_number(declarations: Declarations, outside: Hashable) -> int:
    """Set `declarations.outside_number` to a number that identifies the value `outside`, and return it. Equal values have equal
    numbers.

    `outside`: the declarations elsewhere in the program that a part can use. It may be large, so the keys of parts contain only
    its number."""
    declarations.outside_number = 0 if declarations.memo is None else declarations.memo.assign_number(outside)
    return declarations.outside_number


@dataclass(frozen=True, slots=True)
class _CachedPart:
    """The cached result of checking one part of a program, and what the check added to the declarations.

    - `findings`: the findings of the check.
    - `used_names`, `written_attributes`: the names that the part uses, and the attributes that it writes.
    - `expanded_count`: the number of operations in the behaviours that were expanded for the part.
    - `name_uses`: the names that the check resolved."""

    result: Any
    findings: tuple[Diagnostic, ...]
    used_names: frozenset[tuple[str, str]]
    written_attributes: frozenset[str]
    expanded_count: int
    name_uses: tuple[NameUse, ...]


class _UnknownNames(dict[tuple[str, ...], list[Span]]):
    """The spans of all unknown names that were reported, by kind and name.

    `has_omitted_finding`: whether a finding about a part was omitted because an earlier finding has the same cause. In this
    case, the result for the part must not be cached."""

    has_omitted_finding = False

    def __contains__(self, name: object) -> bool:
        is_known = super().__contains__(name)
        self.has_omitted_finding = self.has_omitted_finding or is_known
        return is_known


class CheckResultCache:
    """Cache of check results for parts of a program. The key contains all inputs of the check of a part.

    After a complete check, entries that it did not use are removed."""

    def __init__(self) -> None:
        self.known: dict[_PartKey, _CachedPart] = {}
        self.used_keys: set[_PartKey] = set()
        self.number_by_value: dict[Hashable, int] = {}
        self.numbers_in_use: set[int] = set()
        self.given = 0

    def assign_number(self, value: Hashable) -> int:
        """Return a number for a value. Equal values get the same number as long as the cache contains the value, or a part that
        used it."""
        if value not in self.number_by_value:
            self.given += 1
            self.number_by_value[value] = self.given
        self.numbers_in_use.add(self.number_by_value[value])
        return self.number_by_value[value]

    def get_or_compute_part(self, declarations: Declarations, key: _PartKey, compute: Callable[[], T]) -> T:
        """Return the result of `compute`, or the cached result for the same key. A cached result also restores the findings,
        resolved names, uses and writes of its check."""
        self.used_keys.add(key)
        known = self.known.get(key)
        if known is None:
            return self._compute_part(declarations, key, compute)
        declarations.used_names |= known.used_names
        declarations.written_attributes |= known.written_attributes
        declarations.expanded_count += known.expanded_count
        declarations.name_uses += known.name_uses
        declarations.report.extend(known.findings)
        return known.result  # type: ignore[no-any-return]

    def _compute_part(self, declarations: Declarations, key: _PartKey, compute: Callable[[], T]) -> T:
        said, expanded, unknown_count = (
            len(declarations.report.diagnostics),
            declarations.expanded_count,
            len(declarations.unknown_names),
        )
        bound = len(declarations.name_uses)
        used, written, names = declarations.used_names, declarations.written_attributes, declarations.unknown_names
        declarations.used_names, declarations.written_attributes, declarations.unknown_names = set(), set(), _UnknownNames(names)
        try:
            result = compute()
        finally:
            own_used, own_written, own_unknown = (
                declarations.used_names,
                declarations.written_attributes,
                declarations.unknown_names,
            )
            declarations.used_names, declarations.written_attributes, declarations.unknown_names = (
                used | own_used,
                written | own_written,
                names | own_unknown,
            )
        if len(own_unknown) == unknown_count and not (isinstance(own_unknown, _UnknownNames) and own_unknown.has_omitted_finding):
            complaints = tuple(declarations.report.diagnostics[said:])
            spent = declarations.expanded_count - expanded
            names_there = tuple(declarations.name_uses[bound:])
            self.known[key] = _CachedPart(result, complaints, frozenset(own_used), frozenset(own_written), spent, names_there)
        return result

    def mark_results_used(self, kinds: Collection[Hashable]) -> None:
        """Mark all results of some kinds as used although this check skipped their parts. The kind is the first element of a
        key."""
        self.used_keys |= {key for key in self.known if key[0][0] in kinds}

    def drop_unused_results(self) -> None:
        """Remove entries that the completed check did not use."""
        self.known = {key: value for key, value in self.known.items() if key in self.used_keys}
        used_numbers = self.numbers_in_use.union(outside for _, outside in self.known)
        self.number_by_value = {value: number for value, number in self.number_by_value.items() if number in used_numbers}
        self.used_keys, self.numbers_in_use = set(), set()
