"""Fills the table of addresses and the numbers of a block: where in the world each array lies that its machine code names.

Code reads eight rows at once, so every array that it is given goes on for eight rows behind the last one: registers are moved
into arrays with room, what others own is copied. What has not become another array since the last run is not looked up again."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping
from operator import is_not, itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.lanes import BOOL, F32, F64, I32, I64, WIDTH
from antdsl.machine_code.memory import Addresses, address, has_room, roomy
from antdsl.numerics import randomness
from antdsl.plan import ir
from antdsl.runtime.backends.native.block import BlockCode
from antdsl.runtime.backends.native.layout import Key
from antdsl.runtime.backends.native.search import MOST
from antdsl.runtime.clip_values import clip_table
from antdsl.runtime.moving.obstacle_clearance import clearance
from antdsl.runtime.world import Population, World

_FEW = 64  # arrays that nobody looks for whether they are still in use
Find = Callable[[World, Population], int]
DTYPES = {F32: np.float32, F64: np.float64, BOOL: np.bool_, I32: np.int32, I64: np.int64}


class Rooms:
    """Arrays with room, by what they hold: the same one for all blocks that name it."""

    def __init__(self) -> None:
        self._moved: dict[int, tuple[NDArray[Any], NDArray[Any], int]] = {}  # by identity: an array, that with room, its address
        self._most = _FEW  # arrays, above which it is looked who still has them
        self._copies: dict[Key, Copy] = {}
        self.step = 0  # goes up with each: what stays while one lasts is copied once

    def moved(self, population: Population, name: str, *, start: bool) -> tuple[NDArray[Any], int]:
        """A register's array with its address, moved into one with room unless it is in one. Start and now share the new one
        where they shared the old one: else it would be copied at the end of each step."""
        holders = population.start, population.now
        array = holders[not start][name]
        known = self._moved.get(id(array))
        if known is None:
            new = array if has_room(array) else roomy(array)
            known = self._moved[id(array)] = (array, new, address(new))
            self._moved[id(new)] = (new, *known[1:])
        elif known[1] is not array:  # somebody goes on with the one without room, as who asks specs does: it may have changed
            np.copyto(known[1], array)
        for holder in holders:
            if holder.get(name) is array:
                holder[name] = known[1]
        return known[1:]

    def settle(self, populations: Iterable[Population]) -> None:
        """A step begins. Let go of arrays that nobody has any more, once they may be more than those in use."""
        self.step += 1
        if len(self._moved) > self._most:
            held = {id(array) for each in populations for holder in (each.start, each.now) for array in holder.values()}
            self._moved = {key: known for key, known in self._moved.items() if id(known[1]) in held}
            self._most = max(_FEW, 2 * len(self._moved))

    def forget(self) -> None:
        """Rows are others now: let go of arrays that are no longer in use."""
        self._moved.clear()

    def copy(self, *key: Hashable) -> Copy:
        """What stands for a key: the same one for all blocks that name it."""
        return self._copies.setdefault(key, Copy(self))


class Copy:
    """A copy with room of an array that another part of the program owns, or of something made of the world."""

    __slots__ = ("_address", "_of", "_rooms", "_whole")

    def __init__(self, rooms: Rooms) -> None:
        self._rooms, self._address = rooms, 0
        self._of: Any = None
        self._whole: NDArray[Any] = np.zeros(0)

    def of(self, array: NDArray[Any], dtype: Any, stamp: Any = None) -> int:
        """The address of a copy. `stamp`: as long as it stays, so does what was copied; without one that is a step."""
        stamp = self._rooms.step if stamp is None else stamp
        if stamp != self._of or len(self._whole) != len(array) + WIDTH:
            self._size(len(array), dtype)
            self._whole[: len(array)] = array
            self._of = stamp
        return self._address

    def lasting(self, of: Any, make: Callable[[], NDArray[Any]]) -> int:
        """The address of what is made of something, as long as that is the same one."""
        if of is not self._of:
            self._of, self._whole = of, make()
            self._address = address(self._whole)
        return self._address

    def _size(self, rows: int, dtype: Any) -> None:
        if len(self._whole) != rows + WIDTH:
            self._whole = np.zeros(rows + WIDTH, dtype)
            self._address = address(self._whole)


class Tables:
    """What one block of one species is run with: addresses and numbers that all threads read, and for each a `Lane`."""

    def __init__(self, code: BlockCode, rooms: Rooms) -> None:
        self.code, self._rooms = code, rooms
        self.numbers = np.zeros(max(len(code.layout.numbers), 1), np.int64)
        self.pointers = np.zeros(len(code.layout.pointers), np.int64)
        self.lanes: list[Lane] = []
        self._lies = Addresses()
        self._views = {np.dtype(kind): self.numbers.view(kind) for kind in (np.int64, np.float64, np.float32, np.int32, np.bool_)}
        nodes: list[tuple[ir.Node, int]] = []
        self._draws: dict[tuple[str, str, int], dict[str, int]] = {}  # by species, site and block: places of words
        self._changing: list[tuple[Key, int]] = []
        for key, place in code.layout.numbers.items():
            node = key[1] if key[0] == "node" else None
            if isinstance(node, ir.Node):
                nodes.append((node, place))
            elif key[0] == "philox":
                self._draws.setdefault((str(key[1]), str(key[2]), int(str(key[3]))), {})[str(key[4])] = place
            else:
                self._changing.append((key, place))
        self._lasting = [each for each in nodes if each[0].rate <= ir.Rate.RUN]
        self._stepping = [each for each in nodes if each[0].rate > ir.Rate.RUN]
        self._filled: Any = None  # the values that `_lasting` were put down from
        self._seed: int | None = None  # that the words of draws were put down for
        pointers = list(code.layout.pointers.items())
        registers = [(str(key[1]), key[0] == "start", place) for key, place in pointers if key[0] in ("start", "now")]
        self._registers = sorted(registers, key=lambda each: not each[1])  # those of the start first
        self._of_start, self._of_now = (_getter([name for name, at, _ in registers if at == start]) for start in (True, False))
        self._seen: list[Any] = [None] * len(self._registers)
        self._kept = [(int(str(key[1])), key[2], place) for key, place in pointers if key[0] == "kept"]
        self._grids = [
            (int(str(key[1])), str(key[2]), place) for key, place in pointers if key[0] == "grid" and key[2] != "widest"
        ]
        self._found = [(_POINTERS[str(key[0])](self, key), place) for key, place in pointers if key[0] in _POINTERS]
        self._of: list[Any] = [None] * (1 + len(code.near))  # what is kept for the step and the grids, as they were last
        self.pointers[0] = address(self.numbers)

    def fill(
        self, world: World, population: Population, values: Mapping[ir.Node, Any], lasting: Any, kept: Any, grids: Any
    ) -> None:
        """All but what a lane has of its own. `values` are those of the step, among them those of the run, which stay as long as
        `lasting` is the same one; `grids`: a cell grid for each search."""
        self._numbers(world, population, values, lasting)
        if any(map(is_not, self._seen, (*self._of_start(population.start), *self._of_now(population.now)))):
            for number, (name, start, place) in enumerate(self._registers):
                self._seen[number], self.pointers[place] = self._rooms.moved(population, name, start=start)
        if kept is not self._of[0]:
            self._of[0] = kept
            for number, part, place in self._kept:
                has, parts = kept[self.code.kept[number]]
                self.pointers[place] = address(has if part == "has" else parts[part])
        for search, grid in enumerate(grids):
            if grid is not self._of[1 + search]:
                self._of[1 + search] = grid
                for number, name, place in self._grids:
                    if number == search:
                        self.pointers[place] = 0 if grid[name] is None else address(grid[name])
        for find, place in self._found:
            self.pointers[place] = find(world, population)

    def lane(self, number: int, world: World, rows: int) -> Lane:
        """That of a thread, ready to run what the tables were filled for, for so many rows at once."""
        while len(self.lanes) <= number:
            self.lanes.append(Lane(self.code, self.pointers))
        lane = self.lanes[number]
        lane.room(rows, max(len(other) for other in world.populations.values()))
        lane.pointers[:] = self.pointers
        lane.pointers[lane.own] = lane.places
        return lane

    def _numbers(self, world: World, population: Population, values: Mapping[ir.Node, Any], lasting: Any) -> None:
        """What has not become another number since is not put down again."""
        if lasting is not self._filled:
            self._filled = lasting
            for node, place in self._lasting:
                self._number(place, values[node])
        for node, place in self._stepping:
            self._number(place, values[node])
        for of, words in self._draws.items():
            (first, low, last), (k0, k1) = randomness.counters(world.setting.seed, world.frame, *of)
            self.numbers[words["first"]] = first
            if world.setting.seed != self._seed:
                for word, value in (("low", low), ("last", last), ("k0", k0), ("k1", k1)):
                    self.numbers[words[word]] = value
        self._seed = world.setting.seed
        for key, place in self._changing:
            self._number(place, _NUMBERS[str(key[0])](world, population, key))

    def _number(self, place: int, value: Any) -> None:
        view = self._views[value.dtype]
        view[place * (8 // value.dtype.itemsize)] = value

    # --- one kind of key each: gives what looks for its address in a step ---------------------------------------------------

    def _rows(self, key: Key) -> Find:
        """What does not change while the rows stay."""
        copy, name = self._copy(key), str(key[0])
        return lambda world, population: copy.of(getattr(population, name), np.int64, (population.version, len(population)))

    def _quarantined(self, key: Key) -> Find:
        copy = self._copy(key)
        return lambda world, population: copy.of(population.quarantined, np.bool_)

    def _mesh(self, key: Key) -> Find:
        copy = self._copy(key)
        return lambda world, population: copy.of(population.footing.mesh, np.int64)

    def _event(self, key: Key) -> Find:
        copy, name = self._copy(key), str(key[1])

        def find(world: World, population: Population) -> int:
            flags = population.events.get(name)
            return copy.of(np.zeros(len(population), np.bool_) if flags is None else flags, np.bool_)

        return find

    def _other(self, key: Key) -> Find:
        """What is another one's: registers at the start of the step, ids, and these in order with their rows."""
        species, name = str(key[1]), str(key[2])
        if name in ("sorted ids", "rows of sorted ids"):
            copy, which = self._rooms.copy(*key), name != "sorted ids"

            def in_order(world: World, population: Population) -> int:
                other = world.populations[species]
                return copy.of(other.sorted_ids()[which], np.int64, (other.version, len(other)))

            return in_order
        attribute = {"frame of birth": "born", "unsorted ids": "ids"}.get(name)
        if attribute is not None:
            copy = self._rooms.copy(species, attribute)

            def of_rows(world: World, population: Population) -> int:
                other = world.populations[species]
                return copy.of(getattr(other, attribute), np.int64, (other.version, len(other)))

            return of_rows
        return lambda world, population: self._rooms.moved(world.populations[species], name, start=True)[1]

    def _item(self, key: Key) -> Find:
        copy, items, name = self._rooms.copy(*key), str(key[1]), str(key[2])
        return lambda world, population: copy.of(world.items[items].seen[name], np.float32)

    def _cell(self, key: Key) -> Find:
        copy, name = self._copy(key), str(key[1])
        return lambda world, population: copy.of(population.cells[name], np.int32)

    def _clear(self, key: Key) -> Find:
        copy, name = self._copy(key), str(key[1])
        return lambda world, population: copy.of(clearance(world, population, name), np.float32)

    def _clip(self, key: Key) -> Find:
        copy, what = self._copy(key), str(key[1])
        return lambda world, population: copy.lasting(world.setting, lambda: clip_table(world, population, what))

    def _field(self, key: Key) -> Find:
        name, what, lies = str(key[1]), key[2], self._lies
        if what == "held":
            return lambda world, population: lies.of(key, world.fields[name].held)
        if what == "pending":
            return lambda world, population: lies.of(key, world.fields[name].pending)
        if what == "block":
            count = int(str(key[3]))
            return lambda world, population: lies.of(key, world.fields[name].cells.nearest(count))
        return lambda world, population: lies.of(key, world.fields[name].seen_places)

    def _copy(self, key: Key) -> Copy:
        """What stands for a key of this species."""
        return self._rooms.copy(self.code.species.name, *key)


