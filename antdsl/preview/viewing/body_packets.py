"""The packets of the bodies of agents and items. Each body is sent once to a page.

Bodies of species are skinned meshes with the samples of the played clips. The page poses them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.definition import STATE_MATERIAL, Definition
from antdsl.bodies.agents.driving import iterate_look_shares
from antdsl.bodies.agents.leg_ik import LEG_BENDING_LIMITS, LegIkSolver
from antdsl.bodies.agents.machine_clips import PlayedClip
from antdsl.bodies.agents.poses import ClipTable, build_clip_table
from antdsl.bodies.agents.varied_bodies import iterate_scale_pivots
from antdsl.bodies.library import load_library_body
from antdsl.bodies.posed_body import NO_DRIVEN_POSE, PosedBody
from antdsl.bodies.shapes import build_item_mesh
from antdsl.bodies.skinned_mesh import BlendTarget, compute_blend_targets
from antdsl.outputs.cache.pose_arrays import list_wearable_layers
from antdsl.outputs.pictures.light import encode_srgb_values
from antdsl.pipeline import Shot
from antdsl.preview.binary_packets import pack_arrays
from antdsl.preview.viewing.view_state import SlotPackets, ViewState
from antdsl.runtime import Population, World
from antdsl.scene.crowds.body_choice import find_number_of_key, find_species_of_key
from antdsl.scene.crowds.crowd_model import collect_body_weights
from antdsl.scene.library_bodies import BODY_WORDS, find_body_for_species
from antdsl.scene.looks import KIND_BY_LOOK, SURFACE_KINDS, choose_drawn_shape

Arrays = dict[str, NDArray[Any]]
MAX_PAGE_LAYERS = 24  # maximum number of layers on pages; integers of this number of bits are exact in float32
_CACHED_BODIES = 16  # number of outfits with cached bodies
MAX_BLEND_TARGETS = 48  # maximum number of blend-shape targets on pages
_NATURAL_COLOUR_STEPS = 255  # steps along the path of natural colours


@dataclass(frozen=True, slots=True)
class BodyOutfit:
    """A body of a species, with the clips and layers that its agents may display.

    `clips`: the clips of its states, each with a transform group.
    `layers`: the layers that some agents wear in addition to the body's own.
    `look_groups`: the transform groups that `look` turns.
    `blends_lean`: whether clips are blended by turn and slope."""

    definition: Definition
    clips: tuple[PlayedClip, ...] = ()
    layers: tuple[str, ...] = ()
    look_groups: tuple[str, ...] = ()
    blends_lean: bool = False


def collect_outfits(world: World, shot: Shot, population: Population) -> dict[str, BodyOutfit]:
    """Return the outfits of a species, by body key. Layers beyond the number that pages support are dropped."""
    keys = world.setting.list_body_keys(population.name)
    return {key: _make_outfit(world, population, find_body_of_key(shot, key)) for key in keys}


def _make_outfit(world: World, population: Population, definition: Definition) -> BodyOutfit:
    """Return the outfit of those agents of one species that have the body `definition`."""
    plan = population.plan
    layers = tuple(name for name in list_wearable_layers(population, world.setting) if name in definition.layers)[
        :MAX_PAGE_LAYERS
    ]
    looks = tuple(name for name in plan.look_groups if name in definition.groups)
    plays = tuple(
        PlayedClip(
            each.name,
            each.on,
            each.is_additive,
            each.left_turn_clip,
            each.right_turn_clip,
            each.climbing_clip,
            each.descending_clip,
        )
        for each in plan.clips
    )
    return BodyOutfit(definition, plays, layers, looks, "lean#turn" in plan.registers)


def make_rig_packet(key: str, body_outfit: BodyOutfit, machines: tuple[str, ...] = ()) -> bytes:
    """Return the packet of a body: its clips, and its meshes for distant crowds and for near agents.

    `idle` in the header: the number and duration (s) of the base clip that is played below all others; absent without such a
    clip.
    `natural` in the header: the trait that selects the natural colour, and its number of steps per unit; empty if all agents
    have the same colour."""
    arrays, header = _make_rig(body_outfit)
    return pack_arrays(f"rig:{key}", arrays, machines=list(machines), **header)


@lru_cache(maxsize=_CACHED_BODIES)
def build_posed_body(body_outfit: BodyOutfit) -> PosedBody:
    """Return the posed body of an outfit. It is built at the first call and then cached."""
    return PosedBody(body_outfit.definition, body_outfit.clips, body_outfit.layers)


@dataclass(frozen=True, slots=True)
class BodyTraits:
    """The traits in which the bodies of agents differ, apart from clips. Each trait is one number per agent.

    `targets`: the blend-shape targets with varying weights.
    `scales`: the transform groups with varying sizes.
    `materials`: the materials with varying colours; the number is the position in the colour range.
    """

    targets: tuple[BlendTarget, ...] = ()
    scales: tuple[str, ...] = ()
    materials: tuple[str, ...] = ()

    @property
    def count(self) -> int:
        """Return the number of traits."""
        return len(self.targets) + len(self.scales) + len(self.materials)


@lru_cache(maxsize=_CACHED_BODIES)
def find_traits(body_outfit: BodyOutfit) -> BodyTraits:
    """Return the traits of an outfit. Blend-shape targets beyond the number that pages support are dropped."""
    targets = dict.fromkeys(each for level in _make_detail_levels(body_outfit).values() for each in _find_blend_targets(level))
    varied = body_outfit.definition.variation
    return BodyTraits(tuple(targets)[:MAX_BLEND_TARGETS], tuple(varied.scales), tuple(varied.materials))


def _make_detail_levels(body_outfit: BodyOutfit) -> dict[str, PosedBody]:
    body = build_posed_body(body_outfit)
    return {"low": body.coarse_body, "fine": body.fine_body}


def _find_blend_targets(level: PosedBody) -> dict[BlendTarget, NDArray[np.float32]]:
    return compute_blend_targets(level.drawn_definition, level.bindings, level.point_indices)


@lru_cache(maxsize=_CACHED_BODIES)
def _make_rig(body_outfit: BodyOutfit) -> tuple[Arrays, dict[str, Any]]:
    """Return the arrays of a body's rig, and its entries in the packet header."""
    definition, plays = body_outfit.definition, body_outfit.clips
    body, table = build_posed_body(body_outfit), build_clip_table(definition)
    idle = definition.clips.get(definition.idle)
    arrays = _make_clip_arrays(table, definition, plays if idle is None else (*plays, PlayedClip(definition.idle)))
    arrays |= _make_leg_arrays(body.leg_solver, table)
    arrays["look"] = _order_weights_by_depth(
        table, [iterate_look_shares(table.rig, definition.groups[name]) for name in body_outfit.look_groups]
    )
    differ = find_traits(body_outfit)
    arrays |= _make_variation_arrays(definition, differ, table)
    arrays["natural"] = _make_natural_colours(body)
    for level, each in _make_detail_levels(body_outfit).items():
        mesh_arrays = _make_mesh_arrays(each, table) | _make_trait_vertex_arrays(each, differ)
        arrays |= {f"{level}/{name}": array for name, array in mesh_arrays.items()}
    return arrays, {
        "joints": len(table.joint_order), "texels": _count_texels(table), "length": float(definition.length),
        "base": [round(float(x), 9) for x in definition.compute_base_matrix()[:3].reshape(-1)], "bending": LEG_BENDING_LIMITS,
        "idle": [] if idle is None or idle.duration <= 0 else [len(plays), idle.duration],
        "looks": list(body_outfit.look_groups), "leans": body_outfit.blends_lean, "traits": differ.count,
        "targets": len(differ.targets), "natural": _find_natural_trait(definition, differ),
    }  # fmt: skip


