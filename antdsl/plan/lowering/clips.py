"""`play`: which clip each machine plays, how far it has come, and how the clip before gives way to it.

A clip's time is counted in turns: 0 where it begins, 1 where it has been played once, on from there where it loops. So a body
with other clips of the same names, faster or slower ones, takes over where the one before was. A clip that covers ground goes by
the ground that the agent covers, so that feet do not slide; others by the clock.

Of each machine that plays: `clip`, the number of the clip in `SpeciesPlan.clips` (-1 for none), `clip_turns` and, before the last
step, `clip_last`, `clip_weight`; the clip before with its turns and weight, `clip_before`, `clip_before_turns` and
`clip_before_weight`; `clip_fade`, the share that it still has, and `clip_over`, the time in which that goes from 1 to 0."""

from __future__ import annotations

from antdsl.plan import ir
from antdsl.plan.ir import Kind, Node
from antdsl.plan.lowering.expressions import scalar
from antdsl.plan.lowering.writer import Writer
from antdsl.program import model
from antdsl.source import Span

OVER = 0.15  # s, in which one clip gives way to the next where no change says otherwise
NONE = -1
_BEFORE = 1e-6  # turns: where a clip that begins was before, so that it comes past a mark at its start
_START = "~clip.start"


def clips_of(species: model.Species) -> tuple[ir.ClipPlan, ...]:
    """The clips that a species plays, each once, in text order."""
    found: dict[ir.ClipPlan, None] = {}
    for machine in species.machines:
        for line in _lines(machine):
            found.setdefault(ir.ClipPlan(line.clip, line.on))
    return tuple(found)


def plays(machine: model.Machine) -> bool:
    """Whether some state of a machine plays a clip."""
    return bool(_lines(machine))


def declare(w: Writer, machine: model.Machine) -> None:
    """The registers of a machine that plays."""
    name = machine.name
    for part in ("clip", "clip_before"):
        w.declare(f"{name}.{part}", Kind.I32, "memory", NONE)
    for part in ("clip_turns", "clip_last", "clip_weight", "clip_before_turns", "clip_before_weight", "clip_fade"):
        w.declare(f"{name}.{part}", Kind.F32, "memory")
    w.declare(f"{name}.clip_over", Kind.F32, "memory", OVER)


def begin(w: Writer, machine: model.Machine) -> None:
    """At birth: the clip of the start state, from its start, or from anywhere where it loops."""
    line = next((line for line in machine.states[machine.start].body if isinstance(line, model.Play)), None)
    if line is None:
        return
    b, name, clip = w.b, machine.name, _number(w, line)
    draw = b("draw", attrs=(f"{w.species.name}.{name}.clip", 0))
    w.store(f"{name}.clip", clip, line.span)
    w.store(f"{name}.clip_turns", b("where", _loops(w, clip), draw, b.number(0)), line.span)
    w.store(f"{name}.clip_last", b("sub", w.read(f"{name}.clip_turns"), b.number(_BEFORE)), line.span)
    w.store(f"{name}.clip_weight", b.number(1), line.span)


def give_way(w: Writer, machine: model.Machine, over: model.Expr | None, span: Span) -> None:
    """A change says in what time the clip of the state that is left gives way."""
    if plays(machine):
        w.store(f"{machine.name}.clip_over", w.b.number(OVER) if over is None else scalar(w, over), span)


def rest(w: Writer, machine: model.Machine, state: model.State) -> None:
    """A state without a clip, in a machine that has some: the clip before gives way to none."""
    if plays(machine) and not any(isinstance(line, model.Play) for line in state.body):
        _become(w, machine.name, w.b.row(NONE), w.b.number(0), state.span)
        _fade(w, machine.name, state.span)
        w.store(f"{machine.name}.clip_weight", w.b.number(0), state.span)


def play(w: Writer, machine: str, line: model.Play) -> None:
    """A line of the state that the agent is in."""
    b, clip = w.b, _number(w, line)
    begins = b("ne", w.read(f"{machine}.clip"), clip)
    pace = _pace(w, clip)
    if line.speed is not None:
        pace = b("mul", pace, scalar(w, line.speed))
    turns, step = w.read(f"{machine}.clip_turns"), b("mul", pace, w.run("dt"))
    goes_on = b("where", begins, turns, b("add", turns, step))
    held = b("where", _loops(w, clip), goes_on, b("min", goes_on, b.number(1)))
    w.store(f"{machine}.clip_last", turns, line.span)
    w.store(f"{machine}.clip_turns", held, line.span)
    _become(w, machine, clip, step, line.span)
    _fade(w, machine, line.span)
    weight = b.number(1) if line.weight is None else b("min", b("max", scalar(w, line.weight), b.number(0)), b.number(1))
    w.store(f"{machine}.clip_weight", weight, line.span)


