"""Agents, items and fields of a simulation, as arrays that a caller can read and set."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from antdsl.api.errors import AntdslError
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.fields.pheromone import PheromoneField
from antdsl.fields.vector_field import VectorField, list_program_fields
from antdsl.plan.ir import ValueKind
from antdsl.program.tables.vocabulary import explain_range, is_limit_attribute
from antdsl.runtime.world import AXES

if TYPE_CHECKING:
    from antdsl.api.simulation import Simulation
    from antdsl.runtime.world import Items, Population, World

_MOTION_ARRAY_NAMES = ("position", "velocity", "heading", "up")  # vectors that all agents have; only steps change them
_MAX_HTML_ROWS = 5


def make_unknown_name_error(kind: str, name: object, known: Iterator[str] | tuple[str, ...]) -> AntdslError:
    """Return the error for a name that is not in `known`. `kind`: the kind of name, such as `species`."""
    names = sorted(known)
    near = find_nearest_name(str(name), names)
    return AntdslError(
        f"there is no {kind} `{name}`",
        f"did you mean `{near}`?" if near else f"the known names are: {', '.join(names) or 'none'}",
    )


def make_read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Make an array read-only, and return it. The array is a copy, so a caller's changes to it would have no effect."""
    array.setflags(write=False)
    return array


def import_pandas() -> Any:
    """Return the module pandas. Raises AntdslError if it is not installed."""
    try:
        import pandas
    except ImportError:
        raise AntdslError("pandas is not installed", "install it: `pip install pandas`") from None
    return pandas


def make_table(columns: dict[str, NDArray[Any]], index: NDArray[Any], name: str) -> Any:
    """Return columns as a DataFrame. A vector column becomes one column per axis. Raises AntdslError if pandas is not
    installed."""
    pandas = import_pandas()
    flat: dict[str, NDArray[Any]] = {}
    for column, values in columns.items():
        flat |= {f"{column}.{axis}": values[:, k] for k, axis in enumerate(AXES)} if values.ndim == 2 else {column: values}
    return pandas.DataFrame(flat, index=pandas.Index(index, name=name))


def format_html_table(columns: dict[str, NDArray[Any]], index: NDArray[Any], title: str) -> str:
    """Return the first rows of a table as HTML."""
    from html import escape

    first_rows = index[:_MAX_HTML_ROWS]
    rows = [
        f"<tr><th>{escape(str(row))}</th>"
        + "".join(f"<td>{escape(str(values[k]))}</td>" for values in columns.values())
        + "</tr>"
        for k, row in enumerate(first_rows)
    ]
    note = f"<p>{len(index) - len(first_rows):,} more</p>" if len(index) > len(first_rows) else ""
    head = "".join(f"<th>{escape(name)}</th>" for name in ("", *columns))
    return f"<p><b>{escape(title)}</b></p><table><tr>{head}</tr>{''.join(rows)}</table>{note}"


