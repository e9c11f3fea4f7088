"""The kinds of scalars in a scene, as pydantic types that are parsed from text: integers, quantities, lengths, frame rates,
names.

The module also has the mappings that several models share: points, and positions at frames. Each type converts a text to a value
exactly, or raises an error with a code, a message, and the text to write instead."""

from __future__ import annotations

import re
from collections.abc import Callable
from fractions import Fraction
from typing import Annotated, Any, NamedTuple

from pydantic import BaseModel, BeforeValidator, ConfigDict, Discriminator, Tag
from pydantic_core import PydanticCustomError

from antdsl import limits
from antdsl.program.model import Dimension
from antdsl.program.tables.units import describe_dimension, format_with_unit
from antdsl.scene.quantities import Quantity, QuantityError, parse_integer_range, parse_number, parse_quantity

_NAME_PATTERN = re.compile(r"[A-Za-z][A-Za-z0-9_]*", re.ASCII)
_MAX_WORD_CHARACTERS = 1000
LENGTH_DIMENSION, ANGLE_DIMENSION, TIME_DIMENSION, SPEED_DIMENSION = (
    Dimension(length=1),
    Dimension(angle=1),
    Dimension(time=1),
    Dimension(length=1, time=-1),
)
# The largest magnitudes, in base units. Larger values would overflow when squared, or lose all digits.
LARGEST_BY_DIMENSION = {
    LENGTH_DIMENSION: limits.MAX_SCENE_LENGTH,
    ANGLE_DIMENSION: limits.MAX_SCENE_ANGLE,
    TIME_DIMENSION: limits.MAX_SCENE_SECONDS,
    SPEED_DIMENSION: limits.MAX_SCENE_SPEED,
}
BASE_UNIT_BY_DIMENSION = {LENGTH_DIMENSION: "mm", ANGLE_DIMENSION: "rad", TIME_DIMENSION: "s", SPEED_DIMENSION: "mm/s"}


def make_value_error(message: str, help: str = "", **context: Any) -> PydanticCustomError:
    """Return an error with exactly this message, even if it contains braces. `context`: further data for the report of the
    error."""
    return PydanticCustomError("worded", "{words}", {"words": message, "help": help, **context})


def describe_value(value: Any) -> str:
    """Return words for a value of a scene, for a message: its text, shortened, or its kind."""
    if isinstance(value, str):
        return f"`{value if len(value) <= 60 else value[:57] + '…'}`"
    return "a list" if isinstance(value, list) else "a mapping"


def require_text(value: Any, expected_text: str) -> str:
    """Return a text without blanks at its ends. Raises an error for an empty text, or a value that is not a text."""
    if not isinstance(value, str):
        raise make_value_error(f"expected {expected_text} here, not {describe_value(value)}")
    if not value.strip():
        raise make_value_error(f"expected {expected_text} here, but the value is missing")
    return value.strip()


def parse_integer_between(low: int, high: int) -> Callable[[Any], int]:
    """Return a parser for decimal integers from `low` to `high`."""

    def read_integer(value: Any) -> int:
        text = require_text(value, "a whole number")
        if not re.fullmatch(r"[+-]?[0-9]{1,20}", text, re.ASCII):
            raise make_value_error(f"{describe_value(text)} is not a whole number", f"write digits only, {low} to {high}")
        if not low <= int(text) <= high:
            raise make_value_error(f"`{int(text)}` is not between {low} and {high}")
        return int(text)

    return read_integer


def parse_any_quantity(value: Any) -> Quantity:
    """Return the number with any unit, or without a unit, that a value stands for. Raises an error, which pydantic reports."""
    text = require_text(value, "a number")
    try:
        quantity = parse_quantity(text)
    except QuantityError as error:
        usual = "write a number and a unit of mm cm m u s min step rad deg turn mg g kg N uN %"
        raise make_value_error(f"{describe_value(text)} {error}", error.help or usual) from None
    return _limit_quantity(quantity, limits.MAX_SCENE_NUMBER)


def _limit_quantity(quantity: Quantity, largest: float, unit: str = "") -> Quantity:
    """Return the quantity unchanged. Raises an error if its number is larger than `largest`. `unit`: the unit of `largest`, for
    the message."""
    if abs(quantity.number) > largest:
        raise make_value_error(
            f"{describe_value(quantity.text)} is too large", f"write a number from {-largest:g} to {largest:g}{unit}"
        )
    return quantity


def parse_quantity_of(dim: Dimension) -> Callable[[Any], Quantity]:
    """Return a parser for quantities of one dimension. A number without a unit is in the scene's own unit (degrees for an
    angle)."""

    def read_quantity(value: Any) -> Quantity:
        quantity = parse_any_quantity(value)
        if quantity.has_no_unit and dim == ANGLE_DIMENSION:
            quantity = parse_quantity(f"{quantity.text} deg")
        if quantity.dim != dim and not quantity.has_no_unit:
            raise make_value_error(f"`{quantity.text}` is not {describe_dimension(dim)}", f"write `{format_with_unit(50, dim)}`")
        return _limit_quantity(quantity, LARGEST_BY_DIMENSION[dim], f" {BASE_UNIT_BY_DIMENSION[dim]}")

    return read_quantity