def _count_texels(table: ClipTable) -> int:
    """Return the number of texels (four numbers each) per joint and sample. The texels hold the translation and the rotation, and
    also scale and shear if the rig has them."""
    return 2 + table.has_scale + table.has_shear


def _make_clip_arrays(table: ClipTable, definition: Definition, played_clips: tuple[PlayedClip, ...]) -> Arrays:
    """Return the arrays of the clips. Joints are numbered by depth in the rig.

    - `sample` float32[R, J, texels, 4]: the samples, the rest pose first.
    - `parent` int32[J]: the parent of each joint.
    - `clip` int32[P, 3, 4]: the first sample (-1 if the body lacks the clip), the number of samples, flags (1 loops, 2 is
      added), and the transform group. Then the first samples and numbers of samples of its left and right, up and down variants.
    - `group` float32[G, J]: the joint weights of each transform group. The first row is the complete rig.
    """
    joints, sample_rows = len(table.joint_order), [np.array([0])]
    groups = ["", *sorted({each.group for each in played_clips} - {""})]
    clip_ranges: dict[str, tuple[int, int]] = {}
    for name in dict.fromkeys(name for each in played_clips for name in (each.clip, *each[3:]) if name in table.names):
        number = table.find_clip(name) + 1
        first, length = int(table.first_sample_rows[number]), int(table.sample_counts[number])
        clip_ranges[name] = sum(map(len, sample_rows)), length
        sample_rows.append(np.arange(first, first + length))
    clips = []
    for each in played_clips:
        first, length = clip_ranges.get(each.clip, (-1, 1))
        again = first >= 0 and bool(table.is_looping[table.find_clip(each.clip) + 1])
        blend_ranges = [number for blend_clip in each[3:] for number in clip_ranges.get(blend_clip, (-1, 1))]
        clips.append((first, length, int(again) + 2 * int(each.add), groups.index(each.group), *blend_ranges))
    rows = table.sample_rows[np.concatenate(sample_rows)]
    sample = np.zeros((len(rows), joints, _count_texels(table), 4), np.float32)
    at = 0
    for texel, width in enumerate((3, 4, *([3] if table.has_scale else []), *([3] if table.has_shear else []))):
        part = rows[:, at : at + width * joints].reshape(len(rows), width, joints)
        sample[:, :, texel, :width] = part.transpose(0, 2, 1)
        at += width * joints
    place = find_depth_order(table)
    parents = np.asarray(table.rig.parents)[table.joint_order]
    ones = np.ones(joints, np.float32)
    weights = [ones if not name else table.compute_group_weights(definition.groups[name])[0] for name in groups]
    return {
        "sample": sample,
        "parent": np.where(parents >= 0, place[parents], -1).astype(np.int32),
        "clip": np.array(clips, np.int32).reshape(-1, 12),
        "group": np.stack(weights).astype(np.float32),
    }


