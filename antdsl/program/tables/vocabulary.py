"""The built-in words of the language as tables: units, types, built-in names, and built-in operations with costs and ranges.

The checker uses the tables to type calls, the lowering has one rule per operation, and the editor displays the help. To add an
operation, add one row here and one rule in `plan/lowering/rules`. Senses are rows of `program/tables/senses`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import inf, pi

from antdsl.program.model import Dimension, TypeKind
from antdsl.program.tables import senses, set_senses
from antdsl.program.tables.rows import BuiltinRow, UseCost, parse_row
from antdsl.program.tables.things import KIND_BY_WORD
from antdsl.syntax.editions import EDITIONS

LENGTH_DIMENSION, TIME_DIMENSION, MASS_DIMENSION, ANGLE_DIMENSION = (
    Dimension(length=1),
    Dimension(time=1),
    Dimension(mass=1),
    Dimension(angle=1),
)
SPEED_DIMENSION = Dimension(length=1, time=-1)
FORCE_DIMENSION = Dimension(length=1, time=-2, mass=1)


@dataclass(frozen=True, slots=True)
class UnitRow:
    """A unit of the language. Its value in base units (mm, s, g, rad) has three factors.

    They are `factor`, the scene's unit (mm) to the power `unit_power`, and the step length `dt` to the power `step`."""

    dim: Dimension
    factor: float
    unit_power: int = 0
    step: int = 0


UNIT_BY_NAME: dict[str, UnitRow] = {
    "mm": UnitRow(LENGTH_DIMENSION, 1.0),
    "cm": UnitRow(LENGTH_DIMENSION, 10.0),
    "m": UnitRow(LENGTH_DIMENSION, 1000.0),
    "u": UnitRow(LENGTH_DIMENSION, 1.0, unit_power=1),
    "s": UnitRow(TIME_DIMENSION, 1.0),
    "min": UnitRow(TIME_DIMENSION, 60.0),
    "step": UnitRow(TIME_DIMENSION, 1.0, step=1),
    "rad": UnitRow(ANGLE_DIMENSION, 1.0),
    "deg": UnitRow(ANGLE_DIMENSION, pi / 180.0),
    "turn": UnitRow(ANGLE_DIMENSION, 2.0 * pi),
    "mg": UnitRow(MASS_DIMENSION, 0.001),
    "g": UnitRow(MASS_DIMENSION, 1.0),
    "kg": UnitRow(MASS_DIMENSION, 1000.0),
    "N": UnitRow(FORCE_DIMENSION, 1e6),
    "uN": UnitRow(FORCE_DIMENSION, 1.0),
    "%": UnitRow(Dimension(), 0.01),
}

# Type words of `behaviour` arguments, results and annotations. A word that is not a dimension is a Kind of the model.
TYPE_BY_WORD: dict[str, Dimension | str] = {
    "number": Dimension(),
    "length": LENGTH_DIMENSION,
    "time": TIME_DIMENSION,
    "angle": ANGLE_DIMENSION,
    "mass": MASS_DIMENSION,
    "speed": SPEED_DIMENSION,
    "force": FORCE_DIMENSION,
    "area": Dimension(length=2),
    "push": "push",  # a vector without dimension
    "vector": "vector",  # any dimension
    "position": "position",  # a vector of length
    "velocity": "velocity",  # a vector of speed
    "bool": "bool",
    "place": "place",  # anything with a position: an item, an agent, a curve
    "item": "item",
    "agent": "agent",
    "field": "field",
    **{kind.value: kind.value for kind in TypeKind if kind.value in KIND_BY_WORD and KIND_BY_WORD[kind.value].type_meaning},
}


@dataclass(frozen=True, slots=True)
class BuiltinAttribute:
    """An attribute that every agent has.

    - `is_settable`: whether a species may set the attribute without `=`, and statements may assign it.
    - `default`: the default as text in the language. `edition`: the first edition that has the attribute.
    - `can_be_unlimited`: whether the value `none`, which means no limit, is allowed.
    - `is_for_standing`: whether only species with upright bodies have it.
    - `max_value`: the largest value, in base units."""

    type: str
    is_settable: bool
    default: str | None  # as text of the language; `EDITION_DEFAULTS` overrides it
    help: str
    edition: int = 1  # the first edition that has it
    can_be_unlimited: bool = False  # whether `none` says that there is no limit
    is_for_standing: bool = False  # whether only species with standing bodies, which set it, have it
    max_value: float = inf  # the greatest value, in base units
    can_be_zero: bool = False