def parse_positive_quantity(dim: Dimension) -> Callable[[Any], Quantity]:
    """Return a parser for quantities of one dimension that are above zero."""
    inner = parse_quantity_of(dim)

    def read_positive_quantity(value: Any) -> Quantity:
        quantity = inner(value)
        if quantity.number <= 0:
            raise make_value_error(f"`{quantity.text}` is not above zero")
        if quantity.number < limits.MIN_POSITIVE_NUMBER:
            raise make_value_error(
                f"`{quantity.text}` is too small", f"write at least {limits.MIN_POSITIVE_NUMBER:g} {BASE_UNIT_BY_DIMENSION[dim]}"
            )
        return quantity

    return read_positive_quantity


def parse_number_between(low: float, high: float) -> Callable[[Any], float]:
    """Return a parser for decimal numbers without a unit, from `low` to `high`."""

    def read_number(value: Any) -> float:
        text = require_text(value, "a number")
        try:
            parsed_number = parse_number(text)
        except QuantityError as error:
            raise make_value_error(f"{describe_value(text)} {error}", error.help) from None
        if not low <= parsed_number <= high:
            raise make_value_error(
                f"`{text}` is not between {low:g} and {high:g}", f"write a number from `{low:g}` to `{high:g}`"
            )
        return parsed_number

    return read_number


def parse_share(value: Any) -> float:
    """Return the fraction, 0 to 1, that a text such as `30 %` or `0.3` stands for."""
    quantity = parse_any_quantity(value)
    if quantity.dim != Dimension() or not 0 <= quantity.number <= 1:
        raise make_value_error(f"`{quantity.text}` is not a share", "write a share from `0 %` to `100 %`")
    return quantity.number


def _check_name(value: Any) -> str:
    text = require_text(value, "a name")
    if not _NAME_PATTERN.fullmatch(text) or len(text) > limits.MAX_NAME_CHARACTERS:
        raise make_value_error(
            f"{describe_value(text)} is not a name", "names have letters, digits and `_`, and begin with a letter"
        )
    return text


def parse_condition(value: Any) -> str:
    """Return the text of a condition on one line. The condition is checked later, with the program."""
    text = " ".join(require_text(value, "a condition").split())
    if not text or len(text) > limits.MAX_LINE_CHARACTERS:
        raise make_value_error("this is not a condition", "write one such as `total(food.load) == 0`")
    return text


def parse_one_of(*words: str) -> Callable[[Any], str]:
    """Return a parser that accepts one of `words`."""

    def read_word(value: Any) -> str:
        from antdsl.diagnostics.suggestion import find_nearest_name

        text = require_text(value, "a word")
        if text not in words:
            near = find_nearest_name(text, words)
            listed = ", ".join(f"`{w}`" for w in words)
            raise make_value_error(
                f"{describe_value(text)} is none of {listed}", f"did you mean `{near}`?" if near else "write one of these"
            )
        return text

    return read_word


def _parse_fps(value: Any) -> Fraction:
    text = require_text(value, "a number of frames per second")
    if not re.fullmatch(r"[0-9]{1,7}(\.[0-9]{1,6}|/[0-9]{1,7})?", text, re.ASCII) or text.endswith("/0"):
        raise make_value_error(
            f"{describe_value(text)} is not a number of frames per second", "write `24`, `23.976` or `24000/1001`"
        )
    try:
        rate = Fraction(text)
    except ZeroDivisionError:
        raise make_value_error(f"{describe_value(text)} divides by zero", "write `24000/1001`") from None
    # the rates that users write as 23.976 or 29.97 are N·1000/1001
    for nominal in (24, 30, 48, 60, 120):
        exact = Fraction(nominal * 1000, 1001)
        if "." in text and abs(rate - exact) < Fraction(1, 200):
            rate = exact
    if not 1 <= rate <= limits.MAX_FPS:
        raise make_value_error(f"`{text}` frames per second is not between 1 and {limits.MAX_FPS}")
    return rate


class FrameRange(NamedTuple):
    """A first and a last frame, both included."""

    first: int
    last: int


# other separators that users write between two frames
_OTHER_RANGE_PATTERN = re.compile(r"\[?\s*(-?[0-9]{1,9})\s*(?:-|–|—|…|\.{3}|:|,|;|to|bis)\s*(-?[0-9]{1,9})\s*\]?", re.ASCII)


def parse_frame_range(text: str) -> FrameRange:
    """Return the frames that a text stands for. The text is a range such as `1001..1720`, or a single frame. Raises
    QuantityError with the reason."""
    try:
        first, last = parse_integer_range(text)
    except QuantityError:
        other = _OTHER_RANGE_PATTERN.fullmatch(text.strip())
        ends = sorted((int(other[1]), int(other[2]))) if other else []
        raise QuantityError("is not a range of frames", f"write `{ends[0]}..{ends[1]}`" if ends else "") from None
    if last < first:
        raise QuantityError("ends before it begins")
    if last - first >= limits.MAX_FRAMES:
        raise QuantityError(f"has more than {limits.MAX_FRAMES:,} frames")
    return FrameRange(first, last)


