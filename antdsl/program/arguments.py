"""Which argument is which: the arguments of a call as written are put in the order of what is called, by place or by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from antdsl.diagnostics import Fix, Label
from antdsl.diagnostics.suggestion import nearest_name
from antdsl.program.scope import Scope, listed
from antdsl.source import Span
from antdsl.syntax import nodes


@dataclass(frozen=True, slots=True)
class Slot:
    """One argument of what is called. `required` ones have no default and are not optional."""

    name: str
    required: bool
    variadic: bool = False


def arranged(scope: Scope, called: str, slots: Sequence[Slot], node: nodes.Call) -> dict[str, list[nodes.Argument]] | None:
    """The arguments by the slot they belong to; None after a complaint that leaves the call without sense."""
    found: dict[str, list[nodes.Argument]] = {}
    names, position, sound = [slot.name for slot in slots], 0, True
    for argument in node.arguments:
        if isinstance(argument, nodes.Comprehension):
            scope.report.error(
                "wrong-argument",
                f"`{called}` takes no `… in …: …`",
                argument.span,
                "that is for `sum mean min max count any every best`",
            )
            return None
        if argument.name is not None:
            sound = _named(scope, called, names, found, argument) and sound
            continue
        while position < len(slots) and slots[position].name in found and not slots[position].variadic:
            position += 1
        if position >= len(slots):
            scope.report.error(
                "wrong-arity", f"`{called}` takes {_how_many(slots)}", argument.span, f"write `{_shape(called, slots)}`"
            )
            return None
        found.setdefault(slots[position].name, []).append(argument)
        position += 0 if slots[position].variadic else 1
    missing = [slot.name for slot in slots if slot.required and slot.name not in found]
    if missing and sound:
        scope.report.error(
            "missing-argument", f"`{called}` wants {listed(missing)}", node.span, f"write `{_shape(called, slots)}`"
        )
    return None if missing or not sound else found


def _named(scope: Scope, called: str, names: list[str], found: dict[str, list[nodes.Argument]], argument: nodes.Argument) -> bool:
    name = argument.name
    assert name is not None
    if name.text not in names:
        near = nearest_name(name.text, names)
        advice = f"did you mean `{near}`?" if near else f"it takes {listed(names)}" if names else "it takes none"
        span = Span(name.span.source, name.span.start, name.span.start + len(name.text))
        scope.report.error(
            "unknown-argument",
            f"`{called}` has no argument `{name.text}`",
            name.span,
            advice,
            fix=Fix(span, near) if near else None,
        )
        return False
    if name.text in found:
        first = found[name.text][0].span
        scope.report.error(
            "duplicate-argument",
            f"`{name.text}` is given twice",
            argument.span,
            "leave one of them out",
            labels=(Label(first, "first here"),),
        )
        return False
    found[name.text] = [argument]
    return True


def _how_many(slots: Sequence[Slot]) -> str:
    most = len(slots)
    return "no arguments" if most == 0 else "one argument" if most == 1 else f"at most {most} arguments"


def _shape(called: str, slots: Sequence[Slot]) -> str:
    return f"{called}({', '.join(slot.name if slot.required else slot.name + ': …' for slot in slots)})"


def type_all(scope: Scope, node: nodes.Call) -> None:
    """Look at the arguments of a call that makes no sense, so that what they use counts as used and their own slips are told."""
    for argument in node.arguments:
        if isinstance(argument, nodes.Comprehension):
            scope.typed(argument.over)
        elif isinstance(argument.value, nodes.RangeExpr):
            scope.typed(argument.value.low)
            scope.typed(argument.value.high)
        else:
            scope.typed(argument.value)
