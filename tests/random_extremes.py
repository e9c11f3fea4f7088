"""Random programs of every construct, in worlds of every kind, fed with what is no number, endless, huge and denormal.

`Extremes(seed)` writes a program and the world it runs in; `spoil` puts such values into registers, items and fields of a run,
the same for every backend and order of rows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from typing import Any

import meshes
import numpy as np
import random_sensing
from meaning import crowd, item
from plan_text import program_of

from antdsl.passes import optimise_plan
from antdsl.plan import ir, lower, verify_plan
from antdsl.plan.traverse import iterate_statements, list_blocks
from antdsl.program import typed
from antdsl.program.model import Program
from antdsl.program.tables.effects import EFFECT_BY_OPERATION
from antdsl.program.tables.set_senses import SET_RESULT_OPERATIONS, SET_SENSE_BY_OPERATION
from antdsl.program.tables.vocabulary import (
    BUILTIN_ATTRIBUTE_BY_NAME,
    BUILTINS_BY_NAME,
    OPERATION_BY_SIGN,
    OTHER_OPERATIONS,
    REDUCER_HELP,
)
from antdsl.program.traverse import iterate_parts
from antdsl.runtime import FieldStartData, MeshData, World, WorldSetting, set_param
from antdsl.scene.setting import CameraData, DetailLevelData, FlowTarget, GeometryMotion, PaintedValues, SolidData, SpreadFlowData
from antdsl.scene.staging.motion import MeshMotion

ODD = (np.nan, np.inf, -np.inf, 1e30, -1e30, 3.4e38, 1e-40, -1e-45, 1e-30, -0.0, 0.0, 1.0, -1.0, 16777217.0, 2147483648.0)
LAMP = replace(item("f", 20, -20, 8, load=5), look="light")
BODY = ("size", "mass", "max_speed", "radius")  # spoiled more seldom: who has no size is soon out of all that happens
SPOILED = ("fear", "luck", "load", "mood", *BODY)
WORLD = random_sensing.WORLD.replace(
    "  curve way_in\n", "  curve way_in\n  solid hill\n  flow drift\n  map damp\n  camera shot\n"
)

NUMBERS = (
    *random_sensing.NUMBERS,
    "light(food)",
    "odd",
    "huge",
    "tiny",
    "odd * luck",
    "huge * huge * fear",
    "tiny / huge",
    "fear / (luck - luck)",
    "log(fear - 9)",
    "sqrt(fear - 9)",
    "exp(luck * 400)",
    "abs(fear) ^ luck",
    "(fear - 1) ^ 3",
    "odd ^ luck",
    "cos(odd * 1 rad)",
    "log(tiny)",
    "noise(scale: 20 mm, seed: id, period: 2 s)",
    "min_speed / 20 mm/s",
    "moved / 2 mm",
    "length(drift)",
    "(if reachable(drift) then 1 else 0)",
    "damp",
    "smell(trail, ahead: odd * 1 mm, turn: odd * 1 deg)",
    "smell(alarm_mark, ahead: fear * 9 mm)",
    "distance(hill) / 40 mm",
    "carved / 1 mm^3",
    "sum(n in neighbours(30 mm): n.id)",
    "count(n in neighbours(30 mm): n.id > id)",
    "count(f in all(food): f == meal)",
    "sum(n in neighbours(odd * 1 mm): n.luck)",
    "count(neighbours(huge * 1 mm, odd * 1 deg))",
    "sum(n in neighbours(30 mm): odd * n.fear)",
    "mean(n in neighbours(40 mm): n.luck / (n.fear - n.fear))",
    "min(1, min(n in neighbours(30 mm): odd))",
    "max(1, max(n in neighbours(30 mm): n.fear * huge))",
    "best(n in neighbours(40 mm): odd * n.luck).luck",
    "best(f in all(food): f.load * odd).load",
    "sum(n in other: n.mood * huge)",
    "max(-9, max(f in all(food, within: odd * 1 mm): f.load))",
    "ray(heading * odd, reach: 40 mm, on: stones).distance / 40 mm",
    "length(ray(heading, reach: huge * 1 mm, on: stones).normal)",
    "falling(luck, 0 .. 1)",
    "around(fear * odd, 0 .. 2)",
    "dot(cross(heading, up), uphill)",
    "angle(heading * odd, up) / 1 rad",
    "length(project(velocity, onto: up)) / 10 mm/s",
    "length(unit(velocity * odd))",
    "length(limit(velocity, tiny * 1 mm/s)) / 10 mm/s",
    "length(mix(heading, up, odd))",
    "distance(strongest(trail, nearest: 9)) / 50 mm",
    "distance(closest(way_in)) / 50 mm",
    "distance(position(pal)) / 50 mm",
    "length(velocity(pal)) / 10 mm/s",
    "distance(first(pal, nearest(a))) / 50 mm",
    "haste",
    "around_me",
    "distance(nearest(other, within: 50 mm, with: mood > fear)) / 50 mm",
    "load_of_all",
    "time / 1 s",
    "group",
    "radius / clearance",
    "max_turn / 1 rad/s",
)
PUSHES = (
    *random_sensing.PUSHES,
    "heading * odd",
    "vector(odd, luck, huge)",
    "drift",
    "along(drift, weight: odd)",
    "rotate(heading, about: up, by: odd * 1 rad)",
    "avoid(hill)",
    "match(velocity * huge)",
    "match(clear_velocity(heading * luck * max_speed * 2, within: odd * 20 mm, horizon: 1 s, most: 4))",
    "keep_clear(heading, within: 30 mm)",
    "toward(widest_gap(within: odd * 30 mm))",
    "coast()",
    "evade(pal)",
    "give_way(20 mm)",
    "toward(direction(meal, to: nearest(nest)), pace: odd)",
    "limit(heading * odd, tiny)",
)
CONDITIONS = (
    *random_sensing.CONDITIONS,
    "touching(ground)",
    "touching(hill)",
    "odd == odd",
    "fear <= odd",
    "luck >= tiny",
    "fear * odd > luck",
    "pal is not none",
    "meal == nearest(food)",
    "pal != nearest(a)",
    "no neighbours(tiny * 1 mm)",
    "any(n in neighbours(30 mm): n.luck * odd > 0)",
    "every(f in all(food): f.load * odd != 0)",
    "any(h in feelers(stones, count: 2, spread: 30 deg, reach: 20 mm): h.distance * odd < 5 mm)",
    "chance luck * 1 /s",
    "(rising(fear, 0 .. 1) and falling(luck * odd, 0 .. 1)) > 0.3",
    "time_in_state > 0.2 s",
    "previous == q",
)
DECLARED = """param odd = 1
param huge = 1e30
param tiny = 1e-30
carved = 0 mm^3
let load_of_all = sum(f in all(food): f.load)
on collision(met) { fear += odd; pal = met; heading = direction(met, to: self) }
on collision(met: other) { luck -= met.mood * odd }
fuzzy haste { rising(fear, 0 .. 1) -> 1; not meal -> 0.5; falling(luck * odd, 0 .. 1) -> 0.2 }
"""
LINES = (
    "fear = {any}",
    "luck = {any}",
    "carve hill(radius: 1.5 mm, into: carved)",
    "carve hill(radius: odd * 1 mm, toward: heading)",
    "deposit trail {any}{rate}",
    "deposit alarm_mark huge * luck{rate}",
    "emit ping(within: odd * 1 mm)",
    "pal = best(n in neighbours(40 mm): n.luck * odd)",
)


class Extremes(random_sensing.Sensing):
    """`text` is a program with the species `a` and `other`, `kind` what is special about its world."""

    numbers, pushes, conditions, statements, declarations = NUMBERS, PUSHES, CONDITIONS, LINES, DECLARED
    KINDS = ("still", "moving", "detail", "loose")

    def __init__(self, seed: int) -> None:
        self.kind, self.seed = self.KINDS[seed % len(self.KINDS)], seed
        if self.kind == "loose":
            self.numbers, self.pushes, self.conditions, self.statements = (
                tuple(word for word in words if not any(name in word for name in ("drift", "damp", "hill", "ground")))
                for words in (NUMBERS, PUSHES, CONDITIONS, LINES)
            )
        super().__init__(seed)

    def lines(self, body: bool) -> str:
        """As those of any program, at times with one of any resulting value."""
        text = super().lines(body)
        if self.rng.random() < 0.2:
            line = self.rng.choice(self.statements).format(any=self.number(1), rate=" * 1 /s" if body else "")
            written = ("fear", "luck", "pal")
            if not any(line.startswith(name) and f"{name} " in text for name in written):
                text = f"{text}; {line}" if text else line
        return text


def plan_and_program(extremes: Extremes) -> tuple[ir.Plan, Program]:
    """The program as checked, and its plan."""
    program = program_of(extremes.text, WORLD)
    plan, _ = lower(program)
    verify_plan(plan)
    return optimise_plan(plan), program


def setting(extremes: Extremes, agents: int = 21) -> WorldSetting:
    """Hills with a boulder, a hill to dig in, a road, two sources and a nest; for the kind `loose` an endless plane."""
    draw = np.random.default_rng(extremes.seed)
    ground, stones = MeshData(*meshes.terrain(200.0, 12)), MeshData(*meshes.ball(15.0, (40, 5, 10), 6))
    goal = FlowTarget(np.array([[60.0, 0.0, 0.0]]), np.array([8.0]))
    lay = np.abs(ground.vertices[:, 1]) / 8
    lay[::7] = draw.choice(ODD[3:], len(lay[::7]))
    optional_parts: dict[str, Any] = {}
    if extremes.kind != "loose":
        optional_parts = {
            "surfaces": {"ground": ground},
            "flows": {"drift": SpreadFlowData("toward", goal, radius=90.0)},
            "maps": {"damp": PaintedValues("ground", lay)},
            "solids": {"hill": SolidData(MeshData(*meshes.box((-70, -20, -70), (-30, 25, -30))), 4.0)},
            "field_start": {"trail": (FieldStartData(float(draw.choice([0.5, 1e30, 1e-40, 1e-310])), (0.0, 0.0, 0.0), 40.0),)},
        }
    if extremes.kind == "moving":
        poses = np.repeat(np.eye(3, 4)[None], 30, axis=0)
        poses[:, 0, 3] = np.arange(30) * 0.5
        optional_parts["motion"] = GeometryMotion(meshes={"ground": MeshMotion.from_transforms(poses, len(ground.vertices))})
    if extremes.kind == "detail":
        optional_parts["level_of_detail"] = DetailLevelData(np.array([[0.0, 60.0, 0.0]]), 70.0, 90.0)
    return WorldSetting(
        fps=Fraction(10),
        seed=extremes.seed,
        contacts=("off", "soft", "hard")[extremes.seed % 3],
        obstacles={"stones": stones},
        cameras={
            "shot": CameraData(
                *(np.array([each]) for each in ((0.0, 60.0, 90.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0))), np.array([35.0])
            )
        },
        curves={"way_in": np.array([[-80.0, 0, -80], [0, 0, 10], [80, 0, 60]])},
        items={"food": (LAMP, item("g", -40, 10, 8, load=2.5)), "nest": (item("n", 0, 0, 12),)},
        crowds=(crowd(agents, radius=60), crowd(4, species="other", radius=60)),
        params={f"a.{name}": float(draw.choice(ODD)) for name in ("odd", "huge", "tiny")},
        **optional_parts,
    )


def spoil(world: World, frame: int, seed: int) -> None:
    """Before a step: params get other values, and every fifth frame some registers, items and cells."""
    draw = np.random.default_rng([seed, frame])
    set_param(world, "a.odd", float(draw.choice(ODD)))
    if frame % 5:
        return
    for _, population in sorted(world.populations.items()):
        rows = population.get_rows_by_id()
        for register in SPOILED:
            hit, value = draw.integers(0, 12, len(rows)) == 0, draw.choice(ODD, len(rows)).astype(np.float32)
            if register in population.now and (register not in BODY or frame % 20 == 0):
                for held in (population.now, population.start):
                    held[register][rows[hit]] = value[hit]
    for items in world.items.values():
        for amounts in items.amounts.values():
            amounts[draw.integers(0, len(amounts))] = draw.choice(ODD)
    for _, field in sorted(world.fields.items()):
        cells = draw.integers(0, max(len(field.amounts), 1), 9)
        if len(field.amounts):
            field.amounts[cells] = draw.choice(np.abs(ODD), 9)


def one_nan(world: World) -> None:
    """After a step: every NaN gets the same bits. Which sign one has hangs on the order of operands that a processor is given."""
    arrays = [array for p in world.populations.values() for held in (p.now, p.start) for array in held.values()]
    arrays += [p.position for p in world.populations.values()] + [p.normal for p in world.populations.values()]
    arrays += [amounts for items in world.items.values() for amounts in items.amounts.values()]
    arrays += [field.amounts for field in world.fields.values()]
    for array in arrays:
        if array.dtype.kind == "f":
            array[np.isnan(array)] = np.nan


def constructs(plan: ir.Plan, program: Program) -> Iterator[str]:
    """What of the language's tables a program has: words and reductions as checked, operations and statements of its plan."""
    for part in iterate_parts(program):
        if isinstance(part, typed.OperationExpr):
            yield f"word {part.name}"
        elif isinstance(part, typed.ReduceExpr):
            yield f"reduce {part.reducer}"
        elif isinstance(part, typed.SetExpr):
            yield f"set {part.source}"
        elif isinstance(part, typed.AttributeRef) and part.name in BUILTIN_ATTRIBUTE_BY_NAME:
            yield f"given {part.name}"
    for node in plan.nodes:
        yield f"operation {node.op}"
    for species in plan.species.values():
        for _, block in list_blocks(species):
            for _, statement in iterate_statements(block):
                yield f"effect {statement.op}" if isinstance(statement, ir.Request) else f"statement {type(statement).__name__}"


def every_construct() -> set[str]:
    """All that `constructs` may tell of, by the tables."""
    words = {row.op for rows in BUILTINS_BY_NAME.values() for row in rows} - set(SET_SENSE_BY_OPERATION)
    known_constructs = {f"word {op}" for op in words | set(OTHER_OPERATIONS) | set(OPERATION_BY_SIGN.values())}
    known_constructs |= (
        {f"reduce {how}" for how in REDUCER_HELP}
        | {f"set {name}" for name in SET_RESULT_OPERATIONS}
        | {f"given {name}" for name in BUILTIN_ATTRIBUTE_BY_NAME}
    )
    known_constructs |= {f"operation {op}" for op in ir.OPERATION_BY_NAME} | {f"effect {op}" for op in EFFECT_BY_OPERATION}
    return known_constructs | {f"statement {each.__name__}" for each in (ir.If, ir.Store, ir.Claim, ir.Give)}
