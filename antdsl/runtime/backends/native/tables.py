"""Fills a block's tables of addresses and numbers: the memory address of each array of the world that its machine code uses.

Machine code reads eight rows at once, so every array is padded by eight rows (`rooms`). Tables are reused from step to step,
and only entries that may have changed are written again. These are addresses of named arrays that were replaced, copies made
in each step, and changed numbers. Births, reordered rows and reloads create new arrays, so they are noticed in the same
manner."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from itertools import repeat
from operator import is_not, itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.fields.pheromone import PheromoneField
from antdsl.fields.reached import CellsAboveThreshold
from antdsl.machine_code.memory import address
from antdsl.numerics import randomness
from antdsl.plan import ir
from antdsl.program.tables.columns import FIXED
from antdsl.runtime.backends.native.block import BlockCode
from antdsl.runtime.backends.native.lane import LaneMemories, LaneMemory
from antdsl.runtime.backends.native.layout import AddressKey
from antdsl.runtime.backends.native.rooms import PaddedArrays, PaddedCopy
from antdsl.runtime.clip_values import clip_table, table_starts
from antdsl.runtime.moving.obstacle_clearance import cached_clearance
from antdsl.runtime.world import Population, World

AddressFinder = Callable[[World, Population], int]
HolderFinder = Callable[[World, Population], Any]
NamedIndices = list[tuple[str, int]]  # register names, with the indices of their addresses
TableWords = NDArray[np.int64]


class HeldArrays:
    """Arrays of one object of the world.

    `of`: finds the object. `get`: returns its arrays, or an object that changes when they change.
    `put`: writes the addresses of all arrays if the result of `get` differs from `seen`. It may replace arrays by padded ones."""

    __slots__ = ("get", "of", "put", "seen")

    def __init__(
        self,
        of: HolderFinder,
        get: Callable[[Any], Iterable[NDArray[Any]]],
        put: Callable[[World, Population, Any, TableWords], None],
    ) -> None:
        self.of, self.get, self.put = of, get, put
        self.seen: Iterable[Any] = repeat(None)


class AddressTables:
    """The inputs of one block of one species: addresses and numbers that all threads read, and `lanes` for the parts of the
    block."""

    def __init__(self, code: BlockCode, rooms: PaddedArrays) -> None:
        self.code, self._rooms = code, rooms
        self.numbers = np.zeros(max(len(code.layout.numbers), 1), np.int64)
        self.pointers = np.zeros(len(code.layout.pointers), np.int64)
        self.pointers[0] = address(self.numbers)
        self.lanes = LaneMemories(code)
        self.version = 0  # of the pointers
        self._views = {np.dtype(kind): self.numbers.view(kind) for kind in (np.int64, np.float64, np.float32, np.int32, np.bool_)}
        nodes: list[tuple[ir.PlanNode, int]] = []
        self._draws: dict[tuple[str, str, int], dict[str, int]] = {}  # by species, site and block: the index of each word
        self._changing: list[tuple[Callable[[World, str], int | float], str, int]] = []
        for key, place in code.layout.numbers.items():
            node = key[1] if key[0] == "node" else None
            if isinstance(node, ir.PlanNode):
                nodes.append((node, place))
            elif key[0] == "philox":
                self._draws.setdefault((str(key[1]), str(key[2]), int(str(key[3]))), {})[str(key[4])] = place
            else:
                self._changing.append((_NUMBER_GETTERS[str(key[0])], str(key[1]) if len(key) > 1 else "", place))
        self._lasting = [each for each in nodes if each[0].rate <= ir.UpdateRate.RUN]
        self._stepping = [each for each in nodes if each[0].rate > ir.UpdateRate.RUN]
        self._filled: Any = None  # the values from which the entries in `_lasting` were written
        self._seed: int | None = None  # the seed for which words of draws were written
        self._told: list[int | float | None] = [None] * len(self._changing)
        pointers = list(code.layout.pointers.items())
        self._kept = [(int(str(key[1])), key[2], place) for key, place in pointers if key[0] == "kept"]
        self._grids = [
            (int(str(key[1])), str(key[2]), place) for key, place in pointers if key[0] == "grid" and key[2] != "widest"
        ]
        self._of: list[Any] = [None] * (1 + len(code.near))  # stored senses and grids of the last fill
        groups: dict[AddressKey, list[tuple[AddressKey, int]]] = {}
        self._found: list[tuple[AddressFinder, int]] = []
        for key, place in pointers:
            holder = self._holder_key(key)
            if holder is not None:
                groups.setdefault(holder, []).append((key, place))
            elif key[0] in _FINDER_MAKERS:
                self._found.append((_FINDER_MAKERS[str(key[0])](self, key), place))
        self._held = [self._held_arrays(holder, keys) for holder, keys in groups.items()]
        self._at = [0] * len(self._found)

    def fill(
        self,
        world: World,
        population: Population,
        values: Mapping[ir.PlanNode, Any],
        lasting: Any,
        stored_senses: Any,
        grids: Any,
    ) -> None:
        """Fill all entries except those of a single lane.

        `values`: the values of the step, including those of the run, which stay valid while `lasting` is the same object.
            `grids`: a cell grid for each search."""
        self._update_numbers(world, values, lasting)
        words, changed = self.pointers, False
        for held in self._held:
            holder = held.of(world, population)
            if any(map(is_not, held.seen, held.get(holder))):
                held.put(world, population, holder, words)
                held.seen, changed = held.get(holder), True
        if stored_senses is not self._of[0]:
            self._of[0], changed = stored_senses, True
            for number, part, place in self._kept:
                has, parts = stored_senses[self.code.lazy_nodes[number]]
                words[place] = address(has if part == "has" else parts[part])
        for search, grid in enumerate(grids, 1):
            if grid is not self._of[search]:
                self._of[search], changed = grid, True
                for number, name, place in self._grids:
                    if number == search - 1:
                        words[place] = 0 if grid[name] is None else address(grid[name])
        for number, (find, place) in enumerate(self._found):
            at = find(world, population)
            if at != self._at[number]:
                self._at[number] = words[place] = at
                changed = True
        self.version += changed

    def largest_species(self, world: World) -> int:
        """Return the number of agents of the largest species if the block searches for other agents, else 0."""
        return max([len(other) for other in world.populations.values()]) if self.code.near else 0

    def prepare_lanes(self, parts: int, rows: int, others: int) -> list[LaneMemory]:
        """Return lanes for `parts` parts of `rows` rows each, ready to run with the filled tables.

        `others`: the number of agents of the largest searched species."""
        return self.lanes.prepare(parts, rows, others, self.pointers)

    def _update_numbers(self, world: World, values: Mapping[ir.PlanNode, Any], lasting: Any) -> None:
        """Write the numbers of the step. Unchanged numbers, and those of the run, are not written again."""
        if lasting is not self._filled:
            self._filled = lasting
            for node, place in self._lasting:
                self._write_number(place, values[node])
        for node, place in self._stepping:
            self._write_number(place, values[node])
        if self._draws:
            first, seed = randomness.frame_word(world.frame), world.setting.seed
            for of, words in self._draws.items():
                self.numbers[words["first"]] = first
                if seed != self._seed:
                    (_, low, last), (k0, k1) = randomness.counters(seed, world.frame, *of)
                    for word, value in (("low", low), ("last", last), ("k0", k0), ("k1", k1)):
                        self.numbers[words[word]] = value
            self._seed = seed
        for number, (of_world, name, place) in enumerate(self._changing):
            current_value = of_world(world, name)
            if current_value != self._told[number]:
                self._told[number] = current_value
                self._write_number(
                    place, np.float64(current_value) if isinstance(current_value, float) else np.int64(current_value)
                )

    def _write_number(self, place: int, value: Any) -> None:
        view = self._views[value.dtype]
        view[place * (8 // value.dtype.itemsize)] = value

    # --- arrays that the world has by name: keys of one holder, and what looks at it ------------------------------------------

    def _holder_key(self, key: AddressKey) -> AddressKey | None:
        """Return the key of the object that contains a named array, or None."""
        match key[0]:
            case "start" | "now" | "cell":
                return (key[0],)
            case name if name in FIXED:
                return ("own",)
            case "item" | "field":
                return key[:2]
            case "other" if key[2] not in _SORTED_ID_NAMES:
                return ("other" if key[2] in _OTHER_FIXED else "start of", key[1])
        return None

    def _held_arrays(self, holder: AddressKey, keys: list[tuple[AddressKey, int]]) -> HeldArrays:
        """Return the watcher of all arrays that one object contains."""
        of, names = str(holder[-1]), [(str(key[-1]), place) for key, place in keys]
        match holder[0]:
            case "start" | "now" as when:
                return self._held_registers(names, start=when == "start")
            case "own":
                return self._held_mapping(lambda world, population: population.columns, names)
            case "other":
                names = [(_OTHER_FIXED[name], place) for name, place in names]
                return self._held_mapping(lambda world, population: world.populations[of].columns, names)
            case "start of":
                return self._held_mapping(lambda world, population: world.populations[of].start, names)
            case "item":
                return self._held_mapping(lambda world, population: world.items[of].visible_values, names)
            case "field":
                return _held_field(of, [(key[2:], place) for key, place in keys])
        return self._held_mapping(lambda world, population: population.cells, names)

    def _held_registers(self, names: NamedIndices, *, start: bool) -> HeldArrays:
        """Return the watcher of registers, at the start of the step or now."""

        def put(world: World, population: Population, holder: Any, words: TableWords) -> None:
            for name, place in names:
                words[place] = self._rooms.move_register(population, name, start=start)[1]

        find: HolderFinder = (lambda world, population: population.start) if start else (lambda world, population: population.now)
        return HeldArrays(find, _make_getter(names), put)

    def _held_mapping(self, of: HolderFinder, names: NamedIndices) -> HeldArrays:
        """Return the watcher of the arrays in a mapping."""

        def put(world: World, population: Population, holder: Any, words: TableWords) -> None:
            for name, place in names:
                holder[name], words[place] = self._rooms.place(holder[name])

        return HeldArrays(of, _make_getter(names), put)

    # --- one kind of key each: gives what looks for its address in a step ---------------------------------------------------

    def _find_mesh(self, key: AddressKey) -> AddressFinder:
        copy = self._copy(key)
        return lambda world, population: copy.of(population.footing.mesh, np.int64)

    def _find_event(self, key: AddressKey) -> AddressFinder:
        """Return a function that finds the flags of agents that an event has reached, as a new array in each step.

        For a species that does not handle the event, no flag is set."""
        name = str(key[1])
        if name not in self.code.species.handles:
            copy = self._copy(key)
            return lambda world, population: copy.of(np.zeros(len(population), np.bool_), np.bool_, len(population))

        def find(world: World, population: Population) -> int:
            population.events[name], place = self._rooms.place(population.events[name])
            return place

        return find

    def _find_sorted_ids(self, key: AddressKey) -> AddressFinder:
        """Return a function that finds the sorted ids of another species, or their rows."""
        copy, species, which = self._rooms.copy(*key), str(key[1]), key[2] != "sorted ids"

        def find(world: World, population: Population) -> int:
            other = world.populations[species]
            return copy.of(other.sorted_ids()[which], np.int64, (other.version, len(other)))

        return find

    def _find_clear(self, key: AddressKey) -> AddressFinder:
        copy, name = self._copy(key), str(key[1])
        return lambda world, population: copy.of(cached_clearance(world, population, name), np.float32)

    def _find_clip(self, key: AddressKey) -> AddressFinder:
        copy, what = self._copy(key), str(key[1])
        return lambda world, population: copy.lasting_address(world.setting, lambda: clip_table(world, population, what))

    def _find_clip_body(self, key: AddressKey) -> AddressFinder:
        """Return a function that finds where the entries of each agent's body begin in the tables of clips."""
        copy = self._copy(key)

        def find(world: World, population: Population) -> int:
            return copy.of(table_starts(world, population), np.int32, (population.version, len(population)))

        return find

    def _find_reached(self, key: AddressKey) -> AddressFinder:
        """Return a function that finds the cells near which a field reaches a threshold."""
        _, name, count, bound = key
        numbers, place = self._views[np.dtype(np.float32)], 2 * self.code.layout.number("node", bound)
        reached: CellsAboveThreshold | None = None

        def find(world: World, population: Population) -> int:
            nonlocal reached
            field, least = world.fields[str(name)], numbers[place]
            if reached is None or not reached.of(field, least):
                reached = CellsAboveThreshold(field, least, int(str(count)))
            return address(reached.now(world.options.threads))

        return find

    def _copy(self, key: AddressKey) -> PaddedCopy:
        """Return the padded copy for a key of this species."""
        return self._rooms.copy(self.code.species.name, *key)


