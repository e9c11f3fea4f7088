"""Fills a block's tables of addresses and numbers. They contain the memory address of each array that its machine code uses.

Machine code reads eight rows at once, so every array is padded by eight rows (`padded_arrays`). Tables are reused from step to
step. Only entries that may have changed are written again: addresses of arrays that were replaced or copied, and changed numbers.
Births, reordered rows and reloads always create new arrays, so they need no separate check."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from itertools import repeat
from operator import is_not, itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.fields.pheromone import PheromoneField
from antdsl.fields.threshold_cells import CellsNearThreshold
from antdsl.machine_code.memory import get_array_address
from antdsl.numerics import randomness
from antdsl.plan import ir
from antdsl.program.tables.columns import FIXED_COLUMN_BY_NAME
from antdsl.runtime.backends.native.address_layout import AddressKey
from antdsl.runtime.backends.native.block_writer import BlockCodePlan
from antdsl.runtime.backends.native.lane_memory import LaneBufferPool, LaneBuffers
from antdsl.runtime.backends.native.padded_arrays import PaddedArrays, PaddedCopy
from antdsl.runtime.clip_values import find_clip_table_starts, make_clip_table
from antdsl.runtime.moving.clearance.obstacle_clearance import get_obstacle_clearance
from antdsl.runtime.world import Population, World

AddressFinder = Callable[[World, Population], int]
OwnerFinder = Callable[[World, Population], Any]
NamedIndices = list[tuple[str, int]]  # register names, with the indices of their addresses
AddressWords = NDArray[np.int64]


class WatchedArrays:
    """Arrays of one object of the world. When one of them changes its address, the table is updated.

    `find_owner`: returns the object. `get_arrays`: returns its arrays, or an object that changes when they change.
    `write_addresses`: writes the addresses to the table, and may replace arrays by padded ones. It is called if the result of
    `get_arrays` differs from `previous_arrays`."""

    __slots__ = ("find_holder", "get_arrays", "previous_arrays", "write_addresses")

    def __init__(
        self,
        find_owner: OwnerFinder,
        get: Callable[[Any], Iterable[NDArray[Any]]],
        store_words: Callable[[World, Population, Any, AddressWords], None],
    ) -> None:
        self.find_holder, self.get_arrays, self.write_addresses = find_owner, get, store_words
        self.previous_arrays: Iterable[Any] = repeat(None)


class AddressTables:
    """The inputs of one block's machine code: a table of addresses and a table of numbers, which all threads read.

    `lanes`: the memory of each part of the block."""

    def __init__(self, code: BlockCodePlan, padded_arrays: PaddedArrays) -> None:
        self.code, self._padded_arrays = code, padded_arrays
        self.numbers = np.zeros(max(len(code.layout.number_indices), 1), np.int64)
        self.pointers = np.zeros(len(code.layout.pointer_indices), np.int64)
        self.pointers[0] = get_array_address(self.numbers)
        self.lanes = LaneBufferPool(code)
        self.version = 0  # version of the pointers
        self._views = {np.dtype(kind): self.numbers.view(kind) for kind in (np.int64, np.float64, np.float32, np.int32, np.bool_)}
        nodes: list[tuple[ir.PlanNode, int]] = []
        self._draw_entries: dict[tuple[str, str, int], dict[str, int]] = {}  # by species, site and block: the index of each word
        self._number_entries: list[tuple[Callable[[World, str], int | float], str, int]] = []
        for key, place in code.layout.number_indices.items():
            node = key[1] if key[0] == "node" else None
            if isinstance(node, ir.PlanNode):
                nodes.append((node, place))
            elif key[0] == "philox":
                self._draw_entries.setdefault((str(key[1]), str(key[2]), int(str(key[3]))), {})[str(key[4])] = place
            else:
                self._number_entries.append((_NUMBER_GETTERS[str(key[0])], str(key[1]) if len(key) > 1 else "", place))
        self._run_entries = [each for each in nodes if each[0].rate <= ir.UpdateRate.RUN]
        self._step_entries = [each for each in nodes if each[0].rate > ir.UpdateRate.RUN]
        self._written_values: Any = None  # the values from which the `_run_entries` were written
        self._written_seed: int | None = None  # the seed for which words of draws were written
        self._written_numbers: list[int | float | None] = [None] * len(self._number_entries)
        pointers = list(code.layout.pointer_indices.items())
        self._sense_entries = [(int(str(key[1])), key[2], place) for key, place in pointers if key[0] == "kept"]
        self._grid_entries = [
            (int(str(key[1])), str(key[2]), place) for key, place in pointers if key[0] == "grid" and key[2] != "widest"
        ]
        self._written_sources: list[Any] = [None] * (1 + len(code.searches))  # stored senses and grids of the last fill
        groups: dict[AddressKey, list[tuple[AddressKey, int]]] = {}
        self._finder_entries: list[tuple[AddressFinder, int]] = []
        for key, place in pointers:
            holder = self._find_owner_key(key)
            if holder is not None:
                groups.setdefault(holder, []).append((key, place))
            elif key[0] in _FINDER_MAKERS:
                self._finder_entries.append((_FINDER_MAKERS[str(key[0])](self, key), place))
        self._watched_arrays = [self._watch_arrays(holder, keys) for holder, keys in groups.items()]
        self._written_addresses = [0] * len(self._finder_entries)

    def fill_tables(
        self,
        world: World,
        population: Population,
        values: Mapping[ir.PlanNode, Any],
        run_values: Any,
        stored_senses: Any,
        grids: Any,
    ) -> None:
        """Write all entries of both tables, except those that differ between the parts of the block. `values`: by node, the
        values that are equal for all agents. Values that are constant in a run are not written again while `run_values` is the
        same object. `stored_senses`: the arrays of senses that are stored for the step. `grids`: a cell grid for each search."""
        self._update_numbers(world, values, run_values)
        words, changed = self.pointers, False
        for held in self._watched_arrays:
            holder = held.find_holder(world, population)
            if any(map(is_not, held.previous_arrays, held.get_arrays(holder))):
                held.write_addresses(world, population, holder, words)
                held.previous_arrays, changed = held.get_arrays(holder), True
        if stored_senses is not self._written_sources[0]:
            self._written_sources[0], changed = stored_senses, True
            for number, part, place in self._sense_entries:
                has, parts = stored_senses[self.code.lazy_nodes[number]]
                words[place] = get_array_address(has if part == "has" else parts[part])
        for search, grid in enumerate(grids, 1):
            if grid is not self._written_sources[search]:
                self._written_sources[search], changed = grid, True
                for number, name, place in self._grid_entries:
                    if number == search - 1:
                        words[place] = 0 if grid[name] is None else get_array_address(grid[name])
        for number, (find, place) in enumerate(self._finder_entries):
            at = find(world, population)
            if at != self._written_addresses[number]:
                self._written_addresses[number] = words[place] = at
                changed = True
        self.version += changed

    def count_agents_of_largest_species(self, world: World) -> int:
        """Return the number of agents in the largest species that the block searches. 0 if it searches none."""
        return max([len(other) for other in world.populations.values()]) if self.code.searches else 0

    def prepare_lane_buffers(self, parts: int, rows: int, other_count: int) -> list[LaneBuffers]:
        """Return the memories of `parts` parts of a block, for `rows` rows each, with the addresses of these tables.

        `others`: the number of agents in the largest species that is searched."""
        return self.lanes.prepare_lane_buffers(parts, rows, other_count, self.pointers)

    def _update_numbers(self, world: World, values: Mapping[ir.PlanNode, Any], constant_values: Any) -> None:
        """Write the numbers that have changed since the last step to the table."""
        if constant_values is not self._written_values:
            self._written_values = constant_values
            for node, place in self._run_entries:
                self._write_number(place, values[node])
        for node, place in self._step_entries:
            self._write_number(place, values[node])
        if self._draw_entries:
            first, seed = randomness.compute_frame_word(world.frame), world.setting.seed
            for of, words in self._draw_entries.items():
                self.numbers[words["first"]] = first
                if seed != self._written_seed:
                    (_, low, last), (k0, k1) = randomness.build_counters(seed, world.frame, *of)
                    for word, value in (("low", low), ("last", last), ("k0", k0), ("k1", k1)):
                        self.numbers[words[word]] = value
            self._written_seed = seed
        for number, (of_world, name, place) in enumerate(self._number_entries):
            current_value = of_world(world, name)
            if current_value != self._written_numbers[number]:
                self._written_numbers[number] = current_value
                self._write_number(
                    place, np.float64(current_value) if isinstance(current_value, float) else np.int64(current_value)
                )

    def _write_number(self, index: int, value: Any) -> None:
        view = self._views[value.dtype]
        view[index * (8 // value.dtype.itemsize)] = value

    # --- arrays with names in the world: keys grouped by the object that contains them -----------------------------------------

    def _find_owner_key(self, key: AddressKey) -> AddressKey | None:
        """Return the key of the object of the world that contains the array `key`. None if no object contains it."""
        match key[0]:
            case "start" | "now" | "cell":
                return (key[0],)
            case name if name in FIXED_COLUMN_BY_NAME:
                return ("own",)
            case "item" | "field":
                return key[:2]
            case "other" if key[2] not in _SORTED_ID_NAMES:
                return ("other" if key[2] in _FIXED_COLUMN_BY_OTHER_KEY else "start of", key[1])
        return None

    def _watch_arrays(self, owner: AddressKey, keys: list[tuple[AddressKey, int]]) -> WatchedArrays:
        """Return watched arrays of the object with key `owner`. `keys`: the key and the table index of each array."""
        of, names = str(owner[-1]), [(str(key[-1]), place) for key, place in keys]
        match owner[0]:
            case "start" | "now" as when:
                return self._watch_registers(names, start=when == "start")
            case "own":
                return self._watch_mapping(lambda world, population: population.columns, names)
            case "other":
                names = [(_FIXED_COLUMN_BY_OTHER_KEY[name], place) for name, place in names]
                return self._watch_mapping(lambda world, population: world.populations[of].columns, names)
            case "start of":
                return self._watch_mapping(lambda world, population: world.populations[of].start, names)
            case "item":
                return self._watch_mapping(lambda world, population: world.items[of].visible_values, names)
            case "field":
                return _watch_field(of, [(key[2:], place) for key, place in keys])
        return self._watch_mapping(lambda world, population: population.cells, names)

    def _watch_registers(self, names: NamedIndices, *, start: bool) -> WatchedArrays:
        """Return watched registers with these `names`. `start`: whether to watch their values at the start of the step, or the
        current ones."""

        def write_addresses(world: World, population: Population, holder: Any, words: AddressWords) -> None:
            for name, place in names:
                words[place] = self._padded_arrays.pad_register(population, name, start=start)[1]

        find: OwnerFinder = (lambda world, population: population.start) if start else (lambda world, population: population.now)
        return WatchedArrays(find, _make_arrays_getter(names), write_addresses)

    def _watch_mapping(self, find_owner: OwnerFinder, names: NamedIndices) -> WatchedArrays:
        """Return arrays to watch: those with these `names` in the mapping that `find_owner` returns for a population."""

        def write_addresses(world: World, population: Population, holder: Any, words: AddressWords) -> None:
            for name, place in names:
                holder[name], words[place] = self._padded_arrays.pad_array(holder[name])

        return WatchedArrays(find_owner, _make_arrays_getter(names), write_addresses)

    # --- functions for other kinds of keys, which find the address in each step
    # --------------------------------------------------

    def _make_mesh_finder(self, key: AddressKey) -> AddressFinder:
        copy = self._get_padded_copy(key)
        return lambda world, population: copy.update_copy(population.footing.mesh, np.int64)

    def _make_event_finder(self, key: AddressKey) -> AddressFinder:
        """Return a function that returns the address of the event's flags, one per agent.

        For a species that does not handle the event, all flags are False."""
        name = str(key[1])
        if name not in self.code.species.event_names:
            copy = self._get_padded_copy(key)
            return lambda world, population: copy.update_copy(np.zeros(len(population), np.bool_), np.bool_, len(population))

        def find_event_address(world: World, population: Population) -> int:
            population.events[name], place = self._padded_arrays.pad_array(population.events[name])
            return place

        return find_event_address

    def _make_sorted_ids_finder(self, key: AddressKey) -> AddressFinder:
        """Return a function that returns the address of another species' sorted ids, or of the rows of these ids."""
        copy, species, which = self._padded_arrays.get_copy(*key), str(key[1]), key[2] != "sorted ids"

        def find_sorted_ids(world: World, population: Population) -> int:
            other = world.populations[species]
            return copy.update_copy(other.get_sorted_ids()[which], np.int64, (other.version, len(other)))

        return find_sorted_ids

    def _make_clearance_finder(self, key: AddressKey) -> AddressFinder:
        copy, name = self._get_padded_copy(key), str(key[1])
        return lambda world, population: copy.update_copy(get_obstacle_clearance(world, population, name), np.float32)

    def _make_clip_finder(self, key: AddressKey) -> AddressFinder:
        copy, what = self._get_padded_copy(key), str(key[1])
        return lambda world, population: copy.update_derived_copy(world.setting, lambda: make_clip_table(world, population, what))

    def _find_clip_body(self, key: AddressKey) -> AddressFinder:
        """Return a function that returns the address of the result of `clip_values.find_clip_table_starts`."""
        copy = self._get_padded_copy(key)

        def find_clip_table(world: World, population: Population) -> int:
            return copy.update_copy(find_clip_table_starts(world, population), np.int32, (population.version, len(population)))

        return find_clip_table

    def _make_threshold_finder(self, key: AddressKey) -> AddressFinder:
        """Return a function that returns the address of a table of counts. It shows near which cells a field reaches a
        threshold."""
        _, name, count, bound = key
        numbers, place = self._views[np.dtype(np.float32)], 2 * self.code.layout.find_number_index("node", bound)
        reached: CellsNearThreshold | None = None

        def find_threshold_cells(world: World, population: Population) -> int:
            nonlocal reached
            field, least = world.fields[str(name)], numbers[place]
            if reached is None or not reached.has_same_settings(field, least):
                reached = CellsNearThreshold(field, least, int(str(count)))
            return get_array_address(reached.update_counts(world.options.threads))

        return find_threshold_cells

    def _get_padded_copy(self, key: AddressKey) -> PaddedCopy:
        """Return the padded copy that belongs to this species and a key."""
        return self._padded_arrays.get_copy(self.code.species.name, *key)


