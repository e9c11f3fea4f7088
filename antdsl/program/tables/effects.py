"""What an agent may ask of the rest of the world: each a row from which the plan's statement, its checks, its text, the record of
a step, the trace and the costs are made.

An effect is added by a row here, a rule in `antdsl.plan.lowering.actions` that lowers its line, and a function in the phases
that settles what was asked. What is settled between all who ask (`take`, `give`) and what changes only the agent itself is no
row.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from antdsl.program.tables.rows import Cost


@dataclass(frozen=True, slots=True)
class Effect:
    """`target`: the kind of thing it names, "" for none. `operands`: numbers, by name; those of `optional` may be missing.
    `phase`: the phase of a step that settles it. `help`: for the editor; `meaning`: for readers of plans.

    `shown` is its line of a plan and `told` that of a trace: `{of}` what it names, `{own}` the agent's register that it fills
    after the blocks, and the operands by name; a part in square brackets is left out where one of these is missing. `refused`:
    how a fault is called if an operand is not finite; "" where that does not matter. `above_0`: nothing is asked where the first
    operand is 0 or less; `quiet_at_0`: a trace does not tell of a first operand of 0."""

    op: str
    target: str
    operands: tuple[str, ...]
    phase: str
    help: str
    meaning: str
    shown: str
    told: str
    optional: frozenset[str] = frozenset()
    refused: str = ""
    above_0: bool = False
    quiet_at_0: bool = False
    cost: Cost | None = None


_ROWS = (
    Effect(
        "deposit",
        "field",
        ("amount",),
        "effects",
        "lays scent into a field",
        "lands in the agent's own cell at t+1; the amount of a step (already multiplied by dt)",
        "deposit {amount} in {of}",
        "deposit {of} {amount}",
        refused="deposit {of}",
        quiet_at_0=True,
        cost=Cost(25, "lays {thing}", "fields"),
    ),
    Effect(
        "carve",
        "solid",
        ("radius", "x", "y", "z"),
        "solids",
        "digs a ball out of a solid",
        "digs a ball of `radius` (mm) with its middle at (x, y, z) out of a solid, to be gone at t+1; what it had of the solid "
        "(mm³) is added to the agent's own register, if one is named, after the step's blocks",
        "carve {of} ball {radius} at {x}, {y}, {z}[ -> {own}]",
        "carve {of}, radius {radius} mm",
        refused="carve {of}",
        above_0=True,
        cost=Cost(1000, "digs {thing}"),
    ),
    Effect(
        "emit",
        "event",
        ("within",),
        "effects",
        "raises an event",
        "raises an event for all agents that handle it within a distance (mm; none: only for itself), seen at t+1",
        "emit {of}[ within {within}]",
        "emit {of}[ within {within} mm]",
        optional=frozenset(("within",)),
        cost=Cost(50, "raises {thing}"),
    ),
    Effect(
        "spawn",
        "species",
        (),
        "births",
        "makes a new agent",
        "a new agent where this one stands, at t+1",
        "spawn {of}",
        "spawn {of}",
    ),
    Effect("die", "", (), "births", "ends this agent", "the agent is gone at t+1", "die", "die"),
)
EFFECTS: dict[str, Effect] = {row.op: row for row in _ROWS}


def phrase(template: str, values: Mapping[str, str | None]) -> str:
    """A template with its values; a part in square brackets is left out where one of its values is None."""

    def part(found: re.Match[str]) -> str:
        inner = found.group(1)
        return "" if any(values[name] is None for name in _NAME.findall(inner)) else inner

    return _PART.sub(part, template).format_map(values)


_PART = re.compile(r"\[([^\]]*)\]")
_NAME = re.compile(r"\{(\w+)\}")
