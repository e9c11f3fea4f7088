"""Crowds that are empty for a part of a run, and a program that asks them all that the language can ask.

The program is made from the tables of the language, so a new sense, set, reduction or effect is in it without an edit here.
Askers look at rabbits; eggs bear both. Only counts and params decide which agents exist in which frames. So all `LIVES` are one
plan, and its machine code is built once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from types import SimpleNamespace
from typing import Literal, cast

import numpy as np
import random_extremes
from meaning import crowd
from plan_text import plan_of
from test_program import checked

from antdsl.passes import optimise_plan
from antdsl.plan import ir
from antdsl.program.tables import senses
from antdsl.program.tables.rows import ArgumentRow, BuiltinRow
from antdsl.program.tables.set_senses import SET_RESULT_OPERATIONS, SET_SENSE_BY_OPERATION
from antdsl.runtime import FieldStartData, WorldSetting
from antdsl.scene.setting import PaintedValues

Size = Literal["sets", "all", "pairs"]
FRAMES = 12  # at 10 a second
WORLD = random_extremes.WORLD
ENDLESS = 1000.0  # s

# What stands for an argument of a set, by its type and, where several kinds fit, for species, items and obstacles.
ARGUMENTS = {
    "length": "40 mm",
    "angle": "200 deg",
    "condition": "it.radius > 0 mm",
    "number": "2",
    "count": "3",
    "items": "food",
    "obstacle": "stones",
    "species": "rabbit",
    "set": "neighbours(40 mm, of: rabbit)",
}
# How a value of any type becomes a stored number: the first form that the checker takes.
MEASURES = (
    "clamp({}, -9 .. 9)",
    "(if {} then 1 else 0)",
    "clamp({} / 1 mm, -9 .. 9)",
    "clamp({} / 1 deg, -9 .. 9)",
    "length({})",
    "clamp(length({}) / 1 mm/s, -9 .. 9)",
    "clamp(distance({}) / 1 mm, -9 .. 9)",
    "({}).radius / 1 mm",
)
# A reduction over a set, what its element is called being n.
REDUCTIONS = {
    "sum": "clamp(sum(n in {}: n.radius / 1 mm), -9 .. 9)",
    "mean": "clamp(mean(n in {}: n.radius / 1 mm), -9 .. 9)",
    "min": "clamp(min(n in {}: n.radius / 1 mm), -9 .. 9)",
    "max": "clamp(max(n in {}: n.radius / 1 mm), -9 .. 9)",
    "count": "count(n in {}: n.radius > 1 mm)",
    "any": "(if any(n in {}: n.radius > 1 mm) then 1 else 0)",
    "every": "(if every(n in {}: n.radius > 1 mm) then 1 else 0)",
    "best": "clamp(best(n in {}: n.radius / 1 mm).radius / 1 mm, -9 .. 9)",
}
OF_NONE = {"sum": 0, "mean": 0, "min": 9, "max": -9, "count": 0, "any": 0, "every": 1, "best": 0}  # by the language reference

_LAYERS = "give_way(20 mm); avoid(stones); keep_clear(heading, within: 30 mm); pursue(pal); state; separate(15 mm)"
_TEXT = (
    """use steering
