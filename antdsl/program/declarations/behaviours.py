"""Checks each behaviour once, without its callers. Each call is replaced by an expansion of the behaviour with the types of the
call."""

from __future__ import annotations

from collections.abc import Mapping

from antdsl import limits
from antdsl.diagnostics import Label, Report
from antdsl.program.kinds import BAD_TYPE
from antdsl.program.model import Binding, ChangeRate, Expr, InlinedBehaviour, OperationExpr, TypeKind, ValueType
from antdsl.program.names.scope import (
    BehaviourInfo,
    Declarations,
    NameScope,
    StableKeys,
    find_highest_rate,
    make_bad_expression,
    parse_type_words,
    report_duplicate,
    suggest_name,
)
from antdsl.program.tables.vocabulary import BUILTINS_BY_NAME, TYPE_BY_WORD
from antdsl.program.traverse import iterate_nodes
from antdsl.program.types.arguments import ArgumentSlot, arrange_arguments, type_arguments, type_point
from antdsl.program.types.descriptions import describe_type, is_compatible, quote_source, report_mismatch
from antdsl.program.types.expressions import THING_KINDS
from antdsl.program.types.operators import type_value, type_value_as
from antdsl.syntax import nodes

_STORABLE_KINDS = frozenset({TypeKind.NUMBER, TypeKind.VECTOR, TypeKind.BOOL, TypeKind.ITEM, TypeKind.AGENT, TypeKind.BAD})
_DRAWING_FUNCTIONS = frozenset({"uniform", "normal", "pick", "random"})
_MAX_NESTED_OPERATIONS = 100  # maximum size of an expanded behaviour


# --- what a behaviour costs ------------------------------------------------------------------------------------------


def measure_behaviour(report: Report, info: BehaviourInfo) -> None:
    """Compute the size and depth of a behaviour and of all behaviours that it calls. A cycle of calls is reported only once,
    with the names of all behaviours in it."""
    stack: list[tuple[BehaviourInfo, int]] = [(info, 0)]
    path: list[BehaviourInfo] = []
    while stack:
        each, step = stack.pop()
        if step == 0:
            if each.check_state != "new":
                continue
            each.check_state = "sizing"
            path.append(each)
            _measure_calls(each)
        if step < len(each.calls):
            stack.append((each, step + 1))
            called = each.calls[step]
            if called.check_state == "sizing":
                _report_call_cycle(report, path[path.index(called) :])
            elif called.check_state == "new":
                stack.append((called, 0))
            continue
        path.pop()
        _add_call_sizes(report, each)


def _measure_calls(info: BehaviourInfo) -> None:
    for part, depth in iterate_nodes(info.node):
        info.operation_count += 1
        info.depth = max(info.depth, depth)
        if isinstance(part, nodes.Keep):
            info.has_memory = True
        elif isinstance(part, nodes.Unary) and part.op == "chance":
            info.has_draws = True
        elif isinstance(part, nodes.Call):
            if isinstance(part.function, nodes.NameRef) and part.function.name.text in _DRAWING_FUNCTIONS:
                info.has_draws = True
            called = _find_behaviour(info, part)
            if called is not None:
                info.calls.append(called)


def _find_behaviour(info: BehaviourInfo, call: nodes.Call) -> BehaviourInfo | None:
    function = call.function
    if isinstance(function, nodes.NameRef):
        return None if function.name.text in BUILTINS_BY_NAME else info.file.find_behaviour(function.name.text)
    if isinstance(function, nodes.Member) and isinstance(function.owner, nodes.NameRef):
        module = info.file.aliases.get(function.owner.name.text)
        return module.own_behaviours.get(function.name.text) if module else None
    return None


def _add_call_sizes(report: Report, info: BehaviourInfo) -> None:
    if info.check_state == "circular":
        return
    info.operation_count = min(
        limits.MAX_TREE_NODES * 2, info.operation_count + sum(called.operation_count for called in info.calls)
    )
    info.depth += max((called.depth for called in info.calls), default=0)
    info.has_memory = info.has_memory or any(called.has_memory for called in info.calls)
    info.has_draws = info.has_draws or any(called.has_draws for called in info.calls)
    info.check_state = "circular" if any(called.check_state == "circular" for called in info.calls) else "sized"
    if info.check_state == "sized" and info.depth > _MAX_NESTED_OPERATIONS + limits.MAX_EXPRESSION_DEPTH:
        message = f"behaviour `{info.node.name.text}` calls others too many levels deep"
        report.error("too-deep", message, info.node.name.span, "merge some of them")
        info.check_state = "circular"


