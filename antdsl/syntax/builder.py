"""Builds the tree. There is one method for each rule of the grammar; the parser calls these methods from the leaves up. The
parser sees a line with empty braces. Their content has already been parsed, and is found by the opening brace's offset."""

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
    """Converter of positions in the parsed text to spans in the source."""

    def make_source_span(self, start: int, end: int) -> Span: ...


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
    """Builder of a line's nodes. `span_maker`: the line's location. `body_by_offset`: the bodies in the line, by the offset of
    `{`."""

    def __init__(self) -> None:
        self.span_maker: SpanMaker
        self.body_by_offset: dict[int, tuple[Any, ...]] = {}

    # --- places and leaves ---

    def get_span(self, part: Any) -> Span:
        """Return the span of a token or of a node."""
        span: Span = self.span_maker.make_source_span(part.start_pos, part.end_pos) if hasattr(part, "start_pos") else part.span
        return span

    def join_spans(self, parts: Sequence[Any]) -> Span:
        """Return the span from the first to the last part that is not None."""
        present_parts = [part for part in parts if part is not None]
        return self.get_span(present_parts[0]).to(self.get_span(present_parts[-1]))

    @overload
    def make_name(self, token: None) -> None: ...
    @overload
    def make_name(self, token: Token) -> n.Name: ...
    def make_name(self, token: Token | None) -> n.Name | None:
        return None if token is None else n.Name(str(token.value), self.get_span(token))

    @overload
    def text(self, token: None) -> None: ...
    @overload
    def text(self, token: Token) -> n.Text: ...
    def text(self, token: Token | None) -> n.Text | None:
        return None if token is None else n.Text(token.value[1:-1], self.get_span(token))

    def body(self, parts: list[Any]) -> BracedBody:
        lines = tuple(parts[1:-1]) or self.body_by_offset.get(self.get_span(parts[0]).start, ())
        return BracedBody(lines, self.join_spans(parts))

    def names(self, parts: list[Any]) -> tuple[n.Name, ...]:
        return tuple(n.Name(str(token.value), self.get_span(token)) for token in parts)

    # --- the top of a file ---

    def header(self, parts: list[Any]) -> FileHeader:
        return FileHeader(self.number([parts[1]]), self.join_spans(parts))

    def use_library(self, parts: list[Any]) -> n.Use:
        return n.Use(self.make_name(parts[1]), None, None, self.join_spans(parts))

    def use_file(self, parts: list[Any]) -> n.Use:
        return n.Use(None, self.text(parts[1]), self.make_name(parts[3]), self.join_spans(parts))

    def world(self, parts: list[Any]) -> n.World:
        return n.World(parts[1].lines, self.join_spans(parts))

    def world_item(self, parts: list[Any]) -> n.WorldItem:
        kind, name, body, help = parts
        attributes = body.lines if body else ()
        return n.WorldItem(self.make_name(kind), self.make_name(name), attributes, self.text(help), self.join_spans(parts))

    def field(self, parts: list[Any]) -> n.FieldDecl:
        word, name, value_type, _, surfaces, help, body = parts
        return n.FieldDecl(self.make_name(name), surfaces, body.lines, self.join_spans([word, body]), self.text(help), value_type)

    def setting(self, parts: list[Any]) -> n.Setting:
        return n.Setting(self.make_name(parts[0]), parts[1], self.join_spans(parts))

    def species(self, parts: list[Any]) -> n.Species:
        _, name, help, body = parts
        return n.Species(self.make_name(name), body.lines, self.text(help), self.join_spans(parts))

    def behaviour(self, parts: list[Any]) -> n.Behaviour:
        _, name, _, arguments, _, _, returns, body = parts
        span = self.join_spans(parts)
        helps = [line for line in body.lines if isinstance(line, n.Text)]
        results = [line.value for line in body.lines if isinstance(line, ResultLine)]
        lines = tuple(line for line in body.lines if isinstance(line, (n.Keep, n.Let)))
        result = results[0] if len(results) == 1 else n.BadExpr(Span(span.source, max(span.start, span.end - 1), span.end))
        return n.Behaviour(self.make_name(name), arguments or (), returns, helps[0] if helps else None, lines, result, span)

    def behaviour_arguments(self, parts: list[Any]) -> tuple[n.BehaviourArgument, ...]:
        return tuple(parts)

    def behaviour_argument(self, parts: list[Any]) -> n.BehaviourArgument:
        return n.BehaviourArgument(self.make_name(parts[0]), parts[1], parts[3], self.join_spans(parts))

    def spec(self, parts: list[Any]) -> n.Spec:
        _, name, _, scene, body = parts
        return n.Spec(self.text(name), self.text(scene), body.lines, self.join_spans(parts))

    # --- a declared value ---

    def declaration(self, parts: list[Any]) -> n.Declaration:
        name, type, _, value, range, relax, each, help = parts
        return n.Declaration(self.make_name(name), type, value, range, relax, each, self.text(help), self.join_spans(parts))

    def relax(self, parts: list[Any]) -> n.Relax:
        return n.Relax(parts[1], parts[2], self.join_spans(parts))

    def for_each(self, parts: list[Any]) -> n.ForEach:
        return n.ForEach(self.make_name(parts[2]), parts[3], self.join_spans(parts))

    def type(self, parts: list[Any]) -> n.TypeName:
        return n.TypeName(self.make_name(parts[0]), self.make_name(parts[1]), self.join_spans(parts))

    def range(self, parts: list[Any]) -> n.RangeExpr:
        return n.RangeExpr(parts[0], parts[1], self.join_spans(parts))

    # --- members of a species ---

    def param(self, parts: list[Any]) -> n.ParamDecl:
        return n.ParamDecl(parts[1], self.join_spans(parts))

    def given(self, parts: list[Any]) -> n.AnimalProperty:
        return n.AnimalProperty(self.make_name(parts[0]), parts[1], self.text(parts[2]), self.join_spans(parts))

    def let(self, parts: list[Any]) -> n.Let:
        kind = n.Measure if str(parts[0].value) == "measure" else n.Let
        return kind(self.make_name(parts[1]), parts[3], self.text(parts[4]), self.join_spans(parts))

    measure = let

    def latch(self, parts: list[Any]) -> n.Latch:
        _, name, _, condition, _, end_condition, help = parts
        return n.Latch(self.make_name(name), condition, end_condition, self.join_spans(parts), self.text(help))

    def fuzzy(self, parts: list[Any]) -> n.Fuzzy:
        return n.Fuzzy(self.make_name(parts[1]), parts[3].lines, self.join_spans(parts), self.text(parts[2]))

    def rule(self, parts: list[Any]) -> n.Rule:
        return n.Rule(parts[0], parts[2], self.join_spans(parts))

    def start(self, parts: list[Any]) -> n.Start:
        return n.Start(self.make_name(parts[1]), self.join_spans(parts))

    def on(self, parts: list[Any]) -> n.On:
        _, event, _, variable, species, _, body = parts
        return n.On(self.make_name(event), self.make_name(variable), self.make_name(species), body.lines, self.join_spans(parts))

    def layers(self, parts: list[Any]) -> n.Layers:
        return n.Layers(self.make_name(parts[1]), parts[2].lines, self.join_spans(parts))

    def layer(self, parts: list[Any]) -> n.Layer:
        face, push, _, condition = parts
        return n.Layer(push, condition, self.join_spans(parts), face is not None)

    def machine(self, parts: list[Any]) -> n.Machine:
        return n.Machine(self.make_name(parts[1]), parts[3].lines, self.join_spans(parts), self.text(parts[2]))

    def from_any(self, parts: list[Any]) -> n.Change:
        change: n.Change = parts[3]
        return replace(change, any_except=parts[2] or (), span=self.join_spans(parts))

    def state(self, parts: list[Any]) -> n.State:
        _, name, label, colour, at_least, body = parts
        blocks = [line for line in body.lines if isinstance(line, ActionBlock)]
        lines = tuple(line for line in body.lines if not isinstance(line, ActionBlock))
        enter = tuple(action for block in blocks if block.word == "enter" for action in block.actions)
        exit = tuple(action for block in blocks if block.word == "exit" for action in block.actions)
        least, span = at_least.value if at_least else None, self.join_spans(parts)
        return n.State(self.make_name(name), self.text(label), self.make_name(colour), least, lines, enter, exit, span)

    def at_least(self, parts: list[Any]) -> ResultLine:
        return ResultLine(parts[2], self.join_spans(parts))

    # --- lines of a state ---

    def steer(self, parts: list[Any]) -> n.Steer:
        return n.Steer(parts[1], self.join_spans(parts))

    def face(self, parts: list[Any]) -> n.Face:
        return n.Face(parts[1], self.join_spans(parts))

    def enter(self, parts: list[Any]) -> ActionBlock:
        return ActionBlock(str(parts[0].value), parts[1].lines, self.join_spans(parts))

    exit = enter

    def change(self, parts: list[Any]) -> n.Change:
        interrupt, _, (condition, delay, held), take, _, target, over, body = parts
        actions, span = body.lines if body else (), self.join_spans(parts)
        return n.Change(interrupt is not None, condition, delay, held, take, target, over, actions, None, span)

    def condition(self, parts: list[Any]) -> tuple[n.Expr | None, n.Expr | None, n.Expr | None]:
        return parts[0], None, parts[1]

    def after(self, parts: list[Any]) -> tuple[n.Expr | None, n.Expr | None, n.Expr | None]:
        return None, parts[0], None

    def take(self, parts: list[Any]) -> n.Take:
        _, amount, attribute, _, source = parts
        takes_all = getattr(amount, "type", None) == "ALL"
        return n.Take(None if takes_all else amount, self.make_name(attribute), source, self.join_spans(parts))

    def target_state(self, parts: list[Any]) -> n.Target:
        return n.Target(self.make_name(parts[0]), False, (), self.join_spans(parts))

    def target_previous(self, parts: list[Any]) -> n.Target:
        return n.Target(None, True, (), self.join_spans(parts))

    def target_choose(self, parts: list[Any]) -> n.Target:
        return n.Target(None, False, parts[1].lines, self.join_spans(parts))

    def weight(self, parts: list[Any]) -> n.Weight:
        return n.Weight(self.make_name(parts[0]), parts[1], self.join_spans(parts))

    def assign(self, parts: list[Any]) -> n.Assign:
        return n.Assign(parts[0], str(parts[1].value), parts[2], self.join_spans(parts))

    def ask(self, parts: list[Any]) -> n.VerbLine:
        name = self.make_name(parts[1]) if len(parts) > 1 else None
        return n.VerbLine(str(parts[0].value), name, None, _drop_absent(parts[3:-1]), None, self.join_spans(parts))

    def ask_open(self, parts: list[Any]) -> n.VerbLine:
        name, arguments = self.make_name(parts[1]), _drop_absent(parts[3:-2])
        return n.VerbLine(str(parts[0].value), name, None, arguments, parts[-1], self.join_spans(parts))

    def ask_amount(self, parts: list[Any]) -> n.VerbLine:
        return n.VerbLine(str(parts[0].value), self.make_name(parts[1]), parts[-1], (), None, self.join_spans(parts))

    def ask_when(self, parts: list[Any]) -> n.VerbLine:
        return n.VerbLine(str(parts[0].value), self.make_name(parts[1]), None, (), None, self.join_spans(parts), parts[-1])

    def give(self, parts: list[Any]) -> n.Give:
        gives_all = getattr(parts[1], "type", None) == "ALL"
        return n.Give(None if gives_all else parts[1], self.make_name(parts[2]), parts[3], self.join_spans(parts))

    # --- lines of a behaviour and of a spec ---

    def help(self, parts: list[Any]) -> n.Text:
        text: n.Text = self.text(parts[0])
        return text

    def keep(self, parts: list[Any]) -> n.Keep:
        return n.Keep(self.make_name(parts[1]), parts[2], parts[4], parts[5], self.join_spans(parts))

    def result(self, parts: list[Any]) -> ResultLine:
        return ResultLine(parts[0], self.join_spans(parts))

    def spec_for(self, parts: list[Any]) -> n.SpecLine:
        return self._make_claim("for", parts[1], parts[2], parts)

    def spec_seeds(self, parts: list[Any]) -> n.SpecLine:
        return n.SpecLine(str(parts[0].value), None, None, parts[1], (), self.join_spans(parts))

    spec_pass = spec_seeds

    def spec_set(self, parts: list[Any]) -> n.SpecLine:
        return n.SpecLine("set", parts[1], None, parts[3], (), self.join_spans(parts))

    def spec_against(self, parts: list[Any]) -> n.SpecLine:
        body = parts[-1] if isinstance(parts[-1], BracedBody) else None
        scene = None if parts[1] is body else self.text(parts[1])
        return n.SpecLine("against", scene, None, None, body.lines if body else (), self.join_spans(parts))

    def spec_claim(self, parts: list[Any]) -> n.SpecLine:
        return self._make_claim(str(parts[0].value), None, parts[1], parts)

    def spec_within(self, parts: list[Any]) -> n.SpecLine:
        return self._make_claim(str(parts[0].value), parts[1], parts[2], parts)

    def spec_when(self, parts: list[Any]) -> n.SpecLine:
        return self._make_claim(str(parts[2].value), parts[3] if len(parts) > 4 else None, parts[-1], parts, parts[1])

    def _make_claim(self, kind: str, time: Any, condition: Any, parts: list[Any], start_condition: Any = None) -> n.SpecLine:
        expectation, _, held = condition or (None, None, None)
        span = self.join_spans([*parts[:-1], expectation, held])
        return n.SpecLine(kind, None, time, expectation, (), span, held, start_condition)

    def spec_each(self, parts: list[Any]) -> n.SpecLine:
        return n.SpecLine("each", self.name([parts[1]]), None, None, parts[2].lines, self.join_spans(parts))

    # --- expressions ---

    def if_else(self, parts: list[Any]) -> n.IfElse:
        return n.IfElse(parts[1], parts[2], parts[3], self.join_spans(parts))

    def binary(self, parts: list[Any]) -> n.Binary:
        left, op, right = parts
        return n.Binary(str(op.value), left, right, self.get_span(op), left.span.to(right.span))

    def unary(self, parts: list[Any]) -> n.Unary:
        op, operand = parts
        return n.Unary(str(op.value), operand, self.get_span(op), self.join_spans(parts))

    def is_none(self, parts: list[Any]) -> n.IsNone:
        return n.IsNone(parts[0], parts[2] is not None, self.join_spans(parts))

    def clip_test(self, parts: list[Any]) -> n.ClipTest:
        return n.ClipTest(self.make_name(parts[2]), parts[1] is not None, self.join_spans(parts))

    def pair_of(self, parts: list[Any]) -> n.PairOf:
        return n.PairOf(parts[0], parts[1], self.join_spans(parts))

    def number(self, parts: list[Any]) -> n.Number:
        return n.Number(float(parts[0].value), self.get_span(parts[0]))

    def quantity(self, parts: list[Any]) -> n.Quantity:
        token: Token = parts[0]
        match = QUANTITY_PATTERN.match(token.value)
        assert match is not None
        digits, unit = match[1], match[2] or ""
        unit_span = self.span_maker.make_source_span(token.end_pos - len(unit), token.end_pos)
        return n.Quantity(float(digits), unit, unit_span, self.get_span(token))

    def name(self, parts: list[Any]) -> n.NameRef:
        return n.NameRef(self.make_name(parts[0]), self.get_span(parts[0]))

    def none(self, parts: list[Any]) -> n.NoneOf:
        return n.NoneOf(self.make_name(parts[1]), self.join_spans(parts))

    def parentheses(self, parts: list[Any]) -> n.Expr:
        inner: n.Expr = parts[1]
        return replace(inner, span=self.join_spans(parts))

    def call(self, parts: list[Any]) -> n.Call:
        return n.Call(parts[0], _drop_absent(parts[2:-1]), self.join_spans(parts))

    def member_of(self, parts: list[Any]) -> n.Member:
        return n.Member(parts[0], self.make_name(parts[1]), self.join_spans(parts))

    def index(self, parts: list[Any]) -> n.Index:
        return n.Index(parts[0], parts[1], self.join_spans(parts))

    def index_all(self, parts: list[Any]) -> n.IndexAll:
        return n.IndexAll(parts[0], self.make_name(parts[1]), parts[2], self.join_spans(parts))

    def unreadable(self, parts: list[Any]) -> n.BadExpr:
        return n.BadExpr(self.get_span(parts[0]))

    def argument(self, parts: list[Any]) -> n.Argument:
        return n.Argument(self.make_name(parts[0]), parts[1], self.join_spans(parts))

    def comprehension(self, parts: list[Any]) -> n.Comprehension:
        return n.Comprehension(self.make_name(parts[0]), parts[1], parts[2], self.join_spans(parts))


def _drop_absent(parts: Sequence[Any]) -> tuple[Any, ...]:
    """Return the nodes among the parts, without None and tokens."""
    return tuple(part for part in parts if part is not None and not hasattr(part, "start_pos"))
