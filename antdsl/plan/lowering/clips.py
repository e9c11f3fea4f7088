"""Lowers `play`: the clip that each machine plays, its progress, and the cross-fade from the previous clip.

Progress is counted in turns: 0 at the start of a clip, 1 after it has played once, and so on if it loops. Bodies with clips of
different speed therefore have the same progress. A clip that covers ground advances with the distance that the agent covers, so
that feet do not slide. Other clips advance with time.

Registers of each machine that plays clips:

- `clip`: the index of the clip in `SpeciesPlan.clips` (-1: none). `clip_weight`: its weight.
- `clip_turns`: its progress in turns. `clip_last`: its progress before the last step.
- `clip_before`, `clip_before_turns` and `clip_before_weight`: the same values of the previous clip.
- `clip_fade`: the weight of the previous clip in the pose. `clip_fading`: the time in which this weight falls from 1 to 0.
- `clip_over`: the fade time of the next change.
- `clip_earlier` and its registers: the clip before the previous one, if the clip changes during a fade.
- `clip_earlier_fade`: the fraction of the fading weight that belongs to this earlier clip.

While `clip_earlier_fade` is above 0, a further change waits (`clip_waits`), so that no pose jumps."""

from __future__ import annotations

from math import pi

from antdsl.plan import ir
from antdsl.plan.ir import PlanNode, ValueKind
from antdsl.plan.lowering import values
from antdsl.plan.lowering.expressions import lower_condition, lower_scalar
from antdsl.plan.lowering.values import VectorNodes
from antdsl.plan.lowering.writer import AXES, PlanWriter
from antdsl.program import model
from antdsl.source import Span

FULL_LEAN_TURN, FULL_LEAN_SLOPE = pi / 2, 0.5  # rad/s, sine of the slope: values that count as 1
LEAN_SMOOTHING_SECONDS = 0.15  # time constant of the turn and the slope
DEFAULT_FADE_SECONDS = 0.15  # default duration of a cross-fade
NO_CLIP = -1
_START_OFFSET_TURNS = 1e-6  # turns before the start, so that a mark at the start is passed
_START_REGISTER, _LAST_REGISTER, _BEGINS_REGISTER, _WAITS_REGISTER = "~clip.start", "~clip.last", "~clip.begins", "~clip.waits"
_CLIP_NUMBER_REGISTERS = (
    "clip_turns", "clip_last", "clip_weight", "clip_before_turns", "clip_before_weight", "clip_fade",
    "clip_earlier_turns", "clip_earlier_weight", "clip_earlier_fade",
)  # fmt: skip
# Copies between registers as another clip begins, in this order.
_FADE_REGISTER_COPIES = (
    ("clip_earlier", "clip_before"), ("clip_earlier_turns", "clip_before_turns"), ("clip_earlier_weight", "clip_before_weight"),
    ("clip_earlier_fade", "clip_fade"), ("clip_earlier_fading", "clip_fading"), ("clip_before", "clip"),
    ("clip_before_turns", "clip_turns"), ("clip_before_weight", "clip_weight"), ("clip_fading", "clip_over"),
)  # fmt: skip


def list_clips(species: model.Species) -> tuple[ir.ClipPlan, ...]:
    """Return the clips that a species plays, without duplicates, in text order."""
    clip_plans: dict[ir.ClipPlan, None] = {}
    for machine in species.machines:
        for line in _list_play_lines(machine):
            clip_plans.setdefault(_make_clip_plan(line))
    return tuple(clip_plans)


def _make_clip_plan(line: model.Play) -> ir.ClipPlan:
    return ir.ClipPlan(line.clip, line.group, line.is_additive, *line.blend_clips)


def plays_clips(machine: model.Machine) -> bool:
    """Return whether at least one state of a machine plays a clip."""
    return bool(_list_play_lines(machine))


def declare_registers(w: PlanWriter, machine: model.Machine) -> None:
    """Declare the registers of a machine that plays clips."""
    name = machine.name
    for part in ("clip", "clip_before", "clip_earlier"):
        w.declare_register(f"{name}.{part}", ValueKind.I32, "memory", NO_CLIP)
    for part in _CLIP_NUMBER_REGISTERS:
        w.declare_register(f"{name}.{part}", ValueKind.F32, "memory")
    for part in ("clip_over", "clip_fading", "clip_earlier_fading"):
        w.declare_register(f"{name}.{part}", ValueKind.F32, "memory", DEFAULT_FADE_SECONDS)
    w.declare_register(f"{name}.clip_waits", ValueKind.BOOL, "memory")