def _report_call_cycle(report: Report, cycle: list[BehaviourInfo]) -> None:
    names = " → ".join(f"`{each.node.name.text}`" for each in [*cycle, cycle[0]])
    message = f"behaviours call each other in a circle: {names}"
    report.error("circle", message, cycle[0].node.name.span, "a behaviour cannot call itself; remove one of the calls")
    for each in cycle:
        each.check_state = "circular"


# --- a behaviour alone -----------------------------------------------------------------------------------------------


def check_behaviour(declarations: Declarations, info: BehaviourInfo, report_errors: bool = True) -> bool:
    """Check a behaviour once, with the declared types of its arguments. Return whether it has no errors."""
    if info.check_state in ("ok", "broken"):
        return info.check_state == "ok"
    report = Report()
    measure_behaviour(report, info)
    for called in info.calls:
        if called.check_state == "sized" and called is not info:
            check_behaviour(declarations, called)
    sound = info.check_state == "sized"
    if sound:
        info.check_state = "ok"  # cycles were rejected earlier, so the recursion ends
        _check_arguments_and_body(declarations, info, report)
        sound = report.ok
    info.check_state = "ok" if sound else "broken"
    if report_errors:
        declarations.report.extend(report)
    return sound


def _check_arguments_and_body(declarations: Declarations, info: BehaviourInfo, report: Report) -> None:
    node, name = info.node, info.node.name.text
    scope = NameScope(declarations, info.file, StableKeys(name), report, behaviour=name, is_generic=True)
    local: dict[str, Binding | Expr] = {}
    for argument in node.arguments:
        if argument.name.text in local:
            report_duplicate(
                report, "argument", argument.name, next(a for a in node.arguments if a.name.text == argument.name.text).name.span
            )
        type = resolve_argument_type(scope, argument)
        if argument.default is not None:
            _type_argument(scope.with_changes(local_names=dict(local)), name, argument, argument.default, type)
        local[argument.name.text] = Binding(argument.name.text, "argument", type, ChangeRate.AGENT, argument.name.span)
    body, result = _check_body(scope.with_changes(local_names=local), info)
    returns = resolve_returned_type(scope, node)
    if not is_compatible(result.type, returns):
        report_mismatch(report, node.result, result.type, returns, f"`{name}`")
    if not report.ok or info.file.node.has_errors:
        return  # erroneous lines may use the arguments that seem unused
    for argument in node.arguments:
        if ("local", f"{argument.name.span}:{argument.name.text}") not in declarations.used_names:
            message = f"`{name}` never uses its argument `{argument.name.text}`"
            report.warning("unused-argument", message, argument.name.span, "use it, or delete it")
    for binding in body:
        if ("local", f"{binding.span}:{binding.name}") not in declarations.used_names:
            report.warning("unused-let", f"`{binding.name}` is never used", binding.span, "use it, or delete it")


def resolve_argument_type(scope: NameScope, argument: nodes.BehaviourArgument) -> ValueType:
    return resolve_declared_type(scope, argument.type)


def resolve_returned_type(scope: NameScope, node: nodes.Behaviour) -> ValueType:
    return resolve_declared_type(scope, node.returns)


def resolve_declared_type(scope: NameScope, written_type: nodes.TypeName) -> ValueType:
    """Return the type that a type name in the source stands for. Report an unknown name."""
    name = written_type.name
    if written_type.of is not None:
        scope.record_thing_use(written_type.of)
    type = parse_type_words(name.text, written_type.of.text if written_type.of else None)
    if type is None:
        scope.report.error(
            "unknown-type",
            f"no type `{name.text}`",
            name.span,
            suggest_name(name.text, TYPE_BY_WORD, f"types are {', '.join(f'`{w}`' for w in TYPE_BY_WORD)}"),
        )
        return BAD_TYPE
    return type


def _check_body(scope: NameScope, info: BehaviourInfo) -> tuple[list[Binding], Expr]:
    """Return the lets and keeps of a behaviour in text order, and the expression for the behaviour's result."""
    bindings: list[Binding] = []
    local = dict(scope.local_names)
    for line in info.node.body:
        line_scope = scope.with_changes(local_names=dict(local))
        if line.name.text in local:
            first = next((b.span for b in bindings if b.name == line.name.text), info.node.name.span)
            report_duplicate(scope.report, "name", line.name, first)
        binding = _check_keep(line_scope, line) if isinstance(line, nodes.Keep) else _check_let(line_scope, line)
        local[line.name.text] = binding
        bindings.append(binding)
    return bindings, type_value(scope.with_changes(local_names=local), info.node.result, resolve_returned_type(scope, info.node))


