"""All mutable data of a running simulation, as arrays: agents, items and fields.

Each register is an array, float32 unless the plan declares another type. Positions are also stored as float64. Agents sense
the values at the start of the step (`start`), and write to the current values (`now`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Generic, Literal, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.protocol import Footing, Ground
from antdsl.machine_code.memory import allocate_padded, gather_padded
from antdsl.numerics.row_copies import RowCopier, copy_rows
from antdsl.numerics.row_hash import RowHasher
from antdsl.numerics.sorting import invert_order, sort_stably
from antdsl.plan import ir
from antdsl.program.tables.columns import FIXED_COLUMN_BY_NAME, REGISTER_COLUMN_BY_NAME
from antdsl.runtime.requests import EffectRequests
from antdsl.scene.crowds.line_ids import CrowdLineIds
from antdsl.scene.setting import WorldSetting

if TYPE_CHECKING:
    from antdsl.casting.curves import SampledCurve
    from antdsl.casting.obstacle import Obstacle
    from antdsl.fields.cells import CellLookupState
    from antdsl.fields.flow import PaintedMap, SurfaceFlow
    from antdsl.fields.pheromone import PheromoneField
    from antdsl.fields.vector_field import VectorField
    from antdsl.ground.solid import Volume
    from antdsl.runtime.binding.overcrowding import OvercrowdedCrowd
    from antdsl.runtime.faults import FaultLog
    from antdsl.runtime.feet.feet_state import FeetState
    from antdsl.runtime.feet.feet_step import LegsOfBody
    from antdsl.runtime.feet.foothold_search import FootGround
    from antdsl.runtime.level_of_detail import DetailLevels
    from antdsl.runtime.motion_measures import MotionMeasures
    from antdsl.runtime.notes.note_run import ActiveNotesRun
    from antdsl.runtime.periodic_world import PeriodicWorld
    from antdsl.senses.neighbours import CellGrid
from antdsl.senses.touching import TouchingAgents

DTYPE_BY_KIND: Mapping[ir.ValueKind, type[np.generic]] = {
    ir.ValueKind.F32: np.float32, ir.ValueKind.BOOL: np.bool_, ir.ValueKind.I32: np.int32, ir.ValueKind.I64: np.int64,
}  # fmt: skip
AXES = ("x", "y", "z")
PUSHED_DISTANCE_REGISTER = "moved"  # mm per step, by contacts; only species that use it have this register
UNWRAPPED_REGISTERS = tuple(f"unwrapped.{axis}" for axis in AXES)  # mm; only species of periodic worlds have them
MOVED_REGISTERS = tuple(name for column in REGISTER_COLUMN_BY_NAME.values() if column.shape for name in column.registers)
ScalarType = TypeVar("ScalarType", bound=np.generic)


@dataclass(frozen=True, slots=True)
class Options:
    """Options of a run. Only `on_fault` affects results: it determines what happens after a fault. `chunk`: the number of rows
    that a thread processes at once. `shuffle_rows`: a seed for a random order of rows. `wait_for_code`: whether the first step
    waits for machine code instead of running in NumPy. `feet`: whether positions of feet are computed."""

    backend: Literal["numpy", "native", "reference"] = "native"
    chunk: int = 16_384
    threads: int = 1
    shuffle_rows: int | None = None
    on_fault: Literal["stop", "quarantine"] = "stop"
    wait_for_code: bool = False
    feet: bool = False


@dataclass(slots=True, eq=False)
class Items:
    """All items that share a name in the scene. `names`: the name of each item. `amounts` float64: the current amounts.
    `visible_values` float32: the amounts at the start of the step, which agents sense."""

    name: str
    names: tuple[str, ...]
    position: NDArray[np.float64]
    amounts: dict[str, NDArray[np.float64]]
    visible_values: dict[str, NDArray[np.float32]]

    def __len__(self) -> int:
        return len(self.names)

    def publish_amounts(self) -> None:
        """Copy the current amounts to the values that agents sense."""
        for name, amount in self.amounts.items():
            np.copyto(self.visible_values[name], amount, casting="same_kind")


class FixedColumnProperty(Generic[ScalarType]):
    """An attribute of a population that gets and sets the array of the same name in `columns`."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, population: Population, owner: type | None = None) -> NDArray[ScalarType]:
        return population.columns[self._name]

    def __set__(self, population: Population, array: NDArray[ScalarType]) -> None:
        population.columns[self._name] = array


