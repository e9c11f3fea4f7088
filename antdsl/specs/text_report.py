"""Results as text.

There is a line for each spec and seed. Failures have their location, frame, agents and values. Golden runs and coverage
follow."""

from __future__ import annotations

from collections.abc import Sequence

from antdsl.diagnostics.text_positions import escape_text
from antdsl.loading import display_path
from antdsl.specs.cases import SavedFrames, SpecCase, SpecFailure, SpecVerdict
from antdsl.specs.coverage import CoverageEntry, SpecCoverage
from antdsl.specs.golden.golden_runs import GoldenResult

_MAX_LISTED_UNCOVERED = 20  # maximum number of unreached states and transitions listed by name
_MAX_LISTED_DIFFERENCES = 6


def format_case_line(case: SpecCase) -> str:
    """Return one line about a case: `passed  "no crumb is lost", seed 3: 240 frames, 1.2 s`."""
    return f'{case.outcome:<7} "{escape_text(case.name)}", seed {case.seed}: {case.frames} frames, {case.seconds:.1f} s'


def describe_failed_case(case: SpecCase) -> str:
    """Return text about a failed case: its line, its failures with location, frame, agent and values, and the command that
    displays it."""
    lines = [format_case_line(case), *(f"  {line}" for failure in case.failures for line in describe_failure(failure))]
    return "\n".join(lines + ([] if case.saved_frames is None else [f"  {line}" for line in _describe_saved(case.saved_frames)]))


def describe_failure(failure: SpecFailure) -> list[str]:
    """Return a failure as lines of text: what was expected and where, when it failed, for which agents, and the values."""
    where = f"{failure.span}: " if failure.span is not None else ""
    lines = [f"{escape_text(where)}{escape_text(failure.message)}"]
    if failure.frame is not None:
        time_text = f"  first at frame {failure.frame}"
        time_text += f", {failure.time:.6g} s from the start" if failure.time is not None else ""
        lines.append(time_text + (f", by {_format_agent_names(failure)}" if failure.agent else ""))
    if failure.wait_start_frame is not None:
        lines.append(f"  pending since frame {failure.wait_start_frame}")
    if failure.other_count and (failure.values or failure.states_and_position):
        lines.append(f"  of {_format_agent_name(failure)}:")
    value_names = {text for text, _ in failure.values}
    other_values = [pair for pair in failure.states_and_position if pair[0] not in value_names]
    return lines + [f"    {escape_text(text)} is {escape_text(value)}" for text, value in (*failure.values, *other_values)]


def _format_agent_name(failure: SpecFailure) -> str:
    return "" if failure.agent is None else f"{failure.agent[0]} {failure.agent[1]}"


def _format_agent_names(failure: SpecFailure) -> str:
    assert failure.agent is not None
    agents = failure.agents or (failure.agent[1],)
    remainder = failure.other_count + 1 - len(agents)
    return f"{failure.agent[0]} {', '.join(map(str, agents))}" + (f" and {remainder} more" if remainder > 0 else "")


def _describe_saved(saved_frames: SavedFrames) -> list[str]:
    if saved_frames.folder is None:
        return [escape_text(saved_frames.note)]
    lines = [
        f"saved: frames {saved_frames.first_frame} to {saved_frames.frame} in {escape_text(display_path(saved_frames.folder))}"
    ]
    lines += [escape_text(saved_frames.note)] if saved_frames.note else []
    return [
        *lines,
        f"  see it:         {escape_text(saved_frames.view_command)}",
        f"  continue it:    {escape_text(saved_frames.resume_command)}",
    ]


def describe_verdict(verdict: SpecVerdict) -> str:
    """Return one line about the verdict on a spec: `"ants come home": 4 of 5 seeds passed, enough for 80 %`."""
    ends = {True: "enough for", False: "too few for", None: "not all seeds ran, of"}[verdict.has_passed]
    share = f"{verdict.spec.pass_share * 100:.6g} %"
    return f'"{escape_text(verdict.spec.name)}": {verdict.passed_count} of {verdict.case_count} seeds passed, {ends} {share}'


