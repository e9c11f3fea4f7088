"""Checks of notes against the scene and its programs: agents, targets, curves, maps, attributes and states must exist."""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite

from antdsl.diagnostics import Report
from antdsl.program.model import Program, TypeKind
from antdsl.scene.checks.entry_checks import check_attribute_value, report_unknown_name
from antdsl.scene.crowds.casting_model import FacingDirection
from antdsl.scene.crowds.initial_values import is_settable
from antdsl.scene.document import PathKey
from antdsl.scene.load import Scene
from antdsl.scene.notes.note_programs import LOOK_MACHINE_PREFIX, PLAY_MACHINE_NAME
from antdsl.scene.notes.note_regions import Band, NoteBall, NoteRegion
from antdsl.scene.notes.notes_model import (
    AttractNote,
    ChangeNote,
    Note,
    PartNote,
    PassingNote,
    ReachNote,
    RegionNote,
    ReleaseNote,
    RepelNote,
    SetNote,
    Target,
)
from antdsl.scene.notes.selectors import (
    AgentConditions,
    AgentName,
    AnySelector,
    SelectorKeys,
    SelectorNames,
    SelectorProblem,
    View,
    find_camera_problems,
    find_name_problems,
    find_selector_problems,
)
from antdsl.scene.quantities import Quantity
from antdsl.scene.scene_kinds import SCENE_KINDS

MESH_GROUPS = ("obstacles", "surfaces")  # the mappings of a setting with meshes
_CURVE_HELP = "declare it in the program, `world { curve NAME }`, or write its points: `[[0, 0, 0], [50, 0, 0]]`"


def check_notes(scene: Scene, program: Program, report: Report, names: SelectorNames) -> None:
    """Report everything in the notes of a scene that does not match the scene and its programs."""
    for number in range(len(scene.model.notes)):
        check_note(scene, program, report, names, number)
    reserved = [
        m for s in program.species.values() for m in s.machines if m.name.startswith((PLAY_MACHINE_NAME, LOOK_MACHINE_PREFIX))
    ]
    for machine in reserved if scene.model.notes else ():
        words = f"notes of a scene use the name `{machine.name}` for a machine of their own"
        report.error("reserved-name", words, machine.span, "rename the machine")


def check_note(scene: Scene, program: Program, report: Report, names: SelectorNames, number: int) -> None:
    """Report everything in one note of a scene that does not match the scene and its programs."""
    _NoteCheck(scene, program, report, names, scene.model.notes[number], ("notes", number)).check_all()


