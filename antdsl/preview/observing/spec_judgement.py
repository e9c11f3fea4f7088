"""Evaluation of a scene's specs while it runs. The results are stored as curves.

Each frame is judged once, when it is first simulated. After an edit, the evaluation starts again at the edited frame, because
the results are valid for one program only."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from os.path import realpath
from pathlib import Path
from time import perf_counter, thread_time
from typing import Any

from antdsl.pipeline import Shot
from antdsl.plan.lowering.spec_blocks import lower_spec
from antdsl.plan.lowering.spec_plans import SpecPlan
from antdsl.preview.observing.observer import PauseReason
from antdsl.preview.session import PreviewSession
from antdsl.preview.timeline import SimulationSegment
from antdsl.program.expectations import Spec
from antdsl.runtime import World
from antdsl.scene.paths import PathRefused, Roots
from antdsl.specs.cases import SpecFailure
from antdsl.specs.judge import SpecJudge

# Limits of judging an unrequested spec: share of the time of a step, and seconds
_MAX_JUDGING_SHARE, _MAX_JUDGING_SECONDS = 0.1, 0.004
_WARM_UP_FRAMES, _MEASURED_FRAMES = 3, 24  # frames before the measurement, and measured frames
CURVE_NAME_PREFIX = "spec: "


@dataclass(slots=True, eq=False)
class SpecStatus:
    """The status of one spec.

    `plan`: how to judge the spec; None if it cannot be judged.
    `judge`: the object that judges each frame; None while the spec is not judged. `reason`: why it is not judged.
    `seconds` and `frames`: the total time spent on judging, and the number of judged frames."""

    name: str
    plan: SpecPlan | None = None
    reason: str = ""
    judge: SpecJudge | None = None
    seconds: float = 0.0
    frames: int = 0

    @property
    def failure(self) -> SpecFailure | None:
        """Return the first failure of the spec, or None."""
        return self.judge.failures[0] if self.judge is not None and self.judge.failures else None

    def make_json_entry(self) -> dict[str, Any]:
        """Return the status as an entry of the message `specs`."""
        failed = self.failure
        return {
            "name": self.name,
            "holds": None if self.judge is None else failed is None,
            "since": None if self.judge is None else self.judge.first,
            "frame": None if failed is None else failed.frame,
            "message": self.reason if failed is None else describe_failure(failed),
            "species": failed.agent[0] if failed is not None and failed.agent is not None else "",
            "agents": [] if failed is None else list(failed.agents),
        }


class SpecObserver:
    """Judges all specs of a session's program. Slow specs are stopped, unless a breakpoint requires them.

    `send_message`: called with a message whenever the status of a spec changes."""

    def __init__(self, send_message: Callable[[dict[str, Any]], None] = lambda message: None) -> None:
        self.send_message, self.wanted = send_message, frozenset[str]()
        self.statuses: list[SpecStatus] = []
        self._cached_plans: tuple[Shot, list[tuple[str, SpecPlan | str]]] | None = None
        self._stretch: SimulationSegment | None = None
        self._last_judged_frame = 0  # the last judged frame
        self._last_message: dict[str, Any] = {}
        self._step_start_time = 0.0

    def make_message(self) -> dict[str, Any]:
        """Return the message that lists the status of all specs."""
        return {"op": "specs", "specs": [each.make_json_entry() for each in self.statuses]}

    def require_specs(self, names: Collection[str]) -> None:
        """Judge these specs however slow they are. Specs that were stopped are judged again from the next step on."""
        self.wanted = frozenset(names)

    def plan_specs(self, shot: Shot, scene: Path) -> list[tuple[str, SpecPlan | str]]:
        """Return all specs of a program by name, each with its plan, or with the reason why it cannot be judged in this
        session."""
        if self._cached_plans is None or self._cached_plans[0] is not shot:
            self._cached_plans = shot, list(_plan_specs(shot, scene))
        return self._cached_plans[1]

    def on_new_world(self, session: PreviewSession) -> None:
        """Do nothing, because the next step notices the new world by its segment of history."""

    def before_step(self, session: PreviewSession) -> None:
        """If necessary, judge the current frame before the step. Then start to measure the time of the step."""
        self._judge_frame(session)
        self._step_start_time = perf_counter()

    def after_step(self, session: PreviewSession) -> PauseReason | None:
        """Judge the new frame, and send the statuses if they changed. Always return None, so the session never pauses."""
        took = perf_counter() - self._step_start_time
        self._judge_frame(session)
        for each in self.statuses:
            self._stop_if_slow(each, took)
        message = self.make_message()
        if message != self._last_message:
            self._last_message = message
            self.send_message(message)
        return None

    def _judge_frame(self, session: PreviewSession) -> None:
        """Judge the session's current frame, if it has just been simulated for the first time."""
        frame, shot = session.frame, session.shot
        if frame != session.last_frame or frame < shot.frames.first:
            return
        stretch = session.timeline.find_stretch(frame)
        if stretch is not self._stretch or frame not in (self._last_judged_frame, self._last_judged_frame + 1):
            self._stretch = stretch
            self.statuses = [_make_status(*each) for each in self.plan_specs(shot, session.compiler.scene)]
            fresh = self._start_judging(session, lambda spec: True)
        else:
            again = self._start_judging(session, lambda spec: spec.name in self.wanted)
            fresh = self.statuses if frame != self._last_judged_frame else again
        self._last_judged_frame = frame
        for each in fresh:
            self._judge_spec(each, session.world)
            if each.judge is not None:
                curve = 0.0 if each.failure is not None else 1.0
                session.timeline.curves[frame].setdefault(CURVE_NAME_PREFIX + each.name, curve)

    def _start_judging(self, session: PreviewSession, is_selected: Callable[[SpecStatus], bool]) -> list[SpecStatus]:
        """Start to judge specs from this frame on, and return their statuses.

        These are all specs that `is_selected` accepts, that are not being judged, and that can be judged."""
        candidates = [each for each in self.statuses if each.judge is None and each.plan is not None and is_selected(each)]
        for each in candidates:
            assert each.plan is not None
            each.judge = SpecJudge(each.plan, session.world, session.shot.frames.last)
            each.reason, each.seconds, each.frames = "", 0.0, 0
        return candidates

    def _judge_spec(self, status: SpecStatus, world: World) -> None:
        if status.judge is not None and not status.judge.is_over:
            began = thread_time()  # CPU time of this thread, so that other load on the machine does not count
            status.judge.judge_frame(world)
            status.frames += 1
            if status.frames > _WARM_UP_FRAMES:
                status.seconds += thread_time() - began

    def _stop_if_slow(self, status: SpecStatus, step_seconds: float) -> None:
        """Stop judging a spec that takes too long. Do nothing if the spec has already failed, or if a breakpoint needs it.

        `step_seconds`: duration of the last step (s)."""
        if status.judge is None or status.frames < _MEASURED_FRAMES or status.name in self.wanted or status.failure is not None:
            return
        takes = status.seconds / (status.frames - _WARM_UP_FRAMES)
        if not status.judge.is_over and takes > max(_MAX_JUDGING_SHARE * step_seconds, _MAX_JUDGING_SECONDS):
            status.judge = None
            status.reason = f"judging it takes {1000 * takes:.1f} ms per frame; set a breakpoint on it to judge it anyway"


