"""The bodies that agents and items are displayed with, each sent once. Bodies of species are skinned meshes with the samples of
the played clips. The page poses them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.definition import Definition
from antdsl.bodies.agents.driving import look_shares
from antdsl.bodies.agents.leg_ik import LEG_BENDING_LIMITS, LegSolver
from antdsl.bodies.agents.machine_clips import PlayedClip
from antdsl.bodies.agents.poses import ClipTable, clip_table
from antdsl.bodies.agents.varied_bodies import scaled_joints
from antdsl.bodies.library import library_body
from antdsl.bodies.posed_body import PosedBody
from antdsl.bodies.shapes import item_shape, placed
from antdsl.bodies.skinned_mesh import BlendTarget, blend_targets
from antdsl.outputs.cache.pose_arrays import layers_worn, playing
from antdsl.pipeline import Shot
from antdsl.preview.binary_packets import pack
from antdsl.preview.viewing.seen import SlotPackets, ViewState
from antdsl.runtime import Population, World
from antdsl.scene.body_choice import body_keys, number_of_key, species_of_key
from antdsl.scene.crowd_model import named_weights
from antdsl.scene.library_bodies import BODY_WORDS, body_for_species

Arrays = dict[str, NDArray[Any]]
MAX_PAGE_LAYERS = 24  # that pages tell apart: whole numbers of so many bits are exact in float32
_CACHED_BODIES = 16  # outfits with built bodies
MAX_BLEND_TARGETS = 48  # of blend shapes, that pages know


class RigPackets:
    """The slots `rig:KEY`, one for each body of a species. Sent again if a body, or the clips that it plays, change."""

    def __init__(self) -> None:
        self._given: dict[str, tuple[BodyOutfit, tuple[str, ...]]] = {}

    def packets(self, view_state: ViewState) -> SlotPackets:
        """Yield the packets of bodies that are new or have new clips."""
        for population in view_state.world.populations.values():
            for key, worn in outfits(view_state.world, view_state.shot, population).items():
                rig_key = worn, tuple(playing(population))
                if self._given.get(key) != rig_key:
                    self._given[key] = rig_key
                    yield f"rig:{key}", rig_packet(key, *rig_key)


@dataclass(frozen=True, slots=True)
class BodyOutfit:
    """The abilities of a species' bodies.

    `plays`: clips of its states, with transform groups.
    `layers`: the layers that some agents wear in addition to the body's own.
    `looks`: the transform groups of `look`.
    `leans`: whether clips blend with turn and slope.
    """

    definition: Definition
    plays: tuple[PlayedClip, ...] = ()
    layers: tuple[str, ...] = ()
    looks: tuple[str, ...] = ()
    leans: bool = False


def outfits(world: World, shot: Shot, population: Population) -> dict[str, BodyOutfit]:
    """Return the outfits of a species, by the keys of its bodies. Layers beyond the limit of pages are dropped."""
    keys = body_keys(population.name, len(world.setting.body_weights.get(population.name, ())))
    return {key: _outfit(world, population, body_of_key(shot, key)) for key in keys}


def _outfit(world: World, population: Population, definition: Definition) -> BodyOutfit:
    """Return the outfit of agents of a species that have a body."""
    plan = population.plan
    layers = tuple(name for name in layers_worn(population, world.setting) if name in definition.layers)[:MAX_PAGE_LAYERS]
    looks = tuple(name for name in plan.looks if name in definition.groups)
    plays = tuple(PlayedClip(each.name, each.on, each.add, each.left, each.right, each.up, each.down) for each in plan.clips)
    return BodyOutfit(definition, plays, layers, looks, "lean:turn" in plan.registers)


def rig_packet(key: str, worn: BodyOutfit, machines: tuple[str, ...] = ()) -> bytes:
    """Return the packet of a body: its clips, and its meshes for crowds and for near agents.

    `idle` in its header: the number and duration (s) of the base clip below all others; absent without such a clip."""
    arrays, header = _rig(worn)
    return pack(f"rig:{key}", arrays, machines=list(machines), **header)


@lru_cache(maxsize=_CACHED_BODIES)
def posed_body(worn: BodyOutfit) -> PosedBody:
    """Return the body of an outfit. It is built once."""
    return PosedBody(worn.definition, worn.plays, worn.layers)


@dataclass(frozen=True, slots=True)
class BodyTraits:
    """The properties in which the bodies of agents differ, apart from clips. Each is one number per agent.

    `targets`: weights of blend-shape targets.
    `scales`: sizes of transform groups.
    `materials`: positions in the colour ranges of materials.
    """

    targets: tuple[BlendTarget, ...] = ()
    scales: tuple[str, ...] = ()
    materials: tuple[str, ...] = ()

    @property
    def count(self) -> int:
        """Return the number of traits."""
        return len(self.targets) + len(self.scales) + len(self.materials)


@lru_cache(maxsize=_CACHED_BODIES)
def traits(worn: BodyOutfit) -> BodyTraits:
    """Return the traits of an outfit. Targets beyond the limit of pages are dropped."""
    targets = dict.fromkeys(each for level in _levels(worn).values() for each in _targets(level))
    varied = worn.definition.variation
    return BodyTraits(tuple(targets)[:MAX_BLEND_TARGETS], tuple(varied.scales), tuple(varied.materials))


def _levels(worn: BodyOutfit) -> dict[str, PosedBody]:
    body = posed_body(worn)
    return {"low": body.coarse, "fine": body.fine}


def _targets(level: PosedBody) -> dict[BlendTarget, NDArray[np.float32]]:
    return blend_targets(level.shaded, level.bindings, level.taken)


@lru_cache(maxsize=_CACHED_BODIES)
def _rig(worn: BodyOutfit) -> tuple[Arrays, dict[str, Any]]:
    definition, plays = worn.definition, worn.plays
    body, table = posed_body(worn), clip_table(definition)
    idle = definition.clips.get(definition.idle)
    arrays = _clips(table, definition, plays if idle is None else (*plays, PlayedClip(definition.idle)))
    arrays |= _legs(body.legs, table)
    arrays["look"] = _weights_by_depth(table, [look_shares(table.rig, definition.groups[name]) for name in worn.looks])
    differ = traits(worn)
    arrays |= _variation(definition, differ, table)
    for level, each in _levels(worn).items():
        mesh_arrays = _mesh(each, table) | _trait_vertex_arrays(each, differ)
        arrays |= {f"{level}/{name}": array for name, array in mesh_arrays.items()}
    return arrays, {
        "joints": len(table.order), "texels": _texel_count(table), "length": float(definition.length),
        "base": [round(float(x), 9) for x in definition.base_matrix()[:3].reshape(-1)], "bending": LEG_BENDING_LIMITS,
        "idle": [] if idle is None or idle.duration <= 0 else [len(plays), idle.duration],
        "looks": list(worn.looks), "leans": worn.leans, "traits": differ.count, "targets": len(differ.targets),
    }  # fmt: skip


def _texel_count(table: ClipTable) -> int:
    """Return the number of texels (four numbers each) per joint and sample: one for translation, one for rotation, and further
    ones for scale and shear if there are any."""
    return 2 + table.scaled + table.sheared


def _clips(table: ClipTable, definition: Definition, plays: tuple[PlayedClip, ...]) -> Arrays:
    """Return the arrays of the clips. Joints are numbered by depth in the rig.

    - `sample` float32[R, J, texels, 4]: the samples, the rest pose first.
    - `parent` int32[J]: the parent of each joint.
    - `clip` int32[P, 3, 4]: the first sample (-1 if the body lacks the clip), the number of samples, flags (1 loops, 2 is added),
      and the transform group. Then the first samples and numbers of samples of its left and right, up and down variants.
    - `group` float32[G, J]: weights of joints, first those of the complete rig.
    """
    joints, sample_rows = len(table.order), [np.array([0])]
    groups = ["", *sorted({each.on for each in plays} - {""})]
    clip_ranges: dict[str, tuple[int, int]] = {}
    for name in dict.fromkeys(name for each in plays for name in (each.clip, *each[3:]) if name in table.names):
        number = table.number(name) + 1
        first, length = int(table.first[number]), int(table.counts[number])
        clip_ranges[name] = sum(map(len, sample_rows)), length
        sample_rows.append(np.arange(first, first + length))
    clips = []
    for each in plays:
        first, length = clip_ranges.get(each.clip, (-1, 1))
        again = first >= 0 and bool(table.loops[table.number(each.clip) + 1])
        blend_ranges = [number for blend_clip in each[3:] for number in clip_ranges.get(blend_clip, (-1, 1))]
        clips.append((first, length, int(again) + 2 * int(each.add), groups.index(each.on), *blend_ranges))
    rows = table.samples[np.concatenate(sample_rows)]
    sample = np.zeros((len(rows), joints, _texel_count(table), 4), np.float32)
    at = 0
    for texel, width in enumerate((3, 4, *([3] if table.scaled else []), *([3] if table.sheared else []))):
        part = rows[:, at : at + width * joints].reshape(len(rows), width, joints)
        sample[:, :, texel, :width] = part.transpose(0, 2, 1)
        at += width * joints
    place = _depth_order(table)
    parents = np.asarray(table.rig.parents)[table.order]
    ones = np.ones(joints, np.float32)
    weights = [ones if not name else table.weights(definition.groups[name])[0] for name in groups]
    return {
        "sample": sample,
        "parent": np.where(parents >= 0, place[parents], -1).astype(np.int32),
        "clip": np.array(clips, np.int32).reshape(-1, 12),
        "group": np.stack(weights).astype(np.float32),
    }


def _weights_by_depth(table: ClipTable, groups: Sequence[Iterable[tuple[int, float]]]) -> NDArray[np.float32]:
    """Return the joint weights of G groups as float32[G, J], joints by depth. `groups`: pairs of a joint's number in the rig and
    its weight."""
    weights = np.zeros((len(groups), len(table.order)), np.float32)
    for k, group in enumerate(groups):
        for joint, weight in group:
            weights[k, joint] = weight
    return weights[:, table.order]


def _variation(definition: Definition, differ: BodyTraits, table: ClipTable) -> Arrays:
    """Return two arrays.

    - `scale` float32[S, J]: the weight with which the size of a transform group scales each joint, with its descendants; joints
      by depth.
    - `palette` float32[c, 4]: the colours of materials that vary, one material after the other.
    """
    scale = _weights_by_depth(table, [scaled_joints(table.rig, definition.groups[name]) for name in differ.scales])
    colours = [colour for name in differ.materials for colour in definition.variation.materials[name]]
    palette = np.zeros((len(colours), 4), np.float32)
    palette[:, :3] = np.array(colours, np.float32).reshape(-1, 3)
    return {"scale": scale, "palette": palette}


def _trait_vertex_arrays(level: PosedBody, differ: BodyTraits) -> Arrays:
    """Return two arrays.

    - `target` float32[T, v, 6]: the offsets of each blend-shape target to positions and normals.
    - `paint` float32[v, 2]: the number of the trait that selects a vertex's colour (-1 if the colour does not vary), and the
      index of the first of its colours.
    """
    targets, count = _targets(level), len(level.mesh.points)
    none = np.zeros((count, 6), np.float32)
    paint = np.full((count, 2), -1, np.float32)
    first = 0
    for k, name in enumerate(differ.materials):
        paint[level.material == name] = len(differ.targets) + len(differ.scales) + k, first
        first += len(level.definition.variation.materials[name])
    return {"target": np.array([targets.get(each, none) for each in differ.targets], np.float32), "paint": paint}


def _depth_order(table: ClipTable) -> NDArray[np.int32]:
    """Return, for each joint of the rig, its index in the order by depth."""
    place = np.empty(len(table.order), np.int32)
    place[table.order] = np.arange(len(table.order))
    return place


def _legs(legs: LegSolver | None, table: ClipTable) -> Arrays:
    """Return `leg` float32[L, 2, 4]: the joints of hip, knee and foot, numbered by depth, and the axis about which a straight
    knee bends."""
    if legs is None:
        return {}
    leg_array, place = np.zeros((legs.count, 2, 4), np.float32), _depth_order(table)
    leg_array[:, 0, :3] = [place[[each.upper, each.lower, each.foot]] for each in legs.chains]
    leg_array[:, 1, :3] = legs.straight_axes()
    return {"leg": leg_array}


def _leg_parts(legs: LegSolver | None, joints: int) -> NDArray[np.int32]:
    """Return the leg part of each joint of the rig: 0 for none, else three times the leg's number plus 1 for thigh, 2 for shank,
    3 for foot."""
    part_numbers = np.zeros(joints, np.int32)
    for number, each in enumerate(legs.chains if legs is not None else ()):
        for piece, those in enumerate((each.thigh, each.shank, each.sole), 1):
            part_numbers[those] = 3 * number + piece
    return part_numbers


def _mesh(body: PosedBody, table: ClipTable) -> Arrays:
    """Return the arrays of the mesh.

    - `position` and `normal` float32[v, 3] in the rest pose; `face` uint32[m, 3].
    - `colour` uint8[v, 4]: square roots of linear colours, and the share of the agent's own colour.
    - `bone` uint8 or uint16[v, 4]; `weight` uint8[v, 4].
    - `joint` int32[B] by depth and `inverse` float32[B, 3, 4] of the bones."""
    mesh = body.mesh
    place = np.append(_depth_order(table), -1)  # of a bone without a joint: -1
    colour = np.sqrt(np.clip(np.column_stack([body.own, np.square(body.tint)]), 0, 1))
    return {
        "position": mesh.points,
        "normal": np.round(mesh.normals * 127).astype(np.int8),
        "face": body.faces.astype(np.uint32),
        "colour": np.round(colour * 255).astype(np.uint8),
        "bone": mesh.bones.astype(np.uint16),
        "weight": mesh.weights,
        "joint": place[mesh.joint].astype(np.int32),
        "part": np.append(_leg_parts(body.legs, len(table.order)), 0)[mesh.joint].astype(np.int32),
        "inverse": mesh.inverse,
        "layer": body.masks.astype(np.uint32),
    }


def body_of_key(shot: Shot, key: str) -> Definition:
    """Return a body: from its own file, else the library body that the scene requests or that matches the species' name."""
    own, species, number = shot.bodies.get(key), species_of_key(key), number_of_key(key)
    if own is not None:
        return own
    named = list(named_weights(shot.scene.model.crowd).get(species, {}))
    requested_body = named[number] if number < len(named) else None
    return library_body(requested_body if requested_body in BODY_WORDS else body_for_species(species))


class ItemBodyPackets:
    """The slots `item:ITEMS:NAME`. Items that only mark positions have no body."""

    def __init__(self) -> None:
        self._given: set[tuple[str, str, int]] = set()

    def packets(self, view_state: ViewState) -> SlotPackets:
        """Yield the packets of items with a new body."""
        for kind, items in view_state.world.items.items():
            for index, name in enumerate(items.names):
                if (kind, name, index) in self._given:
                    continue
                self._given.add((kind, name, index))
                shape = item_shape(kind, name)
                if shape == "none":
                    continue
                vertices, faces, colour = placed(shape)
                slot = f"item:{kind}:{name}"
                arrays = {
                    "position": vertices.astype(np.float32),
                    "face": faces.astype(np.uint32),
                    "colour": colour.astype(np.float32),
                }
                yield slot, pack(slot, arrays, items=kind, index=index, shape=shape)
