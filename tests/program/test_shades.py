"""Shades of truth: `rising falling around`, `and or not` of them, and `fuzzy` rules; on both backends, by their definitions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from meaning import crowd, item, play


def value(text: str, at: float = 0.0) -> float:
    """`x` of an agent that stands so far from the one piece of food, after one step."""
    states = "start s\nstate s { when true -> t { x = y } }\nstate t { when false -> s }"
    history = play(f"species a {{ x = 0\n{text}\n{states} }}", crowd(at=[(at, 0)]), items={"food": (item("f", 0, 0),)})
    return history["x"][0]


@pytest.mark.parametrize(("at", "rising", "falling", "around"), [(0, 0, 1, 0), (20, 0, 1, 0), (30, 0.25, 0.75, 0.5),
                                                                 (40, 0.5, 0.5, 1), (60, 1, 0, 0), (90, 1, 0, 0)])  # fmt: skip
def test_memberships_are_straight_between_their_ends(at: float, rising: float, falling: float, around: float) -> None:
    for word, expected in (("rising", rising), ("falling", falling), ("around", around)):
        assert value(f"let y = {word}(distance(nearest(food)), 20 mm .. 60 mm)", at) == pytest.approx(expected, abs=1e-6)


NEAR = "let near = falling(distance(nearest(food)), 20 mm .. 60 mm)\n"


def test_and_or_not_are_least_greatest_and_the_rest_to_one() -> None:
    assert value(NEAR + "let y = near and not near", 30) == pytest.approx(0.25)
    assert value(NEAR + "let y = near or not near", 30) == pytest.approx(0.75)
    assert value(NEAR + "fuzzy y { near and touching(food) -> 1; true -> 0 }", 30) == 0  # in a rule a yes counts as 1
    assert value(NEAR + "fuzzy y { near and nearest(food) -> 1; near -> 0 }", 30) == pytest.approx(0.5)


def test_rules_are_weighted_by_how_true_they_are() -> None:
    """0.75 of 0.8 and 0.25 of 0.1, over their sum; a rule of which nothing is true says nothing; nothing at all is 0."""
    both = NEAR + "fuzzy y { near -> 0.8; not near -> 0.1 }"
    assert [value(both, at) for at in (0, 30, 80)] == pytest.approx([0.8, 0.625, 0.1])
    assert [value(NEAR + "fuzzy y { near -> 0.8 }", at) for at in (30, 80)] == pytest.approx([0.8, 0])
    third = NEAR + "let wide = not near\nfuzzy haste { near -> 40 mm/s; wide -> 10 mm/s; touching(food) -> 0 mm/s }\n"
    third += "let y = haste / (1 mm/s)"
    assert [value(third, at) for at in (0, 30)] == pytest.approx([20, 32.5])


def test_a_degree_outside_of_0_to_1_counts_as_the_nearer_end() -> None:
    assert value("n = 7\nfuzzy y { n -> 1; 0.5 -> 0 }") == pytest.approx(1 / 1.5)
    assert value("n = 7\nfuzzy y { 0 - n -> 1; 0.5 -> 3 }") == pytest.approx(3)


@settings(max_examples=15)
@given(st.lists(st.tuples(st.floats(0, 1, width=32), st.floats(-100, 100, width=32)), min_size=1, max_size=6))
def test_rules_are_the_weighted_mean_of_their_outputs(rules: list[tuple[float, float]]) -> None:
    attributes = "".join(f"d{k} = {d:.9f}\no{k} = {abs(o):.9f}\n" for k, (d, o) in enumerate(rules))
    lines = "; ".join(f"d{k} -> {'-' if o < 0 else ''}o{k}" for k, (_, o) in enumerate(rules))
    d, o = np.array([float(f"{d:.9f}") for d, _ in rules]), np.array([o for _, o in rules])
    expected = float((d * o).sum() / d.sum()) if d.sum() > 0 else 0.0
    assert value(f"{attributes}fuzzy y {{ {lines} }}") == pytest.approx(expected, rel=1e-4, abs=1e-3)


def test_rules_drive_changes_chances_and_pushes() -> None:
    """One who stands in the light has fled from it; the share of those who did goes by the rules' number as a rate."""
    text = (
        NEAR
        + """fuzzy fright { near -> 1; not near -> 0 }
response 1 step
max_speed 10 mm/s
on spawn { velocity = vector(0 mm/s, 0 mm/s, 0 mm/s) }
start calm
state calm { steer flee(nearest(food)) * fright * 0.25; when fright > 0.7 held 0.2 s -> gone; when chance fright * 2 /s -> gone }
state gone { when false -> calm }"""
    )
    ring = [(40 * np.cos(k), 40 * np.sin(k)) for k in range(200)]  # half in the light
    flee = "behaviour flee(target: place) -> push { direction(target, to: self) }\n"
    history = play(f"{flee}species a {{ {text} }}", crowd(at=[(24, 0), (90, 0), *ring]), steps=3,
                items={"food": (item("f", 0, 0),)})  # fmt: skip
    assert history.states(0)[-1] == "gone" and history.states(1)[-1] == "calm"
    speeds = [history.at("velocity.x", 1)[k] for k in (0, 1)]  # a kinematic push of 1 is twice the full speed
    assert speeds == pytest.approx([0.9 * 0.25 * 20, 0], abs=1e-4)
    fled_count = history["main.state"][2:].count(1)
    assert fled_count == pytest.approx(200 * (1 - np.exp(-2 * 0.5 * 0.3)), abs=25)
