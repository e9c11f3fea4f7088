"""A kind of thing of the world is a row and a class: few other files name it."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from antdsl.program.tables.things import KIND_BY_WORD
from antdsl.scene.scene_kinds import SCENE_KINDS

PACKAGE = Path(__file__).resolve().parents[2] / "antdsl"
OWN = {"syntax/words.py", "program/tables/things.py", "scene/scene_kinds.py"}  # its word, its row, its class
# Other files that may name a kind: the rows of senses and effects, the keys of scenes, and code that is about this kind alone.
MOST = {"surface": 6, "obstacle": 7, "solid": 3, "curve": 5, "flow": 6, "map": 5}


def files_by_word() -> dict[str, set[str]]:
    """The files that name a kind, as a text or as a member of `Kind`."""
    named: dict[str, set[str]] = {word: set() for word in MOST}
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str | bytes):
                word = node.value if isinstance(node.value, str) else node.value.decode("latin-1")
            elif isinstance(node, ast.Attribute) and ast.unparse(node.value).endswith("Kind"):
                word = node.attr.lower()
            else:
                continue
            if word in named:
                named[word].add(path.relative_to(PACKAGE).as_posix())
    return named


NAMED = files_by_word()


@pytest.mark.parametrize("word", MOST)
def test_few_files_name_a_kind(word: str) -> None:
    others = sorted(NAMED[word] - OWN)
    assert NAMED[word] >= OWN and len(others) <= MOST[word], others


def test_every_kind_that_a_scene_gives_has_a_class() -> None:
    assert set(SCENE_KINDS) == {row.word for row in KIND_BY_WORD.values() if row.scene}
