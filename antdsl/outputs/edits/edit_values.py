"""Types of values in the lines of edits, as pydantic types that parse text."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from pydantic import BeforeValidator

from antdsl import limits
from antdsl.program.model import Dimension
from antdsl.scene.notes.note_values import DEFAULT_EASE_FRAMES as DEFAULT_EASE_FRAMES
from antdsl.scene.notes.note_values import FrameCount as FrameCount
from antdsl.scene.quantities import Quantity, QuantityError, parse_quantity
from antdsl.scene.values import make_value_error, parse_integer_between

MAX_FACTOR = 100.0
FrameOffset = Annotated[int, BeforeValidator(parse_integer_between(-limits.MAX_FRAMES, limits.MAX_FRAMES))]


def parse_factor(low: float) -> Callable[[Any], float]:
    """Return a parser of factors from `low` to MAX_FACTOR, such as `50 %` or `0.5`."""

    def read_factor(value: Any) -> float:
        try:
            quantity = parse_quantity(value) if isinstance(value, str) else Quantity(-1, Dimension(), "", "")
        except QuantityError as why:
            raise make_value_error(f"`{value[:60]}` {why}", why.help or "write `50 %`") from None
        if quantity.dim != Dimension() or not low <= quantity.number <= MAX_FACTOR:
            raise make_value_error(f"`{str(value)[:60]}` is not a factor", f"write `{100 * low:g} %` to `{100 * MAX_FACTOR:g} %`")
        return quantity.number

    return read_factor


Speed = Annotated[float, BeforeValidator(parse_factor(0.0))]
Factor = Annotated[float, BeforeValidator(parse_factor(0.01))]
