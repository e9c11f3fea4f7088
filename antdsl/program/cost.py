"""Estimates the cost of each state of a program from its senses, fields, draws and sums. Each of these has an approximate
weight.

The estimate allows states to be compared before a run. Nothing is measured."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from antdsl.program import model
from antdsl.program.tables.effects import EFFECT_BY_OPERATION
from antdsl.program.tables.rows import UseCost
from antdsl.program.tables.set_senses import SET_SENSE_BY_OPERATION
from antdsl.program.tables.vocabulary import COST_BY_OPERATION
from antdsl.program.traverse import iterate_parts
from antdsl.program.types.folding import find_constant

ASSUMED_SET_MEMBERS = 8  # elements of a set that the estimate assumes
_TAKE_COST = UseCost(40, "takes {thing}")


@dataclass(frozen=True, slots=True)
class CostEntry:
    """One use of a sense, field or draw.

    `kind`: "senses", "fields" or "draws". `description`: a text about the use, with how often it occurs per step.
    `weight`: the total weight; one addition has the weight 1."""

    kind: str  # senses, fields or draws
    description: str
    weight: float


@dataclass(frozen=True, slots=True)
class StateCost:
    """The uses of senses, fields and draws in one state, or those common to all states.

    `name`: `MACHINE.STATE`, or `STATE` if there is only one machine. It is `every state` for the common uses."""

    name: str
    cost_entries: tuple[CostEntry, ...]
    operation_count: int  # operations on numbers; those inside sets count ASSUMED_SET_MEMBERS times

    @property
    def weight(self) -> float:
        """Return the total weight of the state: that of all uses, plus that of the operations on numbers."""
        return self.operation_count + sum(use.weight for use in self.cost_entries)


def estimate_costs(program: model.Program, species: model.Species) -> list[StateCost]:
    """Return the costs of every state of a species in text order, followed by the costs that all states have in common."""
    state_parts = [
        StateCost(
            state.name if len(species.machines) == 1 else f"{machine.name}.{state.name}",
            *_count_uses(program, _collect_step_parts(species, machine, state)),
        )
        for machine in species.machines
        for state in machine.states
    ]
    relaxed = [a.relax_to for a in species.attributes if a.relax_to is not None]
    always = (
        species.layers,
        species.latches,
        relaxed,
        [handler.actions for handler in species.handlers if handler.event != "spawn"],
    )
    return [*state_parts, StateCost("every state", *_count_uses(program, always))]


def _collect_step_parts(species: model.Species, machine: model.Machine, state: model.State) -> object:
    """Return the parts of the program that an agent in the state evaluates in every step. Enter and exit actions are omitted,
    because they are evaluated only once."""
    still = (
        species.rest.push
        if species.rest is not None and state.index in species.rest.resting_states.get(machine.name, ())
        else None
    )
    changes = [(change.condition, change.delay, change.hold_time, change.take_action) for change in state.transitions]
    return state.body, still, changes


def _count_uses(program: model.Program, root: object) -> tuple[tuple[CostEntry, ...], int]:
    weights: dict[tuple[str, str], float] = {}
    sums = 0
    inside = _find_ids_inside_sets(root)
    for part in iterate_parts(root):
        sums += _count_operations(part) * (ASSUMED_SET_MEMBERS if id(part) in inside else 1)
        for use in _make_cost_entries(part):
            # equal senses are computed once, each draw separately
            previous = weights.get((use.kind, use.description), 0.0)
            weights[use.kind, use.description] = previous + use.weight if use.kind == "draws" else use.weight
    return tuple(CostEntry(kind, words, weight) for (kind, words), weight in weights.items()), sums


def _find_ids_inside_sets(root: object) -> set[int]:
    """Return the `id()` of each part of the program that is computed once per member of a set."""
    return {
        id(inner)
        for part in iterate_parts(root)
        if isinstance(part, (model.ReduceExpr, model.SetExpr))
        for inner in _iterate_parts_evaluated_per_member(part)
    }


def _iterate_parts_evaluated_per_member(part: model.ReduceExpr | model.SetExpr) -> Iterator[object]:
    body = part.body if isinstance(part, model.ReduceExpr) else part.condition
    return iterate_parts(body) if body is not None else iter(())


_PAIR_VALUE_OPERATIONS = 100  # operations to find the slot of a pair value


def _count_operations(part: object) -> int:
    if isinstance(part, model.Assign) and (part.pair_agent is not None or part.other_agents is not None):
        return _PAIR_VALUE_OPERATIONS
    if isinstance(part, (model.Steer, model.FaceLine, model.Assign)):
        return 3
    if not isinstance(part, model.OperationExpr):
        return 0
    return 3 if part.type.kind.value == "vector" else 1


def _make_cost_entries(part: object) -> Iterable[CostEntry]:
    """Return the uses of senses, fields and draws in one node of the program."""
    match part:
        case model.SetExpr():
            cost = SET_SENSE_BY_OPERATION[part.source].cost
            return [] if cost is None else [_make_entry(cost, part.source_name, part.args)]
        case model.OperationExpr():
            cost = COST_BY_OPERATION.get(part.name)
            thing = next((arg.name for arg in part.args if isinstance(arg, model.ThingRef) and arg.name != "self"), "")
            return [] if cost is None or (cost.needs_thing and not thing) else [_make_entry(cost, thing, part.args, part.name)]
        case model.Take():
            return [_make_entry(_TAKE_COST, part.attribute or part.source.span.text)]
        case model.EffectRequest():
            cost = EFFECT_BY_OPERATION[part.op].cost
            return [] if cost is None else [_make_entry(cost, part.target, part.args)]
    return []


def _make_entry(cost: UseCost, thing: str, args: tuple[model.Expr | None, ...] = (), op: str = "") -> CostEntry:
    """Return the entry for a use, with the count, thing and distance that `cost` describes."""
    count = 1
    if cost.multiplier_index is not None:
        times = args[cost.multiplier_index] if len(args) > cost.multiplier_index else None
        known = find_constant(times) if times is not None else None
        count = int(known.number) if known is not None else cost.default_multiplier
    words = cost.text_template.format(thing=thing, count=count, word=op.removesuffix("_agent"))
    if cost.distance_index is not None and len(args) > cost.distance_index and args[cost.distance_index] is not None:
        words += f" within {_format_argument(args[cost.distance_index])}"
    return CostEntry(cost.heading, words, cost.weight * count)


def _format_argument(expr: model.Expr | None) -> str:
    """Return the source text of an argument. If the argument is a parameter of a behaviour, return the text with which the
    behaviour was called."""
    while isinstance(expr, model.BindingRef) and expr.binding.role == "argument" and expr.binding.value is not None:
        expr = expr.binding.value
    return " ".join(expr.span.text.split()) if expr is not None else "any distance"