class _NoteCheck:
    """The check of one note. `path`: the keys that lead to the note in the scene."""

    def __init__(
        self, scene: Scene, program: Program, report: Report, names: SelectorNames, note: Note, path: tuple[PathKey, ...]
    ) -> None:
        self.scene, self.program, self.report, self.names, self.note, self.path = scene, program, report, names, note, path

    def check_all(self) -> None:
        """Check all names and values of the note."""
        note = self.note
        problems = [*find_selector_problems(note.agents, self.names, *self.path, note.verb)]
        if isinstance(note, SelectorKeys):
            problems += find_selector_problems(note, self.names, *self.path)
        for path, target in self._iterate_targets():
            if isinstance(target, FacingDirection) and not any(target.direction):
                help = "write one that is not zero, such as `{direction: [0, 1, 0]}`"
                self.report.error(
                    "wrong-value", "a direction of zeros leads nowhere", self.scene.find_span(*self.path, *path), help
                )
            if isinstance(target, AgentName):
                problems += self._find_target_problems(target, (*self.path, *path))
        problems += self._find_region_problems()
        if isinstance(note, PartNote):
            problems += self._find_thing_problems(note.thing, "for")
        for problem in problems:
            self.report.error("unknown-thing", problem.message, self.scene.find_span(*problem.path), problem.help)
        self._check_things()
        self._check_frames()
        if isinstance(note, SetNote):
            self._check_values(note)
        if isinstance(note, ChangeNote) and note.to not in self.names.states:
            self._report_unknown("no species has a state", self.names.states, "to")

    def _find_target_problems(self, target: AgentName, path: tuple[PathKey, ...]) -> Iterator[SelectorProblem]:
        others, what = self.names.items | self.names.cameras, "no crowd line, species, item or camera is named"
        if not isinstance(self.note, ReachNote) or "stagger" in path:
            others, what = others | self._list_things(*MESH_GROUPS), "no crowd line, species, item, camera or mesh is named"
        return find_name_problems(target, self.names, path, others, what)

    def _find_region_problems(self) -> Iterator[SelectorProblem]:
        for key, region in self._iterate_regions():
            around = region.around if isinstance(region, NoteBall) else None
            line = region.along if isinstance(region, Band) and isinstance(region.along, tuple) else ()
            for number, target in enumerate(line):
                if isinstance(target, AgentName):
                    yield from self._find_target_problems(target, (*self.path, key, "along", number))
            if isinstance(region, View):
                yield from find_camera_problems(region.in_view, self.names, (*self.path, key, "in_view"))
            if around is not None and not (isinstance(around, tuple) and isinstance(around[0], Quantity)):
                yield from self._find_thing_problems(around, key, "around")

    def _iterate_regions(self) -> Iterator[tuple[str, NoteRegion]]:
        """Yield the regions of the note, each with its key in the note."""
        note = self.note
        if isinstance(note, RegionNote) and note.region is not None:
            yield "in", note.region
        if isinstance(note, PassingNote) and note.inside is not None:
            yield "inside", note.inside

    def _find_thing_problems(self, thing: AnySelector, *path: PathKey) -> Iterator[SelectorProblem]:
        """Yield a problem for each name in `thing` that does not exist. The names are of things of the world or of agents."""
        things = self._list_things(*MESH_GROUPS) | self.names.items | self.names.cameras
        words = "no mesh, item, camera, crowd line or species is named"
        return find_selector_problems(thing, self.names, *self.path, *path, others=things, what=words)

    def _iterate_targets(self) -> Iterator[tuple[tuple[PathKey, ...], Target]]:
        note = self.note
        if isinstance(note, ReachNote | AttractNote | RepelNote) and note.target is not None:
            yield (type(note).model_fields["target"].alias or "target",), note.target
        if note.delay_rule is not None and note.delay_rule.origin is not None:
            yield ("stagger", "from"), note.delay_rule.origin
        for group, target in note.looks.items():
            yield ("at" if note.verb == "look" else "look_at", group), target

    def _check_things(self) -> None:
        """Report curves, maps and regions that do not exist. Also report the thing of a `part` note if it does not exist."""
        note, curves = self.note, self._list_things("curves")
        bands = [((key, "along"), getattr(region, "along", None)) for key, region in self._iterate_regions()]
        for path, along in ((("along",), getattr(note, "along", None)), *bands):
            if isinstance(along, str) and along not in curves:
                self._report_unknown("no program has a curve", curves, *path, help=_CURVE_HELP)
        maps = self._list_things("maps")
        if isinstance(note, RegionNote) and note.painted is not None and note.painted not in maps:
            self._report_unknown("no program has a map", maps, "painted")

    def _check_frames(self) -> None:
        """Warn if the note has no effect because its frames are outside those of the scene."""
        note, model = self.note, self.scene.model
        first, last = model.frames.first - model.preroll, model.frames.last
        begins = note.last_frame if isinstance(note, ReachNote | ReleaseNote) else note.first_frame
        key = "frame" if "frame" in type(note).model_fields else "frames"
        if isfinite(begins) and begins > last:
            message, help = (
                f"the scene ends at frame {last}, before this note",
                "write an earlier frame, or more `frames` of the scene",
            )
        elif isinstance(note, ChangeNote) and note.frame <= first:
            message = f"the scene begins at frame {first}, and agents begin in a state without a change"
            help = f"write `each: {{state: {note.to}}}` in their crowd line, or a later frame"
        elif isfinite(note.last_frame) and note.last_frame + note.ease_frames < first:
            message, help = f"the scene begins at frame {first}, after this note", "write a later frame"
        else:
            return
        self.report.warning("out-of-range", message, self.scene.find_span(*self.path, key), help)

    def _list_things(self, *groups: str) -> frozenset[str]:
        """Return the names of the world's things in the groups `groups`."""
        things = self.program.world.items()
        return frozenset(name for name, t in things if t.kind in SCENE_KINDS and SCENE_KINDS[t.kind].group in groups)

    def _report_unknown(self, words: str, names: frozenset[str], *path: PathKey, help: str = "") -> None:
        if help and not names:
            name = self.scene.find_span(*self.path, *path).text
            self.report.error("unknown-thing", f"{words} `{name}`", self.scene.find_span(*self.path, *path), help)
        else:
            report_unknown_name(self.report, self.scene, (*self.path, *path), words, names, key=False)

    # --- attributes ---------------------------------------------------------------------------------------------------

    def _check_values(self, note: SetNote) -> None:
        species = sorted(_find_species(note.agents, self.scene) & self.program.species.keys()) or sorted(self.program.species)
        for name, value in note.to.items():
            path = (*self.path, "to", name)
            fitting = [a for s in species for a in self.program.species[s].attributes if a.name == name and is_settable(a)]
            if not fitting:
                known = {a.name for s in species for a in self.program.species[s].attributes if is_settable(a)}
                report_unknown_name(self.report, self.scene, path, f"`{'`, `'.join(species)}` has no attribute", known)
            elif isinstance(value, bool) != (fitting[0].type.kind is TypeKind.BOOL):
                is_bool, span = fitting[0].type.kind is TypeKind.BOOL, self.scene.find_span(*path)
                words = f"`{name}` is {'' if is_bool else 'not '}true or false, so it cannot be `{span.text}`"
                self.report.error("wrong-value", words, span, "write `true` or `false`" if is_bool else "write a number")
            elif not isinstance(value, bool):
                check_attribute_value(self.scene, self.report, value, fitting[0], *path)


def _find_species(selector: AnySelector | None, scene: Scene) -> set[str]:
    """Return the names of the species of which a selector may select agents. The selector names them directly, or by a crowd
    line.

    The set is empty if agents of all species may be selected."""
    if isinstance(selector, AgentName):
        lines = {line.name: line.species for line in scene.model.crowd}
        return {lines.get(selector.name, selector.name)}
    if isinstance(selector, AgentConditions):
        return _find_species(selector.of, scene)
    return set().union(*(_find_species(each, scene) for each in selector or ()))
