"""Dimensions, kinds, types and rates of values, which the checker infers for every expression."""

from __future__ import annotations

from enum import Enum, IntEnum
from typing import NamedTuple

from antdsl.program.tables.things import KIND_BY_WORD


class Dimension(NamedTuple):
    """The exponents of length (mm), time (s), mass (g) and angle (rad). They may be fractions, for example after `sqrt`."""

    length: float = 0
    time: float = 0
    mass: float = 0
    angle: float = 0


class TypeKind(Enum):
    """The kind of a type. This includes the kinds of things of the world."""

    _ignore_ = "word row"
    NUMBER = "number"
    VECTOR = "vector"  # a push is a vector without dimension
    BOOL = "bool"
    STATE = "state"  # `of` is "species.machine"
    ITEM = "item"  # one item or none; `of` names the items
    AGENT = "agent"  # one agent or none; `of` names the species
    HIT = "hit"  # the hit of a ray, or none
    PLACE = "place"  # anything with a position; only while a behaviour is checked alone
    # Only as arguments, never stored:
    SET = "set"  # `of` names the items or species, or "hit"
    FIELD = "field"
    VECTOR_FIELD = "field of vectors"  # also a flow
    OBSTACLE = "obstacle"
    for word, row in KIND_BY_WORD.items():
        if not row.has_values and word != OBSTACLE:
            vars()[word.upper()] = word
    SPECIES = "species"
    ITEMS = "items"
    RANGE = "range"
    BAD = "bad"  # error already reported; compatible with every type


class ValueType(NamedTuple):
    """The type of a value. `referent`: the species, items or machine that it refers to, if any."""

    kind: TypeKind
    dimension: Dimension = Dimension()
    referent: str | None = None


BAD_TYPE = ValueType(TypeKind.BAD)
NUMBER_TYPE = ValueType(TypeKind.NUMBER)
BOOL_TYPE = ValueType(TypeKind.BOOL)
PUSH_TYPE = ValueType(TypeKind.VECTOR)
VELOCITY_TYPE = ValueType(TypeKind.VECTOR, Dimension(length=1, time=-1))
LENGTH_TYPE = ValueType(TypeKind.NUMBER, Dimension(length=1))
TIME_TYPE = ValueType(TypeKind.NUMBER, Dimension(time=1))
PER_SECOND_TYPE = ValueType(TypeKind.NUMBER, Dimension(time=-1))


class ChangeRate(IntEnum):
    """How often a value changes. The rate of an expression is the highest rate of its parts."""

    CONST = 0
    RUN = 1  # params, dt, the scene's unit
    STEP = 2  # time, frame
    AGENT = 3
    ELEMENT = 4  # per pair, item or ray, inside a set