@dataclass(slots=True, eq=False)
class Population:
    """All living agents of one species, as arrays with one row per agent. `columns`: the arrays in `FIXED_COLUMN_BY_NAME`.
    `start`, `now`: registers at the start of the step, and their current values. `cells`: each agent's cell, by field."""

    ids = FixedColumnProperty[np.int64]()
    born = FixedColumnProperty[np.int64]()
    quarantined = FixedColumnProperty[np.bool_]()
    position = FixedColumnProperty[np.float64]()
    normal = FixedColumnProperty[np.float32]()

    plan: ir.SpeciesPlan
    columns: dict[str, NDArray[Any]]
    start: dict[str, NDArray[Any]]
    now: dict[str, NDArray[Any]]
    footing: Footing
    events: dict[str, NDArray[np.bool_]]
    raised_events: dict[str, NDArray[np.bool_]]  # events that agents sense in the next step
    cells: dict[str, NDArray[np.int32]] = field(default_factory=dict)  # field -> own cell
    # field -> the lookup data of its cells, independent of rows
    voxels: dict[str, CellLookupState | None] = field(default_factory=dict)
    effects: EffectRequests = field(default_factory=EffectRequests)
    claimed_totals: dict[str, NDArray[np.float64]] = field(default_factory=dict)  # by site: total claimed in this step
    version: int = 0  # changes when rows change
    reordered: tuple[NDArray[np.int64], NDArray[np.intp]] | None = None  # ids before the last `retain_rows`, and its rows
    next_id: int = 0
    replaced_poses: tuple[NDArray[Any], ...] | None = None  # poses of leaning bodies, which `level_headings` replaced
    buffers: dict[str, tuple[NDArray[Any], ...]] = field(default_factory=dict)  # by name, for `get_buffers`
    row_copier: RowCopier = field(default_factory=RowCopier)  # copies registers when written values become visible
    row_hasher: RowHasher = field(default_factory=RowHasher)  # hashes the state
    _zero_copier: RowCopier = field(default_factory=RowCopier)  # copies zeros to registers that exist only within a step
    _cached_rows: tuple[int, NDArray[np.int64], NDArray[np.intp]] | None = None
    _cached_ranks: tuple[int, NDArray[np.int32]] | None = None
    bodies: tuple[int, NDArray[np.uint8]] | None = None  # version, and the index of each row's body: see `body_rows`
    _cached_state_names: tuple[ir.SpeciesPlan, tuple[str, ...]] | None = None
    # the plan, the number of agents, and arrays of zeros
    _cached_temps: tuple[ir.SpeciesPlan, int, dict[str, NDArray[Any]]] | None = None

    def list_state_registers(self) -> tuple[str, ...]:
        """Return the names of registers that belong to the state, in order."""
        if self._cached_state_names is None or self._cached_state_names[0] is not self.plan:
            names = tuple(name for name in sorted(self.now) if self.plan.registers[name].role != "temp")
            self._cached_state_names = (self.plan, names)
        return self._cached_state_names[1]

    def clear_temporary_registers(self, threads: int = 1) -> None:
        """Set all registers that exist only within a step to 0."""
        n = len(self)
        if self._cached_temps is None or self._cached_temps[0] is not self.plan or self._cached_temps[1] != n:
            temps = {name: each for name, each in self.plan.registers.items() if each.role == "temp"}
            zeros = {(r.kind, r.initial_value): np.full(n, r.initial_value, DTYPE_BY_KIND[r.kind]) for r in temps.values()}
            self._cached_temps = (self.plan, n, {name: zeros[each.kind, each.initial_value] for name, each in temps.items()})
        zeros_of = self._cached_temps[2]
        self._zero_copier.copy(list(map(self.now.__getitem__, zeros_of)), list(zeros_of.values()), threads)

    def get_buffers(self, name: str, count: int, shape: tuple[int, ...], dtype: type[np.generic]) -> tuple[NDArray[Any], ...]:
        """Return `count` arrays for results of a step. The same arrays are returned, and overwritten, in the next step."""
        arrays = self.buffers.get(name)
        if arrays is None or arrays[0].shape != shape:
            arrays = self.buffers[name] = tuple(np.empty(shape, dtype) for _ in range(count))
        return arrays

    @property
    def name(self) -> str:
        return self.plan.name

    def __len__(self) -> int:
        return len(self.columns["ids"])

    def get_sorted_ids(self) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
        """Return all ids in ascending order, and the row of each id. Callers must not change these arrays."""
        if self._cached_rows is None or self._cached_rows[0] != self.version:
            order = sort_stably(self.ids)
            self._cached_rows = (self.version, self.ids[order], order)
        return self._cached_rows[1], self._cached_rows[2]

    def find_rows(self, ids: NDArray[np.int64]) -> NDArray[np.intp]:
        """Return the row of each id; -1 for dead agents and for the id -1."""
        known, order = self.get_sorted_ids()
        if not len(known):
            return np.full(np.shape(ids), -1, np.intp)
        at = np.minimum(np.searchsorted(known, ids), len(known) - 1)
        return np.where(known[at] == ids, order[at], -1)

    def get_rows_by_id(self) -> NDArray[np.intp]:
        """Return all rows in ascending order of the agents' ids."""
        return self.get_sorted_ids()[1]

    def compute_id_ranks(self) -> NDArray[np.int32]:
        """Return, for each row, the rank of its id among all ids."""
        if self._cached_ranks is None or self._cached_ranks[0] != self.version:
            self._cached_ranks = self.version, invert_order(self.get_rows_by_id())
        return self._cached_ranks[1]

    def draw_living_ids(self, random_words: NDArray[np.uint64]) -> NDArray[np.int64]:
        """Return the id of a living agent for each 32-bit random word, uniformly distributed. -1 if no agent lives."""
        known, _ = self.get_sorted_ids()
        if not len(known):
            return np.full(np.shape(random_words), -1, np.int64)
        return known[((random_words * np.uint64(len(known))) >> np.uint64(32)).astype(np.intp)]

    def read_vector(self, name: str, *, is_current: bool = True) -> NDArray[np.float64]:
        """Return the components of a vector register, float64 (n, 3): current values, or those at the start of the step."""
        source = self.now if is_current else self.start
        return np.stack([source[f"{name}.{axis}"] for axis in AXES], axis=1).astype(np.float64)


