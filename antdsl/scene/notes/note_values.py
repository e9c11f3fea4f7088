"""The kinds of values in notes, as pydantic types that are parsed from text."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from pydantic import BeforeValidator

from antdsl import limits
from antdsl.program.model import Dimension
from antdsl.scene.quantities import Quantity
from antdsl.scene.values import describe_value, make_value_error, parse_any_quantity, parse_integer_between, parse_share

DEFAULT_EASE_FRAMES = 6
_MAX_EASE_FRAMES = 10_000
FrameNumber = Annotated[int, BeforeValidator(parse_integer_between(-limits.MAX_FRAMES, limits.MAX_FRAMES * 1000))]
FrameCount = Annotated[int, BeforeValidator(parse_integer_between(0, _MAX_EASE_FRAMES))]
ShareValue = Annotated[float, BeforeValidator(parse_share)]


def _parse_share_up_to_all(excess: str, advice: str) -> Callable[[Any], float]:
    """Return a parser of percentages up to 100 %. `excess`: the message for a larger value. `advice`: what to write instead."""

    def parse(value: Any) -> float:
        quantity = parse_any_quantity(value)
        if quantity.dim == Dimension() and quantity.number > 1:
            raise make_value_error(f"`{quantity.text}` is {excess}", advice)
        return parse_share(value)

    return parse


_parse_thin_share = _parse_share_up_to_all(
    "more than all: a note adds no agents", "write a larger `count` in the crowd, or duplicate agents of the cache by an edit"
)
_parse_speed_share = _parse_share_up_to_all(
    "faster than these agents can move: `max_speed` is their limit",
    "give them a greater one, `{set: …, to: {max_speed: 60 mm/s}}`, or retime the cache by an edit",
)
ThinShare = Annotated[float, BeforeValidator(_parse_thin_share)]
SpeedShare = Annotated[float, BeforeValidator(_parse_speed_share)]


def _parse_share_range(value: Any) -> tuple[float, float]:
    """Return the two fractions in a list `[A, B]`, which are the lower and upper end of a range."""
    if not isinstance(value, list) or len(value) != 2:
        raise make_value_error(f"{describe_value(value)} is not a part of a picture", "write `[0 %, 33 %]`")
    first, last = map(parse_share, value)
    if first >= last:
        raise make_value_error("this part of the picture is empty", f"write the smaller share first: `[{value[1]}, {value[0]}]`")
    return first, last


ShareRange = Annotated[tuple[float, float], BeforeValidator(_parse_share_range)]


def _parse_set_value(value: Any) -> Quantity | bool:
    if isinstance(value, str) and value.strip() in ("true", "false"):
        return value.strip() == "true"
    return parse_any_quantity(value)


SetValue = Annotated[Quantity | bool, BeforeValidator(_parse_set_value)]