def _order_weights_by_depth(table: ClipTable, groups: Sequence[Iterable[tuple[int, float]]]) -> NDArray[np.float32]:
    """Return the joint weights of G groups as float32[G, J], with joints numbered by depth. `groups`: for each group, pairs of a
    joint's number in the rig and its weight."""
    weights = np.zeros((len(groups), len(table.joint_order)), np.float32)
    for k, group in enumerate(groups):
        for joint, weight in group:
            weights[k, joint] = weight
    return weights[:, table.joint_order]


def _make_variation_arrays(definition: Definition, body_traits: BodyTraits, table: ClipTable) -> Arrays:
    """Return the arrays of sizes and colours that vary between agents.

    - `scale` float32[S, J]: how much the size of each transform group scales each joint and its descendants. Joints are numbered
      by depth.
    - `palette` float32[c, 4]: the colours of materials that vary, one material after the other.
    """
    scale = _order_weights_by_depth(
        table, [iterate_scale_pivots(table.rig, definition.groups[name]) for name in body_traits.scales]
    )
    colours = [colour for name in body_traits.materials for colour in definition.variation.materials[name]]
    palette = np.zeros((len(colours), 4), np.float32)
    palette[:, :3] = np.array(colours, np.float32).reshape(-1, 3)
    return {"scale": scale, "palette": palette}


