"""Represents conditions as lists of cases, to decide whether a condition can hold and whether it implies another one.

The analysis understands comparisons with constants, and recognises tests with equal text. Any other test may be true or false."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass

from antdsl.program.checks.analysis.ranges import Interval, compute_range
from antdsl.program.model import Binding, BindingRef, Constant, Expr, OperationExpr, Param, TypeKind

_MAX_CASES = 48  # conditions with more cases are not analysed
_MIRRORED_COMPARISON_BY_OPERATION = {"lt": "gt", "le": "ge", "gt": "lt", "ge": "le", "eq": "eq", "ne": "ne"}
_NEGATED_COMPARISONS = {"lt": "ge", "le": "gt", "gt": "le", "ge": "lt", "eq": "ne", "ne": "eq"}


@dataclass(slots=True)
class ConditionCase:
    """One case in which a condition holds. The case applies if all of its entries are true.

    - `intervals`: the interval that contains a number, by the key of the number's expression.
    - `truth_by_test`: whether a test is true, by the key of the test. It contains all tests except comparisons with constants."""

    intervals: dict[str, Interval] = field(default_factory=dict)
    truth_by_test: dict[str, bool] = field(default_factory=dict)

    def intersect(self, other: ConditionCase) -> ConditionCase | None:
        """Return the case in which both this case and `other` apply, or None if they exclude each other."""
        numbers, tests = dict(self.intervals), dict(self.truth_by_test)
        for key, interval in other.intervals.items():
            numbers[key] = numbers[key].intersect(interval) if key in numbers else interval
            if numbers[key].is_empty:
                return None
        for key, holds in other.truth_by_test.items():
            if tests.setdefault(key, holds) != holds:
                return None
        return ConditionCase(numbers, tests)


ConditionCases = list[ConditionCase]


class TooManyCasesError(Exception):
    """Error for a condition with more cases than the analysis allows."""


# A condition with too many cases, or with lets nested too deeply, is not analysed.
UNREADABLE_CONDITION_ERRORS = (TooManyCasesError, RecursionError)


@dataclass(slots=True)
class ConditionReader:
    """Converter of the conditions of one species to lists of cases. It caches the results.

    - `range_by_key`: by the key of an expression, a range that contains all of its values.
    - `key_by_id`, `range_by_expr_id`, `cached_cases`: caches by the `id()` of an expression or binding.
    - `retained_parts`: the objects with these ids. They are retained, because a new object could get the id of a freed one.
    """

    params: Mapping[str, Param]
    range_by_key: dict[str, Interval] = field(default_factory=dict)
    key_by_id: dict[int, str] = field(default_factory=dict)
    retained_parts: list[object] = field(default_factory=list)
    # A let may be used in many places and may use other lets, so each is analysed only once.
    range_by_expr_id: dict[int, Interval] = field(default_factory=dict)
    cached_cases: dict[tuple[int, bool], ConditionCases] = field(default_factory=dict)

    def read_cases(self, test: Expr | None, is_true: bool = True) -> ConditionCases:
        """Return the cases in which a condition is true or, if `is_true` is False, the cases in which it is false.

        Raises TooManyCasesError."""
        if test is None:
            return [ConditionCase()] if is_true else []
        if isinstance(test, BindingRef) and test.binding.role in ("let", "argument") and test.binding.value is not None:
            found = self.cached_cases.get((id(test.binding), is_true))
            if found is None:
                found = self.cached_cases[id(test.binding), is_true] = self.read_cases(test.binding.value, is_true)
            return found
        if isinstance(test, Constant):
            return [ConditionCase()] if (test.number != 0) == is_true else []
        if isinstance(test, OperationExpr) and test.type.kind is TypeKind.BOOL:
            if test.name == "not":
                return self.read_cases(test.args[0], not is_true)
            if test.name in ("and", "or"):
                left, right = (self.read_cases(arg, is_true) for arg in test.args)
                return _intersect_cases(left, right) if (test.name == "and") == is_true else _check_case_count(left + right)
            if test.name in _MIRRORED_COMPARISON_BY_OPERATION:
                return self._read_comparison(test, test.name if is_true else _NEGATED_COMPARISONS[test.name])
            if test.name == "is_some":
                return [ConditionCase(truth_by_test={f"is_none({self.make_key(test.args[0])})": not is_true})]
        return [ConditionCase(truth_by_test={self.make_key(test): is_true})]

    def _read_comparison(self, test: OperationExpr, name: str) -> ConditionCases:
        left, right = test.args
        assert left is not None and right is not None
        if left.type.kind is not TypeKind.NUMBER:
            same = f"eq({','.join(sorted((self.make_key(left), self.make_key(right))))})"
            return [ConditionCase(truth_by_test={same: name == "eq"})]
        if _find_constant_value(left) is not None:
            left, right, name = right, left, _MIRRORED_COMPARISON_BY_OPERATION[name]
        edge = _find_constant_value(right)
        if edge is None:  # with two variables, compare their difference with 0
            if self.make_key(left) > self.make_key(right):
                left, right, name = right, left, _MIRRORED_COMPARISON_BY_OPERATION[name]
            key = f"{self.make_key(left)} - {self.make_key(right)}"
            a, b = (
                compute_range(left, self.params, self.range_by_expr_id),
                compute_range(right, self.params, self.range_by_expr_id),
            )
            return self._make_comparison_cases(key, Interval(a.low - b.high, a.high - b.low), 0.0, name)
        subject, edge, name = _isolate_variable(left, edge, name)
        return self._make_comparison_cases(
            self.make_key(subject), compute_range(subject, self.params, self.range_by_expr_id), edge, name
        )

    def _make_comparison_cases(self, key: str, known_range: Interval, limit: float, name: str) -> ConditionCases:
        """Return the cases of the comparison `name` (such as `lt`) between the number with the key `key` and `limit`.

        `known_range`: a range that always contains the number."""
        if not (math.isnan(known_range.low) or math.isnan(known_range.high)):
            self.range_by_key[key] = known_range
        below, above = Interval(high=limit, is_high_open=True), Interval(low=limit, is_low_open=True)
        alternatives = {
            "lt": (below,), "gt": (above,), "eq": (Interval(limit, limit),), "ne": (below, above),
            "le": (Interval(high=limit),), "ge": (Interval(low=limit),),
        }[name]  # fmt: skip
        intervals = [interval.intersect(self.range_by_key.get(key, Interval())) for interval in alternatives]
        return [ConditionCase(intervals={key: interval}) for interval in intervals if not interval.is_empty]

    def make_key(self, part: object) -> str:
        """Return a key that is equal for expressions with the same meaning. Two random draws, or two memories, never have equal
        keys.

        Long keys are replaced by their hashes. Otherwise, each level of nested lets could double the length of a key."""
        if isinstance(part, BindingRef) and part.binding.role in ("let", "argument") and part.binding.value is not None:
            return self.make_key(part.binding.value)
        known = self.key_by_id.get(id(part))
        if known is None:
            self.retained_parts.append(part)
            known = self._build_key(part)
            if len(known) > 200:
                known = hashlib.blake2b(known.encode(), digest_size=16).hexdigest()
            self.key_by_id[id(part)] = known
        return known

    def _build_key(self, part: object) -> str:
        if isinstance(part, tuple):
            return f"({','.join(self.make_key(each) for each in part)})"
        if isinstance(part, Binding):
            return f"{part.role} {part.name} {part.span.start}"
        if not is_dataclass(part):
            return str(part)
        names = (f.name for f in fields(part) if f.name not in ("span", "type", "rate"))
        return f"{type(part).__name__}{tuple(self.make_key(getattr(part, name)) for name in names)}"


def _find_constant_value(expr: Expr) -> float | None:
    """Return the value of an expression that is a constant, or a name for a constant. Return None for any other expression."""
    while isinstance(expr, BindingRef) and expr.binding.role in ("let", "argument") and expr.binding.value is not None:
        expr = expr.binding.value
    return expr.number if isinstance(expr, Constant) and not (expr.unit_power or expr.step) else None


def _isolate_variable(subject: Expr, limit: float, name: str) -> tuple[Expr, float, str]:
    """Solve the comparison of `subject` with a constant for its variable: `2 * x + 1 > 5` becomes `x > 2`.

    Returns the variable, the new constant, and the name of the comparison (such as `gt`). A negative factor reverses the
    comparison."""
    while isinstance(subject, OperationExpr) and subject.name in ("neg", "add", "sub", "mul", "div"):
        if subject.name == "neg":
            assert subject.args[0] is not None
            subject, limit, name = subject.args[0], -limit, _MIRRORED_COMPARISON_BY_OPERATION[name]
            continue
        left, right = subject.args
        assert left is not None and right is not None
        a, b = _find_constant_value(left), _find_constant_value(right)
        if subject.name == "add" and (a is not None or b is not None):
            subject, limit = (left, limit - b) if b is not None else (right, limit - (a or 0.0))
        elif subject.name == "sub" and b is not None:
            subject, limit = left, limit + b
        elif subject.name == "mul" and (factor := b if b is not None else a):
            subject, limit, name = (
                (left if b is not None else right),
                limit / factor,
                _MIRRORED_COMPARISON_BY_OPERATION[name] if factor < 0 else name,
            )
        elif subject.name == "div" and b:
            subject, limit, name = left, limit * b, _MIRRORED_COMPARISON_BY_OPERATION[name] if b < 0 else name
        else:
            break
    return subject, limit, name


def _intersect_cases(left: ConditionCases, right: ConditionCases) -> ConditionCases:
    """Return the cases in which both conditions hold. Raises TooManyCasesError."""
    if len(left) * len(right) > _MAX_CASES:
        raise TooManyCasesError
    return [case for a in left for b in right if (case := a.intersect(b)) is not None]


def _check_case_count(cases: ConditionCases) -> ConditionCases:
    """Return the cases unchanged. Raises TooManyCasesError if there are too many for the analysis."""
    if len(cases) > _MAX_CASES:
        raise TooManyCasesError
    return cases


def is_always_false(reader: ConditionReader, test: Expr | None) -> bool:
    """Return whether a condition can never hold. The result is False if the analysis cannot decide."""
    try:
        return not reader.read_cases(test)
    except UNREADABLE_CONDITION_ERRORS:
        return False


def is_always_true(reader: ConditionReader, test: Expr | None) -> bool:
    """Return whether a condition always holds. The result is False if the analysis cannot decide.

    The analysis ignores NaN, for which no comparison holds."""
    try:
        return not reader.read_cases(test, False)
    except UNREADABLE_CONDITION_ERRORS:
        return False


def does_condition_imply(reader: ConditionReader, premise: Expr | None, conclusion: Expr | None) -> bool:
    """Return whether `conclusion` holds whenever `premise` holds. The result is False if the analysis cannot decide."""
    try:
        return not _intersect_cases(reader.read_cases(premise), reader.read_cases(conclusion, False))
    except UNREADABLE_CONDITION_ERRORS:
        return False
