"""The explanation of one agent's step, as immutable values that can be written as JSON. Numbers are in the units that authors
use."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

FORMAT_VERSION = 1
FloatTriple = tuple[float, float, float]
PlainValue = float | bool | str | None | FloatTriple


@dataclass(frozen=True, slots=True)
class SourceLocation:
    """The location of a text in a program: the text on one line, its file and its line number."""

    text: str
    file: str
    line: int


@dataclass(frozen=True, slots=True)
class ExpressionPart:
    """A part of a condition.

    - `text`: the part as in the source. `value`: its value in `unit`. `shown`: the value as text, in the form that authors
      write.
    - `role`: "draw" for the random number of a `chance`, and "bar" for the limit with which this number is compared. "joined"
      for a part that only joins other parts, such as `and` or `<`. "" for all other parts."""

    text: str
    value: PlainValue
    unit: str
    shown: str
    role: str = ""
    parts: tuple[ExpressionPart, ...] = ()


@dataclass(frozen=True, slots=True)
class TimerReading:
    """A timer of a transition.

    `what`: "held", "after" or "at least". `has`, `needs`: the elapsed and the required time. They are in steps for "held",
    otherwise in seconds since the agent entered the state. `holds`: whether the required time has elapsed."""

    what: str
    has: float
    needs: float
    unit: str
    holds: bool


@dataclass(frozen=True, slots=True)
class TransitionReport:
    """A transition that was checked in a step.

    - `kind`: interrupt, from any, or when.
    - `held`: whether the condition was true. `fires`: whether the condition was true and all timers had elapsed.
    - `wins`: whether this is the transition that the machine took."""

    place: SourceLocation
    kind: str
    target: str
    condition: ExpressionPart | None
    held: bool
    timers: tuple[TimerReading, ...]
    take: ExpressionPart | None
    fires: bool
    wins: bool


@dataclass(frozen=True, slots=True)
class ClaimResult:
    """The result of one claim by the agent. `amount`: the requested amount; None means everything. `draw`: a random number;
    claims with smaller numbers are granted first. `won`: whether the claim was granted. `items`, `item`, `attribute`: the
    group, the item and the attribute from which the amount was claimed. For a claim from a field, `items` and `item` are the
    name of the field, and `attribute` may be empty."""

    items: str
    item: str
    attribute: str
    amount: float | None
    draw: float
    won: bool
    place: SourceLocation


@dataclass(frozen=True, slots=True)
class ChoiceResult:
    """A random choice among states.

    `draw`: the random number, from 0 to 1. `bars`: the range 0 to 1 is divided into one part for each state; these are the upper
    limits of the parts. `chosen`: the chosen state."""

    draw: float
    bars: tuple[tuple[str, float], ...]
    chosen: str


@dataclass(frozen=True, slots=True)
class MachineStep:
    """The decisions of one machine in a step.

    - `before`, `after`: the states before and after the step. `since`: the seconds that the agent has spent in `before`.
    - `looked`: the transitions that were checked, in order. `changed`: whether the machine took one of these transitions."""

    machine: str
    before: str
    after: str
    since: float
    looked: tuple[TransitionReport, ...]
    changed: bool
    claim: ClaimResult | None
    choice: ChoiceResult | None


@dataclass(frozen=True, slots=True)
class LayerReport:
    """The result of one layer in a step.

    - `state`: "pushed", "nothing" (the push was zero), "off" (the condition was false) or "no strength" (earlier layers used
      all).
    - `left`: the strength that earlier layers have left over for this one, from 0 to 1.
    - `push`: the push that the layer requested. `length`: its length.
    - `given`: the part of the push that took effect. `share`: the length of this part, as a fraction of the complete budget.
    - `cut`: the length by which the push was reduced."""

    place: SourceLocation
    state: str
    condition: ExpressionPart | None
    left: float
    push: FloatTriple | None
    length: float
    given: FloatTriple
    share: float
    cut: float


@dataclass(frozen=True, slots=True)
class SteeringLine:
    """A `steer` or `face` line that ran, and the push that it requested. `part`: `state` for a line of a state, or `layers` for
    a line of a layer."""

    text: str
    push: FloatTriple
    length: float
    part: str = "state"


@dataclass(frozen=True, slots=True)
class NearbyObject:
    """Another agent or an item near the agent.

    `name`: the id of the agent or the name of the item. `distance`: the distance in mm. `about`: a text with its states or
    amounts."""

    name: str
    distance: float
    about: str


@dataclass(frozen=True, slots=True)
class ObservedSet:
    """A set of agents or items that the agent has searched.

    The fields are: the text of the set in the program, the species or items, the number of members, and the nearest members."""

    asked: str
    of: str
    count: int
    nearest: tuple[NearbyObject, ...]


@dataclass(frozen=True, slots=True)
class SenseReading:
    """The reading of a sense. `kind`: ray, obstacle, curve, flow, map or field. `shown`: the result as text."""

    kind: str
    name: str
    text: str
    shown: str
    values: tuple[PlainValue, ...]


@dataclass(frozen=True, slots=True)
class RandomDraw:
    """A random draw: the stable name of its code site, the program text that requested it, and its value."""

    site: str
    text: str
    value: float


@dataclass(frozen=True, slots=True)
class ChangedValue:
    """An attribute or a memory that has changed, with its values before and after the step."""

    name: str
    before: PlainValue
    after: PlainValue
    unit: str
    shown: tuple[str, str]
    memory: bool = False


@dataclass(frozen=True, slots=True)
class StateInterval:
    """A range of frames in which a machine was in one state. Both ends are included."""

    machine: str
    state: str
    first: int
    last: int


@dataclass(frozen=True, slots=True)
class Explanation:
    """The report on one agent in the step to `frame`.

    - `hash`: the hash of the complete state at `frame`. It is equal to the hash in the cache.
    - `checkpoint`: the frame from which the run was simulated again.
    - `mode`: how the layers are combined.
    - `strip`: the states of each machine over time. If the run is read from a cache, there are only the states of the first
      machine.
    - `alive`: the first and the last frame in which the agent lives. `notes`: sentences about the scene's notes that direct the
      agent.
    - `push`: the combined push, without a unit; its length is at most 1.
    - `velocity`: the velocities before and after the step, in mm/s; None after death. `acceleration`: mm/s².
    - `seen`: the sets that the agent searched. `fields`: the value of each field at the agent.
    - `did`: sentences about the agent's requests to the world. `changes`: the attributes and memories that have changed."""

    scene: str
    species: str
    agent: int
    frame: int
    fps: str
    hash: str
    checkpoint: int
    mode: str
    strip: tuple[StateInterval, ...]
    alive: tuple[int, int] | None
    notes: tuple[str, ...]
    machines: tuple[MachineStep, ...]
    handlers: tuple[SourceLocation, ...]
    steers: tuple[SteeringLine, ...]
    layers: tuple[LayerReport, ...]
    push: FloatTriple
    velocity: tuple[FloatTriple, FloatTriple | None]
    acceleration: FloatTriple | None
    seen: tuple[ObservedSet, ...]
    fields: tuple[tuple[str, float], ...]
    senses: tuple[SenseReading, ...]
    draws: tuple[RandomDraw, ...]
    did: tuple[str, ...]
    changes: tuple[ChangedValue, ...]


def make_json_document(explanation: Explanation) -> dict[str, Any]:
    """Return the explanation as values for JSON. Infinity and NaN become null."""
    document: dict[str, Any] = _json_value({"format": FORMAT_VERSION, **asdict(explanation)})
    return document


def _json_value(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _json_value(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_json_value(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
