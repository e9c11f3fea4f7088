"""Every example comes to the states that are recorded for it: a change that claims to change nothing is held to that."""

from __future__ import annotations

import pytest
from state_hashes import RECORDED_FEET, SCENES, difference, feet_of, frames_of, named, recorded

# One of each program, of few agents: the others take minutes to place.
SOON = ("alarm/scene", "flocking/scene", "flow/scene", "minimal/scene", "moods/scene", "thesis/tunnel_and_can", "worth/scene")


def test_every_example_is_recorded() -> None:
    assert set(recorded()) == {named(scene) for scene in SCENES}


@pytest.mark.parametrize("scene", [scene for scene in SCENES if named(scene) in SOON], ids=named)
def test_first_frames_are_as_recorded(scene) -> None:
    assert difference(scene, 4) is None


@pytest.mark.parametrize(
    "scene", [scene for scene in SCENES if named(scene) in ("flow/scene", "thesis/tunnel_and_can")], ids=named
)
def test_feet_are_as_recorded(scene) -> None:
    assert feet_of(scene) == recorded(RECORDED_FEET)[named(scene)]


@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES, ids=named)
def test_feet_of_every_example_are_as_recorded(scene) -> None:
    assert feet_of(scene) == recorded(RECORDED_FEET).get(named(scene), {})


@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES, ids=named)
def test_whole_shots_are_as_recorded(scene) -> None:
    assert difference(scene) is None


def test_another_seed_is_noticed() -> None:
    scene = next(scene for scene in SCENES if named(scene) == "minimal/scene")
    hashes = dict(frames_of(scene, 2, None))
    assert hashes[1] == recorded()["minimal/scene"][1] and len(set(hashes.values())) == 3
