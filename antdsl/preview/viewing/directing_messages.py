"""The messages about notes and edits: the available verbs, the names that these may use, and the lines that users added."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from antdsl.outputs.cache.cache_reader import list_caches_below
from antdsl.preview.directing.hand_edits import EDITS_FILE, HandEdit
from antdsl.preview.directing.hand_notes import HandNote
from antdsl.preview.directing.verb_forms import FORMS_BY_LIST, VerbForm, VerbKey
from antdsl.preview.session import PreviewSession
from antdsl.preview.viewing.body_packets import find_body_of_key
from antdsl.program.tables.colours import COLOUR_BY_NAME
from antdsl.scene.checks.scene_checks import list_selector_names
from antdsl.scene.crowds.initial_values import is_settable
from antdsl.scene.library_bodies import BODY_WORDS
from antdsl.scene.notes.note_programs import remove_note_machines

if TYPE_CHECKING:
    from antdsl.preview.live import LiveSimulation

NamesByKind = Mapping[str, list[str]]
_DEFAULT_BODY_PART = "head"  # of bodies that look at something
_MAX_NAMES = 200  # of one kind


def make_verbs_message(live: LiveSimulation) -> dict[str, Any]:
    """Return the message with the verbs of notes and edits, the crowds that have names, and the origin of positions on pages
    (mm)."""
    session = live.session
    names, world = _list_names(session), session.world
    lines = [
        {"name": line.name, "species": ids.species, "ranges": [list(each) for each in ids.ranges]}
        for line, ids in zip(session.shot.scene.model.crowd, world.crowd_lines, strict=True)
        if line.name is not None
    ]
    return {"op": "verbs", **make_form_entries(names), "lines": lines, "origin": [float(x) for x in world.origin]}


def make_form_entries(names: NamesByKind) -> dict[str, list[dict[str, Any]]]:
    """Return the verbs and keys of `notes` and of `edits`. `names`: the result of `_list_names`."""
    return {listed: [_make_verb_entry(form, names) for form in make_forms()] for listed, make_forms in FORMS_BY_LIST.items()}


def _make_verb_entry(form: VerbForm, names: NamesByKind) -> dict[str, Any]:
    """Return the entry of a verb. `kind`, `example` and `choices` describe the value that follows the verb itself."""
    return {
        "verb": form.verb, "help": form.help, "keys": [_make_key_entry(key, names) for key in form.keys],
        "kind": form.value.name, "example": form.value.example, "choices": names.get(form.value.name, [])[:_MAX_NAMES],
    }  # fmt: skip


def make_notes_message(live: LiveSimulation) -> dict[str, Any]:
    """Return the notes that pages added to the run."""
    lines = [_make_line_entry(note) for note in live.session.notes]
    return {"op": "notes", "lines": lines, "problem": "", "file": live.screen.names.get_short_name(live.compiler.scene)}


def make_edits_message(live: LiveSimulation) -> dict[str, Any]:
    """Return the message about the edits that users added. It lists the edits, and gives the reason if the displayed frame lacks
    them. It also gives the result of settling."""
    settling = live.screen.settling
    lines = [_make_line_entry(edit) for edit in settling.edited.edits]
    settled = {"running": settling.is_running, "settled": settling.edited.settled is not None, "report": list(settling.report)}
    return {"op": "edits", "lines": lines, "problem": settling.edited.problem, "file": EDITS_FILE, "settling": settled}


def _make_line_entry(line: HandNote | HandEdit) -> dict[str, Any]:
    return {"key": line.key, "line": line.text, "on": line.is_on, "problem": line.problem}


def _make_key_entry(key: VerbKey, names: NamesByKind) -> dict[str, Any]:
    """Return the entry of a key. `names`: the result of `_list_names`."""
    return {
        "name": key.name, "kind": key.kind.name, "unit": key.kind.unit, "required": key.is_required, "default": key.default,
        "help": key.help, "example": _make_example(key, names), "narrows": key.is_selector,
        "choices": names.get(key.kind.name, [])[:_MAX_NAMES],
    }  # fmt: skip


def _make_example(key: VerbKey, names: NamesByKind) -> str:
    """Return an example of a key's value, with names from the scene where possible."""
    parts, own = names["part"], names.get(key.kind.name, [])
    if key.kind.name == "looks":
        return f"{{{parts[0] if parts else 'head'}: {names['target'][0] if names['target'] else '[0, 100, 0]'}}}"
    return own[0] if own else key.kind.example


def _list_names(session: PreviewSession) -> NamesByKind:
    """Return the names that values may use, by kind of key. The kind `part` has the transform groups of the bodies."""
    shot, world = session.shot, session.world
    setting, program = world.setting, remove_note_machines(shot.program)
    selectors = list_selector_names(shot.scene, program)
    bodies = [find_body_of_key(shot, key) for name in world.populations for key in setting.list_body_keys(name)]
    agents = [*selectors.lines, *sorted(selectors.species)]
    items, meshes = sorted(selectors.items), [*sorted(setting.obstacles), *sorted(setting.surfaces)]
    attributes = {a.name: None for species in program.species.values() for a in species.attributes if is_settable(a)}
    return {
        "agents": agents, "target": [*items, *agents, *sorted(selectors.cameras), *meshes],
        "state": sorted(each for each in selectors.states if "." not in each),
        "camera": sorted(selectors.cameras), "map": sorted(setting.maps), "path": sorted(setting.curves),
        "thing": [*meshes, *items, *agents],
        "clip": sorted({clip for body in bodies for clip in body.clips}),
        "part": sorted({group for body in bodies for group in body.groups}, key=lambda name: (name != _DEFAULT_BODY_PART, name)),
        "values": [f"{{{name}: }}" for name in attributes],
        "cache": list_caches_below(Path(shot.scene.source.path).parent),
        "place": items, "body": list(BODY_WORDS), "colour": list(COLOUR_BY_NAME), "ground": ["follow", "free"],
        "axis": ["x", "y", "z"], "mesh": sorted(setting.surfaces),
        "joint": sorted({joint for body in bodies for joint in body.rig.names}),
        "layers": sorted({f"[{layer}]" for body in bodies for layer in body.layers}),
    }  # fmt: skip