class Lane:
    """What a thread has of its own while it runs a block: what stages leave to each other, lists, notes and counts.

    `counts`: above 0 first where somebody has too many others around, then how many each list has; `needs`: above 0 for a call
    that somebody needs; `columns` of each list: rows, and what is written down beside them; `ticks` by line, of code that is
    timed; `laid`: by field, whether anything was; `widest`: the greatest radius of each search."""

    def __init__(self, code: BlockCode, pointers: NDArray[np.int64]) -> None:
        self.code, self.pointers = code, np.zeros_like(pointers)
        self.address = address(self.pointers)
        self.arrays: dict[tuple[int, int], NDArray[Any]] = {}
        self.columns: list[list[NDArray[Any]]] = []
        self.notes = np.zeros(1, np.int64)
        self.counts, self.needs = np.zeros(1 + len(code.lists), np.int64), np.zeros(max(len(code.needs), 1), np.uint8)
        self.ticks = np.zeros(0 if code.lines is None else len(code.lines.told), np.int64)
        self.laid: dict[str, NDArray[np.bool_]] = {}
        self.widest = [np.zeros(WIDTH, np.float32) for _ in code.near]
        self._candidates = np.zeros(0, np.int32)
        self._size = self._others = -1
        self._keys = [(key, place) for key, place in code.layout.pointers.items() if key[0] in _OWN or key[2:] == ("widest",)]
        self.own = np.array([place for _, place in self._keys], np.intp)
        self.places = np.zeros(len(self._keys), np.int64)

    def room(self, rows: int, others: int) -> None:
        """Arrays for so many rows of a chunk, and so many agents of the largest species."""
        if rows <= self._size and others <= self._others:
            return
        self._size, self._others = max(rows, self._size), max(others, self._others)
        for (slot, part), kind in self.code.layout.arrays.items():
            self.arrays[slot, part] = np.zeros(self._size + WIDTH, DTYPES[kind])
        self.columns.clear()
        for number in range(len(self.code.lists)):
            parts = sorted(part for slot, part in self.arrays if slot == -1 - number)
            self.columns.append([self.arrays[-1 - number, part] for part in parts])
        self.notes = np.zeros(1 + 2 * (len(self.code.faults) * (self._size // WIDTH + 1)), np.int64)
        self._candidates = np.zeros(2 * self._others + (WIDTH + 1) * MOST, np.int32)  # of one agent with distances beside
        for number, (key, _) in enumerate(self._keys):
            self.places[number] = address(self._own(key))

    def _own(self, key: Key) -> NDArray[Any]:
        match key[0]:
            case "array":
                return self.arrays[int(str(key[1])), int(str(key[2]))]
            case "grid":
                return self.widest[int(str(key[1]))]
            case "laid":
                return self.laid.setdefault(str(key[1]), np.zeros(1, np.bool_))
            case "notes":
                return self.notes
            case "counts":
                return self.counts
            case "needs":
                return self.needs
            case "ticks":
                return self.ticks
        return self._candidates


def _getter(names: list[str]) -> Callable[[Mapping[str, NDArray[Any]]], tuple[NDArray[Any], ...]]:
    """What gives the arrays of these names."""
    return itemgetter(*names) if len(names) > 1 else lambda held: tuple(held[name] for name in names)


_OWN = frozenset(
    ("array", "laid", "notes", "counts", "needs", "ticks", "candidates")
)  # kinds of keys that each lane has for itself
_POINTERS: dict[str, Callable[[Tables, Key], Find]] = {
    "ids": Tables._rows,
    "born": Tables._rows,
    "quarantined": Tables._quarantined,
    "mesh": Tables._mesh,
    "event": Tables._event,
    "other": Tables._other,
    "item": Tables._item,
    "cell": Tables._cell,
    "clear": Tables._clear,
    "clip": Tables._clip,
    "field": Tables._field,
}


def _half(count: int) -> int:
    """The greatest power of 2 below a count, 0 for 0 and 1."""
    return 1 << ((count - 1).bit_length() - 1) if count > 1 else 0


_NUMBERS: dict[str, Callable[[World, Population, Key], Any]] = {
    "frame": lambda world, population, key: np.int64(world.frame),
    "dt": lambda world, population, key: np.float64(world.dt),
    "items": lambda world, population, key: np.int64(len(world.items[str(key[1])])),
    "agents": lambda world, population, key: np.int64(len(world.populations[str(key[1])])),
    "half": lambda world, population, key: np.int64(_half(len(world.populations[str(key[1])]))),
    "turns": lambda world, population, key: np.int64(_half(len(world.populations[str(key[1])])).bit_length()),
    "cells": lambda world, population, key: np.int64(len(world.fields[str(key[1])].cells)),
    "threads": lambda world, population, key: np.int64(world.options.threads),
    "surface": lambda world, population, key: np.int64(world.surface_index.get(str(key[1]), -1)),
}