def write_start_clip(w: PlanWriter, machine: model.Machine, state: model.State) -> None:
    """Write the start of the clip that the state plays at birth. The clip starts at progress 0 or, if it loops, at a random
    progress."""
    line = next((line for line in state.body if isinstance(line, model.Play)), None)
    if line is None:
        return
    b, name, clip = w.b, machine.name, _find_clip_number(w, line)
    draw = b("draw", attrs=(f"{w.species.name}.{name}.clip", 0))
    w.add_store(f"{name}.clip", clip, line.span)
    w.add_store(f"{name}.clip_turns", b("where", _is_looping(w, clip), draw, b.add_number(0)), line.span)
    w.add_store(
        f"{name}.clip_last", b("sub", w.read_at_step_start(f"{name}.clip_turns"), b.add_number(_START_OFFSET_TURNS)), line.span
    )
    w.add_store(f"{name}.clip_weight", b.add_number(1), line.span)


def store_fade_time(w: PlanWriter, machine: model.Machine, fade_time: model.Expr | None, span: Span) -> None:
    """Store the fade time with which the clip changes when a transition leaves the current state. `fade_time`: None for the
    default."""
    w.add_store(
        f"{machine.name}.clip_over",
        w.b.add_number(DEFAULT_FADE_SECONDS) if fade_time is None else lower_scalar(w, fade_time),
        span,
    )
    w.add_store(f"{machine.name}.clip_waits", w.b.false, span)


def restart_clip(w: PlanWriter, machine: model.Machine, state: model.State) -> None:
    """Write a request to restart the clip of a state for agents that enter the state.

    If the clip is already playing, it restarts only if the line's `restart_condition` holds."""
    line = next((line for line in state.body if isinstance(line, model.Play)), None)
    if line is not None and line.restart_condition is not None:
        w.add_store(f"{machine.name}.clip_waits", lower_condition(w, line.restart_condition), line.span)


def fade_out_clip(w: PlanWriter, machine: model.Machine, state: model.State) -> None:
    """Write the fade-out of the previous clip in a state without a clip. Writes nothing if no other state of the machine has a
    clip."""
    if plays_clips(machine) and not any(isinstance(line, model.Play) for line in state.body):
        _write_clip_step(w, machine.name, w.b.add_row(NO_CLIP), None, w.b.add_number(0), state.span)


def lower_play(w: PlanWriter, machine: str, line: model.Play) -> None:
    """Write the statements for a `play` line of the agent's current state."""
    b = w.b
    speed = None if line.speed is None else lower_scalar(w, line.speed)
    weight = (
        b.add_number(1)
        if line.weight is None
        else b("min", b("max", lower_scalar(w, line.weight), b.add_number(0)), b.add_number(1))
    )
    _write_clip_step(w, machine, _find_clip_number(w, line), speed, weight, line.span)


def _write_clip_step(w: PlanWriter, machine: str, clip: PlanNode, speed: PlanNode | None, weight: PlanNode, span: Span) -> None:
    """Write one step of a machine that requests `clip`. In this step, the clip starts, waits until it is allowed to start, or
    continues."""
    b, now, turns = w.b, w.read_at_step_start(f"{machine}.clip"), w.read_at_step_start(f"{machine}.clip_turns")
    none = clip is b.add_row(NO_CLIP)
    wished = b("ne", now, clip) if none else b("or", b("ne", now, clip), w.read_at_step_start(f"{machine}.clip_waits"))
    shares = (w.read_at_step_start(f"{machine}.{share}") for share in ("clip_fade", "clip_earlier_fade"))
    three = b("and", *(b("gt", share, b.add_number(0)) for share in shares))
    own = b.add_number(1) if speed is None else speed
    first = _compute_first_turns(w, machine, clip, b("mul", b("mul", _compute_play_rate(w, clip), own), w.read_run_value("dt")))
    held = (
        (_BEGINS_REGISTER, ValueKind.BOOL, b("and", wished, b("not", three))), (_WAITS_REGISTER, ValueKind.BOOL, b("and",
        wished, three)),
        (_START_REGISTER, ValueKind.F32, first[0]), (_LAST_REGISTER, ValueKind.F32, first[1]),
    )  # fmt: skip
    for name, kind, node in held:
        w.declare_register(name, kind, "temp")
        w.add_store(name, node, span)
    begins, waits = w.read_at_step_start(_BEGINS_REGISTER), w.read_at_step_start(_WAITS_REGISTER)
    pace = b("mul", _compute_play_rate(w, now), b("where", waits, b.add_number(1), own))
    goes_on = b("add", turns, b("mul", pace, w.read_run_value("dt")))
    further = b("where", _is_looping(w, now), goes_on, b("min", goes_on, b.add_number(1)))
    w.add_store(f"{machine}.clip_waits", waits, span)
    w.add_store(f"{machine}.clip_last", turns, span)
    w.add_store(f"{machine}.clip_turns", b("where", waits if none else b("not", begins), further, turns), span)
    _start_clip(w, machine, clip, span)
    _advance_fades(w, machine, span)
    w.add_store(f"{machine}.clip_weight", b("where", waits, w.read_at_step_start(f"{machine}.clip_weight"), weight), span)


