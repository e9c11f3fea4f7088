"""The page poses bodies as pictures do: the same clips, blended in the same way, to a thousandth of a body."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from browsing import chromium
from numpy.typing import NDArray
from page_messages import WALK, scene, status, texts
from page_stage import Stage, stage
from PIL import Image
from sampling import sampled

from antdsl.bodies.agents.blending import ClipPlayback, blend_poses
from antdsl.bodies.agents.definition import (
    STATE_MATERIAL,
    Binding,
    BlendTargets,
    Channel,
    Clip,
    Definition,
    InBetweens,
    Layer,
    Leg,
    Rig,
    SkinShape,
    SkinWeights,
    TransformGroup,
    Variation,
)
from antdsl.bodies.agents.driving import PoseAdjustments, rotate_joints_to_look_directions
from antdsl.bodies.agents.leg_ik import LegIkSolver, PlacedFeet
from antdsl.bodies.agents.machine_clips import EARLIER_CLIP_FIELDS, MachineClips, PlayedClip, build_machine_playback
from antdsl.bodies.agents.poses import ClipTable, build_clip_table
from antdsl.bodies.agents.transforms import compute_world_matrices
from antdsl.bodies.agents.varied_bodies import VariationDraws, draw_colour_path_positions, draw_group_scale
from antdsl.bodies.body import build_orientations
from antdsl.bodies.posed_body import PosedBody
from antdsl.bodies.skinned_mesh import compute_blend_targets
from antdsl.outputs.pictures.light import encode_srgb_values
from antdsl.preview.binary_packets import pack_arrays
from antdsl.preview.viewing.action_arrays import compute_blend_weights, make_stance_arrays, pack_clips
from antdsl.preview.viewing.body_packets import BodyOutfit, find_depth_order, find_traits, make_rig_packet
from antdsl.runtime.feet.feet_state import FeetState
from antdsl.runtime.feet.trunk import compute_slope_quaternions

if TYPE_CHECKING:
    from playwright.sync_api import Browser

PLAYS = (
    PlayedClip("sway", left_turn_clip="nod", climbing_clip="reach"), PlayedClip("nod"), PlayedClip("reach", "arms"),
    PlayedClip("gone"),
    PlayedClip("nod", "arms", add=True),
)  # fmt: skip
CAMERA = {"at": [50, 40, 120], "look_at": [50, 0, 50], "focal": 35}
CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
SIDES = np.array(
    [
        [0, 1, 3],
        [0, 3, 2],
        [4, 6, 7],
        [4, 7, 5],
        [0, 4, 5],
        [0, 5, 1],
        [2, 3, 7],
        [2, 7, 6],
        [0, 2, 6],
        [0, 6, 4],
        [1, 5, 7],
        [1, 7, 3],
    ],
    np.int32,
)


def clip(name: str, samples: int, seed: int, joints: tuple[str, ...], loop: bool) -> Clip:
    random = np.random.default_rng(seed)
    turns = random.normal((0, 0, 0, 2), size=(samples, len(joints), 4))
    turns /= np.linalg.norm(turns, axis=2, keepdims=True)
    moves, scales, shears = (random.normal(mean, 0.2, (samples, len(joints), 3)).astype(np.float32) for mean in (0.5, 1, 0))
    tracks = [moves, turns.astype(np.float32), scales, shears]
    if loop:
        tracks = [np.concatenate([part[:-1], part[:1]]) for part in tracks]
    return Clip(name, 24.0, joints, tracks[0], tracks[1], tracks[2], tracks[3], loop=loop)


def crane(size: float = 1.0) -> Definition:
    """A body of eight joints that stand in no order of depth, each with a box, in a space that is not that of agents."""
    random = np.random.default_rng(5)
    names = tuple(f"j{k}" for k in range(8))
    parents = np.array([-1, 0, 1, 0, 3, 4, 2, 5], np.int32)
    rest = np.tile(np.eye(4), (8, 1, 1))
    rest[:, :3, 3] = random.normal(size=(8, 3))
    box = SkinShape("box", CUBE * np.float32(0.2 * size), SIDES)
    clips = (clip("sway", 9, 1, names, True), clip("nod", 6, 2, names[2:], False), clip("reach", 5, 3, names, True))
    return Definition(
        "crane", Rig(names, parents, rest), {"box": box}, {"body": Layer("body", tuple(Binding(name, "box") for name in names))},
        {each.name: each for each in clips}, {"arms": TransformGroup("arms", (("j4", 1.0), ("j5", 0.5), ("j7", 0.25)))},
        front=(0.0, 0.0, 1.0), up=(0.0, 1.0, 0.0), length=2.5,
    )  # fmt: skip


def machines(count: int, seed: int = 7) -> tuple[MachineClips, MachineClips]:
    """Agents of which each has other clips, in the middle of changes; some play nothing."""
    random = np.random.default_rng(seed)
    machine_clips = []
    for _ in range(2):
        clips = random.integers(-1, len(PLAYS), (2, count)).astype(np.int16)
        turns = random.uniform(-2, 3, (2, count)).astype(np.float32)
        weights = random.uniform(size=(2, count)).astype(np.float32)
        fade = random.choice([0.0, 0.3, 0.8], count).astype(np.float32)
        machine_clips.append(MachineClips(clips[0], turns[0], weights[0], clips[1], turns[1], weights[1], fade))
    earlier = random.integers(-1, len(PLAYS), count).astype(np.int16), *random.uniform(size=(3, count)).astype(np.float32)
    return replace(machine_clips[0], **dict(zip(EARLIER_CLIP_FIELDS, earlier, strict=True))), machine_clips[1]


def leans(count: int) -> NDArray[np.int8]:
    """How much agents turn and climb, in three bytes."""
    return (np.random.default_rng(6).uniform(-127, 127, (count, 3)) * (1, 1, 0)).astype(np.int8)


def frame(plays: tuple[MachineClips, ...], number: int = 20, extra_arrays: Mapping[str, NDArray[Any]] | None = None) -> bytes:
    count = len(plays[0].clip)
    loops = np.array([True, False, True, False, False, False])
    side = np.arange(count, dtype=np.float32)
    arrays: dict[str, NDArray[Any]] = {
        "ant/id": np.arange(10, 10 + count, dtype=np.int32),
        "ant/position": np.stack([20 + 6 * (side % 9), 0 * side, 20 + 6 * (side // 9)], axis=1),
        "ant/heading": np.tile(np.array([127, 0, 0], np.int8), (count, 1)),
        "ant/up": np.tile(np.array([0, 127, 0], np.int8), (count, 1)),
        "ant/size": np.full(count, 4, np.float32),
        "ant/speed": np.zeros(count, np.float32), "ant/born": np.zeros(count, np.int32),
        "ant/state/main": np.zeros(count, np.uint8),
    }  # fmt: skip
    arrays |= {f"ant/plays/{name}": pack_clips(each, loops) for name, each in zip(("main", "arms"), plays, strict=True)}
    arrays |= {f"ant/{name}": array for name, array in {"lean": leans(count), **(extra_arrays or {})}.items()}
    return pack_arrays("frame", arrays, frame=number, light=False, felt=[])


def rig(body: Definition) -> bytes:
    return make_rig_packet("ant", BodyOutfit(body, PLAYS, blends_lean=True), ("main", "arms"))


def expected_bones(body: Definition, plays: tuple[MachineClips, ...], level: PosedBody) -> NDArray[np.float64]:
    """The matrices [n, B, 3, 4] of the bones of a mesh, by what antdsl itself makes of what is played."""
    table = build_clip_table(body)
    return in_bones(body, level, blend_poses(table, body.groups, playing(table, plays)).world_transforms)


def playing(table: ClipTable, plays: tuple[MachineClips, ...]) -> ClipPlayback:
    count = len(plays[0].clip)
    return build_machine_playback(table, PLAYS, plays, count, leans(count)[:, :2].astype(np.float32) / 127)


def in_bones(body: Definition, level: PosedBody, world: NDArray[np.float32]) -> NDArray[np.float64]:
    square = np.tile(np.eye(4), (len(world), len(level.mesh.bone_joints), 1, 1))
    square[:, :, :3] = world[:, level.mesh.bone_joints]
    inverse = np.tile(np.eye(4), (len(level.mesh.bone_joints), 1, 1))
    inverse[:, :3] = level.mesh.inverse_matrices
    return np.asarray((body.compute_base_matrix()[None, None] @ square @ inverse[None])[:, :, :3])


def legged() -> Definition:
    """The same with two legs, one of which has a joint below its foot; a clip leaves them free."""
    body = crane()
    clips = {**body.clips, "reach": replace(body.clips["reach"], feet=False)}
    return replace(body, legs=(Leg("left", "j3", "j4", "j5"), Leg("right", "j1", "j2", "j6")), clips=clips)


def with_ankles() -> Definition:
    """The same with flat soles: one leg has a joint between ankle and foot, the ankle of the other is its foot."""
    body = legged()
    return replace(body, legs=(Leg("left", "j3", "j4", "j7", "j5"), Leg("right", "j1", "j2", "j6", "j6")))


def standing(count: int) -> tuple[FeetState, dict[str, NDArray[Any]]]:
    """Feet here and there around agents that look anywhere, on sloping ground."""
    random = np.random.default_rng(9)
    position = random.uniform(0, 60, (count, 3)).astype(np.float32)
    heading, up = (
        np.rint(127 * random.normal(mean, 0.3, (count, 3))).clip(-127, 127).astype(np.int8) for mean in ((1, 0, 0), (0, 1, 0))
    )
    light = {"id": np.arange(10, 10 + count), "position": position, "heading": heading, "up": up, "size": np.full(count, 4, "f4")}
    feet = FeetState.make_empty(2)
    feet.shown = position.T[:, :, None] + random.normal(0, 2.5, (3, count, 2))
    feet.swing = np.where(random.random((count, 2)) < 0.6, np.float32(-1), np.float32(0.5))
    feet.rise, feet.slope = random.normal(0, 0.3, count).astype(np.float32), random.normal(0, 0.3, (2, count)).astype(np.float32)
    feet.phase = np.zeros(count, np.float32)
    return feet, light


def bones(page: Stage, agent: int) -> NDArray[np.float64]:
    page.drawn()
    return np.array(page.page.evaluate("(id) => window.antdsl.bones('ant', id)", agent)).reshape(-1, 3, 4)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as chromium_browser:
        yield chromium_browser


@pytest.fixture
def page(browser: Browser) -> Iterator[Stage]:
    with stage(browser) as opened:
        yield opened


@pytest.mark.parametrize("near", sampled([False, True], [True]))
def test_bones_are_where_antdsl_puts_them(page: Stage, near: bool) -> None:
    body, plays = crane(), machines(60)
    page.tell(scene(camera=CAMERA), texts(), status(), rig(body), frame(plays))
    if near:
        page.page.locator("#view > canvas").press("n")
        page.page.locator("#view > canvas").press("g")
    page.page.wait_for_timeout(300)
    level = PosedBody(body, PLAYS)
    expected = expected_bones(body, plays, level)
    assert len(level.coarse_body.mesh.bone_joints) == len(level.mesh.bone_joints) == 8
    for row in (0,) if near else range(60):
        assert np.abs(bones(page, 10 + row) - expected[row]).max() < 1e-3, row


@pytest.mark.parametrize("make_body", sampled([legged, with_ankles], [legged]))
def test_legs_are_bent_as_antdsl_bends_them(page: Stage, make_body: Callable[[], Definition]) -> None:
    body, plays, count = make_body(), machines(40), 40
    feet, light = standing(count)
    legs, level, table = LegIkSolver(body), PosedBody(body, PLAYS), build_clip_table(body)
    stands = legs.compute_stance_weights(PLAYS, plays, count)
    assert 0 < stands.min() < 0.9 and stands.max() == 1
    normals = np.random.default_rng(3).normal((0, 2, 0), 1, (count, 2, 3)).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    placed = PlacedFeet(
        feet.shown.transpose(1, 2, 0),
        feet.is_standing.astype(np.uint8),
        feet.phase,
        feet.rise,
        compute_slope_quaternions(feet.slope),
        normals if legs.has_flat_soles else None,
    )
    turned = build_orientations(light["heading"].astype(np.float64), light["up"].astype(np.float64))
    beside = placed.convert_to_body_space(light["position"], turned, light["size"]).scale_trunk_motion(stands)
    poses = blend_poses(table, body.groups, playing(table, plays))
    expected = in_bones(body, level, legs.bend_legs(poses, beside, stands).world_transforms)
    assert np.abs(expected - expected_bones(body, plays, level)).max() > 0.3, "legs and trunks are moved"
    page.tell(
        scene(camera=CAMERA),
        texts(),
        status(),
        rig(body),
        frame(plays, extra_arrays=make_stance_arrays(legs, placed, light, stands)),
    )
    page.page.wait_for_timeout(300)
    for row in range(count):
        assert np.abs(bones(page, 10 + row) - expected[row]).max() < 2e-3, row


def test_parts_look_where_antdsl_has_them_look(page: Stage) -> None:
    body, plays, count = crane(), machines(30), 30
    looks = np.random.default_rng(4).normal((0.5, 0, 0), 1, (count, 3))
    looks = np.rint(127 * looks / np.linalg.norm(looks, axis=1, keepdims=True)).astype(np.int8)
    level, table = PosedBody(body, PLAYS), build_clip_table(body)
    poses = blend_poses(table, body.groups, playing(table, plays))
    directions = looks.astype(np.float32) / np.linalg.norm(looks, axis=1, keepdims=True).astype(np.float32)
    turned = rotate_joints_to_look_directions(table, poses, {"arms": directions}, body.groups, body.compute_base_matrix()[:3, :3])
    expected = in_bones(body, level, turned.world_transforms)
    assert np.abs(expected - expected_bones(body, plays, level)).max() > 0.3
    message = make_rig_packet("ant", BodyOutfit(body, PLAYS, (), ("arms",), True), ("main", "arms"))
    page.tell(scene(camera=CAMERA), texts(), status(), message, frame(plays, extra_arrays={"look/arms": looks}))
    page.page.wait_for_timeout(300)
    for row in range(count):
        assert np.abs(bones(page, 10 + row) - expected[row]).max() < 1e-3, row


def test_joints_have_the_offsets_of_edits_as_antdsl_has_them(page: Stage) -> None:
    body, plays, count, random = crane(), machines(12), 12, np.random.default_rng(8)
    body = replace(body, variation=Variation({"arms": (0.6, 1.8)}))
    looks = random.normal((0.5, 0, 0), 1, (count, 3))
    looks = np.rint(127 * looks / np.linalg.norm(looks, axis=1, keepdims=True)).astype(np.int8)
    directions = looks.astype(np.float32) / np.linalg.norm(looks, axis=1, keepdims=True).astype(np.float32)
    offsets = {}
    for joint in ("j3", "j5"):
        turns = random.normal(size=(count, 4))
        turns /= np.linalg.norm(turns, axis=1, keepdims=True)
        offsets[joint] = np.concatenate([random.normal(0, 0.2, (count, 3)), turns], axis=1).astype(np.float32)
    lean = leans(count)[:, :2].astype(np.float32) / 127
    driven = PoseAdjustments({}, {"arms": directions}, VariationDraws(np.arange(10, 10 + count), 3, "ant"), lean, offsets)
    level = PosedBody(body, PLAYS)
    expected, plain = (
        in_bones(body, level, level.compute_poses(plays, count, driven_pose=each).world_transforms)
        for each in (driven, replace(driven, joint_offsets={}))
    )
    assert np.abs(expected - plain).max() > 0.3
    worn, order = BodyOutfit(body, PLAYS, (), ("arms",), True), find_depth_order(build_clip_table(body))
    other = trait_arrays(worn, plays, driven) | {"look/arms": looks}
    edited = {f"offset/{order[int(joint[1:])]}": offset for joint, offset in offsets.items()}
    page.tell(scene(camera=CAMERA), texts(), status(), make_rig_packet("ant", worn, ("main", "arms")))
    for number, extra_arrays, bones_of in ((20, edited, expected), (21, {}, plain), (22, edited, expected)):
        page.tell(frame(plays, number, other | extra_arrays))
        page.page.wait_for_timeout(600)
        for row in range(count):
            assert np.abs(bones(page, 10 + row) - bones_of[row]).max() < 1e-3, (number, row)


def test_agents_show_the_layers_that_they_wear(page: Stage) -> None:
    body, plays = crane(), machines(12)
    box = replace(body.shapes["box"], name="hat", points=body.shapes["box"].points * np.float32(6))
    hats = Layer("hat", (Binding("j0", "hat"),)), Layer("cap", (Binding("j7", "hat"),))
    body = replace(body, shapes={**body.shapes, "hat": box}, layers={**body.layers, "hat": hats[0], "cap": hats[1]})
    masks = PosedBody(body, PLAYS, ("hat", "cap")).layer_masks
    assert [int((masks == mask).sum()) for mask in (0, 1, 2)] == [64, 8, 8]
    message = make_rig_packet("ant", BodyOutfit(body, PLAYS, ("hat", "cap"), blends_lean=True), ("main", "arms"))
    page.tell(scene(camera=CAMERA), texts(), status(), message)
    show_states(page)

    def coloured(wears: int) -> int:
        page.tell(frame(plays, extra_arrays={"wears": np.full(12, wears, np.uint32)}))
        picture = take_screenshot(page)
        return int(((picture[..., 0] > 90) & (picture[..., 2] < 0.6 * picture[..., 0])).sum())

    none, hat, both = coloured(0), coloured(1), coloured(3)
    assert hat > 2 * none and both > 1.2 * hat
    assert coloured(0) == none


def trait_arrays(worn: BodyOutfit, plays: tuple[MachineClips, ...], driven: PoseAdjustments) -> dict[str, NDArray[np.float32]]:
    """What a frame tells of what bodies differ by."""
    assert driven.variation_draws is not None
    body_traits, differ = find_traits(worn), worn.definition.variation
    parts = [
        *compute_blend_weights(
            worn, body_traits, plays, len(driven.variation_draws.ids), driven.channels, leans(len(plays[0].clip))[:, :2] / 127
        ).T
    ]
    parts += [draw_group_scale(differ, name, driven.variation_draws) for name in body_traits.scales]
    parts += [draw_colour_path_positions(differ, name, driven.variation_draws) for name in body_traits.materials]
    padded_array = np.zeros((-(-len(parts) // 3) * 3, len(driven.variation_draws.ids)), np.float32)
    for k, part in enumerate(parts):
        padded_array[k] = part
    return {f"trait/{k}": padded_array[3 * k : 3 * k + 3].T for k in range(len(padded_array) // 3)}


def test_parts_are_as_large_as_antdsl_has_them_by_id(page: Stage) -> None:
    body, plays = crane(), machines(12)
    body = replace(body, variation=Variation({"arms": (0.6, 1.8)}))
    driven = PoseAdjustments(
        variation_draws=VariationDraws(np.arange(10, 22), 3, "ant"), lean=leans(12)[:, :2].astype(np.float32) / 127
    )
    level = PosedBody(body, PLAYS)
    expected = in_bones(body, level, level.compute_poses(plays, 12, driven_pose=driven).world_transforms)
    assert np.abs(expected - expected_bones(body, plays, level)).max() > 0.3
    worn = BodyOutfit(body, PLAYS, blends_lean=True)
    page.tell(scene(camera=CAMERA), texts(), status(), make_rig_packet("ant", worn, ("main", "arms")))
    page.tell(frame(plays, extra_arrays=trait_arrays(worn, plays, driven)))
    page.page.wait_for_timeout(300)
    for row in range(12):
        assert np.abs(bones(page, 10 + row) - expected[row]).max() < 1e-3, row


def blended() -> Definition:
    """The crane as one shape that follows its joints, with two blend shapes, one by way of another; clips turn one of them on."""
    body, random = crane(), np.random.default_rng(2)
    rest = compute_world_matrices(body.rig.parents, body.rig.rest_matrices)
    points = np.concatenate([CUBE * 0.3 + at[:3, 3].astype(np.float32) for at in rest]).astype(np.float32)
    faces = np.concatenate([SIDES + 8 * k for k in range(8)]).astype(np.int32)
    joints = np.repeat(np.arange(8), 8)[:, None].astype(np.int32)
    capture = SkinWeights(body.rig.names, joints, np.ones((64, 1), np.float32), np.linalg.inv(rest))

    def shape(name: str, spread: float, **fields: Any) -> SkinShape:
        return SkinShape(
            name, points + random.normal(0, spread, points.shape).astype(np.float32), faces, capture=capture, **fields
        )

    shapes = [
        shape("base", 0, blend=BlendTargets(("puffed", "torn"), ("puff", "tear"))),
        shape("puffed", 0.3), shape("torn", 0.3, in_betweens=InBetweens(("half",), (0.4,))), shape("half", 0.3),
    ]  # fmt: skip
    values = random.uniform(0, 1, (9, 1)).astype(np.float32)
    return replace(
        body, rig=replace(body.rig, channels=(Channel("puff"), Channel("tear", 0.1))),
        shapes={each.name: each for each in shapes},
        layers={"close": Layer("close", (), (Binding("", "base", deformer="blendshape+linearskinning"),)),
                "body": Layer("body", (), (Binding("", "base", deformer="blendshape+linearskinning"),))},
        clips={**body.clips, "sway": replace(body.clips["sway"], channels=("tear",), values=values)},
    )  # fmt: skip


def test_blend_shapes_go_by_clips_and_by_what_is_said_of_channels() -> None:
    body, plays = blended(), machines(12)
    said = np.where(np.arange(12) % 3 == 0, np.nan, np.linspace(-0.5, 1.5, 12)).astype(np.float32)
    driven = PoseAdjustments(
        {"puff": said}, variation_draws=VariationDraws(np.arange(10, 22)), lean=leans(12)[:, :2].astype(np.float32) / 127
    )
    worn, level = BodyOutfit(body, PLAYS, blends_lean=True), PosedBody(body, PLAYS)
    body_traits = find_traits(worn)
    weights = compute_blend_weights(worn, body_traits, plays, 12, driven.channels, driven.lean)
    assert len(body_traits.targets) == 3 and len(np.unique(weights[:, 1:])) > 6
    targets = compute_blend_targets(level.drawn_definition, level.bindings, level.point_indices)
    moved = sum(weights[:, k, None, None] * targets[each][None] for k, each in enumerate(body_traits.targets))
    points, _ = level.pose_vertices(plays, 12, driven_pose=driven)
    bones_of = in_bones(body, level, level.compute_poses(plays, 12, driven_pose=driven).world_transforms)[
        :, level.mesh.bones[:, 0]
    ]
    at = np.concatenate([level.mesh.points + moved[:, :, :3], np.ones((*moved.shape[:2], 1))], axis=2)
    assert np.abs(np.einsum("nvij,nvj->nvi", bones_of, at) - points).max() < 1e-4


def test_blend_shapes_are_drawn_as_a_body_of_that_shape(page: Stage) -> None:
    """With the whole weight of a target, the page draws the picture that it draws of a body that is the target."""
    body, plays = blended(), machines(12)

    def picture(body: Definition, weight: float) -> NDArray[np.int64]:
        worn = BodyOutfit(body, PLAYS, blends_lean=True)
        page.tell(scene(camera=CAMERA), texts(), status(), make_rig_packet("ant", worn, ("main", "arms")))
        driven = PoseAdjustments(
            {"puff": np.full(12, weight, np.float32), "tear": np.zeros(12, np.float32)},
            variation_draws=VariationDraws(np.arange(10, 22)),
        )
        page.tell(frame(plays, extra_arrays=trait_arrays(worn, plays, driven)))
        return take_screenshot(page)

    def differ(a: NDArray[np.int64], b: NDArray[np.int64]) -> int:
        covered = [(each[..., 0] > 90) & (each[..., 2] < 0.6 * each[..., 0]) for each in (a, b)]  # by bodies, not their shadows
        return int((covered[0] != covered[1]).sum())

    picture(body, 0)
    show_states(page)
    base, puffed = picture(body, 0), picture(body, 1)
    bare = replace(body.shapes["puffed"], name="base")
    same = replace(body, shapes={"base": bare}, layers={
        name: Layer(name, (), (Binding("", "base", deformer="linearskinning"),)) for name in ("close", "body")
    })  # fmt: skip
    assert differ(base, puffed) > 500
    assert differ(picture(same, 0), puffed) < 0.02 * differ(base, puffed)


def test_materials_have_the_colours_that_antdsl_draws_by_id(page: Stage) -> None:
    """One agent alone in the view has the picture of a body with a material of that colour for all."""
    slate, ends = {"slate": (0.5, 0.5, 0.5)}, ((0.9, 0.0, 0.0), (0.0, 0.0, 0.9), (0.0, 0.9, 0.0))
    box = replace(crane().shapes["box"], materials=("slate",), material=np.zeros(12, np.int32))
    varied = replace(crane(), materials=slate, shapes={"box": box}, variation=Variation({}, {"slate": ends}))
    plays, draws = machines(4), VariationDraws(np.arange(10, 14), 4, "ant")

    def picture(body: Definition) -> NDArray[np.int64]:
        worn = BodyOutfit(body, PLAYS, blends_lean=True)
        page.tell(scene(camera=CAMERA), texts(), status(), make_rig_packet("ant", worn, ("main", "arms")))
        page.tell(frame(plays, extra_arrays=trait_arrays(worn, plays, PoseAdjustments(variation_draws=draws))))
        return take_screenshot(page)

    page.tell(scene(camera=CAMERA), texts(), status())
    several = picture(varied)
    level = PosedBody(varied, PLAYS)
    colours = level.compute_colours(PoseAdjustments(variation_draws=draws))[:, 0]
    alike, masks = np.zeros(several.shape[:2], bool), 0
    for row in range(4):
        uniform_picture = picture(replace(varied, materials={"slate": tuple(map(float, colours[row]))}, variation=Variation()))
        same = np.abs(uniform_picture - several).max(axis=2) < 6
        moved = np.abs(uniform_picture - several).max(axis=2) >= 6
        masks += int(moved.any())
        alike |= same
    assert masks == 4, "they have different colours"
    assert alike.mean() > 0.999


def test_between_two_frames_clips_go_on_and_blend(page: Stage) -> None:
    """What is shown on the way lies between the two frames, and goes through no rest pose."""
    body = crane()
    still = [np.zeros(3, np.float32), np.ones(3, np.float32)]

    def at(clip: int, previous_clip: int, turn: float, fade: float) -> tuple[MachineClips, MachineClips]:
        turns, fades = np.full(3, turn, np.float32), np.full(3, fade, np.float32)
        last = np.full(3, 0.95, np.float32)
        one = MachineClips(
            np.full(3, clip, np.int16), turns, still[1], np.full(3, previous_clip, np.int16), last, still[1], fades
        )
        none = MachineClips(np.full(3, -1, np.int16), still[0], still[0], np.full(3, -1, np.int16), still[0], still[0], still[0])
        return one, none

    page.tell(scene(camera=CAMERA), texts(), status(), rig(body), frame(at(0, -1, 0.9, 0.0)))
    page.page.wait_for_timeout(500)
    level = PosedBody(body, PLAYS)
    first = bones(page, 10)
    assert np.abs(first - expected_bones(body, at(0, -1, 0.9, 0.0), level)[0]).max() < 1e-3
    page.tell(frame(at(2, 0, 0.05, 0.5), 21))
    page.page.wait_for_timeout(800)
    assert np.abs(bones(page, 10) - expected_bones(body, at(2, 0, 0.05, 0.5), level)[0]).max() < 1e-3


def show_states(page: Stage) -> None:
    page.find("side-tab-view").click()
    page.find("colour").select_option("state")


def test_bodies_have_their_natural_colours_as_in_pictures_until_states_are_chosen(page: Stage) -> None:
    """Agents that vary between a dark red and a dark blue look like bodies with a material of each agent's natural colour."""
    box = replace(crane().shapes["box"], materials=(STATE_MATERIAL,), material=np.zeros(12, np.int32))
    ends = ((0.3, 0.0, 0.0), (0.0, 0.0, 0.3))
    natural = replace(crane(), materials={STATE_MATERIAL: ends[0]}, shapes={"box": box})
    natural = replace(natural, variation=Variation({}, {STATE_MATERIAL: ends}))
    plays, driven = machines(12), PoseAdjustments(variation_draws=VariationDraws(np.arange(10, 22), 4, "ant"))
    expected = encode_srgb_values(PosedBody(natural, PLAYS).compute_natural_colours(driven, 12))
    worn = BodyOutfit(natural, PLAYS, blends_lean=True)

    def tell(*extra_messages: bytes) -> NDArray[np.int64]:
        page.tell(*extra_messages, frame(plays, extra_arrays=trait_arrays(worn, plays, driven) | tint))
        return bodies_only()

    def bodies_only() -> NDArray[np.int64]:
        return take_screenshot(page)[120:-8, 8:-8]  # without the legend and the mark of focus

    tint: dict[str, NDArray[Any]] = {}
    page.tell(scene(camera=CAMERA), texts(), status())
    natural_picture = tell(make_rig_packet("ant", worn, ("main", "arms")))
    row = page.find("legend-ant-main-walk")
    assert row.inner_text().split() == ["walk", "12"] and row.locator("i").count() == 0, "no colour that is not there"
    tint = {"tint": np.column_stack([np.rint(expected * 255), np.ones(12)]).astype(np.uint8)}
    assert np.abs(tell() - natural_picture).max() <= 3, "as if an edit had set the colours of pictures"
    tint = {}
    tell()
    page.page.locator("#view > canvas").press("s")
    page.find("side-tab-view").click()
    assert page.find("colour").input_value() == "state"
    assert row.locator("i").evaluate("each => getComputedStyle(each).backgroundColor") == "rgb(230, 179, 26)"
    assert (np.abs(bodies_only() - natural_picture).max(axis=2) > 60).sum() > 100
    page.tell(scene(camera=CAMERA))
    assert page.find("colour").input_value() == "state", "a changed program leaves the choice"
    page.page.locator("#view > canvas").press("s")
    assert np.abs(bodies_only() - natural_picture).max() <= 3


