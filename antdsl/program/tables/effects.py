"""The requests that an agent may make of the world, one row each. A row defines the checks of its line, the plan's statement with
its checks and text, and the record of a step. It also defines the trace, the costs and the editor's words.

The syntax of its line is the row of the same word in `antdsl.syntax.verbs`. The function that settles it is in
`SETTLER_BY_EFFECT` of `antdsl.runtime.phases`. Requests that are settled among several agents (`take`, `give`) and statements
that change only the agent itself have no row."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from antdsl.program.tables.rows import ArgumentRow, UseCost


@dataclass(frozen=True, slots=True)
class Effect:
    """`target`: the kind of what it names, "" for none. `args`: what follows the name; one of type `added A` is written without
    brackets, one of type `agent` after the word `to`. `computed`: the operands of the plan, by name, if `OPERAND_LOWERERS` of
    `antdsl.plan.lowering.actions` has a function that computes them. `phase`: the phase of a step that resolves it. `help`: for
    the editor; `meaning`: for readers of plans. `too_often`: what is wrong with its line in a state's body; "" if it may be
    there. `last`: the agent is removed after it. `draws`: random numbers depend on its place in the text. `feeds`: it supplies
    what it names with what others look for, as a field gets scent and an event is raised.

    `plan_text` is its line of a plan and `trace` that of a trace. `{of}` is what it names, `{own}` the agent's register that it
    fills after the blocks. `{receiver}` (in a trace) is the species of the one agent that it is for; operands are by name. A part
    in square brackets is left out if one of these is missing. `refused`: the name of the fault if an operand is not finite; "" if
    that does not matter. `above_0`: nothing is requested if the first operand is 0 or less; `quiet_at_0`: a trace omits a first
    operand of 0."""

    op: str
    target: str
    args: tuple[ArgumentRow, ...]
    phase: str
    help: str
    meaning: str
    plan_text: str
    trace: str
    computed: tuple[str, ...] = ()
    too_often: str = ""
    last: bool = False
    draws: bool = False
    feeds: bool = False
    refused: str = ""
    above_0: bool = False
    quiet_at_0: bool = False
    cost: UseCost | None = None

    @property
    def numbers(self) -> tuple[ArgumentRow, ...]:
        """Return the arguments that are computed; the others name an attribute."""
        return tuple(arg for arg in self.args if not arg.type.startswith("own "))

    @property
    def operands(self) -> tuple[str, ...]:
        """What the plan's statement has, by name."""
        return self.computed or tuple(arg.name for arg in self.numbers)

    @property
    def agents(self) -> frozenset[str]:
        """Operands that are the id of an agent."""
        return frozenset() if self.computed else frozenset(arg.name for arg in self.numbers if arg.type == "agent")

    @property
    def optional(self) -> frozenset[str]:
        """Operands that may be missing."""
        return frozenset() if self.computed else frozenset(arg.name for arg in self.numbers if arg.optional)


_EFFECT_ROWS = (
    Effect(
        "deposit",
        "field",
        (ArgumentRow("amount", "added number"),),
        "effects",
        "lays scent into a field",
        "lands in the agent's own cell at t+1; the amount of a step (already multiplied by dt)",
        "deposit {amount} in {of}",
        "deposit {of} {amount}",
        feeds=True,
        refused="deposit {of}",
        quiet_at_0=True,
        cost=UseCost(25, "lays {thing}", "fields"),
    ),
    Effect(
        "carve",
        "solid",
        (
            ArgumentRow("radius", "length", above=0, called="radius of a ball to dig", sample="size / 2"),
            ArgumentRow("toward", "push", optional=True),
            ArgumentRow("into", "own mm^3", optional=True, called="a volume", sample="soil"),
        ),
        "solids",
        "digs a ball out of a solid",
        "digs a ball of `radius` (mm) with its middle at (x, y, z) out of a solid, to be gone at t+1; what it had of the solid "
        "(mm³) is added to the agent's own register, if one is named, after the step's blocks",
        "carve {of} ball {radius} at {x}, {y}, {z}[ -> {own}]",
        "carve {of}, radius {radius} mm",
        computed=("radius", "x", "y", "z"),
        refused="carve {of}",
        above_0=True,
        cost=UseCost(1000, "digs {thing}"),
    ),
    Effect(
        "emit",
        "event",
        (ArgumentRow("within", "length", optional=True), ArgumentRow("to", "agent", optional=True)),
        "effects",
        "raises an event",
        "raises an event for all agents that handle it within a distance (mm; none: only for itself), or for one agent "
        "alone (if it is in reach, where a distance is given), seen at t+1",
        "emit {of}[ within {within}][ to {to}]",
        "emit {of}[ within {within} mm][ to {receiver} {to}]",
        feeds=True,
        cost=UseCost(50, "raises {thing}"),
    ),
    Effect(
        "spawn",
        "species",
        (),
        "births",
        "makes a new agent",
        "makes a new agent at this one's position, at t+1",
        "spawn {of}",
        "spawn {of}",
        too_often="would make a new one in every step",
        draws=True,
    ),
    Effect("die", "", (), "births", "removes this agent", "the agent is removed at t+1", "die", "die", last=True),
)
EFFECT_BY_OPERATION: dict[str, Effect] = {row.op: row for row in _EFFECT_ROWS}


def effects_of_phase(phase: str) -> tuple[str, ...]:
    """The effects that a phase of a step settles, in the order of the table."""
    return tuple(row.op for row in EFFECT_BY_OPERATION.values() if row.phase == phase)


def feeding_effects(kind: str) -> frozenset[str]:
    """Return the effects that add to the thing they name, a `field` or an `event`."""
    return frozenset(row.op for row in EFFECT_BY_OPERATION.values() if row.feeds and row.target == kind)


def fill_template(template: str, values: Mapping[str, str | None]) -> str:
    """A template with its values; a part in square brackets is left out where one of its values is None."""

    def part(match: re.Match[str]) -> str:
        inner = match.group(1)
        return "" if any(values[name] is None for name in _PLACEHOLDER_PATTERN.findall(inner)) else inner

    return _OPTIONAL_PART_PATTERN.sub(part, template).format_map(values)


_OPTIONAL_PART_PATTERN = re.compile(r"\[([^\]]*)\]")
_PLACEHOLDER_PATTERN = re.compile(r"\{(\w+)\}")
