"""What a row of the tables of the language can say: an argument, a word that is called, a sense, a set, a request to the world.

Rows are data. The functions that lower, compute and settle stand in the tables of their own rooms, under the same `op`.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Arg:
    """One argument. `type`: a type word; `number A` is a number of any dimension, the same for every A of the call; `vector A`
    likewise; `range A` two such numbers (they fill two places of the operation); `count` a whole constant; `any A` anything,
    all alike; `condition` a bool about the element. Of a statement also `added T`, so much a second in a state and an amount
    elsewhere, and `own U`, the name of an attribute of the agent's, in a unit or of a type. `default` as the language would write
    it; `optional` may be absent (None). A constant has to lie above `above` and be whole where `whole` is set. `called`: what it
    is, in a message; `sample`: how a statement may give it."""

    name: str
    type: str
    default: str | None = None
    optional: bool = False
    variadic: bool = False
    above: float | None = None
    whole: bool = False
    called: str = ""
    sample: str = ""


@dataclass(frozen=True, slots=True)
class Cost:
    """What `antdsl check --cost` says of a use: rough weight (one addition is 1), words with `{thing}` (what is named) and
    `{count}`, and the heading. `times`: the number of the argument that multiplies the weight, `often` where that is not a
    constant. `within`: the number of the argument that says how far. `named`: counts only where a thing of the world is named."""

    weight: float
    words: str
    heading: str = "senses"
    times: int | None = None
    often: int = 1
    within: int | None = None
    named: bool = False


@dataclass(frozen=True, slots=True)
class Builtin:
    """A word of the language for an operation of the typed tree, `op`.

    `spoken`: by a `call`, by the bare `name`, or as the `value` of a thing whose name stands where a value is wanted. `called`:
    its name, where that is not `op`. `part`: which result of its sense it is. `sense`: it hangs on the agent, whatever the
    arguments. `draws`: it takes a random number. `interval`: where its values lie. `sample`: how it looks in a line."""

    args: tuple[Arg, ...]
    result: str
    help: str
    op: str
    part: str = ""
    spoken: str = "call"
    called: str = ""
    sense: bool = False
    draws: bool = False
    interval: tuple[float, float] | None = None
    cost: Cost | None = None
    sample: str = ""

    @property
    def name(self) -> str:
        return self.called or self.op


@dataclass(frozen=True, slots=True)
class Part:
    """A result of a sense: its kind as a letter of the plan's table (f, b, i, l); a vector has size 3."""

    name: str
    kind: str = "f"
    size: int = 1


@dataclass(frozen=True, slots=True)
class Sense:
    """An operation of the plan that looks at the world from where the agent stands, and the words that ask it.

    `of`: the kind of thing that its first attribute names, "" for none; `attrs`: further attributes. `operands`: kinds, a letter
    each. `trace`: how a trace says the results, by the names of the parts (for three or more numbers, all of them, if it is not
    given); `nothing`: what it says where the first part is false. `quiet`: a trace does not tell of it."""

    op: str
    of: str
    results: tuple[Part, ...]
    meaning: str
    words: tuple[Builtin, ...] = ()
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
    def spelled(self) -> str:
        """The results and what they mean, as the plan's table says it."""
        if len(self.kinds) == 1:
            return self.meaning
        names = (f"{part.name}{axis} {part.kind}" for part in self.results for axis in ("xyz" if part.size == 3 else ("",)))
        return f"({', '.join(names)}): {self.meaning}"

    def place(self, part: str) -> tuple[int, int]:
        """Where a result stands among all numbers, and how many it has."""
        first = 0
        for each in self.results:
            if each.name == part:
                return first, each.size
            first += each.size
        raise KeyError(part)


@dataclass(frozen=True, slots=True)
class SetSense:
    """A word that gives a set: `op` is the source of a set in the typed tree, `sets` the operations of the plan that it can
    become, `rows` what it takes, told apart by the kind of the first argument."""

    op: str
    rows: tuple[Builtin, ...]
    sets: tuple[str, ...]
    cost: Cost | None
    sample: str