def take_screenshot(page: Stage) -> NDArray[np.int64]:
    page.page.wait_for_timeout(400)
    picture = page.page.locator("#view > canvas").screenshot()
    return np.asarray(Image.open(io.BytesIO(picture)).convert("RGB")).astype(np.int64)


def test_a_body_that_is_another_one_is_drawn_at_once_and_takes_the_colours_of_states_and_materials(page: Stage) -> None:
    body, plays = crane(), machines(30)
    page.tell(scene(camera=CAMERA), texts(), status(), rig(body), frame(plays))
    show_states(page)
    amber = np.array([255 * part for part in WALK])

    def coloured() -> int:
        picture = take_screenshot(page)
        unit = picture / np.maximum(np.linalg.norm(picture, axis=2, keepdims=True), 1)
        bright = picture.max(axis=2) > 60
        return int((bright & (unit @ (amber / np.linalg.norm(amber)) > 0.99)).sum())

    small = coloured()
    assert small > 100
    page.tell(rig(crane(2.0)))
    large = coloured()
    assert large > 2 * small
    page.tell(rig(replace(crane(2.0), materials={"slate": (0.0, 0.02, 0.3)}, shapes={
        "box": replace(crane(2.0).shapes["box"], materials=("slate",), material=np.zeros(12, np.int32)),
    })))  # fmt: skip
    assert coloured() < 0.2 * large