def _make_natural_colours(body: PosedBody) -> NDArray[np.uint8]:
    """Return the natural colours of agents, uint8[c, 3], in display encoding.

    This is one colour, or evenly spaced colours along the path of their variation."""
    path = body.definition.variation.materials.get(STATE_MATERIAL)
    linear = body.compute_natural_colours(NO_DRIVEN_POSE, 1)
    if path is not None:
        at = np.linspace(0, len(path) - 1, _NATURAL_COLOUR_STEPS + 1)
        linear = np.column_stack([np.interp(at, np.arange(len(path)), channel) for channel in np.array(path).T])
    return np.round(np.clip(encode_srgb_values(linear), 0, 1) * 255).astype(np.uint8)


def _find_natural_trait(definition: Definition, body_traits: BodyTraits) -> list[float]:
    path = definition.variation.materials.get(STATE_MATERIAL)
    if path is None:
        return []
    first = len(body_traits.targets) + len(body_traits.scales)
    return [first + body_traits.materials.index(STATE_MATERIAL), _NATURAL_COLOUR_STEPS / (len(path) - 1)]


def _make_trait_vertex_arrays(level: PosedBody, body_traits: BodyTraits) -> Arrays:
    """Return the arrays of vertices that depend on traits of the agent.

    - `target` float32[T, v, 6]: the offsets that each blend-shape target adds to positions and normals.
    - `paint` float32[v, 2]: the number of the trait that selects a vertex's colour, and the index of the first of its colours.
      The number is -1 if the colour does not vary.
    """
    targets, count = _find_blend_targets(level), len(level.mesh.points)
    none = np.zeros((count, 6), np.float32)
    paint = np.full((count, 2), -1, np.float32)
    first = 0
    for k, name in enumerate(body_traits.materials):
        paint[level.material_names == name] = len(body_traits.targets) + len(body_traits.scales) + k, first
        first += len(level.definition.variation.materials[name])
    return {"target": np.array([targets.get(each, none) for each in body_traits.targets], np.float32), "paint": paint}


def find_depth_order(table: ClipTable) -> NDArray[np.int32]:
    """Return, for each joint of the rig, its index when joints are numbered by depth."""
    place = np.empty(len(table.joint_order), np.int32)
    place[table.joint_order] = np.arange(len(table.joint_order))
    return place


def _make_leg_arrays(legs: LegIkSolver | None, table: ClipTable) -> Arrays:
    """Return `leg` float32[L, 5, 4], five rows of four numbers for each of L legs; {} for a body without legs.

    Row 0: the joints hip, knee, foot and ankle, numbered by depth. Row 1: the axis about which a straight knee bends, and
    whether the sole is flat. Rows 2 and 3: the body's up direction in the space of the ankle and of the foot. Row 4: the vector
    from the foot to the ankle."""
    if legs is None:
        return {}
    leg_array, place = np.zeros((legs.leg_count, 5, 4), np.float32), find_depth_order(table)
    leg_array[:, 0] = [place[[each.upper, each.lower, each.foot, each.ankle]] for each in legs.chains]
    leg_array[:, 1, :3], leg_array[:, 1, 3] = legs.get_straight_axes(), [each.has_flat_sole for each in legs.chains]
    for row, leg in zip(leg_array, legs.chains, strict=True):
        row[2:, :3] = legs.get_local_up_axes(leg.ankle), legs.get_local_up_axes(leg.foot), legs.get_arch(leg)
    return {"leg": leg_array}


def _number_leg_parts(legs: LegIkSolver | None, joints: int) -> NDArray[np.int32]:
    """Return, for each joint of the rig, the number of the leg part that it belongs to; 0 for none.

    The number is 4 times the leg's number, plus 1 for the thigh, 2 for the shank, 3 for the arch, 4 for the sole."""
    part_numbers = np.zeros(joints, np.int32)
    for number, each in enumerate(legs.chains if legs is not None else ()):
        for piece, those in enumerate((each.thigh_joints, each.shank_joints, each.arch_joints, each.sole_joints), 1):
            part_numbers[those] = 4 * number + piece
    return part_numbers


