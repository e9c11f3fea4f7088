"""Measures of the motion in a run, to judge whether agents look alive. They affect no agent, and are not part of the state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import cache, partial
from itertools import chain
from math import fsum
from operator import itemgetter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import F32, F64, I64, Array1, Array2, Strided2, allocate_scratch, inlined, kernel, simd_range
from antdsl.numerics import parallel
from antdsl.numerics import vectors as vec
from antdsl.numerics.kernel_vectors import VectorColumns
from antdsl.numerics.parallel import compute_buffer_index
from antdsl.runtime.binding.spacing import has_extent
from antdsl.runtime.moving.clearance.bodies_inside import find_sampled_bodies_inside
from antdsl.runtime.moving.clearance.head_clearance import find_heads_inside
from antdsl.runtime.moving.contacts.capsules import measure_overlap_depths
from antdsl.runtime.periodic_world import measure_overlaps
from antdsl.runtime.world import AXES

if TYPE_CHECKING:
    from antdsl.runtime.world import Population, World

Counts = NDArray[np.int64]
Floats = NDArray[np.float64]
_HISTOGRAM_BINS = 1800  # bins of a histogram: 0.1 degrees of turn each, or 1/1800 of overlap each
_PATH_WINDOW_SECONDS = 2.0  # s: duration of a path that is classified as straight or circling
_MAX_CIRCLING_SHARE = 0.15  # a path circles if its net displacement is at most this share of its length
_MIN_PATH_BODY_LENGTHS = 3.0  # shorter paths are not classified
_MIN_PUSH_SHARE = 0.2  # agents with a smaller push do not intend to move
_STANDING_SPEED_SHARE = 0.03  # share of max_speed below which an agent stands
_TOUCH_OVERLAP_SHARE = 0.01  # share of the sum of two radii: a smaller overlap is only a touch
_VISIBLE_OVERLAP_SHARE = 0.05  # share of the trunk's width: deeper overlaps are visible
_MAX_AGENTS_MEASURED_EACH_STEP = 2_000  # with k times as many, trunks are measured about every k steps
_POSE_REGISTERS = tuple(f"{name}.{axis}" for name in ("position", "heading", "up") for axis in AXES)
_MOTION_REGISTERS = tuple(f"{name}.{axis}" for name in ("velocity", "push") for axis in AXES)
_MEASURED_REGISTERS = (*_POSE_REGISTERS, *_MOTION_REGISTERS, "max_speed", "size")
_CURRENT_REGISTERS, _STEP_START_REGISTERS = itemgetter(*_MEASURED_REGISTERS), itemgetter(*_POSE_REGISTERS)
_MOTION_THRESHOLDS = (np.float32(_MIN_PUSH_SHARE), np.float32(_STANDING_SPEED_SHARE), np.float32(_MIN_PATH_BODY_LENGTHS))
_AGENTS_PER_PART = 512  # agents per chunk; the values of a chunk are computed before they are counted
_BIN_LOOKUP_CELLS = 4096  # cells of half chords; each has the first bin that it overlaps


@dataclass(slots=True, eq=False)
class PathWindow:
    """Paths of agents in the current time window: ids, `start` (n, 3) mm, length `path` (mm), `age` (steps), and a buffer."""

    ids: Counts
    start: Floats
    path: Floats
    age: Counts
    straightness: Floats = field(init=False)  # buffer for the result of a step

    def __post_init__(self) -> None:
        self.straightness = np.empty(len(self.ids))


@dataclass(slots=True, eq=False)
class MotionMeasures:
    """Measures of motion in a run: histograms of turns, tilts and overlaps; counts of agents and paths (`ways`); maxima."""

    turns: Counts = field(default_factory=lambda: np.zeros(_HISTOGRAM_BINS + 1, np.int64))
    tilts: Counts = field(default_factory=lambda: np.zeros(_HISTOGRAM_BINS + 1, np.int64))
    overlaps: Counts = field(default_factory=lambda: np.zeros(_HISTOGRAM_BINS + 1, np.int64))
    standing: int = 0
    wishing: int = 0
    ways: int = 0
    circling: int = 0
    straightness: float = 0.0
    steps: int = 0
    tilt_max: float = 0.0
    step_max: float = 0.0
    heads: int = 0
    heads_inside: int = 0
    bodies: int = 0
    bodies_inside: int = 0
    placed: int = 0
    overlapping: int = 0
    deep_max: float = 0.0
    max_half_chord: float = 0.0  # the half chord of a tilt that `tilt_max` was computed for
    part_counts: Counts = field(default_factory=lambda: np.zeros((2, 1, _HISTOGRAM_BINS + 1), np.int64))  # see `_add_part_counts`
    windows: dict[str, PathWindow] = field(default_factory=dict)

    def reset_step_measures(self) -> None:
        """Restart all measures, for example after a preroll, except the overlaps at the start that `begin` counted."""
        for each in fields(fresh := MotionMeasures(placed=self.placed, overlapping=self.overlapping)):
            setattr(self, each.name, getattr(fresh, each.name))

    def begin_measuring(self, world: World) -> None:
        """Count the agents that overlap an agent of any species at the start, before any agent moves."""
        crowds = [population.now for population in world.populations.values()]
        if not crowds:
            return
        radius = np.concatenate([now["radius"] for now in crowds])
        wide = has_extent(radius)
        x, y, z = (np.concatenate([now[f"position.{axis}"] for now in crowds])[wide] for axis in "xyz")
        self.placed = len(radius)
        self.overlapping = int(np.count_nonzero(measure_overlaps(world, x, y, z, radius[wide]) > _TOUCH_OVERLAP_SHARE))

    def collect_checkpoint_arrays(self) -> dict[str, NDArray[Any]]:
        """Return all measures as named arrays, for a checkpoint."""
        self._add_part_counts()
        named_arrays = {name: np.array(getattr(self, name)) for name in _CHECKPOINT_FIELDS}
        for species, window in self.windows.items():
            named_arrays |= {f"window.{species}.{name}": np.array(getattr(window, name)) for name in _WINDOW_COLUMNS}
        return named_arrays

    @classmethod
    def from_arrays(cls, arrays: dict[str, NDArray[Any]]) -> MotionMeasures:
        """Return the measures that the arrays of a checkpoint contain. Measures without an array start from 0."""
        motion = cls()
        for name in _CHECKPOINT_FIELDS:
            if name in arrays:
                value = arrays[name]
                setattr(motion, name, value.copy() if value.ndim else value.item())
        for species in sorted({name.split(".", 1)[1].rsplit(".", 1)[0] for name in arrays if name.startswith("window.")}):
            motion.windows[species] = PathWindow(*(arrays[f"window.{species}.{name}"].copy() for name in _WINDOW_COLUMNS))
        return motion

    def record_step(self, world: World) -> None:
        """Add one step to all measures. Call this after the phase `move`, before the ground moves."""
        second = max(1, round(1.0 / world.dt))
        every = second if world.setting.contacts == "off" else 1 + len(world) // _MAX_AGENTS_MEASURED_EACH_STEP
        crowds = [population for population in world.populations.values() if len(population)]
        for population in crowds:
            self._add_step_of_species(world, population)
        with_depths, bodies = self.steps % every == 0 and len(world) > 1, self.steps % second == 0
        if with_depths or bodies:
            self._measure_bodies(world, with_depths, crowds if bodies else [])
        self.steps += 1

    def _add_step_of_species(self, world: World, population: Population) -> None:
        window, steps = self._update_window(population), max(1, round(_PATH_WINDOW_SECONDS / world.dt))
        straight = self._count_motion(population, window, np.float32(world.dt), steps, world.options.threads)
        self.wishing += len(population)
        if len(straight):
            self.ways += len(straight)
            self.circling += int(np.count_nonzero(straight < _MAX_CIRCLING_SHARE))
            self.straightness += fsum(straight)  # `fsum`: the same result for any order of rows

    def _count_motion(self, population: Population, window: PathWindow, dt: np.float32, steps: int, threads: int) -> Floats:
        """Add a step to the counts and paths. Return the straightness (0 to 1) of each path that ended in this step."""
        now, start = _CURRENT_REGISTERS(population.now), _STEP_START_REGISTERS(population.start)
        poses = (now[0:3], now[3:6], now[6:9], start[0:3], start[3:6], start[6:9])
        agents = AgentColumns(*poses, now[9:12], now[12:15], *now[15:])
        paths = PathColumns(population.position, window.start, window.path, window.age, window.straightness)
        n = len(population)
        several = parallel.count_parts(n, threads, parallel.MIN_LIGHT_ITEMS_PER_THREAD)
        if self.part_counts.shape[1] < several:
            self._add_part_counts()
            self.part_counts = np.zeros((2, several, _HISTOGRAM_BINS + 1), np.int64)
        (turns, tilts), (least, first) = self.part_counts, _make_bin_table()
        bins = HistogramBins(turns, tilts, several, n, least, first)
        work = partial(_count_agent_motion, agents, paths, bins, MotionLimits(dt, *_MOTION_THRESHOLDS, steps))
        counts = parallel.run_in_parts(work, n, threads, parallel.MIN_LIGHT_ITEMS_PER_THREAD)
        for _, _, standing, half, share in counts:
            if half > self.max_half_chord:
                self.max_half_chord = half
                self.tilt_max = max(self.tilt_max, float(_compute_degrees(np.array([half], np.float32))[0]))
            self.step_max = max(self.step_max, share)
            self.standing += standing
        return parallel.join_parts(counts, window.straightness)[0]

    def _add_part_counts(self) -> None:
        """Add the turns and tilts that kernels counted to the histograms. Each chunk counts in a separate row."""
        for total, rows in zip((self.turns, self.tilts), self.part_counts, strict=True):
            total += rows.sum(axis=0)
        self.part_counts.fill(0)

    def _update_window(self, population: Population) -> PathWindow:
        """Return the current paths of a species, with one row for each of its agents, in the order of the population's rows."""
        known, ids = self.windows.get(population.name), population.ids
        if known is not None and (known.ids is ids or np.array_equal(known.ids, ids)):
            known.ids = ids  # the same array, so that the next comparison is fast
            return known
        n = len(ids)
        fresh = PathWindow(ids, np.empty((n, 3)), np.empty(n), np.empty(n, np.int64))
        if known is not None and population.reordered is not None and population.reordered[0] is known.ids:
            rows = population.reordered[1]
            if len(rows) == n:
                for name in _WINDOW_COLUMNS[1:]:
                    getattr(known, name).take(rows, axis=0, out=getattr(fresh, name), mode="clip")
                self.windows[population.name] = fresh
                return fresh
        fresh.start[:], fresh.path[:], fresh.age[:] = population.position, 0.0, 0
        if known is not None and len(known.ids):
            rows = population.find_rows(known.ids)
            is_alive = rows >= 0
            at = rows[is_alive]
            fresh.start[at], fresh.path[at], fresh.age[at] = known.start[is_alive], known.path[is_alive], known.age[is_alive]
        self.windows[population.name] = fresh
        return fresh

    def _measure_bodies(self, world: World, needs_depths: bool, crowds: list[Population]) -> None:
        """Measure overlaps, and heads and bodies inside the ground, of `crowds`, and (if `needs_depths`) penetration depths of
        trunks. An overlap, from 0 (none) to 1 (equal positions), is with the deepest neighbour. All measures run in parallel."""
        looks: list[Callable[[], NDArray[Any]]] = [partial(measure_overlap_depths, world)] if needs_depths else []
        for population in crowds:
            places = *vec.get_vector_registers(population.now, "position"), population.now["radius"]
            looks.append(partial(measure_overlaps, world, *places))
            looks += [partial(find, world, population) for find in (find_heads_inside, find_sampled_bodies_inside)]

        def run_looks(begin: int, end: int) -> list[NDArray[Any]]:
            with np.errstate(all="ignore"):  # NumPy's error state is per thread
                return [look() for look in looks[begin:end]]

        results = chain.from_iterable(parallel.run_in_parts(run_looks, len(looks), world.options.threads, 1))
        if needs_depths:
            self.deep_max = max(self.deep_max, float((next(results) > _VISIBLE_OVERLAP_SHARE).mean()))
        for _ in crowds:
            self.overlaps += np.bincount((next(results) * _HISTOGRAM_BINS).astype(np.int64), minlength=_HISTOGRAM_BINS + 1)
            heads, bodies = next(results), next(results)
            self.heads, self.bodies = self.heads + len(heads), self.bodies + len(bodies)
            self.heads_inside, self.bodies_inside = self.heads_inside + int(heads.sum()), self.bodies_inside + int(bodies.sum())

    def summarise(self) -> dict[str, float]:
        """Return the measures by name. Turns and tilts are in degrees per step. `step_max` is relative to the longest step
        that the speed limit allows. All others are fractions."""
        self._add_part_counts()
        return {
            "turn_p99": _compute_percentile_99(self.turns) * 180.0,
            "tilt_p99": _compute_percentile_99(self.tilts) * 180.0,
            "tilt_max": self.tilt_max,
            "step_max": self.step_max,
            "circling": self.circling / max(1, self.ways),
            "standing": self.standing / max(1, self.wishing),
            "heads_inside": self.heads_inside / max(1, self.heads),
            "body_inside": self.bodies_inside / max(1, self.bodies),
            "overlap_start": self.overlapping / max(1, self.placed),
            "overlap_p99": _compute_percentile_99(self.overlaps),
            "deep_max": self.deep_max,
            "straightness": self.straightness / max(1, self.ways),
        }


