"""The simulated history. It consists of segments ("stretches" of time), each simulated by one program.

Segments have checkpoints from which to continue, and reduced frames to display. A reduced frame has only some of the arrays that
pages display."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from antdsl.pipeline import RunChoices, Shot
from antdsl.preview.agent_columns import Arrays, make_reduced_frame
from antdsl.runtime import BindingCache, Options, World, restore_checkpoint, set_param, state_hash, take_checkpoint
from antdsl.runtime.binding.bind_world import bind_world_without_agents

_REDUCED_FRAMES_BUDGET_SHARE = 0.25  # share of the budget for reduced frames
_POSES_BUDGET_SHARE = 0.125  # share of the budget for poses of bodies
_MAX_CURVE_FRAMES = 50_000  # frames
_MAX_BRANCHES = 8
_MAX_STOP_REASONS = 256


class ReducedFrames(dict[int, Mapping[str, Arrays]]):
    """Reduced frames, by frame and species. `nbytes`: the size of all arrays in bytes. An array that several frames share counts
    once."""

    def __init__(self) -> None:
        super().__init__()
        self.nbytes = 0
        self._use_count_by_array: Counter[int] = Counter()

    def put_frame(self, frame: int, arrays_by_species: Mapping[str, Arrays]) -> None:
        """Store the arrays of a frame by species, and count their bytes."""
        self.drop_frame(frame)
        self[frame] = arrays_by_species
        for array in chain.from_iterable(light.values() for light in arrays_by_species.values()):
            self.nbytes += array.nbytes if not self._use_count_by_array[id(array)] else 0
            self._use_count_by_array[id(array)] += 1

    def drop_frame(self, frame: int) -> None:
        """Remove a frame. Arrays that other frames share still count in `nbytes`."""
        for array in chain.from_iterable(light.values() for light in self.pop(frame, {}).values()):
            self._use_count_by_array[id(array)] -= 1
            if not self._use_count_by_array[id(array)]:
                del self._use_count_by_array[id(array)]
                self.nbytes -= array.nbytes


@dataclass(frozen=True, slots=True, eq=False)
class SpeciesPoses:
    """The poses of the agents of one species at a frame, as sent to pages.

    `arrays`: the arrays by name. They are valid only for the body and the clips of `outfit`."""

    outfit: object
    arrays: Arrays


class StoredPoses(dict[int, Mapping[str, SpeciesPoses]]):
    """Poses of bodies, by frame and species. `nbytes`: the size of all arrays in bytes."""

    def __init__(self) -> None:
        super().__init__()
        self.nbytes = 0

    def put_frame(self, frame: int, poses: Mapping[str, SpeciesPoses]) -> None:
        """Store the poses of a frame by species, and count their bytes."""
        self.drop_frame(frame)
        self[frame] = poses
        self.nbytes += sum(_count_bytes(each.arrays) for each in poses.values())

    def drop_frame(self, frame: int) -> None:
        """Remove the poses of a frame."""
        self.nbytes -= sum(_count_bytes(each.arrays) for each in self.pop(frame, {}).values())


@dataclass(frozen=True, slots=True)
class ParamChange:
    """A change of a param at a frame. `text`: the new value as the user wrote it. `value`, `previous_value`: the new and the
    previous value in base units."""

    frame: int
    name: str
    text: str
    value: float
    previous_value: float


@dataclass(slots=True, eq=False)
class SimulationSegment:
    """A segment of history: the frames from `first` on that one shot simulated.

    `reason`: why the segment was started.
    `choices`, `disabled_layers`: the settings that the user had made when it began. `disabled_layers` maps species and layer
    text to the layer's file.
    `param_changes`: params that were set during the segment.
    `is_fresh`: whether its first frame equals that of a run without edits."""

    shot: Shot
    first: int
    reason: str
    origin: NDArray[np.float64]
    choices: RunChoices
    disabled_layers: Mapping[tuple[str, str], Path] = field(default_factory=dict)
    checkpoints: dict[int, Arrays] = field(default_factory=dict)
    param_changes: list[ParamChange] = field(default_factory=list)
    is_fresh: bool = True
    # the inputs of an unedited run up to its first frame, and the hash there
    _state_before_edit: tuple[object, str] | None = None

    def replace(self, previous_stretch: SimulationSegment, old_world: World, world: World) -> None:
        """Take over from the segment `previous_stretch` at the frame of its world `old_world`.

        `world`: the world of this segment, made from `old_world`. This segment counts as a fresh run if an edit was undone at
        the frame at which it was made, and no state was lost."""
        if previous_stretch.first == old_world.frame and previous_stretch._state_before_edit is not None:
            self._state_before_edit = previous_stretch._state_before_edit
        elif previous_stretch.is_fresh and not previous_stretch.param_changes:
            self._state_before_edit = previous_stretch._list_source_texts(), state_hash(old_world)
        same = self._state_before_edit is not None and self._state_before_edit[0] == self._list_source_texts()
        self.is_fresh = same and self._state_before_edit == (self._list_source_texts(), state_hash(world))

    def _list_source_texts(self) -> object:
        """Return the sources of the shot and the disabled layers, for comparison with those of another segment."""
        return dict(self.shot.inputs), frozenset(self.disabled_layers)

    def change_param(self, world: World, name: str, text: str, value: float) -> None:
        """Set a param from the world's frame on. A value that is set and reset at the same frame is not recorded."""
        current_changes = [each for each in self.param_changes if (each.frame, each.name) == (world.frame, name)]
        was = current_changes[0].previous_value if current_changes else float(world.params[name])
        self.param_changes = [each for each in self.param_changes if each not in current_changes]
        if np.float32(value) != np.float32(was):
            self.param_changes.append(ParamChange(world.frame, name, text, value, was))
        set_param(world, name, value)

    def restore_world(self, arrays: Arrays, options: Options, binding_cache: BindingCache) -> World:
        """Return a new world with the state of a checkpoint. `arrays`: the arrays of the checkpoint."""
        world = bind_world_without_agents(
            self.shot.plan, self.shot.setting, options, binding_cache=binding_cache, origin=self.origin
        )
        restore_checkpoint(world, arrays)
        return world

    def apply_param_changes(self, world: World) -> None:
        """Apply the param changes that are recorded for the world's current frame to the world."""
        for change in self.param_changes:
            if change.frame == world.frame:
                set_param(world, change.name, change.value)