def test(w: Writer, e: model.ClipTest) -> Node:
    """`clip done`, `clip at MARK`: whether a clip has come past a place in the last step, or to its end since it began."""
    b, machine = w.b, e.machine
    names = next(m for m in w.species.machines if m.name == machine)
    if not plays(names):
        return b.false
    turns, last = w.read(f"{machine}.clip_turns"), w.read(f"{machine}.clip_last")
    if not e.mark:
        return b("ge", turns, b.number(1))
    mark = b("clip.value", w.read(f"{machine}.clip"), attrs=(f"mark {e.mark}",))
    whole = [b("floor", b("sub", each, mark)) for each in (turns, last)]
    once = b("and", b("lt", last, mark), b("ge", turns, mark))
    passed = b("or", b("and", _loops(w, w.read(f"{machine}.clip")), b("gt", whole[0], whole[1])), once)
    return b("and", passed, b("ge", mark, b.number(0)))


def _become(w: Writer, machine: str, clip: Node, step: Node, span: Span | None) -> None:
    """Another clip begins at its start, or in step with the one before where both cover ground, which it then goes on with by so
    many turns (`step`)."""
    b, before = w.b, w.read(f"{machine}.clip")
    turns = w.read(f"{machine}.clip_turns")
    w.declare(_START, Kind.F32, "temp")
    with w.region(b("ne", before, clip), span or w.species.span):
        both = b("and", _walks(w, before), _walks(w, clip))
        part = b("sub", turns, b("floor", turns))
        w.store(_START, b("where", both, b("add", part, step), b.number(0)), span)
        w.store(f"{machine}.clip_before_turns", turns, span)
        w.store(f"{machine}.clip_before_weight", w.read(f"{machine}.clip_weight"), span)
        w.store(f"{machine}.clip_fade", b.number(1), span)
        w.store(f"{machine}.clip_last", b("where", both, part, b.number(-_BEFORE)), span)
        w.store(f"{machine}.clip_before", before, span)
        w.store(f"{machine}.clip", clip, span)
        w.store(f"{machine}.clip_turns", w.read(_START), span)


def _fade(w: Writer, machine: str, span: Span | None) -> None:
    """The clip before has less of a share, and goes on meanwhile."""
    b, dt = w.b, w.run("dt")
    fade, before = w.read(f"{machine}.clip_fade"), w.read(f"{machine}.clip_before")
    with w.region(b("gt", fade, b.number(0)), span or w.species.span):
        left = b("sub", fade, b("div", dt, b("max", w.read(f"{machine}.clip_over"), dt)))
        turns = b("add", w.read(f"{machine}.clip_before_turns"), b("mul", _pace(w, before), dt))
        held = b("where", _loops(w, before), turns, b("min", turns, b.number(1)))
        w.store(f"{machine}.clip_before_turns", held, span)
        w.store(f"{machine}.clip_fade", b("max", left, b.number(0)), span)


def _pace(w: Writer, clip: Node) -> Node:
    """Turns a second: by the ground covered where the clip covers ground, in lengths of the body, else as long as it takes."""
    b = w.b
    stride, seconds = b("clip.value", clip, attrs=("stride",)), b("clip.value", clip, attrs=("seconds",))
    x, y, z = w.read_vector("velocity")
    speed = b("sqrt", b("add", b("add", b("mul", x, x), b("mul", y, y)), b("mul", z, z)))
    ground = b("mul", stride, b("max", w.read("size"), b.number(1e-6)))
    by_ground = b("div", speed, b("where", b("gt", ground, b.number(0)), ground, b.number(1)))
    return b("where", b("gt", stride, b.number(0)), by_ground, b("div", b.number(1), b("max", seconds, w.run("dt"))))


def _number(w: Writer, line: model.Play) -> Node:
    """The number of the clip of a line."""
    return w.b.row(clips_of(w.species).index(ir.ClipPlan(line.clip, line.on)))


def _loops(w: Writer, clip: Node) -> Node:
    return w.b("gt", w.b("clip.value", clip, attrs=("loop",)), w.b.number(0.5))


def _walks(w: Writer, clip: Node) -> Node:
    return w.b("gt", w.b("clip.value", clip, attrs=("stride",)), w.b.number(0))


def _lines(machine: model.Machine) -> list[model.Play]:
    return [line for state in machine.states for line in state.body if isinstance(line, model.Play)]
