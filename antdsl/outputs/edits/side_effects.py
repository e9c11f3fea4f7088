"""Finds side effects of edits: agents that overlap or are off the ground because of an edit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.definition import BodyError
from antdsl.bodies.agents.transforms import Floats
from antdsl.bodies.crowd_bodies import compute_collision_size
from antdsl.outputs.cache.cache_reader import Arrays, Cache
from antdsl.outputs.cache.frame_agents import LongArray, get_agent_ids, get_species_numbers, make_agent_keys
from antdsl.outputs.cache.manifest import WornBodyEntry
from antdsl.outputs.cache_bodies import CacheBodies, find_body_numbers
from antdsl.outputs.edits.edited_cache import EditedCache
from antdsl.outputs.edits.frame_rows import SPECIES_PER_KEY, match_rows
from antdsl.outputs.edits.verbs.agent_moves import find_axes
from antdsl.outputs.edits.verbs.terrain import Ground, Terrain
from antdsl.scene.library_bodies import CAPSULE_BY_BODY, find_body_for_species
from antdsl.scene.setting import BodyCapsuleData

EXAMINED_FRAMES = 8  # evenly spaced
_MIN_DEPTH, _MIN_GAP = 0.25, 0.5  # of the smaller width, and body lengths: less is not reported
_GAP_REACH = 50.0  # body lengths in which ground is searched


@dataclass(frozen=True, slots=True, eq=False)
class Trunks:
    """The trunks of the agents in a frame, as capsules.

    `keys`: the agents. `middle` [n, 3], `axis` [n, 3]: the centre and the unit direction of the capsule. `half` [n], `radius`
    [n]: half the length of the axis, and the radius."""

    keys: LongArray
    middle: Floats
    axis: Floats
    half: Floats
    radius: Floats


def describe_side_effects(cache: EditedCache) -> list[str]:
    """Return messages about agents that overlap or are off the ground with the edits of a cache, but not without them.

    Only a sample of frames is examined. An overlap counts from a quarter of the smaller width, a gap from half a body length."""
    examination = SideEffects(cache)
    for _ in examination.examine():
        pass
    return examination.messages


class SideEffects:
    """The side effects of the edits of a cache, found frame by frame. `messages`: messages for users about those found so far."""

    def __init__(self, cache: EditedCache) -> None:
        self._cache = cache
        self._overlaps: dict[tuple[int, int], int] = {}
        self._gaps: dict[int, int] = {}

    @property
    def messages(self) -> list[str]:
        return [*_describe_overlaps(self._cache, self._overlaps), *_describe_gaps(self._cache, self._gaps)]

    def examine(self) -> Iterator[int]:
        """Examine a sample of the frames. Yield the number of each examined frame."""
        cache, frames = self._cache, self._cache.frames()
        count = min(len(frames), EXAMINED_FRAMES)
        chosen = sorted({frames[round(k * (len(frames) - 1) / max(count - 1, 1))] for k in range(count)})
        sizes = [list(iterate_capsules(each)) for each in (cache.original, cache)]
        ground = Ground(cache)
        for number in chosen:
            old, new = cache.original.frame(number), cache.frame(number)
            if any(name not in arrays for arrays in (old, new) for name in ("id", "P", "orient", "pscale")):
                return
            old_trunks, new_trunks = make_trunks(cache.original, old, sizes[0]), make_trunks(cache, new, sizes[1])
            changed = find_changed(old_trunks, new_trunks)
            known = set(find_overlaps(old_trunks, np.ones(len(old_trunks.keys), np.bool_)))
            for pair in find_overlaps(new_trunks, changed):
                if pair not in known:
                    self._overlaps.setdefault(pair, number)
            terrain = ground.at(number)
            for key in _find_gaps(old, new, changed, terrain) if terrain else ():
                self._gaps.setdefault(key, number)
            yield number


def _describe_overlaps(cache: Cache, overlaps: dict[tuple[int, int], int]) -> list[str]:
    if not overlaps:
        return []
    (one, other), frame = next(iter(overlaps.items()))
    pairs = "1 pair of agents overlaps" if len(overlaps) == 1 else f"{len(overlaps):,} pairs of agents overlap"
    return [f"{pairs} because of edits: `{_name_agent(cache, one)}` and `{_name_agent(cache, other)}` in frame {frame}"]


def _describe_gaps(cache: Cache, gaps: dict[int, int]) -> list[str]:
    if not gaps:
        return []
    key, frame = next(iter(gaps.items()))
    agents = "1 agent is" if len(gaps) == 1 else f"{len(gaps):,} agents are"
    return [f"{agents} off the ground because of edits: `{_name_agent(cache, key)}` in frame {frame}"]


def _name_agent(cache: Cache, key: int) -> str:
    return f"{cache.manifest.species[key % SPECIES_PER_KEY].name}.{key // SPECIES_PER_KEY}"


def iterate_capsules(cache: Cache) -> Iterator[list[BodyCapsuleData]]:
    """Yield, for each species, the collision sizes of its bodies."""
    bodies = CacheBodies(cache.manifest, cache.read_static())
    for number, species in enumerate(cache.manifest.species):
        sizes = []
        for which, entry in enumerate(species.bodies or (WornBodyEntry(body=species.body, definition=species.definition),)):
            word = entry.body if entry.body in CAPSULE_BY_BODY else find_body_for_species(species.name)
            try:
                trunk = CAPSULE_BY_BODY[word]
                own = BodyCapsuleData(trunk.length, trunk.width, trunk.height, trunk.forward_offset)
                sizes.append(own if entry.definition is None else compute_collision_size(bodies.definition(number, which)))
            except BodyError:
                sizes.append(own)
        yield sizes


def make_trunks(cache: Cache, arrays: Arrays, sizes: list[list[BodyCapsuleData]]) -> Trunks:
    """Return the trunks of the agents in a frame. `sizes`: for each species, the collision sizes of its bodies."""
    numbers, ids = get_species_numbers(arrays), get_agent_ids(arrays)
    shape = np.zeros((len(ids), 4))
    for number, own in enumerate(sizes):
        rows = np.flatnonzero(numbers == number)
        table = np.array([(each.length, each.width, each.height, each.forward_offset) for each in own])
        shape[rows] = table[np.minimum(find_body_numbers(cache.manifest, number, ids[rows]), len(table) - 1)]
    position, scale = np.asarray(arrays["P"], np.float64), np.asarray(arrays["pscale"], np.float64)
    heading, up = find_axes(np.asarray(arrays["orient"], np.float64))
    length, width, height, ahead = shape.T * scale
    middle = position + up * height[:, None] + heading * ahead[:, None]
    return Trunks(make_agent_keys(arrays), middle, heading, np.maximum(length - width, 0) / 2, width / 2)


def find_changed(old: Trunks, new: Trunks) -> NDArray[np.bool_]:
    """Return a mask of the trunks in `new` that have no counterpart in `old`, or differ from it."""
    at, is_there = match_rows(new.keys, old.keys)
    if not len(old.keys):
        return np.ones(len(new.keys), np.bool_)
    same: NDArray[np.bool_] = (old.middle[at] == new.middle).all(axis=1) & (old.axis[at] == new.axis).all(axis=1)
    is_changed: NDArray[np.bool_] = ~(is_there & same & (old.radius[at] == new.radius))
    return is_changed


def find_overlaps(trunks: Trunks, is_chosen: NDArray[np.bool_], min_depth: float = _MIN_DEPTH) -> Iterator[tuple[int, int]]:
    """Yield pairs of agents that overlap by more than the fraction `min_depth` of the smaller width. At least one of them must be
    chosen."""
    from scipy.spatial import cKDTree

    good = np.flatnonzero(np.isfinite(trunks.middle).all(axis=1) & (trunks.radius > 0))
    if len(good) < 2 or not is_chosen.any():
        return
    reach = float((trunks.half + (1 + max(-min_depth, 0)) * trunks.radius)[good].max())
    pairs = cKDTree(trunks.middle[good]).query_pairs(2 * reach, output_type="ndarray")
    pairs = good[pairs][(is_chosen[good[pairs]]).any(axis=1)] if len(pairs) else np.empty((0, 2), np.intp)
    one, other = pairs[:, 0], pairs[:, 1]
    arm = trunks.axis * trunks.half[:, None]
    distance = measure_segment_distances(trunks.middle[one], arm[one], trunks.middle[other], arm[other])
    depth = trunks.radius[one] + trunks.radius[other] - distance
    is_overlap = depth > min_depth * 2 * np.minimum(trunks.radius[one], trunks.radius[other])
    for first, second in zip(trunks.keys[one[is_overlap]].tolist(), trunks.keys[other[is_overlap]].tolist(), strict=True):
        yield min(first, second), max(first, second)


def measure_segment_distances(a: Floats, u: Floats, b: Floats, v: Floats) -> Floats:
    """Return the distance [n] between each pair of segments: from a - u to a + u, and from b - v to b + v.

    The nearest points on the lines are clamped to the segments, one after the other (C. Ericson, Real-Time Collision Detection,
    2005)."""
    offset, uu, vv, uv = a - b, (u * u).sum(axis=1), (v * v).sum(axis=1), (u * v).sum(axis=1)
    ou, ov = (offset * u).sum(axis=1), (offset * v).sum(axis=1)
    cross = uu * vv - uv * uv
    s = np.clip(np.where(cross > 1e-12, (uv * ov - ou * vv) / np.maximum(cross, 1e-12), 0.0), -1, 1)
    t = np.clip(np.where(vv > 1e-12, (uv * s + ov) / np.maximum(vv, 1e-12), 0.0), -1, 1)
    s = np.clip(np.where(uu > 1e-12, (uv * t - ou) / np.maximum(uu, 1e-12), 0.0), -1, 1)
    between = offset + u * s[:, None] - v * t[:, None]
    distance: Floats = np.sqrt((between * between).sum(axis=1))
    return distance


def _find_gaps(old: Arrays, new: Arrays, changed: NDArray[np.bool_], terrain: Terrain) -> list[int]:
    """Return the keys of the changed agents that are farther from the ground than before."""
    rows = np.flatnonzero(changed)
    keys = make_agent_keys(new)[rows]
    at, is_there = match_rows(keys, make_agent_keys(old))
    heights, length = _measure_heights(new, rows, terrain), np.asarray(new["pscale"], np.float64)[rows]
    old_heights = np.zeros(len(rows))
    old_heights[is_there] = _measure_heights(old, at[is_there], terrain)
    is_off = heights > old_heights + _MIN_GAP * length
    raised_keys: list[int] = keys[is_off & np.isfinite(old_heights)].tolist()
    return raised_keys


def _measure_heights(arrays: Arrays, rows: NDArray[np.intp], terrain: Terrain) -> Floats:
    """Return the distance of each agent from the ground along its up direction. It is inf without ground."""
    position, orient, length = (np.asarray(arrays[name], np.float64)[rows] for name in ("P", "orient", "pscale"))
    hits = terrain.find_along(position, find_axes(orient)[1], 0.5 * length, _GAP_REACH * length)
    offset = position - hits.position
    return np.where(hits.is_hit, np.sqrt((offset * offset).sum(axis=1)), np.inf)
