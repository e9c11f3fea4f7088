"""The bodies of a scene's crowd: agent definitions from files, checked against the clips, groups and marks that the species use.

Also computes the body data that a run needs: clip durations, strides and marks, and the collision size of each body."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar

from antdsl.bodies.agents.body_extents import compute_standing_box, rotate_box_to_agent_space
from antdsl.bodies.agents.boxes import compute_rest_box
from antdsl.bodies.agents.definition import Clip, Definition, map_language_names
from antdsl.bodies.agents.leg_chains import build_legs_data
from antdsl.bodies.agents.packed import hash_definition
from antdsl.bodies.body_sizes import measure_standing_proportions, report_odd_sizes
from antdsl.bodies.files.reading import load_definition
from antdsl.bodies.library import load_library_body
from antdsl.bodies.posed_body import COLLISION_LAYER_NAME, find_base_layer
from antdsl.diagnostics import Label, Report
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.limits import MAX_WORN_LAYERS
from antdsl.plan.lowering.writer import BodyProportions
from antdsl.program.model import Channel, ClipTest, Look, Machine, Play, Program, Species, Wear
from antdsl.program.traverse import iterate_parts
from antdsl.scene.checks.existence_checks import find_body_span
from antdsl.scene.crowds.body_choice import find_number_of_key, find_species_of_key, make_body_key
from antdsl.scene.library_bodies import BODY_WORDS, CAPSULE_BY_BODY, find_body_for_species
from antdsl.scene.load import Scene
from antdsl.scene.setting import BodyCapsuleData, ClipData, LegsData
from antdsl.source import Span

BodyType = TypeVar("BodyType", Definition, str)
_MAX_LISTED_NAMES = 12  # maximum number of names in a message


@dataclass(frozen=True, slots=True)
class NamedBody:
    """A body of a species. The scene names it, or it is chosen by the name of the species.

    `key`: the key of the body, built by `scene.body_choice`.
    `written_name`: the name of a library body, or a path, as in the scene.
    `place`: the location in the scene that names the body.
    `weight`: how often agents of the species get this body, relative to its other bodies."""

    key: str
    species: str
    written_name: str
    place: Span
    weight: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class CrowdBodies:
    """The bodies of a crowd, by their keys (`scene.body_choice`). If a species has only one body, its key is the species' name.

    `definitions`: the definitions of bodies from files; bodies from the same file share one object.
    `clips`: the data of the clips of each species.
    `collision_sizes`: the collision sizes of the bodies in `definitions`, and of all bodies of species with several bodies.
    `legs`: for bodies with legs and gaits, their leg data.
    `hashes`: the content hash of each file, by its path in the scene.
    `proportions`: the proportions of the bodies of species that set their height.
    `weights`: for each species with several bodies, the weight of each body."""

    definitions: Mapping[str, Definition] = field(default_factory=dict)
    clips: Mapping[str, Mapping[str, ClipData]] = field(default_factory=dict)
    collision_sizes: Mapping[str, BodyCapsuleData] = field(default_factory=dict)
    legs: Mapping[str, LegsData] = field(default_factory=dict)
    hashes: Mapping[str, str] = field(default_factory=dict)
    proportions: Mapping[str, BodyProportions] = field(default_factory=dict)
    weights: Mapping[str, tuple[float, ...]] = field(default_factory=dict)


class LegsByBody(Mapping[str, LegsData]):
    """The leg data of all bodies that have legs and gaits, by key. The data is computed on first access, because most commands
    do not need it.

    `bodies`: by key, a definition or the name of a library body."""

    def __init__(self, bodies: Mapping[str, Definition | str]) -> None:
        self._bodies = bodies

    @cached_property
    def _legs_by_body(self) -> dict[str, LegsData]:
        """Return the leg data of all bodies that have legs and gaits, by key."""
        definitions = {name: load_library_body(body) if isinstance(body, str) else body for name, body in self._bodies.items()}
        return {name: build_legs_data(body) for name, body in definitions.items() if body.legs and body.gaits}

    def __getitem__(self, key: str) -> LegsData:
        return self._legs_by_body[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._legs_by_body)

    def __len__(self) -> int:
        return len(self._legs_by_body)


def load_crowd_bodies(scene: Scene, program: Program) -> tuple[CrowdBodies, Report]:
    """Return the bodies of a scene's crowd, from files and from the library, and a report of mismatches.

    A finding is located at the body's name in the scene. Its label marks the place in the program that uses the missing part."""
    report = Report()
    files: dict[str, Definition | None] = {}
    named = list_named_bodies(scene, tuple(program.species))
    chosen = {line.species for line in scene.model.crowd if line.body is not None}
    words = {each.key: each.written_name for each in named if each.written_name in BODY_WORDS and each.species in program.species}
    shown_species = {line.species for line in scene.model.crowd if line.wear} | {
        n
        for n, s in program.species.items()
        if any(True for m in s.machines for _ in (*_iterate_play_lines(m), *_iterate_display_lines(m)))
    }
    library = {
        each.key: load_library_body(each.written_name) for each in named if each.key in words and each.species in shown_species
    }
    worn: dict[str, Definition] = {}
    in_crowd = {line.species for line in scene.model.crowd}
    for each in named:
        if each.written_name in BODY_WORDS:
            if each.key in library and each.species in in_crowd:
                species = program.species[each.species]
                _check_body(species, library[each.key], each.written_name, each.place, report, each.species not in chosen)
            continue
        if each.written_name not in files:
            files[each.written_name], findings = load_definition(each.written_name, scene.roots, each.place)
            report.extend(findings)
        definition = files[each.written_name]
        if definition is not None and each.species in program.species:
            _check_body(program.species[each.species], definition, each.written_name, each.place, report)
            worn[each.key] = definition
    _check_layers(scene, program, named, worn | library, report)
    weights: dict[str, tuple[float, ...]] = {}
    for each in named:
        weights[each.species] = (*weights.get(each.species, ()), each.weight)
    weights = {species: parts for species, parts in weights.items() if len(parts) > 1}
    mixed = {each.key: each.written_name for each in named if each.species in weights and each.written_name in BODY_WORDS}
    definitions = {text: definition for text, definition in files.items() if definition is not None}
    bodies = CrowdBodies(
        worn,
        {key: {name: build_clip_data(clip, body) for name, clip in body.clips.items()} for key, body in (worn | library).items()},
        {key: compute_collision_size(body, program.species[find_species_of_key(key)].edition > 1) for key, body in worn.items()}
        | {key: _get_library_collision_size(text) for key, text in mixed.items()},
        LegsByBody({**worn, **words}),
        {text: hash_definition(body) for text, body in definitions.items()},
        measure_standing_proportions(program, _select_first_bodies(worn), _select_first_bodies(words)),
        weights,
    )
    report_odd_sizes(scene, program, _select_first_bodies(worn), _select_first_bodies(words), report)
    return bodies, report


