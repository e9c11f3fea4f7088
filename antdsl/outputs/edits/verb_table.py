"""The table of edits, with one row per verb."""

from __future__ import annotations

from typing import NamedTuple

from antdsl.outputs.edits.edit_layer import EditLayer, EditLine
from antdsl.outputs.edits.verbs.copies import DuplicateLayer, DuplicateLine
from antdsl.outputs.edits.verbs.curves import PinLayer, PinLine
from antdsl.outputs.edits.verbs.dropping import DropLayer, DropLine
from antdsl.outputs.edits.verbs.joints import OffsetLayer, OffsetLine
from antdsl.outputs.edits.verbs.looks import ReplaceLayer, ReplaceLine
from antdsl.outputs.edits.verbs.merging import MergeLayer, MergeLine
from antdsl.outputs.edits.verbs.mirroring import MirrorLayer, MirrorLine
from antdsl.outputs.edits.verbs.placing import (
    ExpandLayer,
    ExpandLine,
    FaceLayer,
    FaceLine,
    MoveLayer,
    MoveLine,
    RotateLayer,
    RotateLine,
    ScaleLayer,
    ScaleLine,
)
from antdsl.outputs.edits.verbs.removal import ClipLayer, ClipLine, KillLayer, KillLine
from antdsl.outputs.edits.verbs.smoothing import SmoothLayer, SmoothLine
from antdsl.outputs.edits.verbs.timing import HoldLine, RetimeLine, TimeLayer
from antdsl.scene.notes.selectors import AgentConditions


class EditVerb(NamedTuple):
    """A verb of edits: the model of its lines, and the class of the view that applies a line.

    `is_last`: whether the view reads the result of all other edits."""

    line: type[EditLine]
    layer: type[EditLayer]
    is_last: bool = False


_ROWS = (
    EditVerb(KillLine, KillLayer),
    EditVerb(ClipLine, ClipLayer),
    EditVerb(DuplicateLine, DuplicateLayer),
    EditVerb(MergeLine, MergeLayer),
    EditVerb(HoldLine, TimeLayer),
    EditVerb(RetimeLine, TimeLayer),
    EditVerb(MoveLine, MoveLayer),
    EditVerb(RotateLine, RotateLayer),
    EditVerb(ScaleLine, ScaleLayer),
    EditVerb(ExpandLine, ExpandLayer),
    EditVerb(FaceLine, FaceLayer),
    EditVerb(PinLine, PinLayer),
    EditVerb(DropLine, DropLayer),
    EditVerb(OffsetLine, OffsetLayer),
    EditVerb(ReplaceLine, ReplaceLayer),
    EditVerb(SmoothLine, SmoothLayer, is_last=True),
    EditVerb(MirrorLine, MirrorLayer, is_last=True),
)
for _row in _ROWS:  # selectors name the conditions before these are defined
    _row.line.model_rebuild(_types_namespace={"AgentConditions": AgentConditions})
VERB_BY_WORD = {row.line.verb: row for row in _ROWS}
