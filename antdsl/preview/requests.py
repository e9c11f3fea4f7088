"""The requests that a page may send: one model for each `op`. All other messages are rejected.

No request can write a file. Only edits may name files, which must be in the folder of the scene or below it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, TypeAdapter

NameText = Annotated[str, StringConstraints(min_length=1, max_length=200)]
NonEmptyText = Annotated[str, StringConstraints(min_length=1, max_length=2000)]
FrameNumber = Annotated[int, Field(ge=-(2**53), le=2**53)]  # the range of integers in JavaScript
AgentId = Annotated[int, Field(ge=0, le=2**53)]
MAX_PLANNED_AGENTS = 300  # maximum number of agents with planned paths displayed at the same time


class RequestRefusedError(Exception):
    """Error for a request that cannot be carried out. The message gives the reason and suggests an alternative."""

    def __init__(self, message: str, help: str = "") -> None:
        super().__init__(message)
        self.message, self.help = message, help


class _RequestModel(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Play(_RequestModel):
    """Play from the current frame on."""

    op: Literal["play"]


class Pause(_RequestModel):
    """Pause, and drop pending steps."""

    op: Literal["pause"]


class Step(_RequestModel):
    """Simulate `count` frames as fast as possible."""

    op: Literal["step"]
    count: int = Field(1, ge=1, le=1000)


class SetSpeed(_RequestModel):
    """Set the speed of play: 1 is real time as the scene defines it, 0 is as fast as possible."""

    op: Literal["speed"]
    times: float = Field(ge=0, le=64)


class Seek(_RequestModel):
    """Go to a frame. `exact`: false while a slider is dragged. The stored agents of the frame are then displayed without
    simulation."""

    op: Literal["seek"]
    frame: FrameNumber
    exact: bool


class SetValue(_RequestModel):
    """Set a param, or a setting of a field, to a number with a unit."""

    op: Literal["set"]
    name: NameText
    value: NonEmptyText


class SwitchLayer(_RequestModel):
    """Switch a layer of a species on or off. The layer is identified by its text."""

    op: Literal["layer"]
    species: NameText
    layer: NonEmptyText
    on: bool


class SwitchField(_RequestModel):
    """Switch a field on or off."""

    op: Literal["field"]
    name: NameText
    on: bool


LineList = Literal["notes", "edits"]


class DraftLine(_RequestModel):
    """Check a note or an edit, and add it if `apply` is true. `agents`: the value of the verb. `values`: the values of the other
    keys."""

    op: Literal["direct"]
    list: LineList
    verb: NameText
    agents: Annotated[str, StringConstraints(max_length=4000)]
    values: dict[NameText, NonEmptyText] = Field(default_factory=dict, max_length=32)
    apply: bool = False


class SwitchLine(_RequestModel):
    """Switch a note or an edit on or off, or remove it. Only lines that were added on pages can be switched."""

    op: Literal["line"]
    list: LineList
    key: int = Field(ge=0, le=2**53)
    action: Literal["on", "off", "remove"]


class Settle(_RequestModel):
    """Simulate again the agents that edits affect, in all simulated frames. `on`: if false, stop this and remove its result."""

    op: Literal["settle"]
    on: bool


class Reload(_RequestModel):
    """Load the current files."""

    op: Literal["reload"]


class Restart(_RequestModel):
    """Simulate again from the first frame."""

    op: Literal["restart"]


class ColumnRef(_RequestModel):
    """An attribute of a species, by name."""

    species: NameText
    name: NameText


class AgentRef(_RequestModel):
    """One agent: its species and its id."""

    species: NameText
    agent: AgentId


class SetDisplay(_RequestModel):
    """Set everything that a page displays in addition to the agents. Each request replaces the previous one.

    `columns`, `fields`, `flows`: the names of the columns, fields and flows to display.
    `solids`: whether solids are displayed.
    `follow`: the agent for which feelers are displayed.
    `planned`: the agents for which planned paths are displayed; None for no agents. An empty tuple means all agents, if there
    are at most 300."""

    op: Literal["look"]
    columns: tuple[ColumnRef, ...] = Field((), max_length=64)
    fields: tuple[NameText, ...] = Field((), max_length=64)
    flows: tuple[NameText, ...] = Field((), max_length=64)
    solids: bool = True
    follow: AgentRef | None = None
    planned: tuple[AgentRef, ...] | None = Field(None, max_length=64)


class Explain(_RequestModel):
    """Ask why an agent acted as it did in the step that leads to `frame`."""

    op: Literal["explain"]
    species: NameText
    agent: AgentId
    frame: FrameNumber


class StateBreak(_RequestModel):
    """A breakpoint that is hit when an agent enters a state."""

    kind: Literal["state"]
    species: NameText
    machine: NameText
    state: NameText


class ConditionBreak(_RequestModel):
    """A breakpoint that is hit when a condition becomes true. `text`: the condition in the language of specs."""

    kind: Literal["condition"]
    text: NonEmptyText


class SpecBreak(_RequestModel):
    """A breakpoint that is hit when a spec fails."""

    kind: Literal["spec"]
    spec: NameText


class FaultBreak(_RequestModel):
    """A breakpoint that is hit when any agent has a fault."""

    kind: Literal["fault"]


AnyBreak = Annotated[StateBreak | ConditionBreak | SpecBreak | FaultBreak, Field(discriminator="kind")]


class SetBreakpoints(_RequestModel):
    """Replace all breakpoints. `tried`: an additional breakpoint, which is added only if it matches the program."""

    op: Literal["breaks"]
    breaks: tuple[AnyBreak, ...] = Field((), max_length=64)
    tried: AnyBreak | None = None


class SwitchProfile(_RequestModel):
    """Start or stop the messages about the costs of steps."""

    op: Literal["profile"]
    on: bool


AnyRequest = Annotated[
    Play
    | Pause
    | Step
    | SetSpeed
    | Seek
    | SetValue
    | SwitchLayer
    | SwitchField
    | DraftLine
    | SwitchLine
    | Settle
    | Reload
    | Restart
    | SetDisplay
    | Explain
    | SetBreakpoints
    | SwitchProfile,
    Field(discriminator="op"),
]
REQUEST_ADAPTER: TypeAdapter[AnyRequest] = TypeAdapter(AnyRequest)
