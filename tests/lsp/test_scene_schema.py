"""The JSON Schema of scenes for editors of YAML."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml
from page_groups import SCENE_TEXT

from antdsl import resources
from antdsl.lsp.scene_schema import SCHEMA_FILE_NAME, build_schema_text

ROOT = Path(__file__).resolve().parents[2]
SCHEMA = json.loads(build_schema_text())
SCENES = sorted(path for path in ROOT.glob("examples/*/*.yaml") if "\nedits:" not in path.read_text(encoding="utf-8"))
PAGE_SCENES = re.findall(r"```yaml scene\n(.*?)```", SCENE_TEXT, re.DOTALL)


class Yaml12Loader(yaml.SafeLoader):
    """Reads `on` as a text, as editors do."""


Yaml12Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag != "tag:yaml.org,2002:bool" or first in "tTfF"]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}


def list_errors(scene: Any) -> list[str]:
    return [error.message for error in jsonschema.Draft202012Validator(SCHEMA).iter_errors(scene)]


def test_the_shipped_file_is_that_of_the_models() -> None:
    assert resources.grammar_file(SCHEMA_FILE_NAME).read_text(encoding="utf-8") == build_schema_text()
    jsonschema.Draft202012Validator.check_schema(SCHEMA)


@pytest.mark.parametrize("path", SCENES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_every_scene_of_the_examples_is_valid(path: Path) -> None:
    assert not list_errors(yaml.load(path.read_text(encoding="utf-8"), Yaml12Loader))


def test_the_scenes_of_the_page_are_valid() -> None:
    assert len(PAGE_SCENES) > 5
    for text in PAGE_SCENES:
        assert not list_errors(yaml.load(text, Yaml12Loader)), text


@pytest.mark.parametrize(
    "scene",
    [
        {"antdsl": 1, "crowdd": []},
        {"antdsl": 1, "crowd": [{"species": "ant", "plase": {"on": "ground"}}]},
        {"antdsl": 1, "crowd": [{"species": "ant", "place": {"onn": "ground"}}]},
        {"antdsl": 1, "crowd": {"species": "ant"}},
        {"antdsl": 1, "world": {"ground": {"mesh": "a.ply", "scales": 2}}},
        {"antdsl": 1, "camera": {"atx": [0, 0, 0]}},
        {"antdsl": 1, "output": {"attribute": ["P"]}},
    ],
)
def test_unknown_keys_are_errors(scene: Any) -> None:
    assert list_errors(scene)


def test_keys_have_their_help() -> None:
    assert SCHEMA["properties"]["fps"]["description"]
    assert sum("description" in schema for schema in SCHEMA["properties"].values()) > 15
