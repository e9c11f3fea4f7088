"""One agent's step as frozen values that JSON can represent. Numbers are in the author's units."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

FORMAT_VERSION = 1
FloatTriple = tuple[float, float, float]
PlainValue = float | bool | str | None | FloatTriple


@dataclass(frozen=True, slots=True)
class SourceLocation:
    """A span of a program: its text on one line, its file and line."""

    text: str
    file: str
    line: int


@dataclass(frozen=True, slots=True)
class ExpressionPart:
    """A part of a condition. `value` is in `unit`; `shown` is the value in the author's spelling. `role`: draw or bar of a
    `chance`, joined, or empty. A joined part has only its inner parts with `and`, `<` and similar signs between them."""

    text: str
    value: PlainValue
    unit: str
    shown: str
    role: str = ""
    parts: tuple[ExpressionPart, ...] = ()


@dataclass(frozen=True, slots=True)
class TimerReading:
    """A timer with its elapsed and required amount. `what`: held (in steps), after, or at least (both in seconds in the
    state)."""

    what: str
    has: float
    needs: float
    unit: str
    holds: bool


@dataclass(frozen=True, slots=True)
class TransitionReport:
    """A transition that was checked. `kind`: interrupt, from any, when. `held`: whether its condition was true. `fires`: whether
    its condition and its timers were true."""

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
    """A claim of an agent to an item or a field, and whether it succeeded. Claims with smaller draws are served first. An
    `amount` of None means all. For a field, `items` and `item` are its name, and `attribute` may be empty."""

    items: str
    item: str
    attribute: str
    amount: float | None
    draw: float
    won: bool
    place: SourceLocation


@dataclass(frozen=True, slots=True)
class ChoiceResult:
    """A draw among states: `draw` from 0 to 1, the cumulative share of each state, and the state taken."""

    draw: float
    bars: tuple[tuple[str, float], ...]
    chosen: str


@dataclass(frozen=True, slots=True)
class MachineStep:
    """`before` and `after`: its states, with `since` seconds spent in the first. `looked`: the checked transitions in order;
    `changed`: whether one was taken."""

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
    """A layer's wish. `left`: strength left before it; `length` of its `push`; `given`: the part that it received, `share` of the
    whole budget, `cut` of its length. `state`: pushed, nothing (its push was zero), off (its condition is false), no strength."""

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
    """A `steer` or `face` line that ran, and its push. `part`: `state`, or `layers` if it is in a layer."""

    text: str
    push: FloatTriple
    length: float
    part: str = "state"


@dataclass(frozen=True, slots=True)
class NearbyObject:
    """Another agent or an item near the agent: its id or name, its distance in mm, and its state or amounts."""

    name: str
    distance: float
    about: str


@dataclass(frozen=True, slots=True)
class ObservedSet:
    """The content of a set: its text in the program, its size `count`, and its `nearest` members."""

    asked: str
    of: str
    count: int
    nearest: tuple[NearbyObject, ...]


@dataclass(frozen=True, slots=True)
class SenseReading:
    """A sense that was queried: ray, obstacle, curve, flow, map or field; `shown` describes its result."""

    kind: str
    name: str
    text: str
    shown: str
    values: tuple[PlainValue, ...]


@dataclass(frozen=True, slots=True)
class RandomDraw:
    """A random draw: its site (stable name), the text that requested it, and the value."""

    site: str
    text: str
    value: float


@dataclass(frozen=True, slots=True)
class ChangedValue:
    """An attribute or memory before and after the step."""

    name: str
    before: PlainValue
    after: PlainValue
    unit: str
    shown: tuple[str, str]
    memory: bool = False


@dataclass(frozen=True, slots=True)
class StateInterval:
    """A state of a machine over a range of frames; both ends are included."""

    machine: str
    state: str
    first: int
    last: int


@dataclass(frozen=True, slots=True)
class Explanation:
    """The report on one agent in the step to `frame`. `push` has no unit and a length of at most 1; velocities are mm/s,
    `acceleration` mm/s². `hash`: of the complete state at `frame`, equal to the cache's. `strip`: each machine's states
    in order of time; a cache stores only the states of the first machine."""

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


def as_json(explanation: Explanation) -> dict[str, Any]:
    """Return the explanation as JSON values: infinity and NaN become null."""
    document: dict[str, Any] = _json_value({"format": FORMAT_VERSION, **asdict(explanation)})
    return document


def _json_value(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _json_value(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_json_value(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