def _check_let(scope: NameScope, line: nodes.Let) -> Binding:
    expr = scope.type_expression(line.value)
    return Binding(line.name.text, "let", expr.type, expr.rate, line.name.span, expr)


def _check_keep(scope: NameScope, line: nodes.Keep) -> Binding:
    expected_type = resolve_declared_type(scope, line.type) if line.type else None
    who = f"`keep {line.name.text}`"
    first = type_value(scope, line.first) if expected_type is None else type_value_as(scope, line.first, expected_type, who)
    type = expected_type or first.type
    if type.kind not in _STORABLE_KINDS:
        message = f"{describe_type(type)} cannot be stored"
        scope.report.error("wrong-kind", message, line.first.span, "store a number, a vector, a yes or no, an item or an agent")
    key = f"{scope.keys.path}.{line.name.text}"
    binding = Binding(line.name.text, "keep", type, ChangeRate.AGENT, line.name.span, first, None, key)
    inner = scope.with_changes(local_names={**scope.local_names, line.name.text: binding})
    # the next value may read the previous one, so the binding must exist first; it is completed below
    object.__setattr__(binding, "next_value", type_value_as(inner, line.then, type, who))
    return binding


# --- a call ----------------------------------------------------------------------------------------------------------


def call_behaviour(scope: NameScope, node: nodes.Call, expected_type: ValueType | None) -> Expr:
    """Return the expansion of the behaviour that `node` calls."""
    info = _find_called_behaviour(scope, node.function)
    if info is None:
        type_arguments(scope, node)
        return make_bad_expression(node.span)
    name = info.node.name.text
    scope.mark_used("behaviour", f"{info.node.name.span}")
    _bind_call_names(scope, info, node)
    if not check_behaviour(scope.declarations, info):
        type_arguments(scope, node)
        return make_bad_expression(node.span)
    slots = [ArgumentSlot(a.name.text, a.default is None) for a in info.node.arguments]
    arguments_by_slot = arrange_arguments(scope, name, slots, node)
    if arguments_by_slot is None:
        type_arguments(scope, node)
        return make_bad_expression(node.span)
    if not _is_allowed(scope, info, node):
        return make_bad_expression(node.span)
    if scope.is_generic:
        return _check_call(scope, info, node, {slot: arguments[0].value for slot, arguments in arguments_by_slot.items()})
    return _expand_call(scope, info, node, {slot: arguments[0].value for slot, arguments in arguments_by_slot.items()})


def expand_implicit_call(scope: NameScope, info: BehaviourInfo, node: nodes.Call) -> Expr:
    """Return the expansion of a behaviour without arguments, for a call that the language itself makes.

    `node`: a call with the location that errors refer to."""
    if not check_behaviour(scope.declarations, info) or not _is_allowed(scope, info, node):
        return make_bad_expression(node.span)
    return _expand_call(scope, info, node, {})


def _bind_call_names(scope: NameScope, info: BehaviourInfo, node: nodes.Call) -> None:
    """Record the declarations of the names in a call, which are the module, the behaviour and its arguments."""
    path, name, function = info.file.node.source.path, info.node.name.text, node.function
    if isinstance(function, nodes.Member) and isinstance(function.owner, nodes.NameRef):
        scope.record_name_use(function.owner.span, "alias", scope.file.node.source.path, function.owner.name.text)
    scope.record_name_use(function.name.span if isinstance(function, nodes.Member) else function.span, "behaviour", path, name)
    for argument in node.arguments:
        if isinstance(argument, nodes.Argument) and argument.name is not None:
            scope.record_name_use(argument.name.span, "inner", path, name, argument.name.text)


def _find_called_behaviour(scope: NameScope, function: nodes.Expr) -> BehaviourInfo | None:
    if isinstance(function, nodes.NameRef):
        return scope.file.find_behaviour(function.name.text)
    assert isinstance(function, nodes.Member)
    alias = function.owner.name.text if isinstance(function.owner, nodes.NameRef) else None
    module = scope.file.aliases.get(alias) if alias else None
    if module is None:
        advice = "only behaviours of a file in a `use` line are called this way"
        if alias:
            advice = f'add it: `use "./{alias}.ant" as {alias}`'
        message = f"no file is used under the name {quote_source(function.owner.span)}"
        scope.report.error("unknown-module", message, function.owner.span, suggest_name(alias or "", scope.file.aliases, advice))
        return None
    info = module.own_behaviours.get(function.name.text)
    if info is None and not module.is_missing:
        message = f"no behaviour `{function.name.text}` in `{alias}`"
        scope.report.error(
            "unknown-behaviour", message, function.name.span, suggest_name(function.name.text, module.own_behaviours)
        )
    return info


