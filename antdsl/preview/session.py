"""A scene under way with its history: it goes on, goes back to any frame that was simulated, and takes edits at any of them.

Going back re-simulates from the nearest checkpoint, to the same bits; what is changed at an earlier frame begins a branch."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from antdsl import limits
from antdsl.diagnostics import Report
from antdsl.pipeline import Choices, Shot
from antdsl.plan.ir import Plan
from antdsl.plan.traverse import field_nodes, needed, operands, statements
from antdsl.preview.compiling import Compiler
from antdsl.preview.layer_order import Off, texts_without
from antdsl.preview.speculative import differing
from antdsl.preview.timeline import Light, Stretch, Timeline, nearest_checkpoint
from antdsl.reload import migration_line
from antdsl.runtime import BindError, FaultStop, LimitStop, Options, World, bind, state_hash, step
from antdsl.runtime.binding.start_findings import start_findings
from antdsl.runtime.profiling import Meter
from antdsl.scene.field_settings import settable
from antdsl.scene.matching import check_param
from antdsl.scene.quantities import BadQuantity, Quantity, parse_quantity

_AGAIN = "simulated again from the first frame"
_LAYER = 60  # letters of a layer that are told


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of an edit: `did` says what was edited, `line` what was kept, moved and reset; `text` is what to write into a
    file to have the same for good. With errors in the report nothing has changed."""

    report: Report = field(default_factory=Report)
    line: str = ""
    text: str = ""
    did: str = ""

    @property
    def ok(self) -> bool:
        return self.report.ok