def lower_clip_test(w: PlanWriter, e: model.ClipTest) -> PlanNode:
    """Return a node that is true if a clip passed a mark in the last step (`clip at MARK`), or has ended (`clip done`)."""
    b, machine = w.b, e.machine
    names = next(m for m in w.species.machines if m.name == machine)
    if not plays_clips(names):
        return b.false
    turns, last = w.read_at_step_start(f"{machine}.clip_turns"), w.read_at_step_start(f"{machine}.clip_last")
    has_begun = b("not", w.read_at_step_start(f"{machine}.clip_waits"))
    if not e.mark:
        return b("and", has_begun, b("ge", turns, b.add_number(1)))
    mark = b("clip.value", w.read_at_step_start(f"{machine}.clip"), attrs=(f"mark {e.mark}",))
    cycles = [b("floor", b("sub", each, mark)) for each in (turns, last)]
    crosses_mark = b("and", b("lt", last, mark), b("ge", turns, mark))
    passed = b(
        "or", b("and", _is_looping(w, w.read_at_step_start(f"{machine}.clip")), b("gt", cycles[0], cycles[1])), crosses_mark
    )
    return b("and", has_begun, b("and", passed, b("ge", mark, b.add_number(0))))


def _compute_first_turns(w: PlanWriter, machine: str, clip: PlanNode, step: PlanNode) -> tuple[PlanNode, PlanNode]:
    """Return the progress of a new clip after this step, and before this step, in turns of its cycle.

    A new clip starts at 0. If the new and the previous clip both cover ground, it continues at the previous clip's progress,
    plus `step` turns."""
    b, previous_clip, turns = w.b, w.read_at_step_start(f"{machine}.clip"), w.read_at_step_start(f"{machine}.clip_turns")
    both = b("and", b("ne", previous_clip, clip), b("and", _is_covering_ground(w, previous_clip), _is_covering_ground(w, clip)))
    part = b("sub", turns, b("floor", turns))
    return b("where", both, b("add", part, step), b.add_number(0)), b("where", both, part, b.add_number(-_START_OFFSET_TURNS))


def _start_clip(w: PlanWriter, machine: str, clip: PlanNode, span: Span | None) -> None:
    """Write the start of the clip with the index `clip`. The current clip becomes the previous clip, and the previous clip
    becomes the one before that."""
    b = w.b
    with w.open_region(w.read_at_step_start(_BEGINS_REGISTER), span or w.species.span):
        for to, source in _FADE_REGISTER_COPIES:
            w.add_store(f"{machine}.{to}", w.read_at_step_start(f"{machine}.{source}"), span)
        w.add_store(f"{machine}.clip_fade", b.add_number(1), span)
        w.add_store(f"{machine}.clip_last", w.read_at_step_start(_LAST_REGISTER), span)
        w.add_store(f"{machine}.clip", clip, span)
        w.add_store(f"{machine}.clip_turns", w.read_at_step_start(_START_REGISTER), span)


def _advance_fades(w: PlanWriter, machine: str, span: Span | None) -> None:
    """Reduce the weights of the previous clips in the pose, and advance their progress."""
    b, dt = w.b, w.read_run_value("dt")
    with w.open_region(b("gt", w.read_at_step_start(f"{machine}.clip_fade"), b.add_number(0)), span or w.species.span):
        for which, share, over in (
            ("clip_earlier", "clip_earlier_fade", "clip_earlier_fading"),
            ("clip_before", "clip_fade", "clip_fading"),
        ):
            previous_clip = w.read_at_step_start(f"{machine}.{which}")
            left = b(
                "sub",
                w.read_at_step_start(f"{machine}.{share}"),
                b("div", dt, b("max", w.read_at_step_start(f"{machine}.{over}"), dt)),
            )
            turns = b("add", w.read_at_step_start(f"{machine}.{which}_turns"), b("mul", _compute_play_rate(w, previous_clip), dt))
            held = b("where", _is_looping(w, previous_clip), turns, b("min", turns, b.add_number(1)))
            w.add_store(f"{machine}.{which}_turns", held, span)
            w.add_store(f"{machine}.{share}", b("max", left, b.add_number(0)), span)


