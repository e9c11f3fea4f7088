"""Dimensions, kinds, types and rates of values: what the checker infers for every expression."""

from __future__ import annotations

from enum import Enum, IntEnum
from typing import NamedTuple

from antdsl.program.tables.things import KINDS_OF_THINGS


class Dim(NamedTuple):
    """Exponents of length (mm), time (s), mass (g) and angle (rad). May be fractions after `sqrt`."""

    length: float = 0
    time: float = 0
    mass: float = 0
    angle: float = 0


class Kind(Enum):
    """The kinds of things of the world are members too."""

    _ignore_ = "word row"
    NUMBER = "number"
    VECTOR = "vector"  # a push is a vector without dimension
    BOOL = "bool"
    STATE = "state"  # `of` is "species.machine"
    ITEM = "item"  # one item or none; `of` names the items
    AGENT = "agent"  # one agent or none; `of` names the species
    HIT = "hit"  # what a ray met, or none
    PLACE = "place"  # only while a behaviour is checked on its own: anything that has a position
    # Only as arguments, never stored:
    SET = "set"  # `of` names the items or species, or "hit"
    FIELD = "field"
    OBSTACLE = "obstacle"
    for word, row in KINDS_OF_THINGS.items():
        if not row.has_values and word != OBSTACLE:
            vars()[word.upper()] = word
    SPECIES = "species"
    ITEMS = "items"
    RANGE = "range"
    BAD = "bad"  # complained about already; fits everywhere


class Type(NamedTuple):
    kind: Kind
    dim: Dim = Dim()
    of: str | None = None


BAD = Type(Kind.BAD)
NUMBER = Type(Kind.NUMBER)
BOOL = Type(Kind.BOOL)
PUSH = Type(Kind.VECTOR)
VELOCITY = Type(Kind.VECTOR, Dim(length=1, time=-1))
LENGTH = Type(Kind.NUMBER, Dim(length=1))
TIME = Type(Kind.NUMBER, Dim(time=1))
PER_SECOND = Type(Kind.NUMBER, Dim(time=-1))


class Rate(IntEnum):
    """How often a value changes; an expression has the greatest rate of its parts."""

    CONST = 0
    RUN = 1  # params, dt, the scene's unit
    STEP = 2  # time, frame
    AGENT = 3
    ELEMENT = 4  # per pair, item or ray, inside a set
