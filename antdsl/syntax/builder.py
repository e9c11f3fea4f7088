"""Builds the tree: one method for each rule of the grammar, called by the parser from the leaves up.

The parser sees a line with empty braces. Their content has been parsed before and is looked up by the brace's offset."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, overload

from antdsl.source import Span
from antdsl.syntax import nodes as n
from antdsl.syntax.words import QUANTITY_PATTERN


class Token(Protocol):
    """The attributes of a parser's token that the builder uses. `start_pos` and `end_pos` are offsets in the parsed text."""

    type: str
    value: str
    start_pos: int
    end_pos: int


class SpanMaker(Protocol):
    """The location of the parsed text in the source."""

    def span(self, start: int, end: int) -> Span: ...


@dataclass(frozen=True, slots=True)
class BracedBody:
    """The lines between two braces."""

    lines: tuple[Any, ...]
    span: Span


@dataclass(frozen=True, slots=True)
class FileHeader:
    edition: n.Number
    span: Span


@dataclass(frozen=True, slots=True)
class ResultLine:
    """The last line of a behaviour."""

    value: n.Expr
    span: Span


@dataclass(frozen=True, slots=True)
class ActionBlock:
    """`enter { … }` or `exit { … }` in a state."""

    word: str
    actions: tuple[n.Action, ...]
    span: Span