def _select_first_bodies(bodies: Mapping[str, BodyType]) -> dict[str, BodyType]:
    """Return the first body of each species, by species. `bodies`: bodies by key."""
    return {find_species_of_key(key): body for key, body in bodies.items() if find_number_of_key(key) == 0}


def _check_layers(
    scene: Scene, program: Program, bodies: Iterable[NamedBody], definitions: Mapping[str, Definition], report: Report
) -> None:
    """Report worn layers that a body does not have, and species that wear more layers than are possible."""
    layers: dict[str, set[str]] = {}
    keys_by_species: dict[str, list[str]] = {}
    for each in bodies:
        keys_by_species.setdefault(each.species, []).append(each.key)
    for number, line in enumerate(scene.model.crowd):
        if line.species not in program.species:
            continue
        appearances = (each for machine in program.species[line.species].machines for each in _iterate_display_lines(machine))
        named = layers.setdefault(line.species, {each.layer for each in appearances if isinstance(each, Wear)})
        dressed = tuple(dict.fromkeys(name for part in line.list_worn_layers() for name in part if name))
        named |= set(dressed)
        place = scene.find_span("crowd", number, "wear")
        for key in keys_by_species[line.species]:
            if key in definitions:
                _check_worn_layers(line.species, definitions[key], dressed, len(keys_by_species[line.species]) > 1, place, report)
        if len(named) > MAX_WORN_LAYERS:
            words = (
                f"the agents of this line use {len(named)} layers of `{line.species}`, but at most {MAX_WORN_LAYERS} are possible"
            )
            report.error("too-large", words, place, "combine shapes that agents always wear together into one layer")


