"""Checks that the things to which a scene and its program refer exist.

These are the species of a crowd, the files of bodies, and the scenes of specs."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from antdsl import limits
from antdsl.diagnostics import Fix, Label, Report
from antdsl.program.cascading_errors import merge_repeated_findings
from antdsl.program.model import OperationExpr, Program, ThingRef
from antdsl.program.traverse import iterate_parts
from antdsl.scene.library_bodies import BODY_WORDS
from antdsl.scene.load import Scene
from antdsl.scene.looks import is_lamp_look
from antdsl.scene.paths import PathRefused, Roots
from antdsl.scene.thing_models import LampThing, MeshThing
from antdsl.source import Span

_SUGGESTION_PATTERN = re.compile(r"did you mean `([^`]+)`\?")


def check_body_files(scene: Scene, program: Program, report: Report) -> None:
    """Report each crowd line that names a body that cannot be used."""
    first: dict[str, int] = {}
    for number, line in enumerate(scene.model.crowd):
        if line.body is None:
            continue
        place = scene.find_span("crowd", number, "body")
        earlier = first.setdefault(line.species, number)
        known = scene.model.crowd[earlier]
        if list(known.body_weights.items()) != list(line.body_weights.items()):
            report.error(
                "wrong-value", f"`{line.species}` has a different body in a line above", place,
                f"write `{scene.find_span('crowd', earlier, 'body').text.strip()}` in both, or make it another species",
                labels=(Label(scene.find_span("crowd", earlier, "body"), "the first one"),),
            )  # fmt: skip
        elif earlier == number:
            for text in line.body_weights:
                if text not in BODY_WORDS:
                    _check_body_file(scene, text, find_body_span(scene, number, text), report)


def find_body_span(scene: Scene, number: int, text: str) -> Span:
    """Return the location of a body's name in a crowd line. If the line has a mapping of bodies, this is a key of the mapping,
    otherwise the value of `body`.

    `number`: the index of the line. `text`: the name of the body."""
    if isinstance(scene.model.crowd[number].body, dict):
        return scene.find_span("crowd", number, "body", text, key=True)
    return scene.find_span("crowd", number, "body")


def _check_body_file(scene: Scene, text: str, place: Span, report: Report) -> None:
    """Report the file of a body if it does not exist or is too large."""
    try:
        size = scene.roots.measure_file_size(text)
    except PathRefused as error:
        report.error(error.code, str(error), place, error.help)
        return
    if size > limits.MAX_BODY_FILE_BYTES:
        report.error("too-large", f"`{text}` has {size:,} bytes, more than {limits.MAX_BODY_FILE_BYTES:,}", place)


def check_absent_species(scene: Scene, program: Program, report: Report) -> None:
    """Report species that agents search for or collide with, but that no program defines."""
    absent = [name for name, thing in program.world.items() if thing.kind == "species" and name not in program.species]
    if not absent:
        return
    every = list(iterate_parts(tuple(program.species.values())))
    keys = ("referent", "source_name", "other_species", "target")
    requested_names = {each.name for each in every if isinstance(each, ThingRef)} | {
        name for each in every for key in keys if isinstance(name := getattr(each, key, None), str)
    }
    for name in absent:
        if name in requested_names:
            message = f"the program uses the species `{name}`, but no line of the crowd adds it"
            advice = f"add to `crowd`: `- {{species: {name}, from: {name}.ant, count: 0}}`"
            label = Label(program.world[name].span, "declared here")
            report.error("missing-thing", message, scene.find_span("antdsl", key=True), advice, labels=(label,))


def check_dark_lamps(scene: Scene, program: Program, report: Report) -> None:
    """Report `light(THING)` for a thing without a light source, and lamps that are off because their strength is 0."""
    lamps = [name for name, thing in scene.model.world.items() if _has_lamp(thing)]
    if scene.model.light.lamps == 0 and lamps:
        message = f"`lamps: 0` makes `{lamps[0]}` dark, in pictures and for `light({lamps[0]})`"
        report.warning("wrong-value", message, scene.find_span("light", "lamps"), "write `lamps: 100 %`, or remove the lamp")
    sensed = {
        thing.name: part
        for part in iterate_parts(tuple(program.species.values()))
        if isinstance(part, OperationExpr) and part.name == "light" and isinstance(thing := part.args[0], ThingRef)
    }
    for name, part in sensed.items():
        value = scene.model.world.get(name)
        if value is not None and not _has_lamp(value):
            message = f"no item of `{name}` emits light, so `light({name})` is always 0"
            label = Label(part.span, "sensed here")
            report.warning(
                "missing-key",
                message,
                scene.find_span("world", name, key=True),
                "add `look: light` to the lamps",
                labels=(label,),
            )


def _has_lamp(thing: Any) -> bool:
    """Return whether a scene's thing has an item that emits light."""
    looks = [item.look for item in thing.values()] if isinstance(thing, dict) else [getattr(thing, "look", None)]
    return isinstance(thing, LampThing) or (not isinstance(thing, MeshThing) and any(map(is_lamp_look, looks)))


def check_spec_scenes(program: Program | None, grants: Mapping[str, Path] | None = None) -> Report:
    """Report scenes that do not exist although specs name them. Each missing scene is reported once, with all locations that
    name it.

    The scenes themselves are not read."""
    report = Report()
    specs = program.specs if program else ()
    named = (text for spec in specs for text in (spec.scene, spec.reference_run.scene if spec.reference_run else None))
    for text in named:
        if text is None or not text.text.endswith((".yaml", ".yml")):
            continue
        roots = Roots(Path(text.span.source.path).resolve().parent, grants or {})
        try:
            roots.measure_file_size(text.text)
        except PathRefused as error:
            near = _SUGGESTION_PATTERN.fullmatch(error.help or "")
            fix = Fix(text.span, f'"{near[1]}"') if near and "/" not in text.text else None
            advice = error.help or "name a scene next to this program or below its folder"
            report.error(error.code, str(error), text.span, advice, fix=fix)
    return merge_repeated_findings(report)
