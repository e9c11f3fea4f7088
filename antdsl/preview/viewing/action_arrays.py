"""Compact arrays that describe what the bodies in a frame do.

They contain up to three clips per machine with progress and weight, the positions of feet, and the pose of the trunk."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.blending import blend_poses
from antdsl.bodies.agents.definition import Definition, TransformGroup
from antdsl.bodies.agents.driving import set_pose_channels
from antdsl.bodies.agents.leg_ik import LegIkSolver, PlacedFeet
from antdsl.bodies.agents.machine_clips import MachineClips, PlayedClip, build_machine_playback
from antdsl.bodies.agents.poses import ClipTable, build_clip_table
from antdsl.bodies.agents.varied_bodies import VariationDraws, draw_colour_path_positions, draw_group_scale
from antdsl.bodies.skinned_mesh import compute_target_weights, reduce_to_channels
from antdsl.numerics.vector_rows import normalise_or_fallback
from antdsl.outputs.cache.pose_arrays import (
    list_playing_machines,
    list_wearable_layers,
    make_clip_arrays,
    make_display_arrays,
    make_feet_arrays,
    read_feet,
    read_machine_clips,
)
from antdsl.pipeline import Shot
from antdsl.preview.session import PreviewSession
from antdsl.preview.timeline import SpeciesPoses
from antdsl.preview.viewing.body_packets import (
    BodyOutfit,
    BodyTraits,
    build_posed_body,
    collect_outfits,
    find_depth_order,
    find_traits,
)
from antdsl.runtime import Population, World
from antdsl.runtime.body_rows import find_body_numbers

_STEPS_PER_BODY_LENGTH = 4096  # steps per body length
_INT16_FULL_SCALE = 32767
_MAX_FEET_BITS = 15  # feet that have a bit for standing
Floats = NDArray[np.float32]
NO_CLIP_CODE = 65535  # the number that means no clip
_UINT16_FULL_SCALE = 65535  # one turn of a clip, or a weight of 1
Arrays = dict[str, NDArray[Any]]


def store_poses(session: PreviewSession) -> None:
    """Store the poses of the session's current frame together with its reduced frame, unless they are stored already."""
    world, lights = session.world, session.read_reduced_frame(session.frame)
    if lights is not None and session.frame not in session.timeline.poses:
        poses = {
            name: _make_species_poses(session, each, lights[name]) for name, each in world.populations.items() if name in lights
        }
        session.timeline.poses.put_frame(session.frame, poses)


def read_stored_poses(session: PreviewSession, frame: int) -> dict[str, Arrays]:
    """Return the stored actions of bodies at a frame, by species. Species that now have other bodies or clips are omitted."""
    arrays_by_species = {}
    for name, then in session.timeline.poses.get(frame, {}).items():
        population = session.world.populations.get(name)
        if population is not None and collect_outfits(session.world, session.shot, population) == then.outfit:
            arrays_by_species[name] = then.arrays
    return arrays_by_species


def _make_species_poses(session: PreviewSession, population: Population, displayed: Arrays) -> SpeciesPoses:
    actions = collect_actions(session.world, session.shot, population, displayed)
    return SpeciesPoses(actions.outfits, make_action_arrays(actions))


@dataclass(frozen=True, slots=True, eq=False)
class SpeciesActions:
    """The actions of the bodies of a species in a frame.

    `machines`: the machines that play clips. `layers`: the layers that agents may wear. `channels`: the channels that states
    set.
    `seed`: the seed of the scene. `seconds`: the time of the frame.
    `outfits`: the outfits by body key. `body_numbers`: uint8[n], the index of each agent's body.
    `stored_arrays`: the arrays that caches also contain, ordered by id, with feet in mm.
    `displayed_arrays`: positions and directions as pages display them, ordered by id."""

    species: str
    machines: tuple[str, ...]
    layers: tuple[str, ...]
    channels: tuple[str, ...]
    seed: int
    seconds: float
    outfits: Mapping[str, BodyOutfit]
    body_numbers: NDArray[np.uint8]
    stored_arrays: Mapping[str, NDArray[Any]]
    displayed_arrays: Arrays

    def select_rows(self, rows: NDArray[np.intp]) -> SpeciesActions:
        """Return the actions of the agents in `rows`. The arrays of feet are left unchanged, because their rows are numbered by
        body, not by agent."""
        stored = {name: array if name.startswith("feet.") else array[rows] for name, array in self.stored_arrays.items()}
        displayed = {name: array[rows] for name, array in self.displayed_arrays.items()}
        return replace(self, stored_arrays=stored, displayed_arrays=displayed, body_numbers=self.body_numbers[rows])


