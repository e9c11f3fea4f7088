"""Clips in behaviour: `play walk` in a state, and what a change says of how one gives way to the next."""

from __future__ import annotations

from dataclasses import replace

from antdsl.diagnostics import Label
from antdsl.program import model
from antdsl.program.declarations.amounts import Block
from antdsl.program.kinds import Kind
from antdsl.program.names.scope import NUMBER, Scope
from antdsl.program.typed import Expr
from antdsl.program.types.arguments import Slot, arranged, type_all
from antdsl.program.types.folding import constant_behind
from antdsl.program.types.operators import condition, wanted
from antdsl.syntax import nodes

_NUMBERS, _NAMES, _CONDITIONS = ("speed", "weight"), ("on", "left", "right", "up", "down"), ("again", "add")
_SLOTS = tuple(Slot(name, required=False) for name in ("speed", "weight", "on", "again", "add", "left", "right", "up", "down"))


def play(scope: Scope, line: nodes.Ask, block: Block) -> model.Play | None:
    """`play walk`, `play walk(speed: 0.5)`, `play wave(on: arms, weight: 0.8)`; None after a complaint."""
    assert line.name is not None
    clip = line.name.text
    found = arranged(scope, "play", _SLOTS, line, f"play {clip}") if line.arguments else {}
    if found is None:
        type_all(scope, _without_names(line))
        return None
    if not block.body:
        scope.report.error(
            "misplaced", f"`play {clip}` stands in an action, and a clip goes on as long as a state", line.span,
            f"write `play {clip}` as a line of the state itself",
        )  # fmt: skip
        return None
    given = {name: arguments[0].value for name, arguments in found.items()}
    said: dict[str, Expr] = {}
    for name in (each for each in (*_NUMBERS, *_CONDITIONS) if each in given):
        who = f"`{name}` of `play`"
        said[name] = wanted(scope, given[name], NUMBER, who) if name in _NUMBERS else condition(scope, given[name], who)
    names = {name: _name(scope, clip, name, given[name]) for name in _NAMES if name in given}
    if any(each.type.kind is Kind.BAD for each in said.values()) or None in names.values():
        return None
    if not all([_sensible(scope, clip, name, each) for name, each in said.items()]):
        return None
    add = constant_behind(said["add"]) if "add" in said else None
    on, left, right, up, down = (names.get(name) or "" for name in _NAMES)
    return model.Play(
        clip, on, said.get("speed"), said.get("weight"), line.span, said.get("again"), add is not None and add.number != 0,
        (left, right, up, down),
    )  # fmt: skip


def _without_names(line: nodes.Ask) -> nodes.Ask:
    """The line without the arguments that are names of the body's, which are no expressions."""
    named = [isinstance(each, nodes.Argument) and each.name is not None and each.name.text in _NAMES for each in line.arguments]
    return replace(line, arguments=tuple(each for each, of_body in zip(line.arguments, named, strict=True) if not of_body))


def _name(scope: Scope, clip: str, argument: str, node: nodes.Expr) -> str | None:
    """A name of the body's that an argument gives; None after a complaint."""
    if isinstance(node, nodes.NameRef):
        return node.name.text
    what, sample = ("a transform group", "arms") if argument == "on" else ("a clip", f"{clip}_{argument}")
    scope.report.error(
        "wrong-argument", f"`{argument}` of `play` names {what} of the body, and `{' '.join(node.span.text.split())}` is no name",
        node.span, f"write `play {clip}({argument}: {sample})`",
    )  # fmt: skip
    return None


def _sensible(scope: Scope, clip: str, argument: str, found: Expr) -> bool:
    """Whether a value can be what it is for; a complaint where a constant cannot."""
    known = constant_behind(found)
    text = " ".join(found.span.text.split())
    words, help = "", ""
    if argument == "add" and known is None:
        words, help = (
            f"`add` of `play` is one value for all agents, but `{text}` may differ",
            f"write `play {clip}(add: true)`",
        )
    elif argument == "weight" and known is not None and not 0 <= known.number <= 1:
        words, help = f"`{text}` is no share of a pose, which is from 0 to 1", f"write `play {clip}(weight: 0.5)`"
    elif argument == "speed" and known is not None and known.number < 0:
        words, help = f"a clip goes ahead only, and `{text}` is below 0", f"write `play {clip}(speed: 1.5)`"
    if words:
        scope.report.error("out-of-range" if known is not None else "wrong-argument", words, found.span, help)
    return not words


def one_clip(scope: Scope, node: nodes.State) -> None:
    """Complain about a state that plays several clips."""
    lines = [line for line in node.body if isinstance(line, nodes.Ask) and line.verb == "play"]
    for line in lines[1:]:
        scope.report.error(
            "two-writers", f"`{node.name.text}` plays a clip already, and a state plays one", line.span,
            "play it in a separate machine, `machine arms { … }`", labels=(Label(lines[0].span, "first here"),),
        )  # fmt: skip