class Builder:
    """Stores the location of the line being parsed (`place`) and the bodies inside it (`bodies`, by the offset of the `{`)."""

    def __init__(self) -> None:
        self.place: SpanMaker
        self.bodies: dict[int, tuple[Any, ...]] = {}

    # --- places and leaves ---

    def at(self, part: Any) -> Span:
        """Return the span of a token, or of a node that is already built."""
        span: Span = self.place.span(part.start_pos, part.end_pos) if hasattr(part, "start_pos") else part.span
        return span

    def over(self, parts: Sequence[Any]) -> Span:
        """Return the span from the first to the last part that exists."""
        present_parts = [part for part in parts if part is not None]
        return self.at(present_parts[0]).to(self.at(present_parts[-1]))

    @overload
    def word(self, token: None) -> None: ...
    @overload
    def word(self, token: Token) -> n.Name: ...
    def word(self, token: Token | None) -> n.Name | None:
        return None if token is None else n.Name(str(token.value), self.at(token))

    @overload
    def text(self, token: None) -> None: ...
    @overload
    def text(self, token: Token) -> n.Text: ...
    def text(self, token: Token | None) -> n.Text | None:
        return None if token is None else n.Text(token.value[1:-1], self.at(token))

    def body(self, parts: list[Any]) -> BracedBody:
        lines = tuple(parts[1:-1]) or self.bodies.get(self.at(parts[0]).start, ())
        return BracedBody(lines, self.over(parts))

    def names(self, parts: list[Any]) -> tuple[n.Name, ...]:
        return tuple(n.Name(str(token.value), self.at(token)) for token in parts)

    # --- the top of a file ---

    def header(self, parts: list[Any]) -> FileHeader:
        return FileHeader(self.number([parts[1]]), self.over(parts))

    def use_library(self, parts: list[Any]) -> n.Use:
        return n.Use(self.word(parts[1]), None, None, self.over(parts))

    def use_file(self, parts: list[Any]) -> n.Use:
        return n.Use(None, self.text(parts[1]), self.word(parts[3]), self.over(parts))

    def world(self, parts: list[Any]) -> n.World:
        return n.World(parts[1].lines, self.over(parts))

    def world_item(self, parts: list[Any]) -> n.WorldItem:
        kind, name, body, help = parts
        attributes = body.lines if body else ()
        return n.WorldItem(self.word(kind), self.word(name), attributes, self.text(help), self.over(parts))

    def field(self, parts: list[Any]) -> n.FieldDecl:
        _, name, _, surfaces, help, body = parts
        return n.FieldDecl(self.word(name), surfaces, body.lines, self.over([parts[0], body]), self.text(help))

    def setting(self, parts: list[Any]) -> n.Setting:
        return n.Setting(self.word(parts[0]), parts[1], self.over(parts))

    def species(self, parts: list[Any]) -> n.Species:
        _, name, help, body = parts
        return n.Species(self.word(name), body.lines, self.text(help), self.over(parts))

    def behaviour(self, parts: list[Any]) -> n.Behaviour:
        _, name, _, arguments, _, _, returns, body = parts
        span = self.over(parts)
        helps = [line for line in body.lines if isinstance(line, n.Text)]
        results = [line.value for line in body.lines if isinstance(line, ResultLine)]
        lines = tuple(line for line in body.lines if isinstance(line, (n.Keep, n.Let)))
        result = results[0] if len(results) == 1 else n.BadExpr(Span(span.source, max(span.start, span.end - 1), span.end))
        return n.Behaviour(self.word(name), arguments or (), returns, helps[0] if helps else None, lines, result, span)

    def behaviour_arguments(self, parts: list[Any]) -> tuple[n.BehaviourArgument, ...]:
        return tuple(parts)

    def behaviour_argument(self, parts: list[Any]) -> n.BehaviourArgument:
        return n.BehaviourArgument(self.word(parts[0]), parts[1], parts[3], self.over(parts))

    def spec(self, parts: list[Any]) -> n.Spec:
        _, name, _, scene, body = parts
        return n.Spec(self.text(name), self.text(scene), body.lines, self.over(parts))

    # --- a declared value ---

    def declaration(self, parts: list[Any]) -> n.Declaration:
        name, type, _, value, range, relax, each, help = parts
        return n.Declaration(self.word(name), type, value, range, relax, each, self.text(help), self.over(parts))

    def relax(self, parts: list[Any]) -> n.Relax:
        return n.Relax(parts[1], parts[2], self.over(parts))

    def for_each(self, parts: list[Any]) -> n.ForEach:
        return n.ForEach(self.word(parts[2]), parts[3], self.over(parts))

    def type(self, parts: list[Any]) -> n.TypeName:
        return n.TypeName(self.word(parts[0]), self.word(parts[1]), self.over(parts))

    def range(self, parts: list[Any]) -> n.RangeExpr:
        return n.RangeExpr(parts[0], parts[1], self.over(parts))

    # --- members of a species ---

    def param(self, parts: list[Any]) -> n.ParamDecl:
        return n.ParamDecl(parts[1], self.over(parts))

    def given(self, parts: list[Any]) -> n.AnimalProperty:
        return n.AnimalProperty(self.word(parts[0]), parts[1], self.text(parts[2]), self.over(parts))

    def let(self, parts: list[Any]) -> n.Let:
        return n.Let(self.word(parts[1]), parts[3], self.text(parts[4]), self.over(parts))

    def latch(self, parts: list[Any]) -> n.Latch:
        _, name, _, on, _, until, help = parts
        return n.Latch(self.word(name), on, until, self.over(parts), self.text(help))

    def fuzzy(self, parts: list[Any]) -> n.Fuzzy:
        _, name, help, body = parts
        return n.Fuzzy(self.word(name), body.lines, self.over(parts), self.text(help))

    def rule(self, parts: list[Any]) -> n.Rule:
        return n.Rule(parts[0], parts[2], self.over(parts))

    def start(self, parts: list[Any]) -> n.Start:
        return n.Start(self.word(parts[1]), self.over(parts))

    def on(self, parts: list[Any]) -> n.On:
        _, event, _, variable, species, _, body = parts
        return n.On(self.word(event), self.word(variable), self.word(species), body.lines, self.over(parts))

    def layers(self, parts: list[Any]) -> n.Layers:
        return n.Layers(self.word(parts[1]), parts[2].lines, self.over(parts))

    def layer(self, parts: list[Any]) -> n.Layer:
        face, push, _, condition = parts
        return n.Layer(push, condition, self.over(parts), face is not None)

    def machine(self, parts: list[Any]) -> n.Machine:
        _, name, help, body = parts
        return n.Machine(self.word(name), body.lines, self.over(parts), self.text(help))

    def from_any(self, parts: list[Any]) -> n.Change:
        change: n.Change = parts[3]
        return replace(change, any_except=parts[2] or (), span=self.over(parts))

    def state(self, parts: list[Any]) -> n.State:
        _, name, label, colour, at_least, body = parts
        blocks = [line for line in body.lines if isinstance(line, ActionBlock)]
        lines = tuple(line for line in body.lines if not isinstance(line, ActionBlock))
        enter = tuple(action for block in blocks if block.word == "enter" for action in block.actions)
        exit = tuple(action for block in blocks if block.word == "exit" for action in block.actions)
        least = at_least.value if at_least else None
        return n.State(self.word(name), self.text(label), self.word(colour), least, lines, enter, exit, self.over(parts))

    def at_least(self, parts: list[Any]) -> ResultLine:
        return ResultLine(parts[2], self.over(parts))

    # --- lines of a state ---

    def steer(self, parts: list[Any]) -> n.Steer:
        return n.Steer(parts[1], self.over(parts))

    def face(self, parts: list[Any]) -> n.Face:
        return n.Face(parts[1], self.over(parts))

    def enter(self, parts: list[Any]) -> ActionBlock:
        return ActionBlock(str(parts[0].value), parts[1].lines, self.over(parts))

    exit = enter

    def change(self, parts: list[Any]) -> n.Change:
        interrupt, _, (condition, delay, held), take, _, target, over, body = parts
        actions, span = body.lines if body else (), self.over(parts)
        return n.Change(interrupt is not None, condition, delay, held, take, target, over, actions, None, span)

    def condition(self, parts: list[Any]) -> tuple[n.Expr | None, n.Expr | None, n.Expr | None]:
        return parts[0], None, parts[1]

    def after(self, parts: list[Any]) -> tuple[n.Expr | None, n.Expr | None, n.Expr | None]:
        return None, parts[0], None

    def take(self, parts: list[Any]) -> n.Take:
        _, amount, attribute, _, source = parts
        every = getattr(amount, "type", None) == "ALL"
        return n.Take(None if every else amount, self.word(attribute), source, self.over(parts))

    def target_state(self, parts: list[Any]) -> n.Target:
        return n.Target(self.word(parts[0]), False, (), self.over(parts))

    def target_previous(self, parts: list[Any]) -> n.Target:
        return n.Target(None, True, (), self.over(parts))

    def target_choose(self, parts: list[Any]) -> n.Target:
        return n.Target(None, False, parts[1].lines, self.over(parts))

    def weight(self, parts: list[Any]) -> n.Weight:
        return n.Weight(self.word(parts[0]), parts[1], self.over(parts))

    def assign(self, parts: list[Any]) -> n.Assign:
        return n.Assign(parts[0], str(parts[1].value), parts[2], self.over(parts))

    def ask(self, parts: list[Any]) -> n.Ask:
        name = self.word(parts[1]) if len(parts) > 1 else None
        return n.Ask(str(parts[0].value), name, None, _drop_absent(parts[3:-1]), None, self.over(parts))

    def ask_open(self, parts: list[Any]) -> n.Ask:
        return n.Ask(str(parts[0].value), self.word(parts[1]), None, _drop_absent(parts[3:-2]), parts[-1], self.over(parts))

    def ask_amount(self, parts: list[Any]) -> n.Ask:
        return n.Ask(str(parts[0].value), self.word(parts[1]), parts[-1], (), None, self.over(parts))

    def ask_when(self, parts: list[Any]) -> n.Ask:
        return n.Ask(str(parts[0].value), self.word(parts[1]), None, (), None, self.over(parts), parts[-1])

    def give(self, parts: list[Any]) -> n.Give:
        every = getattr(parts[1], "type", None) == "ALL"
        return n.Give(None if every else parts[1], self.word(parts[2]), parts[3], self.over(parts))

    # --- lines of a behaviour and of a spec ---

    def help(self, parts: list[Any]) -> n.Text:
        text: n.Text = self.text(parts[0])
        return text

    def keep(self, parts: list[Any]) -> n.Keep:
        _, name, type, _, first, then = parts
        return n.Keep(self.word(name), type, first, then, self.over(parts))

    def result(self, parts: list[Any]) -> ResultLine:
        return ResultLine(parts[0], self.over(parts))

    def spec_for(self, parts: list[Any]) -> n.SpecLine:
        return self._make_claim("for", parts[1], parts[2], parts)

    def spec_seeds(self, parts: list[Any]) -> n.SpecLine:
        return n.SpecLine(str(parts[0].value), None, None, parts[1], (), self.over(parts))

    spec_pass = spec_seeds

    def spec_set(self, parts: list[Any]) -> n.SpecLine:
        return n.SpecLine("set", parts[1], None, parts[3], (), self.over(parts))

    def spec_against(self, parts: list[Any]) -> n.SpecLine:
        body = parts[-1] if isinstance(parts[-1], BracedBody) else None
        scene = None if parts[1] is body else self.text(parts[1])
        return n.SpecLine("against", scene, None, None, body.lines if body else (), self.over(parts))

    def spec_claim(self, parts: list[Any]) -> n.SpecLine:
        return self._make_claim(str(parts[0].value), None, parts[1], parts)

    def spec_within(self, parts: list[Any]) -> n.SpecLine:
        return self._make_claim("within", parts[1], parts[2], parts)

    def spec_when(self, parts: list[Any]) -> n.SpecLine:
        return self._make_claim(str(parts[2].value), parts[3] if len(parts) > 4 else None, parts[-1], parts, parts[1])

    def _make_claim(self, kind: str, time: Any, condition: Any, parts: list[Any], since: Any = None) -> n.SpecLine:
        expectation, _, held = condition or (None, None, None)
        return n.SpecLine(kind, None, time, expectation, (), self.over([*parts[:-1], expectation, held]), held, since)

    def spec_each(self, parts: list[Any]) -> n.SpecLine:
        return n.SpecLine("each", self.name([parts[1]]), None, None, parts[2].lines, self.over(parts))

    # --- expressions ---

    def if_else(self, parts: list[Any]) -> n.IfElse:
        return n.IfElse(parts[1], parts[2], parts[3], self.over(parts))

    def binary(self, parts: list[Any]) -> n.Binary:
        left, op, right = parts
        return n.Binary(str(op.value), left, right, self.at(op), left.span.to(right.span))

    def unary(self, parts: list[Any]) -> n.Unary:
        op, operand = parts
        return n.Unary(str(op.value), operand, self.at(op), self.over(parts))

    def is_none(self, parts: list[Any]) -> n.IsNone:
        return n.IsNone(parts[0], parts[2] is not None, self.over(parts))

    def clip_test(self, parts: list[Any]) -> n.ClipTest:
        return n.ClipTest(self.word(parts[2]), parts[1] is not None, self.over(parts))

    def pair_of(self, parts: list[Any]) -> n.PairOf:
        return n.PairOf(parts[0], parts[1], self.over(parts))

    def number(self, parts: list[Any]) -> n.Number:
        return n.Number(float(parts[0].value), self.at(parts[0]))

    def quantity(self, parts: list[Any]) -> n.Quantity:
        token: Token = parts[0]
        written = QUANTITY_PATTERN.match(token.value)
        assert written is not None
        digits, unit = written[1], written[2] or ""
        unit_span = self.place.span(token.end_pos - len(unit), token.end_pos)
        return n.Quantity(float(digits), unit, unit_span, self.at(token))

    def name(self, parts: list[Any]) -> n.NameRef:
        return n.NameRef(self.word(parts[0]), self.at(parts[0]))

    def none(self, parts: list[Any]) -> n.NoneOf:
        return n.NoneOf(self.word(parts[1]), self.over(parts))

    def parentheses(self, parts: list[Any]) -> n.Expr:
        inner: n.Expr = parts[1]
        return replace(inner, span=self.over(parts))

    def call(self, parts: list[Any]) -> n.Call:
        return n.Call(parts[0], _drop_absent(parts[2:-1]), self.over(parts))

    def member_of(self, parts: list[Any]) -> n.Member:
        return n.Member(parts[0], self.word(parts[1]), self.over(parts))

    def index(self, parts: list[Any]) -> n.Index:
        return n.Index(parts[0], parts[1], self.over(parts))

    def index_all(self, parts: list[Any]) -> n.IndexAll:
        return n.IndexAll(parts[0], self.word(parts[1]), parts[2], self.over(parts))

    def unreadable(self, parts: list[Any]) -> n.BadExpr:
        return n.BadExpr(self.at(parts[0]))

    def argument(self, parts: list[Any]) -> n.Argument:
        return n.Argument(self.word(parts[0]), parts[1], self.over(parts))

    def comprehension(self, parts: list[Any]) -> n.Comprehension:
        return n.Comprehension(self.word(parts[0]), parts[1], parts[2], self.over(parts))


def _drop_absent(parts: Sequence[Any]) -> tuple[Any, ...]:
    """Return the existing arguments: none for an empty pair of parentheses."""
    return tuple(part for part in parts if part is not None and not hasattr(part, "start_pos"))