@dataclass(frozen=True, slots=True, eq=False)
class TimelineBranch:
    """A part of the history that an edit replaced: everything from frame `first` on. `reason`: why it was replaced. Its curves
    are displayed next to the new ones."""

    first: int
    reason: str
    curves: dict[int, dict[str, float]]


class Timeline:
    """The segments of a session's history, in order of time, with a checkpoint every `every` frames.

    If the data exceeds `max_bytes` bytes, parts are dropped in this order:
    - poses of the oldest frames, until poses take an eighth
    - the oldest reduced frames, until they take a quarter
    - checkpoints between others, where they are closest
    - complete segments, oldest first

    `curves`: the curves of the last 50,000 frames, in order. `branches`: the last 8 branches.
    `stop_reasons`: the last 256 frames at which play was stopped, with the reason."""

    def __init__(self, checkpoint_interval: int, budget: int) -> None:
        self.every, self.max_bytes = checkpoint_interval, budget
        self.version = 0  # changes whenever simulated frames are replaced
        self.stretches: list[SimulationSegment] = []
        self.branches: list[TimelineBranch] = []
        self.curves: dict[int, dict[str, float]] = {}
        self.stop_reasons: dict[int, str] = {}
        self.reduced_frames = ReducedFrames()
        self.poses = StoredPoses()  # poses of reduced frames that a page displayed when they were simulated
        self._checkpoint_bytes = 0  # bytes of checkpoints

    @property
    def last_frame(self) -> int:
        """Return the number of the last simulated frame."""
        return next(reversed(self.curves), self.stretches[-1].first if self.stretches else 0)

    @property
    def nbytes(self) -> int:
        """Return the size in bytes of all stored data except curves."""
        return self._checkpoint_bytes + self.reduced_frames.nbytes + self.poses.nbytes

    def find_stretch(self, frame: int) -> SimulationSegment:
        """Return the segment that a frame belongs to. A frame at the boundary of two segments belongs to the later one."""
        return next(stretch for stretch in reversed(self.stretches) if stretch.first <= frame)

    def find_next_stretch(self, stretch: SimulationSegment) -> SimulationSegment | None:
        """Return the segment that follows `stretch`, or None."""
        number = self.stretches.index(stretch) + 1
        return self.stretches[number] if number < len(self.stretches) else None

    def start_stretch(self, stretch: SimulationSegment, world: World) -> None:
        """Continue with a new segment from its first frame on. The old history from this frame on becomes a branch."""
        self.drop_frames_after(stretch.first, stretch.reason)
        self.curves.pop(stretch.first, None)  # to be measured again
        for each in [each for each in self.stretches if each.first == stretch.first]:
            self._drop_stretch(each)
        self.stretches.append(stretch)
        self.store_frame(stretch, world)

    def drop_frames_after(self, frame: int, line: str) -> None:
        """Drop all data of frames after `frame`, except curves, which become a branch. `line`: the reason for the branch."""
        self.version += 1
        old = {each: values for each, values in self.curves.items() if each > frame}
        if old:
            self._add_branch(TimelineBranch(frame, line, old))
        self.stop_reasons = {each: why for each, why in self.stop_reasons.items() if each <= frame}
        for each_stretch in [each for each in self.stretches if each.first > frame]:
            self._drop_stretch(each_stretch)
        for stretch in self.stretches:
            stretch.param_changes = [change for change in stretch.param_changes if change.frame <= frame]
            for each in [each for each in stretch.checkpoints if each > frame]:
                self._checkpoint_bytes -= _count_bytes(stretch.checkpoints.pop(each))
        for each in old:
            del self.curves[each]
            self._drop_frame(each)
        if old:
            self.curves.setdefault(frame, {})  # the frame may be older than all existing ones

    def make_empty_successor(self, line: str) -> Timeline:
        """Return an empty timeline. If the old history has more than one frame, it becomes a branch of the new timeline."""
        timeline = Timeline(self.every, self.max_bytes)
        timeline.branches = self.branches
        if len(self.curves) > 1:
            timeline._add_branch(TimelineBranch(next(iter(self.curves)), line, self.curves))
        return timeline

    def mark_stop(self, frame: int, reason: str) -> None:
        """Record that play was stopped at a frame, with the reason."""
        self.stop_reasons.pop(frame, None)
        self.stop_reasons[frame] = reason
        while len(self.stop_reasons) > _MAX_STOP_REASONS:
            del self.stop_reasons[next(iter(self.stop_reasons))]

    def _add_branch(self, branch: TimelineBranch) -> None:
        self.branches = [*self.branches[1 - _MAX_BRANCHES :], branch]

    def store_frame(self, stretch: SimulationSegment, world: World) -> None:
        """Store the state of a world at its frame. A frame that is simulated again is not stored again."""
        frame = world.frame
        fresh = not self.curves or frame > self.last_frame
        if fresh:
            self.curves[frame] = count_agents(world)
            if len(self.curves) > _MAX_CURVE_FRAMES:
                del self.curves[next(iter(self.curves))]
        if (frame == stretch.first and frame not in stretch.checkpoints) or (fresh and frame % self.every == 0):
            self._checkpoint_bytes -= _count_bytes(stretch.checkpoints.get(frame, {}))
            stretch.checkpoints[frame] = take_checkpoint(world)
            self._checkpoint_bytes += _count_bytes(stretch.checkpoints[frame])
        if fresh:
            previous = self.reduced_frames.get(frame - 1, {})
            self.poses.drop_frame(frame)
            self.reduced_frames.put_frame(
                frame, {name: make_reduced_frame(p, previous.get(name)) for name, p in world.populations.items()}
            )
        self._enforce_budget(stretch)

    def _drop_frame(self, frame: int) -> None:
        """Drop the reduced frame and the poses of a frame."""
        self.reduced_frames.drop_frame(frame)
        self.poses.drop_frame(frame)

    def _drop_stretch(self, stretch: SimulationSegment) -> None:
        self.stretches.remove(stretch)
        self._checkpoint_bytes -= sum(_count_bytes(arrays) for arrays in stretch.checkpoints.values())

    def _enforce_budget(self, current: SimulationSegment) -> None:
        while self.nbytes > self.max_bytes and self._drop_least_useful(current):
            pass

    def _drop_least_useful(self, current: SimulationSegment) -> bool:
        """Drop the stored data that are the least useful. Return False if only one reduced frame and the first checkpoint of each
        segment are left."""
        if self.poses.nbytes > _POSES_BUDGET_SHARE * self.max_bytes:
            self.poses.drop_frame(next(iter(self.poses)))
            return True
        if self.reduced_frames.nbytes <= _REDUCED_FRAMES_BUDGET_SHARE * self.max_bytes:
            between = [entry for each in self.stretches for entry in _list_droppable_checkpoints(each)]
            if between:
                _, _, frame, stretch = min(between, key=lambda entry: entry[:3])
                self._checkpoint_bytes -= _count_bytes(stretch.checkpoints.pop(frame))
                return True
            if self.stretches[0] is not current:
                self._drop_stretch(self.stretches[0])
                for frame in [each for each in self.reduced_frames if each < self.stretches[0].first]:
                    self._drop_frame(frame)
                return True
        if len(self.reduced_frames) > 1:
            self._drop_frame(next(iter(self.reduced_frames)))
        return len(self.reduced_frames) > 1


