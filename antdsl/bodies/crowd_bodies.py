"""The bodies of a scene's crowd: agent definitions from files, checked against the clips, groups and marks that the species use.
Also the body data that a run needs: clip lengths, strides and marks, and the collision size of each body."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

from antdsl.bodies.agents.body_extents import standing_box, turn_box
from antdsl.bodies.agents.boxes import rest_box
from antdsl.bodies.agents.definition import Clip, Definition, language_names
from antdsl.bodies.agents.leg_chains import legs_data
from antdsl.bodies.agents.packed import digest
from antdsl.bodies.body_sizes import standing_proportions, warn_of_sizes
from antdsl.bodies.files.reading import load_definition
from antdsl.bodies.library import library_body
from antdsl.bodies.posed_body import COLLISION_LAYER, own_layer
from antdsl.diagnostics import Label, Report
from antdsl.diagnostics.suggestion import nearest_name
from antdsl.limits import MAX_WORN_LAYERS
from antdsl.plan.lowering.writer import BodyProportions
from antdsl.program.model import Channel, ClipTest, Look, Machine, Play, Program, Species, Wear
from antdsl.program.traverse import parts
from antdsl.scene.library_bodies import BODY_WORDS, body_for_species
from antdsl.scene.load import Scene
from antdsl.scene.setting import ClipData, LegsData, RoomData
from antdsl.source import Span

_MAX_LISTED_NAMES = 12  # names in a message


@dataclass(frozen=True, slots=True, eq=False)
class CrowdBodies:
    """Bodies by species.

    `definitions`: of species with a body file; species that name the same file share one object.
    `clips`: of all species.
    `rooms`: the collision sizes of the bodies in `definitions`.
    `legs`: of species with legs and gaits.
    `hashes`: content hash of each file, by its path in the scene.
    `proportions`: of species that set their height.
    """

    definitions: Mapping[str, Definition] = field(default_factory=dict)
    clips: Mapping[str, Mapping[str, ClipData]] = field(default_factory=dict)
    rooms: Mapping[str, RoomData] = field(default_factory=dict)
    legs: Mapping[str, LegsData] = field(default_factory=dict)
    hashes: Mapping[str, str] = field(default_factory=dict)
    proportions: Mapping[str, BodyProportions] = field(default_factory=dict)


class LegsBySpecies(Mapping[str, LegsData]):
    """The legs of all species with a body that has legs and gaits. Computed on first access, because most commands do not need
    them.

    `bodies`: by species, a definition or the name of a library body.
    """

    def __init__(self, bodies: Mapping[str, Definition | str]) -> None:
        self._bodies = bodies

    @cached_property
    def _legs(self) -> dict[str, LegsData]:
        """Return the legs of all bodies that have legs, by species."""
        definitions = {name: library_body(body) if isinstance(body, str) else body for name, body in self._bodies.items()}
        return {name: legs_data(body) for name, body in definitions.items() if body.legs and body.gaits}

    def __getitem__(self, species: str) -> LegsData:
        return self._legs[species]

    def __iter__(self) -> Iterator[str]:
        return iter(self._legs)

    def __len__(self) -> int:
        return len(self._legs)


def crowd_bodies(scene: Scene, program: Program) -> tuple[CrowdBodies, Report]:
    """Return the bodies of a scene's crowd, from files and from the library, and a report of mismatches. A finding is located
    where the scene names the body; a label marks where the program uses the missing part."""
    report = Report()
    files: dict[str, Definition | None] = {}
    named = _named_bodies(scene)
    chosen = {line.species for line in scene.model.crowd if line.body is not None}
    worn: dict[str, Definition] = {}
    words = _library_bodies(scene, program)
    library_species = {line.species for line in scene.model.crowd if line.wear}
    library_species |= {
        n for n, s in program.species.items() if any(True for m in s.machines for _ in (*_play_lines(m), *_display_lines(m)))
    }
    library = {name: library_body(text) for name, text in words.items() if name in library_species}
    for species, (text, place) in named.items():
        if text in BODY_WORDS:
            if species in library:
                _check_body(program.species[species], library[species], text, place, report, species not in chosen)
            continue
        if text not in files:
            files[text], findings = load_definition(text, scene.roots, place)
            report.extend(findings)
        definition = files[text]
        if definition is not None and species in program.species:
            _check_body(program.species[species], definition, text, place, report)
            worn[species] = definition
    _check_layers(scene, program, worn | library, report)
    definitions = {text: definition for text, definition in files.items() if definition is not None}
    bodies = CrowdBodies(
        worn,
        {
            species: {name: clip_data(clip, body) for name, clip in body.clips.items()}
            for species, body in (worn | library).items()
        },
        {species: body_room(body, program.species[species].edition > 1) for species, body in worn.items()},
        LegsBySpecies({**worn, **words}),
        {text: digest(body) for text, body in definitions.items()},
        standing_proportions(program, worn, words),
    )
    warn_of_sizes(scene, program, worn, words, report)
    return bodies, report


def _check_layers(scene: Scene, program: Program, worn: Mapping[str, Definition], report: Report) -> None:
    """Report layers that crowd lines wear and that their body does not have. Also report more layers than can be
    distinguished."""
    layers: dict[str, set[str]] = {}
    for number, line in enumerate(scene.model.crowd):
        if line.species not in program.species:
            continue
        appearances = (each for machine in program.species[line.species].machines for each in _display_lines(machine))
        named = layers.setdefault(line.species, {each.layer for each in appearances if isinstance(each, Wear)})
        dressed = tuple(dict.fromkeys(name for part in line.layers() for name in part if name))
        named |= set(dressed)
        body = worn.get(line.species)
        place = scene.span("crowd", number, "wear")
        for name in dressed:
            if body is not None and name not in body.layers:
                near, known = (
                    nearest_name(name, list(body.layers)),
                    ", ".join(f"`{each}`" for each in list(body.layers)[:_MAX_LISTED_NAMES]),
                )
                has = f"it has {known}" if known else "it has no layers"
                words = f"the body of `{line.species}` has no layer `{name}`"
                report.error("unknown-name", words, place, f"did you mean `{near}`? {has}" if near else has)
        if len(named) > MAX_WORN_LAYERS:
            words = f"agents of `{line.species}` may wear {len(named)} layers, and {MAX_WORN_LAYERS} at most can be distinguished"
            report.error("too-large", words, place, "combine shapes that are worn together in one layer")


def clip_data(clip: Clip, body: Definition) -> ClipData:
    """Return a clip's data for a run, in seconds, body lengths and cycles."""
    seconds = clip.duration
    marks = {name: mark_time / seconds if seconds > 0 else 0.0 for name, mark_time in clip.marks.items()}
    return ClipData(seconds, clip.stride / body.length, clip.loop, marks)


