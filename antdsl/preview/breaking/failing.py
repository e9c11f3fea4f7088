"""A breakpoint on a failing spec of the scene: it held in the previous frame and fails in this one."""

from __future__ import annotations

from antdsl.diagnostics.suggestion import nearest_name
from antdsl.preview.breaking.model import BreakpointError
from antdsl.preview.observing.observer import Stop
from antdsl.preview.observing.spec_judgement import CURVE, Specs
from antdsl.preview.requests import SpecBreak
from antdsl.preview.session import Session


class SpecWatcher:
    def __init__(self, session: Session, ask: SpecBreak, specs: Specs) -> None:
        known = dict(specs.plans_by_name(session.shot, session.compiler.scene))
        if ask.spec not in known:
            near = nearest_name(ask.spec, known)
            help = f"did you mean `{near}`?" if near else ", ".join(f"`{each}`" for each in known) or "the program has no spec"
            raise BreakpointError(f"there is no spec `{ask.spec}`", help)
        plan = known[ask.spec]
        if isinstance(plan, str):
            raise BreakpointError(f"`{ask.spec}` is not judged here: {plan}", f'`antdsl test` judges it: `--spec "{ask.spec}"`')
        self.ask, self.specs = ask, specs

    def begin(self, session: Session) -> None:
        """The curve says how it was."""

    def check_frame(self, session: Session) -> Stop | None:
        frame, curves, key = session.frame, session.timeline.curves, CURVE + self.ask.spec
        if curves.get(frame, {}).get(key) != 0.0 or curves.get(frame - 1, {}).get(key) == 0.0:
            return None
        judged = next((each.as_json() for each in self.specs.judged if each.name == self.ask.spec), None)
        if judged is None or judged["frame"] != frame:  # it was judged before an edit, and is gone through again
            return Stop(f"`{self.ask.spec}` fails at frame {frame}")
        return Stop(f"`{self.ask.spec}` fails at frame {frame}: {judged['message']}", judged["species"], tuple(judged["agents"]))
