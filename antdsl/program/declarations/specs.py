"""Checks specs: scene, duration, seeds, params, and expectations about the complete run and about each agent."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from antdsl.diagnostics import Report
from antdsl.program.declarations.fields import SETTING_RULES, is_run_constant
from antdsl.program.declarations.world import make_outer_scope
from antdsl.program.expectations import (
    AggregateExpr,
    BodyMeasure,
    ComparisonRun,
    Expectation,
    ExpectationReading,
    Goal,
    MeasureValue,
    MotionMeasure,
    ReferenceRunValue,
    Spec,
    SpecChange,
    StartValue,
    TimeOf,
)
from antdsl.program.kinds import NUMBER_TYPE, TIME_TYPE
from antdsl.program.model import ChangeRate, Constant, Expr, Field, OperationExpr, Param, TypeKind
from antdsl.program.names.scope import Declarations, FileNames, NameScope, StableKeys, list_names, suggest_name
from antdsl.program.tables.units import choose_default_unit, find_unit_measure
from antdsl.program.tables.vocabulary import DRAWING_OPERATIONS
from antdsl.program.traverse import iterate_nodes, iterate_parts
from antdsl.program.types.aggregates import SpecRules
from antdsl.program.types.descriptions import quote_source
from antdsl.program.types.folding import find_constant
from antdsl.program.types.operators import type_condition, type_value_as
from antdsl.syntax import nodes
from antdsl.syntax.words import FIXED_FIELD_SETTINGS

MAX_SEEDS = 1000
_COMPARISON_OPERATIONS = ("lt", "le", "gt", "ge", "eq", "ne")
_REFERENCE_KINDS = (TypeKind.ITEM, TypeKind.AGENT)
_WORDS_ALLOWED_ONCE = ("seeds", "pass", "set", "against", "sooner", "goal", "each")  # words of lines outside of `each`
_SETTING_WORDS = ("seeds", "pass", "set", "until")  # words of lines that set up the run


@dataclass(slots=True)
class _SpecCheck:
    """The intermediate state of checking one spec."""

    declarations: Declarations
    names: FileNames
    params: Mapping[str, Param]
    fields: Mapping[str, Field]
    duration: Expr | None = None
    seeds: list[int] = field(default_factory=list)
    changes: list[SpecChange] = field(default_factory=list)
    expectations: list[Expectation] = field(default_factory=list)
    pass_share: float | None = None
    has_reference_run: bool = False  # whether the spec has a reference run
    reference_run: ComparisonRun | None = None
    block_count: int = 0


def check_spec(
    declarations: Declarations, names: FileNames, spec: nodes.Spec, params: Mapping[str, Param], fields: Mapping[str, Field]
) -> Spec:
    """Return a spec with typed expressions. Report names that are not allowed in a spec."""
    if spec.scene is not None and not spec.scene.text.endswith((".yaml", ".yml")):
        words = f"`{spec.scene.text}` is not the name of a scene"
        declarations.report.error("not-a-scene", words, spec.scene.span, 'write `on "scene.yaml"`')
    work = _SpecCheck(declarations, names, params, fields, has_reference_run=any(line.kind == "against" for line in spec.lines))
    for line in spec.lines:
        _check_line(work, line)
    if not any((line.condition is not None and line.kind not in _SETTING_WORDS) or line.kind == "each" for line in spec.lines):
        message = f"the spec {quote_source(spec.name.span)} has no expectations"
        declarations.report.warning("empty-spec", message, spec.name.span, "write `always: …` or `within 20 s: …`")
    return Spec(
        spec.name.text, spec.scene, work.duration, tuple(dict.fromkeys(work.seeds)), tuple(work.changes),
        tuple(work.expectations), spec.span, 1.0 if work.pass_share is None else work.pass_share, work.reference_run,
    )  # fmt: skip


def _check_line(work: _SpecCheck, line: nodes.SpecLine) -> None:
    if line.kind == "for" and line.condition is None:
        _check_repeat(work, line, work.duration is not None)
        work.duration = _type_time(work, line, make_outer_scope(work.declarations, work.names, "spec"))
    elif line.kind == "seeds":
        _read_seeds(work, line)
    elif line.kind == "pass":
        _check_repeat(work, line, work.pass_share is not None)
        work.pass_share = _read_share(work, line, line.condition)
    elif line.kind == "against":
        _check_repeat(work, line, work.reference_run is not None)
        work.reference_run = _check_reference_run(work, line)
    elif line.kind == "set":
        _add_change(work, line)
    elif line.kind == "each":
        _check_each_block(work, line)
    elif line.kind == "goal":
        _add_goal(work, line)
    else:
        _add_expectation(work, line, None)


def _check_repeat(work: _SpecCheck, line: nodes.SpecLine, is_repeated: bool) -> None:
    if is_repeated:
        words = f"`{line.kind}` appears twice in one spec"
        work.declarations.report.error("duplicate-name", words, line.span, "keep one of them")


def _type_time(
    work: _SpecCheck, line: nodes.SpecLine, scope: NameScope, node: nodes.Expr | None = None, word: str = ""
) -> Expr | None:
    node, word = node or line.time, word or line.kind
    assert node is not None
    expr = type_value_as(scope, node, TIME_TYPE, f"`{word}`")
    if expr.type.kind is TypeKind.BAD or not is_run_constant(work.declarations.report, expr, f"`{word}`"):
        return None
    known = find_constant(expr)
    if known is not None and known.number <= 0:
        message = f"`{word}` needs a time above 0"
        work.declarations.report.error("out-of-range", message, node.span, "write a time above 0, such as `20 s`")
        return None
    return expr


def _read_share(work: _SpecCheck, line: nodes.SpecLine, node: nodes.Expr | None) -> float | None:
    """Return a fraction from 0 to 1, or None after an error. It is the fraction of seeds that must pass, or the tolerance of a
    goal."""
    assert node is not None
    word = f"`{line.kind}`"
    expr = type_value_as(make_outer_scope(work.declarations, work.names, "spec"), node, NUMBER_TYPE, word)
    known = find_constant(expr)
    if known is not None and 0 < known.number <= 1:
        return known.number
    if expr.type.kind is not TypeKind.BAD:
        words, sample = ("share of the seeds", "pass 80 %") if line.kind == "pass" else ("tolerance", "goal 5 %: …")
        message = f"{word} needs a {words}, not {quote_source(node.span)}"
        work.declarations.report.error("out-of-range", message, node.span, f"write a share up to `100 %`, such as `{sample}`")
    return None


def _check_reference_run(work: _SpecCheck, line: nodes.SpecLine) -> ComparisonRun:
    """Return the reference run that an `against` block describes. Its `set` lines are the changes of this run."""
    report, scene = work.declarations.report, line.target
    if isinstance(scene, nodes.Text) and not scene.text.endswith((".yaml", ".yml")):
        message = f"`{scene.text}` is not the name of a scene"
        report.error("not-a-scene", message, scene.span, 'write `against "without_fields.yaml"`')
    own, work.changes = work.changes, []
    for inner in line.lines:
        if inner.kind == "set":
            _add_change(work, inner)
        else:
            words = f"`{inner.kind}` belongs to the spec, not to the run it is compared with"
            report.error("misplaced-line", words, inner.span, "write it outside of `against { … }`")
    own, work.changes = work.changes, own
    if not own and scene is None and not line.lines:
        words = "`against` does not state what differs in the other run"
        report.error("wrong-argument", words, line.span, "write `against { set forager.reward = 0 /s }`")
    return ComparisonRun(scene if isinstance(scene, nodes.Text) else None, tuple(own), line.span)


def _read_seeds(work: _SpecCheck, line: nodes.SpecLine) -> None:
    node = line.condition
    assert node is not None
    ends = (node.low, node.high) if isinstance(node, nodes.RangeExpr) else (node,)
    bounds = [_read_whole_number(work, end) for end in ends]
    numbers = [number for number in bounds if number is not None]
    if len(numbers) < len(bounds):
        return
    low, high = numbers[0], numbers[-1]
    if high < low:
        work.declarations.report.error("empty-range", "the seeds end before they begin", node.span, "write the lower one first")
    elif high - low >= MAX_SEEDS:
        advice = "a spec that holds for ten seeds will probably hold for a thousand"
        work.declarations.report.error("too-many", f"more than {MAX_SEEDS:,} seeds", node.span, advice)
    else:
        work.seeds += range(low, high + 1)


def _read_whole_number(work: _SpecCheck, node: nodes.Expr) -> int | None:
    expr = type_value_as(make_outer_scope(work.declarations, work.names, "spec"), node, NUMBER_TYPE, "`seeds`")
    known = find_constant(expr)
    if known is not None and known.number == int(known.number) and 0 <= known.number < 2**53:
        return int(known.number)
    if expr.type.kind is not TypeKind.BAD:
        message = f"a seed is a whole number, not {quote_source(node.span)}"
        work.declarations.report.error("wrong-count", message, node.span, "write `seeds 1 .. 5`")
    return None


def _add_change(work: _SpecCheck, line: nodes.SpecLine) -> None:
    declared, scope = work.declarations, make_outer_scope(work.declarations, work.names, "spec")
    assert line.target is not None and line.condition is not None
    text = "".join(line.target.span.text.split())
    thing, _, word = text.partition(".")
    if text in work.params:
        param = work.params[text]
        declared.used_names.add(("param", text))
        _bind_target(scope, line.target, "species", "own")
        expr = type_value_as(scope, line.condition, param.type, f"`{text}`")
        if expr.type.kind is TypeKind.BAD:
            return
        if find_constant(expr) is None:
            is_run_constant(declared.report, expr, f"`{text}`")
            return
        _check_range(work, line.condition, param, expr)
        work.changes.append(SpecChange(text, expr, line.span))
    elif thing in work.fields and word in SETTING_RULES and word not in FIXED_FIELD_SETTINGS:
        declared.used_names.add(("field", thing))
        _bind_target(scope, line.target, "field", "setting")
        value = SETTING_RULES[word](scope, nodes.Setting(nodes.Name(word, line.target.span), line.condition, line.span))
        if value is not None:
            work.changes.append(SpecChange(text, value, line.span))
    else:
        known = [
            *work.params,
            *(f"{name}.{word}" for name in work.fields for word in SETTING_RULES if word not in FIXED_FIELD_SETTINGS),
        ]
        advice = suggest_name(text, known, f"there is {list_names(work.params)}" if work.params else None)
        declared.report.error("unknown-name", f"no param `{text}` to set", line.target.span, advice)


def _bind_target(scope: NameScope, target: nodes.Expr | nodes.Text, owner: str, value: str) -> None:
    """Record to which declarations the two names in `forager.smell` or `trail.half_life` refer. `owner` and `value`: the kinds
    of the first and the second name."""
    if isinstance(target, nodes.Member) and isinstance(target.owner, nodes.NameRef):
        name, word = target.owner.name.text, target.name.text
        scope.record_name_use(target.owner.span, owner, name)
        scope.record_name_use(target.name.span, *((value, word) if value == "setting" else (value, name, word)))


def _check_range(work: _SpecCheck, node: nodes.Expr, param: Param, expr: Expr) -> None:
    constant = find_constant(expr)
    for bound, sign in ((param.low, 1), (param.high, -1)):
        alike = (
            constant is not None and bound is not None and (bound.unit_power, bound.step) == (constant.unit_power, constant.step)
        )
        if constant is not None and bound is not None and alike and sign * (constant.number - bound.number) < 0:
            low, high = (end.span.text if end is not None else "" for end in (param.low, param.high))
            message = f"`{param.name}` = {constant.span.text} is outside {low} .. {high}"
            work.declarations.report.error("out-of-range", message, node.span, "write a value inside the range")


# --- what is expected ------------------------------------------------------------------------------------------------


def _check_each_block(work: _SpecCheck, line: nodes.SpecLine) -> None:
    declared = work.declarations
    assert isinstance(line.target, nodes.NameRef)
    species = line.target.name.text
    if species not in declared.species:
        message = f"no species `{species}`"
        declared.report.error("unknown-species", message, line.target.span, suggest_name(species, declared.species))
        return
    declared.used_names.add(("species", species))
    make_outer_scope(declared, work.names, "spec").record_name_use(line.target.span, "species", species)
    work.block_count += 1
    for inner in line.lines:
        if inner.kind in ("seeds", "pass", "set", "against", "sooner", "goal", "each") or (
            inner.kind == "for" and not inner.condition
        ):
            message = f"`{inner.kind}` belongs to the whole spec"
            declared.report.error("misplaced-line", message, inner.span, f"write it outside of `each {species}`")
        else:
            _add_expectation(work, inner, species)


def _add_expectation(work: _SpecCheck, line: nodes.SpecLine, species: str | None) -> None:
    assert line.condition is not None
    rules = SpecRules(work.declarations, work.has_reference_run)
    scope = make_outer_scope(rules.declarations, work.names, f"{species or ''}.spec")
    if species is not None:
        scope = scope.with_changes(species=work.declarations.species[species], keys=StableKeys(f"{species}.spec"))
    time = _type_time(work, line, scope) if line.time is not None else None
    held = None if line.held is None else _type_time(work, line, scope, line.held, "held")
    since = None if line.since is None else type_condition(scope, line.since, "`when`")
    expr = type_condition(scope, line.condition, f"`{line.kind}`")
    conditions = [each for each in (since, expr) if each is not None]
    if any(isinstance(p, Expr) and p.type.kind is TypeKind.BAD for each in conditions for p in iterate_parts(each)):
        return
    at_end = any(isinstance(part, MotionMeasure) for each in conditions for part in iterate_parts(each))
    if all(_is_judgeable(work, line, species, each, at_end) for each in conditions) and _allows_time(work, line):
        readings, block = tuple(_list_readings(expr, line.condition)), work.block_count if species else 0
        work.expectations.append(Expectation(line.kind, block, species, expr, time, readings, at_end, line.span, held, since))


def _add_goal(work: _SpecCheck, line: nodes.SpecLine) -> None:
    """Add a goal as an expectation about the last frame. The expectation is met if value and target differ by at most the
    tolerance."""
    report, node, tolerance = work.declarations.report, line.condition, _read_share(work, line, line.time)
    if not isinstance(node, nodes.Binary) or node.op != "==" or line.held is not None:
        span = line.span if node is None else node.span
        report.error(
            "wrong-argument", "a `goal` compares a number with a target", span, "write `goal 5 %: total(nest.load) == 400`"
        )
        return
    scope = make_outer_scope(SpecRules(work.declarations, work.has_reference_run).declarations, work.names, ".spec")
    equal = type_condition(scope, node, "`goal`")
    if tolerance is None or any(isinstance(p, Expr) and p.type.kind is TypeKind.BAD for p in iterate_parts(equal)):
        return
    value, target = equal.args[:2] if isinstance(equal, OperationExpr) else (None, None)
    if value is None or target is None or value.type.kind is not TypeKind.NUMBER:
        report.error("wrong-kind", "a `goal` is about a number", node.span, "compare a number, such as `total(nest.load)`")
    elif _is_judgeable(work, line, None, equal, False):
        share = Constant(NUMBER_TYPE, ChangeRate.CONST, line.span, tolerance)
        difference = OperationExpr(value.type, equal.rate, node.span, "sub", (value, target))
        limit = OperationExpr(value.type, equal.rate, node.span, "mul", (_make_absolute(target), share))
        close = OperationExpr(equal.type, equal.rate, node.span, "le", (_make_absolute(difference), limit))
        readings = tuple(_list_readings(equal, node))
        goal = Goal(value, target, tolerance)
        work.expectations.append(Expectation("finally", 0, None, close, None, readings, False, line.span, goal=goal))


def _make_absolute(expr: Expr) -> Expr:
    return OperationExpr(expr.type, expr.rate, expr.span, "abs", (expr,))


def _allows_time(work: _SpecCheck, line: nodes.SpecLine) -> bool:
    """Return whether `held` or `sooner` is allowed in a line. If not, report an error."""
    report = work.declarations.report
    if line.held is not None and line.kind in ("always", "for"):
        words = f"`{line.kind}` with `held` fails in the first frame, where nothing has held yet"
        advice = "delete `held`: a condition that is always true has always held"
        report.error("wrong-argument", words, line.held.span, advice)
        return False
    if line.kind == "sooner" and not work.has_reference_run:
        words = "`sooner` compares with a reference run, but there is none"
        report.error("misplaced-line", words, line.span, "add a line such as `against { set forager.reward = 0 /s }`")
        return False
    return True


def _is_judgeable(work: _SpecCheck, line: nodes.SpecLine, species: str | None, expr: Expr, at_end: bool) -> bool:
    """Return whether the condition of a line can be judged at all. If not, report an error. `at_end`: whether the condition uses
    a measure that is known only at the end of the run."""
    report, text = work.declarations.report, quote_source(expr.span)
    if species is None and expr.rate > ChangeRate.STEP:
        names = [name for name, each in work.declarations.species.items() if each.node is not None] or ["walker"]
        advice = f"write it in `each {names[0]} {{ … }}`, or use the `share`, `mean`, `min` or `max` of all"
        report.error("wrong-rate", f"{text} differs from agent to agent, but no agent is named", expr.span, advice)
        return False
    held = line.held is not None or line.since is not None
    if at_end and (species is not None or held or line.kind not in ("always", "never", "finally")):
        advice = "limit it in a line of the spec itself: `always: motion.circling < 5 %`"
        report.error("wrong-argument", "`motion` is measured over the whole run and known only at its end", expr.span, advice)
        return False
    return is_free_of_draws(report, expr, "a spec")


def is_free_of_draws(report: Report, expr: Expr, place: str) -> bool:
    """Return whether an expression has no random draws. If it has some, report an error. `place`: a text that describes where
    the expression is."""
    draw = next((p for p in iterate_parts(expr) if isinstance(p, OperationExpr) and p.name in DRAWING_OPERATIONS), None)
    if draw is not None:
        message = f"{quote_source(draw.span)} draws a random number, but {place} must not change the run"
        report.error("draw-in-spec", message, draw.span, "leave it out")
    return draw is None


def _list_readings(expr: Expr, node: nodes.Expr) -> Iterator[ExpectationReading]:
    """Yield the values to report if an expectation fails, in text order.

    They are both sides of each comparison, and all other values in the condition."""
    units = [part.unit for part, _ in iterate_nodes(node) if isinstance(part, nodes.Quantity)]
    stack: list[Expr] = [expr]
    while stack:
        part = stack.pop()
        if (
            isinstance(part, OperationExpr)
            and part.name == "is_none"
            and part.args[0] is not None
            and part.args[0].type.kind in _REFERENCE_KINDS
        ):
            yield ExpectationReading(part.args[0], "")  # the reference itself, or none
        elif isinstance(part, OperationExpr) and part.name in ("and", "or", "not", *_COMPARISON_OPERATIONS):
            stack += [arg for arg in reversed(part.args) if arg is not None]
        elif part.rate > ChangeRate.RUN or isinstance(
            part, AggregateExpr | StartValue | MotionMeasure | ReferenceRunValue | BodyMeasure | MeasureValue | TimeOf
        ):
            yield ExpectationReading(part, _choose_display_unit(part, units))


def _choose_display_unit(part: Expr, units: list[str]) -> str:
    """Return the unit in which to display a number: the first unit of its dimension in the source, or a default unit."""
    if part.type.kind is not TypeKind.NUMBER:
        return ""
    for unit in units:
        known = find_unit_measure(unit)
        if known is not None and known.dim == part.type.dimension:
            return unit
    return choose_default_unit(part.type.dimension)
