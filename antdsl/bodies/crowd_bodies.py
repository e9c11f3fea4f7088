"""The bodies that a scene's crowd wears: agent definitions from files, held against what the species play, and what a run needs
of them: the clips' lengths, strides and marks, and the room that each body takes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from antdsl.bodies.agents.boxes import rest_box
from antdsl.bodies.agents.clip import Clip
from antdsl.bodies.agents.definition import Definition
from antdsl.bodies.agents.packed import digest
from antdsl.bodies.catalogue import body_of
from antdsl.bodies.kept_definitions import definition_at
from antdsl.bodies.library.table import BODIES, library_body
from antdsl.diagnostics import Label, Report
from antdsl.diagnostics.suggestion import nearest_name
from antdsl.plan.lowering.traversal import inside
from antdsl.program.model import ClipTest, Expr, Machine, Play, Program, Species
from antdsl.scene.load import Scene
from antdsl.scene.setting import ClipData, RoomData
from antdsl.source import Span

_SHOWN = 12  # names in a message


@dataclass(frozen=True, slots=True, eq=False)
class CrowdBodies:
    """By species: `definitions` (one for all that wear the same), `clips`, and the `rooms` of those whose body is a file.
    `hashes`: of the content of each file, by its path in the scene."""

    definitions: Mapping[str, Definition] = field(default_factory=dict)
    clips: Mapping[str, Mapping[str, ClipData]] = field(default_factory=dict)
    rooms: Mapping[str, RoomData] = field(default_factory=dict)
    hashes: Mapping[str, str] = field(default_factory=dict)


def crowd_bodies(scene: Scene, program: Program) -> tuple[CrowdBodies, Report]:
    """The bodies of a scene's crowd, from files and from the library, and what does not fit: at their places in the scene, with
    a label where the program asks for what is missing."""
    report = Report()
    found: dict[str, Definition | None] = {}
    worn: dict[str, Definition] = {}
    named = _named(scene)
    for species, (text, place) in named.items():
        if text not in found:
            found[text], findings = (library_body(text), Report()) if text in BODIES else definition_at(text, scene.roots, place)
            report.extend(findings)
        body = found[text]
        if body is not None and species in program.species:
            _check(program.species[species], body, text, place, report)
            worn[species] = body
    made = CrowdBodies(
        worn,
        {species: {name: clip_data(clip, body) for name, clip in body.clips.items()} for species, body in worn.items()},
        {species: room_of(body) for species, body in worn.items() if named[species][0] not in BODIES},
        {text: digest(body) for text, body in found.items() if body is not None and text not in BODIES},
    )
    return made, report


def clip_data(clip: Clip, body: Definition) -> ClipData:
    """What a run needs to know of a clip: seconds, body lengths and turns."""
    seconds = clip.duration
    marks = {name: moment / seconds if seconds > 0 else 0.0 for name, moment in clip.marks.items()}
    return ClipData(seconds, clip.stride / body.length, clip.loop, marks)


def room_of(body: Definition) -> RoomData:
    """The room that a body takes: as long and wide as its box in the rest pose, and never shorter than wide."""
    least, most = rest_box(body)
    corners = np.array([[(least, most)[k >> axis & 1][axis] for axis in range(3)] for k in range(8)])
    turned = corners @ body.base()[:3, :3].T
    low, high = turned.min(axis=0), turned.max(axis=0)
    width = max(float(high[2] - low[2]), 1e-3)
    middle = (low + high) / 2
    return RoomData(max(float(high[0] - low[0]), width), width, float(middle[1]), float(middle[0]))


def _named(scene: Scene) -> dict[str, tuple[str, Span]]:
    """The body that each species' first line with one names, else the one of the library that suits its name."""
    found: dict[str, tuple[str, Span]] = {}
    for number, line in enumerate(scene.model.crowd):
        if line.body is not None:
            found.setdefault(line.species, (line.body, scene.span("crowd", number, "body")))
    for number, line in enumerate(scene.model.crowd):
        found.setdefault(line.species, (body_of(line.species), scene.span("crowd", number, "species")))
    return found


def _check(species: Species, body: Definition, text: str, place: Span, report: Report) -> None:
    """Complains of the clips, transform groups and marks that a species wants and its body does not have."""
    lacks: dict[str, tuple[str, Label]] = {}  # what to do about each, and where it is wanted

    def want(what: str, name: str, known: Iterable[str], label: Label) -> None:
        names = sorted(set(known))
        if not name or name in names:
            return
        near = nearest_name(name, names)
        listed = ", ".join(f"`{each}`" for each in names[:_SHOWN]) + (" …" if len(names) > _SHOWN else "")
        has = f"it has {listed}" if names else f"it has no {what}s"
        help = f"did you mean `{near}`? {has}" if near else has  # more than a word to put in place of the file's path
        lacks.setdefault(f"{what} `{name}`", (help, label))

    marks = [mark for clip in body.clips.values() for mark in clip.marks]
    for machine in species.machines:
        for line in _plays(machine):
            want("clip", line.clip, body.clips, Label(line.span, "played here"))
            want("transform group", line.on, body.groups, Label(line.span, "named here"))
        for test in _tests(machine):
            want("mark", test.mark, marks, Label(test.span, "asked for here"))
    if lacks:
        helps = [help if len(lacks) == 1 else f"{name}: {help}" for name, (help, _) in lacks.items()]
        labels = tuple(label for _, label in lacks.values())
        words = f"`{text[-60:]}` has no {', no '.join(lacks)}"
        report.error("unknown-name", words, place, "; ".join(helps), labels=labels)


def _plays(machine: Machine) -> Iterator[Play]:
    for state in machine.states:
        yield from (line for line in state.body if isinstance(line, Play))


def _tests(machine: Machine) -> Iterator[ClipTest]:
    """Questions about clips in the changes of a machine."""
    for state in machine.states:
        for change in state.transitions:
            asked: tuple[Expr | None, ...] = (change.condition, change.held, change.after)
            for expr in asked:
                yield from (each for each in inside(expr) if isinstance(each, ClipTest)) if expr is not None else ()