class StepBackend(Protocol):
    """The interface of backends, which run the blocks of a plan; see `backends`."""

    def begin_step(self, world: World) -> None:
        """Begin a step: discard data that was cached for the last step."""

    def run(self, world: World, population: Population, block: str, rows: NDArray[np.intp] | None = None) -> None:
        """Run a block for the agents `rows`; None means all agents."""

    def list_messages(self) -> list[str]:
        """Return messages for the user, for example that NumPy runs instead of machine code. Results are the same."""


@dataclass(slots=True, eq=False)
class World:
    """The state of a running simulation.

    `frame`: the number of the current frame; during a step, the frame before the step. `origin` (mm): subtracted from all
    positions at binding, so that float32 stays precise far from the scene's zero."""

    plan: ir.Plan
    setting: WorldSetting
    options: Options
    up: NDArray[np.float64]
    origin: NDArray[np.float64]
    frame: int
    params: dict[str, np.float32]
    populations: dict[str, Population]
    items: dict[str, Items]
    fields: dict[str, PheromoneField]
    vector_fields: dict[str, VectorField]  # fields of vectors; `fields` has their components
    field_rates: dict[str, tuple[np.float32, float]]  # decay factor per step, diffusion (mm²/s)
    obstacles: dict[str, Obstacle]  # by name; includes surfaces and solids
    curves: dict[str, SampledCurve]
    flows: dict[str, SurfaceFlow]
    maps: dict[str, PaintedMap]
    ground: Ground
    surface_index: dict[str, int]
    solids: dict[str, Volume]
    backend: StepBackend
    faults: FaultLog
    motion: MotionMeasures
    crowd_lines: tuple[CrowdLineIds, ...]  # by the index of the crowd line
    timings: dict[str, float] = field(default_factory=dict)  # wall time (s) by phase, over all steps
    cpu_seconds: dict[str, float] = field(default_factory=dict)  # CPU time (s) of all threads by phase, over all steps
    grids: dict[tuple[str, float], CellGrid] = field(default_factory=dict)  # of this step
    trees: dict[str, Any] = field(default_factory=dict)  # of this step, by species: k-d trees of all
    clearances: dict[tuple[str, str, int], NDArray[Any]] = field(default_factory=dict)  # of this step
    obstacle_faces: Any = None  # the obstacles, and their faces for kernels, see `obstacle_clearance`; None: not computed yet
    touching_agents: dict[tuple[str, str], TouchingAgents] | None = None  # of this step, by both species; None: not computed yet
    transitions: dict[str, int] = field(default_factory=dict)
    dug_balls: dict[str, list[NDArray[np.float64]]] | None = None  # balls (k, 4) since the last retrieval; None: not recorded
    emissions: list[dict[str, NDArray[Any]]] | None = None  # columns of `EMIT` since the last retrieval; None: not recorded
    spec_values: dict[str, np.float32] = field(default_factory=dict)  # aggregate values that a spec requests, by name
    detail_levels: DetailLevels | None = None
    notes: ActiveNotesRun | None = None  # None: the scene has none
    overcrowded_lines: list[OvercrowdedCrowd] = field(default_factory=list)  # crowd lines without space for all agents
    unreached_field_starts: list[tuple[str, int]] = field(default_factory=list)  # field, and index of a value without cells
    watchers: list[Callable[[World], None]] = field(default_factory=list)  # called in each step after the phase `act`
    feet: dict[str, FeetState] = field(default_factory=dict)  # by body key; only those with computed feet
    legs_by_species: dict[str, LegsOfBody] = field(default_factory=dict)  # legs and gaits, by body key
    foot_ground: FootGround | None = None  # the ground for feet
    periodic: PeriodicWorld | None = None  # None: the world does not wrap
    is_stepping: bool = False  # between the first and the last phase of a step

    @property
    def dt(self) -> float:
        return self.setting.dt

    @property
    def display_frame(self) -> int:
        """Return the frame to which computations belong: during a step the frame that it produces, else the current one."""
        return self.frame + self.is_stepping

    def __len__(self) -> int:
        return sum([len(p.ids) for p in self.populations.values()])


