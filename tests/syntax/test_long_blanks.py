"""Files with very many blanks in a row are read in time that grows with their length and not with its square."""

from __future__ import annotations

import pytest

from antdsl.diagnostics import ignore_comments
from antdsl.scene import indentation

BLANKS = 200_000
TEXTS = {
    "a comment": (ignore_comments._IGNORE_COMMENT, "# antdsl: ignore[far-away] x", "y", True),
    "a key without a colon": (indentation._KEY_PATTERN, "ground", "x", False),
    "a key": (indentation._KEY_PATTERN, "ground", ": x", True),
    "a word behind a key": (indentation._MISSING_COLON_PATTERN, "ground", "x", True),
    "a value without a blank": (indentation._MISSING_SPACE_PATTERN, "ground:x", "y", True),
}


@pytest.mark.parametrize("name", TEXTS)
def test_blanks_cost_no_more_than_once_each(name: str) -> None:
    """With the square of their number this would take half an hour."""
    pattern, prefix, suffix, is_match = TEXTS[name]
    match = pattern.search(prefix + " " * BLANKS + suffix)
    assert (match is not None) == is_match
    short = pattern.search(f"{prefix} {suffix}")
    assert (short is not None) == is_match


def test_a_plain_key_ends_before_the_blanks() -> None:
    match = indentation._KEY_PATTERN.match("two words  : 1")
    assert match is not None and match[1] == "two words"
    assert [indentation._KEY_PATTERN.match(text) is not None for text in ("a:", "a :x", "'q: r' : 1", ": x", "-a: 1")] == [
        True, False, True, False, False,
    ]  # fmt: skip
