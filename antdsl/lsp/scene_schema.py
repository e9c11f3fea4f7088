"""The JSON Schema of scenes, for YAML editors. `python -m antdsl.lsp.scene_schema` writes the schema file that antdsl
distributes.

The schema has the keys of the scene models, with their help. It accepts more values than a scene does: a number may be a text
with a unit, and a list may be a text such as `1..240`. `antdsl check` checks these values."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from antdsl import resources
from antdsl.atomic_write import write_atomically
from antdsl.lsp.word_descriptions import find_scene_key_help
from antdsl.scene.scene_model import SceneModel, ScenePart

SCHEMA_FILE_NAME = "scene.schema.json"
_SCALAR_SCHEMA = {"type": ["number", "string"]}
_SCALAR_TYPES = ("number", "integer", "string")
_DROPPED_KEYWORDS = ("title", "default", "discriminator", "required")  # a scene that extends another may leave out any key


def build_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a scene file."""
    schema = SceneModel.model_json_schema(by_alias=True)
    definitions = schema.pop("$defs")
    model_names = {model.__name__ for model in _list_models(ScenePart)}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$comment": "Made from the models of scenes by `python -m antdsl.lsp.scene_schema`: change it there.",
        "title": "antdsl scene",
        **_allow_scalar_texts(schema),
        "$defs": {
            name: _allow_scalar_texts(part) if name in model_names else _SCALAR_SCHEMA for name, part in definitions.items()
        },
    }


def build_schema_text() -> str:
    """Return the text of the schema file. It has one line for each key of a scene and one for each definition."""
    schema = build_schema()
    lines = []
    for keyword, value in schema.items():
        if keyword in ("properties", "$defs"):
            rows = ",\n".join(f"  {json.dumps(name)}: {json.dumps(part)}" for name, part in value.items())
            lines.append(f"{json.dumps(keyword)}: {{\n{rows}\n }}")
        else:
            lines.append(f"{json.dumps(keyword)}: {json.dumps(value)}")
    return "{\n " + ",\n ".join(lines) + "\n}\n"


def _list_models(model: type[ScenePart]) -> Iterator[type[ScenePart]]:
    """Yield all subclasses of a model, direct and indirect."""
    for child in model.__subclasses__():
        yield child
        yield from _list_models(child)


def _allow_scalar_texts(part: Any) -> Any:
    """Return a part of the schema in which each scalar may also be a text with a unit."""
    if isinstance(part, list):
        return [_allow_scalar_texts(each) for each in part]
    if not isinstance(part, dict):
        return part
    if part.get("type") in _SCALAR_TYPES and not part.keys() & {"enum", "const"}:
        return _SCALAR_SCHEMA
    if part.get("type") == "array":
        items = {"items": _allow_scalar_texts(part["items"])} if "items" in part else {}
        return {"anyOf": [{"type": "array", **items}, _SCALAR_SCHEMA]}
    loose_part: dict[str, Any] = {}
    for keyword, value in part.items():
        if keyword == "properties":
            loose_part[keyword] = {key: _describe(key, _allow_scalar_texts(schema)) for key, schema in value.items()}
        elif keyword in ("oneOf", "anyOf"):  # looser alternatives can hold at the same time
            alternatives = _allow_scalar_texts(value)
            loose_part["anyOf"] = [each for number, each in enumerate(alternatives) if each not in alternatives[:number]]
        elif keyword not in _DROPPED_KEYWORDS:
            loose_part[keyword] = _allow_scalar_texts(value)
    return loose_part


def _describe(key: str, schema: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a key, extended by the help for this key."""
    help = find_scene_key_help(key)
    return {**schema, "description": help} if help else schema


def main() -> None:
    """Write the schema file next to the grammar in the checkout."""
    path = resources.grammar_file(SCHEMA_FILE_NAME)
    write_atomically(path, build_schema_text().encode())


if __name__ == "__main__":
    main()
