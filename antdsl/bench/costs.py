"""What a process that measures is asked, and what it answers, as plain values that go through JSON; and a job in a process of
its own: its memory and its start-up are nobody else's."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from statistics import median
from typing import Any

from antdsl.child_processes import module_command, module_environment

BOUND = "bound"  # the name under which the frame written by hand is told beside backends


@dataclass(frozen=True, slots=True)
class Job:
    """Measure a case (by its name, or a scene by its path) with so many agents (None: as many as it has) on some backends.

    `turns` times each backend makes `steps` steps, in turn with the others (0: as many as take about 20 ms). `bound`: the frame
    written by hand takes its turns too. `full_run`: frames of a run, as `antdsl run` makes them, are measured besides."""

    case: str
    agents: int | None
    backends: tuple[str, ...]
    turns: int = 20
    steps: int = 0
    threads: int = 1
    bound: bool = False
    full_run: bool = False

    def as_json(self) -> dict[str, Any]:
        """For `from_json`."""
        return asdict(self)

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Job:
        """What `as_json` gave."""
        return Job(**{**data, "backends": tuple(data["backends"])})


@dataclass(frozen=True, slots=True)
class Cost:
    """Seconds of a step, of the processors and by the clock, one number a turn; and by phase in the mean of all turns."""

    cpu: list[float]
    wall: list[float]
    phases_cpu: dict[str, float] = field(default_factory=dict)
    phases_wall: dict[str, float] = field(default_factory=dict)

    @property
    def cpu_ms(self) -> float:
        """Milliseconds of processors of a step: the median of the turns."""
        return 1000 * median(self.cpu)

    @property
    def wall_ms(self) -> float:
        """Milliseconds by the clock of a step: the median of the turns."""
        return 1000 * median(self.wall)


@dataclass(frozen=True, slots=True)
class SetUp:
    """CPU seconds until the first frame: `start` Python and packages, `compile` from the texts to a plan and meshes, `bind` to a
    world, `first` the first step. After it: `code` to make machine code that no run has kept, `kept` to load what one has kept
    (None of a backend without any, or where no folder can keep it), `second` the second step, the first of machine code."""

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
    """Seconds of a frame of a run: cache, feet and contacts as in the scene. `cpu` and `wall`: of all threads, the writer
    included; `step`: CPU of the same steps when nothing is written; `feet`: the part of `step` that moves feet."""

    frames: int
    cpu: float
    wall: float
    step: float
    feet: float


@dataclass(frozen=True, slots=True)
class Measured:
    """What a process found out. Of the first backend: `set_up`, `memory` (bytes that the process grew by at most, from before the
    binding), `full_run` and `counts` of one step (`counting`). `state`: bytes of all that is kept of agents; `nodes`: those of
    the plan; `neighbours`: how many others stand within the case's sight, in the mean, after the last step; `told`: what is
    otherwise than asked, such as that NumPy has run where machine code was to be measured, each sentence after the name of its
    backend."""

    job: Job
    agents: int
    steps: int
    costs: dict[str, Cost]
    set_up: SetUp
    memory: int
    state: int
    nodes: int
    counts: dict[str, int]
    neighbours: float | None = None
    full_run: FullRun | None = None
    told: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """For `from_json`."""
        return asdict(self)

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Measured:
        """What `as_json` gave."""
        full_run = data["full_run"]
        return Measured(
            **{
                **data,
                "job": Job.from_json(data["job"]),
                "costs": {name: Cost(**cost) for name, cost in data["costs"].items()},
                "set_up": SetUp(**data["set_up"]),
                "full_run": None if full_run is None else FullRun(**full_run),
                "told": tuple(data.get("told", ())),
            }
        )

    def ratios(self, name: str, other: str) -> list[float]:
        """CPU time of a step on one of `costs` over that on another, turn by turn."""
        return [one / two for one, two in zip(self.costs[name].cpu, self.costs[other].cpu, strict=True)]


class Failed(Exception):
    """The process ended without a result; the message is what it said last."""


def measured(job: Job) -> Measured:
    """What the process finds out. Raises Failed."""
    command = module_command("antdsl.bench", json.dumps(job.as_json()))
    done = subprocess.run(command, capture_output=True, text=True, env=module_environment())
    if done.returncode:
        raise Failed((done.stderr.strip() or f"the process ended with {done.returncode}").splitlines()[-1])
    return Measured.from_json(json.loads(done.stdout.splitlines()[-1]))
