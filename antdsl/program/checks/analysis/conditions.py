"""Represents conditions as lists of cases. This decides whether a condition can hold, and whether one condition implies another.

The analysis understands comparisons with constants, and tests with equal text. It assumes that any other test may be true or
false."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass

from antdsl.program.checks.analysis.ranges import Interval, range_of
from antdsl.program.model import Binding, BindingRef, Constant, Expr, OperationExpr, Param, TypeKind

_MAX_CASES = 48  # conditions with more cases are not analysed
_SWAPPED_COMPARISONS = {"lt": "gt", "le": "ge", "gt": "lt", "ge": "le", "eq": "eq", "ne": "ne"}
_NEGATED_COMPARISONS = {"lt": "ge", "le": "gt", "gt": "le", "ge": "lt", "eq": "ne", "ne": "eq"}


@dataclass(slots=True)
class ConditionCase:
    """One case of a condition. The case applies if all of its entries hold.

    - `numbers`: the interval in which each number lies, by the key of the number's expression.
    - `tests`: whether each other test is true or false, by the key of the test."""

    numbers: dict[str, Interval] = field(default_factory=dict)
    tests: dict[str, bool] = field(default_factory=dict)

    def intersect(self, other: ConditionCase) -> ConditionCase | None:
        """Return the case in which both cases hold, or None if they exclude each other."""
        numbers, tests = dict(self.numbers), dict(self.tests)
        for key, interval in other.numbers.items():
            numbers[key] = numbers[key].intersect(interval) if key in numbers else interval
            if numbers[key].is_empty:
                return None
        for key, holds in other.tests.items():
            if tests.setdefault(key, holds) != holds:
                return None
        return ConditionCase(numbers, tests)


ConditionCases = list[ConditionCase]


class TooManyCases(Exception):
    """A condition has more cases than the analysis allows."""


# A condition with too many cases, or with lets nested too deeply, is not analysed.
UNREADABLE_CONDITION_ERRORS = (TooManyCases, RecursionError)


@dataclass(slots=True)
class ConditionReader:
    """Reads the conditions of one species. `known`: a range that always contains a number, by the key of its expression."""

    params: Mapping[str, Param]
    known: dict[str, Interval] = field(default_factory=dict)
    keys: dict[int, str] = field(default_factory=dict)
    references: list[object] = field(default_factory=list)  # keeps the objects alive of which `keys` has ids
    # A let may be used in many places and may use other lets, so each is analysed only once.
    ranges: dict[int, Interval] = field(default_factory=dict)
    behind: dict[tuple[int, bool], ConditionCases] = field(default_factory=dict)

    def cases(self, test: Expr | None, holds: bool = True) -> ConditionCases:
        """Return the cases in which a condition is true, or, if `holds` is False, the cases in which it is false. Raises
        TooManyCases."""
        if test is None:
            return [ConditionCase()] if holds else []
        if isinstance(test, BindingRef) and test.binding.role in ("let", "argument") and test.binding.value is not None:
            found = self.behind.get((id(test.binding), holds))
            if found is None:
                found = self.behind[id(test.binding), holds] = self.cases(test.binding.value, holds)
            return found
        if isinstance(test, Constant):
            return [ConditionCase()] if (test.number != 0) == holds else []
        if isinstance(test, OperationExpr) and test.type.kind is TypeKind.BOOL:
            if test.name == "not":
                return self.cases(test.args[0], not holds)
            if test.name in ("and", "or"):
                left, right = (self.cases(arg, holds) for arg in test.args)
                return _combine(left, right) if (test.name == "and") == holds else _limit_cases(left + right)
            if test.name in _SWAPPED_COMPARISONS:
                return self._comparison(test, test.name if holds else _NEGATED_COMPARISONS[test.name])
            if test.name == "is_some":
                return [ConditionCase(tests={f"is_none({self.key(test.args[0])})": not holds})]
        return [ConditionCase(tests={self.key(test): holds})]

    def _comparison(self, test: OperationExpr, name: str) -> ConditionCases:
        left, right = test.args
        assert left is not None and right is not None
        if left.type.kind is not TypeKind.NUMBER:
            same = f"eq({','.join(sorted((self.key(left), self.key(right))))})"
            return [ConditionCase(tests={same: name == "eq"})]
        if _constant_value(left) is not None:
            left, right, name = right, left, _SWAPPED_COMPARISONS[name]
        edge = _constant_value(right)
        if edge is None:  # two variables: compare their difference with 0
            if self.key(left) > self.key(right):
                left, right, name = right, left, _SWAPPED_COMPARISONS[name]
            key = f"{self.key(left)} - {self.key(right)}"
            a, b = range_of(left, self.params, self.ranges), range_of(right, self.params, self.ranges)
            return self._compare_with_edge(key, Interval(a.low - b.high, a.high - b.low), 0.0, name)
        subject, edge, name = _isolate(left, edge, name)
        return self._compare_with_edge(self.key(subject), range_of(subject, self.params, self.ranges), edge, name)

    def _compare_with_edge(self, key: str, known: Interval, edge: float, name: str) -> ConditionCases:
        if not (math.isnan(known.low) or math.isnan(known.high)):
            self.known[key] = known
        below, above = Interval(high=edge, high_open=True), Interval(low=edge, low_open=True)
        alternatives = {
            "lt": (below,), "gt": (above,), "eq": (Interval(edge, edge),), "ne": (below, above),
            "le": (Interval(high=edge),), "ge": (Interval(low=edge),),
        }[name]  # fmt: skip
        intervals = [interval.intersect(self.known.get(key, Interval())) for interval in alternatives]
        return [ConditionCase(numbers={key: interval}) for interval in intervals if not interval.is_empty]

    def key(self, part: object) -> str:
        """Return a key that is equal for expressions of equal meaning. Two random draws, or two memories, never have equal keys.
        Long keys are hashed: with nested lets, the length of a key could otherwise double at each level."""
        if isinstance(part, BindingRef) and part.binding.role in ("let", "argument") and part.binding.value is not None:
            return self.key(part.binding.value)
        known = self.keys.get(id(part))
        if known is None:
            self.references.append(part)
            known = self._key(part)
            if len(known) > 200:
                known = hashlib.blake2b(known.encode(), digest_size=16).hexdigest()
            self.keys[id(part)] = known
        return known

    def _key(self, part: object) -> str:
        if isinstance(part, tuple):
            return f"({','.join(self.key(each) for each in part)})"
        if isinstance(part, Binding):
            return f"{part.role} {part.name} {part.span.start}"
        if not is_dataclass(part):
            return str(part)
        names = (f.name for f in fields(part) if f.name not in ("span", "type", "rate"))
        return f"{type(part).__name__}{tuple(self.key(getattr(part, name)) for name in names)}"


def _constant_value(expr: Expr) -> float | None:
    """Return the value of an expression that is a constant, or a name for a constant; None for any other expression."""
    while isinstance(expr, BindingRef) and expr.binding.role in ("let", "argument") and expr.binding.value is not None:
        expr = expr.binding.value
    return expr.number if isinstance(expr, Constant) and not (expr.u or expr.step) else None


def _isolate(subject: Expr, edge: float, name: str) -> tuple[Expr, float, str]:
    """Solve a comparison for its variable: rewrite `2 * x + 1 > 5` as `x > 2`."""
    while isinstance(subject, OperationExpr) and subject.name in ("neg", "add", "sub", "mul", "div"):
        if subject.name == "neg":
            assert subject.args[0] is not None
            subject, edge, name = subject.args[0], -edge, _SWAPPED_COMPARISONS[name]
            continue
        left, right = subject.args
        assert left is not None and right is not None
        a, b = _constant_value(left), _constant_value(right)
        if subject.name == "add" and (a is not None or b is not None):
            subject, edge = (left, edge - b) if b is not None else (right, edge - (a or 0.0))
        elif subject.name == "sub" and b is not None:
            subject, edge = left, edge + b
        elif subject.name == "mul" and (factor := b if b is not None else a):
            subject, edge, name = (
                (left if b is not None else right),
                edge / factor,
                _SWAPPED_COMPARISONS[name] if factor < 0 else name,
            )
        elif subject.name == "div" and b:
            subject, edge, name = left, edge * b, _SWAPPED_COMPARISONS[name] if b < 0 else name
        else:
            break
    return subject, edge, name


def _combine(left: ConditionCases, right: ConditionCases) -> ConditionCases:
    if len(left) * len(right) > _MAX_CASES:
        raise TooManyCases
    return [case for a in left for b in right if (case := a.intersect(b)) is not None]


def _limit_cases(cases: ConditionCases) -> ConditionCases:
    if len(cases) > _MAX_CASES:
        raise TooManyCases
    return cases


def is_never(reader: ConditionReader, test: Expr | None) -> bool:
    """Return whether a condition cannot hold."""
    try:
        return not reader.cases(test)
    except UNREADABLE_CONDITION_ERRORS:
        return False


def is_always(reader: ConditionReader, test: Expr | None) -> bool:
    """Return whether a condition always holds. The analysis ignores NaN, for which no comparison holds."""
    try:
        return not reader.cases(test, False)
    except UNREADABLE_CONDITION_ERRORS:
        return False


def implies(reader: ConditionReader, narrow: Expr | None, wide: Expr | None) -> bool:
    """Return whether `wide` holds whenever `narrow` does."""
    try:
        return not _combine(reader.cases(narrow), reader.cases(wide, False))
    except UNREADABLE_CONDITION_ERRORS:
        return False