def _compute_play_rate(w: PlanWriter, clip: PlanNode) -> PlanNode:
    """Return how many times per second a clip plays.

    For a clip that covers ground, this follows from the agent's speed in body lengths, otherwise from the clip's duration."""
    b = w.b
    stride, seconds = b("clip.value", clip, attrs=("stride",)), b("clip.value", clip, attrs=("seconds",))
    x, y, z = w.read_vector("velocity")
    speed = b("sqrt", b("add", b("add", b("mul", x, x), b("mul", y, y)), b("mul", z, z)))
    ground = b("mul", stride, b("max", w.read_at_step_start("size"), b.add_number(1e-6)))
    by_ground = b("div", speed, b("where", b("gt", ground, b.add_number(0)), ground, b.add_number(1)))
    return b(
        "where", b("gt", stride, b.add_number(0)), by_ground, b("div", b.add_number(1), b("max", seconds, w.read_run_value("dt")))
    )


def _find_clip_number(w: PlanWriter, line: model.Play) -> PlanNode:
    """Return the index of the clip that a `play` line names."""
    return w.b.add_row(list_clips(w.species).index(_make_clip_plan(line)))


def _is_looping(w: PlanWriter, clip: PlanNode) -> PlanNode:
    return w.b("gt", w.b("clip.value", clip, attrs=("loop",)), w.b.add_number(0.5))


def _is_covering_ground(w: PlanWriter, clip: PlanNode) -> PlanNode:
    return w.b("gt", w.b("clip.value", clip, attrs=("stride",)), w.b.add_number(0))


def _list_play_lines(machine: model.Machine) -> list[model.Play]:
    return [line for state in machine.states for line in state.body if isinstance(line, model.Play)]


def has_lean_clips(w: PlanWriter) -> bool:
    """Return whether a clip of the species has variants for turning, climbing or descending."""
    return any(clip.has_lean_clips for clip in list_clips(w.species))


def declare_lean_registers(w: PlanWriter) -> None:
    """Declare the registers that store how far the body turns and climbs."""
    if has_lean_clips(w):
        for name in ("turn", "slope", *(f"was.{axis}" for axis in AXES)):
            w.declare_register(f"lean#{name}", ValueKind.F32, "memory")


def store_start_heading(w: PlanWriter) -> None:
    """Store the heading at birth as the previous heading. In the first step, the body then has not turned."""
    if has_lean_clips(w):
        w.store_vector("lean#was", w.read_vector("heading"), None)


def update_leaning(w: PlanWriter) -> None:
    """Write the statements that store how far the body has turned since the previous step, and the slope of its heading. Call
    this once per step."""
    if not has_lean_clips(w):
        return
    b, dt, heading = w.b, w.read_run_value("dt"), w.read_vector("heading")
    turned = b(
        "div",
        values.compute_dot_product(b, values.compute_cross_product(b, w.read_vector("lean#was"), heading), w.read_vector("up")),
        dt,
    )
    climb = values.compute_dot_product(b, heading, VectorNodes(*(w.read_run_value(f"up_{axis}") for axis in AXES)))
    share = b("sub", b.add_number(1), b("exp", b("neg", b("div", dt, b.add_number(LEAN_SMOOTHING_SECONDS)))))
    for name, measure, full_value in (("turn", turned, FULL_LEAN_TURN), ("slope", climb, FULL_LEAN_SLOPE)):
        now = w.read_at_step_start(f"lean#{name}")
        wish = _clamp_to_unit(w, b("div", measure, b.add_number(full_value)))
        w.add_store(f"lean#{name}", b("add", now, b("mul", b("sub", wish, now), share)), None)
    w.store_vector("lean#was", heading, None)


def _clamp_to_unit(w: PlanWriter, measure: PlanNode) -> PlanNode:
    return w.b("min", w.b("max", measure, w.b.add_number(-1)), w.b.add_number(1))
