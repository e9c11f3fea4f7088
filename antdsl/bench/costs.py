"""Requests to measuring processes and their results, as plain values that are sent as JSON; and a job in a separate process,
which shares its memory and its start-up with no other job."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import median

from pydantic import TypeAdapter

from antdsl.child_processes import module_command, module_environment


@dataclass(frozen=True, slots=True)
class Job:
    """A case to measure (its name, or the path of a scene) with a number of agents (None: its own number) on some backends.

    Each backend takes `turns` turns of `steps` steps, alternating with the others. With 0 steps, a turn has as many as take about
    20 ms. `full_run`: also measure frames of a run, as `antdsl run` makes them."""

    case: str
    agents: int | None
    backends: tuple[str, ...]
    turns: int = 20
    steps: int = 0
    threads: int = 1
    full_run: bool = False


@dataclass(frozen=True, slots=True)
class Cost:
    """Seconds of a step, as CPU time and as wall time: one number per turn, and by phase the mean of all turns."""

    cpu: list[float]
    wall: list[float]
    phases_cpu: dict[str, float] = field(default_factory=dict)
    phases_wall: dict[str, float] = field(default_factory=dict)

    @property
    def cpu_ms(self) -> float:
        """CPU milliseconds of a step: the median of the turns."""
        return 1000 * median(self.cpu)

    @property
    def wall_ms(self) -> float:
        """Wall-clock milliseconds of a step: the median of the turns."""
        return 1000 * median(self.wall)


@dataclass(frozen=True, slots=True)
class SetUp:
    """CPU seconds until the first frame, and to have machine code after it.

    Until the first frame: `start`: Python and packages. `compile`: from the texts to a plan and meshes. `bind`: to a world.
    `first`: the first step. After it: `code`: to build machine code that no run has cached; then to load cached machine code
    (None for a backend without machine code, or if no folder can store it). `second`: the second step, the first one in machine
    code."""

    start: float
    compile: float
    bind: float
    first: float
    code: float | None = None
    kept: float | None = None
    second: float | None = None

    @property
    def total(self) -> float:
        """Until the first frame stands."""
        return self.start + self.compile + self.bind + self.first


@dataclass(frozen=True, slots=True)
class FullRun:
    """Seconds per frame of a run with cache, feet and contacts as in the scene. `cpu` and `wall`: of all threads, including the
    writer; `step`: CPU of the same steps without writing; `feet`: the part of `step` that moves feet."""

    frames: int
    cpu: float
    wall: float
    step: float
    feet: float


@dataclass(frozen=True, slots=True)
class Measurement:
    """Results of a measuring process.

    `costs`: by the names of backends, and of other frames that took turns. Of the first backend: `set_up`; `memory`: the largest
    growth of the process in bytes, from before the binding; `full_run`. `state`: bytes of all stored values of agents. `nodes`:
    number of nodes of the plan.
    `neighbours`: mean number of others within the case's sight after the last step. `told`: messages about deviations from the
    request, for example that NumPy ran instead of machine code. Each message begins with the name of its backend."""

    job: Job
    agents: int
    steps: int
    costs: dict[str, Cost]
    set_up: SetUp
    memory: int
    state: int
    nodes: int
    neighbours: float | None = None
    full_run: FullRun | None = None
    told: tuple[str, ...] = ()

    def ratios(self, name: str, other: str) -> list[float]:
        """Return the CPU time of a step of one entry of `costs` divided by that of another, turn by turn."""
        return [one / two for one, two in zip(self.costs[name].cpu, self.costs[other].cpu, strict=True)]


JOBS, MEASUREMENTS = TypeAdapter(Job), TypeAdapter(Measurement)  # which read and write JSON


class MeasuringError(Exception):
    """The process ended without a result; the message is what it said last."""


def measure_in_process(job: Job, words: Sequence[str] = ()) -> Measurement:
    """Return what a separate process measures. `words`: the command that measures, without the job; by default that of
    antdsl. Raises MeasuringError."""
    text = JOBS.dump_json(job).decode()
    command = [*words, text] if words else module_command("antdsl.bench", text)
    process = subprocess.run(command, capture_output=True, text=True, env=module_environment())
    if process.returncode:
        raise MeasuringError((process.stderr.strip() or f"the process ended with {process.returncode}").splitlines()[-1])
    return MEASUREMENTS.validate_json(process.stdout.splitlines()[-1])
