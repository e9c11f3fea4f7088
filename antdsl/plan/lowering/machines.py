"""Lowers state machines: `decide` determines the winning transition, `act` executes it (decisions 8 to 11).

`decide` only stores the number of the winning transition in the temp `~MACHINE.pending`. Transitions of a machine are numbered
from 1."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

from antdsl.plan import ir
from antdsl.plan.ir import PlanNode, ValueKind
from antdsl.plan.lowering import clips
from antdsl.plan.lowering.actions import complain, write
from antdsl.plan.lowering.expressions import lower, presence, scalar, truth
from antdsl.plan.lowering.values import EntityRef, NamedThing
from antdsl.plan.lowering.writer import PlanWriter, UnsupportedConstruct
from antdsl.program import model

STEP_COUNT_SLACK = 1 - 4e-7  # 0.5 s at 24 frames a second is 12 steps, also where the quotient of two float32 says 12.000001


@dataclass(frozen=True, slots=True)
class _StateChange:
    """A transition with its number in the machine and the state that it leaves."""

    number: int
    state: model.State
    transition: model.Transition


class MachineWriter:
    """Writes the registers and statements of one machine."""

    def __init__(self, w: PlanWriter, machine: model.Machine) -> None:
        self.w, self.machine, self.name = w, machine, machine.name
        self.site = f"{w.species.name}.{machine.name}"
        pairs = [(s, t) for s in machine.states for t in s.transitions]
        self.changes = [_StateChange(n, s, t) for n, (s, t) in enumerate(pairs, 1)]
        self.shared = Counter(t.key for _, t in pairs)
        for part in ("state", "previous", "next"):
            w.declare(f"{self.name}.{part}", ValueKind.I32, "memory")
        w.declare(f"{self.name}.time_in_state", ValueKind.F32, "memory")
        if clips.plays_clips(machine):
            clips.declare(w, machine)
        w.declare(self.pending, ValueKind.I32, "temp")
        w.declare(self.won, ValueKind.BOOL, "temp")
        for change in self.changes:
            if change.transition.held is not None:
                w.declare(_counter(change.transition), ValueKind.F32, "memory")

    @property
    def pending(self) -> str:
        """Return the register with the number of the winning transition; 0: none."""
        return f"~{self.name}.pending"

    @property
    def won(self) -> str:
        """Return the register that is set if the claim of a take succeeded."""
        return f"~{self.name}.won"

    def plan(self) -> ir.MachinePlan:
        states = self.machine.states
        return ir.MachinePlan(
            self.name,
            tuple(s.name for s in states),
            tuple(s.label for s in states),
            tuple(s.colour for s in states),
            self.machine.start,
        )

    def _is_in(self, state: model.State) -> PlanNode:
        if len(self.machine.states) == 1:
            return self.w.b.true
        return self.w.b("eq", self.w.read(f"{self.name}.state"), self.w.b.row(state.index))

    def among(self, states: Iterable[int]) -> PlanNode:
        """Return whether the current state is one of these states."""
        state = self.w.read(f"{self.name}.state")
        is_among = self.w.b.false
        for index in states:
            is_among = self.w.b("or", is_among, self.w.b("eq", state, self.w.b.row(index)))
        return is_among

    # --- birth -------------------------------------------------------------------------------------------------------

    def begin(self) -> None:
        """Write the start state, before all other parts of birth."""
        for part in ("state", "previous", "next"):
            self.w.store(f"{self.name}.{part}", self.w.b.row(self.machine.start), self.machine.span)
        clips.begin(self.w, self.machine)

    def enter_start(self) -> None:
        """Write the enter actions of the start state, at birth."""
        start = self.machine.states[self.machine.start]
        write(self.w, start.enter, f"{self.site}.{start.name}.enter")

    # --- decide ------------------------------------------------------------------------------------------------------

    def decide(self) -> None:
        """Check the transitions of each state in order; the first one that holds wins. Winners with a take emit claims."""
        by_state = [(s, [c for c in self.changes if c.state is s]) for s in self.machine.states]
        self.w.alternatives([(self._is_in(s), s.span, partial(self._weigh, cs)) for s, cs in by_state if cs])
        self._per_change([c for c in self.changes if c.transition.take], self._claim)

    def _per_state(self, states: Iterable[model.State], write: Callable[[model.State], None]) -> None:
        self.w.alternatives([(self._is_in(s), s.span, partial(write, s)) for s in states])

    def _per_change(self, changes: Iterable[_StateChange], write: Callable[[_StateChange], None]) -> None:
        self.w.alternatives([(self._is_change(c), c.transition.span, partial(write, c)) for c in changes])

    def _is_change(self, change: _StateChange) -> PlanNode:
        return self.w.b("eq", self.w.read(self.pending), self.w.b.row(change.number))

    def _weigh(self, changes: list[_StateChange]) -> None:
        """Store the number of the first transition of a state that holds."""
        winner = self.w.b.row(0)
        weighed = [(c, self._fires(c)) for c in changes]
        for change, fires in weighed:
            self.w.note_transition(self.name, change.number, change.state, change.transition, fires)
        for change, fires in reversed(weighed):
            winner = self.w.b("where", fires, self.w.b.row(change.number), winner)
        self.w.store(self.pending, winner, changes[0].state.span)

    def _fires(self, change: _StateChange) -> PlanNode:
        """Return whether all conditions of a transition hold."""
        w, t = self.w, change.transition
        w.b.span = t.span
        try:
            holds = w.b.true if t.condition is None else truth(w, t.condition)
            if t.held is not None:
                holds = self._has_held(t, holds, t.held)
            if t.delay is not None:
                holds = w.b("and", has_passed(w, self.name, t.delay), holds)
            if change.state.at_least is not None and not t.interrupt:
                holds = w.b("and", has_passed(w, self.name, change.state.at_least), holds)
            if self._is_from_any(t) and t.target is None:
                holds = w.b("and", holds, w.b("ne", self._target(change), w.read(f"{self.name}.state")))
            if t.take is not None and t.take.source.type.kind is not model.TypeKind.FIELD:
                holds = w.b("and", holds, presence(w, lower(w, t.take.source), t.take.source))
            return holds
        except UnsupportedConstruct as missing:
            complain(w, missing)
            return w.b.false

    def _is_from_any(self, t: model.Transition) -> bool:
        """Return whether a transition was declared `from any`. Such a transition never leads into the current state, which may be
        known only at run time."""
        return t.key.startswith(f"{self.site}.{model.FROM_ANY_KEY}->")

    def _has_held(self, t: model.Transition, holds: PlanNode, duration: model.Expr) -> PlanNode:
        """Return whether the condition `holds` is true now and has been true without a break in the steps of `duration` before.
        Write its step counter."""
        b, counter = self.w.b, _counter(t)
        previous_count = self.w.read_previous(counter)
        count = b("where", holds, b("add", previous_count, b.number(1)), b.number(0))
        self.w.store(counter, count, t.span)
        return b("and", holds, b("ge", previous_count, steps(self.w, scalar(self.w, duration))))

    def _claim(self, change: _StateChange) -> None:
        w, take = self.w, change.transition.take
        assert take is not None
        source = lower(w, take.source)
        own = take.attribute if take.attribute in w.registers else None
        amount = None if take.amount is None else scalar(w, take.amount)
        if isinstance(source, NamedThing):
            of, item, attribute = source.name, None, ""
        else:
            assert isinstance(source, EntityRef) and take.attribute is not None
            of, item, attribute = source.of, source.node, take.attribute
        w.add(ir.Claim(of, attribute, item, amount, self.won, own, change.transition.key, take.span))
        w.mark_written(self.won)
        if own:
            w.mark_written(own)

    # --- act ---------------------------------------------------------------------------------------------------------

    def act(self) -> None:
        """Write the exit actions, the transition's actions, the change of state and the enter actions, then the body of the new
        state."""
        w = self.w
        if self.changes:
            with w.region(self._is_changing(), self.machine.span):
                self._change()
        self._per_state(self.machine.states, self._body)

    def _body(self, state: model.State) -> None:
        write(self.w, state.body, f"{self.site}.{state.name}", self.name)
        clips.rest(self.w, self.machine, state)

    def _is_changing(self) -> PlanNode:
        b = self.w.b
        chosen = b("ne", self.w.read(self.pending), b.row(0))
        taking = [c for c in self.changes if c.transition.take]
        if not taking:
            return chosen
        is_requested = b.false
        for change in taking:
            is_requested = b("or", is_requested, self._is_change(change))
        return b("and", chosen, b("or", b("not", is_requested), self.w.read(self.won)))

    def _change(self) -> None:
        w, name, b = self.w, self.name, self.w.b
        old = w.read(f"{name}.state")
        target = old
        for change in reversed(self.changes):
            target = b("where", self._is_change(change), self._target(change), target)
        w.store(f"{name}.next", target, self.machine.span)
        self._per_state((s for s in self.machine.states if s.exit), lambda s: write(w, s.exit, f"{self.site}.{s.name}.exit"))
        if clips.plays_clips(self.machine):
            self._per_change(self.changes, lambda c: clips.give_way(w, self.machine, c.transition.over, c.transition.span))
        acting = (c for c in self.changes if c.transition.actions)
        self._per_change(acting, lambda c: write(w, c.transition.actions, c.transition.key))
        w.store(f"{name}.previous", old, self.machine.span)
        w.store(f"{name}.state", w.read(f"{name}.next"), self.machine.span)
        w.store(f"{name}.time_in_state", b.number(0), self.machine.span)
        self._per_state(self.machine.states, self._enter)

    def _target(self, change: _StateChange) -> PlanNode:
        """Return the index of the state that a transition leads to; a `choose` draws it."""
        w, t, b = self.w, change.transition, self.w.b
        if t.previous:
            return w.read(f"{self.name}.previous")
        if not t.choices:
            return b.row(t.target if t.target is not None else change.state.index)
        weights = [(index, b("max", scalar(w, weight), b.number(0))) for index, weight in t.choices]
        bounds, total = [], b.number(0)
        for index, weight in weights:
            total = b("add", total, weight)
            bounds.append((index, total))
        draw = b("draw", attrs=(f"{t.key}.choose", 0))
        w.note_choice(t.key, draw, weights)
        place = b("mul", draw, total)
        target = b.row(t.choices[-1][0])
        for index, bound in reversed(bounds[:-1]):
            target = b("where", b("lt", place, bound), b.row(index), target)
        return target

    def _enter(self, state: model.State) -> None:
        """Reset the counters of `held`, then write the enter actions. The counter of a single state is reset on entry into it.
        A counter that several states share is reset on entry into a state without the transition."""
        own_keys = {t.key for t in state.transitions}
        for key in dict.fromkeys(c.transition.key for c in self.changes if c.transition.held is not None):
            counter = f"{key}.held"
            if (self.shared[key] == 1) == (key in own_keys):
                self.w.store(counter, self.w.b.number(0), state.span)
        write(self.w, state.enter, f"{self.site}.{state.name}.enter")
        clips.enter(self.w, self.machine, state)

    def advance(self) -> None:
        """Add one step to the time in the state."""
        advance(self.w, self.name)


def _counter(t: model.Transition) -> str:
    return f"{t.key}.held"


def steps(w: PlanWriter, duration: PlanNode) -> PlanNode:
    """Return the smallest whole number of steps that lasts at least `duration`."""
    b = w.b
    ratio = b("mul", b("div", duration, w.run("dt")), b.number(STEP_COUNT_SLACK))
    return b("neg", b("floor", b("neg", ratio)))


def has_passed(w: PlanWriter, machine: str, duration: model.Expr) -> PlanNode:
    """Return whether the agent has been in the machine's current state for at least `duration`."""
    b = w.b
    nearly = b("sub", steps(w, scalar(w, duration)), b.number(0.5))
    return b("ge", w.read(f"{machine}.time_in_state"), b("mul", nearly, w.run("dt")))


def advance(w: PlanWriter, machine: str) -> None:
    """Add one step to the time in the state. The time is a whole number of steps, so no rounding errors accumulate."""
    b, dt = w.b, w.run("dt")
    name = f"{machine}.time_in_state"
    step_count = b("floor", b("add", b("div", w.read(name), dt), b.number(1.5)))
    w.store(name, b("mul", step_count, dt), None)