def describe_golden(result: GoldenResult) -> str:
    """Return the result of a golden run as text: the first difference, and the agents concerned."""
    words = {"same": "same", "differs": "differs", "written": "written"}.get(result.outcome, "waiting")
    line = f"{words:<7} {escape_text(result.name)}, seed {result.seed}: "
    if result.outcome != "differs":
        return line + (result.message or f"{result.frames} frames")
    lines = [f"{line}first at frame {result.frame}"]
    lines += [f"  {result.message}"] if result.message else []
    if result.detail_frame is not None and result.detail_frame != result.frame:
        lines.append(f"  details of frame {result.detail_frame}, the next frame stored in detail:")
    lines += [f"  {escape_text(str(each))}" for each in result.differences[:_MAX_LISTED_DIFFERENCES]]
    remainder = len(result.differences) - _MAX_LISTED_DIFFERENCES
    lines += [f"  and {remainder} more attributes"] if remainder > 0 else []
    lines += [f"  it was made with {escape_text(result.origin)}, which differs from this machine"] if result.origin else []
    return "\n".join([*lines, "  if the change is intended, store it: run the same command with --update"])


def describe_counts(cases: Sequence[SpecCase], error_count: int, goldens: Sequence[GoldenResult] = ()) -> str:
    """Return one line with the counts: `5 passed, 1 failed, 2 mistakes in files`."""
    numbers = {word: sum(case.outcome == word for case in cases) for word in ("passed", "failed", "allowed", "waiting")}
    phrases = [f"{numbers['passed']} passed"]
    phrases += [f"{numbers['failed']} failed"] if numbers["failed"] else []
    phrases += [f"{numbers['allowed']} allowed to fail"] if numbers["allowed"] else []
    phrases += [f"{numbers['waiting']} not finished"] if numbers["waiting"] else []
    differ = sum(result.outcome == "differs" for result in goldens)
    phrases += [f"{differ} golden run{'s' if differ > 1 else ''} differ{'' if differ > 1 else 's'}"] if differ else []
    phrases += [f"{error_count} error{'s' if error_count > 1 else ''} in files"] if error_count else []
    return ", ".join(phrases)


def describe_coverage(coverage: SpecCoverage) -> str:
    """Return a line for each state and transition, with its count, in the order of the program.

    The count of a state is a sum over all frames of the number of agents in it. The count of a transition is how many times
    agents took it."""
    both = [(each, "state") for each in coverage.states.values()] + [(each, "change") for each in coverage.changes.values()]
    both.sort(key=lambda pair: (pair[0].span.source.path, pair[0].span.start, pair[1] == "change"))
    wide = max((len(f"{each.count:,}") for each, _ in both), default=0)
    lines = [f"{each.count:>{wide},}  {'  ' if noun == 'change' else ''}{_shorten_name(each.name)}" for each, noun in both]
    return "\n".join(lines)


def describe_uncovered(coverage: SpecCoverage) -> str:
    """Return a text with the number of states and transitions that occurred, and the names of those that never occurred."""
    lines = []
    for noun, verb, table in (("states", "entered", coverage.states), ("changes", "made", coverage.changes)):
        if table:
            covered_count = sum(each.count > 0 for each in table.values())
            lines.append(f"{noun} {verb}: {covered_count} of {len(table)}")
    never = _find_uncovered(coverage)
    lines += [f"  {each.span}: `{_shorten_name(each.name)}` was never {verb}" for each, verb in never[:_MAX_LISTED_UNCOVERED]]
    if len(never) > _MAX_LISTED_UNCOVERED:
        lines.append(f"  and {len(never) - _MAX_LISTED_UNCOVERED} more")
    return "\n".join(lines)


def _shorten_name(name: str) -> str:
    """Return a name without parts that mean nothing to authors: the machine `main`, and the number of a first transition."""
    return name.replace(".main.", ".").removesuffix("#1").replace("->", " -> ")


def _find_uncovered(coverage: SpecCoverage) -> list[tuple[CoverageEntry, str]]:
    entries = [(each, "entered") for each in coverage.states.values() if not each.count]
    entries += [(each, "made") for each in coverage.changes.values() if not each.count]
    return sorted(entries, key=lambda pair: (pair[0].span.source.path, pair[0].span.start))
