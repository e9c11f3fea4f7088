"""Checks the fields of a program: the contents of their cells, the surfaces that they cover, and their settings."""

from __future__ import annotations

from collections.abc import Callable

from antdsl import limits
from antdsl.diagnostics import Label, Report
from antdsl.program import model
from antdsl.program.declarations.world import make_outer_scope
from antdsl.program.kinds import LENGTH_TYPE, NUMBER_TYPE, PER_SECOND_TYPE, TIME_TYPE
from antdsl.program.model import ChangeRate, Constant, Dimension, Expr, TypeKind, ValueType
from antdsl.program.names.collect import check_free_name
from antdsl.program.names.scope import Declarations, FileNames, NameScope, list_names, report_duplicate, suggest_name
from antdsl.program.tables.things import KIND_BY_WORD
from antdsl.program.tables.units import make_number
from antdsl.program.types.descriptions import quote_source
from antdsl.program.types.folding import find_constant
from antdsl.program.types.operators import type_value, type_value_as
from antdsl.syntax import nodes
from antdsl.syntax.words import FIELD_VALUE_WORDS, WORD_SETTING_VALUES


def declare_fields(declarations: Declarations, names: FileNames) -> list[nodes.FieldDecl]:
    """Add a file's fields to the declarations and return them. If another file declares the same field, its text must be equal;
    otherwise report an error."""
    added: list[nodes.FieldDecl] = []
    for item in names.node.items:
        if not isinstance(item, nodes.FieldDecl):
            continue
        known = declarations.fields.get(item.name.text)
        if known is None:
            if item.name.text in declarations.things or item.name.text in declarations.species:
                clash = declarations.things.get(item.name.text)
                report_duplicate(declarations.report, "name", item.name, clash.span if clash else item.name.span)
            elif check_free_name(declarations.report, item.name):
                declarations.fields[item.name.text] = item
                added.append(item)
        elif known.span.source.path == item.span.source.path or known.span.text.split() != item.span.text.split():
            report_duplicate(declarations.report, "field", item.name, known.name.span)
    if len(declarations.fields) > limits.MAX_FIELDS:
        message = f"more than {limits.MAX_FIELDS} fields"
        declarations.report.error("too-many", message, added[-1].name.span if added else None, "leave some out")
    return added


def check_field(declarations: Declarations, names: FileNames, node: nodes.FieldDecl) -> model.Field | None:
    """Return a field with its settings, or None if its cell size is invalid."""
    report = declarations.report
    scope = make_outer_scope(declarations, names, f"field.{node.name.text}")
    _check_value_type(report, node)
    surfaces = tuple(name.text for name in node.surfaces if _is_ground(declarations, name))
    settings: dict[str, nodes.Setting] = {}
    for setting in node.settings:
        word = setting.name.text
        if word not in SETTING_RULES:
            report.error(
                "unknown-setting",
                f"a field has no setting `{word}`",
                setting.name.span,
                suggest_name(word, SETTING_RULES, f"settings are {list_names(SETTING_RULES)}"),
            )
            if not isinstance(setting.value, nodes.NameRef):
                scope.type_expression(setting.value)
        elif word in settings:
            report_duplicate(report, "setting", setting.name, settings[word].name.span)
        else:
            settings[word] = setting
    _check_single_decay(report, settings)
    _check_vector_settings(report, node, settings)
    setting_values = {word: SETTING_RULES[word](scope, setting) for word, setting in settings.items()}
    if "cell" not in settings:
        message = f"field `{node.name.text}` has no cell size"
        report.error("missing-setting", message, node.name.span, "write `cell 4 mm` between its braces")
    cell = setting_values.get("cell") or make_number(1, node.span)
    return model.Field(
        node.name.text, surfaces, cell, setting_values.get("half_life"),
        setting_values.get("evaporate"), setting_values.get("keeps"), setting_values.get("diffuse"),
        _get_chosen_word("combine", setting_values), setting_values.get("limit"), _get_stencil_size(setting_values),
        _get_chosen_word("deposits", setting_values), node.name.span, node.has_vectors,
    )  # fmt: skip