def collect_actions(world: World, shot: Shot, population: Population, displayed: Arrays) -> SpeciesActions:
    """Return the actions of a species' bodies in the world's current frame.

    `displayed`: the reduced frame of the same agents, ordered by id."""
    stored = make_clip_arrays(population) | make_display_arrays(population, world.setting)
    for key in world.setting.list_body_keys(population.name):
        stored |= make_feet_arrays(world, key, 1.0)
    return SpeciesActions(
        population.name,
        tuple(list_playing_machines(population)),
        list_wearable_layers(population, world.setting),
        population.plan.channels,
        world.setting.seed,
        world.frame * world.dt,
        collect_outfits(world, shot, population),
        find_body_numbers(population, world.setting)[population.get_rows_by_id()],
        stored,
        displayed,
    )


def make_action_arrays(actions: SpeciesActions) -> Arrays:
    """Return the actions of bodies as arrays.

    - `SPECIES/plays/MACHINE`: the clips of a machine, as `pack_clips` returns them.
    - `SPECIES/wears` uint32[n]: a bit for each worn layer.
    - `SPECIES/look/GROUP` int8[n, 3]: a unit vector times 127.
    - `SPECIES/offset/K` float32[n, 7]: the offset that edits add to joint K, as in caches. Joints are numbered by depth in the
      rig.
    - `SPECIES/lean` int8[n, 3]: turn times 127, slope times 127, and 0.
    - `SPECIES/trait/K` float32[n, 3]: the body traits, three per array, in order.
    - `SPECIES/feet` and `SPECIES/stance`: if feet are computed. `SPECIES/sole`: if the body has flat soles.

    Arrays of features that a body lacks are left out. In a species with several bodies, each body has separate arrays for its
    agents, named by the body's key. `SPECIES/body` uint8[n] is the index of each agent's body."""
    if len(actions.outfits) == 1:
        ((key, worn),) = actions.outfits.items()
        return _make_body_arrays(actions, key, worn)
    arrays = {f"{actions.species}/body": actions.body_numbers}
    for number, (key, worn) in enumerate(actions.outfits.items()):
        arrays |= _make_body_arrays(actions.select_rows(np.flatnonzero(actions.body_numbers == number)), key, worn)
    return arrays


def _make_body_arrays(actions: SpeciesActions, key: str, worn: BodyOutfit) -> Arrays:
    """Return the action arrays of those agents that have the body `key`."""
    stored, displayed = actions.stored_arrays, actions.displayed_arrays
    count = len(displayed["id"])
    clips_by_machine = {each: read_machine_clips(actions.species, each, stored, count) for each in actions.machines}
    machines = {each: clip for each, clip in clips_by_machine.items() if clip is not None}
    clips = [worn.definition.clips.get(clip) for clip, *_ in worn.clips]
    loops = np.array([*(clip is not None and clip.loop for clip in clips), False])
    arrays: Arrays = {f"plays/{each}": pack_clips(clip, loops) for each, clip in machines.items()}
    arrays |= _make_display_arrays(actions, worn)
    played = (*build_posed_body(worn).build_idle_clips(displayed["id"], actions.seconds), *machines.values())
    arrays |= _make_trait_arrays(actions, worn, played)
    solver = build_posed_body(worn).leg_solver
    feet = None if solver is None else read_feet(key, stored, count, solver.leg_count)
    if feet is not None and solver is not None and count:
        stands = solver.compute_stance_weights((*worn.clips, PlayedClip(worn.definition.idle)), played, count)
        arrays |= make_stance_arrays(solver, feet, displayed, stands)
    return {f"{key}/{what}": array for what, array in arrays.items()}


def _make_display_arrays(actions: SpeciesActions, body_outfit: BodyOutfit) -> Arrays:
    arrays: Arrays = {}
    stored, species = actions.stored_arrays, actions.species
    if body_outfit.layers:
        mask = stored[f"wears.{species}"]
        layer_bits = np.zeros(len(mask), np.uint32)
        for k, layer in enumerate(body_outfit.layers):
            number = np.uint64(actions.layers.index(layer))
            layer_bits |= ((mask >> number) & np.uint64(1)).astype(np.uint32) << np.uint32(k)
        arrays["wears"] = layer_bits
    for group in body_outfit.look_groups:
        arrays[f"look/{group}"] = np.rint(127 * np.nan_to_num(stored[f"looks.{species}.{group}"])).astype(np.int8)
    if body_outfit.blends_lean:
        leans = np.nan_to_num(stored[f"leans.{species}"])
        arrays["lean"] = np.rint(127 * np.clip(np.column_stack([leans, np.zeros(len(leans))]), -1, 1)).astype(np.int8)
    return arrays | _make_offset_arrays(actions, body_outfit)


