"""How much an agent turns and climbs, for clips that give way to others as it does.

Registers of a species with such clips: `lean#turn`, above 0 to the left, and `lean#slope`, above 0 upward, both from -1 to 1; and
`lean#was.x`, `.y` and `.z`, the heading a step before."""

from __future__ import annotations

from math import pi

from antdsl.plan.ir import Kind, Node
from antdsl.plan.lowering import clips, values
from antdsl.plan.lowering.values import Vec
from antdsl.plan.lowering.writer import AXES, Writer

TURN, SLOPE = pi / 2, 0.5  # rad/s, and the sine of the angle: what counts whole
SMOOTH = 0.15  # s in which both follow


def leans(w: Writer) -> bool:
    """Whether some clip of a species goes by how its agents turn or climb."""
    return any(clip.leans for clip in clips.clips_of(w.species))


def declare(w: Writer) -> None:
    """The registers of a species."""
    if leans(w):
        for name in ("turn", "slope", *(f"was.{axis}" for axis in AXES)):
            w.declare(f"lean#{name}", Kind.F32, "memory")


def begin(w: Writer) -> None:
    """At birth: nobody has turned."""
    if leans(w):
        w.store_vector("lean#was", w.read_vector("heading"), None)


def settle(w: Writer) -> None:
    """A step: the turn since the one before, about the body's up, and the way that the heading rises."""
    if not leans(w):
        return
    b, dt, heading = w.b, w.run("dt"), w.read_vector("heading")
    turned = b("div", values.dot(b, values.cross(b, w.read_vector("lean#was"), heading), w.read_vector("up")), dt)
    rises = values.dot(b, heading, Vec(*(w.run(f"up_{axis}") for axis in AXES)))
    share = b("sub", b.number(1), b("exp", b("neg", b("div", dt, b.number(SMOOTH)))))
    for name, measure, whole in (("turn", turned, TURN), ("slope", rises, SLOPE)):
        now = w.read(f"lean#{name}")
        wish = _limited(w, b("div", measure, b.number(whole)))
        w.store(f"lean#{name}", b("add", now, b("mul", b("sub", wish, now), share)), None)
    w.store_vector("lean#was", heading, None)


def _limited(w: Writer, measure: Node) -> Node:
    return w.b("min", w.b("max", measure, w.b.number(-1)), w.b.number(1))