def _check_worn_layers(
    species: str, body: Definition, worn_layers: Iterable[str], has_other_bodies: bool, place: Span, report: Report
) -> None:
    """Report worn layers of a crowd line that a body does not have. `has_other_bodies`: whether the species also has other
    bodies."""
    for name in worn_layers:
        if name not in body.layers:
            near = find_nearest_name(name, list(body.layers))
            known = ", ".join(f"`{each}`" for each in list(body.layers)[:_MAX_LISTED_NAMES])
            has = f"its layers are {known}" if known else "this body has no layers"
            which = f"the body `{body.name}` of `{species}`" if has_other_bodies else f"the body of `{species}`"
            report.error(
                "unknown-name", f"{which} has no layer `{name}`", place, f"did you mean `{near}`? {has}" if near else has
            )


def build_clip_data(clip: Clip, body: Definition) -> ClipData:
    """Return the data of a clip that a run needs. Its duration is in seconds, its stride in body lengths, its marks in cycles."""
    seconds = clip.duration
    marks = {name: mark_time / seconds if seconds > 0 else 0.0 for name, mark_time in clip.marks.items()}
    return ClipData(seconds, clip.stride / body.length, clip.loop, marks)


def compute_collision_size(body: Definition, is_standing: bool = False) -> BodyCapsuleData:
    """Return the collision size of a body.

    If the definition has a capsule, the size is that of the capsule. Otherwise, it is measured from the bounding box of the
    layer `collision` or, without this layer, of the base layer. The box is in the rest pose or, if `is_standing`, in the idle
    clip. The length is never less than the width."""
    if body.capsule is not None:
        length, width, height, ahead = (each / body.length for each in body.capsule)
        return BodyCapsuleData(max(length, width), width, height, ahead)
    layer = body.layers.get(COLLISION_LAYER_NAME) or find_base_layer(body)
    low, high = (
        compute_standing_box(body, layer)
        if is_standing
        else rotate_box_to_agent_space(body, compute_rest_box(replace(body, layers={layer.name: layer})))
    )
    width = max(float(high[2] - low[2]), 1e-3)
    middle = (low + high) / 2
    return BodyCapsuleData(max(float(high[0] - low[0]), width), width, float(middle[1]), float(middle[0]))


def _get_library_collision_size(word: str) -> BodyCapsuleData:
    """Return the collision size of the library body called `word`."""
    capsule = CAPSULE_BY_BODY[word]
    return BodyCapsuleData(capsule.length, capsule.width, capsule.height, capsule.forward_offset)


def list_named_bodies(scene: Scene, species: Iterable[str] = ()) -> list[NamedBody]:
    """Return the bodies of all species of the crowd, and of the additional `species`.

    The bodies of a species are those of its first crowd line that names any. If no line does, it is the library body that matches
    the species' name."""
    lines: dict[str, int] = {}
    for number, line in enumerate(scene.model.crowd):
        if line.body is not None:
            lines.setdefault(line.species, number)
    bodies: list[NamedBody] = []
    for name, number in lines.items():
        weights = scene.model.crowd[number].body_weights
        bodies += [
            NamedBody(make_body_key(name, k, len(weights)), name, text, find_body_span(scene, number, text), weight)
            for k, (text, weight) in enumerate(weights.items())
        ]
    for number, line in enumerate(scene.model.crowd):
        if line.species not in lines:
            lines[line.species] = number
            span = scene.find_span("crowd", number, "species")
            bodies.append(NamedBody(line.species, line.species, find_body_for_species(line.species), span))
    scene_start = scene.find_span("antdsl", key=True)
    return bodies + [NamedBody(name, name, find_body_for_species(name), scene_start) for name in species if name not in lines]


