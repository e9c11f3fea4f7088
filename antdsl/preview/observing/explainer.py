"""Explanations of an agent's decisions in a running session.

The agent's step is simulated again in a separate world, from the nearest checkpoint of the same segment of history. The
session's own world does not change."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.explain import (
    ExplainError,
    LocatedExplanation,
    StepReplay,
    explain_agents_with_positions,
    format_explanation,
    make_absence_error,
    make_json_document,
    merge_state_frames,
)
from antdsl.explain.model import StateInterval as StateStretch
from antdsl.pipeline import Shot
from antdsl.preview.agent_columns import Arrays
from antdsl.preview.session import PreviewSession
from antdsl.preview.timeline import ParamChange, SimulationSegment
from antdsl.runtime import World, take_checkpoint

_CACHED_STRETCHES = 2  # stretches with cached replays: before and after an edit


@dataclass(slots=True, eq=False)
class StretchHistory:
    """The history of one segment of a session, in the form that replays need.

    `extra_checkpoints`: one additional checkpoint, at the frame of the last replay."""

    session: PreviewSession
    stretch: SimulationSegment
    extra_checkpoints: dict[int, Arrays] = field(default_factory=dict)

    @property
    def shot(self) -> Shot:
        """Return the shot that simulated the segment."""
        return self.stretch.shot

    def checkpoint_frames(self) -> Sequence[int]:
        """Return the numbers of all frames that have a checkpoint, in ascending order."""
        return sorted({*self.stretch.checkpoints, *self.extra_checkpoints})

    def restore_world(self, point: int) -> World | None:
        """Return a new world with the state of the checkpoint at frame `point`."""
        arrays = self.extra_checkpoints[point] if point in self.extra_checkpoints else self.stretch.checkpoints[point]
        return self.stretch.restore_world(arrays, self.session.options, self.session.compiler.binding_cache)

    def find_hash(self, frame: int) -> str | None:
        """Return the state hash of the session's current frame; None for other frames.

        Also return None if a param was set at this frame, because the new value takes effect only in the next step."""
        is_current = self.session.timeline.find_stretch(frame) is self.stretch and self.session.frame == frame
        return (
            self.session.state_hash
            if is_current and all(change.frame != frame for change in self.stretch.param_changes)
            else None
        )

    def apply_interventions(self, world: World) -> None:
        """Set the params that the user changed at the world's current frame."""
        self.stretch.apply_param_changes(world)

    def make_missing_error(self, frame: int) -> ExplainError:
        """Return the error that reports that a frame is no longer stored."""
        return ExplainError(f"the history of frame {frame} is no longer stored", f"stored from {self.session.first_frame} on")

    def make_difference_error(self, frame: int) -> ExplainError:
        """Return the error for a frame that a replay does not reproduce bit by bit."""
        return ExplainError(f"frame {frame} is computed differently than before", "this is a bug in antdsl: please report it")


