"""The planned positions of agents in the next seconds of a session, simulated in a separate world.

The session's world is copied once when this simulation begins, and never changed."""

from __future__ import annotations

from antdsl.preview.agent_columns import POSITION_COLUMNS, Arrays, make_packet_arrays, reuse_arrays
from antdsl.preview.session import PreviewSession
from antdsl.preview.timeline import ParamChange, SimulationSegment
from antdsl.runtime import FaultStop, LimitStop, World, step, take_checkpoint

LOOK_AHEAD_SECONDS = 2.0
_MAX_POSITION_BYTES = 1 << 26  # maximum size of the stored positions


class LookAheadSimulation:
    """Simulated future frames of a session: 2 seconds, or as many as fit in 64 MiB.

    `frames`: by frame, the ids and positions of all species; the first is the session's current frame. As the session advances
    through these frames, only new frames at the end are simulated. No frames are simulated past an edit, past the end of the
    existing history after the session went back, or past a step that fails."""

    def __init__(self) -> None:
        self.frames: dict[int, dict[str, Arrays]] = {}
        self.version = 0  # changes whenever the frames change
        self._run_key: tuple[SimulationSegment, tuple[ParamChange, ...]] | None = None
        self._world: World | None = None
        self._stopped = False

    def clear(self) -> None:
        """Drop all frames. The next call of `simulate_next_frame` starts again from the session's current frame."""
        if self._world is not None:
            self.frames, self._run_key, self._world, self._stopped = {}, None, None, False
            self.version += 1

    def needs_simulation(self, session: PreviewSession) -> bool:
        """Return whether more frames must be simulated.

        This also drops frames that do not belong to the session's current run, and frames before the current one."""
        stretch = session.timeline.find_stretch(session.frame)
        of = (stretch, tuple(stretch.param_changes))
        if of != self._run_key or session.frame not in self.frames:
            self.clear()
            self._run_key = of
            return True
        for frame in [each for each in self.frames if each < session.frame]:
            del self.frames[frame]
        return not self._stopped and max(self.frames) < self._find_last_frame(session)

    def simulate_next_frame(self, session: PreviewSession) -> None:
        """Simulate the next future frame, unless enough frames are stored. The first call only stores the session's current
        frame."""
        stretch, world = session.timeline.find_stretch(session.frame), self._world
        if world is None:
            world = self._world = stretch.restore_world(
                take_checkpoint(session.world), session.options, session.compiler.binding_cache
            )
        else:
            stretch.apply_param_changes(world)
            try:
                step(world)
            except LimitStop:  # in the middle of a step
                self._stopped = True
                return
            except FaultStop:
                pass  # the session would also continue after the fault
        previous = self.frames.get(world.frame - 1, {})
        self.frames[world.frame] = {
            name: reuse_arrays(make_packet_arrays(p, POSITION_COLUMNS), previous.get(name, {}))
            for name, p in world.populations.items()
        }
        self.version += 1

    def _find_last_frame(self, session: PreviewSession) -> int:
        """Return the number of the last future frame to simulate."""
        count = max(
            1, min(round(LOOK_AHEAD_SECONDS / session.world.dt), _MAX_POSITION_BYTES // (12 * max(1, len(session.world))))
        )
        next_stretch = session.timeline.find_next_stretch(session.timeline.find_stretch(session.frame))
        return session.frame + count if next_stretch is None else min(session.frame + count, next_stretch.first)
