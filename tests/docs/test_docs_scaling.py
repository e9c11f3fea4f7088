"""The model of docs/scaling.md: what it predicts is the sum of its terms, and is near what was measured."""

from __future__ import annotations

import re
from math import sqrt
from pathlib import Path

PAGE = Path(__file__).resolve().parents[2] / "docs" / "scaling.md"


def numbers(part: str) -> list[list[str]]:
    """The rows of numbers of the table between two marks of the page."""
    text = PAGE.read_text(encoding="utf-8")
    inner = text.partition(f"<!-- {part} -->")[2].partition(f"<!-- end of {part} -->")[0]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in inner.splitlines() if line.startswith("|")]
    return [row for row in rows if re.fullmatch(r"[\d.,]+", row[1])]


def step(agents: int) -> float:
    """CPU ms of a step by the terms of the page."""
    terms = [[float(cell) for cell in row[1:]] for row in numbers("terms")]
    return sum(fixed + root * sqrt(agents) / 1e3 + each * agents / 1e6 for fixed, root, each in terms)


def test_what_is_predicted_is_the_sum_of_the_terms() -> None:
    assert len(numbers("terms")) == 8
    rows = numbers("model")
    assert len(rows) == 7
    for agents, predicted, measured, ratio in rows:
        expected = step(int(agents.replace(",", "")))
        assert abs(float(predicted) - expected) < 0.006, f"{agents} agents: {expected:.2f}"
        assert abs(float(ratio) - float(predicted) / float(measured)) < 0.0051, agents


def test_the_model_is_within_a_quarter_of_what_was_measured() -> None:
    for agents, predicted, measured, _ in numbers("model"):
        assert abs(float(predicted) / float(measured) - 1) <= 0.25, agents
    at = {int(row[0].replace(",", "")): float(row[2]) for row in numbers("model")}
    assert {1_000, 15_000, 100_000, 1_000_000} <= set(at)


def test_the_phases_that_were_measured_add_up_to_the_steps() -> None:
    """Within what the median of a sum differs from the sum of medians, and rounding."""
    text = PAGE.read_text(encoding="utf-8")
    lines = [line.strip("|").split("|") for line in text.partition("### A model")[0].splitlines() if line.startswith("| ")]
    agent_counts = [int(cell.replace(",", "")) for cell in lines[0][1:]]
    at = {int(row[0].replace(",", "")): float(row[2]) for row in numbers("model")}
    for k, agents in enumerate(agent_counts, 1):
        assert abs(sum(float(line[k]) for line in lines[1:]) / at[agents] - 1) < 0.03, agents
