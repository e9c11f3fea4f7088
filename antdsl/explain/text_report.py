"""Explanations as text for people, in blocks. The decisions come first."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from itertools import pairwise
from pathlib import PurePath

from antdsl.explain.model import (
    Explanation,
    ExpressionPart,
    FloatTriple,
    LayerReport,
    MachineStep,
    ObservedSet,
    SourceLocation,
    StateInterval,
    TransitionReport,
)

_BAR_CHARACTERS = 20  # width of the complete budget
_MAX_INTERVALS = 12  # maximum number of intervals; for a long life, those around the requested frame
_MAX_DRAWS = 40


def format_explanation(explanation: Explanation) -> str:
    """Return the complete explanation as lines of text."""
    return "\n".join(_format_report_lines(explanation)) + "\n"


def _format_report_lines(explanation: Explanation) -> Iterator[str]:
    yield f"{explanation.species} {explanation.agent}, the step to frame {explanation.frame} of {explanation.scene}"
    yield from (f"note: {note}" for note in explanation.notes)
    if explanation.strip:
        yield ""
        yield "its states"
        for name in dict.fromkeys(each.machine for each in explanation.strip):
            machine_intervals = tuple(each for each in explanation.strip if each.machine == name)
            yield from _format_timeline_lines(
                machine_intervals, explanation.frame, f"{name}: " if len(machine_intervals) < len(explanation.strip) else ""
            )
    for machine in explanation.machines:
        yield ""
        yield from _format_machine_lines(machine)
    if explanation.handlers:
        yield ""
        yield "received events"
        yield from (f"  {each.text}  ({_format_place(each)})" for each in explanation.handlers)
    yield ""
    yield from _format_push_lines(explanation)
    yield from _format_surroundings_lines(explanation)
    yield from _format_effect_lines(explanation)


def _format_place(place: SourceLocation) -> str:
    """Return the file name and line number of a location as text. The folder is left out, because the file name is enough to
    find the file."""
    return f"{PurePath(place.file).name}:{place.line}"


def _format_timeline_lines(timeline: tuple[StateInterval, ...], frame: int, name: str) -> Iterator[str]:
    """Yield lines that list the states over time. The state in `frame` is in brackets."""
    current = next((k for k, s in enumerate(timeline) if s.first <= frame <= s.last), len(timeline) - 1)
    first = max(0, min(current - _MAX_INTERVALS // 2, len(timeline) - _MAX_INTERVALS))
    part = timeline[first : first + _MAX_INTERVALS]
    words = []
    for k, stretch in enumerate(part, first):
        state = stretch.state or "alive"
        frames = f"{stretch.first}..{stretch.last}" if stretch.first != stretch.last else f"{stretch.first}"
        words.append(f"[{state} {frames}]" if k == current else f"{state} {frames}")
    prefix, suffix = "… > " if first else "", " > …" if first + _MAX_INTERVALS < len(timeline) else ""
    yield f"  {name}{prefix}{' > '.join(words)}{suffix}"
    gaps = [f"{a.last + 1}..{b.first - 1}" for a, b in pairwise(part) if b.first > a.last + 1]
    if gaps:
        yield f"  not in the cache: {', '.join(gaps)}"


# --- deciding --------------------------------------------------------------------------------------------------------


def _format_machine_lines(machine_step: MachineStep) -> Iterator[str]:
    head = "" if machine_step.machine == "main" else f"{machine_step.machine}: "
    if machine_step.before != machine_step.after or machine_step.changed:
        yield f"{head}{machine_step.before} -> {machine_step.after}, after {machine_step.since:.4g} s"
    else:
        yield f"{head}stays in {machine_step.after}, since {machine_step.since:.4g} s"
    if not machine_step.looked:
        yield "  no transition leaves it"
    hidden = False
    for transition in machine_step.looked:
        yield from _format_transition_lines(transition, hidden)
        hidden = hidden or transition.wins
    if machine_step.claim is not None:
        verdict = "won" if machine_step.claim.won else "lost: other agents came first, or too little was left"
        much = "all" if machine_step.claim.amount is None else f"{machine_step.claim.amount:.4g}"
        claim_text = " ".join(word for word in (much, machine_step.claim.attribute, "of", machine_step.claim.item) if word)
        yield f"  requested {claim_text} (turn {machine_step.claim.draw:.4f}): {verdict}"
    if machine_step.choice is not None:
        bars = ", ".join(f"{name} up to {bar:.4g}" for name, bar in machine_step.choice.bars)
        yield f"  drew {machine_step.choice.draw:.4f} among {bars}: {machine_step.choice.chosen}"


def _format_transition_lines(transition: TransitionReport, hide_condition: bool) -> Iterator[str]:
    word = "wins" if transition.wins else ("holds too" if hide_condition else "holds") if transition.fires else "no"
    yield f"  {word:<9} {transition.place.text}  ({_format_place(transition.place)})"
    if transition.condition is not None:
        condition = transition.condition
        for part in (
            condition.parts if condition.role == "joined" and not transition.timers else (condition,)
        ):  # whether the condition holds is already displayed
            yield from _format_condition_lines(part, "            ")
    for timer in transition.timers:
        sign = "has passed" if timer.holds else "has not passed"
        yield f"            {timer.what}: {timer.has:.4g} of {timer.needs:.4g} {timer.unit}, {sign}"
    if transition.take is not None:
        yield f"            from: {transition.take.shown}"


def _format_condition_lines(part: ExpressionPart, indent: str) -> Iterator[str]:
    """Yield the lines of a condition and its parts. If a part tests whether a thing exists, the thing itself is displayed."""
    if len(part.parts) == 1 and part.parts[0].text == part.text:
        part = part.parts[0]
    if part.role in ("draw", "bar"):
        yield f"{indent}{part.role}: {part.shown}"
    elif isinstance(part.value, bool):
        yield f"{indent}{part.text}: {part.shown}"
    else:
        yield f"{indent}{part.text} = {part.shown}"
    for inner in part.parts:
        yield from _format_condition_lines(inner, indent + "  ")


# --- pushing ---------------------------------------------------------------------------------------------------------


def _format_push_lines(explanation: Explanation) -> Iterator[str]:
    yield {
        "budget": "layers, from top to bottom until the strength is used",
        "sum": "layers, added",
        "first": "layers, the first with a push wins",
    }[explanation.mode]
    for layer in explanation.layers:
        yield f"  {_format_strength_bar(layer)} {layer.place.text}  ({_format_place(layer.place)})"
        yield f"  {'':<{_BAR_CHARACTERS + 2}} {_format_layer_line(layer)}"
        if layer.condition is not None:
            yield from _format_condition_lines(layer.condition, " " * (_BAR_CHARACTERS + 7))
    for steer in explanation.steers:
        push = f"{_format_vector(steer.push)}, length {steer.length:.4g}"
        yield f"  {'':<{_BAR_CHARACTERS + 2}} {steer.part}: {steer.text} = {push}"
    yield f"  together  {_format_vector(explanation.push)}, length {_compute_length(explanation.push):.4g}"
    old_velocity, new_velocity = explanation.velocity
    if new_velocity is not None and explanation.acceleration is not None:
        yield (
            f"  velocity  {_format_vector(old_velocity)} -> {_format_vector(new_velocity)} mm/s, "
            f"speed {_compute_length(old_velocity):.4g} -> {_compute_length(new_velocity):.4g} mm/s"
        )
        yield f"  so        {_format_vector(explanation.acceleration)} mm/s^2 in this step"


def _format_strength_bar(layer: LayerReport) -> str:
    """Return a text bar that shows how much of the strength a layer used. This part comes after the part that earlier layers
    used."""
    granted = round(min(layer.share, 1.0) * _BAR_CHARACTERS)
    if layer.share > 0:
        granted = max(granted, 1)
    spent = min(round((1 - min(layer.left, 1.0)) * _BAR_CHARACTERS), _BAR_CHARACTERS - granted)
    return f"[{'.' * spent}{'#' * granted}{' ' * (_BAR_CHARACTERS - spent - granted)}]"


def _format_layer_line(layer: LayerReport) -> str:
    match layer.state:
        case "no strength":
            return "not evaluated: no strength is left"
        case "off":
            return "off: its condition does not hold"
        case "nothing":
            return "no push"
    words = f"push {_format_vector(layer.push or layer.given)}, length {layer.length:.4g}"
    if layer.cut > 0:
        return f"{words}; got {layer.share:.4g}, cut by {layer.cut:.4g}"
    return f"{words}; got all of it"


def _format_vector(vector: FloatTriple) -> str:
    return f"({', '.join(f'{x + 0.0:.4g}' for x in vector)})"


def _compute_length(vector: FloatTriple) -> float:
    return math.sqrt(sum(x * x for x in vector))


# --- around ----------------------------------------------------------------------------------------------------------


def _format_surroundings_lines(explanation: Explanation) -> Iterator[str]:
    if explanation.seen:
        yield ""
        yield "looked at"
        for group in explanation.seen:
            yield from _format_observed_lines(group)
    if explanation.fields:
        yield ""
        yield "fields at its position"
        yield from (f"  {name} = {value:.4g}" for name, value in explanation.fields)
    if explanation.senses:
        yield ""
        yield "felt"
        lines = Counter(f"{sense.kind} {sense.name}: {sense.shown}  ({sense.text})" for sense in explanation.senses)
        yield from (f"  {line}" + (f", {count} times" if count > 1 else "") for line, count in lines.items())
    if explanation.draws:
        yield ""
        yield "drew"
        yield from (f"  {draw.value:.6f}  {draw.site}" for draw in explanation.draws[:_MAX_DRAWS])
        if len(explanation.draws) > _MAX_DRAWS:
            yield f"  and {len(explanation.draws) - _MAX_DRAWS} more"


def _format_observed_lines(group: ObservedSet) -> Iterator[str]:
    yield f"  {group.count} {group.of}: {group.asked}"
    for near in group.nearest:
        detail = f", {near.about}" if near.about else ""
        yield f"    {near.name} at {near.distance:.4g} mm{detail}"
    if group.count > len(group.nearest):
        yield f"    and {group.count - len(group.nearest)} more"


def _format_effect_lines(explanation: Explanation) -> Iterator[str]:
    if explanation.did:
        yield ""
        yield "did"
        yield from (f"  {each}" for each in explanation.did)
    if explanation.changes:
        yield ""
        yield "changed"
        yield from (f"  {each.name}: {each.shown[0]} -> {each.shown[1]}" for each in explanation.changes if not each.memory)
        memories = [each for each in explanation.changes if each.memory]
        yield from (f"  {each.name}: {each.shown[0]} -> {each.shown[1]} (memory)" for each in memories)
