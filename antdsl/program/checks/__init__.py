"""Checks that examine the complete program once all types are known. A new check is one function and one entry in this file."""

from __future__ import annotations

from collections.abc import Callable

from antdsl.diagnostics import Report
from antdsl.program.checks.analysis.checked import CheckContext
from antdsl.program.checks.draws import check_draws
from antdsl.program.checks.flicker import check_flicker
from antdsl.program.checks.layers import check_idle_layers, check_layering
from antdsl.program.checks.per_frame import check_per_frame
from antdsl.program.checks.steps import check_step_units
from antdsl.program.checks.transitions import check_firing, check_reachability, check_shadowed
from antdsl.program.checks.usage import check_empty, check_events, check_unused, check_unused_memory
from antdsl.program.checks.wide_radius import check_wide_radius
from antdsl.program.checks.writers import check_writers

Check = Callable[[CheckContext, Report], None]
CHECKS: tuple[Check, ...] = (
    check_empty,  # a file that does nothing says so before anything else is looked for in it
    check_writers,  # two machines that set the same attribute
    check_layering,  # what the states steer must have its line
    check_step_units,  # for `--strict`: what is said in steps
)

# What can only be said of a program without errors: it reads meaning out of what is written, and out of what is not. Where
# something is wrong, what seems idle may be what was meant there.
OF_SOUND: tuple[Check, ...] = (
    check_reachability,  # states that nothing leads to, and that nothing leads out of
    check_shadowed,  # changes that can never be looked at
    check_events,  # raised and never noticed, noticed and never raised
    check_unused,  # declared and never used
    check_firing,  # their conditions never hold, or always
    check_flicker,  # two states that send the animal to each other
    check_draws,  # numbers drawn in a condition
    check_per_frame,  # values that change by so much a frame
    check_wide_radius,  # neighbours that include all agents
    check_idle_layers,  # lines that no strength is left for
    check_unused_memory,  # attributes and fields that are only set, or only read
)

# Those that look at each species alone, at nothing but its own parts and the params.
OF_EACH = frozenset(
    (
        check_shadowed,
        check_writers,
        check_layering,
        check_firing,
        check_flicker,
        check_draws,
        check_per_frame,
        check_wide_radius,
        check_idle_layers,
    )
)
# And of these, those that look at each state alone, and at the layers.
OF_STATES = frozenset((check_firing, check_draws, check_per_frame))

__all__ = ["CHECKS", "OF_EACH", "OF_SOUND", "OF_STATES", "Check", "CheckContext"]
