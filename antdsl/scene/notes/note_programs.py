"""The additions that notes make to a program: transitions to states, machines that play clips, and machines that turn parts of
bodies.

Each addition is triggered by an event that only notes raise, so agents without a note behave as before. Plans, clips, fades,
explanations and checks of bodies treat the additions like the program's own parts."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from antdsl.program.kinds import BOOL_TYPE, LENGTH_TYPE, TIME_TYPE, ChangeRate, Dimension, TypeKind, ValueType
from antdsl.program.model import (
    FROM_ANY_KEY,
    AttributeDecl,
    Look,
    Machine,
    OperationExpr,
    Play,
    Program,
    Species,
    State,
    Statement,
    Transition,
)
from antdsl.program.typed import AttributeRef, Constant, ThingRef
from antdsl.scene.load import Scene
from antdsl.scene.notes.notes_model import ChangeNote, Note
from antdsl.source import Span

PLAY_MACHINE_NAME, LOOK_MACHINE_PREFIX, OFF_STATE_NAME, ON_STATE_NAME = "notes_play", "notes_look_", "off", "on"
_LOOK_TARGET_PREFIX = "note#"
_LOOK_TARGET_TYPE = ValueType(TypeKind.VECTOR, Dimension(length=1))
_NOTE_STATE_COLOUR = (0.6, 0.6, 0.6)


def format_event_name(machine: str, state: str) -> str:
    """Return the name of the event that puts a machine into a state. It contains `#`, so it cannot be the name of anything in a
    program."""
    return f"note#{machine}.{state}"


def format_look_target_name(group: str) -> str:
    """Return the name of the vector attribute that stores the point at which a transform group looks."""
    return f"{_LOOK_TARGET_PREFIX}{group}"


def split_state_name(name: str, machine: str) -> str:
    """Return the name of a state in the machine `machine` from the text `STATE` or `MACHINE.STATE`."""
    return name.removeprefix(f"{machine}.")


def add_note_machines(program: Program, scene: Scene) -> Program:
    """Return the program with the additions that the notes of a scene need. Without notes, the same object is returned."""
    notes = [(note, scene.find_span("notes", number)) for number, note in enumerate(scene.model.notes)]
    if not notes:
        return program
    return replace(
        program, species={name: _add_note_machines_to_species(species, notes, scene) for name, species in program.species.items()}
    )


def remove_note_machines(program: Program) -> Program:
    """Return the program without the machines and attributes that notes added. Transitions that notes added remain."""
    return replace(
        program, species={name: _remove_note_machines_of_species(species) for name, species in program.species.items()}
    )


def _remove_note_machines_of_species(species: Species) -> Species:
    machines = tuple(each for each in species.machines if not each.name.startswith((PLAY_MACHINE_NAME, LOOK_MACHINE_PREFIX)))
    attributes = tuple(each for each in species.attributes if not each.name.startswith(_LOOK_TARGET_PREFIX))
    return replace(species, machines=machines, attributes=attributes)


def _add_note_machines_to_species(species: Species, notes: list[tuple[Note, Span]], scene: Scene) -> Species:
    frame_seconds = float(1 / scene.model.fps)
    machines = [_add_change_transitions(species, machine, notes) for machine in species.machines]
    clips = {note.played_clip: (note, span) for note, span in notes if note.played_clip}
    if clips:
        plays = [
            (clip, span, Play(clip, "", None, None, span), note.ease_frames * frame_seconds)
            for clip, (note, span) in clips.items()
        ]
        machines.append(_make_machine(species, PLAY_MACHINE_NAME, plays))
    groups = {group: (note, span) for note, span in notes for group in note.looks}
    targets = []
    for group, (note, span) in groups.items():
        name = format_look_target_name(group)
        zero = Constant(LENGTH_TYPE, ChangeRate.CONST, span, 0.0)
        origin = OperationExpr(_LOOK_TARGET_TYPE, ChangeRate.CONST, span, "vector", (zero, zero, zero))
        targets.append(AttributeDecl(name, _LOOK_TARGET_TYPE, origin, False, "", span))
        seconds = Constant(TIME_TYPE, ChangeRate.CONST, span, max(note.ease_frames * frame_seconds / 3, frame_seconds))
        look = Look(group, AttributeRef(_LOOK_TARGET_TYPE, ChangeRate.AGENT, span, None, name), None, seconds, span)
        machines.append(_make_machine(species, f"{LOOK_MACHINE_PREFIX}{group}", [(ON_STATE_NAME, span, look, 0.0)]))
    return replace(species, machines=tuple(machines), attributes=(*species.attributes, *targets))


def _add_change_transitions(species: Species, machine: Machine, notes: Iterable[tuple[Note, Span]]) -> Machine:
    """Return a machine with a transition from every state to each state that a `change` note names."""
    spans = {split_state_name(note.to, machine.name): span for note, span in notes if isinstance(note, ChangeNote)}
    targets = [state for state in machine.states if state.name in spans]
    if not targets:
        return machine
    added = tuple(_make_transition(species, machine.name, state, spans[state.name], 0.0) for state in targets)
    return replace(machine, states=tuple(replace(state, transitions=(*added, *state.transitions)) for state in machine.states))


def _make_machine(species: Species, name: str, displays: Sequence[tuple[str, Span, Statement, float]]) -> Machine:
    """Return a machine that runs statements for notes. Its first state displays nothing. One state for each entry of `displays`
    follows.

    An entry consists of the name of the state, a location, the statement that the state runs, and the fade time (s)."""
    first = displays[0][1]
    states = [_make_state(OFF_STATE_NAME, 0, (), first)]
    states += [_make_state(state, k, (line,), span) for k, (state, span, line, _) in enumerate(displays, 1)]
    fades = [max(seconds for *_, seconds in displays), *(seconds for *_, seconds in displays)]
    transitions = tuple(
        _make_transition(species, name, state, state.span, seconds) for state, seconds in zip(states, fades, strict=True)
    )
    return Machine(name, 0, tuple(replace(state, transitions=transitions) for state in states), first)


def _make_state(name: str, index: int, body: tuple[Statement, ...], span: Span) -> State:
    return State(name, index, "", _NOTE_STATE_COLOUR, None, (), (), (), body, span)


def _make_transition(species: Species, machine: str, state: State, span: Span, fade_seconds: float) -> Transition:
    event = ThingRef(BOOL_TYPE, ChangeRate.CONST, span, format_event_name(machine, state.name))
    fade = Constant(TIME_TYPE, ChangeRate.CONST, span, fade_seconds) if fade_seconds else None
    return Transition(
        f"{species.name}.{machine}.{FROM_ANY_KEY}->{state.name}#note", True,
        OperationExpr(BOOL_TYPE, ChangeRate.AGENT, span, "event", (event,)), None, None, None,
        state.index, False, (), (), span, fade,
    )  # fmt: skip
