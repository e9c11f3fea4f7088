"""The feet of one species as arrays, one row for each agent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from antdsl.numerics.row_hash import RowHash, describe_columns
from antdsl.numerics.sorting import stable_order

Array = NDArray[Any]

STANDS = np.float32(-1)  # of `swing`
NOTHING, PLANE = -2, -1  # of `on`


def by_leg(shape: Sequence[int], dtype: DTypeLike = np.float64) -> Array:
    """Return zeros [..., n, L] stored leg by leg. Operations that are equal for all legs then run along all agents at once, where
    n is large and L small. NumPy preserves that order in derived arrays."""
    return np.zeros((*shape[:-2], shape[-1], shape[-2]), dtype).swapaxes(-1, -2)


def _empty_column(name: str, array: Array, shape: Sequence[int]) -> Array:
    return by_leg(shape, array.dtype) if name in _BY_LEG else np.zeros(shape, array.dtype)


def _copy_column(name: str, array: Array) -> Array:
    copied_array = _empty_column(name, array, array.shape)
    copied_array[...] = array
    return copied_array


@dataclass(slots=True, eq=False)
class Feet:
    """The feet of n agents with L legs, in any order of the agents: a step puts them into the order of the population's rows, in
    which neighbours in space are mostly neighbours in memory. Positions are mm in world coordinates, components first.

    `place` float64[3, n, L]: where each foot stands or is to land. `shown` float64[3, n, L]: its current position. `start`
    float64[3, n, L]: where its swing began. `swing` float32[n, L]: the completed share of its swing, -1 for a standing foot. `on`
    int16[n, L]: the number of the thing that `place` is on, -1 for the plane, -2 for nothing (the foot hangs). `face` int32[n, L]
    and `weight` float64[2, n, L]: the triangle, and the weights of its second and third corner. `found` float32[n, L]: how far
    (body lengths) from its rest position a foot was put back because no nearer ground was found. `phase` float32[n]: the gait
    phase, from 0 to 1. `rise` float32[n]: height of the trunk above its rest height, mm. `slope` float32[2, n]: the increase in
    ground height below its feet per length ahead and aside. `position` float64[3, n], `heading` and `up` float32[3, n]: those at
    the end of the last frame."""

    ids: NDArray[np.int64]
    place: NDArray[np.float64]
    shown: NDArray[np.float64]
    start: NDArray[np.float64]
    swing: NDArray[np.float32]
    on: NDArray[np.int16]
    face: NDArray[np.int32]
    weight: NDArray[np.float64]
    found: NDArray[np.float32]
    phase: NDArray[np.float32]
    rise: NDArray[np.float32]
    slope: NDArray[np.float32]
    position: NDArray[np.float64]
    heading: NDArray[np.float32]
    up: NDArray[np.float32]
    # What the feet of this step went over the ground, float32[2, n, L], ahead and aside in body lengths; None between steps.
    covered: NDArray[np.float32] | None = field(default=None)
    stood: NDArray[np.float64] | None = field(default=None)  # where bodies were before the ground went on, float64[3, n], NaN: no
    rows: RowHash = field(default_factory=RowHash)  # of arrays that mostly stay where they are in memory
    _ranks: NDArray[np.int32] | None = field(default=None, init=False)

    @staticmethod
    def none(legs: int) -> Feet:
        """Return the feet of an empty population."""
        three, flat = (3, 0, legs), (0, legs)
        return Feet(
            np.zeros(0, np.int64), np.zeros(three), np.zeros(three), np.zeros(three), np.zeros(flat, np.float32),
            np.zeros(flat, np.int16), np.zeros(flat, np.int32), np.zeros((2, 0, legs)), np.zeros(flat, np.float32),
            np.zeros(0, np.float32), np.zeros(0, np.float32), np.zeros((2, 0), np.float32), np.zeros((3, 0)),
            np.zeros((3, 0), np.float32), np.zeros((3, 0), np.float32),
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def legs(self) -> int:
        """How many each agent has."""
        return int(self.swing.shape[1])

    @property
    def is_standing(self) -> NDArray[np.bool_]:
        """Which feet stand, bool[n, L]."""
        return np.asarray(self.swing == STANDS)

    def arrays(self) -> dict[str, Array]:
        """Return the stored arrays themselves, by name."""
        return {name: getattr(self, name) for name in STORED_COLUMNS}

    def by_id(self) -> Feet:
        """Return the same feet, rows by id."""
        return self.match_ids(np.sort(self.ids))[0]

    def id_ranks(self) -> NDArray[np.int32]:
        """The place of each row in the order of ids."""
        if self._ranks is None:
            self._ranks = np.empty(len(self), np.int32)
            self._ranks[stable_order(self.ids)] = np.arange(len(self), dtype=np.int32)
        return self._ranks

    def _find_ids(self, ids: NDArray[np.int64]) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
        """Return the rows of ids, and which ids are there."""
        if not len(self):
            return np.zeros(len(ids), np.intp), np.zeros(len(ids), np.bool_)
        order = stable_order(self.ids)
        at = order.take(np.searchsorted(self.ids, ids, sorter=order), mode="clip")
        return at, self.ids[at] == ids

    def copy_common(self, previous_feet: Feet) -> None:
        """Copy the feet of all agents that had feet before."""
        at, known = previous_feet._find_ids(self.ids)
        for name, array in self.arrays().items():
            rows: tuple[Any, ...] = (slice(None),) * _AXIS.get(name, 0)
            array[(*rows, known)] = getattr(previous_feet, name)[(*rows, at[known])]

    def match_ids(self, ids: NDArray[np.int64]) -> tuple[Feet, NDArray[np.intp]]:
        """Return the feet of agents in the order of these ids, zero for agents without earlier feet, and the rows of those
        agents."""
        if np.array_equal(ids, self.ids):
            return self, np.zeros(0, np.intp)
        at, known = self._find_ids(ids)
        new = np.flatnonzero(~known)
        names = (*STORED_COLUMNS, "covered", "stood")
        columns: dict[str, Any] = {name: _pick_rows(name, getattr(self, name), at, new) for name in names}
        return Feet(**columns | {"ids": ids.copy()}), new


def _pick_rows(name: str, array: Array | None, at: NDArray[np.intp], new: NDArray[np.intp]) -> Array | None:
    """Return rows of a column, with zeros in the `new` ones; earlier positions of these bodies are NaN."""
    if array is None:
        return None
    axis = _AXIS.get(name, 0)
    if not array.shape[axis]:
        picked = _empty_column(name, array, (*array.shape[:axis], len(at), *array.shape[axis + 1 :]))
    elif name in _BY_LEG:
        picked = array.swapaxes(-1, -2).take(at, axis=-1).swapaxes(-1, -2)
    else:
        picked = array.take(at, axis=axis)
    rows: tuple[Any, ...] = (slice(None),) * axis
    if new.size:
        picked[(*rows, new)] = np.nan if name == "stood" else 0
    return picked


STORED_COLUMNS = tuple(each.name for each in fields(Feet) if each.name not in ("covered", "stood", "rows", "_ranks"))
_AXIS = {name: 1 for name in ("place", "shown", "start", "weight", "slope", "position", "heading", "up", "covered", "stood")}
_BY_LEG = frozenset(("place", "shown", "start", "swing", "on", "face", "weight", "found", "covered"))


def feet_hash(feet: Mapping[str, Feet], threads: int = 1) -> str:
    """Return a hash of the feet of all species, like `state_hash` for everything else. Empty if there are no feet."""
    if not feet:
        return ""
    digest = sha256()
    for name in sorted(feet):
        digest.update(f"\0{name}\0{len(feet[name])}".encode())
        arrays = feet[name].arrays()
        ids = arrays.pop("ids")
        columns = feet[name].rows.split_columns(list(arrays.values()), [key in _AXIS for key in arrays])
        digest.update(describe_columns(tuple(arrays), arrays.values()) + feet[name].rows.of(ids, columns, threads))
    return digest.hexdigest()[:32]


def feet_from_arrays(arrays: Mapping[str, Array], legs: int, ids: NDArray[np.int64]) -> Feet:
    """Return the feet from arrays that `Feet.arrays` wrote. Raises ValueError if they do not describe the feet of agents with
    these ids."""
    like = Feet.none(legs).arrays()
    columns: dict[str, Any] = {}
    for name, empty in like.items():
        array = np.asarray(arrays[name]) if name in arrays else None
        axis = _AXIS.get(name, 0)
        expected_shape = list(empty.shape)
        expected_shape[axis] = len(ids)
        if array is None or array.dtype != empty.dtype or list(array.shape) != expected_shape:
            raise ValueError(f"`{name}` is missing or of another shape")
        columns[name] = _copy_column(name, array)
    if not np.array_equal(columns["ids"], ids):
        raise ValueError("the `ids` differ")
    return Feet(**columns)