def body_room(body: Definition, stands: bool = False) -> RoomData:
    """Return the collision size of a body: length and width of the box of its layer `collision` in the rest pose, or, if it
    `stands`, in its idle clip. Without that layer, use the layer that is always displayed. The length is never less than the
    width."""
    layer = body.layers.get(COLLISION_LAYER) or own_layer(body)
    low, high = standing_box(body, layer) if stands else turn_box(body, rest_box(replace(body, layers={layer.name: layer})))
    width = max(float(high[2] - low[2]), 1e-3)
    middle = (low + high) / 2
    return RoomData(max(float(high[0] - low[0]), width), width, float(middle[1]), float(middle[0]))


def _library_bodies(scene: Scene, program: Program) -> dict[str, str]:
    """Return the library body of each species that has no body file."""
    named = _named_bodies(scene)
    words = {name: named[name][0] if name in named else body_for_species(name) for name in program.species}
    return {name: text for name, text in words.items() if text in BODY_WORDS}


def _named_bodies(scene: Scene) -> dict[str, tuple[str, Span]]:
    """Return the body of each species: from its first crowd line that names a body, else the library body that matches the
    species' name."""
    bodies: dict[str, tuple[str, Span]] = {}
    for number, line in enumerate(scene.model.crowd):
        if line.body is not None:
            bodies.setdefault(line.species, (line.body, scene.span("crowd", number, "body")))
    for number, line in enumerate(scene.model.crowd):
        bodies.setdefault(line.species, (body_for_species(line.species), scene.span("crowd", number, "species")))
    return bodies