class Crowd:
    """The living agents of one species at the current frame. `crowd["load"]` is an array with one row per agent, by id.

    - `position` (mm, scene axes), `velocity` (mm/s), `heading` and `up`: float64 (n, 3)
    - `state`: the name of each agent's state; for machines other than `main`, `MACHINE.state`. `time_in_state` (s), or
      `MACHINE.time_in_state`: the time since the agent entered the state
    - `age` (s), and the attributes of the program, in base units: numbers, vectors, conditions, ids of agents (-1 for none) and
      names of items ("" for none). Positions in attributes are relative to `Simulation.origin`

    Arrays are read-only copies. `crowd["load"] = values` sets an attribute; `values` is one number, or one number per agent."""

    def __init__(self, simulation: Simulation, species: str) -> None:
        self._simulation, self.species = simulation, species

    @property
    def _world(self) -> World:
        return self._simulation.world

    @property
    def _population(self) -> Population:
        return self._world.populations[self.species]

    def __len__(self) -> int:
        return len(self._population)

    @property
    def ids(self) -> NDArray[np.int64]:
        """The ids of the agents (n,), ascending."""
        return make_read_only(self._population.get_sorted_ids()[0].copy())

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all arrays."""
        return (*_MOTION_ARRAY_NAMES, *self._machine_columns(), "age", *self.attributes)

    @property
    def attributes(self) -> tuple[str, ...]:
        """The names of all attributes: those that the program declares and those that every agent has."""
        registers = self._population.plan.registers
        names = (name.rpartition(".")[0] if name.endswith((".x", ".y", ".z")) else name for name, r in registers.items() if
                 r.role == "attribute")  # fmt: skip
        return tuple(name for name in dict.fromkeys(names) if name not in _MOTION_ARRAY_NAMES and not name.startswith("~"))

    @property
    def settable(self) -> tuple[str, ...]:
        """The names of the attributes that can be set: numbers, vectors and conditions."""
        registers = self._population.plan.registers
        kinds = {name: registers[name if name in registers else f"{name}.x"].kind for name in self.attributes}
        return tuple(name for name, kind in kinds.items() if kind in (ValueKind.F32, ValueKind.BOOL))

    def _machine_columns(self) -> dict[str, tuple[str, str]]:
        """Return the machine behind each state array, by array name, and the part of it: `state` or `time_in_state`."""
        machines = self._population.plan.machines
        columns = dict[str, tuple[str, str]]()
        for machine in machines:
            prefix = "" if machine.name == "main" or len(machines) == 1 else f"{machine.name}."
            columns |= {f"{prefix}{part}": (machine.name, part) for part in ("state", "time_in_state")}
        return columns

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return the array called `name`, one of `names`. Raises AntdslError for another name."""
        population, rows = self._population, self._population.get_rows_by_id()
        if name == "position":
            return make_read_only(population.read_vector(name)[rows] + self._world.origin)
        if name in _MOTION_ARRAY_NAMES:
            return make_read_only(population.read_vector(name)[rows])
        if name == "age":
            return make_read_only(np.maximum(self._world.frame - population.born[rows], 0) * self._world.dt)
        if (column := self._machine_columns().get(name)) is not None:
            values = population.now[".".join(column)][rows]
            if column[1] == "state":
                states = next(machine.states for machine in population.plan.machines if machine.name == column[0])
                values = np.array(states, dtype=str)[values] if states else values.astype(str)
            return make_read_only(np.array(values))
        if name in self.attributes:
            if name not in population.now:
                return make_read_only(population.read_vector(name)[rows])
            values = population.now[name][rows]
            kind, *_, group = population.plan.registers[name].language_type or ("number", None)
            if kind == "item":
                members = (*self._world.items[group].names, "")  # -1, the last, is none
                values = np.array(members, dtype=str)[np.where((values >= 0) & (values < len(members) - 1), values, -1)]
            return make_read_only(values)
        raise make_unknown_name_error(f"array of `{self.species}`", name, self.names)

    def __setitem__(self, name: str, values: ArrayLike) -> None:
        """Set an attribute of all agents, from the next step on. `values`: one value, or one per agent in the order of ids.

        Raises AntdslError if `name` is not an attribute, the shape is wrong, or a value is not allowed, such as a size of 0.
        Limits such as `max_turn` may be infinite."""
        population = self._population
        if name not in self.settable:
            if name in self.names:
                raise AntdslError(f"`{name}` is computed by steps and cannot be set", f"set one of: {', '.join(self.settable)}")
            raise make_unknown_name_error(f"attribute of `{self.species}`", name, self.settable)
        registers = [name] if name in population.now else [f"{name}.{axis}" for axis in AXES]
        shape = (len(population),) if len(registers) == 1 else (len(population), 3)
        try:
            columns = np.broadcast_to(np.asarray(values, np.float64), shape)
        except (TypeError, ValueError):
            raise AntdslError(
                f"`{name}` needs numbers of the shape {shape}",
                f"pass one row of numbers for each of the {len(population)} agents",
            ) from None
        with np.errstate(over="ignore"):
            columns = columns.astype(np.float32)
        if not (np.isfinite(columns) | (is_limit_attribute(name) & (columns == np.inf))).all():
            raise AntdslError(f"`{name}` needs finite numbers, without nan and inf")
        for extreme in (columns.min(), columns.max()) if columns.size else ():
            if (advice := explain_range(name, float(extreme))) is not None:
                raise AntdslError(f"`{name}` cannot be {extreme:g}", advice)
        rows = population.get_rows_by_id()
        for k, register in enumerate(registers):
            column = columns if len(registers) == 1 else columns[:, k]
            for arrays in (population.now, population.start):
                arrays[register][rows] = column.astype(arrays[register].dtype)

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __contains__(self, name: object) -> bool:
        return name in self.names

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.names)

    def to_pandas(self) -> Any:
        """Return a DataFrame with one row per agent, with the ids as index. Raises AntdslError without pandas."""
        return make_table({name: self[name] for name in self.names}, self.ids, "id")

    def __repr__(self) -> str:
        return f"<{len(self):,} agents of {self.species!r} at frame {self._simulation.frame}: {', '.join(self.names)}>"

    def _repr_html_(self) -> str:
        return format_html_table({name: self[name] for name in self.names}, self.ids, repr(self)[1:-1].partition(":")[0])


