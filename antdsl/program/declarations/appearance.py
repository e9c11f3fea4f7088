"""Checks the lines of a state that change the appearance of its agents.

These lines play a clip (`play walk`), wear a layer, set a channel of the body, or turn a group of joints towards a point. A
transition may also set the fade-out time of the previous clip."""

from __future__ import annotations

from dataclasses import replace

from antdsl.diagnostics import Label
from antdsl.program import model
from antdsl.program.declarations.amounts import StatementContext
from antdsl.program.kinds import NUMBER_TYPE, TIME_TYPE, Dimension, TypeKind, ValueType
from antdsl.program.names.scope import NameScope
from antdsl.program.typed import Expr
from antdsl.program.types.arguments import ArgumentSlot, arrange_arguments, type_arguments, type_point
from antdsl.program.types.folding import find_constant
from antdsl.program.types.operators import type_condition, type_value_as
from antdsl.syntax import nodes

_NUMBER_ARGUMENTS, _NAME_ARGUMENTS, _CONDITION_ARGUMENTS = (
    ("speed", "weight"),
    ("on", "left", "right", "up", "down"),
    ("again", "add"),
)
_CLIP_SLOTS = tuple(
    ArgumentSlot(name, is_required=False) for name in ("speed", "weight", "on", "again", "add", "left", "right", "up", "down")
)
_LOOK_SLOTS = (
    ArgumentSlot("at", is_required=True),
    ArgumentSlot("within", is_required=False),
    ArgumentSlot("over", is_required=False),
)
_ANGLE_TYPE = ValueType(TypeKind.NUMBER, Dimension(angle=1))
_MAX_ANGLE = 3.1415927  # rad


def check_wear(scope: NameScope, line: nodes.VerbLine, block: StatementContext) -> model.Wear | None:
    """Check a line such as `wear helmet` or `wear load when load > 0`. Return None after an error."""
    assert line.name is not None
    when = None if line.when is None else type_condition(scope, line.when, "`when`")
    if _report_misplaced_line(scope, line, block) or (when is not None and when.type.kind is TypeKind.BAD):
        return None
    return model.Wear(line.name.text, when, line.span)


def check_channel(scope: NameScope, line: nodes.VerbLine, block: StatementContext) -> model.Channel | None:
    """Check a line such as `channel jaw = load`. Return None after an error."""
    assert line.name is not None and line.amount is not None
    value = type_value_as(scope, line.amount, NUMBER_TYPE, f"`channel {line.name.text}`")
    if _report_misplaced_line(scope, line, block) or value.type.kind is TypeKind.BAD:
        return None
    return model.Channel(line.name.text, value, line.span)


def check_look(scope: NameScope, line: nodes.VerbLine, block: StatementContext) -> model.Look | None:
    """Check a line such as `look head(at: meal, within: 60 deg, over: 0.2 s)`. Return None after an error."""
    assert line.name is not None
    arguments_by_slot = arrange_arguments(scope, "look", _LOOK_SLOTS, line, f"look {line.name.text}")
    if arguments_by_slot is None:
        type_arguments(scope, line)
        return None
    argument_nodes = {name: arguments[0].value for name, arguments in arguments_by_slot.items()}
    at = type_point(scope, argument_nodes["at"], "`at` of `look`")
    within = (
        type_value_as(scope, argument_nodes["within"], _ANGLE_TYPE, "`within` of `look`") if "within" in argument_nodes else None
    )
    over = type_value_as(scope, argument_nodes["over"], TIME_TYPE, "`over` of `look`") if "over" in argument_nodes else None
    said = [each for each in (at, within, over) if each is not None]
    if _report_misplaced_line(scope, line, block) or any(each.type.kind is TypeKind.BAD for each in said):
        return None
    widest = None if within is None else find_constant(within)
    if within is not None and widest is not None and not 0 < widest.number <= _MAX_ANGLE:
        message = f"`{' '.join(within.span.text.split())}` is not an angle by which a body can turn its {line.name.text}"
        scope.report.error("out-of-range", message, within.span, "write an angle above `0 deg`, `180 deg` at most")
        return None
    return model.Look(line.name.text, at, within, over, line.span)


def check_duplicates(scope: NameScope, node: nodes.State) -> None:
    """Report a state that sets one channel twice, or turns one transform group towards two points."""
    first: dict[tuple[str, str], nodes.VerbLine] = {}
    for line in node.body:
        if not isinstance(line, nodes.VerbLine) or line.verb not in ("channel", "look") or line.name is None:
            continue
        first_line = first.setdefault((line.verb, line.name.text), line)
        if first_line is not line:
            does = "sets channel" if line.verb == "channel" else "turns"
            words = f"`{node.name.text}` {does} `{line.name.text}` already; only the second would apply"
            advice = "keep one of them; choose with `if … then … else …`"
            scope.report.error("two-writers", words, line.span, advice, labels=(Label(first_line.span, "first here"),))


