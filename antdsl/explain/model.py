"""What is known about one agent in one step, as frozen values that JSON can say. Numbers are in the author's units."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

FORMAT = 1
Triple = tuple[float, float, float]
Value = float | bool | str | None | Triple


@dataclass(frozen=True, slots=True)
class Place:
    """A stretch of a program: its text on one line, its file and line."""

    text: str
    file: str
    line: int


@dataclass(frozen=True, slots=True)
class Part:
    """A part of a condition: `value` in `unit`, `shown` as one would write it. `role`: draw or bar of a `chance`; joined, where
    it is no more than its parts with `and`, `<` and the like between; else empty."""

    text: str
    value: Value
    unit: str
    shown: str
    role: str = ""
    parts: tuple[Part, ...] = ()


@dataclass(frozen=True, slots=True)
class Timer:
    """`what`: held (in steps), after or at least (in seconds in the state): how long it has been, how long is needed."""

    what: str
    has: float
    needs: float
    unit: str
    holds: bool


@dataclass(frozen=True, slots=True)
class Looked:
    """A transition that was looked at. `kind`: interrupt, from any, when. `held`: its condition; `fires`: that and its timers."""

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
    """What an agent asked of an item or a field, and whether it got it; of all who asked, those with the lesser draw came first.
    `amount` None is all; of a field `items` and `item` are its name, and `attribute` may be empty."""

    items: str
    item: str
    attribute: str
    amount: float | None
    draw: float
    won: bool
    place: Place


@dataclass(frozen=True, slots=True)
class Choice:
    """A draw among states: `draw` from 0 to 1, the share of each state up to which it is taken, and the one that was."""

    draw: float
    bars: tuple[tuple[str, float], ...]
    chosen: str


@dataclass(frozen=True, slots=True)
class MachineStep:
    """`before` and `after`: its states, `since` seconds in the first; `looked`: transitions in their order; `changed` says
    whether one was taken."""

    machine: str
    before: str
    after: str
    since: float
    looked: tuple[Looked, ...]
    changed: bool
    claim: Claim | None
    choice: Choice | None


@dataclass(frozen=True, slots=True)
class Layer:
    """A layer's wish. `left`: strength before it; `length` of its `push`; `given`: what it got of that, `share` of the whole
    budget, `cut` of its length. `state`: pushed, nothing (its push was none), off (its condition does not hold), no strength."""

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
    """A `steer` or `face` line that ran, and its push. `part`: `state`, or `layers` where it stands there."""

    text: str
    push: Triple
    length: float
    part: str = "state"


@dataclass(frozen=True, slots=True)
class Near:
    """Another agent or an item that was looked at: id or name, distance in mm, its state or its amounts."""

    name: str
    distance: float
    about: str


@dataclass(frozen=True, slots=True)
class Seen:
    """What a set held: `asked` is its text, `count` how many; the nearest of them in `nearest`."""

    asked: str
    of: str
    count: int
    nearest: tuple[Near, ...]


@dataclass(frozen=True, slots=True)
class Sense:
    """A sense that was asked: ray, obstacle, curve, flow, map or field; `shown` says what it felt."""

    kind: str
    name: str
    text: str
    shown: str
    values: tuple[Value, ...]


@dataclass(frozen=True, slots=True)
class Draw:
    """A random number that was drawn: its site (stable name), the text that asked, the value."""

    site: str
    text: str
    value: float


@dataclass(frozen=True, slots=True)
class Changed:
    """An attribute or memory before and after the step."""

    name: str
    before: Value
    after: Value
    unit: str
    shown: tuple[str, str]
    memory: bool = False


@dataclass(frozen=True, slots=True)
class Stretch:
    """A state of a machine over frames, both included."""

    machine: str
    state: str
    first: int
    last: int


@dataclass(frozen=True, slots=True)
class Explanation:
    """All about one agent in the step that led to `frame`. `push` is without unit and at most 1 long; velocities are mm/s,
    `acceleration` mm/s². `hash`: of the whole state at `frame`, the same as the cache has for it. `strip`: machine after machine,
    each in order of time; a cache keeps the states of the first machine alone."""

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
    seen: tuple[Seen, ...]
    fields: tuple[tuple[str, float], ...]
    senses: tuple[Sense, ...]
    draws: tuple[Draw, ...]
    did: tuple[str, ...]
    changes: tuple[Changed, ...]


def as_json(explanation: Explanation) -> dict[str, Any]:
    """The explanation as JSON can say it: what is endless or no number is null."""
    found: dict[str, Any] = _sayable({"format": FORMAT, **asdict(explanation)})
    return found


def _sayable(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _sayable(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_sayable(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
