"""The state of the feet of one species, as arrays with one row per agent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from antdsl.numerics.records import match_ids
from antdsl.numerics.row_hash import RowHasher, describe_columns
from antdsl.numerics.sorting import invert_order, sort_stably
from antdsl.program.tables.columns import FEET_COLUMNS

Array = NDArray[Any]

SWING_PHASE_OF_STANDING_FOOT = np.float32(-1)  # value of `swing` for a standing foot
NO_GROUND_NUMBER, PLANE_GROUND_NUMBER = -2, -1  # values of `on`
_COLUMNS = {column.name: column for column in FEET_COLUMNS}
_SHAPE_BY_COLUMN = {name: column.shape for name, column in _COLUMNS.items()} | {"covered": (2, "n", "L"), "stood": (3, "n")}


def make_zeros_by_leg(shape: Sequence[int], dtype: DTypeLike = np.float64) -> Array:
    """Return an array of zeros [..., n, L] that stores the values of all agents for one leg contiguously.

    Operations then run along agents, which is faster because n is large and L is small. NumPy preserves this memory layout in
    derived arrays."""
    return np.zeros((*shape[:-2], shape[-1], shape[-2]), dtype).swapaxes(-1, -2)


def _make_empty_columns(count: int, legs: int, soles: int) -> dict[str, Any]:
    """Return all columns of `FeetState` for `count` agents, filled with zeros."""
    shapes = {name: column.compute_dimensions(n=count, L=legs, S=soles) for name, column in _COLUMNS.items()}
    return {
        name: make_zeros_by_leg(shapes[name], column.type) if _is_by_leg(name) else np.zeros(shapes[name], column.type)
        for name, column in _COLUMNS.items()
    }


def _is_by_leg(name: str) -> bool:
    """Return whether the last axis of a column enumerates legs."""
    return _SHAPE_BY_COLUMN[name][-1] in ("L", "S")


def _find_agent_axis(name: str) -> int:
    """Return the axis of a column that enumerates agents."""
    return _SHAPE_BY_COLUMN[name].index("n")


@dataclass(slots=True, eq=False)
class FeetState:
    """The feet of n agents with L legs. Positions are in world coordinates (mm), with the components as first axis. S is L for
    bodies with flat soles, else 0.

    Agents may be in any order. A step sorts them by the population's rows, so that neighbours in space are mostly adjacent.

    - `place` float64[3, n, L]: the point where each foot stands or is to land
    - `shown`, `start` float64[3, n, L]: the current position of each foot, and the position at which its swing started
    - `swing` float32[n, L]: the completed fraction of the swing; -1 for a standing foot
    - `on` int16[n, L]: the number of the thing below `place`; -1 for the ground plane, -2 for nothing (the foot hangs)
    - `face` int32[n, L], `weight` float64[2, n, L]: the triangle, and the weights of its second and third corner
    - `found` float32[n, L]: the distance (body lengths) of a foothold from the foot's rest position, if no ground is nearer
    - `phase` float32[n]: gait phase, from 0 to 1
    - `rise` float32[n]: height of the trunk above its rest height (mm)
    - `slope` float32[2, n]: the slope of the ground below the feet: increase in height per length ahead, and per length aside
    - `position` float64[3, n], `heading`, `up` float32[3, n]: the pose of the body at the end of the last frame
    - `tread`, `sole` float32[3, n, S]: the normal of the ground at `place`, and the current normal of each sole"""

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
    tread: NDArray[np.float32]
    sole: NDArray[np.float32]
    # Displacement of rest positions over the ground, float32[2, n, L], ahead and aside (body lengths); None between steps.
    covered: NDArray[np.float32] | None = field(default=None)
    stood: NDArray[np.float64] | None = field(default=None)  # positions before the ground moved, float64[3, n]; NaN: new
    row_hasher: RowHasher = field(default_factory=RowHasher)  # hashes the rows
    _cached_ranks: NDArray[np.int32] | None = field(default=None, init=False)

    @staticmethod
    def make_empty(legs: int, soles: int = 0) -> FeetState:
        """Return the feet of an empty population."""
        return FeetState(**_make_empty_columns(0, legs, soles))

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def legs(self) -> int:
        """Return the number of legs of each agent."""
        return int(self.swing.shape[1])

    @property
    def soles(self) -> int:
        """Return the number of flat soles per agent."""
        return int(self.sole.shape[2])

    @property
    def is_standing(self) -> NDArray[np.bool_]:
        """Return which feet stand on the ground, bool[n, L]."""
        return np.asarray(self.swing == SWING_PHASE_OF_STANDING_FOOT)

    def get_stored_arrays(self) -> dict[str, Array]:
        """Return the stored arrays, by name, without copying."""
        return {name: getattr(self, name) for name in _COLUMNS}

    def sort_by_id(self) -> FeetState:
        """Return the feet with rows sorted by id."""
        return self.match_ids(np.sort(self.ids))[0]

    def compute_id_ranks(self) -> NDArray[np.int32]:
        """Return the position that each row would have if the rows were sorted by id."""
        if self._cached_ranks is None:
            self._cached_ranks = invert_order(sort_stably(self.ids))
        return self._cached_ranks

    def _find_id_rows(self, ids: NDArray[np.int64]) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
        """Return the row of each id, and whether the id has a row. The row of an id without one has no meaning."""
        order = sort_stably(self.ids)
        at, known = match_ids(ids, self.ids.take(order))
        return order.take(at, mode="clip") if order.size else at, known

    def copy_common_agents(self, previous_feet: FeetState) -> None:
        """Copy values from `previous_feet`, for all agents that both objects contain."""
        at, known = previous_feet._find_id_rows(self.ids)
        for name, array in self.get_stored_arrays().items():
            rows: tuple[Any, ...] = (slice(None),) * _find_agent_axis(name)
            array[(*rows, known)] = getattr(previous_feet, name)[(*rows, at[known])]

    def match_ids(self, ids: NDArray[np.int64]) -> tuple[FeetState, NDArray[np.intp]]:
        """Return the feet of the agents `ids`, in this order, and the rows of agents that had no feet before. Such new agents get
        feet with all values zero."""
        if np.array_equal(ids, self.ids):
            return self, np.zeros(0, np.intp)
        at, known = self._find_id_rows(ids)
        new = np.flatnonzero(~known)
        columns: dict[str, Any] = {name: _select_rows(name, getattr(self, name), at, new) for name in _SHAPE_BY_COLUMN}
        return FeetState(**columns | {"ids": ids.copy()}), new


def _select_rows(name: str, array: Array | None, source_rows: NDArray[np.intp], new_rows: NDArray[np.intp]) -> Array | None:
    """Return the rows `source_rows` of the column `name`, with zeros in the rows `new_rows`.

    In the column of previous body positions, new rows contain NaN instead."""
    if array is None:
        return None
    axis, is_by_leg = _find_agent_axis(name), _is_by_leg(name)
    if not array.shape[axis]:
        shape = (*array.shape[:axis], len(source_rows), *array.shape[axis + 1 :])
        picked = make_zeros_by_leg(shape, array.dtype) if is_by_leg else np.zeros(shape, array.dtype)
    elif is_by_leg:
        picked = array.swapaxes(-1, -2).take(source_rows, axis=-1).swapaxes(-1, -2)
    else:
        picked = array.take(source_rows, axis=axis)
    if new_rows.size:
        rows: tuple[Any, ...] = (slice(None),) * axis
        picked[(*rows, new_rows)] = np.nan if name == "stood" else 0
    return picked


def feet_hash(feet: Mapping[str, FeetState], threads: int = 1) -> str:
    """Return a hash of the feet of all species, or an empty text without feet. `state_hash` does not include feet."""
    if not feet:
        return ""
    digest = sha256()
    for name in sorted(feet):
        digest.update(f"\0{name}\0{len(feet[name])}".encode())
        arrays = feet[name].get_stored_arrays()
        ids = arrays.pop("ids")
        if not feet[name].soles:
            arrays = {key: array for key, array in arrays.items() if "S" not in _SHAPE_BY_COLUMN[key]}
        columns = feet[name].row_hasher.split_columns(list(arrays.values()), [_find_agent_axis(key) == 1 for key in arrays])
        digest.update(describe_columns(tuple(arrays), arrays.values()) + feet[name].row_hasher.hash_rows(ids, columns, threads))
    return digest.hexdigest()[:32]


def restore_feet(arrays: Mapping[str, Array], feet: FeetState, ids: NDArray[np.int64]) -> FeetState:
    """Return the feet from arrays that `FeetState.get_stored_arrays` returned. `feet`: feet of the same body. Raises
    ValueError if the arrays do not match the legs and ids. The columns of flat soles may be missing if the body has no soles."""
    columns = _make_empty_columns(len(ids), feet.legs, feet.soles)
    for name, column in columns.items():
        array = arrays.get(name, column if "S" in _SHAPE_BY_COLUMN[name] and not feet.soles else None)
        if array is None or array.dtype != column.dtype or array.shape != column.shape:
            raise ValueError(f"`{name}` is missing or has another shape")
        column[...] = array
    if not np.array_equal(columns["ids"], ids):
        raise ValueError("the `ids` differ")
    return FeetState(**columns)