def _report_misplaced_line(scope: NameScope, line: nodes.VerbLine, block: StatementContext) -> bool:
    """Return whether a line is at the wrong place: in an action, although it is only allowed in a state's body. If so, report an
    error."""
    if not block.is_state_body:
        form = f"{line.verb} {line.name.text if line.name is not None else ''}"
        advice = f"write `{' '.join(line.span.text.split())}` as a line of the state itself"
        scope.report.error("misplaced", f"`{form}` is in an action, but it applies as long as a state lasts", line.span, advice)
    return not block.is_state_body


def check_play(scope: NameScope, line: nodes.VerbLine, block: StatementContext) -> model.Play | None:
    """Check a line such as `play walk`, `play walk(speed: 0.5)` or `play wave(on: arms, weight: 0.8)`. Return None after an
    error."""
    assert line.name is not None
    clip = line.name.text
    arguments_by_slot = arrange_arguments(scope, "play", _CLIP_SLOTS, line, f"play {clip}") if line.arguments else {}
    if arguments_by_slot is None:
        type_arguments(scope, _remove_bare_name_arguments(line))
        return None
    if not block.is_state_body:
        message = f"`play {clip}` is in an action, but a clip plays as long as a state lasts"
        scope.report.error("misplaced", message, line.span, f"write `play {clip}` as a line of the state itself")
        return None
    argument_nodes = {name: arguments[0].value for name, arguments in arguments_by_slot.items()}
    said: dict[str, Expr] = {}
    for name in (each for each in (*_NUMBER_ARGUMENTS, *_CONDITION_ARGUMENTS) if each in argument_nodes):
        who = f"`{name}` of `play`"
        node = argument_nodes[name]
        said[name] = (
            type_value_as(scope, node, NUMBER_TYPE, who) if name in _NUMBER_ARGUMENTS else type_condition(scope, node, who)
        )
    names = {
        name: _get_name_argument(scope, clip, name, argument_nodes[name]) for name in _NAME_ARGUMENTS if name in argument_nodes
    }
    if any(each.type.kind is TypeKind.BAD for each in said.values()) or None in names.values():
        return None
    if not all([_is_valid_value(scope, clip, name, each) for name, each in said.items()]):
        return None
    add = find_constant(said["add"]) if "add" in said else None
    on, left, right, up, down = (names.get(name) or "" for name in _NAME_ARGUMENTS)
    return model.Play(
        clip, on, said.get("speed"), said.get("weight"), line.span, said.get("again"), add is not None and add.number != 0,
        (left, right, up, down),
    )  # fmt: skip


def _remove_bare_name_arguments(line: nodes.VerbLine) -> nodes.VerbLine:
    """Return the line without the arguments that name clips or transform groups, because such names are not expressions."""
    named = [
        isinstance(each, nodes.Argument) and each.name is not None and each.name.text in _NAME_ARGUMENTS
        for each in line.arguments
    ]
    return replace(line, arguments=tuple(each for each, of_body in zip(line.arguments, named, strict=True) if not of_body))


def _get_name_argument(scope: NameScope, clip: str, argument: str, node: nodes.Expr) -> str | None:
    """Return the name of a clip or transform group in an argument, or None after an error."""
    if isinstance(node, nodes.NameRef):
        return node.name.text
    what, sample = ("a transform group", "arms") if argument == "on" else ("a clip", f"{clip}_{argument}")
    message = f"`{argument}` of `play` names {what} of the body, but `{' '.join(node.span.text.split())}` is not a name"
    scope.report.error("wrong-argument", message, node.span, f"write `play {clip}({argument}: {sample})`")
    return None


def _is_valid_value(scope: NameScope, clip: str, argument: str, expr: Expr) -> bool:
    """Return whether a value is allowed for its argument. If not, report an error."""
    known = find_constant(expr)
    text = " ".join(expr.span.text.split())
    words, help = "", ""
    if argument == "add" and known is None:
        words, help = (
            f"`add` of `play` has one value for all agents, but `{text}` may differ",
            f"write `play {clip}(add: true)`",
        )
    elif argument == "weight" and known is not None and not 0 <= known.number <= 1:
        words, help = f"`{text}` is not a share of a pose; a share is from 0 to 1", f"write `play {clip}(weight: 0.5)`"
    elif argument == "speed" and known is not None and known.number < 0:
        words, help = f"a clip can play forwards only, but `{text}` is below 0", f"write `play {clip}(speed: 1.5)`"
    if words:
        scope.report.error("out-of-range" if known is not None else "wrong-argument", words, expr.span, help)
    return not words


def check_single_clip(scope: NameScope, node: nodes.State) -> None:
    """Report a state with more than one line that plays a clip."""
    lines = [line for line in node.body if isinstance(line, nodes.VerbLine) and line.verb == "play"]
    for line in lines[1:]:
        message = f"`{node.name.text}` plays a clip already, and a state can play only one"
        advice = "play it in a separate machine, `machine arms { … }`"
        scope.report.error("two-writers", message, line.span, advice, labels=(Label(lines[0].span, "first here"),))
