"""States that steer and layers without a line for them: the animal would never follow its state."""

from __future__ import annotations

from antdsl.diagnostics import Report
from antdsl.program.checks.analysis.checked import CheckContext
from antdsl.program.model import Face, Steer


def check_layering(checked: CheckContext, report: Report) -> None:
    for species in checked.program.species.values():
        lines = [line for m in species.machines for state in m.states for line in state.body]
        steering = next((line for line in lines if isinstance(line, Steer | Face)), None)
        states = [layer for layer in species.layers.layers if layer.push is None]
        if steering is not None and not states:
            verb = "steers" if isinstance(steering, Steer) else "faces a way"
            message = f"`{species.name}` {verb} in its states, and `layers` has no line for that"
            report.error("state-not-in-layers", message, species.layers.span, "write `state` in a line of `layers`")
        for extra in states[1:]:
            report.error("duplicate-name", "`state` appears twice in `layers`", extra.span, "leave one of them out")
