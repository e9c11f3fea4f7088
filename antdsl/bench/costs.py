"""Requests to measuring processes and their results, which are sent as JSON.

A job runs in a separate process, so that no other job affects its memory and start-up. A turn is one measurement of one backend.
The backends of a process alternate, so that all have the same machine load."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import median

from pydantic import TypeAdapter

from antdsl.child_processes import build_module_command, build_module_environment


@dataclass(frozen=True, slots=True)
class BenchJob:
    """A request to measure a case on some backends.

    `case`: its name, or the path of a scene.
    `agents`: the number of agents; None for the case's own number.
    `turns`: the number of measurements of each backend; backends alternate.
    `steps`: steps per turn; 0 means as many as take about 20 ms.
    `full_run`: also measure frames of a run, as `antdsl run` makes them."""

    case: str
    agents: int | None
    backends: tuple[str, ...]
    turns: int = 20
    steps: int = 0
    threads: int = 1
    full_run: bool = False


@dataclass(frozen=True, slots=True)
class StepCost:
    """The cost of a step in seconds.

    `cpu`, `wall`: CPU time and elapsed time, one number per turn. `phases_cpu`, `phases_wall`: the same for each phase, by phase
    name, averaged over all turns."""

    cpu: list[float]
    wall: list[float]
    phases_cpu: dict[str, float] = field(default_factory=dict)
    phases_wall: dict[str, float] = field(default_factory=dict)

    @property
    def cpu_ms(self) -> float:
        """Return the CPU milliseconds of a step (the median over all turns)."""
        return 1000 * median(self.cpu)

    @property
    def wall_ms(self) -> float:
        """Return the elapsed milliseconds of a step (the median over all turns)."""
        return 1000 * median(self.wall)


@dataclass(frozen=True, slots=True)
class SetUpCost:
    """The cost of a set-up, in CPU seconds.

    Before the first frame is complete:
    - `start`: import of Python and packages.
    - `compile`: from the source texts to a plan and meshes.
    - `bind`: from the plan and meshes to a world.
    - `first`: the first step.

    After the first frame, None for a backend without machine code:
    - `code`: building machine code that is not cached.
    - The time to load cached machine code; also None if it cannot be cached.
    - `second`: the second step, which is the first one in machine code."""

    start: float
    compile: float
    bind: float
    first: float
    code: float | None = None
    kept: float | None = None
    second: float | None = None

    @property
    def total(self) -> float:
        """Return the seconds until the first frame is complete."""
        return self.start + self.compile + self.bind + self.first


@dataclass(frozen=True, slots=True)
class FullRunCost:
    """Seconds per frame of a full run, with cache, feet and contacts as the scene sets them.

    `frames`: the number of measured frames.
    `cpu`: CPU time of all threads, including the writer; `wall`: elapsed time.
    `step`: CPU seconds of the same steps without writing.
    `feet`: the part of `step` that moves feet."""

    frames: int
    cpu: float
    wall: float
    step: float
    feet: float


@dataclass(frozen=True, slots=True)
class Measurement:
    """The result of a measuring process. `set_up`, `memory` and `full_run` are those of the first backend.

    `costs`: the cost of a step, by the name of the backend or other program.
    `memory`: the largest growth of the process since the start of binding, in bytes.
    `state`: the size of all stored values of agents, in bytes.
    `nodes`: the number of nodes of the plan.
    `neighbours`: the mean number of other agents within the case's sight after the last step.
    `told`: notes about deviations from the request, for example that NumPy ran instead of machine code. Each begins with the
    name of its backend."""

    job: BenchJob
    agents: int
    steps: int
    costs: dict[str, StepCost]
    set_up: SetUpCost
    memory: int
    state: int
    nodes: int
    neighbours: float | None = None
    full_run: FullRunCost | None = None
    told: tuple[str, ...] = ()

    def compute_ratios(self, name: str, other: str) -> list[float]:
        """Return, for each turn, the CPU time per step of `name` divided by that of `other`. Both are keys of `costs`."""
        return [one / two for one, two in zip(self.costs[name].cpu, self.costs[other].cpu, strict=True)]


JOB_ADAPTER, MEASUREMENT_ADAPTER = TypeAdapter(BenchJob), TypeAdapter(Measurement)  # which read and write JSON


class MeasuringError(Exception):
    """Error if the measuring process ended without a result. The message is the last output of the process."""


def measure_in_process(job: BenchJob, base_command: Sequence[str] = ()) -> Measurement:
    """Return the measurement of a job, made in a separate process. `base_command`: the command to run, without the job; by
    default the command of antdsl. Raises MeasuringError if the process ends without a result."""
    text = JOB_ADAPTER.dump_json(job).decode()
    command = [*base_command, text] if base_command else build_module_command("antdsl.bench", text)
    process = subprocess.run(command, capture_output=True, text=True, env=build_module_environment())
    if process.returncode:
        raise MeasuringError(
            (process.stderr.strip() or f"the process ended with exit code {process.returncode}").splitlines()[-1]
        )
    return MEASUREMENT_ADAPTER.validate_json(process.stdout.splitlines()[-1])