def _make_arrays_getter(names: NamedIndices) -> Callable[[Any], Iterable[NDArray[Any]]]:
    """Return a function that takes a mapping, and returns its arrays with these names."""
    get_arrays = itemgetter(*(name for name, _ in names))
    return get_arrays if len(names) > 1 else lambda holder: (get_arrays(holder),)


def _watch_field(field_name: str, names: list[tuple[AddressKey, int]]) -> WatchedArrays:
    """Return watched arrays `names` of a field. They are watched by the field's version. They have one entry per cell, so they
    need no padding."""

    def get_version(field: PheromoneField) -> tuple[Any, ...]:
        return field, field.version

    def write_field_addresses(world: World, population: Population, field: PheromoneField, words: AddressWords) -> None:
        for (what, *arguments), place in names:
            if what == "places":
                words[place] = get_array_address(field.sensed_positions)
            else:
                words[place] = get_array_address(
                    field.cells.get_nearest_cells(int(str(arguments[0]))) if arguments else getattr(field, str(what))
                )

    return WatchedArrays(lambda world, population: world.fields[field_name], get_version, write_field_addresses)


def _find_power_of_2_below(count: int) -> int:
    """Return the greatest power of 2 that is less than a count; 0 for counts 0 and 1."""
    return 1 << ((count - 1).bit_length() - 1) if count > 1 else 0


