"""The history of a run, with checkpoints from which a step can be simulated again.

A run is a cache, or a session that is still active. A cache names the scene that made it. A step can be explained only if this
scene still exists with unchanged texts."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from antdsl.diagnostics import Report
from antdsl.outputs.cache.cache_reader import Cache, CacheError
from antdsl.outputs.cache.cache_writer import read_checkpoint
from antdsl.outputs.cache_start import StartError, hash_start_frame
from antdsl.pipeline import RunChoices, Shot, open_scene
from antdsl.runtime import CheckpointError, Options, World, bind, restore_checkpoint, state_hash
from antdsl.runtime.checkpoints import STATE_HASH_VERSION
from antdsl.scene.values import FrameRange

_SET_PREFIX = "--set "
_SPEC_INPUT_PREFIX = "set "


class History(Protocol):
    """A stored run of one shot that can be replayed."""

    @property
    def shot(self) -> Shot: ...

    def checkpoint_frames(self) -> Sequence[int]:
        """Return the numbers of the frames that have a checkpoint, ascending."""

    def restore_world(self, point: int) -> World | None:
        """Return a new world with the state of a checkpoint, or None if the checkpoint is damaged."""

    def find_hash(self, frame: int) -> str | None:
        """Return the state hash of a frame, or None if it is unknown."""

    def apply_interventions(self, world: World) -> None:
        """Apply the external changes that the run received at the current frame of the world. Call this before the next step."""

    def make_missing_error(self, frame: int) -> ExplainError:
        """Return the error for a frame that has no undamaged checkpoint before it."""

    def make_difference_error(self, frame: int) -> ExplainError:
        """Return the error for a frame that has a different state when it is simulated again."""


@dataclass(frozen=True, slots=True, eq=False)
class CacheHistory:
    """The history of a run that wrote a cache. `shot`: the shot that the run simulated. `has_feet`: whether restored worlds
    compute the positions of feet."""

    cache: Cache
    shot: Shot
    threads: int
    hashes: dict[int, str]
    has_feet: bool = False

    @classmethod
    def from_cache(cls, cache: Cache, shot: Shot, threads: int = 1) -> CacheHistory:
        """Return the history of a cache. `threads`: the number of threads for replays."""
        return cls(cache, shot, threads, cache.read_state_hashes())

    def checkpoint_frames(self) -> Sequence[int]:
        return self.cache.checkpoints()

    def restore_world(self, point: int) -> World | None:
        try:
            arrays, *_ = read_checkpoint(self.cache, point)
            options = Options(threads=self.threads, on_fault="quarantine", feet=self.has_feet)
            world = bind(self.shot.plan, self.shot.setting, options)
            restore_checkpoint(world, arrays)
        except (CacheError, CheckpointError):
            return None
        return world if state_hash(world) == self.find_hash(point) else None

    def find_hash(self, frame: int) -> str | None:
        return self.hashes.get(frame)

    def apply_interventions(self, world: World) -> None:
        """Do nothing: a run that writes a cache receives no external changes."""

    def make_missing_error(self, frame: int) -> ExplainError:
        missing = "no good checkpoint" if any(point <= frame for point in self.checkpoint_frames()) else "no checkpoint"
        words = f"`{self.cache.folder}` has {missing} up to frame {frame}"
        return ExplainError(words, "run the scene again: each run writes checkpoints")

    def make_difference_error(self, frame: int) -> ExplainError:
        return ExplainError(
            f"frame {frame} is computed differently than in `{self.cache.folder}`",
            "it was written by another version, or by `antdsl test` with a spec's own settings: run the scene again",
        )


class ExplainError(Exception):
    """Error for a step that cannot be explained. The message can be understood without context.

    `usage`: whether the request itself is wrong. `report`: the findings about the scene's files, if they are the reason."""

    def __init__(self, message: str, help: str = "", *, usage: bool = False, report: Report | None = None) -> None:
        super().__init__(message)
        self.help, self.usage, self.report = help, usage, report


def open_shot(
    cache: Cache, scene: Path | None = None, grants: Mapping[str, Path] | None = None, purpose: str = "an explanation"
) -> Shot:
    """Return the shot that made a cache. Raises ExplainError if its scene is missing, has errors, or differs from the scene that
    made the cache. `purpose`: what the shot is needed for, for the message."""
    manifest = cache.manifest
    path = scene or _find_scene(cache)
    spec = [name for name in manifest.inputs if name.startswith(_SPEC_INPUT_PREFIX)]
    if spec:
        words = f"the cache was made by a spec that sets `{spec[0].removeprefix(_SPEC_INPUT_PREFIX)}`"
        raise ExplainError(words, "only caches of `antdsl run` can be explained")
    if manifest.state_hash != STATE_HASH_VERSION:
        words = f"`{cache.folder}` was written by a version of antdsl that computes state hashes in another way"
        raise ExplainError(words, "run the scene again: then repeated steps can be compared with the cache")
    params = {name.removeprefix(_SET_PREFIX): text for name, text in manifest.inputs.items() if name.startswith(_SET_PREFIX)}
    choices = RunChoices(grants or {}, FrameRange(manifest.first, manifest.last), manifest.seed, params)
    shot, report = open_scene(path, choices)
    if shot is None or not report.ok:
        other = "" if scene is not None else f"if `{path}` is not its scene, name the right one: `--scene FILE`"
        raise ExplainError(f"`{path}` has errors", other, report=report)
    try:
        current_inputs = {**shot.inputs, **hash_start_frame(shot)}
    except StartError as error:
        raise ExplainError(str(error), report=error.report) from None
    recorded_inputs = manifest.inputs
    different = sorted(
        name for name in {**recorded_inputs, **current_inputs} if recorded_inputs.get(name) != current_inputs.get(name)
    )
    if different:
        names = ", ".join(f"`{name}`" for name in different[:5])
        other = "" if scene is not None else f"; if `{path}` is not its scene, name the right one: `--scene FILE`"
        advice = f"{purpose} needs the original texts of the run: restore them, or run the scene again{other}"
        raise ExplainError(f"the cache was made from other inputs: {names}", advice)
    return shot


def _find_scene(cache: Cache) -> Path:
    """Return the path of the scene file that made a cache. The cache stores a relative path. This path is tried from each folder
    above the cache, then from the working directory."""
    name = Path(cache.manifest.scene).name
    folder = cache.folder.resolve()
    then = Path(os.path.normpath(folder / cache.manifest.scene_path)) if cache.manifest.scene_path else None
    near = (place / name for place in (*list(folder.parents)[:4], Path.cwd()))
    for path in (*([then] if then is not None else []), *near):
        if path.is_file():
            return path
    previous_location = f", nor at its previous location: `{cache.manifest.scene_path}`" if then is not None else ""
    words = f"the scene `{name}` of `{cache.folder}` is not near it{previous_location}"
    raise ExplainError(words, "name it: `--scene FILE`", usage=True)
