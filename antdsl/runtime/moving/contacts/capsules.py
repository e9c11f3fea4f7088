"""Bodies as capsules: the trunks of all agents, and the distances between them.

A capsule is a segment along the heading, with a radius, at the height of the trunk above the feet. The distance of two
capsules is measured in the plane perpendicular to their mean up direction, and separately along this direction. So neither
slopes nor bodies above each other produce an overlap."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import elementary, parallel, randomness
from antdsl.numerics import vectors as vec
from antdsl.numerics.periodic_box import PeriodicBox
from antdsl.runtime.body_positions import compute_body_positions
from antdsl.runtime.body_rows import group_rows_by_body
from antdsl.runtime.moving.contacts.capsule_distances import (
    NEVER_TILTED_COSINE,
    NO_PERIOD,
    TILTED_COSINE,
    CapsuleArrays,
    CapsuleShape,
    CrowdCapsules,
    TrunkCapsules,
    gather_capsules,
    make_empty_partial_bounds,
    measure_pairs_before_step,
    measure_pairs_of_changed_rows,
    place_trunks,
    select_touching_pairs,
)
from antdsl.runtime.moving.contacts.loads import LOAD_REGISTER, extend_trunks_over_loads
from antdsl.runtime.moving.crouching import compute_lowering, has_crouch
from antdsl.runtime.world import AXES, Population, World
from antdsl.scene.crowds.body_choice import find_species_of_key
from antdsl.scene.library_bodies import (
    CAPSULE_BY_BODY,
    COMPLETE_CAPSULE_BY_BODY,
    LOAD_FRONT_BY_BODY,
    TrunkCapsule,
    find_body_for_species,
)
from antdsl.senses.touching import Bounds, find_touching_pairs

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]
Flags = NDArray[np.bool_]

_PAIR_ID_MULTIPLIER = 0x9E3779B1  # an odd multiplier that combines two ids into one key
_SPECIES_KEY_STEP = 1 << 40  # larger than any id of a species
_GROUND_GAP = 0.05  # body lengths; least distance of a whole body from level ground


def find_capsule(world: World, key: str) -> TrunkCapsule:
    """Return the capsule of a body. If the body has its own file, the shape comes from there. Otherwise it comes from a library
    body: the one named in the species' first crowd line, or else the one for the species' name. The capsule of a complete body is
    raised if it would touch the ground below its feet."""
    own, species = world.setting.body_capsules.get(key), find_species_of_key(key)
    is_whole = world.plan.species[species].has_whole_body
    if own is not None:
        capsule = TrunkCapsule(own.length, own.width, own.height, own.forward_offset)
    else:
        capsule = (COMPLETE_CAPSULE_BY_BODY if is_whole else CAPSULE_BY_BODY)[_find_library_body(world, species)]
    return replace(capsule, height=max(capsule.height, capsule.width / 2 + _GROUND_GAP)) if is_whole else capsule


def _find_library_body(world: World, species: str) -> str:
    """Return the name of the library body that a species uses."""
    bodies = (crowd.body for crowd in world.setting.crowds if crowd.species == species and crowd.body)
    return next(bodies, None) or find_body_for_species(species)


def _find_load_front(world: World, species: str) -> float | None:
    """Return how far (body lengths) a carried load extends ahead of the feet; None if agents of the species carry no loads
    with a size."""
    if world.setting.body_capsules.get(species) is not None or not world.plan.species[species].has_whole_body:
        return None
    return LOAD_FRONT_BY_BODY.get(_find_library_body(world, species))


class CapsuleCrowd:
    """The capsules of all agents of a world, species by species. Each property returns one array for the complete crowd, with the
    values at the time of access. With `start`, these are the values at the start of the step."""

    def __init__(self, world: World, start: bool = False) -> None:
        self.world, self._start = world, start
        self.species = [population for population in world.populations.values() if len(population)]
        self.species = self.species or list(world.populations.values())[:1]  # without agents, arrays have no rows
        self.first = np.array([*accumulate(map(len, self.species), initial=0)], np.intp)
        self.agent_keys = self.concatenate_species(
            lambda p: p.ids + k * _SPECIES_KEY_STEP if (k := self.species.index(p)) else p.ids
        )
        is_whole = any([world.plan.species[each.name].has_whole_body for each in self.species])
        self.tilted_cosine = TILTED_COSINE if is_whole else NEVER_TILTED_COSINE
        self.period = NO_PERIOD if world.periodic is None else world.periodic.box.inverse_table
        self.bounds = self._place_capsules()  # bounds of x, y and z of the middles, and of the reach

    def _place_capsules(self) -> Bounds | None:
        """Compute the capsules of each species. Return the bounds of all capsules; None if they are unknown because agents
        carry loads."""
        self.half, self.radius, self.ahead, self.reach = np.empty((4, len(self)))
        self.middle = np.empty((3, len(self)))
        has_loads = False
        capsules, extremes = (
            TrunkCapsules(self.half, self.radius, self.ahead, self.reach, self.middle),
            make_empty_partial_bounds(),
        )
        bounds: Any = ()
        for population, first in zip(self.species, self.first.tolist(), strict=False):
            own = self._select_registers(population)
            place = np.ascontiguousarray(compute_body_positions(population).T)
            stands = (place, vec.get_vector_registers(own, "heading"), vec.get_vector_registers(own, "up"), own["size"])
            for key, rows in group_rows_by_body(population, self.world.setting):
                capsule = find_capsule(self.world, key)
                shape = CapsuleShape(*map(float, (capsule.length, capsule.width, capsule.height, capsule.forward_offset)))
                if has_crouch(population):
                    stands = (_lower_trunks(population, place, own, capsule), *stands[1:])
                if rows is None:
                    bounds = place_trunks(*stands, shape, first, capsules, extremes)
                else:
                    bounds = _place_trunks_of_rows(stands, rows, shape, first, capsules, extremes)
            front = _find_load_front(self.world, population.name)
            if front is not None and LOAD_REGISTER in own:
                has_loads |= extend_trunks_over_loads(own[LOAD_REGISTER], stands[1], own["size"], front, first, capsules)
        return None if has_loads else list(zip(bounds[:4], bounds[4:], strict=True))

    def __len__(self) -> int:
        return int(self.first[-1])

    def concatenate_species(self, read_column: Callable[[Population], NDArray[Any]], row_axis: int = 0) -> NDArray[Any]:
        """Apply `read_column` to each species, and return the results concatenated along an axis."""
        arrays = [read_column(population) for population in self.species]
        return arrays[0] if len(arrays) == 1 else np.concatenate(arrays, axis=row_axis)

    def split_rows(self, rows: Rows) -> Iterator[tuple[Population, Rows]]:
        """Yield each species with those of the given rows that belong to it. `rows`: ascending rows of the crowd. The yielded
        rows are relative to the first agent of the species."""
        if len(self.species) == 1:
            yield self.species[0], rows
            return
        bounds, firsts = np.searchsorted(rows, self.first).tolist(), self.first.tolist()
        for population, begin, end, first in zip(self.species, bounds, bounds[1:], firsts, strict=False):
            yield population, rows[begin:end] - first if first else rows[begin:end]

    @property
    def capsules(self) -> CrowdCapsules:
        """Return the capsules for kernels, with the current directions of their axes."""
        axes = self.read_vector("heading"), self.read_vector("up")
        return CrowdCapsules(self.middle, *axes, self.half, self.radius, self.period, self.tilted_cosine)

    def read_vector(self, name: str) -> vec.VectorArrays:
        """Return the three components of the vector register `name`. Each is one array over all species."""
        x, y, z = (self.concatenate_species(lambda p, axis=axis: self._select_registers(p)[f"{name}.{axis}"]) for axis in AXES)  # type: ignore[misc]
        return x, y, z

    def _select_registers(self, population: Population) -> dict[str, NDArray[Any]]:
        return population.start if self._start else population.now


def _lower_trunks(population: Population, place: Floats, registers: Mapping[str, NDArray[Any]], capsule: TrunkCapsule) -> Floats:
    """Return the positions (3, n) mm, lowered for crouching bodies, at which trunks are placed.

    A trunk stays above the ground. It is lowered by at most its radius, so that the legs of bodies next to it do not enter it."""
    most = np.float32(min(capsule.width / 2, max(capsule.height - capsule.width / 2, 0.0)))
    lowering = np.minimum(compute_lowering(population), np.maximum(registers["size"], np.float32(0)) * most)
    lowered: Floats = place - np.stack(vec.get_vector_registers(registers, "up")) * lowering
    return lowered


def _place_trunks_of_rows(
    stances: tuple[Floats, vec.VectorArrays, vec.VectorArrays, NDArray[np.float32]],
    rows: Rows,
    shape: CapsuleShape,
    first_index: int,
    capsules: TrunkCapsules,
    partial_bounds: Floats,
) -> Any:
    """Compute the capsules of some rows of a species, and store them from index `first_index` on.

    The result is that of `place_trunks`."""
    place, heading, up, size = stances
    half, radius, ahead, reach = np.empty((4, len(rows)))
    subset = TrunkCapsules(half, radius, ahead, reach, np.empty((3, len(rows))))
    own = np.ascontiguousarray(place.take(rows, axis=1)), vec.take_rows(heading, rows), vec.take_rows(up, rows), size.take(rows)
    bounds = place_trunks(*own, shape, 0, subset, partial_bounds)
    for column, part in zip(capsules, subset, strict=True):
        column[..., first_index + rows] = part
    return bounds


@dataclass(frozen=True, slots=True, eq=False)
class NearbyCapsulePairs:
    """Pairs of capsules that are near each other. Lengths are in mm.

    - `rows`: ascending rows of the crowd that occur in a pair.
    - `first_indices`, `second_indices`: the indices in `rows` of the two agents of each pair. The first agent comes before the
      second by species and id.
    - `middle`, `axis_directions`, `up` (3, k); `half_lengths`, `radius` (k): the capsule of each row at the time when the
      pairs were listed. `max_radius`: the largest radius.
    - `gap` (m): the last measured distance between the surfaces of each pair; negative if they overlap.
    - `direction` (3, m): last measured separation axis, a unit vector from the second agent to the first.
    - `tilted_cosine`: as in `CapsuleArrays`."""

    crowd: CapsuleCrowd
    rows: Rows
    first_indices: Rows
    second_indices: Rows
    middle: Floats
    axis_directions: Floats
    up: Floats
    half_lengths: Floats
    radius: Floats
    max_radius: float
    gap: Floats
    direction: Floats
    period: Floats = field(default_factory=lambda: NO_PERIOD)  # as in `CapsuleArrays`
    tilted_cosine: float = NEVER_TILTED_COSINE

    @property
    def capsules(self) -> CapsuleArrays:
        """Return the capsules of the rows for kernels."""
        return CapsuleArrays(
            self.middle, self.axis_directions, self.up, self.half_lengths, self.radius, self.period, self.tilted_cosine
        )

    def measure_before_step(self, travel: Floats) -> tuple[Floats, Floats, Floats]:
        """Measure all pairs before the rows move by `travel` (3, k) mm, with current headings. Return the gaps, the separation
        axes, and the greatest overlap (k) mm of each row."""
        pairs, rows = len(self.first_indices), len(self.rows)
        gap, direction, depth, lost = np.empty(pairs), np.empty((3, pairs)), np.empty(rows), np.empty(pairs, np.intp)
        count = measure_pairs_before_step(
            self.capsules, travel, self.first_indices, self.second_indices, gap, direction, depth, lost
        )
        self.draw_missing_axes(direction, lost[:count])
        return gap, direction, depth

    def measure_gaps(self, displacement: Floats, changed_rows: Flags) -> None:
        """Measure all pairs with a row in `changed_rows` (k), for rows displaced by `displacement` (3, k) mm."""
        pair_numbers, lost = np.empty((2, len(self.first_indices)), np.intp)
        count = measure_pairs_of_changed_rows(
            self.capsules,
            displacement,
            self.first_indices,
            self.second_indices,
            changed_rows,
            self.gap,
            self.direction,
            pair_numbers,
            lost,
        )
        self.draw_missing_axes(self.direction, lost[:count])

    def draw_missing_axes(self, direction: Floats, pair_indices: Rows) -> None:
        """Draw random separation axes (3, m) for pairs with equal positions. An axis is parallel to the ground of the first
        agent, and depends only on the seed and both ids."""
        if not len(pair_indices):
            return
        crowd, i, j = self.crowd, self.first_indices.take(pair_indices), self.second_indices.take(pair_indices)
        first, second = (crowd.agent_keys.take(self.rows.take(k)) for k in (i, j))
        kinds = (first // _SPECIES_KEY_STEP) * len(crowd.species) + second // _SPECIES_KEY_STEP
        turn = np.empty(len(i), np.float32)
        for kind in np.unique(kinds):
            subset = np.flatnonzero(kinds == kind)
            one, other = (crowd.species[number].name for number in divmod(int(kind), len(crowd.species)))
            ids = (first[subset] % _SPECIES_KEY_STEP) * _PAIR_ID_MULTIPLIER + second[subset] % _SPECIES_KEY_STEP
            turn[subset] = randomness.draw_uniform(crowd.world.setting.seed, 0, one, f"parts from {other}", 0, ids)
        angle = turn * np.float32(2 * np.pi)
        normal = self.up.take(i, axis=1)
        side = np.stack(vec.find_perpendicular((normal[0], normal[1], normal[2])))
        direction[:, pair_indices] = side * elementary.cos(angle) + vec.compute_stacked_cross(normal, side) * elementary.sin(
            angle
        )


def find_near_pairs(crowd: CapsuleCrowd, dead_zone_share: float | None = None) -> NearbyCapsulePairs:
    """Return the pairs of a crowd that may touch. With `dead_zone_share`, return only pairs with a row that overlaps another
    row by more than this fraction of the sum of both radii."""
    x, y, z = crowd.middle
    if crowd.world.periodic is None:
        pairs = find_touching_pairs((x, y, z), crowd.reach, crowd.agent_keys, crowd.bounds)
        i, j = parallel.make_contiguous(pairs.i, pairs.j)
    else:
        i, j = _find_pairs_of_images(crowd, crowd.world.periodic.box)
    m = len(i)
    gap, direction, known = np.empty(m), np.empty((3, m)), np.empty(m, np.intp)
    rows, number = np.empty((2, len(crowd)), np.intp)
    stand = crowd.capsules
    every = (True, 0.0) if dead_zone_share is None else (False, dead_zone_share)
    m, count, lost, widest = select_touching_pairs(stand, crowd.agent_keys, i, j, gap, direction, known, rows, number, *every)
    rows, (middle, ahead, up), (half, radius) = rows[:count], np.empty((3, 3, count)), np.empty((2, count))
    shared = crowd.period, crowd.tilted_cosine
    own = CapsuleArrays(middle, ahead, up, half, radius, *shared)
    gather_capsules(rows, stand, own)
    near = NearbyCapsulePairs(
        crowd, rows, i[:m], j[:m], *own[:5], widest, gap[:m], np.ascontiguousarray(direction[:, :m]), *shared
    )
    near.draw_missing_axes(near.direction, known[:lost])
    return near


def _find_pairs_of_images(crowd: CapsuleCrowd, box: PeriodicBox) -> tuple[Rows, Rows]:
    """Return the rows of all pairs of agents in reach of each other in a periodic world. Each pair occurs once."""
    x, y, z = crowd.middle
    widest = float(np.max(crowd.reach, initial=0.0, where=np.isfinite(crowd.reach)))
    sources, position = box.find_image_rows((x, y, z), 2 * widest)
    order = np.empty(len(sources), np.int64)
    order[np.lexsort((np.arange(len(sources)), crowd.agent_keys.take(sources)))] = np.arange(len(sources))
    pairs = find_touching_pairs((position[0], position[1], position[2]), crowd.reach.take(sources), order)
    i, j = sources.take(pairs.i), sources.take(pairs.j)
    # A pair at the seam occurs for several images of both.
    pair_rows = np.stack([np.minimum(i, j), np.maximum(i, j)], axis=1)[i != j]
    distinct = np.unique(pair_rows, axis=0)
    return np.ascontiguousarray(distinct[:, 0]), np.ascontiguousarray(distinct[:, 1])


def measure_overlap_depths(world: World) -> Floats:
    """Return each agent's greatest penetration depth, in widths of its trunk; 0 without overlap. The result is float64[n], with
    the agents of one species after those of the other."""
    crowd = CapsuleCrowd(world)
    near = find_near_pairs(crowd)
    depth = np.zeros(len(crowd))
    depth[near.rows] = find_greatest_depths(len(near.rows), near.first_indices, near.second_indices, near.gap) / (2 * near.radius)
    return depth


def find_greatest_depths(count: int, first_indices: Rows, second_indices: Rows, gap: Floats) -> Floats:
    """Return the greatest overlap (mm) of each row, computed from the gaps of its pairs. It is 0 for rows without overlap."""
    depth, inside = np.zeros(count), np.flatnonzero(gap < 0)
    for k in (first_indices.take(inside), second_indices.take(inside)):
        np.maximum.at(depth, k, -gap.take(inside))
    return depth
