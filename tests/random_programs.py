"""Random programs, as text and as a plain reading of it: what each line means for one agent, computed without any plan.

`program(rng)` gives both; the reading covers an agent's own numbers, states, changes and memory. What it senses of others is left
to the backends, which have to agree with each other.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field
from math import ceil

import numpy as np

F = np.float32
FPS = 10
DT = F(1 / FPS)
NAMES = ("p", "q", "r", "s")
NUMBERS = ("x", "y", "z")
Read = Callable[["Reading"], np.float32]
Act = Callable[["Reading"], None]


@dataclass
class Change:
    condition: Callable[[Reading], bool]
    target: str | None  # None: previous
    actions: list[Act]
    interrupt: bool = False
    delay: int = 0  # steps
    held: int = 0
    anywhere: bool = False
    counter: int = 0
    excepted: tuple[str, ...] = ()


@dataclass
class State:
    changes: list[Change] = field(default_factory=list)
    body: list[Act] = field(default_factory=list)
    enter: list[Act] = field(default_factory=list)
    exit: list[Act] = field(default_factory=list)
    at_least: int = 0


class Reading:
    """One agent of a program, read line by line."""

    def __init__(self, program: Program) -> None:
        self.program, self.frame = program, 0
        self.now = {name: F(value) for name, value in program.start.items()}
        self.then = self.now  # at birth nothing has been before
        self.latch = False
        self.state = self.previous = "p"
        self.steps = 0
        for act in program.states["p"].enter:
            act(self)

    def step(self) -> None:
        program, state = self.program, self.program.states[self.state]
        self.frame += 1
        self.then = dict(self.now)
        on, off = program.latch
        self.latch = not off(self) if self.latch else on(self)
        offered = [c for c in state.changes if c.interrupt]
        offered += [c for c in program.anywhere if c.target != self.state and self.state not in c.excepted]
        offered += [c for c in state.changes if not c.interrupt]
        fired = None
        for change in offered:
            holds = change.condition(self)
            if change.held:
                change.counter = change.counter + 1 if holds else 0
                holds = holds and change.counter > change.held
            holds = holds and self.steps >= change.delay and (change.interrupt or self.steps >= state.at_least)
            if change.anywhere and change.target is None and self.previous == self.state:
                holds = False
            if holds and fired is None:
                fired = change
        if fired is not None:
            self._change(fired)
        for act in program.states[self.state].body:
            act(self)
        self.steps += 1

    def _change(self, change: Change) -> None:
        target = self.previous if change.target is None else change.target
        for act in self.program.states[self.state].exit + change.actions:
            act(self)
        self.previous, self.state, self.steps = self.state, target, 0
        for each in self.program.states[target].changes:
            each.counter = 0
        for each in self.program.anywhere:
            if each.target == target or target in each.excepted:
                each.counter = 0
        for act in self.program.states[target].enter:
            act(self)


@dataclass
class Program:
    text: str
    start: dict[str, float]
    states: dict[str, State]
    anywhere: list[Change]
    latch: tuple[Callable[[Reading], bool], Callable[[Reading], bool]]


class Author:
    """Writes a program together with its reading."""

    def __init__(self, rng: random.Random) -> None:
        self.rng = rng

    def number(self, depth: int, then: bool = False) -> tuple[str, Read]:
        """An expression; `then`: as it was when the step began."""
        rng = self.rng
        if depth == 0 or rng.random() < 0.2:
            pick = rng.randrange(5)
            if pick == 0:
                value = F(rng.choice([0.5, 1, 2, 3, -1, 0.25]))
                return (f"{value:g}", lambda r: value)
            if pick == 1:
                return "frame", lambda r: F(r.frame)
            if pick == 2 and not then:
                return "before", lambda r: self.before(r)
            name = rng.choice(NUMBERS)
            return name, (lambda r: r.then[name]) if then else (lambda r: r.now[name])
        (a, f), (b, g) = self.number(depth - 1, then), self.number(depth - 1, then)
        match rng.randrange(6):
            case 0:
                return f"({a} + {b})", lambda r: F(f(r) + g(r))
            case 1:
                return f"({a} - {b})", lambda r: F(f(r) - g(r))
            case 2:
                return f"clamp({a} * {b}, -9 .. 9)", lambda r: min(max(F(f(r) * g(r)), F(-9)), F(9))
            case 3:
                return f"min({a}, {b})", lambda r: min(f(r), g(r))
            case 4:
                return f"abs({a})", lambda r: abs(f(r))
        condition, holds = self.condition(depth - 1, then)
        return f"(if {condition} then {a} else {b})", lambda r: f(r) if holds(r) else g(r)

    def condition(self, depth: int, then: bool = False) -> tuple[str, Callable[[Reading], bool]]:
        rng = self.rng
        if depth > 0 and rng.random() < 0.4:
            (a, f), (b, g) = self.condition(depth - 1, then), self.condition(depth - 1, then)
            match rng.randrange(3):
                case 0:
                    return f"({a} and {b})", lambda r: f(r) and g(r)
                case 1:
                    return f"({a} or {b})", lambda r: f(r) or g(r)
            return f"not ({a})", lambda r: not f(r)
        if not then and rng.random() < 0.15:
            return "high", lambda r: r.latch
        (a, p), (b, q) = self.number(depth, then), self.number(depth, then)
        if rng.random() < 0.5:
            return f"{a} < {b}", lambda r: bool(p(r) < q(r))
        return f"{a} >= {b}", lambda r: bool(p(r) >= q(r))

    def lines(self, most: int, body: bool = False) -> tuple[str, list[Act]]:
        """Up to so many statements, one a number."""
        texts, acts = [], []
        for name in self.rng.sample(NUMBERS, self.rng.randint(0, most)):
            text, read = self.number(2)
            if self.rng.random() < 0.4:
                texts.append(f"{name} += clamp({text}, -3 .. 3)" + (" * 1 /s" if body else ""))
                acts.append(self._add(name, read, body))
            else:
                texts.append(f"{name} = clamp({text}, -50 .. 50)")
                acts.append(self._set(name, read))
        return "; ".join(texts), acts

    @staticmethod
    def _set(name: str, read: Read) -> Act:
        def act(r: Reading) -> None:
            r.now[name] = min(max(read(r), F(-50)), F(50))

        return act

    @staticmethod
    def _add(name: str, read: Read, body: bool) -> Act:
        def act(r: Reading) -> None:
            amount = min(max(read(r), F(-3)), F(3))
            r.now[name] = F(r.now[name] + (F(amount * DT) if body else amount))

        return act

    def change(self, own: str | None) -> tuple[str, Change]:
        rng = self.rng
        target = rng.choice([n for n in NAMES if n != own] + [None])
        change = Change(lambda r: True, target, [], anywhere=own is None)
        what, change.condition = self.condition(2)
        kind = rng.randrange(4)
        if kind == 0:
            seconds = rng.choice([0.1, 0.25, 0.3])
            change.held = ceil(round(seconds * FPS, 6))
            what = f"{what} held {seconds} s"
        elif kind == 1:
            seconds = rng.choice([0.1, 0.35, 0.4])
            change.delay, change.condition = ceil(round(seconds * FPS, 6)), lambda r: True
            what = f"after {seconds} s"
        actions, change.actions = self.lines(2)
        return f"when {what} -> {target or 'previous'}" + (f" {{ {actions} }}" if actions else ""), change

    def program(self) -> Program:
        rng = self.rng
        start = {name: rng.choice([0, 1, 2.5, -1]) for name in NUMBERS}
        let_text, self.before = self.number(2, then=True)
        (on, holds), (off, ends) = self.condition(1, then=True), self.condition(1, then=True)
        text = "species a {\n" + "".join(f"{name} = {value}\n" for name, value in start.items())
        text += f"let before = {let_text}\nlatch high = {on} until {off}\nstart p\n"
        anywhere = []
        for _ in range(rng.randint(0, 2)):
            written, change = self.change(None)
            change.excepted = tuple(rng.sample(NAMES, rng.randint(0, 2)))
            text += "from any" + (f" except {', '.join(change.excepted)}" if change.excepted else "") + f" {written}\n"
            anywhere.append(change)
        states = {name: State() for name in NAMES}
        for k, (name, state) in enumerate(states.items()):
            state.at_least = rng.choice([0, 0, 0, 2, 3])
            text += f"state {name}" + (f" for at least {state.at_least / FPS} s" if state.at_least else "") + " {\n"
            for part in ("enter", "exit"):
                written, acts = self.lines(2)
                setattr(state, part, acts)
                text += f"  {part} {{ {written} }}\n" if written else ""
            for _ in range(rng.randint(0, 2)):
                written, change = self.change(name)
                change.interrupt = rng.random() < 0.3
                text += f"  {'interrupt ' if change.interrupt else ''}{written}\n"
                state.changes.append(change)
            following = NAMES[(k + 1) % len(NAMES)]  # each state can be reached and left
            state.changes.append(Change(lambda r: bool(r.now["x"] > F(1)), following, []))
            text += f"  when x > 1 -> {following}\n"
            written, state.body = self.lines(3, body=True)
            text += f"  {written}\n" if written else ""
            text += "}\n"
        return Program(text + "}\n", start, states, anywhere, (holds, ends))