class Session:
    """Make one with `Session.open`."""

    world: World  # to be read only

    def __init__(self, compiler: Compiler, options: Options, timeline: Timeline) -> None:
        self.compiler, self.options, self.timeline = compiler, options, timeline
        self.playing = False
        self.fault: str | None = None  # of the last step
        self._before_off: dict[str, dict[str, str]] = {}  # what was set of fields that are off
        self.meter: Meter | None = None  # measures each step while there is one; see `measure`
        self.on_world: Callable[[Session], None] | None = None  # called when `world` is another one than before
        self._stretch: Stretch

    @classmethod
    def open(
        cls,
        scene: Path,
        choices: Choices | None = None,
        options: Options | None = None,
        *,
        every: int = 24,
        budget: int = limits.GIB // 4,
        compiler: Compiler | None = None,
    ) -> tuple[Session | None, Report]:
        """A session at the scene's first simulated frame, or None and complaints. A checkpoint each `every` frames; `budget`
        bytes of memory for all that is kept. `compiler`: one that has tried this scene before."""
        made = cls(compiler or Compiler(scene), options or Options(), Timeline(every, budget))
        report = made._begin(choices or Choices(), {}).report
        return (made if report.ok else None), report

    # --- time --------------------------------------------------------------------------------------------------------

    @property
    def shot(self) -> Shot:
        return self._stretch.shot

    @property
    def off(self) -> Off:
        """Layers that are off, by species and text, with the file that each stands in."""
        return self._stretch.off

    @property
    def frame(self) -> int:
        return self.world.frame

    @property
    def first(self) -> int:
        return self.timeline.stretches[0].first

    @property
    def head(self) -> int:
        """The last frame that was simulated."""
        return self.timeline.head

    @property
    def hash(self) -> str:
        return state_hash(self.world)

    @property
    def edited(self) -> bool:
        """Whether something was changed while it ran, and not put back at the same frame: it is not what a fresh run gives."""
        return any(not stretch.fresh or stretch.changes for stretch in self.timeline.stretches)

    @property
    def choices(self) -> Choices:
        """What was set by hand, as of this frame."""
        changed = {c.name: c.text for c in self._stretch.changes if c.frame <= self.frame}
        return replace(self._stretch.choices, params={**self._stretch.choices.params, **changed})

    def step(self) -> None:
        """One frame on: through history as it was, then further. A value at fault stops nothing but `playing`."""
        self._step()
        later = self.timeline.after(self._stretch)
        if later is not None and later.first == self.frame:
            self._restore(later, later.first)
        self.timeline.note(self._stretch, self.world)

    def seek(self, frame: int) -> None:
        """Be at a frame that was simulated. ValueError for any other, also for one that is forgotten."""
        self._kept(frame)
        if not self.leads_to(frame):
            self._restore(self.timeline.at(frame), self.nearest(frame))
        while self.frame < frame:
            self._step()

    def leads_to(self, frame: int) -> bool:
        """Whether a frame is reached from where one is by simulating on, as fast as from any checkpoint."""
        stretch = self.timeline.at(frame)
        return stretch is self._stretch and nearest_checkpoint(stretch, frame) <= self.frame <= frame

    def nearest(self, frame: int) -> int:
        """The frame with a checkpoint that a frame is simulated from. ValueError as `seek`."""
        self._kept(frame)
        return nearest_checkpoint(self.timeline.at(frame), frame)

    def _kept(self, frame: int) -> None:
        if not self.first <= frame <= self.head:
            raise ValueError(f"frame {frame} is not among those stored, {self.first} to {self.head}")

    def shown(self, frame: int) -> Mapping[str, Light] | None:
        """The agents at a frame by species, without simulating anything; None where that is forgotten."""
        return self.timeline.light.get(frame)

    def _step(self) -> None:
        self.fault = None
        self._stretch.before_step(self.world)
        if self.meter is not None:
            self.meter.begin(self.world)
        frame = self.world.frame
        try:
            step(self.world)
        except LimitStop as stop:  # the world is in the middle of a step
            self._restore(self._stretch, nearest_checkpoint(self._stretch, frame))
            while self.frame < frame:
                self._step()
            self.fault, self.playing = stop.fault.brief, False
        except FaultStop as stop:
            self.fault, self.playing = stop.fault.brief, False
        if self.meter is not None:
            self.meter.end(self.world)

    def measure(self, on: bool) -> None:
        """Measure what each step spends its time on, in `meter`, or no longer. Changes no result."""
        if self.meter is not None:
            self.meter.stop()
        self.meter = Meter() if on else None

    def _restore(self, stretch: Stretch, frame: int) -> None:
        """Be in a stretch as it was at a checkpoint, in a world that nothing was dug in yet."""
        world = stretch.world(stretch.checkpoints[frame], self.options, self.compiler.built)
        world.watchers = self.world.watchers
        self._enter(world, stretch)

    def _enter(self, world: World, stretch: Stretch) -> None:
        self._stretch, self.world = stretch, world
        if self.on_world is not None:
            self.on_world(self)

    # --- edits ---------------------------------------------------------------------------------------------------------

    def reload(self) -> Outcome:
        """Go on with the files as they are now, from the frame one is at. With errors the last good program runs on."""
        outcome = self._with(self.choices, self._stretch.off)
        if outcome.ok or not (self.choices.params or self._stretch.off):
            return outcome
        choices, dropped = self._known(self.choices, self._stretch.off)
        if not dropped:
            return outcome
        outcome = self._with(choices, self._stretch.off)
        return replace(outcome, line=" · ".join([outcome.line, *dropped])) if outcome.ok else outcome

    def foresee(self) -> None:
        """Compile the files as they are while one waits for them to come to rest, so that a reload finds it done. Nothing else
        comes of it, whatever is in them."""
        instead = self.compiler.instead
        self.compiler.instead, _ = texts_without(self._stretch.off)
        self.compiler.foresee(self.choices)
        self.compiler.instead = instead

    def set(self, name: str, value: str) -> Outcome:
        """Give a param, or a setting of a field, another value: a number and its unit. The text is the line of the scene."""
        text, did = f"set: {{{name}: {value}}}", f"`{name}` is {value}"
        quantity, report = _quantity(self.shot, name, value)
        if quantity is None:
            return Outcome(report)
        if name not in self.shot.plan.params or name in asked_before_the_first_step(self.shot.plan):
            choices = self.choices
            return self._with(replace(choices, params={**choices.params, name: value}), self._stretch.off, text, did)
        self.timeline.cut(self.frame, text)
        self._stretch.change(self.world, name, value, quantity.base(self.shot.scene.model.unit_mm, self.world.dt))
        return Outcome(report, "from the next frame on", text, did)

    def field(self, name: str, on: bool) -> Outcome:
        """Let a field hold scent, or next to none: what is laid stays below a millionth and is gone a step later."""
        off = silenced(name)
        if name not in self.shot.plan.fields:
            return _unknown(f"no program has a field `{name}`")
        chosen = self.choices.params
        if not on and not chosen.items() >= off.items():
            self._before_off[name] = {key: chosen[key] for key in off if key in chosen}
        params = {key: value for key, value in chosen.items() if off.get(key) != value}
        params |= self._before_off.pop(name, {}) if on else {}
        text = "" if on else f"set: {{{', '.join(f'{key}: {value}' for key, value in off.items())}}}"
        did = f"field `{name}` holds scent again" if on else f"field `{name}` holds no scent"
        return self._with(replace(self.choices, params=params if on else {**params, **off}), self._stretch.off, text, did)

    def layer(self, species: str, layer: str, on: bool) -> Outcome:
        """Switch a layer of a species, by its text, off or on again. The text is its lines, commented out."""
        key, off = (species, layer), dict(self._stretch.off)
        if on:
            if off.pop(key, None) is None:
                return _unknown(f"no layer of `{species}` that is off is `{layer}`")
            return self._with(self.choices, off, did=f"layer `{_short(layer)}` is on again")
        plan = self.shot.plan.species.get(species)
        found = next((each for each in plan.layers if each.span.text == layer), None) if plan is not None else None
        if found is None:
            return _unknown(f"no layer of `{species}` is `{layer}`")
        off[key] = Path(os.path.realpath(found.span.source.path))
        text = "\n".join(f"# {line.strip()}" for line in layer.splitlines())
        return self._with(self.choices, off, text, f"layer `{_short(layer)}` is off")

    def restart(self) -> Outcome:
        """Simulate the files as they are, with what was set by hand, from the first frame: a clean run, whose hashes are those of
        `antdsl run` once the lines for what was set stand in the files."""
        return self._begin(self.choices, self._stretch.off)

    def _begin(self, choices: Choices, off: Off) -> Outcome:
        shot, report, _ = self._opened(choices, off)
        if shot is None or not report.ok:
            return Outcome(report)
        try:
            world = bind(shot.plan, shot.setting, self.options, built=self.compiler.built)
        except BindError as why:
            return Outcome(why.report)
        report.extend(start_findings(shot.scene, world))
        self.timeline = self.timeline.begun_again(_AGAIN)
        stretch = Stretch(shot, world.frame, "from the first frame", world.origin, choices, off)
        self.timeline.start(stretch, world)
        self.fault = None
        self._enter(world, stretch)
        return Outcome(report, f"{len(self.world):,} agents from frame {self.frame}", did=_AGAIN)

    def _opened(self, choices: Choices, off: Off) -> tuple[Shot | None, Report, list[tuple[str, str]]]:
        """The shot of the files with these choices, and which layers are there no more."""
        before = self.compiler.instead
        self.compiler.instead, gone = texts_without(off)
        shot, report = self.compiler.open(choices)
        if shot is None or not report.ok:
            self.compiler.instead = before
        return shot, report, gone

    def _with(self, choices: Choices, off: Off, text: str = "", did: str | None = None) -> Outcome:
        """Go on with the files as they are and other choices; without `did` it is the files that may be other ones."""
        shot, report, gone = self._opened(choices, off)
        if shot is None or not report.ok:
            return Outcome(report)
        saved, did = did is None, differing(self.shot, shot) if did is None else did
        if saved and shot.inputs == self.shot.inputs:
            if did:  # a comment, or what no result depends on, such as the camera and the last frame
                self._stretch.shot = shot
            return Outcome(report, self._undone() or ("the run stays as it is" if did else "nothing has changed"), did=did)
        world, migration, findings = self.compiler.take_over(self.world, shot)
        report.extend(findings)
        if world is None:
            return Outcome(report)
        report.extend(start_findings(shot.scene, world))
        line = " · ".join([migration_line(migration), *(f"layer `{layer}` is gone" for _, layer in gone)])
        off = {key: path for key, path in off.items() if key not in gone}
        stretch = Stretch(shot, world.frame, did, world.origin, choices, off)
        stretch.go_on_from(self._stretch, self.world, world)
        self.timeline.start(stretch, world)
        self._enter(world, stretch)
        return Outcome(report, line, text, did)

    def _undone(self) -> str:
        """Where the files are again what they were at this frame, forget what came of the edit that they no longer have."""
        later = [each for each in self.timeline.stretches if each.first > self.frame and each.off == self._stretch.off]
        if all(_files(each.shot) == _files(self.shot) for each in later):
            return ""
        line = "the files are again as they were at this frame: later frames are simulated again"
        self.timeline.cut(self.frame, line)
        return line

    def _known(self, choices: Choices, off: Off) -> tuple[Choices, list[str]]:
        """The choices less the values that the files as they are have no use for, with words about those."""
        shot, report, _ = self._opened(replace(choices, params={}), off)
        if shot is None or not report.ok:
            return choices, []
        fits = {name: value for name, value in choices.params.items() if _quantity(shot, name, value)[0] is not None}
        dropped = [f"`{name}: {value}` fits no more" for name, value in choices.params.items() if name not in fits]
        return replace(choices, params=fits), dropped


