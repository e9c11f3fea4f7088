"""A cache as a USD stage: crowds in one of three forms, and the world, frame by frame.

Values over time may be in separate files with a fixed number of frames each (USD's value clips). So the stage itself stays small,
and programs open only the files for the frames that they show.

`shot.usdc` names the files `shot.values.0001.usdc`, `shot.values.0025.usdc` …, numbered by their first frames. It also names
`shot.values.manifest.usda`, which lists their attributes. Each file ends with the first sample of the next file, so that values
between the two can be interpolated."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any

import numpy as np

from antdsl import __version__
from antdsl.atomic_write import atomic_path
from antdsl.outputs.cache.frame_agents import IDENTITY_ARRAYS, get_species_numbers
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.usd.instancers import InstancerWriter
from antdsl.outputs.usd.skeletons import SkeletonWriter
from antdsl.outputs.usd.time_samples import TimeSamples
from antdsl.outputs.usd.values import BODIES_PATH, ROOT_PATH, StageOutput, add_root, raise_disk_errors
from antdsl.outputs.usd.world import WorldWriter
from antdsl.outputs.usd.xforms import XformWriter
from antdsl.scene.geometry.usd import import_pxr_module
from antdsl.scene.scene_model import UNIT_MM

_DEFAULT_CLIP_SET = "default"  # the name of a prim's first set of clips
MAX_SKELETON_AGENTS = 200  # maximum number of agents of a species with separate skeletons
# Whether each program poses instances of a skeleton. Blender leaves them in their bind pose; Karma, Arnold and Storm pose them.
POSES_INSTANCES_BY_TARGET: Mapping[str, bool] = MappingProxyType({"blender": False, "houdini": True, "usdview": True})
DEFAULT_TARGET = next(iter(POSES_INSTANCES_BY_TARGET))
_FRAMES_PER_SAVE = 24  # frames in memory before the file is saved
_SAME_TIME_FRAMES = 1e-6  # frames


@dataclass(frozen=True, slots=True, kw_only=True)
class XformOptions:
    """Options of an export to USD.

    `shutter`: the interval around each frame, in frames, within which agents have samples; None for one sample per frame.
    `samples`: the number of samples in this interval. `chunk`: the number of frames per file of values; 0 writes all values to
    the stage itself. `close`: whether agents have their close-up bodies."""

    shutter: tuple[float, float] | None = None
    samples: int = 3
    chunk: int = 0
    close: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class UsdOptions(XformOptions):
    """Options of an export to USD with instances.

    `skeletons`: species of up to this many agents are written with a skeleton per agent. The agents of larger species are
    instances from a bank of poses. `target`: the program that will read the file, a key of `POSES_INSTANCES_BY_TARGET`. Agents
    with skeletons are instances if this program poses instances, else copies."""

    skeletons: int = MAX_SKELETON_AGENTS
    target: str = DEFAULT_TARGET


_DEFAULT_OPTIONS = UsdOptions()
CrowdWriter = InstancerWriter | SkeletonWriter | XformWriter


def export_instances(gallery: Gallery, frames: Iterable[int], path: Path, options: UsdOptions = _DEFAULT_OPTIONS) -> list[str]:
    """Write these frames to a USD file, atomically. Return messages about features that USD cannot represent.

    A species of few agents is written as skeletons, a species of many as a point instancer.

    Raises UsdError without usd-core, CacheError for a damaged frame, OSError if writing fails."""
    frames = list(frames)
    most = _count_max_agents(gallery, frames)

    def choose_writer(number: int) -> Callable[..., CrowdWriter]:
        if most[number] > options.skeletons:
            return partial(InstancerWriter, close=options.close)
        return partial(SkeletonWriter, has_instances=POSES_INSTANCES_BY_TARGET[options.target], close=options.close)

    return _export_stage(gallery, frames, path, options, choose_writer)


def export_xforms(gallery: Gallery, frames: Iterable[int], path: Path, options: XformOptions = _DEFAULT_OPTIONS) -> list[str]:
    """Write the stage with one Xform per agent, for programs that animate single objects."""
    return _export_stage(gallery, list(frames), path, options, lambda number: partial(XformWriter, close=options.close))


def _count_max_agents(gallery: Gallery, frames: list[int]) -> list[int]:
    """Return, for each species, the greatest number of its agents in any frame."""
    count = len(gallery.manifest.species)
    most = np.zeros(count, np.int64)
    for frame in frames:
        which = get_species_numbers(gallery.cache.frame(frame, IDENTITY_ARRAYS))
        most = np.maximum(most, np.bincount(which, minlength=count)[:count])
    counts: list[int] = most.tolist()
    return counts


def compute_sample_times(frame: int, options: XformOptions) -> list[float]:
    """Return the times of the samples of agents for a frame: the frame itself, and times in the shutter interval."""
    around = np.linspace(*options.shutter, options.samples) if options.shutter else np.zeros(1)
    sample_times: list[float] = sorted({round(frame + part, 6) for part in (0.0, *around.tolist())})
    return sample_times


def _export_stage(
    gallery: Gallery,
    frames: list[int],
    path: Path,
    options: XformOptions,
    choose_writer: Callable[[int], Callable[..., CrowdWriter]],
) -> list[str]:
    """Write these frames as a stage. Return messages about features that USD cannot represent.

    `choose_writer`: returns the class that writes a species, given the greatest number of its agents."""
    with raise_disk_errors(path), atomic_path(path, path.suffix) as part:
        try:
            stage = import_pxr_module("Usd").Stage.CreateNew(str(part))
        except import_pxr_module("Tf").ErrorException as problem:
            raise OSError(None, "cannot be written", str(path)) from problem
        out = StageOutput(stage, gallery.shows_states)
        with ValueFiles(out, path, frames, options.chunk) as files:
            _write_metadata(stage, gallery, frames)
            crowds = [choose_writer(number)(out, species, number) for number, species in enumerate(gallery.manifest.species)]
            _write_frames(
                _FrameWriters(WorldWriter(out, gallery, frames), crowds, TimeSamples(gallery)), files, frames, options, stage
            )
            notes = [note for crowd in crowds for note in crowd.notes]
        del crowds, files, out, stage  # the file is closed before it is moved
    return list(dict.fromkeys(notes))


@dataclass(frozen=True, slots=True)
class _FrameWriters:
    """The writers of everything that a frame contains."""

    world: WorldWriter
    crowds: list[CrowdWriter]
    time_samples: TimeSamples

    def write_time(self, time: float, frame: int) -> None:
        """Write the agents at a time. If it is the time of the frame itself, also write the world."""
        time_sample = self.time_samples.build_sample(time, frame)
        if time == frame:
            self.world.frame(frame, time_sample.picture)
        for crowd in self.crowds:
            crowd.sample(time_sample)


def _write_frames(shot: _FrameWriters, files: ValueFiles, frames: list[int], options: XformOptions, stage: Any) -> None:
    """Write the samples of all frames. If files of values are requested, write them to these files."""
    written = -np.inf
    for number, frame in enumerate(frames):
        for time in compute_sample_times(frame, options):
            if time <= written + _SAME_TIME_FRAMES:
                continue
            if written == -np.inf:
                files.begin(frame)
            elif time == frame and files.starts_new_file(frame):
                shot.write_time(time, frame)  # completes the previous file
                files.begin(frame)
            shot.write_time(time, frame)
            written = time
        if number % _FRAMES_PER_SAVE == _FRAMES_PER_SAVE - 1:
            stage.Save()
    files.link_files()
    stage.Save()


def _write_metadata(stage: Any, gallery: Gallery, frames: list[int]) -> None:
    """Write the units, the up axis and the times of the stage."""
    geom, manifest = import_pxr_module("UsdGeom"), gallery.manifest
    geom.SetStageMetersPerUnit(stage, UNIT_MM[manifest.units] / 1000)
    geom.SetStageUpAxis(stage, manifest.up.upper())
    stage.SetTimeCodesPerSecond(1 / gallery.dt)
    stage.SetFramesPerSecond(1 / gallery.dt)
    stage.SetStartTimeCode(frames[0])
    stage.SetEndTimeCode(frames[-1])
    stage.SetMetadata("comment", f"antdsl {__version__}: {manifest.scene}, seed {manifest.seed}")
    world = add_root(stage, gallery.origin)
    import_pxr_module("Usd").ModelAPI(world).SetKind("assembly")
    stage.SetDefaultPrim(world.GetPrim())
    stage.CreateClassPrim(BODIES_PATH)


class ValueFiles:
    """The files with the values of a stage that is written to `path`."""

    def __init__(self, stage_output: StageOutput, path: Path, frames: list[int], chunk: int) -> None:
        self._out, self._path, self._frames = stage_output, path, frames
        groups = {(frame - frames[0]) // chunk: frame for frame in reversed(frames)} if chunk else {}
        self._first_frames = sorted(groups.values())
        self._unfinished_files = ExitStack()
        self._layer: Any = None
        if self._first_frames:
            stage_output.manifest_layer = import_pxr_module("Sdf").Layer.CreateAnonymous("manifest.usda")

    def starts_new_file(self, frame: int) -> bool:
        """Return whether a new file begins with this frame."""
        return frame in self._first_frames[1:]

    def begin(self, frame: int) -> None:
        """Begin the file of values for this frame and those after it. Raises OSError if this fails."""
        if not self._first_frames:
            return
        self._save_file()
        part = self._unfinished_files.enter_context(atomic_path(self._make_file_path(f"{frame:04d}.usdc"), ".usdc"))
        part.unlink()
        self._layer = import_pxr_module("Sdf").Layer.CreateNew(str(part))
        self._out.begin(self._layer)

    def _save_file(self) -> None:
        """Save the current file of values."""
        if self._layer is not None:
            self._layer.Save()
        self._layer = None

    def __enter__(self) -> ValueFiles:
        return self

    def __exit__(self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None) -> None:
        """Move all files to their final paths, or none if anything failed.

        The stage of an earlier export is removed first. Otherwise it would use the new values if the new stage is never
        written."""
        self._layer = self._out.clip = None
        if self._first_frames and kind is None:
            self._path.unlink(missing_ok=True)
        self._unfinished_files.__exit__(kind, problem, trace)

    def link_files(self) -> None:
        """Write the names of all files of values to the stage."""
        self._save_file()
        if not self._first_frames:
            return
        self._out.clip = None
        manifest = self._make_file_path("manifest.usda")
        self._out.manifest_layer.Export(str(self._unfinished_files.enter_context(atomic_path(manifest, ".usda"))))
        gf, vt = import_pxr_module("Gf"), import_pxr_module("Vt")
        clips = import_pxr_module("Usd").ClipsAPI(self._out.stage.GetPrimAtPath(ROOT_PATH))
        names = [f"./{self._make_file_path(f'{frame:04d}.usdc').name}" for frame in self._first_frames]
        clips.SetClipAssetPaths(
            import_pxr_module("Sdf").AssetPathArray([import_pxr_module("Sdf").AssetPath(name) for name in names]),
            _DEFAULT_CLIP_SET,
        )
        clips.SetClipManifestAssetPath(import_pxr_module("Sdf").AssetPath(f"./{manifest.name}"), _DEFAULT_CLIP_SET)
        clips.SetClipPrimPath(ROOT_PATH, _DEFAULT_CLIP_SET)
        ends = (self._frames[0] - 1, self._frames[-1] + 2)  # samples of a shutter interval are around the frames
        begins = [ends[0], *self._first_frames[1:]]
        clips.SetClipActive(vt.Vec2dArray([gf.Vec2d(begin, k) for k, begin in enumerate(begins)]), _DEFAULT_CLIP_SET)
        clips.SetClipTimes(vt.Vec2dArray([gf.Vec2d(end, end) for end in ends]), _DEFAULT_CLIP_SET)

    def _make_file_path(self, extension: str) -> Path:
        """Return the path of a file of values. `extension`: its number and suffix."""
        return self._path.with_name(f"{self._path.stem}.values.{extension}")
