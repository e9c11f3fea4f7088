"""The meanings and possible values of keys in scenes. They come from the schema, and from the programs that the scene's crowd
uses."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from antdsl.lsp.features.expression_completion import CompletionItem
from antdsl.lsp.word_descriptions import find_scene_key_help
from antdsl.lsp.word_help import find_help_text
from antdsl.lsp.workspace import OpenDocument, Workspace
from antdsl.program.names.file_declarations import find_declaring_node
from antdsl.program.tables.columns import COLUMN_BY_ATTRIBUTE
from antdsl.program.tables.things import KIND_BY_WORD, KINDS_WITH_FACES
from antdsl.scene import scene_model
from antdsl.scene.camera_models import CAMERA_MODEL_BY_TYPE_TAG
from antdsl.scene.crowds.casting_model import FACING_WORDS
from antdsl.scene.thing_models import ItemThing
from antdsl.syntax import nodes
from antdsl.syntax.words import FIELD_SETTING_WORDS, FIXED_FIELD_SETTINGS

_KEY_PATTERN = re.compile(r"^(\s*)(?:- )?([A-Za-z_.][A-Za-z_0-9.]*):")


def find_key_path(text: str, offset: int) -> tuple[tuple[str, ...], str]:
    """Return the path of keys that encloses a position, outermost first, and the part of the line before the position.

    The path is derived from indentation and open braces, because the YAML may be invalid at this position."""
    begin = text.rfind("\n", 0, offset) + 1
    line = text[begin:offset]
    indent = len(line) - len(line.lstrip())
    outer_keys: list[str] = []
    level = indent if line.strip() else 10**9 if indent else 0
    level = indent
    for earlier in reversed(text[:begin].splitlines()):
        match = _KEY_PATTERN.match(earlier)
        if match is None or earlier.lstrip().startswith("#"):
            continue
        depth = len(match.group(1))
        if depth < level:
            outer_keys.insert(0, match.group(2))
            level = depth
    return (*outer_keys, *_find_open_keys(line)), line


def _find_open_keys(line: str) -> list[str]:
    """Return the keys of a line that still need a value at its end, such as crowd and place for `crowd: - {place: {`."""
    stack: list[str] = []
    key = ""
    for piece in re.finditer(r"([A-Za-z_.][A-Za-z_0-9.]*):|[{}\[\]]", line):
        if piece.group(1):
            key = piece.group(1)
            continue
        sign = piece.group()
        if sign in "{[":
            stack.append(key)
            key = ""
        elif stack:
            stack.pop()
            key = ""
    first = re.match(r"\s*(?:- )?([A-Za-z_.][A-Za-z_0-9.]*):\s*\S*$", line)
    return [each for each in stack if each] + ([first.group(1) + ":"] if first is not None and not stack else [])


def complete_scene(workspace: Workspace, document: OpenDocument, offset: int) -> list[CompletionItem]:
    """Return the completion proposals at an offset of a scene."""
    path, line = find_key_path(document.text.text, offset)
    value = re.search(r"([A-Za-z_.][A-Za-z_0-9.]*):\s*[A-Za-z_0-9./]*$", line)
    if "#" in line:
        return []
    if value is not None:
        outer_keys = tuple(part for part in path if not part.endswith(":"))
        return list(_propose_values(workspace, document, value.group(1), outer_keys))
    return list(_propose_keys(workspace, document, tuple(part for part in path if not part.endswith(":")), line))


def _find_crowd_programs(workspace: Workspace, document: OpenDocument) -> Iterator[OpenDocument]:
    """Yield the programs that a scene's crowd uses."""
    for path in workspace.find_linked_files(document.path):
        other = workspace.find_document(path)
        if other is not None and other.is_program:
            yield other


def _propose_keys(workspace: Workspace, document: OpenDocument, path: tuple[str, ...], line: str) -> Iterator[CompletionItem]:
    """Yield the keys that may be written at a position. `path`: the enclosing keys. `line`: the line up to the position."""
    if not path and not line.lstrip().startswith("-"):
        yield from _propose_model_fields(scene_model.SceneModel)
    elif path[:1] in (("world",), ("cameras",)):
        yield from _propose_world_keys(workspace, document, path)
    elif path == ("set",):
        yield from _propose_settings(workspace, document)
    elif path == ("fields",):
        yield from (
            CompletionItem(name, "property", "field", "", f"{name}: ")
            for p in _find_crowd_programs(workspace, document)
            for name in p.names.fields
        )
    elif path == ("layers",):
        yield from (
            CompletionItem(name, "property", "species", "", f"{name}: ")
            for p in _find_crowd_programs(workspace, document)
            for name in p.names.species
        )
    elif path[-1:] == ("each",) and path[:1] == ("crowd",):
        yield from _propose_initial_values(workspace, document)
    elif path[:1] == ("fields",):
        items = [item for each in scene_model.FIELD_START_MODELS.values() for item in _propose_model_fields(each)]
        yield from {item.label: item for item in items}.values()
    elif path == ("output", "attributes"):
        yield from (CompletionItem(name, "property", "attribute of a frame") for name in COLUMN_BY_ATTRIBUTE)
    else:
        part_model = next((scene_model.MODEL_BY_PATH[part] for part in reversed(path) if part in scene_model.MODEL_BY_PATH), None)
        if part_model is not None:
            yield from _propose_model_fields(part_model)


