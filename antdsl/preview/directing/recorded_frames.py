"""The simulated frames of a session, presented as a cache.

The arrays of a frame are made only when it is read, from a world at this frame."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field
from pathlib import Path

from antdsl.outputs.cache.body_arrays import StoredBodies
from antdsl.outputs.cache.cache_reader import Arrays, Cache, CacheError, select_arrays
from antdsl.outputs.cache.frame_maker import FrameMaker, make_static_arrays
from antdsl.outputs.cache.manifest import Manifest
from antdsl.outputs.shot_manifest import make_shot_manifest
from antdsl.pipeline import Shot
from antdsl.preview.session import PreviewSession
from antdsl.preview.timeline import SimulationSegment, Timeline, find_nearest_checkpoint
from antdsl.runtime import FaultStop, LimitStop, World, step
from antdsl.scene.crowds.crowd_model import collect_body_weights

DISPLAYED_ATTRIBUTES = ("id", "P", "v", "orient", "pscale", "Cd", "state")  # in addition to those of the scene's output
_MAX_STORED_BYTES = 1 << 27


@dataclass(slots=True, eq=False)
class _RecordedFrameStore:
    """A store of frames in memory, with the world that simulates further frames.

    `history`: the timeline that the frames belong to, and its version."""

    frames: OrderedDict[int, Arrays] = field(default_factory=OrderedDict)
    nbytes: int = 0
    history: tuple[Timeline, int] | None = None
    world: World | None = None
    stretch: SimulationSegment | None = None
    shots: list[Shot] = field(default_factory=list)  # with the species and bodies of the manifest

    def clear_for_history(self, history: tuple[Timeline, int]) -> None:
        self.frames, self.nbytes, self.history, self.world, self.stretch = OrderedDict(), 0, history, None, None

    def put_frame(self, number: int, arrays: Arrays) -> None:
        self.frames[number] = arrays
        self.nbytes += _count_bytes(arrays)
        while self.nbytes > _MAX_STORED_BYTES and len(self.frames) > 1:
            self.nbytes -= _count_bytes(self.frames.popitem(last=False)[1])


@dataclass(frozen=True, eq=False)
class RecordedFrames(Cache):
    """The simulated frames of a session, presented as a cache. When a frame other than the session's current one is read, it is
    simulated from the nearest checkpoint. `shot`: the shot that the manifest describes. `static`: the arrays of `static.npz`.
    `last`: the last frame; None for all frames."""

    session: PreviewSession
    shot: Shot
    static: Arrays
    last: int | None = None
    _store: _RecordedFrameStore = field(default_factory=_RecordedFrameStore)

    @classmethod
    def of(cls, session: PreviewSession) -> RecordedFrames:
        """Return the frames of a session. Names of species and states are those of its current programs."""
        shot, world = session.shot, session.world
        bodies = StoredBodies.from_definitions(shot.bodies, collect_body_weights(shot.scene.model.crowd))
        static = {**make_static_arrays(world, shot.setting), **bodies.arrays}
        return cls(Path(shot.scene.source.path).parent, _make_manifest(shot, world, bodies), session, shot, static)

    def frames(self) -> list[int]:
        """Return the numbers of the simulated frames, ascending."""
        last = self.session.last_frame if self.last is None else min(self.last, self.session.last_frame)
        return list(range(self.session.first_frame, last + 1))

    def read_static(self) -> Arrays:
        """Return the arrays that apply to all frames."""
        return self.static

    def frame(self, number: int, names: frozenset[str] | None = None) -> Arrays:
        """Return the arrays of a frame. Raises CacheError if the frame was not simulated, or if its program had other states."""
        session, store = self.session, self._store
        if not session.first_frame <= number <= session.last_frame:
            raise CacheError(f"frame {number} is not among those simulated, {session.first_frame} to {session.last_frame}")
        history = session.timeline, session.timeline.version
        if store.history != history:
            store.clear_for_history(history)
        if number in store.frames:
            store.frames.move_to_end(number)
        elif session.frame == number:
            store.put_frame(number, self._make_frame(session.shot, session.world))
        else:
            self._simulate_to(number)
        return select_arrays(store.frames[number], names)

    def _simulate_to(self, number: int) -> None:
        """Simulate up to frame `number` in a separate world, and store each frame on the way."""
        session, store = self.session, self._store
        stretch = session.timeline.find_stretch(number)
        checkpoint = find_nearest_checkpoint(stretch, number)
        if store.world is None or store.stretch is not stretch or not checkpoint <= store.world.frame < number:
            store.world, store.stretch = (
                stretch.restore_world(stretch.checkpoints[checkpoint], session.options, session.compiler.binding_cache),
                stretch,
            )
            store.put_frame(checkpoint, self._make_frame(stretch.shot, store.world))
        while store.world.frame < number:
            stretch.apply_param_changes(store.world)
            try:
                step(store.world)
            except FaultStop:
                pass  # the session continued after the fault
            except LimitStop as stop:
                store.world = None
                raise CacheError(f"frame {number} cannot be simulated again: {stop.fault.brief_text}") from None
            store.put_frame(store.world.frame, self._make_frame(stretch.shot, store.world))

    def _make_frame(self, shot: Shot, world: World) -> Arrays:
        if shot is not self.shot and not any(shot is each for each in self._store.shots):
            bodies = StoredBodies.from_definitions(shot.bodies, collect_body_weights(shot.scene.model.crowd))
            manifest = _make_manifest(shot, world, bodies)
            if any(getattr(manifest, name) != getattr(self.manifest, name) for name in ("species", "bodies", "origin", "units")):
                raise CacheError(f"frame {world.frame} was simulated by another program, with other states or bodies")
            self._store.shots.append(shot)
        return FrameMaker(world, shot.program, list_attributes(shot)).frame(world)


def _make_manifest(shot: Shot, world: World, bodies: StoredBodies) -> Manifest:
    return make_shot_manifest(shot, world, FrameMaker(world, shot.program, list_attributes(shot)).attributes, bodies)


def list_attributes(shot: Shot) -> tuple[str, ...]:
    """Return the names of the arrays of agents in frames: the output attributes of the shot and the arrays that pages display."""
    machines = (machine.name for species in shot.plan.species.values() for machine in species.machines[1:])
    states = (f"{name}.state" for name in machines)
    return tuple(dict.fromkeys((*shot.scene.model.output.attributes, *DISPLAYED_ATTRIBUTES, *states)))


def _count_bytes(arrays: Arrays) -> int:
    return sum(each.nbytes for each in arrays.values())