class ItemGroup:
    """All items of one name. `items["load"]`: the amount that each item has left, float64 (n,). `items["position"]`: (n, 3) in
    mm."""

    def __init__(self, simulation: Simulation, name: str) -> None:
        self._simulation, self.name = simulation, name

    @property
    def _items(self) -> Items:
        return self._simulation.world.items[self.name]

    @property
    def members(self) -> tuple[str, ...]:
        """The names of the items."""
        return self._items.names

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all arrays."""
        return ("position", *self._items.amounts)

    def __len__(self) -> int:
        return len(self._items)

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """Return the array called `name`, one of `names`, as a read-only copy. Raises AntdslError for another name."""
        if name == "position":
            return make_read_only(self._items.position + self._simulation.world.origin)
        if name not in self._items.amounts:
            raise make_unknown_name_error(f"array of the items `{self.name}`", name, self.names)
        return make_read_only(self._items.amounts[name].copy())

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.names)

    def to_pandas(self) -> Any:
        """Return a DataFrame with one row per item. Raises AntdslError without pandas."""
        return make_table({name: self[name] for name in self.names}, np.array(self.members, dtype=str), "item")

    def __repr__(self) -> str:
        return f"<{len(self):,} items {self.name!r}: {', '.join(self.names)}>"


class Field:
    """A field of the simulation. `values`: the amount in each cell (n,), or a vector (n, 3). `positions`: the centre of each
    cell (n, 3) in mm."""

    def __init__(self, simulation: Simulation, name: str) -> None:
        self._simulation, self.name = simulation, name

    @property
    def values(self) -> NDArray[Any]:
        """The amounts (n,) or vectors (n, 3) of all cells, as a read-only copy."""
        field = self._find_field()
        return make_read_only(field.vectors if isinstance(field, VectorField) else np.array(field.amounts))

    @property
    def positions(self) -> NDArray[np.float64]:
        """The centres (n, 3) of all cells, in mm."""
        field = self._find_field()
        return make_read_only(np.asarray(field.cells.position, np.float64) + self._simulation.world.origin)

    @property
    def total(self) -> float:
        """The sum over all cells. For vectors, the sum of their lengths."""
        return float(np.sum(self._find_field().amounts, dtype=np.float64))

    def __len__(self) -> int:
        return len(self.values)

    def __repr__(self) -> str:
        return f"<field {self.name!r}: {len(self):,} cells, total {self.total:.6g}>"

    def _find_field(self) -> PheromoneField | VectorField:
        return list_program_fields(self._simulation.world)[self.name]