class Explainer:
    """Explains agents of one session. Replays of recent segments are cached, so that further explanations are fast."""

    def __init__(self, session: PreviewSession) -> None:
        self.session = session
        self._cached_replays: list[tuple[SimulationSegment, tuple[ParamChange, ...], StepReplay]] = []

    def explain(self, agents: Sequence[tuple[str, int]], frame: int) -> list[LocatedExplanation | None]:
        """Return, for each agent (species, id), its decisions in the step that leads to `frame`, and its states over time.

        The entry is None for an agent without decisions in this step. Raises ExplainError if no explanation is possible."""
        replay = self._find_replay(frame)
        for species, _ in agents:
            _check_species(species, replay.shot)
        history = replay.history
        assert isinstance(history, StretchHistory)
        if frame - 1 not in history.extra_checkpoints:  # requests for other agents usually follow the first one soon
            history.extra_checkpoints = {frame - 1: take_checkpoint(replay.restore_step_start(frame))}
        return [
            None if account is None else replace(account, explanation=self._add_state_history(account))
            for account in explain_agents_with_positions(replay, frame, agents)
        ]

    def make_message(self, species: str, agent: int, frame: int, name_file: Callable[[str], str] = str) -> dict[str, Any]:
        """Return the message that explains one agent. `name_file`: converts a file's path to the name that pages show."""
        account, why = None, ""
        try:
            [account] = self.explain([(species, agent)], frame)
            if account is None:
                why = _format_error(make_absence_error(self._find_replay(frame), species, agent, frame))
        except ExplainError as error:
            why = _format_error(error)
        reply = {"op": "explained", "species": species, "agent": agent, "frame": frame, "message": why}
        if account is None:
            return reply | {"explanation": None, "told": "", "place": None, "neighbours": []}
        return reply | {
            "explanation": _rename_files(make_json_document(account.explanation), name_file),
            "told": format_explanation(account.explanation),
            "place": list(account.position),
            "neighbours": [list(place) for place in account.neighbour_positions],
        }

    def _find_replay(self, frame: int) -> StepReplay:
        """Return the replay of the step that leads to `frame`. The replay uses the segment in which this step began."""
        first, head = self.session.first_frame, self.session.last_frame
        if frame == first:
            raise ExplainError(f"frame {frame} is the first: no step led to it", f"choose frame {frame + 1} or later")
        if not first < frame <= head:
            stored = f"frames {first + 1} to {head} can be explained" if head > first else "no step has been simulated yet"
            raise ExplainError(f"frame {frame} was not simulated, or is no longer stored", stored)
        stretch = self.session.timeline.find_stretch(frame - 1)
        key = tuple(stretch.param_changes)
        self._cached_replays = [stored for stored in self._cached_replays if stored[0] in self.session.timeline.stretches]
        for known, changes, replay in self._cached_replays:
            if known is stretch and changes == key:
                return replay
        replay = StepReplay(StretchHistory(self.session, stretch))
        self._cached_replays = [stored for stored in self._cached_replays if stored[0] is not stretch][1 - _CACHED_STRETCHES :]
        self._cached_replays.append((stretch, key, replay))
        return replay

    def _add_state_history(self, explanation_location: LocatedExplanation) -> Any:
        explanation = explanation_location.explanation
        state_strip = tuple(self._collect_state_stretches(explanation.species, explanation.agent))
        alive = (min(each.first for each in state_strip), max(each.last for each in state_strip)) if state_strip else None
        return replace(explanation, strip=state_strip, alive=alive)

    def _collect_state_stretches(self, species: str, agent: int) -> Iterator[StateStretch]:
        """Yield the periods that the agent spent in each state, in all stored frames, one machine after the other."""
        frames_by_machine: dict[str, list[tuple[int, str]]] = {}
        for frame, light in sorted(self.session.timeline.reduced_frames.items()):
            if species not in light:
                continue
            rows = np.flatnonzero(light[species]["id"] == agent)
            plan = self.session.timeline.find_stretch(frame).shot.plan.species.get(species)
            for machine in plan.machines if plan is not None and len(rows) else ():
                state = machine.states[int(light[species][f"state/{machine.name}"][rows[0]])]
                frames_by_machine.setdefault(machine.name, []).append((frame, state))
        for name, frames in frames_by_machine.items():
            yield from merge_state_frames(name, frames)


def _check_species(species: str, shot: Shot) -> None:
    if species not in shot.plan.species:
        near = find_nearest_name(species, shot.plan.species)
        listed = ", ".join(f"`{name}`" for name in shot.plan.species)
        raise ExplainError(f"no species `{species}`", f"did you mean `{near}`?" if near else f"there is {listed}")


def _format_error(error: ExplainError) -> str:
    return f"{error}: {error.help}" if error.help else str(error)


def _rename_files(value: Any, name_file: Callable[[str], str]) -> Any:
    """Return a copy of a JSON value in which `name_file` has renamed each file."""
    if isinstance(value, dict):
        return {key: name_file(each) if key == "file" else _rename_files(each, name_file) for key, each in value.items()}
    return [_rename_files(each, name_file) for each in value] if isinstance(value, list) else value