BUILTIN_ATTRIBUTE_BY_NAME: dict[str, BuiltinAttribute] = {
    "position": BuiltinAttribute("position", False, None, "where it stands"),
    "velocity": BuiltinAttribute("velocity", False, None, "how it moves; may be set in `on` and `enter`"),
    "heading": BuiltinAttribute(
        "push", False, None, "where it faces, a unit vector along the surface; may be set in `on` and `enter`"
    ),
    "up": BuiltinAttribute("push", False, None, "normal of the surface, a unit vector"),
    "speed": BuiltinAttribute("speed", False, None, "the length of its velocity"),
    "moved": BuiltinAttribute(
        "length", False, None, "how far contacts pushed it in the step before; 0 where bodies take no room"
    ),
    "unwrapped": BuiltinAttribute(
        "position", False, None, "where it would be if a periodic world did not wrap; elsewhere its position", edition=2
    ),
    "id": BuiltinAttribute("number", False, None, "its number, assigned at birth and never reused"),
    "age": BuiltinAttribute("time", False, None, "since birth"),
    "group": BuiltinAttribute("number", False, None, "which line of the scene's `crowd` made it, from 0"),
    "size": BuiltinAttribute("length", True, "4 mm", "body length"),
    "height": BuiltinAttribute(
        "length",
        True,
        None,
        "body height, of a species that stands; `size` follows from its body",
        edition=2,
        is_for_standing=True,
    ),
    "mass": BuiltinAttribute("mass", True, "1 g", "inertia"),
    "radius": BuiltinAttribute("length", True, "size / 2", "how much room it takes", can_be_zero=True),
    "clearance": BuiltinAttribute("length", True, "0 mm", "height of the body over the surface", can_be_zero=True),
    "max_speed": BuiltinAttribute("speed", True, "30 mm/s", "fastest"),
    "min_speed": BuiltinAttribute(
        "speed",
        True,
        None,
        "its lowest speed, along its velocity or else its heading; may stand still if not set",
        can_be_zero=True,
    ),
    "max_force": BuiltinAttribute("force", True, "mass * max_speed / response", "force of a push of 1"),
    "max_turn": BuiltinAttribute(
        "angle / time", True, None, "fastest turn of the heading; `none`: no limit", can_be_unlimited=True
    ),
    "upright": BuiltinAttribute(
        "number",
        True,
        "0 %",
        "how its body stands: 0 % along the normal of the ground, 100 % vertical",
        edition=2,
        max_value=1,
        can_be_zero=True,
    ),
    "max_slope": BuiltinAttribute(
        "angle",
        True,
        None,
        "steepest ground that it walks on; steeper ground is a wall; `none`: no limit",
        edition=2,
        can_be_unlimited=True,
        can_be_zero=True,
    ),
    "crouch": BuiltinAttribute(
        "number",
        True,
        "100 %",
        "lowest share of its height to which its body crouches below a low ceiling; lower places are walls; 100 %: never",
        edition=2,
        max_value=1,
    ),
    "response": BuiltinAttribute("time", True, "0.15 s", "from standing to full speed; `1 step` reaches any velocity at once"),
}

_BUILTINS_BY_EDITION = {
    edition: {name: row for name, row in BUILTIN_ATTRIBUTE_BY_NAME.items() if row.edition <= edition} for edition in EDITIONS
}


def get_builtin_attributes(edition: int) -> Mapping[str, BuiltinAttribute]:
    """Return the attributes that every agent has in an edition, by name."""
    return _BUILTINS_BY_EDITION[edition]


def explain_range(name: str, number: float) -> str | None:
    """Return advice for a value that a built-in attribute cannot have, such as `write 0 or more`. Return None for an allowed
    value.

    `number`: the value in base units."""
    row = BUILTIN_ATTRIBUTE_BY_NAME.get(name)
    if row is None or not row.is_settable:
        return None
    if number > row.max_value:
        return f"write {100 * row.max_value:g} % or less"
    if number < 0 or (number == 0 and not row.can_be_zero):
        return "write 0 or more" if row.can_be_zero else "write more than 0"
    return None


