"""The arrays of one species, sorted by agent id, under the names that they have in packets for the page."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.program.tables.columns import AGENT_COLUMNS, Column
from antdsl.runtime import Population
from antdsl.runtime.body_positions import compute_body_positions
from antdsl.runtime.world import AXES

Arrays = dict[str, NDArray[Any]]
_PACKET_COLUMNS = sorted((column for column in AGENT_COLUMNS if column.packet), key=lambda column: column.name != "ids")
POSITION_COLUMNS = [column for column in _PACKET_COLUMNS if column.name in ("ids", "position")]
_REDUCED_FRAME_COLUMNS = [column for column in _PACKET_COLUMNS if column.in_preview]
CURRENT_COLUMNS = [column for column in _PACKET_COLUMNS if not column.in_preview]


def make_reduced_frame(population: Population, previous_arrays: Arrays | None = None) -> Arrays:
    """Return the arrays of a species that are stored for each frame, including the states of each machine. `previous_arrays`:
    the arrays of the previous frame. An array that did not change is not copied: both frames share one object."""
    rows = population.get_rows_by_id()
    states = {f"state/{m.name}": population.now[f"{m.name}.state"][rows].astype(np.uint8) for m in population.plan.machines}
    return reuse_arrays(make_packet_arrays(population, _REDUCED_FRAME_COLUMNS) | states, previous_arrays or {})


def reuse_arrays(arrays: Arrays, previous_arrays: Arrays) -> Arrays:
    """Return `arrays`. An array that equals the array of the same name in `previous_arrays` is replaced by that object, which
    saves memory."""
    return {
        name: previous_arrays[name] if name in previous_arrays and np.array_equal(previous_arrays[name], array) else array
        for name, array in arrays.items()
    }


def make_packet_arrays(population: Population, columns: Iterable[Column]) -> Arrays:
    """Return the arrays of `columns` as a packet stores them. A unit vector is stored as three signed bytes: its components
    times 127."""
    rows = population.get_rows_by_id()
    return {column.packet.split()[0]: _make_column_array(population, column, rows) for column in columns}


def _make_column_array(population: Population, column: Column, rows: NDArray[np.intp]) -> NDArray[Any]:
    kind = column.packet.split()[1]
    if column.kind == "derived":
        return VALUE_FUNCTIONS[column.name](population)[rows]
    if column.kind == "fixed":
        values = compute_body_positions(population) if column.name == "position" else population.columns[column.name]
        return values[rows].astype(kind)
    values = np.stack([population.now[name][rows] for name in column.registers], axis=-1).reshape(-1, *column.shape)
    return np.rint(values * np.float32(127)).astype(kind) if kind == "i1" else values.astype(kind)


def _compute_speeds(population: Population) -> NDArray[np.float32]:
    x, y, z = (population.now[f"velocity.{axis}"] for axis in AXES)
    speed: NDArray[np.float32] = np.sqrt(x * x + y * y + z * z)
    return speed


VALUE_FUNCTIONS: Mapping[str, Callable[[Population], NDArray[Any]]] = {"speed": _compute_speeds}
