"""The edit `offset`, which shifts and turns a joint of agents' bodies."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from pydantic import Field, model_validator

from antdsl.bodies.agents.transforms import angles_to_quaternion, multiply_quaternions, slerp_quaternions
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.outputs.cache.cache_reader import Arrays, Cache
from antdsl.outputs.cache.frame_agents import make_agent_keys
from antdsl.outputs.cache_bodies import CacheBodies
from antdsl.outputs.edits.edit_layer import EditLayer, NotEditable
from antdsl.outputs.edits.frame_rows import FrameRows
from antdsl.outputs.edits.verbs.agent_moves import IDENTITY
from antdsl.outputs.edits.verbs.placing import EasedLine, compute_line_ease, convert_displacement
from antdsl.scene.notes.selectors import Selector
from antdsl.scene.values import Angle, PointValue, SceneWord, make_value_error


class OffsetLine(EasedLine):
    """Adds a shift and a rotation to the pose of a joint.

    The shift `by` is ahead, up and right. The rotations `rotate` are about these axes, in this order."""

    verb = "offset"
    agents: Selector = Field(alias="offset")
    joint: SceneWord
    rotate: tuple[Angle, Angle, Angle] | None = None
    by: PointValue | None = None

    @model_validator(mode="after")
    def _check_one(self) -> OffsetLine:
        if self.rotate is None and self.by is None:
            raise make_value_error("`offset` needs `rotate` or `by`", "write `rotate: [0, 30 deg, 0]`")
        return self


@dataclass(frozen=True, eq=False)
class OffsetLayer(EditLayer):
    """A view of a cache in which a joint of some agents is shifted and rotated."""

    line: OffsetLine
    required_arrays = ("id", "pscale")

    @classmethod
    def of(cls, source: Cache, *values: Any) -> Self:
        """Return the view of a cache. `values`: the line of the edit, and its inputs."""
        view, joint = super().of(source, *values), values[0].joint
        bodies, entries = CacheBodies(source.manifest, source.read_static()), list(source.manifest.species)
        known: set[str] = set()
        for number, species in enumerate(entries):
            names = {name for which in range(len(bodies.keys(number))) for name in bodies.definition(number, which).rig.names}
            known |= names
            if joint in names and joint not in species.joints:
                entries[number] = species.model_copy(update={"joints": (*species.joints, joint)})
        if joint not in known:
            near = find_nearest_name(joint, known)
            raise NotEditable(f"no body has a joint `{joint}`" + (f": did you mean `{near}`?" if near else ""))
        return replace(view, manifest=source.manifest.model_copy(update={"species": tuple(entries)}))

    def is_active(self, number: int) -> bool:
        """Return whether the edit changes frame `number`."""
        return compute_line_ease(self.line, number) > 0

    def change_frame(self, number: int, arrays: Arrays) -> Arrays:
        """Return a frame in which the joint is shifted and rotated for the selected agents."""
        angles = np.array([each.number for each in self.line.rotate or ()] or [0.0, 0.0, 0.0])
        share = compute_line_ease(self.line, number)
        turn = slerp_quaternions(IDENTITY[None], angles_to_quaternion(angles[None], "xyz"), np.array([share]))
        by = np.zeros(3) if self.line.by is None else share * convert_displacement(self.line.by, self.manifest)
        selected = np.flatnonzero(self.selection.find(make_agent_keys(arrays)))
        changed, table = dict(arrays), FrameRows(arrays, self.manifest)
        for species in self.manifest.species:
            rows = table.find_body_rows(species.name)
            own = np.flatnonzero(np.isin(rows, selected))
            if self.line.joint not in species.joints or not len(own):
                continue
            name = f"joints.{species.name}.{self.line.joint}"
            neutral = np.concatenate([np.zeros(3), IDENTITY]).astype(np.float32)
            offsets = np.array(arrays[name] if name in arrays else np.tile(neutral, (len(rows), 1)))
            offsets[own, :3] += by / np.asarray(arrays["pscale"], np.float64)[rows[own], None]
            offsets[own, 3:] = multiply_quaternions(np.broadcast_to(turn, (len(own), 4)), offsets[own, 3:].astype(np.float64))
            changed[name] = offsets
        return changed
