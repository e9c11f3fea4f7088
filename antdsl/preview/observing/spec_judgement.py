"""Judges the specs of a scene while it runs, and stores the results as curves. Each frame is judged once, when it is first
simulated. After an edit, judgement starts again at the edited frame, since expectations apply to one program."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from os.path import realpath
from pathlib import Path
from time import perf_counter, thread_time
from typing import Any

from antdsl.pipeline import Shot
from antdsl.plan.lowering.spec_blocks import SpecPlan, lower_spec
from antdsl.preview.observing.observer import PauseReason
from antdsl.preview.session import Session
from antdsl.preview.timeline import SimulationStretch
from antdsl.program.expectations import Spec
from antdsl.runtime import World
from antdsl.scene.paths import PathRefused, Roots
from antdsl.specs.cases import Failure
from antdsl.specs.judge import SpecJudge

# Of the time that a step takes, and seconds: what judging a spec may take unless it is requested
_MAX_JUDGING_SHARE, _MAX_JUDGING_SECONDS = 0.1, 0.004
_WARM_UP_FRAMES, _MEASURED_FRAMES = 3, 24  # frames that are not counted, and those after which it is known
CURVE_NAME_PREFIX = "spec: "


@dataclass(slots=True, eq=False)
class SpecStatus:
    """The status of one spec.

    `plan`: None if no plan can exist.
    `why`: the reason if there is no judge.
    `judge`: judges the spec, or None.
    `seconds` and `frames`: the time of judging, and the number of judged frames.
    """

    name: str
    plan: SpecPlan | None = None
    why: str = ""
    judge: SpecJudge | None = None
    seconds: float = 0.0
    frames: int = 0

    @property
    def failure(self) -> Failure | None:
        """Return the first failure of the spec, or None."""
        return self.judge.failures[0] if self.judge is not None and self.judge.failures else None

    def as_json(self) -> dict[str, Any]:
        """Return the status as the message `specs` lists it."""
        failed = self.failure
        return {
            "name": self.name,
            "holds": None if self.judge is None else failed is None,
            "since": None if self.judge is None else self.judge.first,
            "frame": None if failed is None else failed.frame,
            "message": self.why if failed is None else describe_failure(failed),
            "species": failed.agent[0] if failed is not None and failed.agent is not None else "",
            "agents": [] if failed is None else list(failed.agents),
        }


class SpecObserver:
    """Judges all specs of a session's program. Specs that a client requires are judged at any cost. `tell` receives a message
    whenever the status of a spec changes."""

    def __init__(self, tell: Callable[[dict[str, Any]], None] = lambda message: None) -> None:
        self.tell, self.wanted = tell, frozenset[str]()
        self.judged: list[SpecStatus] = []
        self._plans: tuple[Shot, list[tuple[str, SpecPlan | str]]] | None = None
        self._stretch: SimulationStretch | None = None
        self._last = 0  # the frame that was judged last
        self._told: dict[str, Any] = {}
        self._began = 0.0

    def message(self) -> dict[str, Any]:
        """Return the message with the status of all specs."""
        return {"op": "specs", "specs": [each.as_json() for each in self.judged]}

    def require(self, names: Collection[str]) -> None:
        """Judge these specs whatever the cost. A spec for which judging was stopped is judged again from the next step on."""
        self.wanted = frozenset(names)

    def plans_by_name(self, shot: Shot, scene: Path) -> list[tuple[str, SpecPlan | str]]:
        """Return the specs of a program by name. Each has its plan, or the reason why it is not judged in this session."""
        if self._plans is None or self._plans[0] is not shot:
            self._plans = shot, list(_plan_specs(shot, scene))
        return self._plans[1]

    def on_new_world(self, session: Session) -> None:
        """Do nothing: the next step detects another world by its stretch."""

    def before_step(self, session: Session) -> None:
        """Judge the frame before the step if necessary, and start timing the step."""
        self._judge_frame(session)
        self._began = perf_counter()

    def after_step(self, session: Session) -> PauseReason | None:
        """Judge the new frame, and send the statuses if they changed. Never pause."""
        took = perf_counter() - self._began
        self._judge_frame(session)
        for each in self.judged:
            self._stop_if_slow(each, took)
        message = self.message()
        if message != self._told:
            self._told = message
            self.tell(message)
        return None

    def _judge_frame(self, session: Session) -> None:
        """Judge the session's current frame if it is simulated for the first time."""
        frame, shot = session.frame, session.shot
        if frame != session.last_frame or frame < shot.frames.first:
            return
        stretch = session.timeline.at(frame)
        if stretch is not self._stretch or frame not in (self._last, self._last + 1):
            self._stretch = stretch
            self.judged = [_make_status(*each) for each in self.plans_by_name(shot, session.compiler.scene)]
            fresh = self._start_judging(session, lambda each: True)
        else:
            again = self._start_judging(session, lambda each: each.name in self.wanted)
            fresh = self.judged if frame != self._last else again
        self._last = frame
        for each in fresh:
            self._judge_spec(each, session.world)
            if each.judge is not None:
                curve = 0.0 if each.failure is not None else 1.0
                session.timeline.curves[frame].setdefault(CURVE_NAME_PREFIX + each.name, curve)

    def _start_judging(self, session: Session, which: Callable[[SpecStatus], bool]) -> list[SpecStatus]:
        """Start judging, from this frame on, the specs that `which` selects, that are not judged yet, and that can be. Return
        these specs."""
        candidates = [each for each in self.judged if each.judge is None and each.plan is not None and which(each)]
        for each in candidates:
            assert each.plan is not None
            each.judge = SpecJudge(each.plan, session.world, session.shot.frames.last)
            each.why, each.seconds, each.frames = "", 0.0, 0
        return candidates

    def _judge_spec(self, each: SpecStatus, world: World) -> None:
        if each.judge is not None and not each.judge.over:
            began = thread_time()  # of the processor: what others do on this machine is not its fault
            each.judge.look(world)
            each.frames += 1
            if each.frames > _WARM_UP_FRAMES:
                each.seconds += thread_time() - began

    def _stop_if_slow(self, each: SpecStatus, step: float) -> None:
        """Stop judging a spec that takes too long, unless it has failed or a breakpoint needs it.

        `step`: seconds of the last step."""
        if each.judge is None or each.frames < _MEASURED_FRAMES or each.name in self.wanted or each.failure is not None:
            return
        takes = each.seconds / (each.frames - _WARM_UP_FRAMES)
        if not each.judge.over and takes > max(_MAX_JUDGING_SHARE * step, _MAX_JUDGING_SECONDS):
            each.judge = None
            each.why = f"judging it takes {1000 * takes:.1f} ms a frame: with a breakpoint on it, it is judged all the same"


