"""A running scene with its history. It can advance, go back to any simulated frame, and accept edits at any of these.

To go back, frames are simulated again from the nearest checkpoint, with identical bits. A change at an earlier frame starts a
branch."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from math import inf
from pathlib import Path

from antdsl import limits
from antdsl.diagnostics import Report
from antdsl.pipeline import RunChoices, Shot
from antdsl.preview.agent_columns import Arrays
from antdsl.preview.compiling import SceneCompiler
from antdsl.preview.directing.hand_notes import (
    HandNotes,
    describe_switched_notes,
    drop_written_notes,
    find_last_unaffected_frame,
    list_active_lines,
    switch_off_failed_notes,
)
from antdsl.preview.layer_order import DisabledLayers, remove_disabled_layers
from antdsl.preview.outcomes import (
    EditOutcome,
    find_binding_params,
    make_error_outcome,
    make_silencing_settings,
    parse_param,
    shorten_text,
)
from antdsl.preview.precompiled_shot import describe_changed_files
from antdsl.preview.timeline import SimulationSegment, Timeline, find_nearest_checkpoint
from antdsl.reload import describe_migration
from antdsl.runtime import BindError, FaultStop, LimitStop, Options, World, bind, state_hash, step
from antdsl.runtime.binding.start_findings import find_start_warnings
from antdsl.runtime.profiling import StepMeter

_RESTARTED_TEXT = "simulated again from the first frame"


class PreviewSession:
    """A running scene with its history. `PreviewSession.open` creates one."""

    world: World  # read-only for callers

    def __init__(self, compiler: SceneCompiler, options: Options, timeline: Timeline) -> None:
        self.compiler, self.options, self.timeline = compiler, options, timeline
        self.playing = False
        self.notes: HandNotes = ()  # in addition to those of the scene, for all frames
        self.fault_text: str | None = None  # of the last step
        self._settings_of_disabled_fields: dict[str, dict[str, str]] = {}  # settings of disabled fields
        self.meter: StepMeter | None = None  # if set, measures each step; see `set_measuring`
        self.on_new_world: Callable[[PreviewSession], None] | None = None  # called when `world` was replaced
        self._current_stretch: SimulationSegment

    @classmethod
    def open(
        cls,
        scene: Path,
        choices: RunChoices | None = None,
        options: Options | None = None,
        *,
        checkpoint_interval: int = 24,
        budget: int = limits.GIB // 4,
        compiler: SceneCompiler | None = None,
    ) -> tuple[PreviewSession | None, Report]:
        """Return a session at the scene's first simulated frame, and a report. The session is None if there are errors.

        `checkpoint_interval`: frames between checkpoints.
        `budget`: bytes of memory for all stored data.
        `compiler`: an existing compiler of this scene; by default a new one."""
        session = cls(compiler or SceneCompiler(scene), options or Options(), Timeline(checkpoint_interval, budget))
        report = session._restart_from_first_frame(choices or RunChoices(), {}).report
        return (session if report.ok else None), report

    # --- time --------------------------------------------------------------------------------------------------------

    @property
    def shot(self) -> Shot:
        """Return the shot that simulates the current frame."""
        return self._current_stretch.shot

    @property
    def disabled_layers(self) -> DisabledLayers:
        """Return the layers that are switched off: the file of each, by species and layer text."""
        return self._current_stretch.disabled_layers

    @property
    def frame(self) -> int:
        """Return the number of the current frame."""
        return self.world.frame

    @property
    def first_frame(self) -> int:
        """Return the number of the first frame that is still stored."""
        return self.timeline.stretches[0].first

    @property
    def last_frame(self) -> int:
        """Return the number of the last simulated frame."""
        return self.timeline.last_frame

    @property
    def state_hash(self) -> str:
        """Return the state hash of the current frame."""
        return state_hash(self.world)

    @property
    def is_edited(self) -> bool:
        """Return whether a value or file changed during the run, except changes that were undone at the same frame."""
        return any(not stretch.is_fresh or stretch.param_changes for stretch in self.timeline.stretches)

    @property
    def choices(self) -> RunChoices:
        """Return the values and notes that the user had set by this frame."""
        changed = {c.name: c.text for c in self._current_stretch.param_changes if c.frame <= self.frame}
        params = {**self._current_stretch.choices.params, **changed}
        return replace(self._current_stretch.choices, params=params, notes=list_active_lines(self.notes))

    def step(self) -> None:
        """Advance by one frame: within the recorded history if possible, otherwise by simulation."""
        self._simulate_step()
        later = self.timeline.find_next_stretch(self._current_stretch)
        if later is not None and later.first == self.frame:
            self._restore_checkpoint(later, later.first)
        self.timeline.store_frame(self._current_stretch, self.world)

    def seek(self, frame: int) -> None:
        """Go to a frame that was simulated. Raises ValueError if the frame was not simulated, or is no longer stored."""
        self._check_frame_is_stored(frame)
        if not self.is_ahead(frame):
            self._restore_checkpoint(self.timeline.find_stretch(frame), self.find_checkpoint_frame(frame))
        while self.frame < frame:
            self._simulate_step()

    def is_ahead(self, frame: int) -> bool:
        """Return whether simulating from the current frame reaches `frame` at least as fast as from any checkpoint."""
        stretch = self.timeline.find_stretch(frame)
        return stretch is self._current_stretch and find_nearest_checkpoint(stretch, frame) <= self.frame <= frame

    def find_checkpoint_frame(self, frame: int) -> int:
        """Return the frame of the checkpoint from which `frame` is simulated. Raises ValueError as `seek` does."""
        self._check_frame_is_stored(frame)
        return find_nearest_checkpoint(self.timeline.find_stretch(frame), frame)

    def _check_frame_is_stored(self, frame: int) -> None:
        if not self.first_frame <= frame <= self.last_frame:
            raise ValueError(f"frame {frame} is not among those stored, {self.first_frame} to {self.last_frame}")

    def read_reduced_frame(self, frame: int) -> Mapping[str, Arrays] | None:
        """Return the stored arrays of agents at a frame, by species; None if the frame is no longer stored. Nothing is
        simulated."""
        return self.timeline.reduced_frames.get(frame)

    def _simulate_step(self) -> None:
        self.fault_text = None
        self._current_stretch.apply_param_changes(self.world)
        if self.meter is not None:
            self.meter.begin_measuring(self.world)
        frame = self.world.frame
        try:
            step(self.world)
        except LimitStop as stop:  # the world is in the middle of a step
            self._restore_checkpoint(self._current_stretch, find_nearest_checkpoint(self._current_stretch, frame))
            while self.frame < frame:
                self._simulate_step()
            self.fault_text, self.playing = stop.fault.brief_text, False
        except FaultStop as stop:
            self.fault_text, self.playing = stop.fault.brief_text, False
        if self.meter is not None:
            self.meter.record_steps(self.world)

    def set_measuring(self, is_on: bool) -> None:
        """Start or stop measuring the time of each part of a step. The measurements are in `meter`; results do not change."""
        if self.meter is not None:
            self.meter.stop_measuring()
        self.meter = StepMeter() if is_on else None

    def _restore_checkpoint(self, stretch: SimulationSegment, frame: int) -> None:
        """Replace the session's world by a new one with the state of a checkpoint of `stretch`."""
        world = stretch.restore_world(stretch.checkpoints[frame], self.options, self.compiler.binding_cache)
        world.watchers = self.world.watchers
        self._enter_world(world, stretch)

    def _enter_world(self, world: World, stretch: SimulationSegment) -> None:
        self._current_stretch, self.world = stretch, world
        if self.on_new_world is not None:
            self.on_new_world(self)

    # --- edits ---------------------------------------------------------------------------------------------------------

    def reload(self) -> EditOutcome:
        """Continue from the current frame with the current files. If these have errors, continue with the last valid program."""
        outcome = self._recompile_files(self.choices, self._current_stretch.disabled_layers)
        if outcome.is_successful or not (self.choices.params or self._current_stretch.disabled_layers or self.notes):
            return outcome
        choices, dropped = self._drop_unknown_choices(self.choices, self._current_stretch.disabled_layers)
        if not dropped:
            return outcome
        outcome = self._recompile_files(choices, self._current_stretch.disabled_layers)
        return replace(outcome, line=" · ".join([outcome.line, *dropped])) if outcome.is_successful else outcome

    def precompile(self) -> None:
        """Compile the current files even if they may still change, so that a later reload is fast. There is no other effect."""
        instead = self.compiler.replacement_texts
        self.compiler.replacement_texts, _ = remove_disabled_layers(self._current_stretch.disabled_layers)
        self.compiler.precompile(self.choices)
        self.compiler.replacement_texts = instead

    def set_value(self, name: str, value: str) -> EditOutcome:
        """Set a param, or a setting of a field, to a number with a unit. The `text` of the outcome is the line to write into the
        scene."""
        text, did = f"set: {{{name}: {value}}}", f"`{name}` is {value}"
        quantity, report = parse_param(self.shot, name, value)
        if quantity is None:
            return EditOutcome(report)
        if name not in self.shot.plan.params or name in find_binding_params(self.shot.plan) or self._lacks_notes():
            choices = self.choices
            return self._recompile_files(
                replace(choices, params={**choices.params, name: value}), self._current_stretch.disabled_layers, text, did
            )
        self.timeline.drop_frames_after(self.frame, text)
        self._current_stretch.change_param(
            self.world, name, value, quantity.to_base_units(self.shot.scene.model.unit_mm, self.world.dt)
        )
        return EditOutcome(report, "from the next frame on", text, did)

    def switch_field(self, name: str, is_on: bool) -> EditOutcome:
        """Switch a field on or off. While it is off, deposits are scaled to less than a millionth and vanish after one step."""
        off = make_silencing_settings(name)
        if name not in self.shot.program.fields:
            return make_error_outcome(f"no program has a field `{name}`")
        chosen = self.choices.params
        if not is_on and not chosen.items() >= off.items():
            self._settings_of_disabled_fields[name] = {key: chosen[key] for key in off if key in chosen}
        params = {key: value for key, value in chosen.items() if off.get(key) != value}
        params |= self._settings_of_disabled_fields.pop(name, {}) if is_on else {}
        text = "" if is_on else f"set: {{{', '.join(f'{key}: {value}' for key, value in off.items())}}}"
        did = f"field `{name}` is switched on again" if is_on else f"field `{name}` is switched off"
        return self._recompile_files(
            replace(self.choices, params=params if is_on else {**params, **off}), self._current_stretch.disabled_layers, text, did
        )

    def switch_layer(self, species: str, layer: str, is_on: bool) -> EditOutcome:
        """Switch a layer of a species on or off. The layer is identified by its text.

        The `text` of the outcome has the lines of the layer as comments."""
        key, off = (species, layer), dict(self._current_stretch.disabled_layers)
        if is_on:
            if off.pop(key, None) is None:
                return make_error_outcome(f"`{species}` has no layer `{layer}` that is off")
            return self._recompile_files(self.choices, off, description=f"layer `{shorten_text(layer)}` is on again")
        plan = self.shot.plan.species.get(species)
        layer_plan = next((each for each in plan.layers if each.span.text == layer), None) if plan is not None else None
        if layer_plan is None:
            return make_error_outcome(f"`{species}` has no layer `{layer}`")
        off[key] = Path(os.path.realpath(layer_plan.span.source.path))
        text = "\n".join(f"# {line.strip()}" for line in layer.splitlines())
        return self._recompile_files(self.choices, off, text, f"layer `{shorten_text(layer)}` is off")

    def replace_notes(self, notes: HandNotes, description: str, text: str = "") -> EditOutcome:
        """Replace the notes that users added. The session goes back to the last frame that this change does not affect, and
        continues from there with the current files and values. `description`, `text`: the outcome's values of the same names."""
        frame = find_last_unaffected_frame(self.notes, notes)
        choices, layers = replace(self.choices, notes=list_active_lines(notes)), self._current_stretch.disabled_layers
        if frame == inf:
            outcome = EditOutcome(line="the run does not change", description=description)
        elif frame < self.first_frame:
            outcome = replace(self._restart_from_first_frame(choices, layers), text=text, description=description)
        else:
            outcome = self._recompile_files(choices, layers, text, description, first=int(min(frame, self.frame)))
        self.notes = notes if outcome.is_successful else self.notes
        return outcome

    def _lacks_notes(self) -> bool:
        """Return whether the current segment was simulated without some of the active notes, which begin at later frames."""
        return self._current_stretch.choices.notes != list_active_lines(self.notes)

    def restart(self) -> EditOutcome:
        """Simulate the current files from the first frame on, with the settings that the user has made.

        The state hashes equal those of `antdsl run` on files that contain these settings."""
        return self._restart_from_first_frame(self.choices, self._current_stretch.disabled_layers)

    def _restart_from_first_frame(self, choices: RunChoices, disabled_layers: DisabledLayers) -> EditOutcome:
        shot, report, _ = self._compile(choices, disabled_layers)
        if shot is None or not report.ok:
            return EditOutcome(report)
        try:
            world = bind(shot.plan, shot.setting, self.options, binding_cache=self.compiler.binding_cache)
        except BindError as why:
            return EditOutcome(why.report)
        report.extend(find_start_warnings(shot.scene, world))
        self.timeline = self.timeline.make_empty_successor(_RESTARTED_TEXT)
        stretch = SimulationSegment(shot, world.frame, "from the first frame", world.origin, choices, disabled_layers)
        self.timeline.start_stretch(stretch, world)
        self.fault_text = None
        self._enter_world(world, stretch)
        return EditOutcome(report, f"{len(self.world):,} agents from frame {self.frame}", description=_RESTARTED_TEXT)

    def _compile(self, choices: RunChoices, disabled_layers: DisabledLayers) -> tuple[Shot | None, Report, list[tuple[str, str]]]:
        """Return the shot of the files with these choices, its report, and the disabled layers that no longer exist. The shot is
        None if there are errors."""
        previous_texts = self.compiler.replacement_texts
        self.compiler.replacement_texts, missing_layers = remove_disabled_layers(disabled_layers)
        shot, report = self.compiler.open(choices)
        if shot is None or not report.ok:
            self.compiler.replacement_texts = previous_texts
        return shot, report, missing_layers

    def _recompile_files(
        self,
        choices: RunChoices,
        disabled_layers: DisabledLayers,
        text: str = "",
        description: str | None = None,
        first: int | None = None,
    ) -> EditOutcome:
        """Continue with the current files and changed choices. `description`: describes the change; None if files changed.
        `first`: the stored frame from which to continue; by default the current one."""
        saved, own_notes = description is None, self._current_stretch.choices.notes
        compiled = replace(choices, notes=own_notes) if saved and set(own_notes) <= set(choices.notes) else choices
        shot, report, missing_layers = self._compile(compiled, disabled_layers)
        if shot is None or not report.ok:
            return EditOutcome(report)
        description, old_notes = describe_changed_files(self.shot, shot) if description is None else description, self.notes
        if saved and shot.inputs == self.shot.inputs:
            if description:  # after a comment or another change without effect on results, such as the camera or the last frame
                self._current_stretch.shot = shot
            undone = self._drop_undone_edit()
            if not (undone and self._lacks_notes()):
                return EditOutcome(
                    report,
                    undone or ("the run does not change" if description else "nothing has changed"),
                    description=description,
                )
        if saved:
            self.notes = drop_written_notes(self.notes, shot.scene)
            choices = replace(choices, notes=list_active_lines(self.notes))
        if choices != compiled:
            shot, report, missing_layers = self._compile(choices, disabled_layers)
            if shot is None or not report.ok:
                return EditOutcome(report)
        frame = self.frame
        if first is not None and first < frame:
            self.seek(first)
        world, migration, findings = self.compiler.migrate_world(self.world, shot)
        report.extend(findings)
        if world is None:
            self.seek(frame)
            return EditOutcome(report)
        report.extend(find_start_warnings(shot.scene, world))
        lines = [f"layer `{layer}` no longer exists" for _, layer in missing_layers]
        line = " · ".join([describe_migration(migration), *lines, *describe_switched_notes(old_notes, self.notes)])
        disabled_layers = {key: path for key, path in disabled_layers.items() if key not in missing_layers}
        stretch = SimulationSegment(shot, world.frame, description, world.origin, choices, disabled_layers)
        stretch.replace(self._current_stretch, self.world, world)
        self.timeline.start_stretch(stretch, world)
        self._enter_world(world, stretch)
        return EditOutcome(report, line, text, description)

    def _drop_undone_edit(self) -> str:
        """Drop later frames that an edit has changed and that are obsolete now, because the edit was undone. Return the reason
        as text, or "" if nothing was dropped."""
        later = [
            each
            for each in self.timeline.stretches
            if each.first > self.frame and each.disabled_layers == self._current_stretch.disabled_layers
        ]
        if all(_has_same_files(each.shot, self.shot) for each in later):
            return ""
        line = "the files are again as they were at this frame: later frames are simulated again"
        self.timeline.drop_frames_after(self.frame, line)
        return line

    def _drop_unknown_choices(self, choices: RunChoices, disabled_layers: DisabledLayers) -> tuple[RunChoices, list[str]]:
        """Return the choices without values and notes that the current files cannot use, and one text about each removed value or
        note."""
        shot, report, _ = self._compile(replace(choices, params={}, notes=()), disabled_layers)
        if shot is None or not report.ok:
            return choices, []
        fits = {name: value for name, value in choices.params.items() if parse_param(shot, name, value)[0] is not None}
        dropped = [f"`{name}: {value}` no longer fits" for name, value in choices.params.items() if name not in fits]
        old_notes, choices = self.notes, replace(choices, params=fits)
        self.notes = switch_off_failed_notes(self.notes, self._compile(choices, disabled_layers)[1])
        dropped += describe_switched_notes(old_notes, self.notes)
        return replace(choices, notes=list_active_lines(self.notes)), dropped


def _has_same_files(a: Shot, b: Shot) -> bool:
    """Return whether two shots were compiled from the same files. Values and notes that the user set are ignored. A camera is
    compared only if both shots list it, because only shots with notes list all cameras."""
    names = (a.inputs.keys() | b.inputs.keys()) - {n for shot in (a, b) for n in shot.inputs if n.startswith("--")}
    common = a.inputs.keys() & b.inputs.keys()
    return all(a.inputs.get(n) == b.inputs.get(n) for n in names if n in common or not n.startswith("camera "))
