"""Construction of charts from a program: one chart for each machine, as an author would draw it on paper.

A transition `from any` is a single arrow from a box `any`, instead of one arrow from each state. `previous` is a box next to the
state that uses it."""

from __future__ import annotations

import re
from pathlib import PurePath

from antdsl.graphs.model import Arrow, Box, Chart
from antdsl.program.model import FROM_ANY_KEY, Machine, Program, State, Transition
from antdsl.source import Span

_BLACK = (0.15, 0.15, 0.17)
_GREY = (0.45, 0.46, 0.48)


def build_charts(program: Program) -> tuple[Chart, ...]:
    """Return a chart for each machine of each species, in the order of the source text. A species without states has no
    charts."""
    all_charts = []
    for species in program.species.values():
        for machine in species.machines:
            if machine.states:
                has_one_machine = len(species.machines) == 1
                all_charts.append(_build_chart(species.name if has_one_machine else f"{species.name}.{machine.name}", machine))
    return tuple(all_charts)


def _build_chart(title: str, machine: Machine) -> Chart:
    """Return the chart of one machine."""
    sketch = _ChartBuilder(machine)
    for state in machine.states:
        own_changes = [change for change in state.transitions if not _is_from_any(change)]
        for number, change in enumerate(own_changes, 1):
            sketch.add_transition(f"s{state.index}", change, state.name, f"{number}: " if len(own_changes) > 1 else "")
    everywhere = _find_transitions_from_any(machine)
    for number, (change, left_out) in enumerate(everywhere, 1):
        sketch.add_transition(sketch.add_any_box(left_out), change, "any", f"{number}: " if len(everywhere) > 1 else "")
    return Chart(title, tuple(sketch.boxes.values()), sketch.build_arrows())


def _is_from_any(change: Transition) -> bool:
    return f".{FROM_ANY_KEY}->" in change.key


def _find_transitions_from_any(machine: Machine) -> list[tuple[Transition, tuple[str, ...]]]:
    """Return each transition `from any` once, with the names of the states that its `except` lists."""
    changes: dict[str, Transition] = {}
    where: dict[str, set[int]] = {}
    for state in machine.states:
        for change in state.transitions:
            if _is_from_any(change):
                changes.setdefault(change.key, change)
                where.setdefault(change.key, set()).add(state.index)
    return [
        (change, tuple(s.name for s in machine.states if s.index not in where[key] and s.index != change.target))
        for key, change in sorted(changes.items(), key=lambda item: item[1].span.start)
    ]


class _ChartBuilder:
    """Collects the boxes and arrows of a chart while the chart is built."""

    def __init__(self, machine: Machine) -> None:
        self.boxes: dict[str, Box] = {}
        self._changes: dict[tuple[str, str, bool], list[tuple[str, str]]] = {}
        first = machine.states[machine.start]
        self.boxes["start"] = Box("start", "start", "start", "", _BLACK, f"starts in {first.name}")
        for state in machine.states:
            self.boxes[f"s{state.index}"] = _make_state_box(state)
        self._add_arrow("start", f"s{machine.start}", False, "", "")

    def add_any_box(self, excepted_states: tuple[str, ...]) -> str:
        """Add the box from which transitions `from any` start, and return its key. `excepted_states`: the states that do not
        have these transitions."""
        name = "any state" if not excepted_states else "any but " + ", ".join(excepted_states)
        return self._add_extra_box("any", name, name)

    def _add_extra_box(self, kind: str, unique_text: str, name: str, details: str = "") -> str:
        """Add a box that is not a state, unless it exists already. Return its key. `unique_text`: a text that distinguishes it
        from other boxes of its kind."""
        key = f"{kind} {unique_text}"
        self.boxes.setdefault(key, Box(key, kind, name, "", _GREY, details))  # type: ignore[arg-type]
        return key

    def add_transition(self, source: str, change: Transition, name: str, number: str) -> None:
        """Add a transition from the box `source`. `name`: the name of the source state. `number`: the transition's position in
        the order of evaluation, as text; may be ""."""
        words, details = number + _format_condition(change), _make_tooltip(change.span)
        if change.choices:
            target = self._add_extra_box("choice", change.key, "", details)
        elif change.targets_previous:
            target = self._add_extra_box("previous", name, "previous", "back to the previous state")
        else:
            target = f"s{change.target}"
        self._add_arrow(source, target, change.is_interrupt, words, details)
        for state, weight in change.choices:
            self._add_arrow(target, f"s{state}", False, _format_source_text(weight.span), details)

    def _add_arrow(self, source: str, target: str, interrupt: bool, words: str, details: str) -> None:
        """Add an arrow. All transitions between the same two boxes share one arrow, but interrupts have a separate arrow."""
        self._changes.setdefault((source, target, interrupt), []).append((words, details))

    def build_arrows(self) -> tuple[Arrow, ...]:
        """Return the arrows of all transitions that were added."""
        return tuple(
            Arrow(source, target, tuple(w for w, _ in labels if w), interrupt, "\n".join(dict.fromkeys(d for _, d in labels)))
            for (source, target, interrupt), labels in self._changes.items()
        )


def _make_state_box(state: State) -> Box:
    """Return the box of a state."""
    label = " ".join(state.label.split())
    lasts = f"for at least {_format_source_text(state.min_duration.span)}" if state.min_duration is not None else ""
    details = " · ".join(part for part in (label, lasts, _format_location(state.span)) if part)
    return Box(f"s{state.index}", "state", state.name, " · ".join(p for p in (label, lasts) if p), state.colour, details)


def _format_interrupt(change: Transition) -> str:
    if not change.is_interrupt:
        return ""
    return "interrupt when" if change.condition is not None else "interrupt"


def _format_condition(change: Transition) -> str:
    """Return the condition of a transition as in the source, with its required duration and its `take`."""
    parts = [
        _format_interrupt(change),
        _format_source_text(change.condition.span) if change.condition is not None else "",
        f"after {_format_source_text(change.delay.span)}" if change.delay is not None else "",
        f"held {_format_source_text(change.hold_time.span)}" if change.hold_time is not None else "",
        _format_source_text(change.take_action.span) if change.take_action is not None else "",
    ]
    return " ".join(part for part in parts if part)


def _format_source_text(span: Span) -> str:
    """Return the text of a span on one line, without comments."""
    return " ".join(re.sub(r"#[^\n]*", "", span.text).split())


def _format_location(span: Span) -> str:
    """Return the file name and line of a span. The folder is omitted, so that equal programs give equal pictures in any
    folder."""
    return f"{PurePath(span.source.path).name}:{span.source.find_line_column(span.start)[0]}"


def _make_tooltip(span: Span) -> str:
    return f"{_format_location(span)}: {_format_source_text(span)}"
