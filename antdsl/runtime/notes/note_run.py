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
from antdsl.runtime.notes.absences import remove_absent
from antdsl.runtime.notes.active_notes import ActiveNote, NoteAgents, Rows, compute_weight
from antdsl.runtime.notes.display_verbs import end_displays
from antdsl.runtime.notes.outlines import Outline
from antdsl.runtime.notes.stagger import find_delays, find_greatest_delay
from antdsl.runtime.notes.target_findings import MissedTarget, find_missed_target
from antdsl.runtime.notes.verbs import VERBS, VerbFunctions
from antdsl.runtime.notes.wishes import FINAL_WISH, has_state_wish
from antdsl.runtime.sensing.selectable_agents import collect_selectable_frame
from antdsl.runtime.world import Population, World
from antdsl.scene.notes.notes_model import Note
from antdsl.scene.notes.selection import SelectableFrame, select_ids
from antdsl.scene.notes.selectors import needs_frame
from antdsl.scene.setting import WorldSetting

_MIN_CUT_MM = 1e-6  # mm: less is rounding
_PACE_KEY = "pace"  # of the shares of the speed in the last step


@dataclass(slots=True, eq=False)
class NoteRun:
    """The notes of a world, by the keys that they have in the memory.

    `memory`: named arrays for later steps: ids found by selectors of positions or states, and the fractions of speed of the last
    step. `active`: the active notes of this step. `paces`: the fractions of speed in this step, by species. `outlines`: a cache,
    by thing and frame."""

    notes: Mapping[str, Note]
    memory: dict[str, NDArray[Any]] = field(default_factory=dict)
    active: list[ActiveNote] = field(default_factory=list)
    paces: dict[str, SpeedShares] = field(default_factory=dict)
    missed_targets: list[MissedTarget] = field(default_factory=list)
    outlines: dict[tuple[str, int], list[Outline]] = field(default_factory=dict)

    @staticmethod
    def of(setting: WorldSetting) -> NoteRun | None:
        """Return the notes of a setting. None if it has no notes."""
        notes: dict[str, Note] = {}
        counts: Counter[str] = Counter()  # equal notes have different keys
        for note in setting.notes:
            if note.off == "no":
                text = repr(note)
                notes[hashlib.blake2b(f"{text}{counts[text] or ''}".encode(), digest_size=8).hexdigest()] = note
                counts[text] += 1
        return NoteRun(notes) if notes else None

    def restore_memory(self, memory: Mapping[str, NDArray[Any]]) -> None:
        """Replace the memory by copies of those arrays that belong to these notes."""
        self.memory = {n: array.copy() for n, array in memory.items() if n.partition(".")[0] in {_PACE_KEY, *self.notes}}

    # --- stages of a step ---------------------------------------------------------------------------------------------

    def begin_step(self, world: World) -> None:
        """Find the active notes and their agents, and the agents that move at another speed than usual."""
        frame: SelectableFrame | None = None
        self.active.clear()
        for key, note in self.notes.items():
            if VERBS[note.verb] != VerbFunctions() and self._may_hold(world, key, note):
                frame = frame or collect_selectable_frame(world)
                self.active.append(self._activate(world, key, note, frame))
        for functions, agents in self._iterate_agents(world):
            if functions.begin is not None:
                functions.begin(agents)
        for population in world.populations.values():
            end_displays(world, population)
        self._begin_paces(world)

    def change_wishes(self, world: World, register: str) -> None:
        """Mix the wishes of notes into a register: into what states steer, or into the result of the layers."""
        for functions, agents in self._iterate_agents(world):
            is_mixed = has_state_wish(agents.population)
            if functions.wish is not None and (is_mixed or register == FINAL_WISH):
                functions.wish(agents, register, is_mixed and register == FINAL_WISH)

    def set_values(self, world: World) -> None:
        """Set attributes of agents as the active notes request."""
        for functions, agents in self._iterate_agents(world):
            if functions.values is not None:
                functions.values(agents)

    def remove_absent(self, world: World, first_rows: dict[str, int], *, is_start: bool = False) -> None:
        """Remove newborn agents that notes exclude. `first_rows`: by species, the row of the first newborn agent."""
        remove_absent(world, self.notes.values(), first_rows, is_start)

    def begin_move(self, world: World) -> None:
        """Scale the limits of agents that move at another speed than usual."""
        for name, paces in self.paces.items():
            paces.scale_limits(world.populations[name])

    def cut_steps(self, world: World, population: Population, motion: tuple[VectorArrays, VectorArrays], dt: float) -> None:
        """Shorten the steps of a species where notes forbid them. `motion`: steps (mm) and velocities (mm/s), changed in place,
        for a substep of `dt` s."""
        for active in self.active:
            cut = VERBS[active.note.verb].step
            if cut is None or population.name not in active.rows:
                continue
            rows = active.rows[population.name]
            full_steps = vec.stack_rows(vec.take_rows(motion[0], rows))
            steps = cut(NoteAgents(world, active, population), full_steps)
            at = np.flatnonzero((steps != full_steps).any(axis=1))
            for k in range(3):
                motion[0][k][rows[at]] = steps[at, k]
                motion[1][k][rows[at]] = steps[at, k] / dt

    def cut_pushes(self, world: World, starts: Mapping[str, NDArray[np.float64]], dt: float) -> None:
        """Walk agents back if contacts have pushed them to positions that notes forbid.

        `starts`: by species, the positions (n, 3) mm at the start of the substep of `dt` s."""
        cuts = [(active, cut) for active in self.active if (cut := VERBS[active.note.verb].step) is not None and active.rows]
        crowd = CapsuleCrowd(world) if cuts else None
        for active, cut in cuts:
            assert crowd is not None
            for number, population in enumerate(crowd.species):
                if population.name not in active.rows:
                    continue
                pushed = NoteAgents(world, active, population)
                pushed = pushed.select(np.argsort(pushed.rows))
                rows, arrived, start = pushed.rows, population.position, starts[population.name]
                population.position = start  # steps are measured from there
                allowed = cut(pushed, arrived[rows] - start[rows])
                population.position = arrived
                back = allowed - (arrived[rows] - start[rows])
                at = np.flatnonzero((np.abs(back) > _MIN_CUT_MM).any(axis=1))
                if len(at):
                    CorrectionWalker(crowd, starts, dt).walk_corrections(
                        rows[at] + crowd.first[number], np.ascontiguousarray(back[at].T)
                    )

    def end_move(self, world: World) -> None:
        """Restore the limits that `begin_move` changed, and record agents that missed their target."""
        for name, paces in self.paces.items():
            paces.restore_limits(world.populations[name])
        missed = (find_missed_target(agents) for _, agents in self._iterate_agents(world))
        self.missed_targets += [each for each in missed if each is not None]

    # --- agents -------------------------------------------------------------------------------------------------------

    def _may_hold(self, world: World, key: str, note: Note) -> bool:
        """Return whether a note may apply to at least one agent in this step."""
        most = find_greatest_delay(world, key, self.memory)
        return bool(compute_ease_weight(note.first_frame, note.last_frame + most, note.ease_frames, world.display_frame))

    def _activate(self, world: World, key: str, note: Note, frame: SelectableFrame) -> ActiveNote:
        """Return a note together with the agents to which it applies in this step."""
        rows = self._find_rows(world, key, note, frame)
        delays = find_delays(world, note, rows, self.memory, key)
        if note.delay_rule is not None:
            for name, own in list(rows.items()):
                chosen = np.flatnonzero(compute_weight(note, delays[name], world.display_frame))
                rows[name], delays[name] = own[chosen], delays[name][chosen]
        return ActiveNote(note, key, {name: own for name, own in rows.items() if len(own)}, delays)

    def _find_rows(self, world: World, key: str, note: Note, frame: SelectableFrame) -> dict[str, Rows]:
        """Return the living agents that a note selects, by species. Selectors of positions and states are evaluated only when the
        note begins."""
        selector = note.selector
        names = {species: f"{key}.{species}.ids" for species in world.populations}
        if not needs_frame(selector):
            selected = select_ids(selector, frame)
        elif not names.values() & self.memory.keys():
            selected = select_ids(selector, frame)
            self.memory |= {name: selected.get(species, np.empty(0, np.int64)) for species, name in names.items()}
        else:
            selected = {species: self.memory[name] for species, name in names.items() if name in self.memory}
        rows = {species: world.populations[species].find_rows(ids) for species, ids in selected.items()}
        return {species: own[own >= 0] for species, own in rows.items() if (own >= 0).any()}

    def _iterate_agents(self, world: World) -> Iterator[tuple[VerbFunctions, NoteAgents]]:
        for active in self.active:
            for species in active.rows:
                yield VERBS[active.note.verb], NoteAgents(world, active, world.populations[species])

    def _begin_paces(self, world: World) -> None:
        """Compute for each agent the fraction of its speed at which it moves: the product of the fractions of active notes."""
        shares: dict[str, NDArray[np.float32]] = {}
        for functions, agents in self._iterate_agents(world):
            if functions.pace is not None:
                own = shares.setdefault(agents.population.name, np.ones(len(agents.population), np.float32))
                own[agents.rows] *= functions.pace(agents)
        self.paces.clear()
        for name, population in world.populations.items():
            previous = np.ones(len(population), np.float32)
            ids_name, shares_name = (f"{_PACE_KEY}.{name}.{part}" for part in ("ids", "shares"))
            if ids_name in self.memory:
                rows = population.find_rows(self.memory.pop(ids_name))
                previous[rows[rows >= 0]] = self.memory.pop(shares_name)[rows >= 0]
            own = shares.get(name, np.ones(len(population), np.float32))
            rows = np.flatnonzero((own != 1) | (previous != 1))
            if len(rows):
                self.paces[name] = paces = SpeedShares(rows, own[rows], previous[rows])
                paces.restore_full_velocities(population)
                slow = rows[own[rows] != 1]
                slow = slow[np.argsort(population.ids[slow])]
                self.memory[ids_name], self.memory[shares_name] = population.ids[slow], own[slow]