def _short(text: str) -> str:
    """A layer's text in a line."""
    words = " ".join(text.split())
    return words if len(words) <= _LAYER else f"{words[: _LAYER - 1]}…"


def silenced(field: str) -> dict[str, str]:
    """What is set to have a field hold next to nothing."""
    return {f"{field}.limit": "0.000001", f"{field}.keeps": "0 %/step"}


def _files(shot: Shot) -> dict[str, str]:
    """What a shot was made of, less what was set by hand."""
    return {name: known for name, known in shot.inputs.items() if not name.startswith("--set ")}


def _quantity(shot: Shot, name: str, value: str) -> tuple[Quantity | None, Report]:
    """A value for a param or a setting of a field, or None and what is wrong with it."""
    report = Report()
    try:
        quantity = parse_quantity(value)
    except BadQuantity as why:
        usual = f"write a number and a unit: `{name}: 50 mm`"
        report.error("wrong-value", f"`{name}: {value}`: `{value}` {why}", None, why.help or usual)
        return None, report
    if name not in shot.program.params and name not in settable(shot.program):
        report.error("unknown-thing", f"no program has a param `{name}`", None)
        return None, report
    check_param(shot.scene, shot.program, report, name, quantity)
    return (quantity if report.ok else None), report


def _unknown(message: str) -> Outcome:
    report = Report()
    report.error("unknown-thing", message, None)
    return Outcome(report)


def asked_before_the_first_step(plan: Plan) -> frozenset[str]:
    """Params that fields, other params or newborn agents are made with. All others may change between two steps."""
    nodes = [node for made in plan.fields.values() for node in field_nodes(made)]
    nodes += [param.default for param in plan.params.values()]
    for species in plan.species.values():
        nodes += [node for _, statement in statements(species.born) for node in operands(statement)]
    return frozenset(str(node.attrs[0]) for node in needed(nodes) if node.op == "param")
