"""The requests that a page may send: one model per `op`. All other messages are rejected. No request can write a file or name a
path."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, TypeAdapter

Name = Annotated[str, StringConstraints(min_length=1, max_length=200)]
Words = Annotated[str, StringConstraints(min_length=1, max_length=2000)]
Frame = Annotated[int, Field(ge=-(2**53), le=2**53)]  # what a page's numbers hold
Agent = Annotated[int, Field(ge=0, le=2**53)]
MAX_PLANNED_AGENTS = 300  # agents with planned paths displayed all at once, at most


class Refusal(Exception):
    """A request that cannot be carried out: the reason, and an alternative."""

    def __init__(self, message: str, help: str = "") -> None:
        super().__init__(message)
        self.message, self.help = message, help


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Play(_Model):
    """Play from the current frame on."""

    op: Literal["play"]


class Pause(_Model):
    """Pause, and drop pending steps."""

    op: Literal["pause"]


class Step(_Model):
    """Simulate `count` frames as fast as possible."""

    op: Literal["step"]
    count: int = Field(1, ge=1, le=1000)


class Speed(_Model):
    """Set the speed of play: 1 is the scene's own speed, 0 is as fast as possible."""

    op: Literal["speed"]
    times: float = Field(ge=0, le=64)


class Seek(_Model):
    """Go to a frame. `exact` is false while a slider is dragged: then the stored agents of the frame are displayed without
    simulation."""

    op: Literal["seek"]
    frame: Frame
    exact: bool


class Set(_Model):
    """Set a param, or a setting of a field, to a number with its unit."""

    op: Literal["set"]
    name: Name
    value: Words


class Layer(_Model):
    """Switch a layer of a species on or off. The layer is identified by its text."""

    op: Literal["layer"]
    species: Name
    layer: Words
    on: bool


class Field_(_Model):
    """Switch a field on or off."""

    op: Literal["field"]
    name: Name
    on: bool


class Reload(_Model):
    """Load the current files."""

    op: Literal["reload"]


class Restart(_Model):
    """Simulate again from the first frame."""

    op: Literal["restart"]


class Column(_Model):
    """An attribute of a species, by name."""

    species: Name
    name: Name


class AgentRef(_Model):
    """One agent: its species and its id."""

    species: Name
    agent: Agent


class Look(_Model):
    """Set all that a page displays in addition to the agents. A new request replaces the previous one.

    `columns`, `fields`, `flows`: the displayed ones, by name.
    `solids`: whether solids are displayed.
    `follow`: the followed agent.
    `planned`: the agents with displayed future paths; None for none. An empty tuple means all agents, if there are at most 300.
    """

    op: Literal["look"]
    columns: tuple[Column, ...] = Field((), max_length=64)
    fields: tuple[Name, ...] = Field((), max_length=64)
    flows: tuple[Name, ...] = Field((), max_length=64)
    solids: bool = True
    follow: AgentRef | None = None
    planned: tuple[AgentRef, ...] | None = Field(None, max_length=64)


class Explain(_Model):
    """Request why an agent acted as it did in the step to a frame."""

    op: Literal["explain"]
    species: Name
    agent: Agent
    frame: Frame


class StateBreak(_Model):
    """A breakpoint on entering a state."""

    kind: Literal["state"]
    species: Name
    machine: Name
    state: Name


class ConditionBreak(_Model):
    """A breakpoint on a condition. `text`: the condition in the language of specs."""

    kind: Literal["condition"]
    text: Words


class SpecBreak(_Model):
    """A breakpoint on a failing spec."""

    kind: Literal["spec"]
    spec: Name


class FaultBreak(_Model):
    """A breakpoint on a fault of any agent."""

    kind: Literal["fault"]


Break = Annotated[StateBreak | ConditionBreak | SpecBreak | FaultBreak, Field(discriminator="kind")]


class Breaks(_Model):
    """Replace all breakpoints. `tried`: one more breakpoint, which is added only if it matches the program."""

    op: Literal["breaks"]
    breaks: tuple[Break, ...] = Field((), max_length=64)
    tried: Break | None = None


class Profile(_Model):
    """Start or stop the messages with the costs of steps."""

    op: Literal["profile"]
    on: bool


Ask = Annotated[
    Play | Pause | Step | Speed | Seek | Set | Layer | Field_ | Reload | Restart | Look | Explain | Breaks | Profile,
    Field(discriminator="op"),
]
ASK: TypeAdapter[Ask] = TypeAdapter(Ask)