def _make_status(name: str, plan: SpecPlan | str) -> SpecStatus:
    return SpecStatus(name, None, plan) if isinstance(plan, str) else SpecStatus(name, plan)


def _plan_specs(shot: Shot, scene: Path) -> Iterator[tuple[str, SpecPlan | str]]:
    names: list[str] = []
    for spec in shot.program.specs:
        names.append(spec.name)
        name = spec.name if names.count(spec.name) == 1 else f"{spec.name} ({names.count(spec.name)})"
        yield name, _find_obstacle(spec, shot, scene) or _plan_spec(spec, shot)


def _plan_spec(spec: Spec, shot: Shot) -> SpecPlan | str:
    plan, report = lower_spec(spec, shot.program, shot.plan)
    return plan if plan is not None else next(each.message for each in report.errors)


def _find_obstacle(spec: Spec, shot: Shot, scene: Path) -> str:
    """Return the reason why a spec cannot be judged in this run, or "" if it can be judged."""
    if spec.scene is not None:
        try:
            place = Roots(Path(spec.span.source.path).resolve().parent, shot.scene.roots.folder_by_name).resolve_path(
                spec.scene.text
            )
        except PathRefused as why:
            return str(why)
        if realpath(place) != realpath(scene):
            return f"its scene is `{spec.scene.text}`"
    if spec.reference_run is not None:
        return "it compares with another run, as `antdsl test` does"
    if spec.changes:
        return f"it sets `{spec.changes[0].name}`, as `antdsl test` does"
    if shot.scene.model.preroll and any(each.is_at_end for each in spec.expectations):
        return "it uses `motion`, which includes the preroll here; `antdsl test` leaves the preroll out"
    return ""


def describe_failure(failure: SpecFailure) -> str:
    """Return one line that describes a failure: the condition that did not hold, the agent, and the values."""
    agent_text = ""
    if failure.agent is not None:
        others_text = f" and {failure.other_count} more" if failure.other_count else ""
        agent_text = f", {failure.agent[0]} {failure.agent[1]}{others_text}"
    values = ", ".join(f"{text} is {value}" for text, value in failure.values)
    return f"{failure.message}{agent_text}" + (f" ({values})" if values else "")
