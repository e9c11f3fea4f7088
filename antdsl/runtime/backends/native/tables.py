"""Fills the table of addresses and the numbers of a block: where in the world each array lies that its machine code names.

Code reads eight rows at once, so that every array it is given goes on for eight rows behind the last one: registers are moved into
arrays with room, what others own is copied."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import randomness
from antdsl.plan import ir
from antdsl.runtime.backends.native.block import BlockCode
from antdsl.runtime.backends.native.lanes import BOOL, F32, F64, I32, I64, WIDTH
from antdsl.runtime.backends.native.layout import Key
from antdsl.runtime.backends.native.search import MOST
from antdsl.runtime.world import AXES, Population, World
from antdsl.senses.neighbours import CellGrid

DTYPES = {F32: np.float32, F64: np.float64, BOOL: np.bool_, I32: np.int32, I64: np.int64}


def roomy(array: NDArray[Any]) -> NDArray[Any]:
    """A copy with eight spare rows behind it, zeros."""
    whole = np.zeros((len(array) + WIDTH, *array.shape[1:]), array.dtype)
    whole[: len(array)] = array
    found: NDArray[Any] = whole[: len(array)]
    return found


class Addresses:
    """Addresses of arrays. An array that is the same object as before has the address it had."""

    def __init__(self) -> None:
        self._known: dict[Key, tuple[Any, Any, int]] = {}

    def moved(self, key: Key, holder: dict[str, NDArray[Any]], name: str) -> int:
        """Of a register, which is moved into an array with room unless it is in one."""
        known = self._known.get(key)
        array = holder[name]
        if known is not None and known[0] is array:
            return known[2]
        for other in self._known.values():  # start and now may share one array
            if other[0] is array and other[1] is array:
                self._known[key] = other
                return other[2]
        new = holder[name] = roomy(array)
        self._known[key] = (new, new, _address(new))
        return self._known[key][2]

    def scratch(self, key: Key, shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
        """An array of that shape, the same one as long as the shape stays."""
        known = self._known.get(key)
        if known is None or known[0].shape != shape:
            array = np.zeros(shape, dtype)
            known = self._known[key] = (array, None, _address(array))
        found: NDArray[Any] = known[0]
        return found

    def copied(self, key: Key, array: NDArray[Any], dtype: Any, stamp: Any = None) -> int:
        """Of a copy, made anew where the array or a stamp is another one; a stamp of None: always, into the same place."""
        known = self._known.get(key)
        if known is not None and stamp is not None and known[0] is array and known[1][1] == stamp:
            return known[2]
        if known is not None and stamp is None and len(known[1][0]) == len(array) + WIDTH:
            known[1][0][: len(array)] = array
            return known[2]
        whole = np.zeros(len(array) + WIDTH, dtype)
        whole[: len(array)] = array
        self._known[key] = (array, (whole, stamp), _address(whole))
        return self._known[key][2]


def _address(array: NDArray[Any]) -> int:
    if not array.flags.c_contiguous:
        raise ValueError("machine code reads arrays that lie in one piece")
    found: int = array.__array_interface__["data"][0]
    return found


class Tables:
    """What one block of one species is run with in one thread."""

    def __init__(self, code: BlockCode, addresses: Addresses) -> None:
        self.code, self._addresses = code, addresses
        self.numbers = np.zeros(max(len(code.layout.numbers), 1), np.int64)
        self.pointers = np.zeros(len(code.layout.pointers), np.int64)
        self.arrays: dict[tuple[int, int], NDArray[Any]] = {}
        self.notes = np.zeros(1, np.int64)
        self.crowded = np.zeros(1, np.int64)
        self.widest = [np.zeros(WIDTH, np.float32) for _ in code.near]
        self._candidates = np.zeros(0, np.int32)
        self._size = -1
        self._held: list[Any] = []
        self._bytes = self.numbers.view(np.uint8)
        self.address = _address(self.pointers)

    def fill(self, world: World, population: Population, values: Mapping[ir.Node, Any], kept: Any, grids: list[CellGrid]) -> None:
        """Everything but what depends on the rows of a chunk. `values` are those of the step, `grids` a cell grid for each search."""
        self._held = []
        for key, place in self.code.layout.numbers.items():
            value = _NUMBERS[str(key[0])](world, population, values, key)
            self._bytes[8 * place : 8 * place + value.nbytes] = np.frombuffer(value.tobytes(), np.uint8)
        for key, place in self.code.layout.pointers.items():
            find = _POINTERS.get(str(key[0]))
            if find is not None:
                self.pointers[place] = find(self, world, population, key)
            elif key[0] == "kept":
                has, parts = kept[self.code.kept[int(str(key[1]))]]
                self.pointers[place] = _address(has if key[2] == "has" else parts[int(str(key[2]))])
            elif key[0] == "grid":
                self.pointers[place] = self._grid(grids[int(str(key[1]))], key)

    def room(self, rows: int) -> None:
        """Arrays for so many rows of a chunk."""
        if rows > self._size:
            self._size = rows
            for (slot, part), kind in self.code.layout.arrays.items():
                self.arrays[slot, part] = np.zeros(rows + WIDTH, DTYPES[kind])
            self.notes = np.zeros(1 + 2 * (len(self.code.faults) * (rows // WIDTH + 1)), np.int64)
        for key, place in self.code.layout.pointers.items():
            if key[0] == "array":
                self.pointers[place] = _address(self.arrays[int(str(key[1])), int(str(key[2]))])
            elif key[0] == "notes":
                self.pointers[place] = _address(self.notes)

    # --- one kind of key each -------------------------------------------------------------------------------------------

    def _own(self, world: World, population: Population, key: Key) -> int:
        holder = population.start if key[0] == "start" else population.now
        return self._addresses.moved((population.name, *key), holder, str(key[1]))

    def _rows(self, world: World, population: Population, key: Key) -> int:
        """Arrays that do not change while the rows stay."""
        array = {"ids": population.ids, "born": population.born}[str(key[0])]
        return self._addresses.copied((population.name, *key), array, np.int64, population.version)

    def _quarantined(self, world: World, population: Population, key: Key) -> int:
        return self._addresses.copied((population.name, *key), population.quarantined, np.bool_)

    def _mesh(self, world: World, population: Population, key: Key) -> int:
        return self._addresses.copied((population.name, *key), population.footing.mesh, np.int64)

    def _event(self, world: World, population: Population, key: Key) -> int:
        flags = population.events.get(str(key[1]))
        return self._addresses.copied(
            (population.name, *key), np.zeros(len(population), np.bool_) if flags is None else flags, np.bool_
        )

    def _other(self, world: World, population: Population, key: Key) -> int:
        """What is another one's: registers at the start of the step, ids, and these in order with their rows."""
        other = world.populations[str(key[1])]
        name = str(key[2])
        if name in ("sorted ids", "order"):
            return self._addresses.copied(key, other.sorted_ids()[name == "order"], np.int64, other.version)
        if name == "ids":
            return self._addresses.copied((other.name, "ids"), other.ids, np.int64, other.version)
        return self._addresses.moved((other.name, "start", name), other.start, name)

    def _beside(self, world: World, population: Population, key: Key) -> int:
        """Up to four registers of others at the start of the step, side by side."""
        other = world.populations[str(key[1])]
        whole = self._addresses.scratch(key, (len(other) + WIDTH, 4), np.float32)
        for k, name in enumerate(key[2:]):
            whole[: len(other), k] = other.start[str(name)]
        return _address(whole)

    def _item(self, world: World, population: Population, key: Key) -> int:
        return self._addresses.copied(key, world.items[str(key[1])].seen[str(key[2])], np.float32)

    def _cell(self, world: World, population: Population, key: Key) -> int:
        return self._addresses.copied((population.name, *key), population.cells[str(key[1])], np.int32)

    def _field(self, world: World, population: Population, key: Key) -> int:
        field = world.fields[str(key[1])]
        if key[2] == "held":
            return _address(field.held)
        if key[2] == "block":
            table = field.cells.nearest(int(str(key[3])))
            self._held.append(table)
            return _address(table)
        return _address(field.seen_places[AXES.index(str(key[2]))])

    def _crowded(self, world: World, population: Population, key: Key) -> int:
        return _address(self.crowded)

    def _candidate(self, world: World, population: Population, key: Key) -> int:
        most = max(len(other) for other in world.populations.values()) + (WIDTH + 1) * MOST
        if len(self._candidates) < most:
            self._candidates = np.zeros(most, np.int32)
        return _address(self._candidates)

    def _number(self, world: World, population: Population, key: Key) -> int:
        return _address(self.numbers)

    def _grid(self, grid: CellGrid, key: Key) -> int:
        if key[2] == "widest":
            return _address(self.widest[int(str(key[1]))])
        array = grid.tables[str(key[2])]
        self._held.append(array)
        return 0 if array is None else _address(array)


