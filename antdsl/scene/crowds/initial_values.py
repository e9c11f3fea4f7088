"""The values `each` of a crowd line, checked against the attributes and states of the species and converted to `ValueDraw`s."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

from antdsl.diagnostics import Report
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.program.model import AttributeDecl, Dimension, Machine, Program, Species, TypeKind
from antdsl.scene.checks.entry_checks import check_attribute_value, check_dimension, check_map_name, report_unknown_name
from antdsl.scene.crowds.casting_model import NormalRandomValue, PaintedMapValue, UniformRandomValue, WeightedChoice
from antdsl.scene.crowds.crowd_data import MAX_STANDARD_DEVIATIONS, ValueDraw
from antdsl.scene.document import PathKey
from antdsl.scene.quantities import Quantity, QuantityError, parse_quantity
from antdsl.scene.values import ScenePart

if TYPE_CHECKING:
    from antdsl.scene.load import Scene

_NUMBER_BY_BOOL_TEXT = {"true": 1.0, "false": 0.0, "yes": 1.0, "no": 0.0}


class _CrowdLineValues(NamedTuple):
    """A crowd line, with everything that is needed to convert its values. `report`: receives the errors. `number`: the index of
    the line."""

    scene: Scene
    program: Program
    report: Report
    number: int
    species: Species


def stage_initial_values(scene: Scene, program: Program, report: Report, number: int) -> dict[str, ValueDraw]:
    """Return the draws of a crowd line, by attribute and by `MACHINE.state`. Errors are added to the report."""
    model = scene.model.crowd[number]
    if model.species not in program.species:
        return {}
    line = _CrowdLineValues(scene, program, report, number, program.species[model.species])
    draws = {}
    for key, value in model.each.items():
        path = ("crowd", number, "each", key)
        machine = _find_machine(line.species, key)
        draw = _stage_value(line, value, machine, *path) if machine is not None else _stage_attribute(line, key, value, *path)
        if draw is not None:
            draws[key if machine is None else f"{machine.name}.state"] = draw
    return draws


def _find_machine(species: Species, key: str) -> Machine | None:
    """Return the machine that a key such as `MACHINE.state` names. The key `state` names the first machine. Return None if there
    is no such machine."""
    if key == "state":
        return species.machines[0] if species.machines else None
    name, _, word = key.partition(".")
    return next((each for each in species.machines if word == "state" and each.name == name), None)


def is_settable(attribute: AttributeDecl) -> bool:
    """Return whether scenes may set an attribute. They may if it is a single number or truth value per agent."""
    return attribute.pair_species is None and attribute.type.kind in (TypeKind.NUMBER, TypeKind.BOOL)


def _stage_attribute(line: _CrowdLineValues, key: str, value: str | ScenePart, *path: PathKey) -> ValueDraw | None:
    known = {each.name: each for each in line.species.attributes if is_settable(each)}
    if key not in known:
        names = [*known, *(f"{each.name}.state" for each in line.species.machines)]
        report_unknown_name(line.report, line.scene, path, f"agents of `{line.species.name}` have no attribute", names)
        return None
    return _stage_value(line, value, known[key], *path)


def _stage_value(
    line: _CrowdLineValues, value: str | ScenePart, target: AttributeDecl | Machine, *path: PathKey
) -> ValueDraw | None:
    if isinstance(value, str):
        number = _convert_text(line, value, target, *path)
        return None if number is None else ValueDraw("number", number)
    if isinstance(value, WeightedChoice):
        numbers = [_convert_text(line, text, target, *path, "choice", text) for text in value.choice]
        if any(number is None for number in numbers):
            return None
        return ValueDraw("choice", values=tuple(n for n in numbers if n is not None), weights=tuple(value.choice.values()))
    if isinstance(target, Machine) or target.type.kind is TypeKind.BOOL:
        words = f"`{target.name}` has no number to draw"
        line.report.error("wrong-value", words, line.scene.find_span(*path), "write one value, or `{choice: {A: 3, B: 1}}`")
        return None
    if isinstance(value, UniformRandomValue | NormalRandomValue):
        word, pair = ("uniform", value.uniform) if isinstance(value, UniformRandomValue) else ("normal", value.normal)
        if word == "normal":
            low, high = _convert_mean(line, pair, target, *path, word)
        else:
            low, high = (_convert_quantity(line, each, target, *path, word, k) for k, each in enumerate(pair))
        if low is None or high is None:
            return None
        if (word == "uniform" and high < low) or (word == "normal" and high < 0):
            help = "write the lesser bound first" if word == "uniform" else "write the mean and then a deviation above zero"
            line.report.error("wrong-value", f"`{pair[1].text}` is too small here", line.scene.find_span(*path, word, 1), help)
            return None
        return ValueDraw("uniform" if word == "uniform" else "normal", low, high)
    assert isinstance(value, PaintedMapValue)
    return _stage_painted_value(line, value, target, *path)


def _stage_painted_value(
    line: _CrowdLineValues, value: PaintedMapValue, target: AttributeDecl, *path: PathKey
) -> ValueDraw | None:
    if not check_map_name(line.scene, line.report, line.program, value.painted, *path, "painted"):
        return None
    if (value.low is None) != (value.high is None) or (value.low is None and target.type.dimension != Dimension()):
        help = "add `from` and `to`: the values where the map is 0 and where it is 1"
        line.report.error("missing-key", f"the numbers of `{value.painted}` have no unit", line.scene.find_span(*path), help)
        return None
    if value.low is None or value.high is None:
        return ValueDraw("painted", 0.0, 1.0, map_name=value.painted)
    low, high = (
        _convert_quantity(line, value.low, target, *path, "from"),
        _convert_quantity(line, value.high, target, *path, "to"),
    )
    return None if low is None or high is None else ValueDraw("painted", low, high, map_name=value.painted)


def _convert_quantity(
    line: _CrowdLineValues, quantity: Quantity, target: AttributeDecl, *path: PathKey, deviation: float = 0.0
) -> float | None:
    """Return a quantity in base units. If the attribute cannot have `quantity` minus `deviation`, report an error and return
    None."""
    model = line.scene.model
    if not check_attribute_value(line.scene, line.report, quantity, target, *path, deviation=deviation):
        return None
    return quantity.to_base_units(model.unit_mm, float(1 / model.fps))


def _convert_mean(
    line: _CrowdLineValues, pair: tuple[Quantity, Quantity], target: AttributeDecl, *path: PathKey
) -> tuple[float | None, float | None]:
    """Return the mean and the standard deviation of a normal distribution, in base units. Each is None after an error.

    The check assumes that random values farther than three standard deviations from the mean are cut off."""
    model, (mean, deviation) = line.scene.model, pair
    if not check_dimension(line.scene, line.report, deviation, target.type.dimension, target.name, *path, 1):
        return None, None
    width = deviation.to_base_units(model.unit_mm, float(1 / model.fps))
    return _convert_quantity(line, mean, target, *path, 0, deviation=MAX_STANDARD_DEVIATIONS * max(width, 0.0)), width


def _convert_text(line: _CrowdLineValues, text: str, target: AttributeDecl | Machine, *path: PathKey) -> float | None:
    """Return the number that a text stands for, or None after an error. The number is a quantity in base units, 1 or 0 for a
    truth value, or the index of a state."""
    if isinstance(target, Machine):
        indices = {state.name: float(state.index) for state in target.states}
        return _find_number_for_word(line, text, indices, f"`{line.species.name}` has no state", *path)
    if target.type.kind is TypeKind.BOOL:
        return _find_number_for_word(line, text, _NUMBER_BY_BOOL_TEXT, f"`{target.name}` is true or false, not", *path)
    try:
        quantity = parse_quantity(text)
    except QuantityError as error:
        help = error.help or "write a number with a unit, or `{uniform: [A, B]}`, `{normal: [A, B]}`, `{choice: {A: 3, B: 1}}`"
        line.report.error("wrong-value", f"`{text[:60]}` {error}", line.scene.find_span(*path), help)
        return None
    return _convert_quantity(line, quantity, target, *path)


def _find_number_for_word(
    line: _CrowdLineValues, text: str, number_by_word: Mapping[str, float], words: str, *path: PathKey
) -> float | None:
    """Return the number that a word stands for. For an unknown word, report an error and return None. `words`: the start of the
    message, before the word."""
    if text not in number_by_word:
        near = find_nearest_name(text, number_by_word)
        listed = "known: " + ", ".join(f"`{each}`" for each in number_by_word)
        is_key = "choice" in path
        span = line.scene.find_span(*path, key=is_key)
        line.report.error("unknown-thing", f"{words} `{text[:60]}`", span, f"did you mean `{near}`?" if near else listed)
        return None
    return number_by_word[text]
