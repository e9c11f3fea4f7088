"""What a state shows of its agents beside a clip: a layer that they wear, a channel of the body, what their head looks at."""

from __future__ import annotations

from antdsl.diagnostics import Label
from antdsl.program import model
from antdsl.program.declarations.amounts import Block
from antdsl.program.kinds import Dim, Kind, Type
from antdsl.program.names.scope import NUMBER, TIME, Scope
from antdsl.program.types.arguments import Slot, arranged, type_all
from antdsl.program.types.folding import constant_behind
from antdsl.program.types.operators import condition, wanted
from antdsl.program.types.places import place
from antdsl.syntax import nodes

_SLOTS = (Slot("at", required=True), Slot("within", required=False), Slot("over", required=False))
_ANGLE = Type(Kind.NUMBER, Dim(angle=1))
_WIDEST = 3.1415927  # rad


def wear(scope: Scope, line: nodes.Ask, block: Block) -> model.Wear | None:
    """`wear helmet`, `wear load when load > 0`; None after a complaint."""
    assert line.name is not None
    when = None if line.when is None else condition(scope, line.when, "`when`")
    if _misplaced(scope, line, block) or (when is not None and when.type.kind is Kind.BAD):
        return None
    return model.Wear(line.name.text, when, line.span)


def channel(scope: Scope, line: nodes.Ask, block: Block) -> model.Channel | None:
    """`channel jaw = load`; None after a complaint."""
    assert line.name is not None and line.amount is not None
    value = wanted(scope, line.amount, NUMBER, f"`channel {line.name.text}`")
    if _misplaced(scope, line, block) or value.type.kind is Kind.BAD:
        return None
    return model.Channel(line.name.text, value, line.span)


def look(scope: Scope, line: nodes.Ask, block: Block) -> model.Look | None:
    """`look head(at: meal, within: 60 deg, over: 0.2 s)`; None after a complaint."""
    assert line.name is not None
    found = arranged(scope, "look", _SLOTS, line, f"look {line.name.text}")
    if found is None:
        type_all(scope, line)
        return None
    given = {name: arguments[0].value for name, arguments in found.items()}
    at = place(scope, given["at"], "`at` of `look`")
    within = wanted(scope, given["within"], _ANGLE, "`within` of `look`") if "within" in given else None
    over = wanted(scope, given["over"], TIME, "`over` of `look`") if "over" in given else None
    said = [each for each in (at, within, over) if each is not None]
    if _misplaced(scope, line, block) or any(each.type.kind is Kind.BAD for each in said):
        return None
    widest = None if within is None else constant_behind(within)
    if within is not None and widest is not None and not 0 < widest.number <= _WIDEST:
        scope.report.error(
            "out-of-range", f"`{' '.join(within.span.text.split())}` is no angle that a body turns its {line.name.text} by",
            within.span, "write an angle above `0 deg`, `180 deg` at most",
        )  # fmt: skip
        return None
    return model.Look(line.name.text, at, within, over, line.span)


def said_once(scope: Scope, node: nodes.State) -> None:
    """Complain about a state that gives a channel two values, or turns one transform group to two places."""
    first: dict[tuple[str, str], nodes.Ask] = {}
    for line in node.body:
        if not isinstance(line, nodes.Ask) or line.verb not in ("channel", "look") or line.name is None:
            continue
        before = first.setdefault((line.verb, line.name.text), line)
        if before is not line:
            does = "sets channel" if line.verb == "channel" else "turns"
            words = f"`{node.name.text}` {does} `{line.name.text}` already, and only the second would count"
            scope.report.error(
                "two-writers", words, line.span,
                "keep one of them; choose with `if … then … else …`", labels=(Label(before.span, "first here"),),
            )  # fmt: skip


def _misplaced(scope: Scope, line: nodes.Ask, block: Block) -> bool:
    """Whether a line stands in an action, after a complaint."""
    if not block.body:
        form = f"{line.verb} {line.name.text if line.name is not None else ''}"
        scope.report.error(
            "misplaced", f"`{form}` stands in an action, and is shown as long as a state lasts", line.span,
            f"write `{' '.join(line.span.text.split())}` as a line of the state itself",
        )  # fmt: skip
    return not block.body