def _make_getter(names: NamedIndices) -> Callable[[Any], Iterable[NDArray[Any]]]:
    """Return a function that gets the arrays with these names."""
    get_arrays = itemgetter(*(name for name, _ in names))
    return get_arrays if len(names) > 1 else lambda holder: (get_arrays(holder),)


def _held_field(of: str, names: list[tuple[AddressKey, int]]) -> HeldArrays:
    """Return the watcher of a field's arrays, which change with the field's version. They are indexed by cell and need no
    padding."""

    def get(field: PheromoneField) -> tuple[Any, ...]:
        return field, field.version

    def put(world: World, population: Population, field: PheromoneField, words: TableWords) -> None:
        for (what, *arguments), place in names:
            if what == "places":
                words[place] = address(field.seen_places)
            else:
                words[place] = address(field.cells.nearest(int(str(arguments[0]))) if arguments else getattr(field, str(what)))

    return HeldArrays(lambda world, population: world.fields[of], get, put)


def _power_of_2_below(count: int) -> int:
    """Return the greatest power of 2 below a count; 0 for counts 0 and 1."""
    return 1 << ((count - 1).bit_length() - 1) if count > 1 else 0


_SORTED_ID_NAMES = frozenset(("sorted ids", "rows of sorted ids"))
_OTHER_FIXED = {"frame of birth": "born", "unsorted ids": "ids"}  # key of a fixed column of another species
_FINDER_MAKERS: dict[str, Callable[[AddressTables, AddressKey], AddressFinder]] = {
    "mesh": AddressTables._find_mesh,
    "event": AddressTables._find_event,
    "other": AddressTables._find_sorted_ids,
    "clear": AddressTables._find_clear,
    "clip": AddressTables._find_clip,
    "clip body": AddressTables._find_clip_body,
    "reached": AddressTables._find_reached,
}
_NUMBER_GETTERS: dict[str, Callable[[World, str], int | float]] = {
    "frame": lambda world, name: world.frame,
    "dt": lambda world, name: float(world.dt),
    "items": lambda world, name: len(world.items[name]),
    "agents": lambda world, name: len(world.populations[name]),
    "half": lambda world, name: _power_of_2_below(len(world.populations[name])),
    "turns": lambda world, name: _power_of_2_below(len(world.populations[name])).bit_length(),
    "cells": lambda world, name: len(world.fields[name].cells),
    "threads": lambda world, name: world.options.threads,
    "surface": lambda world, name: world.surface_index.get(name, -1),
}
