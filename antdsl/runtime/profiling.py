"""Measures the time of a run by phase, by layer of each species and by program line.

Time is measured only while a caller uses a `StepMeter`. Measuring does not change the results of a run."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from time import monotonic

from antdsl.plan.ir import LayerPlan, Plan
from antdsl.runtime.backends import NumpyBackend
from antdsl.runtime.backends.block_compiler import BlockInstruction
from antdsl.runtime.backends.metering import BlockCallMeter
from antdsl.runtime.world import World
from antdsl.source import Span

BlockKey = tuple[str, str]  # species and block
_COMMENT_PATTERN = re.compile(r'("[^"]*")|#.*')


@dataclass(frozen=True, slots=True)
class LayerTime:
    """The time of a layer of a species in ms per frame. It includes all computations for the layer, in any file."""

    species: str
    span: Span
    ms: float


@dataclass(frozen=True, slots=True)
class LineTime:
    """The time of a program line in ms per frame, without the time of lines that it calls.

    `text`: the line without indentation and comment."""

    file: str
    line: int
    text: str
    ms: float


@dataclass(frozen=True, slots=True)
class StepProfile:
    """The mean times per frame (ms), over `frames` frames. All are wall times, except the CPU times of phases `cpu_ms`.

    `lines`: the most expensive line first. Their sum is less than that of `phases`, because work for all agents together, such
    as neighbour grids, claims and movement, belongs to no line. `frames_by_backend`: the number of frames that each backend
    ran. It includes frames that NumPy ran before machine code was ready; the other values exclude these. The reference backend
    reports no lines."""

    frames: int = 0
    total_ms: float = 0.0
    phases: dict[str, float] = field(default_factory=dict)
    cpu_ms: dict[str, float] = field(default_factory=dict)
    layers: tuple[LayerTime, ...] = ()
    lines: tuple[LineTime, ...] = ()
    frames_by_backend: dict[str, int] = field(default_factory=dict)


@dataclass(slots=True)
class _StepMeasurement:
    """The times (s) of `steps` steps. `end_time` (s): the clock time at the end of the last step.

    `phases`, `cpu_seconds`: wall time and CPU time by phase. `calls`: the time of each call, by block."""

    steps: int
    end_time: float
    phases: dict[str, float]
    cpu_seconds: dict[str, float]
    calls: dict[BlockKey, list[float]]

    def add_measurement(self, other: _StepMeasurement) -> None:
        self.steps += other.steps
        self.end_time = other.end_time
        for mine, theirs in ((self.phases, other.phases), (self.cpu_seconds, other.cpu_seconds)):
            for name, seconds in theirs.items():
                mine[name] = mine.get(name, 0.0) + seconds
        for key, times in other.calls.items():
            known = self.calls.get(key)
            self.calls[key] = times if known is None else [a + b for a, b in zip(known, times, strict=True)]


class StepMeter:
    """A meter of the mean times per frame, over the frames of the last `seconds`, or over all frames if it is None.

    Call `begin_measuring` before each step and `record_steps` after it. The steps may belong to different worlds. If the program
    changes, earlier measurements are discarded. Measurements of NumPy are discarded once machine code runs the steps."""

    def __init__(self, seconds: float | None = 1.0, *, clock: Callable[[], float] = monotonic) -> None:
        self._seconds, self._clock = seconds, clock
        self._measurements: deque[_StepMeasurement] = deque()
        self._plan: Plan | None = None
        self._instructions: dict[BlockKey, list[BlockInstruction]] = {}
        self._world: World | None = None
        self._backend_name = ""  # name of the backend that ran the last step
        self._frames_by_backend: dict[str, int] = {}
        self._times_before: tuple[dict[str, float], dict[str, float]] = ({}, {})

    def begin_measuring(self, world: World) -> None:
        """Start to measure the next step."""
        if world is not self._world:
            self.stop_measuring()
            self._world = world
            if isinstance(world.backend, NumpyBackend):
                world.backend.set_timing_enabled(True)
        if world.plan is not self._plan:
            self._plan = world.plan
            self._measurements.clear()
            self._frames_by_backend.clear()
            self._instructions = {key: metered.instructions for key, metered in _collect_metered_blocks(world).items()}
        self._times_before = dict(world.timings), dict(world.cpu_seconds)
        for metered in _collect_metered_blocks(world).values():
            metered.reset_counters()

    def record_steps(self, world: World) -> None:
        """Add the completed step to the measurements."""
        if world is not self._world:
            return
        phases, worked = (
            {name: seconds - previous_times.get(name, 0.0) for name, seconds in current_times.items()}
            for previous_times, current_times in zip(self._times_before, (world.timings, world.cpu_seconds), strict=True)
        )
        calls = {key: metered.seconds for key, metered in _collect_metered_blocks(world).items()}
        now = _StepMeasurement(1, self._clock(), phases, worked, calls)
        if isinstance(world.backend, NumpyBackend):
            by = world.backend.backend_name
            if by != self._backend_name:
                self._measurements.clear()
            self._backend_name, self._frames_by_backend[by] = by, self._frames_by_backend.get(by, 0) + 1
        if self._seconds is None and self._measurements:
            self._measurements[0].add_measurement(now)
            return
        self._measurements.append(now)
        while self._seconds is not None and self._measurements[0].end_time < now.end_time - self._seconds:
            self._measurements.popleft()

    def stop_measuring(self) -> None:
        """Stop the measurement. The results remain available."""
        if self._world is not None and isinstance(self._world.backend, NumpyBackend):
            self._world.backend.set_timing_enabled(False)
        self._world = None

    def profile(self) -> StepProfile:
        """Return the averages so far; an empty profile before the first step."""
        if not self._measurements or self._plan is None:
            return StepProfile()
        total = _StepMeasurement(0, 0.0, {}, {}, {})
        for each in self._measurements:
            total.add_measurement(each)
        to_ms = 1000 / total.steps
        phases = {name: seconds * to_ms for name, seconds in total.phases.items()}
        worked = {name: seconds * to_ms for name, seconds in total.cpu_seconds.items()}
        lines = sorted(
            _list_line_times(self._iterate_instruction_times(total), to_ms), key=lambda entry: (-entry.ms, entry.file, entry.line)
        )
        layers = self._list_layer_times(self._plan, total, to_ms)
        return StepProfile(total.steps, sum(phases.values()), phases, worked, layers, tuple(lines), dict(self._frames_by_backend))

    def _iterate_instruction_times(self, total: _StepMeasurement) -> Iterator[tuple[BlockInstruction, float]]:
        """Yield each instruction with its time (s)."""
        for key, times in total.calls.items():
            yield from zip(self._instructions[key], times, strict=True)

    def _list_layer_times(self, plan: Plan, total: _StepMeasurement, to_ms: float) -> tuple[LayerTime, ...]:
        """Return the times of all layers in order, including layers that no agent reached."""
        layer_times: list[LayerTime] = []
        for name, species in plan.species.items():
            spent = [0.0] * len(species.layers)
            times = total.calls.get((name, "blend"), [])
            for instruction, seconds in zip(self._instructions.get((name, "blend"), []), times, strict=True):
                if instruction.layer >= 0:
                    spent[instruction.layer] += seconds
            layer_times += [
                _make_layer_time(name, layer, seconds * to_ms) for layer, seconds in zip(species.layers, spent, strict=True)
            ]
        return tuple(layer_times)


def _collect_metered_blocks(world: World) -> dict[BlockKey, BlockCallMeter]:
    return world.backend.metered_blocks if isinstance(world.backend, NumpyBackend) else {}


def _make_layer_time(species: str, layer: LayerPlan, ms: float) -> LayerTime:
    return LayerTime(species, layer.span, ms)


def _list_line_times(seconds_by_instruction: Iterator[tuple[BlockInstruction, float]], to_ms: float) -> list[LineTime]:
    """Return the times by program line. The time of an instruction counts for the line on which its source text begins.

    Lines are identified by the file name, because parts of a file may be read more than once."""
    seconds_by_line: dict[tuple[str, int], float] = {}
    texts: dict[tuple[str, int], str] = {}
    for instruction, seconds in seconds_by_instruction:
        span = instruction.span
        if span is None or not seconds:
            continue
        place = (span.source.path, span.source.find_line_column(span.start)[0])
        seconds_by_line[place] = seconds_by_line.get(place, 0.0) + seconds
        if place not in texts:
            texts[place] = _COMMENT_PATTERN.sub(r"\1", span.source.line_text(place[1])).strip()
    return [LineTime(file, line, texts[file, line], seconds * to_ms) for (file, line), seconds in seconds_by_line.items()]