def _list_droppable_checkpoints(stretch: SimulationSegment) -> Iterator[tuple[bool, int, int, SimulationSegment]]:
    """Yield the checkpoints of a segment except the first.

    Each is a tuple: whether it is the segment's last checkpoint, how many frames would at most have to be simulated without it,
    its frame, and the segment."""
    frames = sorted(stretch.checkpoints)
    for previous_frame, frame, next_frame in zip(frames, frames[1:], [*frames[2:], None], strict=False):
        yield next_frame is None, (frame if next_frame is None else next_frame) - previous_frame, frame, stretch


def count_agents(world: World) -> dict[str, float]:
    """Return the number of agents by species and by state, and the totals of items, under the names that specs use for them."""
    values: dict[str, float] = {}
    for name, population in world.populations.items():
        values[name] = len(population)
        for machine in population.plan.machines:
            counts = np.bincount(population.now[f"{machine.name}.state"], minlength=len(machine.states))
            values |= {f"{name}.{machine.name}.{state}": int(n) for state, n in zip(machine.states, counts, strict=True)}
    for name, items in world.items.items():
        values |= {f"{name}.{attribute}": float(amounts.sum()) for attribute, amounts in items.amounts.items()}
    return values


def _count_bytes(arrays: Arrays) -> int:
    return sum(array.nbytes for array in arrays.values())


def find_nearest_checkpoint(stretch: SimulationSegment, frame: int) -> int:
    """Return the frame of the segment's last checkpoint at or before `frame`."""
    return max(each for each in stretch.checkpoints if each <= frame)