def _check_body(
    species: Species, body: Definition, text: str, place: Span, report: Report, chosen_by_species: bool = False
) -> None:
    """Report clips, transform groups and marks that a species needs but its body does not have. `chosen_by_species`: whether the
    body was chosen by the name of the species, because no crowd line names a body."""
    lacks: dict[str, tuple[str, Label]] = {}  # help text and place of each missing name

    def require_name(noun: str, name: str, known_names: Iterable[str], label: Label) -> None:
        names = sorted(set(known_names))
        if not name or name in names:
            return
        near = find_nearest_name(name, names)
        listed = ", ".join(f"`{each}`" for each in names[:_MAX_LISTED_NAMES]) + (" …" if len(names) > _MAX_LISTED_NAMES else "")
        has = f"its {noun}s are {listed}" if names else f"this body has no {noun}s"
        help = f"did you mean `{near}`? {has}" if near else has  # several words, unlike a replacement for the file's path
        lacks.setdefault(f"{noun} `{name}`", (help, label))

    marks = [mark for clip in body.clips.values() for mark in clip.marks]
    channels = map_language_names(each.name for each in body.rig.channels).values()
    for machine in species.machines:
        for appearance in _iterate_display_lines(machine):
            if isinstance(appearance, Wear):
                require_name("layer", appearance.layer, body.layers, Label(appearance.span, "worn here"))
            elif isinstance(appearance, Channel):
                require_name("channel", appearance.channel, channels, Label(appearance.span, "set here"))
            else:
                require_name("transform group", appearance.group, body.groups, Label(appearance.span, "turned here"))
        for line in _iterate_play_lines(machine):
            for clip in (line.clip, *line.blend_clips):
                require_name("clip", clip, body.clips, Label(line.span, "played here"))
            require_name("transform group", line.group, body.groups, Label(line.span, "named here"))
    for test in iterate_parts(species):
        if isinstance(test, ClipTest):
            require_name("mark", test.mark, marks, Label(test.span, "requested here"))
    for what, help, label in _find_misplaced_marks(species, body):
        lacks.setdefault(what, (help, label))
    if lacks:
        helps = [help if len(lacks) == 1 else f"{name}: {help}" for name, (help, _) in lacks.items()]
        if chosen_by_species:
            helps.append(
                f"`{species.name}` has this body because of its name: write `body: …` in the crowd line to choose another one"
            )
        labels = tuple(label for _, label in lacks.values())
        words = f"`{text[-60:]}` has no {', no '.join(lacks)}"
        report.error("unknown-name", words, place, "; ".join(helps), labels=labels)


def _find_misplaced_marks(species: Species, body: Definition) -> Iterator[tuple[str, str, Label]]:
    """Yield a message, a help text and a location for each misplaced mark.

    A mark is misplaced if a state waits for it and the state's clip does not have it, although other clips of the body do."""
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
            for test in (part for each in own for part in iterate_parts(each)):
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


def _iterate_play_lines(machine: Machine) -> Iterator[Play]:
    """Yield the `play` statements of a machine's states."""
    for state in machine.states:
        yield from (line for line in state.body if isinstance(line, Play))


def _iterate_display_lines(machine: Machine) -> Iterator[Wear | Channel | Look]:
    """Yield the statements, other than `play` lines, by which the states of a machine change a body: worn layers, channels and
    looks."""
    for state in machine.states:
        yield from (line for line in state.body if isinstance(line, (Wear, Channel, Look)))
