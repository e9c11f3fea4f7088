"""The classes of the rows in the language's tables: an argument, a callable word, a sense, a set, a request to the world.

Rows are data. The functions that lower, compute and resolve them are in tables of other packages, where they have the same `op`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class ArgumentRow:
    """One argument of a word.

    - `type`: a type word, or one of the following.
    - `number A`: a number of any dimension. All arguments with the same letter have the same dimension. `vector A`: the same for
      vectors.
    - `range A`: two such numbers, which fill two arguments of the operation.
    - `count`: a constant integer. `any A`: a value of any type, with the same type for every A. `condition`: a bool about the
      element.
    - `added T` (in statements): a rate per second in a state, otherwise an amount.
    - `own U` (in statements): the name of an attribute of the agent, of unit or type U.
    - `default`: the default, as an expression in the language.
    - `is_optional`: the argument may be absent (None). `is_variadic`: the argument may be repeated.
    - `lower_bound`: a constant value must be above this number. `is_integer`: the value must be whole.
    - `display_name`: the name of the argument in messages.
    - `sample`: an example of the argument in a statement."""

    name: str
    type: str
    default: str | None = None
    is_optional: bool = False
    is_variadic: bool = False
    lower_bound: float | None = None
    is_integer: bool = False
    display_name: str = ""
    sample: str = ""


@dataclass(frozen=True, slots=True)
class UseCost:
    """The cost of one use of a word, for `antdsl check --cost`.

    - `weight`: a rough weight; one addition has the weight 1.
    - `text_template`: the text about the use, with `{thing}` for the named thing and `{count}` for the number of uses.
    - `heading`: the heading under which the use is listed.
    - `multiplier_index`: the index of the argument that multiplies the weight. `default_multiplier`: the multiplier if this
      argument is not constant.
    - `distance_index`: the index of the argument that is a distance.
    - `needs_thing`: the use counts only if it names a thing of the world."""

    weight: float
    text_template: str
    heading: str = "senses"
    multiplier_index: int | None = None
    default_multiplier: int = 1
    distance_index: int | None = None
    needs_thing: bool = False


@dataclass(frozen=True, slots=True)
class BuiltinRow:
    """A word of the language. `op` is the operation of the typed tree for which the word stands.

    - `form`: a `call`, a bare `name`, or the `value` of a thing, if the thing's name is used where a value is expected.
    - `word`: the word, if it differs from `op`.
    - `part`: for a sense with several results, the name of the result that the word returns.
    - `depends_on_agent`: whether the value depends on the agent even if all arguments are constant.
    - `uses_draws`: whether the operation uses a random number.
    - `interval`: the smallest and the largest value.
    - `sample`: an example line with the word."""

    args: tuple[ArgumentRow, ...]
    result: str
    help: str
    op: str
    part: str = ""
    form: str = "call"
    word: str = ""
    depends_on_agent: bool = False
    uses_draws: bool = False
    interval: tuple[float, float] | None = None
    cost: UseCost | None = None
    sample: str = ""

    @property
    def name(self) -> str:
        return self.word or self.op


_SIGNATURE_PATTERN = re.compile(r"(?P<name>\w+)\((?P<args>.*)\) -> (?P<result>.+)")
_ARGUMENT_PATTERN = re.compile(
    r"(?P<name>\w+)(?P<variadic>…?): (?P<whole>whole )?(?P<type>[^=>?]+?)"
    r"( > (?P<above>\S+))?( = (?P<default>.+?))?(?P<optional>\??)"
)


def parse_row(signature: str, help: str, op: str = "", **details: Any) -> BuiltinRow:
    """Return the row of a word. `signature`: the word's signature as an editor shows it, such as `clamp(x: number A, to: range
    A) -> number A`.

    - `a…: any A`: may be repeated.
    - `to: place?`: may be absent.
    - `most: whole number > 0 = 10`: must be whole and above 0; the default is 10.
    - `op`: the operation, if its name differs from the word."""
    parts = _SIGNATURE_PATTERN.fullmatch(signature)
    assert parts is not None, signature
    args = tuple(_parse_argument(each) for each in parts["args"].split(", ") if each)
    return BuiltinRow(args, parts["result"], help, op or parts["name"], word=parts["name"] if op else "", **details)


def _parse_argument(text: str) -> ArgumentRow:
    parts = _ARGUMENT_PATTERN.fullmatch(text)
    assert parts is not None, text
    above = None if parts["above"] is None else float(parts["above"])
    optional, variadic, is_integer = (bool(parts[each]) for each in ("optional", "variadic", "whole"))
    return ArgumentRow(parts["name"], parts["type"], parts["default"], optional, variadic, above, is_integer)


@dataclass(frozen=True, slots=True)
class ResultPart:
    """One of the results of a sense. `kind`: one letter for float, bool, row or id (f, b, i, l). `component_count`: 3 for a
    vector, else 1."""

    name: str
    kind: str = "f"
    component_count: int = 1


@dataclass(frozen=True, slots=True)
class SenseRow:
    """An operation of the plan that reads the world at the agent's position, together with its words in the language.

    - `thing_kind`: the kind of thing that its first attribute names; "" for none.
    - `operands`: the kinds of the operands, one letter for each. `attrs`: further attributes.
    - `trace`: the template of the results' text in traces, with the names of parts. If it is empty, three or more numbers are
      listed in full.
    - `empty_trace`: the text in traces if the first result is false.
    - `is_untraced`: whether traces omit the operation."""

    op: str
    thing_kind: str
    results: tuple[ResultPart, ...]
    meaning: str
    words: tuple[BuiltinRow, ...] = ()
    operands: str = ""
    attrs: tuple[str, ...] = ()
    trace: str = ""
    empty_trace: str = ""
    is_untraced: bool = False

    @property
    def kinds(self) -> str:
        """Return the kinds of all result numbers, one letter for each."""
        return "".join(part.kind * part.component_count for part in self.results)

    @property
    def results_text(self) -> str:
        """Return a text with the results and their meanings, as in the table of plan operations."""
        if len(self.kinds) == 1:
            return self.meaning
        names = (
            f"{part.name}{axis} {part.kind}" for part in self.results for axis in ("xyz" if part.component_count == 3 else ("",))
        )
        return f"({', '.join(names)}): {self.meaning}"

    def find_result_index(self, part: str) -> tuple[int, int]:
        """Return the index of a result's first number among all result numbers, and how many numbers it consists of."""
        first = 0
        for each in self.results:
            if each.name == part:
                return first, each.component_count
            first += each.component_count
        raise KeyError(part)


@dataclass(frozen=True, slots=True)
class SetSense:
    """A word that returns a set.

    - `op`: the source of the set in the typed tree.
    - `plan_operations`: the operations of the plan to which it can be lowered.
    - `rows`: its signatures, which differ in the kind of the first argument."""

    op: str
    rows: tuple[BuiltinRow, ...]
    plan_operations: tuple[str, ...]
    cost: UseCost | None
    sample: str
