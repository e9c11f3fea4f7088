"""Durations as whole steps, rounded up (decision 6), and time in a state that does not drift."""

from __future__ import annotations

from antdsl.plan.ir import Node
from antdsl.plan.lowering.expressions import scalar
from antdsl.plan.lowering.writer import Writer
from antdsl.program import model

SLACK = 1 - 4e-7  # 0.5 s at 24 frames a second is 12 steps, also where the quotient of two float32 says 12.000001


def steps(w: Writer, duration: Node) -> Node:
    """The least whole number of steps that takes so long."""
    b = w.b
    ratio = b("mul", b("div", duration, w.run("dt")), b.number(SLACK))
    return b("neg", b("floor", b("neg", ratio)))


def passed(w: Writer, machine: str, duration: model.Expr) -> Node:
    """The agent has been in the machine's state for that long."""
    b = w.b
    nearly = b("sub", steps(w, scalar(w, duration)), b.number(0.5))
    return b("ge", w.read(f"{machine}.time_in_state"), b("mul", nearly, w.run("dt")))


def advance(w: Writer, machine: str) -> None:
    """One step more in the state: counted in whole steps, so that no rounding piles up."""
    b, dt = w.b, w.run("dt")
    name = f"{machine}.time_in_state"
    whole = b("floor", b("add", b("div", w.read(name), dt), b.number(1.5)))
    w.store(name, b("mul", whole, dt), None)
