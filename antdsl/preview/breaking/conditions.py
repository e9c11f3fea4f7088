"""Breakpoints for a condition that becomes true. The condition is in the language of specs.

It is about the complete world, or about each agent of a species (`each SPECIES: …`)."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from antdsl.diagnostics import Report
from antdsl.pipeline import Shot
from antdsl.plan.lowering.spec_blocks import SpecPlan, lower_spec
from antdsl.preview.breaking.model import BreakpointError
from antdsl.preview.breaking.watchers import MAX_SELECTED_AGENTS, format_agents
from antdsl.preview.observing.observer import PauseReason
from antdsl.preview.requests import ConditionBreak
from antdsl.preview.session import Session
from antdsl.runtime import World
from antdsl.source import Source
from antdsl.specs.queries import SpecEvaluator
from antdsl.specs.value_text import format_value
from antdsl.syntax import nodes, parse

_EACH_PATTERN = re.compile(r"\s*each\s+([A-Za-z_]\w*)\s*:(.*)", re.DOTALL)
_SOURCE_NAME = "<breakpoint>"
_ONE_CONDITION_HELP = "write one condition, such as `count(state == carry) > 10`"


class ConditionWatcher:
    """A breakpoint that is hit when its condition holds but did not hold at the previous frame.

    A condition about each agent is evaluated per agent, and the hit names the agents."""

    def __init__(self, session: Session, request: ConditionBreak) -> None:
        self.text = " ".join(request.text.split())
        self.plan = compile_condition(session.shot, request.text)
        [self.line] = self.plan.judgements
        self.evaluator: SpecEvaluator | None = None
        # ids for which the condition held; a single 0 for a condition about the complete world
        self.previous_ids: NDArray[np.int64] = np.zeros(0, np.int64)

    def begin(self, session: Session) -> None:
        self.evaluator = SpecEvaluator(self.plan, session.world)
        self.previous_ids = self._find_matching_ids(self.evaluator, session.world)

    def check_frame(self, session: Session) -> PauseReason | None:
        if self.evaluator is None:
            self.begin(session)
            return None
        previous, self.previous_ids = self.previous_ids, self._find_matching_ids(self.evaluator, session.world)
        new = np.setdiff1d(self.previous_ids, previous)
        if not len(new):
            return None
        if self.line.species is None:
            return PauseReason(
                f"{self.text}: true at frame {session.frame}{self._describe_values(self.evaluator, session.world)}"
            )
        ids = tuple(int(each) for each in new)
        text = self.text.partition(":")[2].strip()
        return PauseReason(
            f"{format_agents(self.line.species, ids[:MAX_SELECTED_AGENTS])}: {text} at frame {session.frame}",
            self.line.species,
            ids[:MAX_SELECTED_AGENTS],
        )

    def _find_matching_ids(self, evaluator: SpecEvaluator, world: World) -> NDArray[np.int64]:
        judged_world = evaluator.evaluate_frame(world, {})
        if self.line.species is None:
            assert not isinstance(self.line.condition, str)
            return np.zeros(int(bool(evaluator.evaluate_node(world, self.line.condition))), np.int64)
        judged = judged_world.populations[self.line.species]
        assert isinstance(self.line.condition, str)
        return judged.ids[judged.now[self.line.condition].astype(np.bool_)]

    def _describe_values(self, evaluator: SpecEvaluator, world: World) -> str:
        readings = []
        for reading in self.line.readings:
            if reading.node is not None:
                value = format_value(world, evaluator.evaluate_node(world, reading.node), reading.type, reading.unit)
                readings.append(f"{' '.join(reading.span.text.split())} is {value}")
        return f" ({', '.join(dict.fromkeys(readings))})" if readings else ""


def compile_condition(shot: Shot, text: str) -> SpecPlan:
    """Return the plan that evaluates a condition, as if it were the only line of a spec. Raises BreakpointError with the first
    error in the text."""
    from antdsl.program import check

    file, report = parse(Source(_SOURCE_NAME, _make_spec_text(text)))
    _raise_first_error(report)
    if not _is_one_line(file):
        raise BreakpointError(f"`{' '.join(text.split())[:80]}` is not one condition", _ONE_CONDITION_HELP)
    loaded = shot.loaded
    program, report = check([*loaded.files, file], loaded.find_library, loaded.module_by_path)
    words = f"write `each {next(iter(shot.plan.species))}: {' '.join(text.split())}` to test every agent, or use a `count` of all"
    _raise_first_error(report, "" if _EACH_PATTERN.fullmatch(text) else words)
    plan, report = lower_spec(program.specs[-1], program, shot.plan)
    _raise_first_error(report)
    if plan is None or len(plan.judgements) != 1:
        raise BreakpointError(f"`{' '.join(text.split())[:80]}` is not one condition", _ONE_CONDITION_HELP)
    return plan


def _make_spec_text(text: str) -> str:
    each = _EACH_PATTERN.fullmatch(text)
    if each is None:
        return f'spec "breakpoint" {{\n  never: {text}\n}}\n'
    return f'spec "breakpoint" {{\n  each {each[1]} {{\n    never: {each[2]}\n  }}\n}}\n'


def _is_one_line(file: nodes.File) -> bool:
    """Return whether the text consists of a single condition."""
    if len(file.items) != 1 or not isinstance(file.items[0], nodes.Spec):
        return False
    [*lines] = file.items[0].lines
    if len(lines) == 1 and lines[0].kind == "each":
        [*lines] = lines[0].lines
    return len(lines) == 1 and lines[0].kind == "never" and lines[0].held is None


def _raise_first_error(report: Report, suggestion: str = "") -> None:
    """Raise BreakpointError with the first error in the text of the condition.

    The error for a file that contains only a spec is ignored.
    `suggestion`: a correction for a condition about the complete world that only applies to an agent."""
    for error in report.sort_by_place():
        if error.severity == "error" and error.code != "empty-program":
            help = (error.help or "").replace("never: ", "")
            if suggestion and error.code in ("wrong-rate", "unknown-name") and not help.startswith("did you mean"):
                help = suggestion
            raise BreakpointError(error.message, help)
