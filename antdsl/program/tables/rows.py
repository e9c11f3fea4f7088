"""Rows of the tables of the language: an argument, a callable word, a sense, a set, a request to the world.

Rows are data. The functions that lower, compute and settle are in tables of their own packages, under the same `op`."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class ArgumentRow:
    """One argument.

    - `type`: a type word, or one of the following. `number A`: a number of any dimension, equal for every A of the call;
      `vector A` likewise. `range A`: two such numbers, in two places of the operation. `count`: a whole constant.
      `any A`: anything, all of one type. `condition`: a bool about the element.
    - In statements also: `added T`, a rate per second in a state and an amount elsewhere; `own U`, the name of an
      attribute of the agent, in a unit or of a type.
    - `default`: written in the language. `optional`: may be absent (None).
    - `above`, `is_integer`: a constant must be above this, and be whole.
    - `called`: its name in messages. `sample`: an example for statements."""

    name: str
    type: str
    default: str | None = None
    optional: bool = False
    variadic: bool = False
    above: float | None = None
    is_integer: bool = False
    called: str = ""
    sample: str = ""


@dataclass(frozen=True, slots=True)
class UseCost:
    """The cost of a use for `antdsl check --cost`: a rough weight (one addition is 1), a text with `{thing}` (the named thing)
    and `{count}`, and the heading. `times`: the index of the argument that multiplies the weight; `often` is used if that is not
    a constant. `within`: the index of the argument with the distance. `named`: counts only if a thing of the world is named."""

    weight: float
    words: str
    heading: str = "senses"
    times: int | None = None
    often: int = 1
    within: int | None = None
    named: bool = False


@dataclass(frozen=True, slots=True)
class BuiltinRow:
    """A word of the language for an operation of the typed tree, `op`.

    `form`: by a `call`, by the bare `name`, or as the `value` of a thing, if its name is in the place of a value. `called`: its
    name, if that is not `op`. `part`: which result of its sense it is. `sense`: it depends on the agent, whatever the arguments.
    `draws`: it takes a random number. `interval`: the range of its values. `sample`: how it looks in a line."""

    args: tuple[ArgumentRow, ...]
    result: str
    help: str
    op: str
    part: str = ""
    form: str = "call"
    called: str = ""
    sense: bool = False
    draws: bool = False
    interval: tuple[float, float] | None = None
    cost: UseCost | None = None
    sample: str = ""

    @property
    def name(self) -> str:
        return self.called or self.op


_SIGNATURE = re.compile(r"(?P<name>\w+)\((?P<args>.*)\) -> (?P<result>.+)")
_ARG = re.compile(
    r"(?P<name>\w+)(?P<variadic>…?): (?P<whole>whole )?(?P<type>[^=>?]+?)"
    r"( > (?P<above>\S+))?( = (?P<default>.+?))?(?P<optional>\??)"
)


def word(signature: str, help: str, op: str = "", **details: Any) -> BuiltinRow:
    """Return the row of a word by its signature, as an editor shows it: `clamp(x: number A, to: range A) -> number A`.

    `a…: any A` may be given several times, `to: place?` may be absent, and `most: whole number > 0 = 10` must be whole and above
    0, and is 10 where nothing is given. `op`: its operation, if that has another name."""
    parts = _SIGNATURE.fullmatch(signature)
    assert parts is not None, signature
    args = tuple(_argument(each) for each in parts["args"].split(", ") if each)
    return BuiltinRow(args, parts["result"], help, op or parts["name"], called=parts["name"] if op else "", **details)


def _argument(text: str) -> ArgumentRow:
    parts = _ARG.fullmatch(text)
    assert parts is not None, text
    above = None if parts["above"] is None else float(parts["above"])
    optional, variadic, is_integer = (bool(parts[each]) for each in ("optional", "variadic", "whole"))
    return ArgumentRow(parts["name"], parts["type"], parts["default"], optional, variadic, above, is_integer)


@dataclass(frozen=True, slots=True)
class ResultPart:
    """A result of a sense: its kind as a letter of the plan's table (f, b, i, l); a vector has size 3."""

    name: str
    kind: str = "f"
    size: int = 1


@dataclass(frozen=True, slots=True)
class SenseRow:
    """An operation of the plan that reads the world from the agent's position, and the words for it.

    `of`: the kind of thing that its first attribute names, "" for none. `attrs`: further attributes. `operands`: kinds, one
    letter each. `trace`: the trace text of the results, by the names of the parts; without it, three or more numbers are all
    listed. `nothing`: the trace text if the first part is false. `quiet`: left out of traces."""

    op: str
    of: str
    results: tuple[ResultPart, ...]
    meaning: str
    words: tuple[BuiltinRow, ...] = ()
    operands: str = ""
    attrs: tuple[str, ...] = ()
    trace: str = ""
    nothing: str = ""
    quiet: bool = False

    @property
    def kinds(self) -> str:
        """Kinds of all numbers it gives, a letter each."""
        return "".join(part.kind * part.size for part in self.results)

    @property
    def results_text(self) -> str:
        """Return the results and their meaning, as in the plan's table."""
        if len(self.kinds) == 1:
            return self.meaning
        names = (f"{part.name}{axis} {part.kind}" for part in self.results for axis in ("xyz" if part.size == 3 else ("",)))
        return f"({', '.join(names)}): {self.meaning}"

    def place(self, part: str) -> tuple[int, int]:
        """Return the index of a result among all numbers, and its size."""
        first = 0
        for each in self.results:
            if each.name == part:
                return first, each.size
            first += each.size
        raise KeyError(part)


@dataclass(frozen=True, slots=True)
class SetSense:
    """A word that returns a set. `op` is the source of a set in the typed tree, `sets` the operations of the plan that it can
    become. `rows` is what it takes, distinguished by the kind of the first argument."""

    op: str
    rows: tuple[BuiltinRow, ...]
    sets: tuple[str, ...]
    cost: UseCost | None
    sample: str
