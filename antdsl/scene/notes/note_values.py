"""Kinds of values in notes, as pydantic types over text."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator

from antdsl import limits
from antdsl.program.model import Dimension
from antdsl.scene.values import describe_value, make_error, parse_any_quantity, parse_integer_between, parse_share

DEFAULT_EASE_FRAMES = 6
_MAX_EASE_FRAMES = 10_000
FrameNumber = Annotated[int, BeforeValidator(parse_integer_between(-limits.MAX_FRAMES, limits.MAX_FRAMES * 1000))]
FrameCount = Annotated[int, BeforeValidator(parse_integer_between(0, _MAX_EASE_FRAMES))]
Share = Annotated[float, BeforeValidator(parse_share)]


def _parse_thin_share(value: Any) -> float:
    """Return a share of agents that stay. A greater one is an error: notes add no agents."""
    quantity = parse_any_quantity(value)
    if quantity.dim == Dimension() and quantity.number > 1:
        words = f"`{quantity.text}` is more than all: a note adds no agents"
        raise make_error(words, "write a larger `count` in the crowd, or duplicate agents of the cache by an edit")
    return parse_share(value)


ThinShare = Annotated[float, BeforeValidator(_parse_thin_share)]


def _parse_share_range(value: Any) -> tuple[float, float]:
    """Return the shares from A to B of a list `[A, B]`."""
    if not isinstance(value, list) or len(value) != 2:
        raise make_error(f"{describe_value(value)} is not a part of a picture", "write `[0 %, 33 %]`")
    first, last = map(parse_share, value)
    if first >= last:
        raise make_error("this part of the picture is empty", f"write the smaller share first: `[{value[1]}, {value[0]}]`")
    return first, last


ShareRange = Annotated[tuple[float, float], BeforeValidator(_parse_share_range)]


def _parse_speed_share(value: Any) -> float:
    """Return a share of a speed. A greater one is an error: no note takes an agent over its own limit."""
    quantity = parse_any_quantity(value)
    if quantity.dim == Dimension() and quantity.number > 1:
        words = f"`{quantity.text}` is faster than these agents can move: `max_speed` is their limit"
        raise make_error(words, "give them a greater one, `{set: …, to: {max_speed: 60 mm/s}}`, or retime the cache by an edit")
    return parse_share(value)


SpeedShare = Annotated[float, BeforeValidator(_parse_speed_share)]
