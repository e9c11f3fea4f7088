"""What one file may hold is counted before it is parsed."""

from __future__ import annotations

from unittest.mock import patch

import pytest

from antdsl import limits, syntax
from antdsl.source import Source
from antdsl.syntax.incremental_parser import IncrementalParser
from antdsl.syntax.parser import _FileParser

SPECIES = "species s{} {{ state a {{ }}\nlayers {{ state }} }}\n"
END = "\nstate a { }\nlayers { state } }\n"
LARGE = {
    "5,000 species": "ant 1\n" + "".join(SPECIES.format(number) for number in range(5000)),
    "9,005 statements": "ant 1\nspecies s { " + "\n".join(f"let p{number} = 2 mm" for number in range(9000)) + END,
    "4,001 statements": "ant 1\n" + "foo bar\n" * 4000,
    "words, numbers and signs": "ant 1\nspecies s { x = " + "\n x = ".join("+".join(["1"] * 150) for _ in range(120)) + END,
}


@pytest.mark.parametrize("words", LARGE)
def test_a_large_file_is_one_located_message_and_is_not_parsed(words: str) -> None:
    text = LARGE[words]
    assert len(text.encode()) <= limits.MAX_PROGRAM_BYTES
    with patch("antdsl.syntax.parser._FileParser", side_effect=AssertionError("parsed")):
        file, report = syntax.parse(Source("large.ant", text))
    assert file.has_errors
    (error,) = report.errors
    assert error.code == "too-many" and words.split(" of")[0] in error.message
    assert error.span is not None and error.span.start > 1000


@pytest.mark.parametrize("words", LARGE)
def test_a_file_that_is_edited_has_the_same_limits(words: str) -> None:
    parts = IncrementalParser()
    parts.parse(Source("large.ant", "ant 1\n" + SPECIES.format("a") + SPECIES.format("b")))
    with patch("antdsl.syntax.parser._FileParser.parse_lines", autospec=True, side_effect=_FileParser.parse_lines) as reading:
        edited_result = parts.parse(Source("large.ant", LARGE[words]))
    assert (
        reading.call_count <= limits.MAX_FILE_STATEMENTS + limits.MAX_FILE_SPECIES
    )  # one for each part, and for each group in it
    (problem,), (expected,) = (each.errors for each in (edited_result[1], syntax.parse(Source("large.ant", LARGE[words]))[1]))
    assert (problem.message, str(problem.span)) == (expected.message, str(expected.span))


def test_a_file_at_the_limits_is_parsed() -> None:
    text = "ant 1\n" + "".join(SPECIES.format(number) for number in range(limits.MAX_FILE_SPECIES))
    file, report = syntax.parse(Source("large.ant", text))
    assert report.ok and not file.has_errors
    assert not IncrementalParser().parse(Source("large.ant", text))[1].diagnostics
