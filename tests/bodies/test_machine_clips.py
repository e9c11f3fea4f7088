"""What machines play: a wave of the arms over a walk, weights, clips that give way to others and to none. Computed by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rigs import definition, matrix, still, turn

from antdsl.bodies.agents.blending import OVERRIDE_BLEND_MODE, blend_poses
from antdsl.bodies.agents.definition import TransformGroup
from antdsl.bodies.agents.machine_clips import MachineClips, PlayedClip, build_machine_playback
from antdsl.bodies.agents.poses import build_clip_table
from antdsl.numerics.records import select_record_rows

# A trunk, an arm and a leg beside each other; clips put them at heights: rest 0, low 1, high 3.
JOINTS = {"trunk": "", "arm": "", "leg": ""}
LOW, HIGH = (still(name, {j: {"t": (0, y, 0)} for j in JOINTS}) for name, y in (("low", 1), ("high", 3)))
BODY = replace(
    definition(JOINTS, LOW, HIGH),
    groups={"arms": TransformGroup("arms", (("arm", 1.0),)), "half": TransformGroup("half", (("arm", 0.5), ("leg", 1.0)))},
)
CLIPS = (("low", ""), ("high", ""), ("high", "arms"), ("high", "half"), ("gone", ""))


def machine(
    clip: int, weight: float = 1.0, previous_clip: int = -1, previous_weight: float = 1.0, fade: float = 0.0
) -> MachineClips:
    numbers = np.array([clip], np.int16), np.array([previous_clip], np.int16)
    floats = [np.array([x], np.float32) for x in (0.0, weight, 0.0, previous_weight, fade)]
    return MachineClips(numbers[0], floats[0], floats[1], numbers[1], floats[2], floats[3], floats[4])


def heights(*machines: MachineClips) -> list[float]:
    """Of trunk, arm and leg."""
    table = build_clip_table(BODY)
    matrices = blend_poses(table, BODY.groups, build_machine_playback(table, CLIPS, machines, 1)).world_transforms
    return [float(y) for y in matrices[0, :, 1, 3]]


@pytest.mark.parametrize(
    "machines, expected",
    [
        ([], [0, 0, 0]),
        ([machine(-1)], [0, 0, 0]),
        ([machine(4)], [0, 0, 0]),  # a clip that the body does not have
        ([machine(0)], [1, 1, 1]),
        ([machine(0, weight=0.25)], [0.25, 0.25, 0.25]),  # over the rest pose
        ([machine(0), machine(2)], [1, 3, 1]),
        ([machine(0), machine(2, weight=0.5)], [1, 2, 1]),
        ([machine(0), machine(3)], [1, 2, 3]),  # a joint that is half in the group
        ([machine(2), machine(0)], [1, 1, 1]),  # the later one lies over
        ([machine(0), machine(-1)], [1, 1, 1]),
        ([machine(1, previous_clip=0, fade=0.25)], [2.5, 2.5, 2.5]),
        ([machine(0), machine(-1, previous_clip=2, fade=0.5)], [1, 2, 1]),  # gives way to none, and shows what is below
        ([machine(0), machine(2, fade=0.5)], [1, 2, 1]),  # comes from none
        ([machine(0), machine(2, previous_clip=1, fade=0.5)], [2, 3, 2]),  # whole before, the arms now
        ([machine(1, weight=0.5, previous_clip=0, previous_weight=1, fade=0.5)], [(0.5 * 1 + 0.25 * 3)] * 3),
        ([machine(0), machine(2), machine(2)], [1, 3, 1]),
    ],
)  # fmt: skip
def test_machines_lie_over_each_other(machines: list[MachineClips], expected: list[float]) -> None:
    assert heights(*machines) == pytest.approx(expected, abs=1e-5)


def test_rotations_go_over_by_the_shorter_way() -> None:
    clips = [still(name, {"trunk": {"r": [-x for x in turn("z", a)]}}) for name, a in (("a", 0), ("b", 90))]
    body = definition({"trunk": ""}, *clips)
    table = build_clip_table(body)
    matrices = blend_poses(
        table, {}, build_machine_playback(table, (("a", ""), ("b", "")), [machine(0), machine(1, weight=0.5)], 1)
    ).world_transforms[0, 0]
    assert matrices[:, :3] == pytest.approx(matrix(rotation=turn("z", 45))[:3, :3], abs=1e-6)


def test_turns_are_times_and_who_else_is_there_changes_nothing() -> None:
    walk = replace(LOW, name="walk", rate=2.0, translation=np.array([[[0, 0, 0]] * 3, [[0, 1, 0]] * 3], np.float32),
                   rotation=np.tile(LOW.rotation, (2, 1, 1)), scale=np.tile(LOW.scale, (2, 1, 1)))  # fmt: skip
    body = replace(definition(JOINTS, walk, replace(walk, name="once", loop=False)), groups=BODY.groups)
    table = build_clip_table(body)
    clips = (("walk", ""), ("once", ""), ("walk", "arms"))
    clip, turns = np.array([0, 0, 1, 1, 2], np.int16), np.array([0.25, 7.25, 0.5, 1.0, 0.75], np.float32)
    ones, zeros, none = np.ones(5, np.float32), np.zeros(5, np.float32), np.full(5, -1, np.int16)
    all_rows = MachineClips(clip, turns, ones, none, zeros, ones, zeros)
    playing = build_machine_playback(table, clips, [all_rows], 5)
    assert all(tree.modes[0] == OVERRIDE_BLEND_MODE for tree in playing.trees) and len(playing.trees) == 2
    together = blend_poses(table, body.groups, playing).world_transforms
    assert together[:, 1, 1, 3] == pytest.approx([0.25, 0.25, 0.5, 1.0, 0.75]) and together[4, 0, 1, 3] == 0
    for k in range(5):
        alone = blend_poses(
            table, body.groups, build_machine_playback(table, clips, [select_record_rows(all_rows, np.array([k]))], 1)
        ).world_transforms
        assert np.array_equal(alone[0], together[k])


@pytest.mark.parametrize(
    "clips, expected",
    [
        ((PlayedClip("low"), PlayedClip("high", add=True)), [4, 4, 4]),  # 1, and 3 more than at rest
        ((PlayedClip("low"), PlayedClip("high", "arms", add=True)), [1, 4, 1]),
        ((PlayedClip("high", add=True), PlayedClip("low")), [4, 4, 4]),  # what is added lies over all machines
        ((PlayedClip("high", "half", add=True), PlayedClip("low")), [1, 2.5, 4]),
        ((PlayedClip("high", add=True), PlayedClip("low", add=True)), [4, 4, 4]),
    ],
)
def test_what_is_added_lies_over_all_others(clips: tuple[PlayedClip, ...], expected: list[float]) -> None:
    table = build_clip_table(BODY)
    matrices = blend_poses(table, BODY.groups, build_machine_playback(table, clips, [machine(0), machine(1)], 1)).world_transforms
    assert [float(y) for y in matrices[0, :, 1, 3]] == pytest.approx(expected, abs=1e-5)


def test_what_is_added_fades_and_gives_way_to_what_is_not() -> None:
    table, clips = build_clip_table(BODY), (PlayedClip("low"), PlayedClip("high", add=True))
    for fade in (0.0, 0.25, 1.0):
        machines = [machine(0), machine(-1, previous_clip=1, fade=fade)]
        matrices = blend_poses(table, BODY.groups, build_machine_playback(table, clips, machines, 1)).world_transforms
        assert float(matrices[0, 0, 1, 3]) == pytest.approx(1 + 3 * fade, abs=1e-5)
    # over: half of what is added, and half of a walk that lies over the rest
    matrices = blend_poses(
        table, BODY.groups, build_machine_playback(table, clips, [machine(0, previous_clip=1, fade=0.5)], 1)
    ).world_transforms
    assert float(matrices[0, 0, 1, 3]) == pytest.approx(0.5 + 1.5, abs=1e-5)


@pytest.mark.parametrize(
    "lean, height",
    [
        ((0, 0), 1),
        ((1, 0), 3),
        ((0.5, 0), 2),
        ((-1, 0), 0),
        ((-0.5, 0), 0.5),
        ((0, 0.5), 2),
        ((1, 1), 3),
        ((0.5, -1), 2),
        ((9, 0), 3),
    ],
)
def test_clips_give_way_as_an_agent_turns_and_climbs(lean: tuple[float, float], height: float) -> None:
    zero = still("zero", {j: {"t": (0, 0, 0)} for j in JOINTS})
    body = replace(definition(JOINTS, LOW, HIGH, zero), groups=BODY.groups)
    table, clips = (
        build_clip_table(body),
        (PlayedClip("low", left_turn_clip="high", right_turn_clip="zero", climbing_clip="high"),),
    )
    leans = np.array([lean], np.float32)
    matrices = blend_poses(table, body.groups, build_machine_playback(table, clips, [machine(0)], 1, leans)).world_transforms
    assert float(matrices[0, 0, 1, 3]) == pytest.approx(height, abs=1e-5)
    pair = build_machine_playback(
        table, clips, [select_record_rows(machine(0), np.array([0, 0]))], 2, np.array([lean, (0, 0)], np.float32)
    )
    assert [float(y) for y in blend_poses(table, body.groups, pair).world_transforms[:, 0, 1, 3]] == pytest.approx(
        [height, 1], abs=1e-5
    )
