"""Golden runs: the results of a run, stored as text next to its scene. A later run is compared with them frame by frame.

`scene.golden.json` has a hash for every frame. In at most MAX_RECORDED_FRAMES frames, at regular intervals, it also has the
content of `fingerprints`. So the first frame that differs is always known. The next frame with fingerprints shows the attribute
and the agent that differ."""

from __future__ import annotations

import json
import platform
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal, Protocol

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from antdsl import __version__, limits
from antdsl.atomic_write import write_atomically
from antdsl.program.model import Program
from antdsl.runtime import World, state_hash
from antdsl.safe_read import FileTooLargeError, read_size_limited
from antdsl.specs.cases import SpecRun
from antdsl.specs.golden.fingerprints import StateDifference, build_columns, digest_agents, find_differences

MAX_RECORDED_FRAMES = 48
_MAX_FILE_BYTES = 64 * limits.MIB
# format of runs with state hashes that are SHA-256 of all rows
_FIRST_FORMAT_PATTERN = re.compile(rb'\s*\{\s*"golden"\s*:\s*1\b')
GoldenText = Annotated[str, Field(max_length=2000)]
ValueSums = tuple[GoldenText, GoldenText, GoldenText]  # sum and weighted sum of the bits, hexadecimal; reported values


class GoldenModel(BaseModel):
    """The base class of the stored models."""

    model_config = ConfigDict(extra="forbid", hide_input_in_errors=True)


class GoldenFrame(GoldenModel):
    """A frame of a golden run.

    `parts`: for each column key, its sum, weighted sum and summary. Columns that have not changed since the last frame with
    `parts` are omitted. `agents`: the digests of agents, by species."""

    frame: int
    hash: GoldenText
    parts: dict[GoldenText, ValueSums] = {}
    agents: dict[GoldenText, GoldenText] = {}


class GoldenRun(GoldenModel):
    """A recorded run, which is identified by its changed params and its seed. `summary`: a readable summary of the last frame."""

    set: dict[GoldenText, GoldenText]
    seed: int
    summary: dict[GoldenText, GoldenText]
    frames: list[GoldenFrame]


class GoldenFile(GoldenModel):
    """The contents of a golden file. `made`: the environment in which the file was written."""

    golden: Literal[2]
    made: dict[GoldenText, GoldenText]
    runs: list[GoldenRun]


class GoldenError(Exception):
    """Error for a file that is not a valid golden file. The message can be understood without context."""


@dataclass(slots=True)
class GoldenResult:
    """The result of comparing a run with its golden run, or of recording the run as a golden run.

    - `outcome`: "same", "differs", "written" or "waiting". `message`: the reason as text, if there is one.
    - `frame`: the first frame that differs. `detail_frame`: the frame in which `differences` were found.
    - `origin`: the environment in which the golden run was recorded, if it differs from the current one.
    - `frames`: the number of compared frames."""

    scene: Path
    changes: Mapping[str, str]
    seed: int
    outcome: str = "waiting"
    frame: int | None = None
    detail_frame: int | None = None
    differences: list[StateDifference] = field(default_factory=list)
    message: str = ""
    origin: str = ""
    frames: int = 0

    @property
    def name(self) -> str:
        """Return the display name, which consists of the scene and the changed params."""
        return "golden run of " + ", ".join([self.scene.name, *(f"{name} = {text}" for name, text in self.changes.items())])


class GoldenFrameObserver(Protocol):
    """The interface of objects that receive each frame of a run. The run continues at least until `is_over` is true."""

    @property
    def is_over(self) -> bool: ...
    def observe_frame(self, world: World) -> None: ...
    def finish(self, world: World) -> None: ...


def find_golden_path(scene: Path) -> Path:
    """Return the path of the file that stores a scene's golden runs."""
    return scene.with_name(f"{scene.stem}.golden.json")


def describe_environment() -> dict[str, str]:
    """Return the versions and the system that may influence results, by name."""
    return {
        "antdsl": __version__, "python": platform.python_version(), "numpy": np.__version__,
        "system": f"{platform.system()} {platform.machine()}",
    }  # fmt: skip


def read_golden(path: Path) -> GoldenFile | None:
    """Return the contents of a golden file, or None if it does not exist. Raises GoldenError if the file is not valid."""
    try:
        data = read_size_limited(path, _MAX_FILE_BYTES)
        if _FIRST_FORMAT_PATTERN.match(data):
            raise GoldenError(f"`{path.name}` uses another method of state hashes, so it cannot be compared")
        return GoldenFile.model_validate_json(data)
    except FileNotFoundError:
        return None
    except FileTooLargeError:
        raise GoldenError(f"`{path.name}` is too large for a file of golden runs") from None
    except OSError as problem:
        raise GoldenError(f"`{path.name}` cannot be read: {(problem.strerror or str(problem)).lower()}") from None
    except (ValidationError, RecursionError):
        raise GoldenError(f"`{path.name}` is damaged, or has another version") from None


