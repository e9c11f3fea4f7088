"""The table of the requests that an agent can send to the world, with one row for each request.

A row defines how the request's line is checked, how plans store and print it, and how the record of a step describes it. It also
defines its trace, its cost and the editor's words. The syntax of the line is in the row of the same word in
`antdsl.syntax.verbs`. The function that resolves the request is in `RESOLVER_BY_EFFECT` of `antdsl.runtime.phases`.
Two kinds of statements have no row: `take` and `give`, which are resolved among several agents, and statements that change only
the agent itself."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from antdsl.program.tables.rows import ArgumentRow, UseCost


@dataclass(frozen=True, slots=True)
class EffectRow:
    """A kind of request to the world.

    - `target`: the kind of the thing that the request names; "" for none.
    - `args`: its arguments. An argument of type `added A` is written without brackets, and one of type `agent` after the word
      `to`.
    - `computed_operands`: the names of the plan's operands, if a function of `antdsl.plan.lowering.actions` computes them.
    - `phase`: the phase of a step that resolves it.
    - `help`: text for the editor. `meaning`: text for readers of plans.
    - `state_body_error`: the text of the error if its line is in a state's body; "" if it is allowed there.
    - `removes_agent`: whether the agent is removed after the request.
    - `uses_draws`: whether it uses random numbers. They depend on its position in the text.
    - `is_feeding_senses`: whether it changes what other agents sense of the named thing. Examples are `deposit` for a field and
      `emit` for an event.
    - `fault_name`: the name of the fault that a NaN or infinite operand causes; "" if such operands are allowed.
    - `needs_positive_operand`: whether the request has no effect if its first operand is 0 or less. `hides_zero_in_trace`:
      whether a trace omits a first operand of 0.
    - `plan_template`, `trace_template`: templates of its line in a plan and in a trace. They contain operands by name.

    Templates may also contain these names: `{of}` is the named thing. `{own}` is the agent's register to which the result is
    added after the blocks. `{receiver}` (traces only) is the species of the single agent that receives the request. A part in
    square brackets is omitted if one of its values is missing."""

    op: str
    target: str
    args: tuple[ArgumentRow, ...]
    phase: str
    help: str
    meaning: str
    plan_template: str
    trace_template: str
    computed_operands: tuple[str, ...] = ()
    state_body_error: str = ""
    removes_agent: bool = False
    uses_draws: bool = False
    is_feeding_senses: bool = False
    fault_name: str = ""
    needs_positive_operand: bool = False
    hides_zero_in_trace: bool = False
    cost: UseCost | None = None

    @property
    def computed_arguments(self) -> tuple[ArgumentRow, ...]:
        """Return the arguments with a computed value. The other arguments name an attribute."""
        return tuple(arg for arg in self.args if not arg.type.startswith("own "))

    @property
    def operand_names(self) -> tuple[str, ...]:
        """Return the names of the operands of the plan's statement."""
        return self.computed_operands or tuple(arg.name for arg in self.computed_arguments)

    @property
    def agent_operands(self) -> frozenset[str]:
        """Return the names of the operands that are ids of agents."""
        return (
            frozenset()
            if self.computed_operands
            else frozenset(arg.name for arg in self.computed_arguments if arg.type == "agent")
        )

    @property
    def optional_operands(self) -> frozenset[str]:
        """Return the names of the operands that may be missing."""
        return (
            frozenset() if self.computed_operands else frozenset(arg.name for arg in self.computed_arguments if arg.is_optional)
        )


_EFFECT_ROWS = (
    EffectRow(
        "deposit",
        "field",
        (ArgumentRow("amount", "added number"),),
        "effects",
        "lays scent into a field",
        "lands in the agent's own cell at t+1; the amount of a step (already multiplied by dt)",
        "deposit {amount} in {of}",
        "deposit {of} {amount}",
        is_feeding_senses=True,
        fault_name="deposit {of}",
        hides_zero_in_trace=True,
        cost=UseCost(25, "lays {thing}", "fields"),
    ),
    EffectRow(
        "carve",
        "solid",
        (
            ArgumentRow("radius", "length", lower_bound=0, display_name="radius of a ball to dig", sample="size / 2"),
            ArgumentRow("toward", "push", is_optional=True),
            ArgumentRow("into", "own mm^3", is_optional=True, display_name="a volume", sample="soil"),
        ),
        "solids",
        "digs a ball out of a solid",
        "digs a ball of `radius` (mm) around (x, y, z) out of a solid, removed at t+1; what it had of the solid "
        "(mm³) is added to the agent's own register, if one is named, after the step's blocks",
        "carve {of} ball {radius} at {x}, {y}, {z}[ -> {own}]",
        "carve {of}, radius {radius} mm",
        computed_operands=("radius", "x", "y", "z"),
        fault_name="carve {of}",
        needs_positive_operand=True,
        cost=UseCost(1000, "digs {thing}"),
    ),
    EffectRow(
        "emit",
        "event",
        (ArgumentRow("within", "length", is_optional=True), ArgumentRow("to", "agent", is_optional=True)),
        "effects",
        "raises an event",
        "raises an event for all agents that handle it within a distance (mm; none: only for itself), or for one agent "
        "alone (if it is in reach, where a distance is given), seen at t+1",
        "emit {of}[ within {within}][ to {to}]",
        "emit {of}[ within {within} mm][ to {receiver} {to}]",
        is_feeding_senses=True,
        cost=UseCost(50, "raises {thing}"),
    ),
    EffectRow(
        "spawn",
        "species",
        (),
        "births",
        "makes a new agent",
        "makes a new agent at this one's position, at t+1",
        "spawn {of}",
        "spawn {of}",
        state_body_error="would create an agent in every step",
        uses_draws=True,
    ),
    EffectRow("die", "", (), "births", "removes this agent", "the agent is removed at t+1", "die", "die", removes_agent=True),
)
EFFECT_BY_OPERATION: dict[str, EffectRow] = {row.op: row for row in _EFFECT_ROWS}


def list_effects_of_phase(phase: str) -> tuple[str, ...]:
    """Return the effects that a phase of a step resolves, in the order of the table."""
    return tuple(row.op for row in EFFECT_BY_OPERATION.values() if row.phase == phase)


def list_feeding_effects(kind: str) -> frozenset[str]:
    """Return the names of the requests that change what agents sense of things of one kind. `kind`: "field" or "event"."""
    return frozenset(row.op for row in EFFECT_BY_OPERATION.values() if row.is_feeding_senses and row.target == kind)


def fill_template(template: str, values: Mapping[str, str | None]) -> str:
    """Return the template with each name replaced by its value. A part in square brackets is omitted if one of the values in it
    is None."""

    def fill_part(match: re.Match[str]) -> str:
        inner = match.group(1)
        return "" if any(values[name] is None for name in _PLACEHOLDER_PATTERN.findall(inner)) else inner

    return _OPTIONAL_PART_PATTERN.sub(fill_part, template).format_map(values)


_OPTIONAL_PART_PATTERN = re.compile(r"\[([^\]]*)\]")
_PLACEHOLDER_PATTERN = re.compile(r"\{(\w+)\}")