def _parse_frame_range(value: Any) -> FrameRange:
    text = ",".join(value) if isinstance(value, list) and all(isinstance(v, str) for v in value) else value
    text = require_text(text, "a range of frames")
    try:
        return parse_frame_range(text)
    except QuantityError as error:
        usual = "write the first and the last frame with two dots between: `1001..1240`"
        raise make_value_error(f"{describe_value(text)} {error}", error.help or usual) from None


def _check_path(value: Any) -> str:
    text = require_text(value, "the path of a file")
    if text != value:
        raise make_value_error(f"the path {describe_value(value)} begins or ends with a space", f"write `{text}`")
    return text


def parse_word_or_file(*words: str) -> Callable[[Any], str]:
    """Return a parser that accepts one of `words` or the path of a file. A text with a dot or a slash counts as a path."""

    def read_word_or_file(value: Any) -> str:
        text = require_text(value, "a word, or the path of a file,")
        if "." in text or "/" in text:
            return _check_path(value)
        if text not in words:
            from antdsl.diagnostics.suggestion import find_nearest_name

            near, listed = find_nearest_name(text, words), ", ".join(f"`{each}`" for each in words)
            help = f"did you mean `{near}`?" if near else f"write one of these, or a file such as `{text[:40]}.glb`"
            raise make_value_error(f"{describe_value(text)} is none of {listed}, and not a file", help)
        return text

    return read_word_or_file


def _check_word(value: Any) -> str:
    text = require_text(value, "a word")
    if len(text) > _MAX_WORD_CHARACTERS:
        raise make_value_error(f"{describe_value(text)} is too long")
    return text


SceneWord = Annotated[str, BeforeValidator(_check_word)]
SceneName = Annotated[str, BeforeValidator(_check_name)]
FilePath = Annotated[str, BeforeValidator(_check_path)]
AnyQuantity = Annotated[Quantity, BeforeValidator(parse_any_quantity)]
Length = Annotated[Quantity, BeforeValidator(parse_quantity_of(LENGTH_DIMENSION))]


def parse_word_or_quantity(word: str, parse_other: Callable[[Any], Quantity]) -> Callable[[Any], Quantity | str]:
    """Return a parser that accepts `word`, or a quantity that `parse_other` parses."""
    return lambda value: word if str(value) == word else parse_other(value)


def _parse_length_range(value: Any) -> tuple[Quantity, Quantity]:
    """Return the two ends of a range such as `-35 mm .. 35 mm`. The second must be above the first."""
    text = require_text(value, "a range of lengths")
    first, dots, last = text.partition("..")
    if not dots:
        raise make_value_error(f"{describe_value(text)} is not a range of lengths", "write both ends: `-35 mm .. 35 mm`")
    read_length = parse_quantity_of(LENGTH_DIMENSION)
    low, high = read_length(first), read_length(last)
    if low.has_no_unit != high.has_no_unit:
        raise make_value_error(f"only one end of `{text}` has a unit", "write both ends with a unit: `-35 mm .. 35 mm`")
    if not low.number < high.number:
        raise make_value_error(f"`{text}` does not end above its start", "write the smaller number first")
    return low, high


LengthRange = Annotated[tuple[Quantity, Quantity], BeforeValidator(_parse_length_range)]
PositiveLength = Annotated[Quantity, BeforeValidator(parse_positive_quantity(LENGTH_DIMENSION))]
PositiveSpeed = Annotated[Quantity, BeforeValidator(parse_positive_quantity(SPEED_DIMENSION))]
PositiveTime = Annotated[Quantity, BeforeValidator(parse_positive_quantity(TIME_DIMENSION))]
Angle = Annotated[Quantity, BeforeValidator(parse_quantity_of(ANGLE_DIMENSION))]
FramesPerSecond = Annotated[Fraction, BeforeValidator(_parse_fps)]
FrameRangeValue = Annotated[FrameRange, BeforeValidator(_parse_frame_range)]


PointValue = tuple[Length, Length, Length]


class ScenePart(BaseModel):
    """A mapping of a scene. Unknown keys are errors."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, populate_by_name=False, arbitrary_types_allowed=True, hide_input_in_errors=True
    )


class PositionKey(ScenePart):
    """The position of a thing at one frame. The thing moves evenly from one key to the next, and does not move before the
    first key and after the last."""

    at: PointValue | None = None
    rotate: tuple[Angle, Angle, Angle] | None = None


PositionKeysByFrame = dict[
    Annotated[int, BeforeValidator(parse_integer_between(-limits.MAX_FRAMES, limits.MAX_FRAMES * 1000))], PositionKey
]


def _find_point_type_tag(value: Any) -> str:
    return "point" if isinstance(value, list) else "named"


PointOrName = Annotated[
    Annotated[PointValue, Tag("point")] | Annotated[SceneName, Tag("named")], Discriminator(_find_point_type_tag)
]
