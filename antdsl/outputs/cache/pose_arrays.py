"""Arrays for poses in the frames of a cache: clips, layers, channels, looks, leans and feet.

Each row is an agent of the species, by id. Indices of clips count the species' clips in the manifest; -1 means no clip.

`clips.SPECIES.MACHINE.FIELD`: the clips that a machine plays.
`clip` int16: the current clip. `before` int16: the clip that fades out.
`earlier` int16: the clip that was still fading out when `before` began to.
`turns`, `weight`, `fade` and similar fields are float32.
Fields about `earlier` are only in frames in which at least one agent has an earlier clip.

`wears.SPECIES` uint64: a mask of body layers; bit k stands for layer k of the species' `wears` in the manifest.
`channels.SPECIES.NAME` float32: the value that a state sets; NaN if no state sets it.
`looks.SPECIES.GROUP` float32[n, 3]: where the joints of a transform group look. The axes are the heading, the body's up and
the right of both.
`leans.SPECIES` float32[n, 2]: turning (left is above 0) and climbing, from -1 to 1. Present if clips depend on them.

`feet.SPECIES.FIELD`: the feet, with L legs in the order of the body. Agents of a species with several bodies are in the arrays
`feet.SPECIES#0.FIELD`, `feet.SPECIES#1.FIELD` and so on of their bodies.
`P` float32[n, L, 3]: position of each foot in scene units, on the ground or in swing.
`down` uint8[n, L]: 1 for feet on the ground.
`phase` float32[n]: the phase of the gait.
`rise` float32[n]: height of the trunk above its rest height, in scene units.
`tilt` float32[n, 4]: rotation of the trunk relative to `orient`, as a quaternion x, y, z, w.
`normal` float32[n, L, 3]: the direction across each sole, ahead, up and right of the body, if the body has ankles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.bodies.agents.driving import PoseAdjustments
from antdsl.bodies.agents.leg_ik import PlacedFeet
from antdsl.bodies.agents.machine_clips import EARLIER_CLIP_FIELDS, MachineClips
from antdsl.bodies.agents.varied_bodies import VariationDraws
from antdsl.numerics import parallel
from antdsl.numerics.randomness import draw_uniform
from antdsl.outputs.cache import frame_loops
from antdsl.outputs.cache.manifest import SpeciesEntry
from antdsl.program.tables.columns import CLIP_COLUMNS, STANCE_COLUMNS
from antdsl.runtime.feet.soles import compute_local_soles
from antdsl.runtime.feet.wearers import compute_crouch_lowering
from antdsl.runtime.world import Population, World
from antdsl.scene.setting import CrowdData, WorldSetting

_AXES = ("x", "y", "z")
_SOLE_FIELD = "normal"  # of feet, only in frames of bodies with flat soles
Arrays = Mapping[str, NDArray[Any]]
# By field, the register behind `MACHINE.` and its type in a frame.
_REGISTER_BY_FIELD = {each.field: ("clip" if each.field == "clip" else f"clip_{each.field}", each.type) for each in CLIP_COLUMNS}
_USUAL_FIELDS = tuple(field for field in _REGISTER_BY_FIELD if field not in EARLIER_CLIP_FIELDS)
_CLIP_FIELDS, _SHARE_FIELDS = ("clip", "before"), ("turns", "weight", "before_turns", "before_weight", "fade")


def list_playing_machines(population: Population) -> Iterator[str]:
    """Yield the names of the machines that play clips, in the order of the source."""
    return (machine.name for machine in population.plan.machines if f"{machine.name}.clip" in population.plan.registers)


def make_clip_arrays(population: Population, threads: int = 1) -> dict[str, NDArray[Any]]:
    """Return the `clips` arrays of a species, sorted by id. They include the earlier clip if any agent has one."""
    arrays: dict[str, NDArray[Any]] = {}
    for machine in list_playing_machines(population):
        now = {field: population.now[f"{machine}.{register}"] for field, (register, _) in _REGISTER_BY_FIELD.items()}
        values = {field: np.empty(len(population), _REGISTER_BY_FIELD[field][1]) for field in _USUAL_FIELDS}
        of = [tuple([each[field] for field in names]) for each in (now, values) for names in (_CLIP_FIELDS, _SHARE_FIELDS)]
        work = partial(frame_loops.write_playing_clips, of[0], of[1], population.compute_id_ranks(), of[2], of[3])
        parallel.run_in_parts(work, len(population), threads)
        early = now["earlier_fade"] > 0
        if early.any() and (early & (now["fade"] > 0)).any():
            rows = population.get_rows_by_id()
            values |= {
                field: now[field].take(rows).astype(_REGISTER_BY_FIELD[field][1], copy=False) for field in EARLIER_CLIP_FIELDS
            }
        arrays |= {f"clips.{population.name}.{machine}.{field}": array for field, array in values.items()}
    return arrays


def read_machine_clips(species: str, machine: str, arrays: Arrays, count: int) -> MachineClips | None:
    """Return the clips that a machine plays, for `count` agents. None if the arrays do not contain them."""
    named = f"clips.{species}.{machine}."
    parts = {field: _find_array(arrays, named + field, kind, count) for field, (_, kind) in _REGISTER_BY_FIELD.items()}
    if any(parts[field] is None for field in _USUAL_FIELDS):
        return None
    return MachineClips(**{field: None if part is None else np.nan_to_num(part) for field, part in parts.items()})  # type: ignore[arg-type]


def _find_array(arrays: Arrays, name: str, kind: str, *shape: int) -> NDArray[Any] | None:
    """Return the array with this name, type and shape from a frame, or None."""
    array = arrays.get(name)
    return None if array is None or array.shape != shape else np.asarray(array, kind)


def read_all_machine_clips(species: SpeciesEntry, arrays: Arrays, count: int) -> tuple[MachineClips, ...] | None:
    """Return the clips that each machine of a species plays, for `count` agents. None if the frame does not contain them."""
    clips = [read_machine_clips(species.name, machine, arrays, count) for machine in species.playing]
    return None if any(each is None for each in clips) else tuple(each for each in clips if each is not None)


def make_feet_arrays(world: World, key: str, scale: float) -> dict[str, NDArray[Any]]:
    """Return the `feet` arrays of the agents that have the body `key`. Empty if feet are not computed.

    `scale`: scene units per millimetre."""
    feet = world.feet.get(key)
    if feet is None:
        return {}
    n, legs = len(feet), feet.legs
    values, ranks = (
        {
            each.field: np.empty((n, *each.compute_dimensions(legs=legs)), each.type)
            for each in STANCE_COLUMNS
            if feet.soles or each.field != _SOLE_FIELD
        },
        feet.compute_id_ranks(),
    )
    of = parallel.make_contiguous(
        feet.shown.swapaxes(1, 2), feet.swing.T, feet.rise, feet.slope
    )  # arrays with legs before agents
    outputs = values["P"].reshape(n, 3 * legs), values["down"], values["rise"], values["tilt"]
    parallel.run_in_parts(partial(frame_loops.write_feet, *of, ranks, scale, *outputs), n, world.options.threads)
    values["phase"][ranks] = feet.phase
    lowering = compute_crouch_lowering(world, key)
    if lowering is not None:
        values["rise"] -= lowering * np.float32(scale)
    if feet.soles:
        values[_SOLE_FIELD][ranks] = compute_local_soles(feet)
    return {f"feet.{key}.{name}": array for name, array in values.items()}


def read_feet(key: str, arrays: Arrays, count: int, legs: int) -> PlacedFeet | None:
    """Return the feet of the `count` agents that have the body `key`, with `legs` legs each. None if the frame does not contain
    them."""
    parts = {
        each.field: _find_array(arrays, f"feet.{key}.{each.field}", each.type, count, *each.compute_dimensions(legs=legs))
        for each in STANCE_COLUMNS
    }
    is_complete = all(part is not None or field == _SOLE_FIELD for field, part in parts.items())
    return PlacedFeet(*parts.values()) if legs and is_complete else None  # type: ignore[arg-type]


def list_wearable_layers(population: Population, setting: WorldSetting) -> tuple[str, ...]:
    """Return the layers that agents may wear: first those that states show, then those that the scene gives."""
    by_scene = (
        name for crowd in _find_species_crowds(population, setting) for part in crowd.worn_layers for name in part if name
    )
    return tuple(dict.fromkeys((*population.plan.worn_layers, *by_scene)))[: limits.MAX_WORN_LAYERS]


def make_display_arrays(population: Population, setting: WorldSetting) -> dict[str, NDArray[Any]]:
    """Return the arrays `wears`, `channels`, `looks` and `leans` of a species, in order of id."""
    name, now, plan, rows = population.name, population.now, population.plan, population.get_rows_by_id()
    arrays: dict[str, NDArray[Any]] = {}
    layers = list_wearable_layers(population, setting)
    if layers:
        mask = np.zeros(len(rows), np.uint64)
        for layer in plan.worn_layers:
            mark_layer(population, now[f"wear#{layer}"], _make_layer_bit(layers, layer), mask)
        for worn in _draw_scene_layer_masks(population, rows, setting, layers):
            mask |= worn
        arrays[f"wears.{name}"] = mask
    for channel in plan.channels:
        said = now[f"channel#{channel}.said"][rows]
        arrays[f"channels.{name}.{channel}"] = np.where(said, now[f"channel#{channel}"][rows], np.float32(np.nan))
    for group in plan.look_groups:
        parts = [now[f"look#{group}.{axis}"][rows] for axis in _AXES]
        arrays[f"looks.{name}.{group}"] = np.stack(parts, axis=1).astype(np.float32)
    if "lean#turn" in plan.registers:
        arrays[f"leans.{name}"] = np.stack([now["lean#turn"][rows], now["lean#slope"][rows]], axis=1)
    return arrays


def mark_layer(population: Population, is_worn: NDArray[np.bool_], bit: np.uint64, mask: NDArray[np.uint64]) -> None:
    """Set `bit` in the masks of the agents that wear a layer. `is_worn` is in the order of rows, `mask` in the order of ids."""
    frame_loops.mark_worn_layer(is_worn, population.compute_id_ranks(), bit.view(np.int64), mask.view(np.int64))


def read_layer_masks(species: SpeciesEntry, arrays: Arrays, count: int) -> NDArray[np.uint64]:
    """Return the layer mask of each of `count` agents. All are 0 if the frame contains no masks."""
    masks = _find_array(arrays, f"wears.{species.name}", "u8", count)
    if not species.wears or masks is None:
        return np.zeros(count, np.uint64)
    return masks & np.uint64((1 << len(species.wears)) - 1)


def list_mask_layers(species: SpeciesEntry, mask: int) -> tuple[str, ...]:
    """Return the names of the layers that a mask contains."""
    return tuple(layer for k, layer in enumerate(species.wears) if mask >> k & 1)


def read_driven_pose(species: SpeciesEntry, arrays: Arrays, ids: NDArray[np.int64], seed: int) -> PoseAdjustments:
    """Return what changes the poses of the agents `ids` in a frame: channels and looks that states set, and variation between
    bodies.

    Data that the frame does not contain is omitted."""
    of, count = species.name, len(ids)
    channels = {name: _find_array(arrays, f"channels.{of}.{name}", "f4", count) for name in species.channels}
    looks = {name: _find_array(arrays, f"looks.{of}.{name}", "f4", count, 3) for name in species.looks}
    joints = {name: _find_array(arrays, f"joints.{of}.{name}", "f4", count, 7) for name in species.joints}
    return PoseAdjustments(
        {name: values for name, values in channels.items() if values is not None},
        {name: values for name, values in looks.items() if values is not None},
        VariationDraws(ids, seed, of),
        _find_array(arrays, f"leans.{of}", "f4", count, 2),
        {name: values for name, values in joints.items() if values is not None},
    )


def _find_species_crowds(population: Population, setting: WorldSetting) -> Iterator[CrowdData]:
    """Yield the crowd lines of the scene that create agents of a species."""
    return (crowd for crowd in setting.crowds if crowd.species == population.name)


def _draw_scene_layer_masks(
    population: Population, rows: NDArray[np.intp], setting: WorldSetting, layers: tuple[str, ...]
) -> Iterator[NDArray[np.uint64]]:
    """Yield masks of the layers that the scene gives to agents: one array for each part of the body, with at most one layer per
    agent.

    Layers depend on the agent's id and the scene's seed, and do not change during its life. Agents born later use the crowd line
    of their parent."""
    crowds = [crowd for crowd in _find_species_crowds(population, setting) if crowd.worn_layers]
    if not crowds:
        return
    group, ids = population.now["group"][rows], population.ids[rows]
    for crowd in crowds:
        for k, part in enumerate(crowd.worn_layers):
            bits = np.array([_make_layer_bit(layers, layer) for layer in part], np.uint64)
            drawn = draw_uniform(setting.seed, 0, population.name, f"wear {crowd.line_index} {k}", 0, ids)
            which = np.minimum((drawn * np.float32(len(part))).astype(np.intp), len(part) - 1)
            yield np.where(group == crowd.line_index, bits[which], np.uint64(0))


def _make_layer_bit(layers: tuple[str, ...], layer: str) -> np.uint64:
    """Return the mask that contains only `layer`; 0 if the body does not have this layer."""
    return np.uint64(1 << layers.index(layer)) if layer in layers else np.uint64(0)