def _check_value_type(report: Report, node: nodes.FieldDecl) -> None:
    """Report an error if the cells of a field would contain anything other than numbers or pushes."""
    written = node.value_type
    if written is not None and (written.name.text not in FIELD_VALUE_WORDS or written.of is not None):
        words = " or ".join(f"`{word}`" for word in FIELD_VALUE_WORDS)
        message = f"cells of a field hold {words}, not {quote_source(written.span)}"
        advice = "write `: push` for vectors, or nothing for numbers"
        report.error("unknown-type", message, written.span, advice)


def _check_vector_settings(report: Report, node: nodes.FieldDecl, settings: dict[str, nodes.Setting]) -> None:
    """Report settings that are not defined for vectors, such as `combine max`."""
    setting = settings.get("combine")
    if node.has_vectors and setting is not None and setting.value.span.text == "max":
        message = f"`combine max` needs numbers, but the cells of `{node.name.text}` hold vectors"
        report.error(
            "wrong-kind", message, setting.span, "leave it out: deposits are added; `limit` limits the length of the sum"
        )


def _is_ground(declarations: Declarations, name: nodes.Name) -> bool:
    thing = declarations.things.get(name.text)
    if thing is not None and KIND_BY_WORD[thing.kind].has_faces:
        declarations.used_names.add(("thing", name.text))
        return True
    if thing is None and name.text in declarations.unclear_things:
        return False
    grounds = [t.name for t in declarations.things.values() if KIND_BY_WORD[t.kind].is_ground]
    if thing is None:
        message = f"no surface `{name.text}`"
        declarations.report.error(
            "unknown-name", message, name.span, suggest_name(name.text, grounds, f"declare it: `world {{ surface {name.text} }}`")
        )
    else:
        message = f"`{name.text}` is {thing.kind}, but a field needs a surface"
        declarations.report.error("wrong-kind", message, name.span, f"surfaces are {list_names(grounds)}" if grounds else None)
    return False


def _check_single_decay(report: Report, settings: dict[str, nodes.Setting]) -> None:
    decays = [settings[word] for word in ("half_life", "evaporate", "keeps") if word in settings]
    for extra in decays[1:]:
        message = f"`{decays[0].name.text}` and `{extra.name.text}` both define how fast the field fades"
        report.error("two-decays", message, extra.span, "keep one of them", labels=(Label(decays[0].span, "the other one"),))


def _make_setting_rule(
    type: ValueType, min_value: float | None = None, is_exclusive: bool = False
) -> Callable[[NameScope, nodes.Setting], Expr | None]:
    def check_setting(scope: NameScope, node: nodes.Setting) -> Expr | None:
        expr = type_value_as(scope, node.value, type, f"`{node.name.text}`")
        if expr.type.kind is TypeKind.BAD:
            return None
        if not is_run_constant(scope.report, expr, f"`{node.name.text}` of a field"):
            return None
        constant = find_constant(expr)
        if (
            constant is not None
            and min_value is not None
            and (constant.number < min_value or (is_exclusive and constant.number == min_value))
        ):
            message = f"`{node.name.text}` cannot be {quote_source(node.value.span)}"
            advice = f"write {'more than' if is_exclusive else 'at least'} {min_value:g}"
            scope.report.error("out-of-range", message, node.value.span, advice)
            return None
        return expr

    return check_setting


def is_run_constant(report: Report, expr: Expr, subject: str) -> bool:
    """Return whether a value is equal for all agents and in all steps. If not, report an error."""
    if expr.rate <= ChangeRate.RUN:
        return True
    differs = "changes from step to step" if expr.rate is ChangeRate.STEP else "differs from agent to agent"
    message = f"{quote_source(expr.span)} {differs}, but {subject} must be one value for the whole run"
    report.error("wrong-rate", message, expr.span, "write a number")
    return False


