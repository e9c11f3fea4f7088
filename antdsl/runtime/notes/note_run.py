"""The notes of a running world: the agents to which they apply, and the values that they store between steps."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import vectors as vec
from antdsl.numerics.easing import compute_ease_weight
from antdsl.numerics.vectors import VectorArrays
from antdsl.runtime.moving.contacts.capsules import CapsuleCrowd
from antdsl.runtime.moving.correction_walks import CorrectionWalker
from antdsl.runtime.moving.pacing import SpeedShares
from antdsl.runtime.notes.absences import remove_agents_of_absence_notes
from antdsl.runtime.notes.active_notes import ActiveNote, NotedAgents, Rows, compute_note_weight
from antdsl.runtime.notes.display_verbs import end_displays
from antdsl.runtime.notes.outlines import WidenedPolygon
from antdsl.runtime.notes.stagger import find_greatest_delay, get_or_compute_delays
from antdsl.runtime.notes.target_findings import MissedTarget, find_missed_target
from antdsl.runtime.notes.verbs import FUNCTIONS_BY_NOTE_VERB, NoteVerbFunctions
from antdsl.runtime.notes.wishes import FINAL_WISH_REGISTER, has_state_wish
from antdsl.runtime.sensing.selectable_agents import collect_selectable_frame
from antdsl.runtime.world import Population, World
from antdsl.scene.notes.notes_model import Note
from antdsl.scene.notes.selection import SelectableFrame, select_ids
from antdsl.scene.notes.selectors import needs_frame
from antdsl.scene.setting import WorldSetting

_MIN_CORRECTION_MM = 1e-6  # mm: less is rounding
_SPEED_SHARES_NAME = "pace"  # of the shares of the speed in the last step


@dataclass(slots=True, eq=False)
class ActiveNotesRun:
    """The notes of a world, by the keys that they have in the memory.

    `get_stored_arrays`: named arrays for later steps: ids found by selectors of positions or states, and the fractions of speed
    of the last step. `active_notes`: the active notes of this step. `speed_shares`: the fractions of speed in this step, by
    species. `outlines`: a cache, by thing and frame."""

    notes: Mapping[str, Note]
    stored_arrays: dict[str, NDArray[Any]] = field(default_factory=dict)
    active_notes: list[ActiveNote] = field(default_factory=list)
    speed_shares: dict[str, SpeedShares] = field(default_factory=dict)
    missed_targets: list[MissedTarget] = field(default_factory=list)
    outlines: dict[tuple[str, int], list[WidenedPolygon]] = field(default_factory=dict)

    @staticmethod
    def make_for_setting(setting: WorldSetting) -> ActiveNotesRun | None:
        """Return the notes of a setting. None if it has no notes."""
        notes: dict[str, Note] = {}
        counts: Counter[str] = Counter()  # equal notes have different keys
        for note in setting.notes:
            if note.off == "no":
                text = repr(note)
                notes[hashlib.blake2b(f"{text}{counts[text] or ''}".encode(), digest_size=8).hexdigest()] = note
                counts[text] += 1
        return ActiveNotesRun(notes) if notes else None

    def restore_memory(self, memory: Mapping[str, NDArray[Any]]) -> None:
        """Replace the memory by copies of those arrays that belong to these notes."""
        self.stored_arrays = {
            n: array.copy() for n, array in memory.items() if n.partition(".")[0] in {_SPEED_SHARES_NAME, *self.notes}
        }

    # --- stages of a step ---------------------------------------------------------------------------------------------

    def begin_step(self, world: World) -> None:
        """Find the active notes and their agents, and the agents that move at another speed than usual."""
        frame: SelectableFrame | None = None
        self.active_notes.clear()
        for key, note in self.notes.items():
            if FUNCTIONS_BY_NOTE_VERB[note.verb] != NoteVerbFunctions() and self._may_note_apply(world, key, note):
                frame = frame or collect_selectable_frame(world)
                self.active_notes.append(self._activate_note(world, key, note, frame))
        for functions, agents in self._iterate_noted_agents(world):
            if functions.begin_step is not None:
                functions.begin_step(agents)
        for population in world.populations.values():
            end_displays(world, population)
        self._compute_speed_shares(world)

    def apply_wishes(self, world: World, register: str) -> None:
        """Mix the wishes of notes into a register: into what states steer, or into the result of the layers."""
        for functions, agents in self._iterate_noted_agents(world):
            is_mixed = has_state_wish(agents.population)
            if functions.add_wishes is not None and (is_mixed or register == FINAL_WISH_REGISTER):
                functions.add_wishes(agents, register, is_mixed and register == FINAL_WISH_REGISTER)

    def apply_value_notes(self, world: World) -> None:
        """Set attributes of agents as the active notes request."""
        for functions, agents in self._iterate_noted_agents(world):
            if functions.set_values is not None:
                functions.set_values(agents)

    def remove_absent_agents(self, world: World, first_rows: dict[str, int], *, is_start: bool = False) -> None:
        """Remove newborn agents that notes exclude. `first_rows`: by species, the row of the first newborn agent."""
        remove_agents_of_absence_notes(world, self.notes.values(), first_rows, is_start)

    def apply_speed_shares(self, world: World) -> None:
        """Scale the limits of agents that move at another speed than usual."""
        for name, paces in self.speed_shares.items():
            paces.scale_limits(world.populations[name])

    def limit_steps(self, world: World, population: Population, motion: tuple[VectorArrays, VectorArrays], dt: float) -> None:
        """Shorten the steps of a species where notes forbid them. `motion`: steps (mm) and velocities (mm/s), changed in place,
        for a substep of `dt` s."""
        for active in self.active_notes:
            cut = FUNCTIONS_BY_NOTE_VERB[active.note.verb].limit_steps
            if cut is None or population.name not in active.rows:
                continue
            rows = active.rows[population.name]
            full_steps = vec.stack_rows(vec.take_rows(motion[0], rows))
            steps = cut(NotedAgents(world, active, population), full_steps)
            at = np.flatnonzero((steps != full_steps).any(axis=1))
            for k in range(3):
                motion[0][k][rows[at]] = steps[at, k]
                motion[1][k][rows[at]] = steps[at, k] / dt

    def undo_forbidden_pushes(self, world: World, starts: Mapping[str, NDArray[np.float64]], dt: float) -> None:
        """Walk agents back if contacts have pushed them to positions that notes forbid.

        `starts`: by species, the positions (n, 3) mm at the start of the substep of `dt` s."""
        cuts = [
            (active, cut)
            for active in self.active_notes
            if (cut := FUNCTIONS_BY_NOTE_VERB[active.note.verb].limit_steps) is not None and active.rows
        ]
        crowd = CapsuleCrowd(world) if cuts else None
        for active, cut in cuts:
            assert crowd is not None
            for number, population in enumerate(crowd.species):
                if population.name not in active.rows:
                    continue
                pushed = NotedAgents(world, active, population)
                pushed = pushed.select_agents(np.argsort(pushed.rows))
                rows, arrived, start = pushed.rows, population.position, starts[population.name]
                population.position = start  # steps are measured from there
                allowed = cut(pushed, arrived[rows] - start[rows])
                population.position = arrived
                back = allowed - (arrived[rows] - start[rows])
                at = np.flatnonzero((np.abs(back) > _MIN_CORRECTION_MM).any(axis=1))
                if len(at):
                    CorrectionWalker(crowd, starts, dt).walk_corrections(
                        rows[at] + crowd.first[number], np.ascontiguousarray(back[at].T)
                    )

    def restore_speeds(self, world: World) -> None:
        """Restore the limits that `apply_speed_shares` changed, and record agents that missed their target."""
        for name, paces in self.speed_shares.items():
            paces.restore_limits(world.populations[name])
        missed = (find_missed_target(agents) for _, agents in self._iterate_noted_agents(world))
        self.missed_targets += [each for each in missed if each is not None]

    # --- agents -------------------------------------------------------------------------------------------------------

    def _may_note_apply(self, world: World, key: str, note: Note) -> bool:
        """Return whether a note may apply to at least one agent in this step."""
        most = find_greatest_delay(world, key, self.stored_arrays)
        return bool(compute_ease_weight(note.first_frame, note.last_frame + most, note.ease_frames, world.display_frame))

    def _activate_note(self, world: World, key: str, note: Note, frame: SelectableFrame) -> ActiveNote:
        """Return a note together with the agents to which it applies in this step."""
        rows = self._find_selected_rows(world, key, note, frame)
        delays = get_or_compute_delays(world, note, rows, self.stored_arrays, key)
        if note.delay_rule is not None:
            for name, own in list(rows.items()):
                chosen = np.flatnonzero(compute_note_weight(note, delays[name], world.display_frame))
                rows[name], delays[name] = own[chosen], delays[name][chosen]
        return ActiveNote(note, key, {name: own for name, own in rows.items() if len(own)}, delays)

    def _find_selected_rows(self, world: World, key: str, note: Note, frame: SelectableFrame) -> dict[str, Rows]:
        """Return the living agents that a note selects, by species. Selectors of positions and states are evaluated only when the
        note begins."""
        selector = note.selector
        names = {species: f"{key}.{species}.ids" for species in world.populations}
        if not needs_frame(selector):
            selected = select_ids(selector, frame)
        elif not names.values() & self.stored_arrays.keys():
            selected = select_ids(selector, frame)
            self.stored_arrays |= {name: selected.get(species, np.empty(0, np.int64)) for species, name in names.items()}
        else:
            selected = {species: self.stored_arrays[name] for species, name in names.items() if name in self.stored_arrays}
        rows = {species: world.populations[species].find_rows(ids) for species, ids in selected.items()}
        return {species: own[own >= 0] for species, own in rows.items() if (own >= 0).any()}

    def _iterate_noted_agents(self, world: World) -> Iterator[tuple[NoteVerbFunctions, NotedAgents]]:
        for active in self.active_notes:
            for species in active.rows:
                yield FUNCTIONS_BY_NOTE_VERB[active.note.verb], NotedAgents(world, active, world.populations[species])

    def _compute_speed_shares(self, world: World) -> None:
        """Compute for each agent the fraction of its speed at which it moves: the product of the fractions of active notes."""
        shares: dict[str, NDArray[np.float32]] = {}
        for functions, agents in self._iterate_noted_agents(world):
            if functions.compute_speed_shares is not None:
                own = shares.setdefault(agents.population.name, np.ones(len(agents.population), np.float32))
                own[agents.rows] *= functions.compute_speed_shares(agents)
        self.speed_shares.clear()
        for name, population in world.populations.items():
            previous = np.ones(len(population), np.float32)
            ids_name, shares_name = (f"{_SPEED_SHARES_NAME}.{name}.{part}" for part in ("ids", "shares"))
            if ids_name in self.stored_arrays:
                rows = population.find_rows(self.stored_arrays.pop(ids_name))
                previous[rows[rows >= 0]] = self.stored_arrays.pop(shares_name)[rows >= 0]
            own = shares.get(name, np.ones(len(population), np.float32))
            rows = np.flatnonzero((own != 1) | (previous != 1))
            if len(rows):
                self.speed_shares[name] = paces = SpeedShares(rows, own[rows], previous[rows])
                paces.restore_full_velocities(population)
                slow = rows[own[rows] != 1]
                slow = slow[np.argsort(population.ids[slow])]
                self.stored_arrays[ids_name], self.stored_arrays[shares_name] = population.ids[slow], own[slow]
