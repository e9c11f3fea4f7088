"""The keys of a crowd line that describe how agents start: their attributes, placement shapes, directions, and frames.

Values of attributes remain texts here, because their dimensions are known only with the program."""

from __future__ import annotations

import re
from fractions import Fraction
from typing import Annotated, Any, NamedTuple

from pydantic import BeforeValidator, Discriminator, Field, Tag

from antdsl import limits
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.program.model import Dimension
from antdsl.scene.quantities import Quantity, QuantityError, parse_quantity, split_quantity
from antdsl.scene.values import (
    AnyQuantity,
    PointOrName,
    PositiveLength,
    SceneName,
    ScenePart,
    describe_value,
    make_value_error,
    parse_integer_between,
    parse_number_between,
    require_text,
)

_KEY_PATTERN = re.compile(r"[A-Za-z][A-Za-z0-9_]*(\.state)?", re.ASCII)
_SECONDS_PATTERN = re.compile(r"([0-9]{1,7}(?:\.[0-9]{1,6})?)\s*(?:s\s*)?\.\.\s*([0-9]{1,7}(?:\.[0-9]{1,6})?)\s*(?:s)?", re.ASCII)


def _parse_rate(value: Any) -> Quantity:
    text = require_text(value, "a rate such as `20 /s`")
    try:
        quantity = parse_quantity(text)
    except QuantityError as error:
        raise make_value_error(f"{describe_value(text)} {error}", error.help or "write `20 /s`") from None
    if quantity.dim != Dimension(time=-1):
        raise make_value_error(f"`{quantity.text}` is not a rate", f"write `{quantity.text.split()[0][:20]} /s`")
    if not 0 < quantity.number <= limits.MAX_SCENE_NUMBER:
        raise make_value_error(
            f"`{quantity.text}` is not above zero" if quantity.number <= 0 else f"`{quantity.text}` is too large"
        )
    return quantity


ChoiceWeight = Annotated[float, BeforeValidator(parse_number_between(limits.MIN_BODY_WEIGHT, limits.MAX_BODY_WEIGHT))]
ReleaseRate = Annotated[Quantity, BeforeValidator(_parse_rate)]
AgentCount = Annotated[int, BeforeValidator(parse_integer_between(1, limits.MAX_AGENTS))]


class TimeRange(NamedTuple):
    """A time interval in seconds from the scene's first frame."""

    begin: Fraction
    end: Fraction


def _parse_seconds(value: Any) -> TimeRange:
    text = require_text(value, "two times")
    match = _SECONDS_PATTERN.fullmatch(text)
    if match is None:
        raise make_value_error(
            f"{describe_value(text)} is not a time interval", "write two times from the first frame on: `2 s .. 4 s`"
        )
    begin, end = Fraction(match[1]), Fraction(match[2])
    if end <= begin:
        raise make_value_error(f"{describe_value(text)} ends before it begins", f"write `{match[2]} s .. {match[1]} s`")
    return TimeRange(begin, end)


TimeRangeValue = Annotated[TimeRange, BeforeValidator(_parse_seconds)]


class UniformRandomValue(ScenePart):
    """A random number between two bounds. All numbers between them are equally likely."""

    uniform: tuple[AnyQuantity, AnyQuantity]


class NormalRandomValue(ScenePart):
    """A random number from a normal distribution with this mean and standard deviation, cut off at three deviations from the
    mean."""

    normal: tuple[AnyQuantity, AnyQuantity]


class WeightedChoice(ScenePart):
    """One of several values, drawn at random. A value of weight 3 is three times as likely as one of weight 1: `{choice: {0:
    3, 5: 1}}`."""

    choice: Annotated[dict[str, ChoiceWeight], Field(min_length=1, max_length=64)]


class PaintedMapValue(ScenePart):
    """A value that depends on a painted map at the position of the agent. It is `from` where the map is 0, and `to` where the
    map is 1."""

    painted: SceneName
    low: AnyQuantity | None = Field(None, alias="from")
    high: AnyQuantity | None = Field(None, alias="to")


RANDOM_VALUE_MODELS: dict[str, type[ScenePart]] = {
    "uniform": UniformRandomValue, "normal": NormalRandomValue, "choice": WeightedChoice, "painted": PaintedMapValue,
}  # fmt: skip


def _find_draw_type_tag(value: Any) -> str:
    if not isinstance(value, dict):
        return "one-value"
    known = next((key for key in RANDOM_VALUE_MODELS if key in value), None)
    meant = (find_nearest_name(str(key), RANDOM_VALUE_MODELS) for key in value)
    return f"{known or next((key for key in meant if key), 'uniform')}-draw"


def _check_initial_value(value: Any) -> str:
    return require_text(value, "a value or one of `{uniform: [A, B]}`, `{normal: [A, B]}`, `{choice: {A: 3, B: 1}}`")


def _check_initial_value_key(value: Any) -> str:
    text = require_text(value, "the name of an attribute")
    if not _KEY_PATTERN.fullmatch(text):
        raise make_value_error(f"{describe_value(text)} is no attribute", "write an attribute, `state`, or `MACHINE.state`")
    return text


InitialValue = Annotated[
    Annotated[str, BeforeValidator(_check_initial_value), Tag("one-value")]
    | Annotated[UniformRandomValue, Tag("uniform-draw")]
    | Annotated[NormalRandomValue, Tag("normal-draw")]
    | Annotated[WeightedChoice, Tag("choice-draw")]
    | Annotated[PaintedMapValue, Tag("painted-draw")],
    Discriminator(_find_draw_type_tag),
]
InitialValues = dict[Annotated[str, BeforeValidator(_check_initial_value_key)], InitialValue]


class RankFormation(ScenePart):
    """Agents in ranks, one rank behind the other, around the point `around`. The first agents are in the front rank.

    `columns`: the number of agents in each rank.
    `spacing`: the distance between neighbours. Write two lengths for different distances within a rank and between ranks."""

    columns: AgentCount
    spacing: PositiveLength | tuple[PositiveLength, PositiveLength]


class ClumpFormation(ScenePart):
    """Agents in groups. `number`: how many groups. `radius`: the radius of the disc of each group. The discs have random
    positions."""

    number: Annotated[int, BeforeValidator(parse_integer_between(1, 100_000))]
    radius: PositiveLength


class FacingDirection(ScenePart):
    """A direction along the axes of the scene."""

    direction: tuple[
        Annotated[float, BeforeValidator(parse_number_between(-1e6, 1e6))],
        Annotated[float, BeforeValidator(parse_number_between(-1e6, 1e6))],
        Annotated[float, BeforeValidator(parse_number_between(-1e6, 1e6))],
    ]


FACING_WORDS = ("out", "in", "along")


def _find_facing_type_tag(value: Any) -> str:
    return "direction-facing" if isinstance(value, dict) else "place-facing"


FacingValue = Annotated[
    Annotated[FacingDirection, Tag("direction-facing")] | Annotated[PointOrName, Tag("place-facing")],
    Discriminator(_find_facing_type_tag),
]


def convert_rate(text: str, fps: Fraction) -> Fraction:
    """Return a rate such as `20 /s` as an exact number per second."""
    from antdsl.program.tables.units import find_unit_measure

    try:
        digits, unit = split_quantity(text)
    except QuantityError:  # the model has parsed it
        return Fraction(0)
    known = find_unit_measure(unit)
    factor = Fraction(1) if known is None else Fraction(known.factor).limit_denominator(1_000_000)
    return Fraction(digits) * factor * (fps ** int(-known.step) if known is not None and known.step else 1)
