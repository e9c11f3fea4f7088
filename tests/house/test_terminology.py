"""Words to avoid become fewer, never more; each area's count is in `terminology.json`."""

from __future__ import annotations

import ast
import json

import pytest
import terminology

LISTS = "Run `python tests/terminology.py --list {area}`, write what docs/glossary.md says, and `--record` a lower count."


@pytest.mark.parametrize("area", terminology.AREAS)
def test_an_area_has_no_more_words_to_avoid(area: str) -> None:
    allowed = json.loads(terminology.RECORD.read_text(encoding="utf-8"))[area]
    count = sum(1 for _ in terminology.uses(area))
    assert count <= allowed, LISTS.format(area=area)


def test_words_are_found_in_each_kind_of_text() -> None:
    tree = ast.parse('"""It is refused."""\ndef told(whom, position): ...\nfound = "Nobody came here"\nnumber = "told"\n')
    assert {use.word for use in terminology.uses_in_names("way.py", tree)} == {"way", "told", "whom", "found"}
    assert [use.word for use in terminology.uses_in_docstrings("a.py", tree)] == ["is refused"]
    assert [use.word for use in terminology.uses_in_messages("a.py", tree)] == ["nobody"]
    assert [use.line for use in terminology.uses_in_comments("a.py", "x = 1\ny = 2  # worked out\n")] == [2]
    assert not list(terminology.uses_in_text("a.md", 1, "A foretold two-fold besidesthepoint"))


def test_the_glossary_lists_words_of_both_kinds() -> None:
    everywhere, complete = terminology.words()
    assert {"told", "worked out"} <= everywhere and {"found", "way"} <= complete and not everywhere & complete