def _check_body(species: Species, body: Definition, text: str, place: Span, report: Report, by_name: bool = False) -> None:
    """Report the clips, transform groups and marks that a species needs and its body lacks. `by_name`: no crowd line names a
    body, so the body was chosen by the species' name."""
    lacks: dict[str, tuple[str, Label]] = {}  # help text and place of each missing name

    def want(what: str, name: str, known: Iterable[str], label: Label) -> None:
        names = sorted(set(known))
        if not name or name in names:
            return
        near = nearest_name(name, names)
        listed = ", ".join(f"`{each}`" for each in names[:_MAX_LISTED_NAMES]) + (" …" if len(names) > _MAX_LISTED_NAMES else "")
        has = f"it has {listed}" if names else f"it has no {what}s"
        help = f"did you mean `{near}`? {has}" if near else has  # more than a word to put in place of the file's path
        lacks.setdefault(f"{what} `{name}`", (help, label))

    marks = [mark for clip in body.clips.values() for mark in clip.marks]
    channels = language_names(each.name for each in body.rig.channels).values()
    for machine in species.machines:
        for appearance in _display_lines(machine):
            if isinstance(appearance, Wear):
                want("layer", appearance.layer, body.layers, Label(appearance.span, "worn here"))
            elif isinstance(appearance, Channel):
                want("channel", appearance.channel, channels, Label(appearance.span, "set here"))
            else:
                want("transform group", appearance.group, body.groups, Label(appearance.span, "turned here"))
        for line in _play_lines(machine):
            for clip in (line.clip, *line.blend_clips):
                want("clip", clip, body.clips, Label(line.span, "played here"))
            want("transform group", line.on, body.groups, Label(line.span, "named here"))
    for test in parts(species):
        if isinstance(test, ClipTest):
            want("mark", test.mark, marks, Label(test.span, "requested here"))
    for what, help, label in _find_misplaced_marks(species, body):
        lacks.setdefault(what, (help, label))
    if lacks:
        helps = [help if len(lacks) == 1 else f"{name}: {help}" for name, (help, _) in lacks.items()]
        if by_name:
            helps.append(f"without a `body`, `{species.name}` has this one, by its name: add `body: …` for another")
        labels = tuple(label for _, label in lacks.values())
        words = f"`{text[-60:]}` has no {', no '.join(lacks)}"
        report.error("unknown-name", words, place, "; ".join(helps), labels=labels)


def _find_misplaced_marks(species: Species, body: Definition) -> Iterator[tuple[str, str, Label]]:
    """Yield misplaced marks: a state waits for the mark, the state's clip lacks it, but other clips of the body have it. Each
    comes with a message, a help text and its location."""
    having: dict[str, list[str]] = {}
    for clip in body.clips.values():
        for mark in clip.marks:
            having.setdefault(mark, []).append(clip.name)
    for machine in species.machines:
        for state in machine.states:
            playing = next((body.clips.get(line.clip) for line in state.body if isinstance(line, Play)), None)
            if playing is None:
                continue
            # a change `from any` may be meant for other states
            own = [each for each in state.transitions if each.key.startswith(f"{species.name}.{machine.name}.{state.name}->")]
            for test in (part for each in own for part in parts(each)):
                if not isinstance(test, ClipTest) or test.machine != machine.name or test.mark not in having:
                    continue
                if test.mark in playing.marks:
                    continue
                has = ", ".join(f"`{each}`" for each in sorted(playing.marks)) or "no marks"
                others = ", ".join(f"`{each}`" for each in sorted(having[test.mark])[:_MAX_LISTED_NAMES])
                yield (
                    f"mark `{test.mark}` in clip `{playing.name}`",
                    f"`{playing.name}` has {has}; `{test.mark}` is a mark of {others}",
                    Label(test.span, "requested here"),
                )


def _play_lines(machine: Machine) -> Iterator[Play]:
    """Yield the `play` statements of a machine's states."""
    for state in machine.states:
        yield from (line for line in state.body if isinstance(line, Play))


def _display_lines(machine: Machine) -> Iterator[Wear | Channel | Look]:
    """Yield the statements of a machine's states that display something in addition to clips: worn layers, channels and looks."""
    for state in machine.states:
        yield from (line for line in state.body if isinstance(line, (Wear, Channel, Look)))
