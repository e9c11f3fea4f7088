"""Checks that look at a whole program once its types are known. A new check is one file and one entry here."""

from __future__ import annotations

from collections.abc import Callable

from antdsl.diagnostics import Report
from antdsl.program.checks.analysis.checked import Checked
from antdsl.program.checks.draws import draws
from antdsl.program.checks.empty import empty
from antdsl.program.checks.events import events
from antdsl.program.checks.firing import firing
from antdsl.program.checks.flicker import flicker
from antdsl.program.checks.idle_layers import idle_layers
from antdsl.program.checks.layering import layering
from antdsl.program.checks.one_way import one_way
from antdsl.program.checks.per_frame import per_frame
from antdsl.program.checks.reachability import reachability
from antdsl.program.checks.shadowed import shadowed
from antdsl.program.checks.steps import steps
from antdsl.program.checks.unused import unused
from antdsl.program.checks.wide_radius import wide_radius
from antdsl.program.checks.writers import writers

Check = Callable[[Checked, Report], None]
CHECKS: tuple[Check, ...] = (
    empty,  # a file that does nothing says so before anything else is looked for in it
    writers,  # two machines that set the same attribute
    layering,  # what the states steer must have its line
    steps,  # for `--strict`: what is said in steps
)

# What can only be said of a program without errors: it reads meaning out of what is written, and out of what is not. Where
# something is wrong, what seems idle may be what was meant there.
OF_SOUND: tuple[Check, ...] = (
    reachability,  # states that nothing leads to, and that nothing leads out of
    shadowed,  # changes that can never be looked at
    events,  # raised and never noticed, noticed and never raised
    unused,  # declared and never used
    firing,  # their conditions never hold, or always
    flicker,  # two states that send the animal to each other
    draws,  # numbers drawn in a condition
    per_frame,  # values that change by so much a frame
    wide_radius,  # neighbours that include all agents
    idle_layers,  # lines that no strength is left for
    one_way,  # attributes and fields that are only set, or only read
)

# Those that look at each species alone, at nothing but its own parts and the params.
OF_EACH = frozenset((shadowed, writers, layering, firing, flicker, draws, per_frame, wide_radius, idle_layers))
# And of these, those that look at each state alone, and at the layers.
OF_STATES = frozenset((firing, draws, per_frame))

__all__ = ["CHECKS", "OF_EACH", "OF_SOUND", "OF_STATES", "Check", "Checked"]
