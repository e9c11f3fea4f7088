"""Caches of the frames before a failure. They have a checkpoint of every frame, so that the run can be inspected and continued.

While a spec is judged, only periodic copies of the state are stored. After a failure, the frames since the last copy are
simulated again and written to the cache."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from antdsl.atomic_write import find_first_link
from antdsl.loading import display_path
from antdsl.outputs.cache.cache_writer import ForeignFolder, PathBlocked, prepare_folder
from antdsl.outputs.cache.frame_maker import make_static_arrays
from antdsl.outputs.cache_start import StartError, find_start_cache, hash_start_frame
from antdsl.outputs.recording import Recording, record_frames
from antdsl.pipeline import RunChoices, Shot, open_scene
from antdsl.program.model import Constant, Expr
from antdsl.program.tables.units import choose_default_unit, find_unit_measure
from antdsl.program.types.folding import find_constant
from antdsl.runtime import BindingCache, CheckpointError, Options, World, bind, restore_checkpoint, state_hash, take_checkpoint
from antdsl.runtime.checkpoints import Arrays
from antdsl.scene.checks.entry_checks import convert_constant
from antdsl.scene.quantities import QuantityError, parse_quantity
from antdsl.scene.setting import WorldSetting
from antdsl.scene.values import FrameRange
from antdsl.specs.cases import SavedFrames, SpecCase, SpecRun

COPY_INTERVAL_FRAMES = 12  # frames between two stored states
MAX_STORED_CASES = 5  # maximum number of stored cases of one `antdsl test`


@dataclass(frozen=True, slots=True)
class FailureSnapshot:
    """The frame in which a case failed, and the data for simulating it again.

    `hash`: the state hash of this frame; None if the step to it failed. `arrays`: the stored state of an earlier frame."""

    frame: int
    hash: str | None
    arrays: Arrays

    @property
    def first_frame(self) -> int:
        """Return the frame of the stored state, from which the simulation starts."""
        return int(self.arrays["frame"])


class StateSnapshots:
    """Stores one copy of a run's state: the most recent of the copies that are made at intervals.

    If the scene has animation, it stores the first copy instead, because such a run can continue only from its first frame."""

    def __init__(self, setting: WorldSetting) -> None:
        self.keeps_first_copy = bool(setting.motion) or any(camera.is_moving for camera in setting.cameras.values())
        self.last: Arrays | None = None

    def store_copy(self, world: World) -> None:
        """Store a copy of the state, if enough frames have passed since the last copy. Call this at each frame, after judging
        it."""
        if self.last is None or (not self.keeps_first_copy and world.frame >= int(self.last["frame"]) + COPY_INTERVAL_FRAMES):
            self.last = take_checkpoint(world)

    def make_failure_point(self, world: World) -> FailureSnapshot:
        """Return the data for simulating up to the current frame again."""
        return FailureSnapshot(world.frame, state_hash(world), take_checkpoint(world) if self.last is None else self.last)


@dataclass(slots=True)
class FailureSaver:
    """Saves the frames before failures, in `folder` or in `out/failed` next to the scene."""

    folder: Path | None
    grants: Mapping[str, Path]
    options: Options
    count: int = 0

    def save_failure(
        self, run: SpecRun, case: SpecCase, failure_point: FailureSnapshot, binding_cache: BindingCache
    ) -> SavedFrames:
        """Simulate the frames before a failure again, and write them to a cache. If this is not possible, the `note` of the
        result says why."""
        self.count += 1
        if self.count > MAX_STORED_CASES:
            return SavedFrames(None, f"not saved: only the first {MAX_STORED_CASES} are")
        parent_folder = self.folder if self.folder is not None else case.scene.parent / "out" / "failed"
        folder = parent_folder / f"{make_folder_name(case.name)}-{case.seed}"
        folder_names = (case.scene.parent, "out", "failed") if self.folder is None else (parent_folder,)
        link = find_first_link(*folder_names, folder.name)
        if link is not None:
            return SavedFrames(None, f"not saved: `{display_path(link)}` is a link; name a folder with `--keep`")
        params = {change.name: _format_flag_value(run.shot, change.value) for change in case.spec.changes}
        frames = FrameRange(failure_point.first_frame, max(run.shot.frames.last, failure_point.frame + 1))
        shot, report = open_scene(case.scene, RunChoices(self.grants, frames, run.seed, params))
        if shot is None:
            return SavedFrames(None, f"not saved: {report.errors[0].message}")
        try:
            last_hash = self._record_frames(shot, folder, failure_point, binding_cache)
        except (OSError, ForeignFolder, PathBlocked, StartError, CheckpointError) as error:
            return SavedFrames(None, f"not saved: {str(error).lower()}")
        words = [f"--root {shlex.quote(f'{name}={path}')}" for name, path in self.grants.items()]
        words += [f"--set {shlex.quote(f'{name}={text}')}" for name, text in params.items()]
        folder_text, scene = shlex.quote(display_path(folder)), shlex.quote(display_path(case.scene))
        rerun_command = " ".join([f"antdsl run {scene} --frames {frames.first}..{frames.last} --seed {run.seed}", *words])
        failed_frame = failure_point.frame + (failure_point.hash is None)  # a step with a fault is not stored
        agent_ids = next((f.agents for f in case.failures if f.frame == failed_frame and f.agents), ())
        agents = f" --agents {','.join(map(str, agent_ids))} --show trail,ids" if agent_ids else ""
        first = max(failure_point.first_frame, failure_point.frame - 1)
        look = f"antdsl render {folder_text} --frames {first}..{failure_point.frame}{agents}"
        is_reproduced = failure_point.hash is None or last_hash == failure_point.hash
        note = "" if is_reproduced else "the saved run gave other results, which is a bug in antdsl"
        return SavedFrames(
            folder, note, failure_point.first_frame, failure_point.frame, look, f"{rerun_command} --out {folder_text} --resume"
        )

    def _record_frames(self, shot: Shot, folder: Path, failure_point: FailureSnapshot, binding_cache: BindingCache) -> str:
        """Write the frames from the stored state to the failure. Return the state hash of the last frame."""
        model = shot.scene.model
        output = model.output.model_copy(update={"checkpoint": 1})
        short = FrameRange(failure_point.first_frame, failure_point.frame)
        scene = shot.scene.replace_values(output=output, frames=short, preroll=0)
        begins = find_start_cache(shot)
        if begins is not None and begins.resolve() == folder.resolve():
            raise ForeignFolder(f"`{folder}` is the cache from which the scene starts")
        prepare_folder(folder, force=False)
        world = bind(shot.plan, shot.setting, self.options, binding_cache=binding_cache)
        restore_checkpoint(world, failure_point.arrays)
        inputs = {**shot.inputs, **hash_start_frame(shot)}
        recording = Recording(
            replace(shot, scene=scene), folder, world, inputs, static_arrays=make_static_arrays(world, shot.setting)
        )
        for _ in record_frames(recording):
            pass
        return recording.last_state_hash


def make_folder_name(name: str) -> str:
    """Return a name converted to a folder name that contains only letters, digits and hyphens."""
    return "-".join(re.findall("[a-z0-9]+", name.lower()))[:60].strip("-") or "spec"


def _format_flag_value(shot: Shot, value: Expr) -> str:
    """Return the value of a `set` line in the form that `--set` accepts. It is the text in the source, or a computed number with
    its unit."""
    text = "".join(value.span.text.split())
    try:
        parse_quantity(text)
    except QuantityError:
        constant = find_constant(value)
        assert isinstance(constant, Constant)
        unit = choose_default_unit(constant.type.dimension)
        one = find_unit_measure(unit)
        return f"{convert_constant(constant, shot.scene) / (1.0 if one is None else one.factor)!r}{unit}"
    return text