def list_stored_registers(plan: ir.SpeciesPlan) -> frozenset[str]:
    """Return the registers that a block or a phase may change after birth."""
    names = {*MOVED_REGISTERS, PUSHED_DISTANCE_REGISTER, *UNWRAPPED_REGISTERS}
    pending: list[ir.Block] = [plan.decide, plan.act, plan.blend]
    while pending:
        for statement in pending.pop().statements:
            if isinstance(statement, ir.If):
                pending.append(statement.body)
            elif isinstance(statement, ir.Store):
                names.add(statement.register)
            elif isinstance(statement, ir.Claim):
                names.update(name for name in (statement.won_register, statement.register) if name)
            elif isinstance(statement, ir.Give | ir.Request) and statement.register is not None:
                names.add(statement.register)
    return frozenset(names)


def is_start_array_shared(plan: ir.SpeciesPlan, register: str, stored_registers: frozenset[str]) -> bool:
    """Return whether one array is enough for both the start values and the current values of a register.

    It is if the register never changes after birth, or exists only within a step."""
    return register not in stored_registers or plan.registers[register].role == "temp"


def make_empty_population(plan: ir.SpeciesPlan, ground: Ground) -> Population:
    """Return a population without agents; `add_rows` adds agents."""
    now = {name: np.empty(0, DTYPE_BY_KIND[r.kind]) for name, r in plan.registers.items()}
    stored = list_stored_registers(plan)
    start = {
        name: array if is_start_array_shared(plan, name, stored) else np.empty(0, array.dtype) for name, array in now.items()
    }
    events, raised = ({name: np.empty(0, np.bool_) for name in plan.event_names} for _ in range(2))
    return Population(plan, make_fixed_columns(0), start, now, ground.create_unplaced(0), events, raised)