_CHECKPOINT_FIELDS = tuple(each.name for each in fields(MotionMeasures))[:-3]  # the fields that checkpoints contain
_WINDOW_COLUMNS = tuple(each.name for each in fields(PathWindow) if each.init)


def _compute_degrees(half_chord: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the angle (degrees) between two unit vectors, from half the length of the chord that joins their ends."""
    return np.asarray(np.degrees(2 * np.arcsin(half_chord)))


def _find_bins(angle: NDArray[np.float32]) -> Counts:
    return (angle * np.float32(_HISTOGRAM_BINS / 180)).astype(np.int64)


@cache
def _make_bin_table() -> tuple[NDArray[np.float32], Counts]:
    """Return the least half chord of each histogram bin, float32[bins + 2], and a lookup table from half chords to bins,
    int64[cells + 1]. The first array ends with infinity. Bin limits are found by bisection."""
    bin_numbers = np.arange(1, _HISTOGRAM_BINS + 1)
    low, high = (np.full(_HISTOGRAM_BINS, np.float32(end).view(np.int32), np.int64) for end in (0.0, 1.0))
    while (low < high).any():  # positive floats have the same order as their bits
        middle = (low + high) >> 1
        is_reached = _find_bins(_compute_degrees(middle.astype(np.int32).view(np.float32))) >= bin_numbers
        low, high = np.where(is_reached, low, np.minimum(middle + 1, high)), np.where(is_reached, middle, high)
    least = np.concatenate([[0.0], low.astype(np.int32).view(np.float32), [np.inf]]).astype(np.float32)
    return least, _find_bins(_compute_degrees(np.arange(_BIN_LOOKUP_CELLS + 1, dtype=np.float32) / np.float32(_BIN_LOOKUP_CELLS)))


def _compute_percentile_99(counts: NDArray[Any]) -> float:
    """Return the 99th percentile of values from 0 to 1, given the `counts` of their histogram."""
    total = int(counts.sum())
    return float(np.searchsorted(np.cumsum(counts), 0.99 * total)) / _HISTOGRAM_BINS if total else 0.0


@inlined
def _compute_vector_length(x: Any, y: Any, z: Any) -> Any:
    return np.sqrt((x * x + y * y) + z * z)


@inlined
def _compute_half_chord(a: VectorColumns, b: VectorColumns, i: I64) -> F32:
    return _compute_vector_length(a[0][i] - b[0][i], a[1][i] - b[1][i], a[2][i] - b[2][i])


@inlined
def _count_in_histogram(half: F32, bin_starts: Array1[F32], search_starts: Array1[I64], bins: Array2[I64], part: I64) -> None:
    """Add 1 to the bin of `half` in row `part` of `bins`. `search_starts`: for each cell, the first bin to compare."""
    k = search_starts[np.int64(half * np.float32(4096.0))]
    k += 1 if half >= bin_starts[k + 1] else 0  # rarely more, so the branch is well predicted
    while half >= bin_starts[k + 1]:
        k += 1
    bins[part, k] += 1


class AgentColumns(NamedTuple):
    """The current and the previous poses of agents, their velocity, push, speed limit `max_speed` (mm/s) and `size` (mm)."""

    position: VectorColumns
    heading: VectorColumns
    up: VectorColumns
    previous_position: VectorColumns
    previous_heading: VectorColumns
    previous_up: VectorColumns
    velocity: VectorColumns
    push: VectorColumns
    max_speed: Array1[F32]
    size: Array1[F32]


class PathColumns(NamedTuple):
    """Paths of agents: current `position` and `start` (n, 3) mm, `length` (mm), `age` (steps), `straightness` of ended paths."""

    position: Strided2[F64]
    start: Strided2[F64]
    length: Array1[F64]
    age: Array1[I64]
    straightness: Array1[F64]


class HistogramBins(NamedTuple):
    """Histograms with `part_count` rows. `bin_starts`: least half chord of each bin. `search_starts`: bins to search from."""

    turns: Array2[I64]
    tilts: Array2[I64]
    part_count: I64
    count: I64
    bin_starts: Array1[F32]
    search_starts: Array1[I64]


class MotionLimits(NamedTuple):
    """Thresholds. `dt`: seconds per step. `min_push`: least push of an agent that intends to move. `standing_share`: an agent
    below this fraction of its top speed stands. Paths end after `steps` steps, and count from `min_path_length` body sizes on."""

    dt: F32
    min_push: F32
    standing_share: F32
    min_path_length: F32
    steps: I64


class StepCounts(NamedTuple):
    """Counts of a step, for the chunk from agent `begin` on. `ended_paths`: number of ended paths; their straightness is stored
    from `begin` on. `max_tilt_half_chord`: half chord of the greatest tilt. `max_step_share`: longest step / longest allowed
    step."""

    begin: I64
    ended_paths: I64
    standing: I64
    max_tilt_half_chord: F64
    max_step_share: F64


@kernel
def _count_agent_motion(
    agents: AgentColumns, paths: PathColumns, bins: HistogramBins, thresholds: MotionLimits, begin: I64, end: I64
) -> StepCounts:
    """Add one step of the agents from `begin` to `end` - 1 to the measures."""
    position, heading, up, previous_position, previous_heading, up_before, velocity, push, fastest, size = agents
    place, began, path, age, straight = paths
    turns, tilts, several, count, least, first = bins
    dt, wish, still, far, steps = thresholds
    ended, standing, part = 0, 0, compute_buffer_index(begin, count, several)
    tilted, longest = np.float32(0.0), np.float32(0.0)
    turn, tilt = allocate_scratch(_AGENTS_PER_PART, F32), allocate_scratch(_AGENTS_PER_PART, F32)
    share = allocate_scratch(_AGENTS_PER_PART, F32)
    speed, push_lengths = allocate_scratch(_AGENTS_PER_PART, F32), allocate_scratch(_AGENTS_PER_PART, F32)
    for low in range(begin, end, _AGENTS_PER_PART):
        high = min(low + _AGENTS_PER_PART, end)
        for i in simd_range(low, high):
            turn[i - low] = _compute_half_chord(heading, previous_heading, i) * np.float32(0.5)
        for i in simd_range(low, high):
            tilt[i - low] = _compute_half_chord(up, up_before, i) * np.float32(0.5)
        for i in simd_range(low, high):
            share[i - low] = _compute_half_chord(position, previous_position, i) / (fastest[i] * dt)
        for i in simd_range(low, high):
            speed[i - low] = _compute_vector_length(velocity[0][i], velocity[1][i], velocity[2][i])
        for i in simd_range(low, high):
            push_lengths[i - low] = _compute_vector_length(push[0][i], push[1][i], push[2][i])
        for i in range(low, high):
            at = i - low
            _count_in_histogram(min(turn[at], np.float32(1.0)), least, first, turns, part)
            half = min(tilt[at], np.float32(1.0))
            _count_in_histogram(half, least, first, tilts, part)
            tilted = max(tilted, half)
            if fastest[i] * dt > np.float32(0.0) and share[at] > longest:
                longest = share[at]
            standing += 1 if push_lengths[at] > wish and speed[at] < fastest[i] * still else 0
            path[i] += np.float64(speed[at] * dt)
            age[i] += 1
            if age[i] >= steps:
                if path[i] > np.float64(far * size[i]):
                    net = _compute_vector_length(place[i, 0] - began[i, 0], place[i, 1] - began[i, 1], place[i, 2] - began[i, 2])
                    straight[begin + ended] = min(net / path[i], 1.0)
                    ended += 1
                for k in range(3):
                    began[i, k] = place[i, k]
                path[i], age[i] = 0.0, 0
    return StepCounts(begin, ended, standing, np.float64(tilted), np.float64(longest))