_POINTERS: dict[str, Callable[[Tables, World, Population, Key], int]] = {
    "numbers": Tables._number,
    "start": Tables._own,
    "now": Tables._own,
    "ids": Tables._rows,
    "born": Tables._rows,
    "quarantined": Tables._quarantined,
    "mesh": Tables._mesh,
    "event": Tables._event,
    "other": Tables._other,
    "beside": Tables._beside,
    "item": Tables._item,
    "cell": Tables._cell,
    "field": Tables._field,
    "crowded": Tables._crowded,
    "candidates": Tables._candidate,
}


def _philox(world: World, population: Population, values: Mapping[ir.Node, Any], key: Key) -> Any:
    species, site, block, word = str(key[1]), str(key[2]), int(str(key[3])), str(key[4])
    (first, low, last), (k0, k1) = randomness.counters(world.setting.seed, world.frame, species, site, block)
    return np.int64({"first": first, "low": low, "last": last, "k0": k0, "k1": k1}[word])


def _half(count: int) -> int:
    """The greatest power of 2 below a count, 0 for 0 and 1."""
    return 1 << ((count - 1).bit_length() - 1) if count > 1 else 0


_NUMBERS: dict[str, Callable[[World, Population, Mapping[ir.Node, Any], Key], Any]] = {
    "node": lambda world, population, values, key: values[key[1]],  # type: ignore[index]
    "frame": lambda world, population, values, key: np.int64(world.frame),
    "dt": lambda world, population, values, key: np.float64(world.dt),
    "items": lambda world, population, values, key: np.int64(len(world.items[str(key[1])])),
    "agents": lambda world, population, values, key: np.int64(len(world.populations[str(key[1])])),
    "half": lambda world, population, values, key: np.int64(_half(len(world.populations[str(key[1])]))),
    "turns": lambda world, population, values, key: np.int64(_half(len(world.populations[str(key[1])])).bit_length()),
    "cells": lambda world, population, values, key: np.int64(len(world.fields[str(key[1])].cells)),
    "surface": lambda world, population, values, key: np.int64(world.surface_index.get(str(key[1]), -1)),
    "philox": _philox,
}