def is_limit_attribute(name: str) -> bool:
    """Return whether a built-in attribute is a limit, which may be infinite."""
    return name in BUILTIN_ATTRIBUTE_BY_NAME and BUILTIN_ATTRIBUTE_BY_NAME[name].can_be_unlimited


# Values of the run, usable anywhere.
RUN_VALUE_TYPES: dict[str, str] = {"dt": "time", "time": "time", "frame": "number"}

ITEM_ATTRIBUTE_TYPES: dict[str, str] = {"position": "position", "radius": "length"}
HIT_ATTRIBUTE_TYPES: dict[str, str] = {"distance": "length", "normal": "push", "position": "position"}


_DRAW_COST = UseCost(60, "{word}", "draws")


# Words that are not senses: functions of their arguments, and draws.
_PLAIN_BUILTINS = (
    parse_row("abs(x: number A) -> number A", "absolute value"),
    parse_row("clamp(x: number A, to: range A) -> number A", "limited to a range"),
    parse_row("floor(x: number) -> number", "rounded down"),
    parse_row("sqrt(x: number A) -> number sqrt A", "square root; its dimension is halved", interval=senses.POSITIVE_INTERVAL),
    parse_row("sin(x: angle) -> number", "sine", interval=(-1, 1)),
    parse_row("cos(x: angle) -> number", "cosine", interval=(-1, 1)),
    parse_row("exp(x: number) -> number", "e to the x", interval=senses.POSITIVE_INTERVAL),
    parse_row("log(x: number) -> number", "natural logarithm"),
    parse_row(
        "ramp(x: number A, from: range A, to: range B = 0 .. 1) -> number B",
        "maps one range to another in a straight line, and stays inside it",
    ),
    parse_row("mix(a: number A, b: number A, t: number) -> number A", "a at t = 0, b at t = 1"),
    parse_row("mix(a: vector A, b: vector A, t: number) -> vector A", "a at t = 0, b at t = 1"),
    parse_row("min(a: number A, b: number A) -> number A", "the lesser"),
    parse_row("max(a: number A, b: number A) -> number A", "the greater"),
    parse_row("length(v: vector A) -> number A", "length of a vector", interval=senses.POSITIVE_INTERVAL),
    parse_row("unit(v: vector A) -> push", "the same direction, length 1; zero stays zero"),
    parse_row("dot(a: vector A, b: vector B) -> number A*B", "scalar product"),
    parse_row("cross(a: vector A, b: vector B) -> vector A*B", "vector product"),
    parse_row(
        "angle(a: vector A, b: vector B) -> angle",
        "angle between two directions, 0 to half a turn",
        interval=senses.HALF_TURN_INTERVAL,
    ),
    parse_row("rotate(v: vector A, about: push, by: angle) -> vector A", "turned about an axis"),
    parse_row("project(v: vector A, onto: push) -> vector A", "the component of v along a direction"),
    parse_row("limit(v: vector A, max: number A) -> vector A", "shortened to a length if longer"),
    parse_row("vector(x: number A, y: number A, z: number A) -> vector A", "from three numbers, in the scene's axes"),
    parse_row("first(a…: any A) -> any A", "the first that is not none"),
    parse_row(
        "uniform(low: number A, high: number A) -> number A",
        "a uniform random number between two",
        uses_draws=True,
        cost=_DRAW_COST,
    ),
    parse_row(
        "normal(mean: number A, deviation: number A) -> number A",
        "a random number around a mean",
        uses_draws=True,
        cost=_DRAW_COST,
    ),
    parse_row("pick(a…: any A) -> any A", "one of these, equally likely", uses_draws=True, cost=_DRAW_COST),
    parse_row(
        "random(of: species) -> agent",
        "one living agent of a species, all equally likely",
        op="random_agent",
        uses_draws=True,
        cost=_DRAW_COST,
    ),
    parse_row("rising(x: number A, over: range A) -> number", "0 below, 1 above, linear between", interval=senses.SHARE_INTERVAL),
    parse_row(
        "falling(x: number A, over: range A) -> number", "1 below, 0 above, linear between", interval=senses.SHARE_INTERVAL
    ),
    parse_row(
        "around(x: number A, over: range A) -> number", "1 in the middle of the range, 0 outside", interval=senses.SHARE_INTERVAL
    ),
)


