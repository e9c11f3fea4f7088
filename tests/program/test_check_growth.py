"""What a check costs grows with the size of a file, not with its square, whatever stands in the file again and again."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from file_shapes import SHAPES, Shape

from antdsl.pipeline import check_path

# Eight times the text may cost twelve times as much; a square would be sixty-four.
TIMES, GROWTH = 8, 12
QUICK = ("blank lines", "things of the world", "species", "attributes", "uses of one file", "arguments named with an equals sign")


def cost(folder: Path, text: str) -> float:
    """Seconds of CPU that a check of the text takes."""
    path = folder / "a.ant"
    path.write_text(text, encoding="utf-8", newline="")
    (folder / "mine.ant").write_text("ant 1\nbehaviour b() -> push { heading }\n")
    start_time = time.process_time()
    check_path(path)
    return time.process_time() - start_time


def growth(folder: Path, shape: Shape, kibibytes: int) -> float:
    """How many times as much a check of eight times the text costs: the least of three tries, as others may use the machine."""
    least = float("inf")
    for _ in range(3):
        small = cost(folder, shape(kibibytes * 1024))
        least = min(least, cost(folder, shape(TIMES * kibibytes * 1024)) / small)
        if least < GROWTH:
            break
    return least


@pytest.mark.parametrize("name", QUICK)
def test_eight_times_the_text_costs_about_eight_times_as_much(tmp_path: Path, name: str) -> None:
    assert growth(tmp_path, SHAPES[name], 8) < GROWTH


@pytest.mark.slow
@pytest.mark.parametrize("name", SHAPES)
def test_the_longest_files_cost_about_eight_times_those_of_32_kib(tmp_path: Path, name: str) -> None:
    assert growth(tmp_path, SHAPES[name], 32) < GROWTH


def test_a_shape_has_the_requested_length() -> None:
    for name, shape in SHAPES.items():
        text = shape(8 * 1024)
        assert 6 * 1024 < len(text.encode()) <= 8 * 1024, name