def _type_keep_factor(scope: NameScope, node: nodes.Setting) -> Expr | None:
    """Return the factor per step of the setting `keeps`, such as 0.9 for `keeps 90 %/step`."""
    expr = type_value(scope, node.value)
    if expr.type.kind is TypeKind.BAD:
        return None
    constant = find_constant(expr)
    text = " ".join(node.value.span.text.split())
    if constant is None or expr.type != PER_SECOND_TYPE or constant.step != -1 or constant.unit_power:
        better = f"`keeps {text}/step`" if expr.type == NUMBER_TYPE else "`keeps 90 %/step`"
        message = f"`keeps` is a share for each step, and {quote_source(node.value.span)} is not"
        scope.report.error("wrong-unit", message, node.value.span, f"write {better}, or `half_life 8 s`")
        return None
    if not 0 <= constant.number <= 1:
        message = f"`keeps` cannot be {quote_source(node.value.span)}"
        scope.report.error("out-of-range", message, node.value.span, "write a share from `0 %/step` to `100 %/step`")
        return None
    return make_number(constant.number, node.value.span)


def _find_word_index(scope: NameScope, node: nodes.Setting) -> Expr | None:
    """Return the index of a setting's word among the allowed words, as a constant. For any other word, report an error and
    return None."""
    setting = node.name.text
    words = WORD_SETTING_VALUES[setting]
    word = node.value.name.text if isinstance(node.value, nodes.NameRef) else ""
    if word not in words:
        message = f"`{setting}` is {' or '.join(f'`{each}`' for each in words)}, not {quote_source(node.value.span)}"
        advice = f"write {' or '.join(f'`{setting} {each}`' for each in words)}"
        scope.report.error("wrong-kind", message, node.value.span, advice)
        return None
    return make_number(float(words.index(word)), node.value.span)


def _get_chosen_word(setting: str, setting_values: dict[str, Expr | None]) -> str:
    """Return the word of a setting, or its default if it is absent or invalid."""
    chosen_value = setting_values.get(setting)
    return WORD_SETTING_VALUES[setting][int(chosen_value.number) if isinstance(chosen_value, Constant) else 0]


def _check_stencil(scope: NameScope, node: nodes.Setting) -> Expr | None:
    expr = type_value_as(scope, node.value, NUMBER_TYPE, "`stencil`")
    if expr.type.kind is TypeKind.BAD:
        return None
    constant = find_constant(expr)
    if constant is None or constant.number not in STENCIL_SIZES:
        advice = "write `stencil 4` for adjacent cells, or `stencil 8` to include those at the corners"
        scope.report.error("out-of-range", f"`stencil` is 4 or 8, not {quote_source(node.value.span)}", node.value.span, advice)
        return None
    return make_number(constant.number, node.value.span)


def _get_stencil_size(setting_values: dict[str, Expr | None]) -> int:
    chosen_value = setting_values.get("stencil")
    return int(chosen_value.number) if isinstance(chosen_value, Constant) else STENCIL_SIZES[0]


STENCIL_SIZES = (4, 8)  # numbers of neighbour cells, the default first


SETTING_RULES: dict[str, Callable[[NameScope, nodes.Setting], Expr | None]] = {
    "cell": _make_setting_rule(LENGTH_TYPE, 0, is_exclusive=True),
    "half_life": _make_setting_rule(TIME_TYPE, 0, is_exclusive=True),
    "evaporate": _make_setting_rule(PER_SECOND_TYPE, 0),
    "keeps": _type_keep_factor,
    "diffuse": _make_setting_rule(ValueType(TypeKind.NUMBER, Dimension(length=2, time=-1)), 0),
    "stencil": _check_stencil,
    "combine": _find_word_index,
    "deposits": _find_word_index,
    "limit": _make_setting_rule(NUMBER_TYPE, 0, is_exclusive=True),
}