_SORTED_ID_NAMES = frozenset(("sorted ids", "rows of sorted ids"))
_FIXED_COLUMN_BY_OTHER_KEY = {"frame of birth": "born", "unsorted ids": "ids"}  # key of a fixed column of another species
_FINDER_MAKERS: dict[str, Callable[[AddressTables, AddressKey], AddressFinder]] = {
    "mesh": AddressTables._make_mesh_finder,
    "event": AddressTables._make_event_finder,
    "other": AddressTables._make_sorted_ids_finder,
    "clear": AddressTables._make_clearance_finder,
    "clip": AddressTables._make_clip_finder,
    "clip body": AddressTables._find_clip_body,
    "reached": AddressTables._make_threshold_finder,
}
_NUMBER_GETTERS: dict[str, Callable[[World, str], int | float]] = {
    "frame": lambda world, name: world.frame,
    "dt": lambda world, name: float(world.dt),
    "items": lambda world, name: len(world.items[name]),
    "agents": lambda world, name: len(world.populations[name]),
    "half": lambda world, name: _find_power_of_2_below(len(world.populations[name])),
    "turns": lambda world, name: _find_power_of_2_below(len(world.populations[name])).bit_length(),
    "cells": lambda world, name: len(world.fields[name].cells),
    "threads": lambda world, name: world.options.threads,
    "surface": lambda world, name: world.surface_index.get(name, -1),
}