def _group_by_name(rows: Iterable[BuiltinRow]) -> dict[str, tuple[BuiltinRow, ...]]:
    table: dict[str, tuple[BuiltinRow, ...]] = {}
    for row in rows:
        table[row.name] = (*table.get(row.name, ()), row)
    return table


# Called as functions. Names with several rows are distinguished by the first argument's type; the first row that fits wins.
BUILTINS_BY_NAME = _group_by_name((*_PLAIN_BUILTINS, *senses.find_words("call"))) | {
    row.op: row.rows for row in set_senses.SET_SENSE_BY_OPERATION.values()
}

# Words of other tools and everyday words for senses, with the word of this language.
_FOREIGN_SENSES = (
    ("smell smells smelling sniff scent odour", "`nearest(X, within: 40 mm)` for things, or the name of a field: `trail > 0.1`"),
    (
        "see sees look looks sight vision visible sense senses detect detects find near nearby is_near",
        "`nearest(X, within: 40 mm)`, which is none where there is nothing",
    ),
    ("hear hears listen", "the name of an event that another raises with `emit`: `when alarm -> …`"),
    ("collide collides collision bump bumps hit hits reached arrived contact", "`touching(X)`"),
    ("dist distance_to range far", "`distance(X)`"),
    ("raycast cast probe feeler feel feels", "`ray(heading, reach: 20 mm, on: X)`"),
    ("rand randf random_float random_number", "`uniform(0, 1)`"),
    ("agents others", "`neighbours(20 mm)`, and `count(n in neighbours(20 mm): true)` for how many"),
)
SENSE_REPLACEMENTS: dict[str, str] = {word: instead for words, instead in _FOREIGN_SENSES for word in words.split()}

# Names, not calls: `slope` is the angle between `up` and the world's up, `uphill` the world's up laid along the ground.
SENSE_TYPE_BY_NAME: dict[str, str] = {row.name: row.result for row in senses.find_words("name")}

REDUCER_HELP: dict[str, str] = {
    "sum": "sum of the body; 0 or a zero vector for an empty set",
    "mean": "mean of the body; 0 for an empty set",
    "min": "lowest; infinite for an empty set",
    "max": "highest; minus infinity for an empty set",
    "count": "number of elements (for which the body holds)",
    "any": "the body holds for at least one",
    "every": "the body holds for all",
    "best": "the element for which the body is greatest",
}

# Operations of the typed tree for signs and words. Arguments are in source order; absent ones are None.
OPERATION_BY_SIGN = {
    "+": "add", "-": "sub", "*": "mul", "/": "div", "^": "pow", "<": "lt", "<=": "le", ">": "gt", ">=": "ge", "==": "eq",
    "!=": "ne", "and": "and", "or": "or", "not": "not", "neg": "neg",
}  # fmt: skip
# Further operations of the typed tree, in addition to the words of senses.
#   if(condition, then, else)      is_none(x)  (also `no x`; for a set: it is empty)      chance(rate or share)      is_some(x)
#   run(dt | time | frame as Thing)      event(its name as Thing)      fuzzy(degree, output, degree, output, …)
OTHER_OPERATIONS = (
    "if",
    "is_none",
    "is_some",
    "chance",
    *(row.op for row in senses.find_words("value")),
    *SENSE_TYPE_BY_NAME,
    "run",
    "event",
    "fuzzy",
)

# Properties of operations, from their rows. `chance` is a prefix word, not a call.
_OPERATION_ROWS = (
    *(row for rows in BUILTINS_BY_NAME.values() for row in rows),
    *senses.find_words("name"),
    *senses.find_words("value"),
)
DRAWING_OPERATIONS = frozenset((*(row.op for row in _OPERATION_ROWS if row.uses_draws), "chance"))
INTERVAL_BY_OPERATION: dict[str, tuple[float, float]] = {
    row.op: row.interval for row in _OPERATION_ROWS if row.interval is not None
}
COST_BY_OPERATION: dict[str, UseCost] = {row.op: row.cost for row in _OPERATION_ROWS if row.cost is not None} | {
    "chance": _DRAW_COST
}

# Reserved for later editions: an error as a name, and a located `not-yet` error as a construct.
RESERVED_WORDS = ("repeat", "import", "share", "total")