def _make_mesh_arrays(body: PosedBody, table: ClipTable) -> Arrays:
    """Return the arrays of the mesh.

    - `position` and `normal` float32[v, 3] in the rest pose; `face` uint32[m, 3].
    - `colour` uint8[v, 4]: square roots of linear colours, and the weight of the agent's own colour.
    - `bone` uint8 or uint16[v, 4]; `weight` uint8[v, 4].
    - `joint` int32[B] by depth and `inverse` float32[B, 3, 4] of the bones."""
    mesh = body.mesh
    place = np.append(find_depth_order(table), -1)  # of a bone without a joint: -1
    colour = np.sqrt(np.clip(np.column_stack([body.material_colours, np.square(body.tint_weights)]), 0, 1))
    return {
        "position": mesh.points,
        "normal": np.round(mesh.normals * 127).astype(np.int8),
        "face": body.faces.astype(np.uint32),
        "colour": np.round(colour * 255).astype(np.uint8),
        "bone": mesh.bones.astype(np.uint16),
        "weight": mesh.weights,
        "joint": place[mesh.bone_joints].astype(np.int32),
        "part": np.append(_number_leg_parts(body.leg_solver, len(table.joint_order)), 0)[mesh.bone_joints].astype(np.int32),
        "inverse": mesh.inverse_matrices,
        "layer": body.layer_masks.astype(np.uint32),
    }


def find_body_of_key(shot: Shot, key: str) -> Definition:
    """Return the body that a body key identifies. It is the body in the body's own file. Without such a file, it is the library
    body that the scene requests or that matches the species' name."""
    own, species, number = shot.bodies.get(key), find_species_of_key(key), find_number_of_key(key)
    if own is not None:
        return own
    named = list(collect_body_weights(shot.scene.model.crowd).get(species, {}))
    requested_body = named[number] if number < len(named) else None
    return load_library_body(requested_body if requested_body in BODY_WORDS else find_body_for_species(species))


class ItemBodyPackets:
    """A maker of the packets of item bodies, for the slots `item:ITEMS:NAME`. Items that are not drawn have no slot."""

    def __init__(self) -> None:
        self._sent_bodies: dict[str, tuple[int, str, str | None]] = {}

    def make_packets(self, view_state: ViewState) -> SlotPackets:
        """Yield the packets of items that have a new body."""
        for kind in view_state.world.items:
            for index, item in enumerate(view_state.world.setting.items.get(kind, ())):
                shape, slot = choose_drawn_shape(kind, item.name, item.look), f"item:{kind}:{item.name}"
                body = index, shape, item.look
                if body == self._sent_bodies.get(slot) or (shape == "none" and slot not in self._sent_bodies):
                    continue
                self._sent_bodies[slot] = body
                yield slot, _make_item_packet(slot, kind, *body)


def _make_item_packet(slot: str, kind: str, index: int, shape: str, look: str | None) -> bytes:
    """Return the packet of an item's body, in the colours of its look. If the item is not drawn, the mesh is empty."""
    if shape == "none":
        return pack_arrays(slot, {"face": np.zeros((0, 3), np.uint32)}, items=kind, index=index, shape=shape)
    vertices, faces, colour = build_item_mesh(shape)
    header: dict[str, Any] = {"items": kind, "index": index, "shape": shape}
    if look is not None:
        surface = SURFACE_KINDS[KIND_BY_LOOK[look]]
        colour, header = np.broadcast_to(surface.colour, colour.shape), header | {"look": look, "roughness": surface.roughness}
    arrays = {"position": vertices.astype(np.float32), "face": faces.astype(np.uint32), "colour": colour.astype(np.float32)}
    return pack_arrays(slot, arrays, **header)