def _make_status(name: str, plan: SpecPlan | str) -> SpecStatus:
    return SpecStatus(name, None, plan) if isinstance(plan, str) else SpecStatus(name, plan)


def _plan_specs(shot: Shot, scene: Path) -> Iterator[tuple[str, SpecPlan | str]]:
    names: list[str] = []
    for spec in shot.program.specs:
        names.append(spec.name)
        name = spec.name if names.count(spec.name) == 1 else f"{spec.name} ({names.count(spec.name)})"
        yield name, _obstacle_text(spec, shot, scene) or _plan_spec(spec, shot)


def _plan_spec(spec: Spec, shot: Shot) -> SpecPlan | str:
    plan, report = lower_spec(spec, shot.program, shot.plan)
    return plan if plan is not None else next(each.message for each in report.errors)


def _obstacle_text(spec: Spec, shot: Shot, scene: Path) -> str:
    """Return the reason why a spec does not apply to this run, or "" if it applies."""
    if spec.scene is not None:
        try:
            place = Roots(Path(spec.span.source.path).resolve().parent, shot.scene.roots.granted).path(spec.scene.text)
        except PathRefused as why:
            return str(why)
        if realpath(place) != realpath(scene):
            return f"it is about `{spec.scene.text}`"
    if spec.against is not None:
        return "it compares with another run, as `antdsl test` does"
    if spec.changes:
        return f"it sets `{spec.changes[0].name}`, as `antdsl test` does"
    if shot.scene.model.preroll and any(each.at_end for each in spec.expectations):
        return "it uses `motion`, which includes the preroll here; `antdsl test` leaves the preroll out"
    return ""


def describe_failure(failure: Failure) -> str:
    """Return a failure in one line: the condition that did not hold, the agent, and the values."""
    agent_text = ""
    if failure.agent is not None:
        others_text = f" and {failure.others} more" if failure.others else ""
        agent_text = f", {failure.agent[0]} {failure.agent[1]}{others_text}"
    values = ", ".join(f"{text} is {value}" for text, value in failure.values)
    return f"{failure.message}{agent_text}" + (f" ({values})" if values else "")