species asker {{
  param life = {endless} s
  param odd = 1
  param huge = 1
  param tiny = 1
  {attributes}
  seen = 0
  load = 0
  soil = 0 mm^3
  pal = none of rabbit
  met_last = none of rabbit
  bonds = 0 relax to 0 over 1 s for each rabbit, strongest 2
  let foe = nearest(rabbit, within: 60 mm)
  on ping {{ seen += 1 }}
  on collision(met: rabbit) {{ met_last = met }}
  on collision(met) {{ seen += 1 }}
  on spawn {{ pal = nearest(rabbit) }}
  start look
  state look {{
    {lines}
    pal = random(rabbit)
    bonds[n in neighbours(40 mm, of: rabbit)] += 1 /s
    bonds[foe] = 1
    steer arrive(pal)
    deposit trail 1 /s
    carve hill(radius: 1 mm, into: soil)
    emit ping(within: 30 mm)
    emit ping to foe
    when foe and chance 100 %/s take 0.1 load from nearest(food) -> rest {{ give all load to nest }}
    when age > life -> rest {{ die }}
    when no foe held 0.3 s -> rest
  }}
  state rest {{ steer halt(); emit ping; when pal is none -> look; when after 0.2 s -> look; when age > life -> look {{ die }} }}
  layers {{ """
    + _LAYERS
    + """ }}
}}
species rabbit {{
  param life = {endless} s
  fear = 0
  on ping {{ fear += 1 }}
  on spawn {{ fear = count(n in asker: n.load > 0) }}
  start sit
  state sit {{ steer wander(); deposit alarm_mark 1 /s; when age > life -> gone {{ die }} }}
  state gone {{ when after 1 s -> sit }}
}}
species egg {{
  param life = {endless} s
  param hatch = {endless} s
  param asks = 1
  param runs = 1
  bred = 0
  start wait
  state wait {{
    when time > hatch and asks > 0 and bred == 0 -> more {{ spawn asker; bred = 1 }}
    when time > hatch and runs > 0 and bred < 2 -> more {{ spawn rabbit; spawn rabbit; bred = 2 }}
    when time > life -> more {{ die }}
  }}
  state more {{ when bred < 3 -> wait }}
}}
"""
)


@dataclass(frozen=True)
class Life:
    """Who is there when: how many at the beginning, until which second, and from which second on again."""

    name: str
    count: int
    until: float = ENDLESS
    again: float = ENDLESS


NEVER = Life("never", 0)
LIVES = (
    NEVER,
    Life("later", 0, again=0.3),
    Life("not_in_the_middle", 4, 0.3, 0.7),
    Life("not_at_the_end", 4, 0.3),
    Life("one", 1),
)
WHO = ("asker", "rabbit", "both", "everybody")


def calls(word: BuiltinRow) -> Iterator[str]:
    """A word of a set with all that has to be given, with each thing that may, and with all of them."""
    may = [arg for arg in word.args if arg.is_optional or arg.default is not None]
    for chosen in [[], *([each] for each in may), may]:
        yield f"{word.op}({', '.join(_argument_text(arg) for arg in word.args if arg not in may or arg in chosen)})"


def _argument_text(arg: ArgumentRow) -> str:
    plain = not arg.is_optional and arg.type in ("species", "items", "set")
    return ARGUMENTS[arg.type] if plain else f"{arg.name}: {ARGUMENTS[arg.type]}"


@cache
def sets() -> tuple[str, ...]:
    """All sets that can be queried, by the table."""
    return tuple(
        {call: 0 for op in sorted(SET_RESULT_OPERATIONS) for word in SET_SENSE_BY_OPERATION[op].rows for call in calls(word)}
    )


@cache
def reduced(every: bool) -> tuple[tuple[str, str, str], ...]:
    """Each reduction of each set of items or agents: how, the set, the text. A sample: each reduction, and each set, but not all
    pairs of the two."""
    of_things = [each for each in sets() if "stones" not in each]
    pairs = product(REDUCTIONS, of_things)
    chosen = [(how, each) for how, each in pairs if every or how == "count" or each == "neighbours(radius: 40 mm, of: rabbit)"]
    return tuple((how, each, REDUCTIONS[how].format(each)) for how, each in chosen)


@cache
def samples() -> tuple[tuple[str, str], ...]:
    """Each sense as a stored value, or as a line; its word and its text. About agents, these are rabbits."""
    op_texts = [(word.op, word.sample) for how in ("call", "name") for word in senses.find_words(how) if word.sample]
    op_texts += [
        ("field_max", "max(trail, nearest: 9)"),
        ("field_value", "trail"),
        ("flow_value", "drift"),
        ("map_value", "damp"),
    ]
    op_texts += [
        (op, call)
        for op, row in SET_SENSE_BY_OPERATION.items()
        if op not in SET_RESULT_OPERATIONS
        for word in row.rows
        for call in calls(word)
    ]
    return tuple((op, written(op, text.replace("path", "way_in"))) for op, text in op_texts)


def words() -> set[str]:
    """All senses of the tables by their words; what has no sample has to be in `samples` by hand."""
    every = {word.op for how in ("call", "name", "value") for word in senses.find_words(how)}
    return every | {op for op in SET_SENSE_BY_OPERATION if op not in SET_RESULT_OPERATIONS}


def written(word: str, sample: str) -> str:
    """A line of a state that has a sample."""
    if any(sample.startswith(f"{verb} ") for verb in ("steer", "when", "deposit", "emit")):
        return sample
    for form in MEASURES:
        line = f"seen += {form.format(sample)} * 1 /s"
        text = "use steering\nspecies rabbit {}\nspecies asker { load = 0; seen = 0\nstate look { " + line + " } }\n"
        if checked(WORLD + text)[1].ok:
            return line
    raise AssertionError(f"`{word}`: no line has its sample `{sample}`")


@cache
def plan(size: Size = "all") -> ir.Plan:
    """The program of all senses, sets, reductions and effects; `pairs`: of each reduction of each set; `sets`: without the other
    senses and layers, because their machine code takes long to build."""
    every = size == "pairs"
    lines = [] if size == "sets" else [line for _, line in samples()]
    names = [f"r{number}" for number in range(len(reduced(every)))]
    lines += [f"{name} = {text}" for name, (*_, text) in zip(names, reduced(every), strict=True)]
    body = _TEXT.replace(_LAYERS, "state") if size == "sets" else _TEXT
    text = body.format(endless=int(ENDLESS), attributes="; ".join(f"{name} = 5" for name in names), lines="\n    ".join(lines))
    return optimise_plan(plan_of(text, WORLD))


KINDS = tuple(kind for kind in random_extremes.Extremes.KINDS if kind != "loose")  # the program names a surface


def setting(who: str, life: Life, kind: str = "still", seed: int = 0) -> WorldSetting:
    """A world with everything; `who` is there as `life` says, the others all the time, eggs with them."""
    extremes = cast(random_extremes.Extremes, SimpleNamespace(kind=kind, seed=seed))
    lives = {name: life if who in (name, "both", "everybody") else Life("always", 3) for name in ("asker", "rabbit")}
    ends = who == "everybody" and life.again == ENDLESS
    crowds = (
        crowd(lives["asker"].count, "asker", radius=30),
        crowd(lives["rabbit"].count, "rabbit", radius=30),
        crowd(0 if ends and life is NEVER else 1, "egg"),
    )
    params = {f"{name}.life": each.until for name, each in lives.items()}
    params |= {"egg.hatch": life.again, "egg.asks": float(lives["asker"] is life), "egg.runs": float(lives["rabbit"] is life)}
    params["egg.life"] = life.until if ends else ENDLESS
    base_setting = random_extremes.setting(extremes)
    plain = {"damp": PaintedValues("ground", np.abs(base_setting.surfaces["ground"].vertices[:, 1]) / 8)}
    start = {"trail": (FieldStartData(0.5, (0.0, 0.0, 0.0), 40.0),)}
    return replace(base_setting, crowds=crowds, params=params, maps=plain, field_start=start)