def _make_offset_arrays(actions: SpeciesActions, body_outfit: BodyOutfit) -> Arrays:
    prefix = f"joints.{actions.species}."
    offsets = {name.removeprefix(prefix): each for name, each in actions.stored_arrays.items() if name.startswith(prefix)}
    numbers = _number_joints(body_outfit.definition) if offsets else {}
    return {f"offset/{numbers[joint]}": array for joint, array in offsets.items() if joint in numbers}


@lru_cache(maxsize=8)
def _number_joints(definition: Definition) -> Mapping[str, int]:
    """Return, for each joint name, the joint's number when joints are numbered by depth in the rig."""
    table = build_clip_table(definition)
    return dict(zip(table.rig.names, find_depth_order(table).tolist(), strict=True))


def _make_trait_arrays(actions: SpeciesActions, body_outfit: BodyOutfit, machines: tuple[MachineClips, ...]) -> Arrays:
    stored, ids = actions.stored_arrays, actions.displayed_arrays["id"].astype(np.int64)
    differ, varied, count = find_traits(body_outfit), body_outfit.definition.variation, len(ids)
    if not differ.count or not count:
        return {}
    draws = VariationDraws(ids, actions.seed, actions.species)
    trait_values = np.zeros((count, -(-differ.count // 3) * 3), np.float32)
    parts = [draw_group_scale(varied, name, draws) for name in differ.scales]
    parts += [draw_colour_path_positions(varied, name, draws) for name in differ.materials]
    first = len(differ.targets)
    if first:
        said = {each: stored[f"channels.{actions.species}.{each}"] for each in actions.channels}
        lean = stored.get(f"leans.{actions.species}")
        trait_values[:, :first] = compute_blend_weights(body_outfit, differ, machines, count, said, lean)
    for k, part in enumerate(parts, first):
        trait_values[:, k] = part
    return {f"trait/{k}": trait_values[:, 3 * k : 3 * k + 3] for k in range(trait_values.shape[1] // 3)}


def compute_blend_weights(
    body_outfit: BodyOutfit,
    body_traits: BodyTraits,
    machines: Sequence[MachineClips],
    count: int,
    channel_values: Mapping[str, NDArray[Any]],
    lean: NDArray[Any] | None = None,
) -> NDArray[np.float32]:
    """Return the weights of blend-shape targets, float32[n, T], from the clips that agents play and the values of channels.
    `count`: the number of agents n. T: the number of targets."""
    table, groups = make_channel_table(body_outfit.definition)
    plays = (*body_outfit.clips, PlayedClip(body_outfit.definition.idle))
    poses = blend_poses(table, groups, build_machine_playback(table, plays, machines, count, lean))
    return compute_target_weights(body_traits.targets, table.rig, set_pose_channels(table, poses, channel_values).channels)


@lru_cache(maxsize=8)
def make_channel_table(definition: Definition) -> tuple[ClipTable, Mapping[str, TransformGroup]]:
    """Return the sampled clips of a definition, and its transform groups by name."""
    alone = reduce_to_channels(definition)
    return build_clip_table(alone), alone.groups


def pack_clips(clips: MachineClips, loops: NDArray[np.bool_]) -> NDArray[np.uint16]:
    """Return the clips that one machine of n agents plays, uint16[n, 3, k]: numbers, progress and weights.

    k is 2: the clip of the state and the previous one. It is 3 if any agent still plays the clip before these. `loops`: whether
    each clip of the species loops; the entry for "no clip" is False. A clip that does not loop ends with its last sample.
    """
    slots = list(clips.iterate_clip_slots())[::-1]
    if not slots[-1][2].any():
        slots.pop()
    output = np.empty((len(clips.clip), 3, len(slots)), np.uint16)
    for place, (clip, turns, weight) in enumerate(slots):
        known = (clip >= 0) & (clip < len(loops) - 1)
        exact = np.nan_to_num(turns.astype(np.float64))
        again = loops[np.where(known, clip, -1)]
        output[:, 0, place] = np.where(known, clip, NO_CLIP_CODE)
        output[:, 1, place] = np.round(np.where(again, exact - np.floor(exact), np.clip(exact, 0, 1)) * _UINT16_FULL_SCALE)
        output[:, 2, place] = np.round(np.clip(np.nan_to_num(weight), 0, 1) * _UINT16_FULL_SCALE)
    return output


def make_stance_arrays(
    legs: LegIkSolver, feet: PlacedFeet, displayed: Arrays, foot_weights: Floats
) -> dict[str, NDArray[np.int16]]:
    """Return the stances of bodies as integer arrays.

    - `feet` int16[n, L, 3]: the target of each foot joint in 1/4096 of the body length. Axes are forward, up and sideways,
      relative to a body with its trunk at rest.
    - `stance` int16[n, 6]: column 0 is the rise of the trunk in 1/4096 of the body length. Columns 1 to 3 are x, y and z of its
      rotation (32767 is 1). Column 4 is the weight of the feet (32767 is 1). Column 5 has one bit per foot, set while the foot is
      on the ground.
    - `sole` int16[n, L, 3], only of bodies with flat soles: the sideways direction of each sole (32767 is 1) along the same axes.

    `feet`: in mm. `displayed`: the displayed positions and directions of these agents. `foot_weights` [n]: how much the clips
    leave the feet on the ground, from 0 (not at all) to 1.

    Bodies are oriented by the rounded directions that pages receive (three bytes), so that rounding does not shake a standing
    foot."""
    size = np.where(displayed["size"] > 0, displayed["size"], 1).astype(np.float32)
    rise = feet.rise / size * foot_weights
    tilt = feet.tilt * foot_weights[:, None]
    tilt[:, 3] += 1 - foot_weights
    tilt /= np.maximum(np.linalg.norm(tilt, axis=1, keepdims=True), 1e-20)
    stance = np.empty((len(foot_weights), 6), np.int16)
    stance[:, 0] = _quantise_values(rise, _STEPS_PER_BODY_LENGTH)
    stance[:, 1:4] = _quantise_values(tilt[:, :3], _INT16_FULL_SCALE)  # by less than half a turn, so that w is above 0
    stance[:, 4] = _quantise_values(foot_weights, _INT16_FULL_SCALE)
    is_down = feet.is_on_ground[:, :_MAX_FEET_BITS].astype(np.int64)
    stance[:, 5] = (is_down << np.arange(is_down.shape[1])).sum(axis=1)
    away = np.moveaxis(feet.P - displayed["position"][:, None], 2, 0) / size[None, :, None]
    place = _rotate_back(_compute_body_axes(displayed), away)
    place[1] += legs.sole_heights[None] - rise[:, None]
    turn = _make_rotations(tilt)
    goals = _rotate_back(turn, place)
    arrays = {"feet": _quantise_values(goals.transpose(1, 2, 0), _STEPS_PER_BODY_LENGTH), "stance": stance}
    if legs.has_flat_soles:
        normals = np.broadcast_to(np.array([0, 1, 0], np.float32), feet.P.shape) if feet.normals is None else feet.normals
        soles = _rotate_back(turn, np.moveaxis(normals, 2, 0))
        arrays["sole"] = _quantise_values(soles.transpose(1, 2, 0), _INT16_FULL_SCALE)
    return arrays


def _compute_body_axes(displayed: Arrays) -> Floats:
    """Return the forward, up and sideways axes of agents as matrix columns, float32[3, 3, n], exactly as pages compute them."""
    up = normalise_or_fallback(displayed["up"].astype(np.float64), np.array([0.0, 1.0, 0.0])).astype(np.float32)
    ahead = displayed["heading"].astype(np.float32)
    ahead -= up * (ahead * up).sum(axis=1, keepdims=True)
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-20)
    return np.stack([ahead.T, up.T, np.cross(ahead, up).T], axis=1)


def _make_rotations(quaternions: Floats) -> Floats:
    """Return the rotation matrices, float32[3, 3, n], of unit quaternions [n, 4]."""
    x, y, z, w = quaternions.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row) for row in rows]).astype(np.float32)


def _rotate_back(matrices: Floats, points: Floats) -> Floats:
    """Return points, float32[3, n, L], multiplied by the transposes of the matrices [3, 3, n]."""
    x, y, z = points
    return np.stack([(m[0][:, None] * x + m[1][:, None] * y) + m[2][:, None] * z for m in matrices.transpose(1, 0, 2)])


def _quantise_values(values: NDArray[Any], full_scale: int) -> NDArray[np.int16]:
    steps: NDArray[np.int16] = np.clip(np.rint(np.nan_to_num(values) * np.float32(full_scale)), -32767, 32767).astype(np.int16)
    return steps
