"""Selectors: what their texts and mappings mean, which agents they select, and what is reported about wrong ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from antdsl.scene.crowds.line_ids import CrowdLineIds
from antdsl.scene.notes.selection import SelectableAgents, SelectableFrame, StateColumn, select_ids
from antdsl.scene.notes.selectors import (
    AgentConditions,
    AgentName,
    Selector,
    SelectorKeys,
    SelectorNames,
    View,
    combine_selector,
    find_selector_problems,
)

ADAPTER: TypeAdapter[Any] = TypeAdapter(Selector)


def read(value: object) -> Any:
    return ADAPTER.validate_python(value)


class CameraAtZero:
    """A camera that sees the first 35 mm."""

    def find_position(self) -> np.ndarray:
        return np.zeros(3)

    def find_visible(self, position: np.ndarray, view: View) -> np.ndarray:
        return (position[:, 0] < 35 * view.across[1]) & (position[:, 0] >= 35 * view.across[0])


def frame(**changes: Any) -> SelectableFrame:
    """Forty ants on a line, one every 10 mm, and three beetles. Guards have two ranges of ids: 5 to 9 and 30 to 34."""
    ids = np.random.default_rng(3).permutation(40)  # rows are in no order
    ants = SelectableAgents(
        ids,
        np.stack([ids * 10.0, ids * 0.0, ids * 0.0], axis=1),
        {"main": StateColumn(ids % 2, ("rest", "walk")), "mood": StateColumn(ids // 20, ("calm", "angry"))},
    )
    beetles = SelectableAgents(np.arange(3), np.array([[0.0, 50, 0], [100, 50, 0], [200, 50, 0]]))
    values: dict[str, Any] = dict(
        agents={"ant": ants, "beetle": beetles},
        lines={"guards": CrowdLineIds("ant", ((5, 5), (30, 5))), "armour": CrowdLineIds("beetle", ((0, 3),))},
        item_points={"leaf": np.array([[100.0, 0, 0]]), "food": np.array([[100.0, 0, 0], [300.0, 0, 0]])},
        seed=7,
        cameras={"shot": CameraAtZero()},
    )
    return SelectableFrame(**{**values, **changes})


@pytest.mark.parametrize(
    ("value", "ants", "beetles"),
    [
        ("guards", [5, 6, 7, 8, 9, 30, 31, 32, 33, 34], []),
        ("guards.0", [5], []),
        ("guards.7", [32], []),
        ("guards.3..6", [8, 9, 30, 31], []),
        ("ant.3", [3], []),
        ("ant.38..90", [38, 39], []),
        ("beetle", [], [0, 1, 2]),
        (["guards.0", "beetle.1", "guards.0"], [5], [1]),
        ({"of": "guards", "state": "rest"}, [6, 8, 30, 32, 34], []),
        ({"of": "ant", "state": "mood.angry", "without": "ant.21..39"}, [20], []),
        ({"near": "leaf", "within": "20 mm"}, [8, 9, 10, 11, 12], []),
        ({"near": "leaf", "within": "50"}, list(range(5, 16)), [1]),
        ({"near": "leaf", "most": "3"}, [9, 10, 11], []),
        ({"near": "leaf", "within": "12 mm", "most": "9"}, [9, 10, 11], []),
        ({"near": "guards.0", "most": "2"}, [4, 6], []),
        ({"of": "beetle", "near": "leaf", "most": "1"}, [], [1]),
        ({"of": "ant", "near": "food", "within": "10 mm"}, [9, 10, 11, 29, 30, 31], []),
        ({"near": ["1 cm", "0", "0"], "within": "10 mm"}, [0, 1, 2], []),
        ({"near": "guards.0", "within": "10 mm"}, [4, 6], []),
        ({"near": "guards.0..1", "within": "10 mm"}, [4, 7], []),
        ({"in": {"from": ["25", "9", "-1"], "to": ["-5", "-9", "1"]}}, [0, 1, 2], []),
        ({"in": {"around": "leaf", "radius": "60 mm"}, "without": "ant"}, [], [1]),
        ({"of": ["guards", "ant.0"], "in_view": "shot"}, [0], []),
        ({"of": "ant", "in_view": "shot", "across": ["50 %", "100 %"]}, [2, 3], []),
        ({"of": "ant", "in": {"in_view": "shot", "across": ["0 %", "50 %"]}}, [0, 1], []),
        ({"of": ["guards", "ant.0..2"], "near": "shot", "within": "15 mm"}, [0, 1], []),
        ({"of": {"of": "guards", "state": "rest"}, "without": {"state": "calm"}}, [30, 32, 34], []),
        ({"of": "ant", "share": "0 %"}, [], []),
        ({"share": "100 %"}, list(range(40)), [0, 1, 2]),
    ],
)
def test_what_is_selected(value: object, ants: list[int], beetles: list[int]) -> None:
    selected = select_ids(read(value), frame())
    assert [selected.get(name, np.empty(0)).tolist() for name in ("ant", "beetle")] == [ants, beetles]


def test_a_share_depends_on_seed_species_and_id_alone() -> None:
    complete = frame()
    half = select_ids(read({"of": "ant", "share": "50 %"}), complete)["ant"]
    assert 8 < len(half) < 32
    assert set(select_ids(read({"of": "ant", "share": "20 %"}), complete)["ant"]) < set(half)
    assert (select_ids(read({"of": "ant", "share": "50 %", "seed": "7"}), complete)["ant"] == half).all()
    assert set(select_ids(read({"of": "ant", "share": "50 %", "seed": "8"}), complete)["ant"]) != set(half)
    alone = frame(agents={"ant": SelectableAgents(half, np.zeros((len(half), 3)))})  # of others, none is left
    assert (select_ids(read({"share": "50 %"}), alone)["ant"] == half).all()
    many = SelectableAgents(np.arange(100_000), np.zeros((100_000, 3)))
    count = len(select_ids(read({"share": "30 %"}), frame(agents={"ant": many}))["ant"])
    assert abs(count - 30_000) < 600


def test_no_agents() -> None:
    empty = SelectableFrame({"ant": SelectableAgents(np.empty(0, np.int64), np.empty((0, 3)))})
    for value in ("ant", "ant.3", {"near": ["0", "0", "0"], "within": "1 mm"}, {"share": "50 %"}, ["ant", "ant.2"]):
        assert select_ids(read(value), empty) == {}


def test_keys_of_a_line_narrow_its_agents() -> None:
    keys = SelectorKeys.model_validate({"share": "30 %", "seed": "4"})
    assert combine_selector(AgentName("guards"), SelectorKeys()) == AgentName("guards")
    combined = combine_selector(AgentName("guards"), keys)
    assert isinstance(combined, AgentConditions)
    assert combined == AgentConditions.model_validate({"of": "guards", "share": "30 %", "seed": "4"})


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("all(ant, most: 2)", "write a mapping: `{of: ant"),
        ("guards.", "names no agents"),
        ("guards.-1", "names no agents"),
        ("guards.9..3", "write `guards.3..9`"),
        ([], "too_short"),
        ({"near": "leaf"}, "add `within: 50 mm`, or `most: 3`"),
        ({"most": "3"}, "add `near: [0, 0, 0]`"),
        ({"within": "3 mm"}, "add `near: [0, 0, 0]`"),
        ({"seed": "3"}, "add `share: 30 %`"),
        ({"share": "130 %"}, "write a share from `0 %` to `100 %`"),
        ({"share": "3 mm"}, "is not a share"),
        ({"wihtin": "3 mm"}, "extra_forbidden"),
        ({"in": {"from": ["0", "0", "0"]}}, "missing"),
    ],
)
def test_wrong_forms(value: object, words: str) -> None:
    with pytest.raises(ValidationError) as problem:
        read(value)
    assert words in " ".join(str((each["type"], each.get("ctx"))) for each in problem.value.errors())


NAMES = SelectorNames(
    {"guards": 10}, frozenset({"ant"}), frozenset({"leaf"}), frozenset({"rest", "main.rest"}), frozenset({"shot"})
)


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ("gaurds", [((), "no crowd line or species is named `gaurds`", "did you mean `guards`?")]),
        ("guards.10", [((), "`guards.10` does not exist: `guards` has 10 agents", "write a number from 0 to 9")]),
        ("ant.99999", []),
        (["guards", "ants"], [((1,), "no crowd line or species is named `ants`", "did you mean `ant`?")]),
        (
            {"of": "guards", "state": "ret", "near": "lef", "within": "1", "in_view": "shto", "without": {"state": "rst"}},
            [
                (("without", "state"), "no species has a state `rst`", "did you mean `rest`?"),
                (("near",), "no crowd line, species, item or camera is named `lef`", "did you mean `leaf`?"),
                (("state",), "no species has a state `ret`", "did you mean `rest`?"),
                (("in_view",), "no camera is named `shto`", "did you mean `shot`?"),
            ],
        ),
        ({"in": {"around": "laef", "radius": "1"}}, [(("in", "around"), "no item is named `laef`", "did you mean `leaf`?")]),
        ({"near": "guards.3", "within": "1"}, []),
    ],
)
def test_unknown_names(value: object, expected: list[tuple[tuple[object, ...], str, str]]) -> None:
    assert [tuple(each) for each in find_selector_problems(read(value), NAMES)] == expected


def test_ids_of_a_line() -> None:
    line = CrowdLineIds("ant").resize(5, 10)
    assert line.ranges == ((10, 5),) and line.resize(8, 15).ranges == ((10, 8),)
    grown = line.resize(3, 99).resize(6, 40)
    assert grown.ranges == ((10, 3), (40, 3)) and len(grown) == 6
    assert (
        grown.list_ids_between(2, 4).tolist() == [12, 40, 41]
        and grown.list_ids_between(5).tolist() == [42]
        and grown.list_ids_between(6).tolist() == []
    )
    assert grown.find_positions_in_line(np.array([42, 12, 13, 0])).tolist() == [5, 2, -1, -1]
    assert CrowdLineIds("ant").list_ids_between().tolist() == [] and CrowdLineIds("ant").resize(0, 5) == CrowdLineIds("ant")
