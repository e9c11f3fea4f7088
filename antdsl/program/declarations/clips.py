"""Clips in behaviour: `play walk` in a state, and what a change says of how one gives way to the next."""

from __future__ import annotations

from antdsl.diagnostics import Label
from antdsl.program import model
from antdsl.program.declarations.amounts import Block
from antdsl.program.kinds import Kind
from antdsl.program.names.scope import NUMBER, Scope
from antdsl.program.types.arguments import Slot, arranged, type_all
from antdsl.program.types.operators import condition, wanted
from antdsl.syntax import nodes

_SLOTS = (
    Slot("speed", required=False),
    Slot("weight", required=False),
    Slot("on", required=False),
    Slot("again", required=False),
)


def play(scope: Scope, line: nodes.Ask, block: Block) -> model.Play | None:
    """`play walk`, `play walk(speed: 0.5)`, `play wave(on: arms, weight: 0.8)`; None after a complaint."""
    assert line.name is not None
    clip = line.name.text
    found = arranged(scope, "play", _SLOTS, line, f"play {clip}") if line.arguments else {}
    if found is None:
        type_all(scope, line)
        return None
    if not block.body:
        scope.report.error(
            "misplaced", f"`play {clip}` stands in an action, and a clip goes on as long as a state", line.span,
            f"write `play {clip}` as a line of the state itself",
        )  # fmt: skip
        return None
    given = {name: arguments[0].value for name, arguments in found.items()}
    numbers = {
        name: wanted(scope, given[name], NUMBER, f"`{name}` of `play`") if name in given else None for name in ("speed", "weight")
    }
    if any(each is not None and each.type.kind is Kind.BAD for each in numbers.values()):
        return None
    on = given.get("on")
    if on is not None and not isinstance(on, nodes.NameRef):
        text = " ".join(on.span.text.split())
        scope.report.error(
            "wrong-argument", f"`on` of `play` names a transform group of the body, and `{text}` is no name", on.span,
            f"write `play {clip}(on: arms)`",
        )  # fmt: skip
        return None
    again = condition(scope, given["again"], "`again` of `play`") if "again" in given else None
    if again is not None and again.type.kind is Kind.BAD:
        return None
    group = on.name.text if isinstance(on, nodes.NameRef) else ""
    return model.Play(clip, group, numbers["speed"], numbers["weight"], line.span, again)


def one_clip(scope: Scope, node: nodes.State) -> None:
    """Complain about a state that plays several clips."""
    lines = [line for line in node.body if isinstance(line, nodes.Ask) and line.verb == "play"]
    for line in lines[1:]:
        scope.report.error(
            "two-writers", f"`{node.name.text}` plays a clip already, and a state plays one", line.span,
            "play it in a machine of its own, `machine arms { … }`", labels=(Label(lines[0].span, "first here"),),
        )  # fmt: skip
