"""What a program asks for in each state: senses, fields, draws and sums, each with a rough weight, so that states can be held
against each other before anything runs. Nothing is measured here."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from antdsl.program.model import (
    Assign,
    Carve,
    Deposit,
    Emit,
    Expr,
    Local,
    Machine,
    Op,
    Program,
    Reduce,
    SetOf,
    Species,
    State,
    Steer,
    Take,
    Thing,
)
from antdsl.program.traverse import parts
from antdsl.program.types.folding import constant_behind

# Weights are about what one costs one agent, one addition being 1: orders of magnitude for crowds of some ten thousand agents.
# A ray is cast where an obstacle is near only; a set is gone over for MEMBERS.
MEMBERS = 8
RAYS = 3  # of feelers whose number is not a constant
_WEIGHTS = {
    "neighbours": 600, "all": 100, "ray": 400, "near": 100, "curve": 200, "flow": 30, "map": 10, "field": 15,
    "cell": 12, "gradient": 60, "deposit": 25, "draw": 60, "carve": 1000, "emit": 50, "take": 40,
}  # fmt: skip
_DRAWS = frozenset(("uniform", "normal", "pick", "chance", "random_agent"))


@dataclass(frozen=True, slots=True)
class Use:
    """One thing that is asked for: its kind, in the words of the table, how often in a step, and the weight of all."""

    kind: str  # senses, fields or draws
    words: str
    weight: float


@dataclass(frozen=True, slots=True)
class Part:
    """What one state asks for, or what every state does: `name` is `MACHINE.STATE`, or `every state`."""

    name: str
    uses: tuple[Use, ...]
    sums: int  # operations on numbers, those inside sets times MEMBERS

    @property
    def weight(self) -> float:
        return self.sums + sum(use.weight for use in self.uses)


def costs(program: Program, species: Species) -> list[Part]:
    """Every state of a species in the order of the text, and last what is done whatever the state."""
    found = [
        Part(
            state.name if len(species.machines) == 1 else f"{machine.name}.{state.name}",
            *_uses(program, _of(species, machine, state)),
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
    return [*found, Part("every state", *_uses(program, always))]


def _of(species: Species, machine: Machine, state: State) -> object:
    """What is worked out in each step in which somebody is in the state; what is done once, on the way in or out, is not."""
    still = species.rest.push if species.rest is not None and state.index in species.rest.silent.get(machine.name, ()) else None
    changes = [(change.condition, change.after, change.held, change.take) for change in state.transitions]
    return state.body, still, changes


def _uses(program: Program, root: object) -> tuple[tuple[Use, ...], int]:
    found: dict[tuple[str, str], float] = {}
    sums = 0
    inside = _inside_sets(root)
    for part in parts(root):
        sums += _operations(part) * (MEMBERS if id(part) in inside else 1)
        for use in _use(part):
            # the same question twice is asked once; draws are each their own
            kept = found.get((use.kind, use.words), 0.0)
            found[use.kind, use.words] = kept + use.weight if use.kind == "draws" else use.weight
    return tuple(Use(kind, words, weight) for (kind, words), weight in found.items()), sums


def _inside_sets(root: object) -> set[int]:
    """What is worked out for each member of a set."""
    return {id(inner) for part in parts(root) if isinstance(part, (Reduce, SetOf)) for inner in _per_member(part)}


def _per_member(part: Reduce | SetOf) -> Iterator[object]:
    body = part.body if isinstance(part, Reduce) else part.where
    return parts(body) if body is not None else iter(())


def _operations(part: object) -> int:
    if isinstance(part, (Steer, Assign)):
        return 3
    if not isinstance(part, Op):
        return 0
    return 3 if part.type.kind.value == "vector" else 1


def _use(part: object) -> Iterable[Use]:
    """What one node of the program asks for."""
    if isinstance(part, SetOf):
        return [_set(part)]
    if isinstance(part, Deposit):
        return [Use("fields", f"lays {part.field}", _WEIGHTS["deposit"])]
    if isinstance(part, Carve):
        return [Use("senses", f"digs {part.solid}", _WEIGHTS["carve"])]
    if isinstance(part, Emit):
        return [Use("senses", f"raises {part.event}", _WEIGHTS["emit"])]
    if isinstance(part, Take):
        return [Use("senses", f"takes {part.attribute}", _WEIGHTS["take"])]
    return [use] if isinstance(part, Op) and (use := _operation(part)) is not None else []


def _set(part: SetOf) -> Use:
    if part.source == "feelers":
        count = constant_behind(part.args[0]) if part.args[0] is not None else None
        rays = int(count.number) if count is not None else RAYS
        return Use("senses", f"{rays} rays on {part.of}", rays * _WEIGHTS["ray"])
    if part.source == "neighbours":
        return Use("senses", f"{part.of} within {_words(part.args[0])}", _WEIGHTS["neighbours"])
    within = f" within {_words(part.args[0])}" if part.args and part.args[0] is not None else ""
    return Use("senses", f"all {part.of}{within}", _WEIGHTS["all"])


def _operation(op: Op) -> Use | None:
    thing = next((arg.name for arg in op.args if isinstance(arg, Thing) and arg.name != "self"), "")
    if op.name in _DRAWS:
        return Use("draws", op.name.removesuffix("_agent"), _WEIGHTS["draw"])
    if op.name == "ray":
        return Use("senses", f"1 ray on {thing}", _WEIGHTS["ray"])
    if op.name == "field_value":
        return Use("fields", f"{thing}", _WEIGHTS["field"])
    if op.name in ("field_max", "strongest"):
        cells = constant_behind(op.args[1]) if len(op.args) > 1 and op.args[1] is not None else None
        number = int(cells.number) if cells is not None else 16
        return Use("fields", f"{number} cells of {thing}", number * _WEIGHTS["cell"])
    if op.name == "gradient":
        return Use("fields", f"slope of {thing}", _WEIGHTS["gradient"])
    if op.name in ("closest", "tangent"):
        return Use("senses", f"curve {thing}", _WEIGHTS["curve"])
    if op.name in ("touching", "distance", "direction", "position") and thing:
        return Use("senses", f"nearest of {thing}", _WEIGHTS["near"])
    if op.name in ("flow_value", "map_value"):
        kind = op.name.removesuffix("_value")
        return Use("senses", f"{kind} {thing}", _WEIGHTS[kind])
    return None


def _words(expr: Expr | None) -> str:
    """An argument as the author wrote it where the behaviour was called, or as it stands in the behaviour."""
    while isinstance(expr, Local) and expr.binding.role == "argument" and expr.binding.value is not None:
        expr = expr.binding.value
    return " ".join(expr.span.text.split()) if expr is not None else "any distance"
