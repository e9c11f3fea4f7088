"""Simulates a shot and writes it to a cache, from the beginning or from the last intact checkpoint.

After each frame, control returns to the caller, which may report progress or stop the run."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.measures.run_measures import RunMeasures
from antdsl.outputs.cache.body_arrays import StoredBodies
from antdsl.outputs.cache.cache_reader import Cache, CacheError, make_checkpoint_path
from antdsl.outputs.cache.cache_writer import (
    CacheWriter,
    DifferentInputs,
    IntactPart,
    find_intact_part,
    prepare_folder,
    read_checkpoint,
)
from antdsl.outputs.cache.frame_maker import FrameMaker, make_static_arrays
from antdsl.outputs.cache.hashes import HashLine
from antdsl.outputs.cache.manifest import EditsEntry, find_relative_path
from antdsl.outputs.cache.scene_positions import find_scene_origin
from antdsl.outputs.cache.solid_pieces import PieceMaker
from antdsl.outputs.cache_start import hash_start_frame, start_from_cache
from antdsl.outputs.measure_files import MeasureFile
from antdsl.outputs.provenance import collect_provenance
from antdsl.outputs.shot_manifest import make_shot_manifest
from antdsl.pipeline import Shot
from antdsl.runtime import (
    CheckpointError,
    Options,
    World,
    bind,
    collect_emissions,
    feet_hash,
    restore_checkpoint,
    state_hash,
    step,
)
from antdsl.runtime.profiling import StepMeter
from antdsl.scene.crowds.crowd_model import collect_body_weights
from antdsl.scene.values import FrameRange

_TIME_DECIMALS = 6  # of seconds in the file of measures


@dataclass(slots=True, eq=False)
class Recording:
    """A run in progress. If `stop_requested` is set, the run ends after the current frame, with a checkpoint."""

    shot: Shot
    folder: Path
    world: World
    inputs: Mapping[str, str]
    resumed_from: int | None = None
    retained_lines: dict[int, HashLine] = field(default_factory=dict)  # the lines of the retained frames
    damaged_checkpoints: list[int] = field(default_factory=list)  # unusable checkpoints of an earlier run
    notes: list[str] = field(default_factory=list)  # messages on damaged parts of an earlier run that are recomputed
    static_arrays: dict[str, NDArray[Any]] = field(default_factory=dict)  # the arrays of `static.npz`
    frame: int | None = None  # the last frame that was passed to the writer
    stop_requested: bool = False
    last_state_hash: str = ""  # hash of the last frame that is known to be written
    # greatest error of all frames, in body lengths; None if the error of earlier frames is unknown
    surface_error: float | None = 0.0
    steps: int = 0  # number of steps after the first
    seconds: dict[str, float] = field(default_factory=dict)
    frame_seconds: dict[str, float] = field(default_factory=dict)  # frames: parts of `submit`
    writer_seconds: dict[str, float] = field(default_factory=dict)  # frames and checkpoints written meanwhile
    start_time: float = field(default_factory=time.perf_counter)
    edits: EditsEntry | None = None  # of the cache that the run continues
    scene_path: str | None = None  # path from the cache to its scene, if it differs from the path between the files in use
    step_meter: StepMeter | None = None  # measures the steps after the first
    measures: RunMeasures | None = None  # from the first frame on
    stored_measures: NDArray[np.float64] | None = None  # those of the checkpoint from which the run continues

    @property
    def is_complete(self) -> bool:
        """Return whether the last frame was passed to the writer. If `until` holds earlier, that frame is the last one."""
        return self.frame == self.shot.frames.last or (self.measures is not None and self.measures.is_over)

    def add_time(self, label: str, start_time: float) -> None:
        """Add the time since `start_time` to the seconds spent on the kind of work called `label`."""
        self.seconds[label] = self.seconds.get(label, 0.0) + time.perf_counter() - start_time

    def add_measures(self, measures: Mapping[str, Any]) -> None:
        """Record the measurements of a written frame."""
        for of, name in ((self.frame_seconds, "made"), (self.writer_seconds, "seconds")):
            for what, seconds in measures.get(name, {}).items():
                of[what] = of.get(what, 0.0) + seconds
        self.last_state_hash = measures.get("hash", self.last_state_hash)
        self.surface_error = measures.get("surface_error", self.surface_error)


class NothingToResume(Exception):
    """Error if no checkpoint of an earlier run is usable. The message is the reason."""


def begin_recording(shot: Shot, folder: Path, options: Options, *, resume: bool, force: bool) -> Recording:
    """Bind the shot, and compute feet. With `resume`, restore the world from the last intact checkpoint.

    For an intact checkpoint, the files of all frames up to it are complete, and the restored world has the stored hash."""
    inputs, options = {**shot.inputs, **hash_start_frame(shot)}, replace(options, feet=True)
    intact: IntactPart | None = None
    if resume:
        try:
            intact = find_intact_part(folder, inputs, shot.frames.first, shot.frames.last)
        except DifferentInputs as error:
            raise _add_option_changes(shot, inputs, error) from None
        if intact is None and any((folder / "frames").glob("frame.*.npz")):
            raise NothingToResume(f"`{folder}` has frames but no readable manifest")
    prepare_folder(folder, force=force)
    began = time.perf_counter()
    world = bind(shot.plan, shot.setting, options)
    recording = Recording(shot, folder, world, inputs, static_arrays=make_static_arrays(world, shot.setting))
    recording.add_time("bind", began)
    if intact is not None:
        if intact.cache.manifest.origin != find_scene_origin(world):
            raise NothingToResume(f"`{folder}` was written by an antdsl version that measures positions from a different origin")
        recording.edits = intact.cache.manifest.edits
        _resume_recording(recording, intact, options)
    if recording.resumed_from is None:
        start_from_cache(shot, recording.world)
    return recording


def _add_option_changes(shot: Shot, inputs: Mapping[str, str], problem: DifferentInputs) -> DifferentInputs:
    """Return the exception with messages about those of the seed, the first frame and `--set` that differ."""
    then, scene, names = problem.manifest, shot.scene, list(problem.names)
    choices = []
    frames = FrameRange(then.first, max(then.first, shot.frames.last))
    if "scene" in names and scene.replace_values(seed=then.seed, frames=frames).compute_digest() == then.inputs.get("scene"):
        names.remove("scene")
        choices += [f"with seed {then.seed}, not {scene.model.seed}"] if then.seed != scene.model.seed else []
        choices += [f"from frame {then.first}, not {shot.frames.first}"] if then.first != shot.frames.first else []
    for name in [name for name in names if name.startswith("--set ")]:
        names.remove(name)
        previous, now = (f"`{name}={each[name]}`" if name in each else "" for each in (then.inputs, inputs))
        choices.append(
            f"with {previous}, not {now}" if previous and now else f"with {previous}" if previous else f"without {now}"
        )
    return DifferentInputs(then, names, choices)


def _resume_recording(recording: Recording, intact: IntactPart, options: Options) -> None:
    """Restore the world from the last intact checkpoint. Record which damaged frames will be computed again."""
    shot, lines, notes = recording.shot, intact.cache.lines(), [] if intact.damage is None else [intact.damage]
    for frame in intact.checkpoints:
        why = _restore_checkpoint(recording, intact.cache, frame, lines[frame])
        if why is None:
            recording.resumed_from = recording.frame = frame
            recording.last_state_hash = lines[frame].hash
            recording.retained_lines = {number: line for number, line in lines.items() if number <= frame}
            break
        notes.append(why)
        recording.surface_error = 0.0
        recording.world = bind(shot.plan, shot.setting, options)  # the previous world contains data of a bad checkpoint
    if recording.resumed_from is not None:
        notes += _find_damaged_checkpoints(recording, intact.cache, lines, recording.resumed_from)
    first = shot.frames.first if recording.resumed_from is None else recording.resumed_from + 1
    again = min(shot.frames.last, first if intact.last_frame is None else intact.last_frame)
    if not notes and recording.resumed_from is None and intact.last_frame is not None and intact.last_frame >= first:
        notes.append(f"`{intact.cache.folder}` has no checkpoint with complete frames up to it")
    if len(notes) > len(recording.damaged_checkpoints) and again >= first:
        notes.append(f"frame {first} is computed again" if again == first else f"frames {first} to {again} are computed again")
    why = intact.cache.find_static_damage()
    if why is not None:
        notes.append(f"{why}; it is written again")
    beyond = [frame for frame in intact.cache.frames() if frame > shot.frames.last]
    if beyond:
        which = f"frame {beyond[0]} is" if len(beyond) == 1 else f"{len(beyond)} frames, {beyond[0]} to {beyond[-1]}, are"
        notes.append(f"{which} beyond frame {shot.frames.last}, the last, and {'is' if len(beyond) == 1 else 'are'} removed")
    recording.notes = notes + [f"{why}; the file is left unchanged" for why in intact.cache.describe_stray_files()]


def _find_damaged_checkpoints(recording: Recording, cache: Cache, lines: Mapping[int, HashLine], limit: int) -> Iterator[str]:
    """Yield the reason why each unusable checkpoint before frame `limit` is unusable. These checkpoints are recorded for
    removal."""
    for frame in cache.checkpoints():
        why = cache.find_checkpoint_damage(frame, lines.get(frame)) if frame < limit else None
        if why is not None:
            recording.damaged_checkpoints.append(frame)
            yield f"{why}, so the checkpoint is removed"


def _restore_checkpoint(recording: Recording, cache: Cache, frame: int, line: HashLine) -> str | None:
    """Restore the world and the measurements from a checkpoint. Return None, or a complete message if this failed."""
    world, path = recording.world, make_checkpoint_path(cache.folder, frame)
    why = cache.find_checkpoint_damage(frame, line)
    if why is not None:
        return why
    try:
        arrays, recording.surface_error, recording.stored_measures = read_checkpoint(cache, frame)
        restore_checkpoint(world, arrays)
    except CacheError as problem:
        return str(problem)
    except CheckpointError as problem:
        return f"`{path}` is damaged: {problem}"
    if state_hash(world) != line.hash:
        return f"`{path}` does not hold the state of frame {frame}"
    return None if line.feet in ("", feet_hash(world.feet)) else f"`{path}` does not hold the feet of frame {frame}"


def record_frames(recording: Recording, on_frame: Callable[[str, int], None] = lambda label, frame: None) -> Iterator[Recording]:
    """Simulate the frames and write them. Yield the recording after each frame.

    `on_frame(label, frame)` is called for each frame, including those of the preroll. The last frame gets a checkpoint, even if
    `stop_requested` ended the run."""
    shot, world = recording.shot, recording.world
    model = shot.scene.model
    pieces = PieceMaker(shot.frames.first, model.output.checkpoint, 1.0 / shot.setting.unit_mm)
    maker = FrameMaker(world, shot.program, model.output.attributes, pieces, model.output.events)
    stored_bodies = StoredBodies.from_definitions(shot.bodies, collect_body_weights(model.crowd))
    name = Path(shot.scene.source.path).name
    scene_path = recording.scene_path or find_relative_path(Path(shot.scene.source.path), recording.folder)
    manifest = make_shot_manifest(shot, world, maker.attributes, stored_bodies)
    update = {"scene_path": scene_path, "inputs": dict(recording.inputs), "edits": recording.edits}
    manifest = manifest.model_copy(update=update)
    made_with = partial(collect_provenance, name, shot.frames, shot.setting.seed, recording.inputs)
    with (
        CacheWriter(recording.folder, manifest, made_with, recording.add_measures) as writer,
        MeasureFile(recording.folder, shot.measure_names, recording.resumed_from) as measure_file,
    ):
        static = {**recording.static_arrays, **stored_bodies.arrays}
        writer.begin(world, static, maker, recording.retained_lines, recording.damaged_checkpoints, recording.surface_error)
        if recording.resumed_from is None:
            for _ in range(model.preroll):
                if recording.stop_requested:
                    return
                _run_timed_step(recording, "preroll")
                on_frame("preroll", world.frame)
            world.motion.reset_step_measures()
            collect_emissions(world)  # events of the preroll do not belong to the first frame
            world.timings.clear()
            world.cpu_seconds.clear()
        measures = recording.measures = RunMeasures(shot.measures, shot.until, world)
        if recording.resumed_from is None:
            _write_frame(recording, measures, writer, measure_file)
            yield recording
        else:
            if recording.stored_measures is not None:
                measures.restore_stored_values(recording.stored_measures)
            measures.record_frame(world)
        while not recording.is_complete and not recording.stop_requested:
            _run_timed_step(recording, "step")
            _write_frame(recording, measures, writer, measure_file)
            yield recording
        if recording.frame is not None and not _is_checkpoint(recording, recording.frame):
            writer.submit_checkpoint(world, measures.save_stored_values())


def _run_timed_step(recording: Recording, label: str) -> None:
    """Run one step, and add its time to the work called `label`.

    The first step counts as `first_step`, because it also loads kernels and tables."""
    began = time.perf_counter()
    meter = recording.step_meter if label == "step" and "first_step" in recording.seconds else None
    if meter is not None:
        meter.begin_measuring(recording.world)
    step(recording.world)
    if meter is not None:
        meter.record_steps(recording.world)
    if "first_step" in recording.seconds:
        recording.add_time(label, began)
        recording.steps += label == "step"
    else:
        recording.add_time("first_step", began)
        recording.world.timings.clear()
        recording.world.cpu_seconds.clear()


def _is_checkpoint(recording: Recording, frame: int) -> bool:
    """Return whether a frame gets a checkpoint: the first frame, and every n-th after it. A continued run has the same
    checkpoints."""
    return (frame - recording.shot.frames.first) % recording.shot.scene.model.output.checkpoint == 0


def _write_frame(recording: Recording, measures: RunMeasures, writer: CacheWriter, measure_file: MeasureFile) -> None:
    """Pass the current frame to the writer, with a checkpoint if one is due. Also write the frame's measures, and add the time
    spent."""
    world = recording.world
    began = time.perf_counter()
    measures.record_frame(world)
    measure_file.write_frame(
        world.frame, round((world.frame - recording.shot.frames.first) * world.dt, _TIME_DECIMALS), measures.values
    )
    writer.submit_frame(world)
    if _is_checkpoint(recording, world.frame):
        writer.submit_checkpoint(world, measures.save_stored_values())
    recording.frame = world.frame
    recording.add_time("hand_over", began)