def make_fixed_columns(count: int, **known: Any) -> dict[str, NDArray[Any]]:
    """Return the columns of `FIXED_COLUMN_BY_NAME` for `count` new rows: `known` arrays, else initial values."""
    return {
        name: np.asarray(known[name])
        if name in known
        else np.full((count, *column.compute_dimensions()), column.initial_value, column.type)
        for name, column in FIXED_COLUMN_BY_NAME.items()
    }


def retain_rows(population: Population, rows: NDArray[np.intp]) -> None:
    """Reduce a population to the given rows, in the given order."""
    _reorder_columns(population, rows)
    _replace_registers(population, lambda array, _: gather_padded(array, rows))


def publish_state(population: Population, threads: int, rows: NDArray[np.intp] | None = None) -> None:
    """Make the current values the start values of the next step, which agents sense. `rows`: a new order of the agents; None
    to retain their order. Current and start values stay in their arrays, unless one array serves for both."""
    start, now = population.start, population.now
    if rows is not None:
        _reorder_columns(population, rows)
        n = len(rows)
        picked = [(allocate_padded(n, own.dtype) if start[name] is own else start[name], own) for name, own in now.items()]
        copy_rows(picked, rows, threads)
        for name, (to, array) in zip(now, picked, strict=True):
            if start[name] is array:
                start[name] = now[name] = to
        population.version += 1
    every = list(map(start.__getitem__, now)), list(now.values())
    population.row_copier.copy(*(every if rows is None else every[::-1]), threads)


def _reorder_columns(population: Population, rows: NDArray[np.intp]) -> None:
    """Reorder all arrays except registers by `rows`."""
    population.reordered = (population.ids, rows)
    for name, array in population.columns.items():
        population.columns[name] = _select_vector_rows(array, rows) if name == "position" else array.take(rows, axis=0)
    population.footing = population.footing.select_rows(rows)
    population.cells.clear()
    for table in (population.events, population.raised_events):
        for name, array in table.items():
            table[name] = array.take(rows)


def _select_vector_rows(vectors: NDArray[Any], rows: NDArray[np.intp]) -> NDArray[Any]:
    """Return the given rows of vectors (n, 3). Each component of the result is contiguous in memory."""
    picked = np.empty((3, len(rows)), vectors.dtype)
    for component, own in zip(picked, vectors.T, strict=True):
        own.take(rows, out=component, mode="clip")
    return picked.T


def add_rows(population: Population, ids: NDArray[np.int64], frame: int, place: NDArray[np.float64], footing: Footing) -> slice:
    """Append agents with their registers at the initial values to a population. Return their rows."""
    old, count = len(population), len(ids)
    added = make_fixed_columns(count, ids=ids, born=np.full(count, frame, np.int64), position=place)
    for name, array in population.columns.items():
        population.columns[name] = np.concatenate([array, added[name]])
    population.footing = Footing.concatenate(population.footing, footing)
    for table in (population.events, population.raised_events):
        for name, array in table.items():
            table[name] = np.concatenate([array, np.zeros(count, np.bool_)])
    population.cells.clear()
    zeros = population.plan.registers
    _replace_registers(population, lambda a, name: np.concatenate([a, np.full(count, zeros[name].initial_value, a.dtype)]))
    return slice(old, old + count)


def _replace_registers(population: Population, change: Callable[[NDArray[Any], str], NDArray[Any]]) -> None:
    """Replace every register array by the result of `change`. Registers with one array for both `start` and `now` still have
    one array."""
    for name, array in population.now.items():
        shared = population.start[name] is array
        population.now[name] = change(array, name)
        population.start[name] = population.now[name] if shared else change(population.start[name], name)
    population.version += 1
