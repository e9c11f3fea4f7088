"""Checks that examine the complete program once all types are known. To add a check, add one function and one entry in this
file."""

from __future__ import annotations

from collections.abc import Callable

from antdsl.diagnostics import Report
from antdsl.program.checks.analysis.check_context import CheckContext
from antdsl.program.checks.attribute_writers import check_writers
from antdsl.program.checks.draws import check_draws
from antdsl.program.checks.flicker import check_state_flicker
from antdsl.program.checks.layers import check_idle_layers, check_layer_order
from antdsl.program.checks.per_frame import check_per_frame
from antdsl.program.checks.steps import check_step_units
from antdsl.program.checks.transitions import check_constant_conditions, check_reachability, check_shadowed_transitions
from antdsl.program.checks.usage import check_empty_program, check_events, check_unused_memory, check_unused_names
from antdsl.program.checks.wide_radius import check_wide_radius

Check = Callable[[CheckContext, Report], None]
CHECKS: tuple[Check, ...] = (
    check_empty_program,  # a program that declares nothing that acts
    check_writers,  # two machines that set one attribute
    check_layer_order,  # a missing layer `state`
    check_step_units,  # for `--strict`: uses of the unit `step`
)

# Checks only for programs without errors. They report unused or ineffective code. If there are errors, the author may have meant
# to use such code.
ERROR_FREE_CHECKS: tuple[Check, ...] = (
    check_reachability,  # states that no transition enters or leaves
    check_shadowed_transitions,  # transitions that an earlier one always precedes
    check_events,  # events that are emitted but never handled, or the reverse
    check_unused_names,  # declarations that are never used
    check_constant_conditions,  # conditions that never or always hold
    check_state_flicker,  # two states that lead to each other for the same values
    check_draws,  # random draws in conditions
    check_per_frame,  # changes that depend on the frame rate
    check_wide_radius,  # neighbours that include all agents
    check_idle_layers,  # layers for which no strength is left
    check_unused_memory,  # attributes and fields that are only set, or only read
)

# Checks that examine each species separately: only its own parts and the params.
PER_SPECIES_CHECKS = frozenset(
    (
        check_shadowed_transitions,
        check_writers,
        check_layer_order,
        check_constant_conditions,
        check_state_flicker,
        check_draws,
        check_per_frame,
        check_wide_radius,
        check_idle_layers,
    )
)
# Of these, the checks that examine each state separately, and the layers.
PER_STATE_CHECKS = frozenset((check_constant_conditions, check_draws, check_per_frame))

__all__ = ["CHECKS", "ERROR_FREE_CHECKS", "PER_SPECIES_CHECKS", "PER_STATE_CHECKS", "Check", "CheckContext"]
