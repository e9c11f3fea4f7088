"""The edits that users added on pages, and the simulated frames with these edits applied. The run itself does not change."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from antdsl.bodies.agents.definition import BodyError
from antdsl.diagnostics import Report
from antdsl.outputs.cache.cache_reader import Arrays, Cache, CacheError
from antdsl.outputs.cache.frame_agents import make_agent_keys
from antdsl.outputs.cache.manifest import Manifest
from antdsl.outputs.cache_bodies import CacheBodies
from antdsl.outputs.edits.cache_selection import Selection
from antdsl.outputs.edits.edit_files import read_edit_files
from antdsl.outputs.edits.edit_layer import EditInputs, NotEditable
from antdsl.outputs.edits.edit_lines import EDITS_KEY, EditList, PlacedEdit, read_edits
from antdsl.outputs.edits.edited_cache import EditedCache, apply_edits
from antdsl.outputs.edits.frame_rows import SPECIES_PER_KEY
from antdsl.outputs.edits.settled_layer import SettledFrames
from antdsl.outputs.edits.verbs.joints import OffsetLine
from antdsl.outputs.edits.verbs.terrain import Ground
from antdsl.pipeline import Shot
from antdsl.preview.directing.line_drafts import EDIT_SOURCE, LineDraft, write_draft
from antdsl.preview.directing.recorded_frames import RecordedFrames, list_attributes
from antdsl.preview.directing.verb_forms import VerbForm
from antdsl.preview.session import PreviewSession
from antdsl.preview.timeline import Timeline
from antdsl.scene.document import MappingNode, SequenceNode

EDITS_FILE = "edits.yaml"  # where users write edits
_EDITS_TEXT_PREFIX = f"{EDITS_KEY}:\n  - "


@dataclass(frozen=True, slots=True, eq=False)
class HandEdit:
    """An edit that a user added on a page.

    `key`: identifies the edit for pages. `text`: its line. `is_on`: whether it is applied to displayed frames. `problem`: why it
    was switched off automatically."""

    key: int
    text: str
    is_on: bool = True
    problem: str = ""


HandEdits = tuple[HandEdit, ...]


class _ViewKey(NamedTuple):
    """The inputs of a view of the frames. If one of them changes, the view must be made again.

    `history`: the timeline and its version. `next_ids`: by species, the first id that no agent has."""

    shot: Shot
    history: tuple[Timeline, int]
    edits: HandEdits
    next_ids: Mapping[str, int]
    settled: SettledFrames | None


class EditedRunView:
    """A view of a session's simulated frames to which edits are applied. `version` increases whenever the displayed frames may
    have changed.

    `problem`: why the edits could not be applied to the last requested frame."""

    def __init__(self, session: PreviewSession) -> None:
        self.session = session
        self.edits: HandEdits = ()
        self.version = 0
        self.problem = ""
        self._recorded: RecordedFrames | None = None
        self._view: EditedCache | None = None
        self._view_key: _ViewKey | None = None
        self._settled: tuple[object, SettledFrames] | None = None  # with the inputs of the frames, of `describe_inputs`

    def check_line(self, form: VerbForm, agents: str, values: Mapping[str, str]) -> tuple[LineDraft, bool]:
        """Return the draft of an edit, checked against the simulated frames, and whether it has no errors. `agents`: the value
        of the verb, which selects agents. `values`: texts of the other keys."""
        draft = write_draft(form, agents, values)
        manifest = self._read_frames().manifest
        edits, report = _read_line(draft.text, manifest)
        for each in report.diagnostics:
            if not (draft.missing and each.code == "missing-key"):
                draft.report.add(each)
        draft.report_unknown_keys(form, values)
        if edits is not None:
            nodes = edits.document.entries[EDITS_KEY]
            if isinstance(nodes, SequenceNode) and isinstance(nodes.items[0], MappingNode):
                draft.report_nested_keys(nodes.items[0])
        if draft.report.ok and edits is not None:
            draft.report.extend(self._read_files(edits)[-1])
        return draft, draft.report.ok and not draft.missing

    def list_joints(self, agents: str) -> list[str]:
        """Return the names of the joints in the bodies of the selected agents at the session's frame, as choices for the key
        `offset`. `agents`: a selector as in a scene. The list is empty if no agents are selected, or if the selector or the
        frame has an error."""
        view = self.find_view()
        frames: Cache = self._read_frames() if view is None else view
        edits, _ = _read_line(f"{{{OffsetLine.verb}: {agents}, joint: head, by: [0, 0, 0]}}", frames.manifest)
        if edits is None or not isinstance(line := edits.edits[0].line, OffsetLine):
            return []
        number = self.session.frame
        try:
            keys = make_agent_keys(frames.frame(number))
            keys = keys[Selection(line.selector, frames, number).find(keys)]
        except CacheError:
            return []
        bodies, names = CacheBodies(frames.manifest, frames.read_static()), dict[str, None]()
        for species in np.unique(keys % SPECIES_PER_KEY).tolist():
            ids = keys[keys % SPECIES_PER_KEY == species] // SPECIES_PER_KEY
            for body in np.unique(bodies.numbers(species, ids)).tolist():
                names |= dict.fromkeys(bodies.definition(species, body).rig.names)
        return list(names)

    def replace_edits(self, edits: HandEdits, frame: int) -> str:
        """Replace all edits. Return "" on success. If they cannot be applied to `frame`, return the reason and change nothing."""
        if any(each.is_on for each in edits):
            try:
                self._apply_edits(edits).frame(frame)
            except (NotEditable, BodyError, CacheError) as why:
                return str(why)
        self.edits = edits
        self.version += 1
        return ""

    def describe_inputs(self) -> object:
        """Return a value that identifies the inputs of the edited frames. Settled agents remain valid as long as this value does
        not change."""
        timeline = self.session.timeline
        return timeline, timeline.version, tuple(each.text for each in self.edits if each.is_on)

    def open_frames_to_settle(self) -> tuple[EditedCache, Mapping[str, int], tuple[str, ...]]:
        """Return the three inputs of settling: the edited frames, the next free ids, and the names of the agent arrays in frames.

        The frames reach to the last simulated frame and do not contain settled agents. The next free ids are the first id of each
        species that no agent has. Raises NotEditable, BodyError or CacheError with the reason if the frames cannot be edited."""
        recorded = self._read_frames()
        frames = replace(recorded, last=self.session.last_frame)
        return self._apply_edits(self.edits, frames), self._find_next_ids(), list_attributes(recorded.shot)

    def store_settled_frames(self, inputs: object, settled: SettledFrames | None) -> None:
        """Display the agents `settled`, which were simulated again, as long as `describe_inputs` still returns `inputs`. If
        `settled` is None, display no such agents."""
        self._settled = None if settled is None else (inputs, settled)

    @property
    def settled(self) -> SettledFrames | None:
        """Return the agents that were simulated again; None if there are none, or if the frames have changed since then."""
        fits = self._settled is not None and self._settled[0] == self.describe_inputs()
        return self._settled[1] if fits and self._settled is not None else None

    def read_frame(self, number: int) -> tuple[EditedCache, Arrays] | None:
        """Return the view of the edited frames, and the arrays of frame `number`. Return None if no edits are active.

        Also return None if the edits cannot be applied to the frame; `problem` is then the reason."""
        self.problem = ""
        view = self.find_view()
        try:
            return None if view is None else (view, view.frame(number))
        except CacheError as why:
            self.problem = str(why)
            return None

    def find_view(self) -> EditedCache | None:
        """Return a view of the simulated frames with the active edits applied, or None if no edits are active.

        Edits that no longer match the frames are switched off; the `problem` of each says why."""
        if not any(each.is_on for each in self.edits):
            return None
        timeline = self.session.timeline
        key = _ViewKey(self.session.shot, (timeline, timeline.version), self.edits, self._find_next_ids(), self.settled)
        if self._view is None or key != self._view_key:
            self._switch_off_failed()
            is_edited = any(each.is_on for each in self.edits)
            self._view = self._apply_edits(self.edits, settled=self.settled) if is_edited else None
            self._view_key = key._replace(edits=self.edits)
            self.version += 1
        return self._view

    def _switch_off_failed(self) -> None:
        """Switch off each edit that the current programs, or the edits before it, do not allow."""
        passed: list[HandEdit] = []
        for edit in self.edits:
            problem = ""
            if edit.is_on:
                try:
                    self._apply_edits((*passed, edit))
                except (NotEditable, BodyError, CacheError) as why:
                    problem = str(why)
            passed.append(replace(edit, is_on=False, problem=problem) if problem else edit)
        self.edits = tuple(passed)

    def _read_frames(self) -> RecordedFrames:
        if self._recorded is None or self._recorded.shot is not self.session.shot:
            self._recorded = RecordedFrames.of(self.session)
        return self._recorded

    def _apply_edits(
        self, edits: Iterable[HandEdit], frames: RecordedFrames | None = None, settled: SettledFrames | None = None
    ) -> EditedCache:
        """Return the frames with edits applied, and with `settled` agents in place of the simulated ones. `frames`: by default
        all. Raises NotEditable, BodyError or CacheError with the reason if the edits cannot be applied."""
        frames = frames or self._read_frames()
        placed: list[PlacedEdit] = []
        document: EditList | None = None
        for each in edits:
            if each.is_on:
                document, report = _read_line(each.text, frames.manifest)
                if document is None:
                    raise NotEditable(report.errors[0].message)
                placed += document.edits
        assert document is not None
        listed = replace(document, edits=tuple(placed))
        arrays, caches, report = self._read_files(listed)
        if not report.ok:
            raise NotEditable(report.errors[0].message)
        ground = Ground(frames, [mesh for mesh in frames.manifest.meshes if mesh.row.is_ground and not mesh.row.is_dug])
        packed = {} if settled is None else settled.pack()
        return apply_edits(frames, listed, EditInputs(ground, {**arrays, **packed}, caches, self._find_next_ids()))

    def _read_files(self, edits: EditList) -> tuple[Arrays, Mapping[str, Cache], Report]:
        """Return the arrays of meshes and bodies that edits name, the caches that they name, and a report. These files must be in
        the folder of the scene or below it."""
        frames = self._read_frames()
        return read_edit_files(edits, frames.manifest, frames.folder)

    def _find_next_ids(self) -> dict[str, int]:
        """Return, for each species, the lowest id that no simulated agent has."""
        known = self._view_key.next_ids if self._view_key is not None else {}
        lights = self.session.timeline.reduced_frames.values()
        counts = {}
        for name, population in self.session.world.populations.items():
            ids = (int(light[name]["id"].max()) + 1 for light in lights if name in light and len(light[name]["id"]))
            own = max(ids, default=0) if name not in known else 0
            counts[name] = max(own, population.next_id, known.get(name, 0))
        return counts


def _read_line(text: str, manifest: Manifest) -> tuple[EditList | None, Report]:
    return read_edits(f"{_EDITS_TEXT_PREFIX}{text}".encode("utf-8", "replace"), EDIT_SOURCE, manifest)
