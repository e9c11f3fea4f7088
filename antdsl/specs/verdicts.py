"""Which specs hold: all their seeds, or the share of them that `pass` asks for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from antdsl.program.expectations import Spec
from antdsl.specs.cases import Case


@dataclass(frozen=True, slots=True)
class Verdict:
    """A spec that asks for a share of its seeds: how many of how many passed. `holds` is None while some are waiting."""

    spec: Spec
    passed: int
    cases: int
    holds: bool | None


def settle(cases: Sequence[Case]) -> list[Verdict]:
    """The verdicts, once everything has run. What failed in a spec of which enough passed is `allowed` from here on."""
    groups: dict[tuple[str, int, str], list[Case]] = {}
    for case in cases:
        if case.spec.share < 1:
            groups.setdefault((case.spec.span.source.path, case.spec.span.start, str(case.scene)), []).append(case)
    return [_settled(group) for group in groups.values()]


def _settled(group: list[Case]) -> Verdict:
    passed = sum(case.outcome == "passed" for case in group)
    if any(case.outcome == "waiting" for case in group):
        return Verdict(group[0].spec, passed, len(group), None)
    holds = passed >= group[0].spec.share * len(group) * (1 - 1e-9)
    for case in group:
        if holds and case.outcome == "failed":
            case.outcome = "allowed"
    return Verdict(group[0].spec, passed, len(group), holds)