def write_golden(path: Path, runs: Iterable[GoldenRun]) -> None:
    """Write golden runs, one line per frame, so that a text diff shows what changed."""
    lines = [f'{{"golden": 2,\n"made": {json.dumps(describe_environment())},\n"runs": [']
    ordered = sorted(runs, key=lambda run: (sorted(run.set.items()), run.seed))
    for number, run in enumerate(ordered):
        head = f'{{"set": {json.dumps(run.set, ensure_ascii=False)}, "seed": {run.seed},\n"summary": {{\n'
        summary_lines = ",\n".join(f" {json.dumps(k)}: {json.dumps(v, ensure_ascii=False)}" for k, v in run.summary.items())
        frames = ",\n".join(
            json.dumps(frame.model_dump(exclude_defaults=True), ensure_ascii=False, separators=(",", ":")) for frame in run.frames
        )
        lines.append(f'{head}{summary_lines}}},\n"frames": [\n{frames}\n]}}{"," if number + 1 < len(ordered) else ""}')
    write_atomically(path, ("\n".join(lines) + "\n]}\n").encode())


class GoldenRecorder:
    """Records a golden run while a run is simulated. The run does not last longer because of this. `frames`: the approximate
    number of frames."""

    is_over = True

    def __init__(self, run: SpecRun, result: GoldenResult, frame_count: int) -> None:
        self.program, self.result = run.shot.program, result
        self.every = max(1, -(-frame_count // MAX_RECORDED_FRAMES))
        self.known: dict[str, ValueSums] = {}
        self.frames: list[GoldenFrame] = []
        self.golden_run: GoldenRun | None = None

    def observe_frame(self, world: World) -> None:
        """Record the hash of this frame and, at regular intervals, its fingerprints."""
        frame = GoldenFrame(frame=world.frame, hash=state_hash(world))
        if len(self.frames) % self.every == 0:
            sums_by_key = _compute_column_sums(world, self.program)
            frame.parts = {key: sums for key, sums in sums_by_key.items() if self.known.get(key) != sums}
            frame.parts |= {key: ("", "", "") for key in self.known.keys() - sums_by_key.keys()}
            frame.agents = _compute_agent_digests(world, self.program)
            self.known = sums_by_key
        self.frames.append(frame)

    def finish(self, world: World) -> None:
        """Build the golden run from the recorded frames."""
        self.result.frames = len(self.frames)
        summary = {name: f"{len(population)} agents" for name, population in sorted(world.populations.items())}
        column_summaries = {key: column.summarise_values(world) for key, column in build_columns(world, self.program).items()}
        summary |= {key: words for key, words in column_summaries.items() if words}
        self.golden_run = GoldenRun(set=dict(self.result.changes), seed=self.result.seed, summary=summary, frames=self.frames)


class GoldenComparer:
    """Compares a run with a golden run, frame by frame. `result`: the outcome."""

    def __init__(self, run: SpecRun, result: GoldenResult, golden: GoldenRun, environment: Mapping[str, str]) -> None:
        self.program, self.result, self.golden = run.shot.program, result, golden
        self.environment_text = ", ".join(f"{name} {text}" for name, text in environment.items())
        if dict(environment) == describe_environment():
            self.environment_text = ""
        self.known: dict[str, ValueSums] = {}
        self.is_over = False

    def observe_frame(self, world: World) -> None:
        """Compare this frame with the golden run."""
        if self.is_over:
            return
        golden_frame = self.golden.frames[self.result.frames]
        if golden_frame.frame != world.frame:
            self._record_difference(
                world.frame, f"the run starts at frame {world.frame}, but it started at frame {golden_frame.frame}"
            )
            self.is_over = True
            return
        self.result.frames += 1
        if golden_frame.parts or golden_frame.agents:
            self.known = {key: sums for key, sums in {**self.known, **golden_frame.parts}.items() if any(sums)}
        if self.result.frame is None and state_hash(world) != golden_frame.hash:
            self._record_difference(world.frame, "")
        if self.result.frame is not None and golden_frame.agents:
            self.result.detail_frame = world.frame
            self.result.differences = find_differences(world, self.program, self.known, golden_frame.agents)
            self.is_over = True
        elif self.result.frames == len(self.golden.frames):
            self.is_over = True
            if self.result.frame is None:
                self.result.outcome = "same"
            else:
                self.result.message = "no later frame is stored in detail"

    def finish(self, world: World) -> None:
        """Do nothing: the result is already complete."""

    def _record_difference(self, frame: int, words: str) -> None:
        self.result.outcome, self.result.frame, self.result.message, self.result.origin = (
            "differs",
            frame,
            words,
            self.environment_text,
        )


def _compute_column_sums(world: World, program: Program) -> dict[str, ValueSums]:
    sums_by_key = {}
    for key, column in build_columns(world, program).items():
        first, second = column.compute_sums()
        sums_by_key[key] = (f"{first:x}", f"{second:x}", column.summarise_values(world))
    return sums_by_key


def _compute_agent_digests(world: World, program: Program) -> dict[str, str]:
    return {name: digest_agents(world, population, program) for name, population in sorted(world.populations.items())}
