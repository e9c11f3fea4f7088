"""Events that no agent notices, and handlers of events that no agent raises."""

from __future__ import annotations

from antdsl.diagnostics import Report
from antdsl.diagnostics.suggestion import nearest_name
from antdsl.program.checks.analysis.checked import CheckContext
from antdsl.program.tables.effects import feeding_effects
from antdsl.source import Span


def check_events(checked: CheckContext, report: Report) -> None:
    declared = checked.declared
    if any(species.node is None for species in declared.species.values()):
        return  # a species of another file may raise or notice what this one does not
    for event, span in declared.events.items():
        _report_unheard(checked, event, span, report)
        raised = any(checked.is_used(op, event) for op in feeding_effects("event"))
        noticed = checked.is_used("on", event) or checked.is_used("event", event)
        others = [name for name in declared.events if name != event]
        near = nearest_name(event, others)
        if raised and not noticed:
            advice = f"did you mean `{near}`?" if near else f"write `on {event} {{ … }}`, or ask for it: `when {event} -> …`"
            report.warning("unheard-event", f"no agent notices the event `{event}`", span, advice)
        elif noticed and not raised:
            advice = f"did you mean `{near}`?" if near else f"write `emit {event}(within: 20 mm)` where it happens"
            report.warning("silent-event", f"no agent raises the event `{event}`", span, advice)


def _report_unheard(checked: CheckContext, event: str, span: Span, report: Report) -> None:
    """Report species of which agents receive an event that they do not notice."""
    for name in checked.declared.species:
        if checked.is_used("told", f"{event} {name}") and not checked.is_used("heard", f"{event} {name}"):
            advice = f"write `on {event} {{ … }}` in `species {name}`, or test for it there: `when {event} -> …`"
            report.warning("unheard-event", f"a `{name}` receives the event `{event}`, but does not handle it", span, advice)