def _is_allowed(scope: NameScope, info: BehaviourInfo, node: nodes.Call) -> bool:
    """Return whether a call is allowed at its position. If not, report an error.

    Memory and draws are not allowed in all positions, and the size of the expansion is limited."""
    name, declared = info.node.name.text, scope.declarations
    if info.has_memory and scope.no_keep_reason:
        help = "call it in a separate line: `steer …`, or a line of `layers`"
        scope.report.error("keep-inside", f"`{name}` stores a value between steps, and {scope.no_keep_reason}", node.span, help)
        return False
    if info.has_draws and scope.set_elements:
        message = f"`{name}` draws random numbers, which is not possible inside a set"
        scope.report.error("draw-in-set", message, node.span, "call it outside of the set")
        return False
    if scope.behaviour is not None:
        return True  # the calling behaviour includes this size
    previous_size, declared.expanded_count = declared.expanded_count, declared.expanded_count + info.operation_count
    if declared.expanded_count > limits.MAX_TREE_NODES:
        if previous_size <= limits.MAX_TREE_NODES:
            message = f"with `{name}` expanded, this has more than {limits.MAX_TREE_NODES:,} operations"
            scope.report.error("too-large", message, node.span, "call fewer or smaller behaviours")
        return False
    return True


def _check_call(scope: NameScope, info: BehaviourInfo, node: nodes.Call, argument_nodes: Mapping[str, nodes.Expr]) -> Expr:
    """Check the arguments of a call inside a behaviour. This check is independent of callers of the behaviour. Return an
    expression with the type of the result.

    The body of the called behaviour is checked separately."""
    quiet = scope.with_changes(report=Report())
    for argument in info.node.arguments:
        if argument.name.text in argument_nodes:
            given, type = argument_nodes[argument.name.text], resolve_argument_type(quiet, argument)
            _type_argument(scope, info.node.name.text, argument, given, type)
    return OperationExpr(
        resolve_returned_type(quiet, info.node),
        ChangeRate.ELEMENT if scope.set_elements else ChangeRate.AGENT,
        node.span,
        "call",
        (),
    )


def _expand_call(scope: NameScope, info: BehaviourInfo, node: nodes.Call, argument_nodes: Mapping[str, nodes.Expr]) -> Expr:
    name = info.node.name.text
    key = scope.keys.make_key(name)
    report = Report()
    inner = scope.with_changes(file=info.file, keys=StableKeys(key), report=report, behaviour=name, local_names={}, element=None)
    arguments: list[Binding] = []
    local: dict[str, Binding | Expr] = {}
    for argument in info.node.arguments:
        type = resolve_argument_type(inner, argument)
        node_given = argument_nodes.get(argument.name.text)
        if node_given is not None:
            expr = _type_argument(scope, name, argument, node_given, type)
        else:
            assert argument.default is not None
            expr = _type_argument(inner.with_changes(local_names=dict(local)), name, argument, argument.default, type)
        if expr.type.kind is TypeKind.BAD:
            type_arguments(scope, node)
            return make_bad_expression(node.span)
        if expr.type.kind in THING_KINDS:
            local[argument.name.text] = expr
            continue
        binding = Binding(argument.name.text, "argument", expr.type, expr.rate, argument.name.span, expr)
        local[argument.name.text] = binding
        arguments.append(binding)
    body, result = _check_body(inner.with_changes(local_names=local), info)
    if not report.ok:
        first = report.errors[0]
        labels = (Label(first.span, "here"),) if first.span is not None else ()
        return scope.report_error(
            first.code, f"`{name}` cannot be used this way: {first.message}", node.span, first.help, labels=labels
        )
    return InlinedBehaviour(
        result.type,
        max(result.rate, find_highest_rate(b.value for b in body)),
        node.span,
        name,
        key,
        tuple(arguments),
        tuple(body),
        result,
    )


def _type_argument(
    scope: NameScope, behaviour_name: str, argument: nodes.BehaviourArgument, node: nodes.Expr, type: ValueType
) -> Expr:
    who = f"`{argument.name.text}` of `{behaviour_name}`"
    if type.kind is TypeKind.PLACE:
        return type_point(scope, node, who)
    if type.kind is TypeKind.BAD:
        return type_value(scope, node)
    if type.kind in THING_KINDS:
        expr = scope.type_expression(node, type)
        if is_compatible(expr.type, type):
            return expr
        return report_mismatch(scope.report, node, expr.type, type, who)
    return type_value_as(scope, node, type, who)
