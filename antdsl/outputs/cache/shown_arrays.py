"""What agents show beside clips, in the frames of a cache, one row an agent of the species, by id.

`wears.SPECIES` uint64: a mask of layers of the body, bit k for layer k of the species' `wears` in the manifest.
`channels.SPECIES.NAME` float32: the value that a state sets, NaN where none does. `looks.SPECIES.GROUP` float32[n, 3]: where the
joints of a transform group look, by the heading, the body's up and what is right of both. `leans.SPECIES` float32[n, 2]: how
much each turns, to the left above 0, and climbs, from -1 to 1, where clips go by that."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.bodies.agents.driving import Driven
from antdsl.bodies.agents.varied_bodies import Draws
from antdsl.numerics.randomness import uniform
from antdsl.outputs.cache import frame_loops
from antdsl.outputs.cache.manifest import SpeciesEntry
from antdsl.runtime.world import Population
from antdsl.scene.setting import CrowdData, Setting

Arrays = Mapping[str, NDArray[Any]]
_AXES = ("x", "y", "z")


def layers_worn(population: Population, setting: Setting) -> tuple[str, ...]:
    """The layers that agents of a species may show beside the body's own: those of its states, then those of the scene."""
    by_scene = (name for crowd in _crowds(population, setting) for part in crowd.wears for name in part if name)
    return tuple(dict.fromkeys((*population.plan.wears, *by_scene)))[: limits.LAYERS_WORN]


def shown(population: Population, setting: Setting, some: NDArray[np.intp] | None = None) -> dict[str, NDArray[Any]]:
    """The arrays of a species: of its agents at some rows, of all by id where none are given."""
    name, now, plan = population.name, population.now, population.plan
    rows = population.in_id_order() if some is None else some
    arrays: dict[str, NDArray[Any]] = {}
    layers = layers_worn(population, setting)
    if layers:
        mask = np.zeros(len(rows), np.uint64)
        for layer in plan.wears:
            _put_on(population, now[f"wear#{layer}"], some, _bit(layers, layer), mask)
        for worn in _by_scene(population, rows, setting, layers):
            mask |= worn
        arrays[f"wears.{name}"] = mask
    for channel in plan.channels:
        said = now[f"channel#{channel}.said"][rows]
        arrays[f"channels.{name}.{channel}"] = np.where(said, now[f"channel#{channel}"][rows], np.float32(np.nan))
    for group in plan.looks:
        parts = [now[f"look#{group}.{axis}"][rows] for axis in _AXES]
        arrays[f"looks.{name}.{group}"] = np.stack(parts, axis=1).astype(np.float32)
    if "lean#turn" in plan.registers:
        arrays[f"leans.{name}"] = np.stack([now["lean#turn"][rows], now["lean#slope"][rows]], axis=1)
    return arrays


def _put_on(
    population: Population, on: NDArray[np.bool_], some: NDArray[np.intp] | None, bit: np.uint64, mask: NDArray[np.uint64]
) -> None:
    """Put a bit into the masks of the agents who have it on: of those at some rows, of all by id where none are given."""
    if some is None:
        frame_loops.worn(on, population.ranks(), bit.view(np.int64), mask.view(np.int64))
    else:
        mask |= np.where(on[some], bit, np.uint64(0))


def worn_masks(species: SpeciesEntry, arrays: Arrays, count: int) -> NDArray[np.uint64]:
    """The mask of each of `count` agents of a species in a frame; nobody wears anything where the frame does not say."""
    found = arrays.get(f"wears.{species.name}")
    if not species.wears or found is None or found.shape != (count,):
        return np.zeros(count, np.uint64)
    return np.asarray(found, np.uint64) & np.uint64((1 << len(species.wears)) - 1)


def layers_of(species: SpeciesEntry, mask: int) -> tuple[str, ...]:
    """The layers of a mask."""
    return tuple(layer for k, layer in enumerate(species.wears) if mask >> k & 1)


def driven(species: SpeciesEntry, arrays: Arrays, ids: NDArray[np.int64], seed: int) -> Driven:
    """What states say of channels and looks in a frame, for the agents of a species by id, and what their bodies differ by; what
    the frame has not is left out."""
    count = len(ids)
    channels = {name: arrays.get(f"channels.{species.name}.{name}") for name in species.channels}
    looks = {name: arrays.get(f"looks.{species.name}.{name}") for name in species.looks}
    lean = arrays.get(f"leans.{species.name}")
    return Driven(
        {name: np.asarray(v, np.float32) for name, v in channels.items() if v is not None and v.shape == (count,)},
        {name: np.asarray(v, np.float32) for name, v in looks.items() if v is not None and v.shape == (count, 3)},
        Draws(ids, seed, species.name),
        None if lean is None or lean.shape != (count, 2) else np.asarray(lean, np.float32),
    )


def _crowds(population: Population, setting: Setting) -> Iterator[CrowdData]:
    return (crowd for crowd in setting.crowds if crowd.species == population.name)


def _by_scene(
    population: Population, rows: NDArray[np.intp], setting: Setting, layers: tuple[str, ...]
) -> Iterator[NDArray[np.uint64]]:
    """What the scene dresses agents in: of each part one layer, drawn by the agent's id and the scene's seed for its whole life;
    those who are born wear what the line of their parent says."""
    crowds = [crowd for crowd in _crowds(population, setting) if crowd.wears]
    if not crowds:
        return
    group, ids = population.now["group"][rows], population.ids[rows]
    for crowd in crowds:
        for k, part in enumerate(crowd.wears):
            bits = np.array([_bit(layers, layer) for layer in part], np.uint64)
            drawn = uniform(setting.seed, 0, population.name, f"wear {crowd.group} {k}", 0, ids)
            which = np.minimum((drawn * np.float32(len(part))).astype(np.intp), len(part) - 1)
            yield np.where(group == crowd.group, bits[which], np.uint64(0))


def _bit(layers: tuple[str, ...], layer: str) -> np.uint64:
    return np.uint64(1 << layers.index(layer)) if layer in layers else np.uint64(0)
