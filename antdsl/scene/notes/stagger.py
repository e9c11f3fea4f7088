"""The key `stagger` of notes, which delays the frames of a note differently for each agent."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, Field, model_validator

from antdsl.scene.notes.note_values import FrameCount
from antdsl.scene.notes.selectors import NearTarget
from antdsl.scene.values import PositiveSpeed, ScenePart, describe_value, make_value_error, parse_one_of

_STAGGER_FORMS = "write `{from: [0, 0, 0], speed: 40 mm/s}`, `{each: 2}` or `{random: 12}`"


class Stagger(ScenePart):
    """The delay of a note for each agent.

    `from`, `speed`: a wave that starts at a target and spreads at this speed. Each agent begins when the wave arrives.
    `each`: the number of frames between one agent and the next, in the order of ids, or of the distance from the target
    `from`.
    `random`: the largest delay in frames; each agent gets a random one.
    `ends`: `later`, so that the note ends later by the same delay, or `together`, so that it ends for all agents at once."""

    origin: NearTarget | None = Field(None, alias="from")
    speed: PositiveSpeed | None = None
    each: FrameCount | None = None
    random: FrameCount | None = None
    ends: Annotated[str, BeforeValidator(parse_one_of("later", "together"))] = "later"

    @model_validator(mode="after")
    def _check_kind(self) -> Stagger:
        kinds = [name for name in ("speed", "each", "random") if getattr(self, name) is not None]
        if not kinds:
            raise make_value_error("this does not define a delay for each agent", _STAGGER_FORMS)
        if len(kinds) > 1:
            raise make_value_error(f"`{kinds[0]}` and `{kinds[1]}` exclude each other", _STAGGER_FORMS)
        if self.speed is not None and self.origin is None:
            raise make_value_error(
                "`speed` has no effect without `from`", f"write `{{from: [0, 0, 0], speed: {self.speed.text}}}`"
            )
        if self.random is not None and self.origin is not None:
            raise make_value_error(
                "`from` has no effect with `random`", "write `{from: …, speed: 40 mm/s}`, or only `{random: 12}`"
            )
        return self


def require_stagger(value: object) -> object:
    """Return a value unchanged. Raises an error, which pydantic reports, for a text or a list."""
    if not isinstance(value, dict):
        raise make_value_error(f"{describe_value(value)} does not define a delay for each agent", _STAGGER_FORMS)
    return value


StaggerValue = Annotated[Stagger, BeforeValidator(require_stagger)]
