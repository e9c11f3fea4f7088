"""Lowers state machines: `decide` chooses the winning transition, and `act` executes it (decisions 8 to 11).

`decide` only stores the number of the winning transition in the temp `~MACHINE.pending`. Transitions of a machine are numbered
from 1."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from math import inf

from antdsl.plan import ir
from antdsl.plan.ir import PlanNode, ValueKind
from antdsl.plan.lowering import clips
from antdsl.plan.lowering.actions import report_unsupported, write_statements
from antdsl.plan.lowering.expressions import lower_condition, lower_expression, lower_presence, lower_scalar
from antdsl.plan.lowering.values import EntityRef, NamedThing
from antdsl.plan.lowering.writer import PlanWriter, UnsupportedConstruct
from antdsl.program import model

STEP_COUNT_SLACK = 1 - 4e-7  # 0.5 s at 24 frames per second is 12 steps, even if the float32 quotient is 12.000001


@dataclass(frozen=True, slots=True)
class _StateChange:
    """A transition with its number in the machine and the state that it leaves."""

    number: int
    state: model.State
    transition: model.Transition


class MachineWriter:
    """Writer of the registers and statements of one machine."""

    def __init__(self, w: PlanWriter, machine: model.Machine) -> None:
        self.w, self.machine, self.name = w, machine, machine.name
        self.site = f"{w.species.name}.{machine.name}"
        pairs = [(s, t) for s in machine.states for t in s.transitions]
        self.changes = [_StateChange(n, s, t) for n, (s, t) in enumerate(pairs, 1)]
        self.key_counts = Counter(t.key for _, t in pairs)
        for part in ("state", "previous", "next"):
            w.declare_register(f"{self.name}.{part}", ValueKind.I32, "memory")
        w.declare_register(f"{self.name}.time_in_state", ValueKind.F32, "memory")
        if clips.plays_clips(machine):
            clips.declare_registers(w, machine)
        w.declare_register(self.pending_register, ValueKind.I32, "temp")
        w.declare_register(self.won_register, ValueKind.BOOL, "temp")
        for change in self.changes:
            if change.transition.hold_time is not None:
                w.declare_register(_format_counter_name(change.transition), ValueKind.F32, "memory")

    @property
    def pending_register(self) -> str:
        """Return the name of the register that stores the number of the winning transition. The number is 0 if no transition
        wins."""
        return f"~{self.name}.pending"

    @property
    def won_register(self) -> str:
        """Return the name of the register that is true for agents of which the claim by a `take` was granted."""
        return f"~{self.name}.won"

    def make_plan(self) -> ir.MachinePlan:
        states = self.machine.states
        return ir.MachinePlan(
            self.name,
            tuple(s.name for s in states),
            tuple(s.label for s in states),
            tuple(s.colour for s in states),
            self.machine.start,
        )

    def _is_in_state(self, state: model.State) -> PlanNode:
        if len(self.machine.states) == 1:
            return self.w.b.true
        return self.w.b("eq", self.w.read_at_step_start(f"{self.name}.state"), self.w.b.add_row(state.index))

    def is_in_any_state(self, states: Iterable[int]) -> PlanNode:
        """Return a node that is true if the index of the current state is in `states`."""
        state = self.w.read_at_step_start(f"{self.name}.state")
        is_among = self.w.b.false
        for index in states:
            is_among = self.w.b("or", is_among, self.w.b("eq", state, self.w.b.add_row(index)))
        return is_among

    # --- birth -------------------------------------------------------------------------------------------------------

    def write_start_state(self) -> None:
        """Write the statements that set the state at birth. Call this before any other part of birth is written."""
        first = self._choose_start()
        for part in ("state", "previous", "next"):
            self.w.add_store(f"{self.name}.{part}", first, self.machine.span)
        self.write_per_start_state(partial(clips.write_start_clip, self.w, self.machine))

    def _choose_start(self) -> PlanNode:
        """Return the index of the state at birth: the state that the scene sets, else the start state."""
        b = self.w.b
        first = b.add_row(self.machine.start)
        if self._scene_key in self.w.scene_attributes:
            self.w.declare_register(ir.format_birth_register_name(self._scene_key), ValueKind.F32, "temp", inf)
            scene_value = self.w.read_at_step_start(ir.format_birth_register_name(self._scene_key))
            for state in self.machine.states:
                first = b("where", b("eq", scene_value, b.add_number(state.index)), b.add_row(state.index), first)
        return first

    @property
    def _scene_key(self) -> str:
        return f"{self.name}.state"

    def write_per_start_state(self, write: Callable[[model.State], None]) -> None:
        """Call `write` for each state in which an agent can be at birth. This is only the start state, or every state if the
        scene may set the state."""
        if self._scene_key in self.w.scene_attributes:
            self._write_per_state(self.machine.states, write)
        else:
            write(self.machine.states[self.machine.start])

    def write_start_actions(self) -> None:
        """Write the enter actions of the state that an agent has at birth."""
        self.write_per_start_state(lambda state: write_statements(self.w, state.enter, f"{self.site}.{state.name}.enter"))

    # --- decide ------------------------------------------------------------------------------------------------------

    def write_decision(self) -> None:
        """Write the check of each state's transitions, in order. The first transition that holds wins. If it has a `take`, emit
        the claim."""
        by_state = [(s, [c for c in self.changes if c.state is s]) for s in self.machine.states]
        self.w.write_alternatives([(self._is_in_state(s), s.span, partial(self._write_winner, cs)) for s, cs in by_state if cs])
        self._write_per_transition([c for c in self.changes if c.transition.take_action], self._write_claim)

    def _write_per_state(self, states: Iterable[model.State], write: Callable[[model.State], None]) -> None:
        self.w.write_alternatives([(self._is_in_state(s), s.span, partial(write, s)) for s in states])

    def _write_per_transition(self, changes: Iterable[_StateChange], write: Callable[[_StateChange], None]) -> None:
        self.w.write_alternatives([(self._is_winning(c), c.transition.span, partial(write, c)) for c in changes])

    def _is_winning(self, change: _StateChange) -> PlanNode:
        """Return a node that is true if `change` is the winning transition of this step."""
        return self.w.b("eq", self.w.read_at_step_start(self.pending_register), self.w.b.add_row(change.number))

    def _write_winner(self, changes: list[_StateChange]) -> None:
        """Write a store of the number of the first transition that holds. `changes`: the transitions that leave one state, in
        order."""
        winner = self.w.b.add_row(0)
        weighed = [(c, self._lower_firing_condition(c)) for c in changes]
        for change, fires in weighed:
            self.w.note_transition(self.name, change.number, change.state, change.transition, fires)
        for change, fires in reversed(weighed):
            winner = self.w.b("where", fires, self.w.b.add_row(change.number), winner)
        self.w.add_store(self.pending_register, winner, changes[0].state.span)

    def _lower_firing_condition(self, change: _StateChange) -> PlanNode:
        """Return a node that is true if all conditions of a transition hold."""
        w, t = self.w, change.transition
        w.b.span = t.span
        try:
            holds = w.b.true if t.condition is None else lower_condition(w, t.condition)
            if t.hold_time is not None:
                holds = self._has_condition_held_for(t, holds, t.hold_time)
            if t.delay is not None:
                holds = w.b("and", has_state_lasted(w, self.name, t.delay), holds)
            if change.state.min_duration is not None and not t.is_interrupt:
                holds = w.b("and", has_state_lasted(w, self.name, change.state.min_duration), holds)
            if self._is_from_any(t) and t.target is None:
                holds = w.b("and", holds, w.b("ne", self._lower_target(change), w.read_at_step_start(f"{self.name}.state")))
            if t.take_action is not None and t.take_action.source.type.kind is not model.TypeKind.FIELD:
                holds = w.b("and", holds, lower_presence(w, lower_expression(w, t.take_action.source), t.take_action.source))
            return holds
        except UnsupportedConstruct as missing:
            report_unsupported(w, missing)
            return w.b.false

    def _is_from_any(self, transition: model.Transition) -> bool:
        """Return whether a transition was declared `from any`.

        Such a transition never leads into the current state. The current state is only known at run time."""
        return transition.key.startswith(f"{self.site}.{model.FROM_ANY_KEY}->")

    def _has_condition_held_for(self, transition: model.Transition, condition: PlanNode, duration: model.Expr) -> PlanNode:
        """Return a node that is true if a condition holds in this step and has held for the time `duration` before it.

        Also write the statement that counts the steps in which the condition holds."""
        b, counter = self.w.b, _format_counter_name(transition)
        previous_count = self.w.read_previous(counter)
        count = b("where", condition, b("add", previous_count, b.add_number(1)), b.add_number(0))
        self.w.add_store(counter, count, transition.span)
        return b("and", condition, b("ge", previous_count, count_steps(self.w, lower_scalar(self.w, duration))))

    def _write_claim(self, change: _StateChange) -> None:
        w, take = self.w, change.transition.take_action
        assert take is not None
        source = lower_expression(w, take.source)
        own = take.attribute if take.attribute in w.registers else None
        amount = None if take.amount is None else lower_scalar(w, take.amount)
        if isinstance(source, NamedThing):
            of, item, attribute = source.name, None, ""
        else:
            assert isinstance(source, EntityRef) and take.attribute is not None
            of, item, attribute = source.owner, source.node, take.attribute
        w.add_statement(ir.Claim(of, attribute, item, amount, self.won_register, own, change.transition.key, take.span))
        w.mark_written(self.won_register)
        if own:
            w.mark_written(own)

    # --- act ---------------------------------------------------------------------------------------------------------

    def write_actions(self) -> None:
        """Write the exit actions, the transition's actions, the change of state, the enter actions, and then the body of the new
        state."""
        w = self.w
        if self.changes:
            with w.open_region(self._is_changing(), self.machine.span):
                self._write_state_change()
        self._write_per_state(self.machine.states, self._write_state_body)

    def _write_state_body(self, state: model.State) -> None:
        write_statements(self.w, state.body, f"{self.site}.{state.name}", self.name)
        clips.fade_out_clip(self.w, self.machine, state)

    def _is_changing(self) -> PlanNode:
        b = self.w.b
        chosen = b("ne", self.w.read_at_step_start(self.pending_register), b.add_row(0))
        taking = [c for c in self.changes if c.transition.take_action]
        if not taking:
            return chosen
        is_requested = b.false
        for change in taking:
            is_requested = b("or", is_requested, self._is_winning(change))
        return b("and", chosen, b("or", b("not", is_requested), self.w.read_at_step_start(self.won_register)))

    def _write_state_change(self) -> None:
        w, name, b = self.w, self.name, self.w.b
        old = w.read_at_step_start(f"{name}.state")
        target = old
        for change in reversed(self.changes):
            target = b("where", self._is_winning(change), self._lower_target(change), target)
        w.add_store(f"{name}.next", target, self.machine.span)
        self._write_per_state(
            (s for s in self.machine.states if s.exit), lambda s: write_statements(w, s.exit, f"{self.site}.{s.name}.exit")
        )
        if clips.plays_clips(self.machine):
            self._write_per_transition(
                self.changes, lambda c: clips.store_fade_time(w, self.machine, c.transition.fade_time, c.transition.span)
            )
        acting = (c for c in self.changes if c.transition.actions)
        self._write_per_transition(acting, lambda c: write_statements(w, c.transition.actions, c.transition.key))
        w.add_store(f"{name}.previous", old, self.machine.span)
        w.add_store(f"{name}.state", w.read_at_step_start(f"{name}.next"), self.machine.span)
        w.add_store(f"{name}.time_in_state", b.add_number(0), self.machine.span)
        self._write_per_state(self.machine.states, self._write_entry)

    def _lower_target(self, change: _StateChange) -> PlanNode:
        """Return the index of the state that a transition leads to. For a `choose`, the state is drawn at random."""
        w, t, b = self.w, change.transition, self.w.b
        if t.targets_previous:
            return w.read_at_step_start(f"{self.name}.previous")
        if not t.choices:
            return b.add_row(t.target if t.target is not None else change.state.index)
        weights = [(index, b("max", lower_scalar(w, weight), b.add_number(0))) for index, weight in t.choices]
        bounds, total = [], b.add_number(0)
        for index, weight in weights:
            total = b("add", total, weight)
            bounds.append((index, total))
        draw = b("draw", attrs=(f"{t.key}.choose", 0))
        w.note_state_choice(t.key, draw, weights)
        place = b("mul", draw, total)
        target = b.add_row(t.choices[-1][0])
        for index, bound in reversed(bounds[:-1]):
            target = b("where", b("lt", place, bound), b.add_row(index), target)
        return target

    def _write_entry(self, state: model.State) -> None:
        """Write the entry into a state: first reset the counters for `held`, then run the enter actions.

        Each counter belongs to a transition. If only one state has this transition, the counter is reset on entry into that
        state. If several states share the transition, the counter is reset on entry into a state without it."""
        own_keys = {t.key for t in state.transitions}
        for key in dict.fromkeys(c.transition.key for c in self.changes if c.transition.hold_time is not None):
            counter = f"{key}.held"
            if (self.key_counts[key] == 1) == (key in own_keys):
                self.w.add_store(counter, self.w.b.add_number(0), state.span)
        write_statements(self.w, state.enter, f"{self.site}.{state.name}.enter")
        clips.restart_clip(self.w, self.machine, state)

    def advance_time(self) -> None:
        """Write a statement that adds one step to the time in the state."""
        advance_state_time(self.w, self.name)


def _format_counter_name(transition: model.Transition) -> str:
    return f"{transition.key}.held"


def count_steps(w: PlanWriter, duration: PlanNode) -> PlanNode:
    """Return the smallest whole number of steps that lasts at least `duration`."""
    b = w.b
    ratio = b("mul", b("div", duration, w.read_run_value("dt")), b.add_number(STEP_COUNT_SLACK))
    return b("neg", b("floor", b("neg", ratio)))


def has_state_lasted(w: PlanWriter, machine: str, duration: model.Expr) -> PlanNode:
    """Return a node that is true if the machine of the agent has been in its current state for at least `duration`."""
    b = w.b
    nearly = b("sub", count_steps(w, lower_scalar(w, duration)), b.add_number(0.5))
    return b("ge", w.read_at_step_start(f"{machine}.time_in_state"), b("mul", nearly, w.read_run_value("dt")))


def advance_state_time(w: PlanWriter, machine: str) -> None:
    """Write a statement that adds one step to the time in the state. The time is a whole number of steps, so no rounding errors
    accumulate."""
    b, dt = w.b, w.read_run_value("dt")
    name = f"{machine}.time_in_state"
    step_count = b("floor", b("add", b("div", w.read_at_step_start(name), dt), b.add_number(1.5)))
    w.add_store(name, b("mul", step_count, dt), None)
