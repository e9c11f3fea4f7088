"""Fills the table of addresses and the numbers of a block: where in the world each array lies that its machine code names.

Code reads eight rows at once, so every array that it is given goes on for eight rows behind the last one: registers are moved
into arrays with room, what others own is copied. What has not become another array since the last run is not looked up again."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.lanes import BOOL, F32, F64, I32, I64, WIDTH
from antdsl.machine_code.memory import Addresses, address, roomy
from antdsl.numerics import randomness
from antdsl.plan import ir
from antdsl.runtime.backends.native.block import BlockCode
from antdsl.runtime.backends.native.layout import Key
from antdsl.runtime.backends.native.search import MOST
from antdsl.runtime.clip_values import clip_table
from antdsl.runtime.moving.obstacle_clearance import clearance
from antdsl.runtime.world import AXES, Population, World

_FEW = 64  # arrays that nobody looks for whether they are still in use
DTYPES = {F32: np.float32, F64: np.float64, BOOL: np.bool_, I32: np.int32, I64: np.int64}


class Rooms:
    """Arrays with room, by what they hold: the same one for all blocks that name it."""

    def __init__(self) -> None:
        self._moved: dict[int, tuple[NDArray[Any], NDArray[Any], int]] = {}  # by identity: an array, that with room, its address
        self._most = _FEW  # arrays, above which it is looked who still has them
        self._copies: dict[Key, tuple[Any, NDArray[Any], int]] = {}
        self.step = 0  # goes up with each: what stays while one lasts is copied once

    def moved(self, population: Population, name: str, *, start: bool) -> tuple[NDArray[Any], int]:
        """A register's array with its address, moved into one with room unless it is in one. Start and now share the new one
        where they shared the old one: else it would be copied at the end of each step."""
        holders = population.start, population.now
        array = holders[not start][name]
        known = self._moved.get(id(array))
        if known is None:
            new = roomy(array)
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

    def copied(self, key: Key, array: NDArray[Any], dtype: Any, stamp: Any = None) -> int:
        """The address of a copy. `stamp`: as long as it stays, so does what was copied; without one that is a step."""
        known, stamp = self._copies.get(key), self.step if stamp is None else stamp
        if known is not None and known[0] == stamp and len(known[1]) == len(array) + WIDTH:
            return known[2]
        if known is None or len(known[1]) != len(array) + WIDTH:
            whole = np.zeros(len(array) + WIDTH, dtype)
            known = (stamp, whole, address(whole))
        known[1][: len(array)] = array
        self._copies[key] = (stamp, known[1], known[2])
        return known[2]

    def lasting(self, key: Key, of: Any, make: Callable[[], NDArray[Any]]) -> int:
        """The address of what is made of something, as long as that is the same one."""
        known = self._copies.get(key)
        if known is None or known[0] is not of:
            made = make()
            known = self._copies[key] = (of, made, address(made))
        return known[2]

    def fours(self, key: Key, columns: list[NDArray[np.float32]]) -> int:
        """The address of up to four columns side by side, four floats a row, as they are in this step."""
        known, rows = self._copies.get(key), len(columns[0])
        if known is not None and known[0] == self.step and len(known[1]) == rows + WIDTH:
            return known[2]
        if known is None or len(known[1]) != rows + WIDTH:
            whole = np.zeros((rows + WIDTH, 4), np.float32)
            known = (self.step, whole, address(whole))
        for k, column in enumerate(columns):
            known[1][:rows, k] = column
        self._copies[key] = (self.step, known[1], known[2])
        return known[2]


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
        self._registers = [(str(key[1]), key[0] == "start", place) for key, place in pointers if key[0] in ("start", "now")]
        self._seen: list[Any] = [None] * len(self._registers)
        self._kept = [(int(str(key[1])), key[2], place) for key, place in pointers if key[0] == "kept"]
        self._grids = [
            (int(str(key[1])), str(key[2]), place) for key, place in pointers if key[0] == "grid" and key[2] != "widest"
        ]
        self._found = [(_POINTERS[str(key[0])], key, place) for key, place in pointers if key[0] in _POINTERS]
        self.pointers[0] = address(self.numbers)

    def fill(
        self, world: World, population: Population, values: Mapping[ir.Node, Any], lasting: Any, kept: Any, grids: Any
    ) -> None:
        """All but what a lane has of its own. `values` are those of the step, among them those of the run, which stay as long as
        `lasting` is the same one; `grids`: a cell grid for each search."""
        self._numbers(world, population, values, lasting)
        for number, (name, start, place) in enumerate(self._registers):
            holder = population.start if start else population.now
            if holder[name] is not self._seen[number]:
                self._seen[number], self.pointers[place] = self._rooms.moved(population, name, start=start)
        for number, part, place in self._kept:
            has, parts = kept[self.code.kept[number]]
            self.pointers[place] = self._lies.of((number, part), has if part == "has" else parts[part])
        for number, name, place in self._grids:
            array = grids[number][name]
            self.pointers[place] = 0 if array is None else self._lies.of((name, number), array)
        for find, key, place in self._found:
            self.pointers[place] = find(self, world, population, key)

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

    # --- one kind of key each -------------------------------------------------------------------------------------------

    def _rows(self, world: World, population: Population, key: Key) -> int:
        """What does not change while the rows stay."""
        array = {"ids": population.ids, "born": population.born}[str(key[0])]
        return self._rooms.copied((population.name, *key), array, np.int64, (population.version, len(population)))

    def _quarantined(self, world: World, population: Population, key: Key) -> int:
        return self._rooms.copied((population.name, *key), population.quarantined, np.bool_)

    def _mesh(self, world: World, population: Population, key: Key) -> int:
        return self._rooms.copied((population.name, *key), population.footing.mesh, np.int64)

    def _event(self, world: World, population: Population, key: Key) -> int:
        flags = population.events.get(str(key[1]))
        return self._rooms.copied(
            (population.name, *key), np.zeros(len(population), np.bool_) if flags is None else flags, np.bool_
        )

    def _other(self, world: World, population: Population, key: Key) -> int:
        """What is another one's: registers at the start of the step, ids, and these in order with their rows."""
        other, name = world.populations[str(key[1])], str(key[2])
        stamp = (other.version, len(other))
        if name in ("sorted ids", "rows of sorted ids"):
            return self._rooms.copied(key, other.sorted_ids()[name != "sorted ids"], np.int64, stamp)
        if name == "frame of birth":
            return self._rooms.copied((other.name, "born"), other.born, np.int64, stamp)
        if name == "unsorted ids":
            return self._rooms.copied((other.name, "ids"), other.ids, np.int64, stamp)
        return self._rooms.moved(other, name, start=True)[1]

    def _beside(self, world: World, population: Population, key: Key) -> int:
        """Up to four registers of others at the start of the step, side by side."""
        start = world.populations[str(key[1])].start
        return self._rooms.fours(key, [start[str(name)] for name in key[2:]])

    def _item(self, world: World, population: Population, key: Key) -> int:
        return self._rooms.copied(key, world.items[str(key[1])].seen[str(key[2])], np.float32)

    def _cell(self, world: World, population: Population, key: Key) -> int:
        return self._rooms.copied((population.name, *key), population.cells[str(key[1])], np.int32)

    def _clear(self, world: World, population: Population, key: Key) -> int:
        return self._rooms.copied((population.name, *key), clearance(world, population, str(key[1])), np.float32)

    def _clip(self, world: World, population: Population, key: Key) -> int:
        return self._rooms.lasting((population.name, *key), world.setting, lambda: clip_table(world, population, str(key[1])))

    def _field(self, world: World, population: Population, key: Key) -> int:
        field = world.fields[str(key[1])]
        if key[2] == "held":
            return self._lies.of(key, field.held)
        if key[2] == "pending":
            return self._lies.of(key, field.pending)
        if key[2] == "block":
            return self._lies.of(key, field.cells.nearest(int(str(key[3]))))
        places = field.seen_places
        return self._lies.of(key, places) + AXES.index(str(key[2])) * places.strides[0]


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
        self._candidates = np.zeros(self._others + (WIDTH + 1) * MOST, np.int32)
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


_OWN = frozenset(
    ("array", "laid", "notes", "counts", "needs", "ticks", "candidates")
)  # kinds of keys that each lane has for itself
_POINTERS: dict[str, Callable[[Tables, World, Population, Key], int]] = {
    "ids": Tables._rows,
    "born": Tables._rows,
    "quarantined": Tables._quarantined,
    "mesh": Tables._mesh,
    "event": Tables._event,
    "other": Tables._other,
    "beside": Tables._beside,
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