def _propose_initial_values(workspace: Workspace, document: OpenDocument) -> Iterator[CompletionItem]:
    """Yield the attributes that a crowd line may set at birth, and `state`."""
    yield CompletionItem("state", "property", "the first state", "", "state: ")
    for program in _find_crowd_programs(workspace, document):
        for table in program.names.species.values():
            for name, member in table.own_members.items():
                node = find_declaring_node(member)
                if isinstance(node, nodes.Declaration):
                    yield CompletionItem(name, "property", "attribute", find_help_text(node), f"{name}: ")


def _propose_model_fields(part: type[scene_model.ScenePart]) -> Iterator[CompletionItem]:
    """Yield the keys of one part of the scene schema."""
    for name, field in part.model_fields.items():
        key = field.alias or name
        yield CompletionItem(
            key, "property", "must be given" if field.is_required() else "", find_scene_key_help(key), f"{key}: "
        )


def _propose_world_keys(workspace: Workspace, document: OpenDocument, path: tuple[str, ...]) -> Iterator[CompletionItem]:
    """Yield the keys that may be written below `world` or `cameras`: names of things, or the keys of one thing."""
    things = {name: item for each in _find_crowd_programs(workspace, document) for name, item in each.names.things.items()}
    if len(path) == 1:
        for name, item in things.items():
            kind = KIND_BY_WORD.get(item.kind.text)
            if kind is not None and kind.section != path[0]:
                continue
            form = "" if kind is None else kind.snippet
            yield CompletionItem(name, "thing", item.kind.text, find_help_text(item), f"{name}: {form}", bool(form))
        return
    if path[0] == "cameras":
        for model in CAMERA_MODEL_BY_TYPE_TAG.values():
            yield from _propose_model_fields(model)
        return
    thing = things.get(path[1])
    if thing is not None and thing.kind.text == "items":
        if len(path) > 2:
            yield from _propose_model_fields(ItemThing)
            for each in thing.attributes:
                yield CompletionItem(each.name.text, "property", f"value of {path[1]}", "", f"{each.name.text}: ")
        return
    for head, part in scene_model.THING_MODELS.items():
        yield CompletionItem(head, "property", "says what it is", find_scene_key_help(head), f"{head}: ")
        if head == "mesh":
            yield from _propose_model_fields(part)


def _propose_settings(workspace: Workspace, document: OpenDocument) -> Iterator[CompletionItem]:
    """Yield params and field settings that `set` may change, with their values."""
    for program in _find_crowd_programs(workspace, document):
        for species, table in program.names.species.items():
            for name, member in table.own_members.items():
                node = find_declaring_node(member)
                if isinstance(member, nodes.ParamDecl):
                    value = " ".join(node.value.span.text.split())
                    bounds = f" in {' '.join(node.range.span.text.split())}" if node.range is not None else ""
                    help = find_help_text(node)
                    yield CompletionItem(f"{species}.{name}", "property", f"{value}{bounds}", help, f"{species}.{name}: {value}")
        for name, field in program.names.fields.items():
            for setting in field.settings:
                if setting.name.text in FIELD_SETTING_WORDS and setting.name.text not in FIXED_FIELD_SETTINGS:
                    word, value = setting.name.text, setting.value.span.text
                    yield CompletionItem(f"{name}.{word}", "property", value, "setting of a field", f"{name}.{word}: {value}")


def _propose_values(workspace: Workspace, document: OpenDocument, key: str, path: tuple[str, ...]) -> Iterator[CompletionItem]:
    """Yield the possible values of a key. `path`: the enclosing keys."""
    things: dict[str, Any] = {n: i for each in _find_crowd_programs(workspace, document) for n, i in each.names.things.items()}
    if key == "species":
        for each in _find_crowd_programs(workspace, document):
            yield from (CompletionItem(n, "thing", "species") for n, t in each.names.species.items() if t.node is not None)
    elif key in ("from", "extends"):
        suffix = (".ant",) if key == "from" and "crowd" in path else (".yaml", ".yml")
        for file in workspace.list_files():
            if file.suffix in suffix and file.is_relative_to(document.path.parent) and file != document.path:
                yield CompletionItem(file.relative_to(document.path.parent).as_posix(), "file")
    elif key in ("units", "up"):
        yield from (CompletionItem(word, "unit") for word in (("mm", "cm", "m") if key == "units" else ("x", "y", "z")))
    elif key == "along":
        yield from (CompletionItem(n, "thing", "curve") for n, i in things.items() if i.kind.text == "curve")
    elif key in ("on", "border", "edge"):
        yield from (CompletionItem(n, "thing", i.kind.text) for n, i in things.items() if i.kind.text in KINDS_WITH_FACES)
    elif key in ("around", "toward", "away", "solved", "facing"):
        yield from (CompletionItem(word, "keyword") for word in (FACING_WORDS if key == "facing" else ()))
        yield from (CompletionItem(n, "thing", i.kind.text) for n, i in things.items() if i.kind.text in ("items", "curve"))
        yield from (CompletionItem(name, "thing", "item") for name in document.scene.items)
    elif key == "density":
        yield from (CompletionItem(n, "thing", "map") for n, i in things.items() if i.kind.text == "map")
