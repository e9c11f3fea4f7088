"""One agent's step as frozen values that JSON can represent. Numbers are in the author's units."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

FORMAT = 1
Triple = tuple[float, float, float]
Value = float | bool | str | None | Triple


@dataclass(frozen=True, slots=True)
class Place:
    """A span of a program: its text on one line, its file and line."""

    text: str
    file: str
    line: int


@dataclass(frozen=True, slots=True)
class Part:
    """A part of a condition. `value` is in `unit`; `shown` is the value in the author's spelling. `role`: draw or bar of a
    `chance`, joined, or empty. A joined part has only its inner parts with `and`, `<` and similar signs between them."""

    text: str
    value: Value
    unit: str
    shown: str
    role: str = ""
    parts: tuple[Part, ...] = ()


@dataclass(frozen=True, slots=True)
class Timer:
    """A timer with its elapsed and required amount. `what`: held (in steps), after, or at least (both in seconds in the
    state)."""

    what: str
    has: float
    needs: float
    unit: str
    holds: bool


@dataclass(frozen=True, slots=True)
class TransitionAccount:
    """A transition that was checked. `kind`: interrupt, from any, when. `held`: whether its condition was true. `fires`: whether
    its condition and its timers were true."""

    place: Place
    kind: str
    target: str
    condition: Part | None
    held: bool
    timers: tuple[Timer, ...]
    take: Part | None
    fires: bool
    wins: bool


@dataclass(frozen=True, slots=True)
class Claim:
    """A claim of an agent to an item or a field, and whether it succeeded. Claims with smaller draws are served first. An
    `amount` of None means all. For a field, `items` and `item` are its name, and `attribute` may be empty."""

    items: str
    item: str
    attribute: str
    amount: float | None
    draw: float
    won: bool
    place: Place


@dataclass(frozen=True, slots=True)
class Choice:
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
    looked: tuple[TransitionAccount, ...]
    changed: bool
    claim: Claim | None
    choice: Choice | None


@dataclass(frozen=True, slots=True)
class Layer:
    """A layer's wish. `left`: strength left before it; `length` of its `push`; `given`: the part it received, `share` of the
    whole budget, `cut` of its length. `state`: pushed, nothing (its push was zero), off (its condition is false), no strength."""

    place: Place
    state: str
    condition: Part | None
    left: float
    push: Triple | None
    length: float
    given: Triple
    share: float
    cut: float


@dataclass(frozen=True, slots=True)
class Steer:
    """A `steer` or `face` line that ran, and its push. `part`: `state`, or `layers` if it is in a layer."""

    text: str
    push: Triple
    length: float
    part: str = "state"


@dataclass(frozen=True, slots=True)
class NearObject:
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
    nearest: tuple[NearObject, ...]


@dataclass(frozen=True, slots=True)
class Sense:
    """A sense that was queried: ray, obstacle, curve, flow, map or field; `shown` describes its result."""

    kind: str
    name: str
    text: str
    shown: str
    values: tuple[Value, ...]


@dataclass(frozen=True, slots=True)
class Draw:
    """A random draw: its site (stable name), the text that requested it, and the value."""

    site: str
    text: str
    value: float


@dataclass(frozen=True, slots=True)
class ChangedValue:
    """An attribute or memory before and after the step."""

    name: str
    before: Value
    after: Value
    unit: str
    shown: tuple[str, str]
    memory: bool = False


@dataclass(frozen=True, slots=True)
class Stretch:
    """A state of a machine over a range of frames; both ends are included."""

    machine: str
    state: str
    first: int
    last: int


@dataclass(frozen=True, slots=True)
class Explanation:
    """The report on one agent in the step to `frame`. `push` has no unit and a length of at most 1; velocities are mm/s,
    `acceleration` mm/s². `hash`: of the complete state at `frame`, equal to the cache's. `strip`: each machine's states in order
    of time; a cache stores only the states of the first machine."""

    scene: str
    species: str
    agent: int
    frame: int
    fps: str
    hash: str
    checkpoint: int
    mode: str
    strip: tuple[Stretch, ...]
    alive: tuple[int, int] | None
    notes: tuple[str, ...]
    machines: tuple[MachineStep, ...]
    handlers: tuple[Place, ...]
    steers: tuple[Steer, ...]
    layers: tuple[Layer, ...]
    push: Triple
    velocity: tuple[Triple, Triple | None]
    acceleration: Triple | None
    seen: tuple[ObservedSet, ...]
    fields: tuple[tuple[str, float], ...]
    senses: tuple[Sense, ...]
    draws: tuple[Draw, ...]
    did: tuple[str, ...]
    changes: tuple[ChangedValue, ...]


def as_json(explanation: Explanation) -> dict[str, Any]:
    """Return the explanation as JSON values: infinity and NaN become null."""
    document: dict[str, Any] = _json_value({"format": FORMAT, **asdict(explanation)})
    return document


def _json_value(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _json_value(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_json_value(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
