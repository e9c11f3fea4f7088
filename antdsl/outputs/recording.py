"""Simulates a shot into a cache, from the beginning or from the last good checkpoint, one frame at a time for whoever watches."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.cache import Cache
from antdsl.outputs.cache_writer import CacheWriter, prepare_folder, read_checkpoint, resume_points
from antdsl.outputs.feelers import feelers_of
from antdsl.outputs.frames import FrameMaker, describe, static_arrays
from antdsl.outputs.manifest import CameraEntry
from antdsl.outputs.starting import start_from_cache, start_hash
from antdsl.pipeline import Shot
from antdsl.runtime import CheckpointError, Options, World, bind, checkpoint, restore, snapshot, state_hash, step
from antdsl.scene.model import millimetres


@dataclass(slots=True, eq=False)
class Recording:
    """How far a run has come. `stop` asked for between frames ends it at the next, with a checkpoint."""

    shot: Shot
    folder: Path
    world: World
    inputs: Mapping[str, str]
    resumed_from: int | None = None
    frame: int | None = None  # the last that was handed over to be written
    stop: bool = False
    hash: str = ""  # of the last frame that was written, once all are
    surface_error: float = 0.0  # in body lengths
    steps: int = 0
    seconds: dict[str, float] = field(default_factory=dict)
    behind: dict[str, float] = field(default_factory=dict)  # of the writer's thread, while the next frames are simulated
    started: float = field(default_factory=time.perf_counter)

    @property
    def complete(self) -> bool:
        return self.frame == self.shot.frames.last

    def spend(self, what: str, since: float, *, behind: bool = False) -> float:
        """Count the time since `since` under a name; gives the time now. `behind`: spent by the writer's thread."""
        now = time.perf_counter()
        spent = self.behind if behind else self.seconds
        spent[what] = spent.get(what, 0.0) + now - since
        return now


class NothingToResume(Exception):
    """No checkpoint of an earlier run can be used; the message says why."""


def begin(shot: Shot, folder: Path, options: Options, *, resume: bool, force: bool) -> Recording:
    """Bind the shot; with `resume`, put the world where the last good checkpoint left it.

    A checkpoint is good when all frames up to it are there and the world made from it has the hash that the cache has for
    that frame."""
    inputs = {**shot.inputs, **start_hash(shot)}
    points: tuple[Cache, list[int]] | None = None
    if resume:
        points = resume_points(folder, inputs, shot.frames.first, shot.frames.last)
        if points is None and any((folder / "frames").glob("frame.*.npz")):
            raise NothingToResume(f"`{folder}` has frames and no readable manifest")
    prepare_folder(folder, force=force)
    began = time.perf_counter()
    world = bind(shot.plan, shot.setting, options)
    recording = Recording(shot, folder, world, inputs)
    recording.spend("bind", began)
    if points is not None:
        cache, frames = points
        hashes = cache.hashes()
        for frame in frames:
            arrays = read_checkpoint(cache, frame)
            if arrays is None:
                continue
            try:
                restore(world, arrays)
            except CheckpointError:
                continue
            if state_hash(world) == hashes.get(frame):
                recording.resumed_from = recording.frame = frame
                recording.hash = hashes[frame]
                return recording
        if frames:  # a checkpoint that turned out bad has been put into this world
            recording.world = bind(shot.plan, shot.setting, options)
    start_from_cache(shot, recording.world)
    return recording


def record(recording: Recording, watch: Callable[[str, int], None] = lambda what, frame: None) -> Iterator[Recording]:
    """Simulate and write; gives the recording after each frame. `watch(what, frame)` is told of the preroll's frames too.

    When it ends, by itself or because `stop` was set, the last frame has a checkpoint."""
    shot, world = recording.shot, recording.world
    model = shot.scene.model
    maker = FrameMaker(world, shot.program, model.output.attributes)
    manifest = describe(
        world,
        shot.setting,
        version=shot.inputs["antdsl"],
        scene=Path(shot.scene.source.path).name,
        inputs=recording.inputs,
        units=model.units,
        up=model.up,
        first=shot.frames.first,
        last=shot.frames.last,
        preroll=model.preroll,
        checkpoint=model.output.checkpoint,
        attributes=maker.attributes,
        bodies={line.species: line.body for line in model.crowd if line.body is not None},
        feelers={
            name: feelers_of(shot.program, name, world.params, shot.setting.unit_mm, world.dt) for name in world.populations
        },
        camera=_camera(shot),
    )
    with CacheWriter(recording.folder, manifest) as writer:
        writer.begin(static_arrays(world, shot.setting), recording.resumed_from)
        if recording.resumed_from is None:
            for _ in range(model.preroll):
                if recording.stop:
                    return
                began = time.perf_counter()
                step(world)
                recording.spend("step", began)
                watch("preroll", world.frame)
            world.motion.reset()
            _write(recording, writer, maker)
            yield recording
        while recording.frame is not None and recording.frame < shot.frames.last and not recording.stop:
            began = time.perf_counter()
            step(world)
            recording.steps += 1
            recording.spend("step", began)
            _write(recording, writer, maker)
            yield recording
        if recording.frame is not None and not _is_checkpoint(recording, recording.frame):
            writer.checkpoint(recording.frame, checkpoint(world))
    recording.behind["write"] = writer.seconds


def _is_checkpoint(recording: Recording, frame: int) -> bool:
    """The first frame and every so many after it; a run that is continued keeps to the same frames."""
    return (frame - recording.shot.frames.first) % recording.shot.scene.model.output.checkpoint == 0


def _write(recording: Recording, writer: CacheWriter, maker: FrameMaker) -> None:
    world = recording.world
    began = time.perf_counter()
    still = snapshot(world)
    writer.put(world.frame, lambda: _made(recording, maker, still))
    recording.frame = world.frame
    if _is_checkpoint(recording, world.frame):
        writer.checkpoint(world.frame, checkpoint(world))
    recording.spend("hand_over", began)


def _made(recording: Recording, maker: FrameMaker, still: World) -> tuple[dict[str, NDArray[Any]], str]:
    """A frame's arrays and the state's hash, and what is measured on the way; called by the writer's thread."""
    began = time.perf_counter()
    recording.surface_error = max(recording.surface_error, surface_error(still))
    began = recording.spend("measure", began, behind=True)
    recording.hash = state_hash(still)
    began = recording.spend("hash", began, behind=True)
    arrays = maker.frame(still)
    recording.spend("frame", began, behind=True)
    return arrays, recording.hash


def surface_error(world: World) -> float:
    """The greatest distance of an agent, as it is written (float32), from the triangle that it stands on, in body lengths."""
    worst = 0.0
    for population in world.populations.values():
        if len(population):
            exact = world.ground.position(population.footing)
            away = population.position.astype(np.float32) - exact
            size = np.maximum(population.now["size"].astype(np.float64), 1e-9)
            clearance = population.now["clearance"].astype(np.float64) if "clearance" in population.now else 0.0
            distance = np.abs(np.linalg.norm(away, axis=1) - clearance)
            worst = max(worst, float((distance / size).max()))
    return worst


def _camera(shot: Shot) -> CameraEntry | None:
    camera = shot.scene.model.camera
    if camera is None:
        return None
    unit_mm = shot.scene.model.unit_mm
    points: list[Any] = [tuple(part / unit_mm for part in millimetres(point, unit_mm)) for point in (camera.at, camera.look_at)]
    return CameraEntry(at=points[0], look_at=points[1], focal=camera.focal.number if camera.focal is not None else None)
