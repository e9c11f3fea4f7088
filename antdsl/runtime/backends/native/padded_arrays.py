"""Arrays with eight spare rows at the end. Machine code needs these, because it reads eight rows at once. Registers and other
named arrays of the world are moved into padded arrays. Arrays that other parts of the program own are copied."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.memory import copy_padded, get_array_address, has_padding
from antdsl.machine_code.number_kinds import LANE_COUNT
from antdsl.runtime.backends.native.address_layout import AddressKey
from antdsl.runtime.world import Population

_MIN_ARRAYS_TO_DROP = 64  # number of arrays below which unused ones are not searched for


class PaddedArrays:
    """The padded arrays of a world. Blocks that use the same data share one padded array."""

    def __init__(self) -> None:
        self._padded_by_id: dict[
            int, tuple[NDArray[Any], NDArray[Any], int]
        ] = {}  # by identity: an array, that with room, its address
        self._max_arrays = _MIN_ARRAYS_TO_DROP  # with more arrays, unused ones are released
        self._copies: dict[AddressKey, PaddedCopy] = {}
        self.step = 0  # number of the step; a copy without stamp is valid for one step

    def pad_array(self, array: NDArray[Any]) -> tuple[NDArray[Any], int]:
        """Return a padded array with the content of `array`, and its address. An array that is already padded is returned itself.

        From then on, the caller must use the returned array instead of `array`."""
        known = self._padded_by_id.get(id(array))
        if known is None:
            new = array if has_padding(array) else copy_padded(array)
            known = self._padded_by_id[id(array)] = (array, new, get_array_address(new))
            self._padded_by_id[id(new)] = (new, *known[1:])
        # a caller, such as a spec query, continues with the array without padding: it may have changed
        elif known[1] is not array:
            np.copyto(known[1], array)
        return known[1:]

    def pad_register(self, population: Population, name: str, *, start: bool) -> tuple[NDArray[Any], int]:
        """Move a register into a padded array, unless it is already in one. Return the array and its address.

        `start`: whether to move the values at the start of the step instead of the current ones. If both are in the same array,
        both are moved together. Otherwise one would be copied at the end of each step."""
        holders = population.start, population.now
        array = holders[not start][name]
        located_array = self.pad_array(array)
        for holder in holders:
            if holder.get(name) is array:
                holder[name] = located_array[0]
        return located_array

    def begin_step(self, populations: Iterable[Population]) -> None:
        """Release unused arrays at the start of a step if there may be more of them than arrays in use."""
        self.step += 1
        if len(self._padded_by_id) > self._max_arrays:
            held = {id(array) for each in populations for holder in (each.start, each.now) for array in holder.values()}
            self._padded_by_id = {key: known for key, known in self._padded_by_id.items() if id(known[1]) in held}
            self._max_arrays = max(_MIN_ARRAYS_TO_DROP, 2 * len(self._padded_by_id))

    def drop_unused_copies(self) -> None:
        """Release the arrays that are no longer in use after the rows have changed."""
        self._padded_by_id.clear()

    def get_copy(self, *key: Hashable) -> PaddedCopy:
        """Return the padded copy that belongs to a key. All blocks that use the key share it."""
        return self._copies.setdefault(key, PaddedCopy(self))


class PaddedCopy:
    """A padded copy of an array that another part of the program owns, or of an array computed from the world."""

    __slots__ = ("_address", "_owner", "_padded", "_source_stamp")

    def __init__(self, owner: PaddedArrays) -> None:
        self._owner, self._address = owner, 0
        self._source_stamp: Any = None
        self._padded: NDArray[Any] = np.zeros(0)

    def update_copy(self, array: NDArray[Any], dtype: Any, stamp: Any = None) -> int:
        """Copy an array into the padded copy if necessary. Return the address of the copy.

        The copy is valid as long as `stamp` is equal to that of the last call. Without a stamp, it is valid for one step."""
        stamp = self._owner.step if stamp is None else stamp
        if stamp != self._source_stamp or len(self._padded) != len(array) + LANE_COUNT:
            self._resize_copy(len(array), dtype)
            self._padded[: len(array)] = array
            self._source_stamp = stamp
        return self._address

    def update_derived_copy(self, source: Any, make: Callable[[], NDArray[Any]]) -> int:
        """Return the address of a padded copy of the result of `make`. If `source` is a new object, call `make` again."""
        if source is not self._source_stamp:
            self._source_stamp, self._padded = source, make()
            self._address = get_array_address(self._padded)
        return self._address

    def _resize_copy(self, rows: int, dtype: Any) -> None:
        if len(self._padded) != rows + LANE_COUNT:
            self._padded = np.zeros(rows + LANE_COUNT, dtype)
            self._address = get_array_address(self._padded)
