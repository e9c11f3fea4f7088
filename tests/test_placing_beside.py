"""A crowd that is to begin where there is no surface is warned of."""

from __future__ import annotations

from pathlib import Path

import pytest
from test_scene_files import SCENE, folder, opened  # noqa: F401

PLACE = "{on: ground, around: apple, radius: 20 mm}"


@pytest.mark.parametrize(
    ("place", "beside"),
    [
        (PLACE, False),
        ("{around: [900, 0, 0], radius: 20 mm}", True),
        ("{on: ground, around: [0, 0, -900], radius: 20 mm}", True),
        ("{around: [900, 0, 0], radius: 900 mm}", False),
        ("{around: [0, 900, 0], radius: 20 mm}", False),  # it is dropped
        ("{around: [900, 0, 0], radius: 20 cm}", True),
        ("{on: ground}", False),
    ],
)
def test_a_disc_beside_all_surfaces(folder: Path, place: str, beside: bool) -> None:  # noqa: F811
    assert PLACE in SCENE
    shot, report = opened(folder, SCENE.replace(PLACE, place))
    assert shot is not None
    told = [(d.severity, d.span.text if d.span else "") for d in report.diagnostics if d.code == "off-surface"]
    assert told == ([("warning", place)] if beside else [])


def test_nobody_is_told_of_a_crowd_of_none(folder: Path) -> None:  # noqa: F811
    text = SCENE.replace(PLACE, "{around: [900, 0, 0], radius: 20 mm}").replace("count: 5", "count: 0")
    _, report = opened(folder, text)
    assert "off-surface" not in {d.code for d in report.diagnostics}
