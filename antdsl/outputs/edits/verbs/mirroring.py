"""The edit `mirror`. It reads the result of all other edits."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from antdsl.bodies.agents.transforms import Floats
from antdsl.bodies.body import build_orientations
from antdsl.outputs.cache.cache_reader import Arrays
from antdsl.outputs.cache.frame_agents import make_agent_keys
from antdsl.outputs.cache_bodies import CacheBodies
from antdsl.outputs.edits.edit_layer import AgentsLine, EditLayer
from antdsl.outputs.edits.frame_rows import FrameRows
from antdsl.outputs.edits.grounding import Grounds, move_on_ground
from antdsl.outputs.edits.verbs.agent_moves import find_axes, make_moves
from antdsl.outputs.edits.verbs.terrain import MirroredTerrain
from antdsl.scene.crowds.body_choice import find_number_of_key, find_species_of_key
from antdsl.scene.notes.selectors import Selector
from antdsl.scene.thing_models import UNIT_MM
from antdsl.scene.values import Length, parse_one_of


class MirrorLine(AgentsLine):
    """Mirrors agents across a plane perpendicular to `axis`, at the coordinate `at`."""

    verb = "mirror"
    agents: Selector = Field(alias="mirror")
    axis: Annotated[str, BeforeValidator(parse_one_of("x", "y", "z"))]
    at: Length | None = None


_LOCAL_SIGN = np.array([1.0, 1.0, -1.0])  # of vectors in the space of agents: their left becomes their right
_ROTATION_SIGN = np.array([-1.0, -1.0, 1.0, 1.0])  # of rotations there, x y z w


@dataclass(frozen=True, eq=False)
class MirrorLayer(EditLayer):
    """A view of a cache in which some agents are mirrored, with left and right exchanged.

    The ground is not mirrored: agents retain their height above it."""

    line: MirrorLine
    required_arrays = ("id", "P", "orient", "pscale")

    def change_frame(self, number: int, arrays: Arrays) -> Arrays:
        """Return a frame with the selected agents mirrored."""
        rows = np.flatnonzero(self.selection.find(make_agent_keys(arrays)))
        if not len(rows):
            return arrays
        axis, unit_mm = "xyz".index(self.line.axis), UNIT_MM[self.manifest.units]
        at = (self.line.at.to_millimetres(unit_mm) / unit_mm if self.line.at else 0.0) - self.manifest.origin[axis]
        sign, shift = np.where(np.arange(3) == axis, -1.0, 1.0), np.where(np.arange(3) == axis, 2 * at, 0.0)
        mirrored = self._mirror_arrays(arrays, rows, sign, shift)
        ground = self.inputs.ground.at(number) if self.inputs.ground else None
        if ground is None:
            return mirrored
        moves = make_moves(rows, np.asarray(mirrored["P"], np.float64)[rows])
        return move_on_ground(mirrored, self.manifest, moves, Grounds(MirroredTerrain(ground, sign, shift), ground))

    def _mirror_arrays(self, arrays: Arrays, rows: NDArray[np.intp], sign: Floats, shift: Floats) -> dict[str, NDArray[Any]]:
        """Return a frame in which the agents in `rows` are mirrored, regardless of the ground.

        `sign`, `shift` [3]: the mirrored position is position · `sign` + `shift`."""
        mirrored, table = dict(arrays), FrameRows(arrays, self.manifest)
        heading, up = find_axes(np.asarray(arrays["orient"], np.float64)[rows])
        for name, keys in table.iterate_agent_arrays():
            own = np.flatnonzero(np.isin(keys, table.keys[rows]))
            values = arrays[name][own]
            first, field = name.partition(".")[0], name.rpartition(".")[2]
            if name == "orient":
                values = build_orientations(heading * sign, up * sign).astype(np.float32)
            elif name == "P" or (first in ("feet", "events") and field == "P"):
                values = values * sign + shift
                values = values[:, self._pair_legs(name.split(".")[1])] if first == "feet" else values
            elif name in ("v", "v_ground") or (first == "events" and field == "N"):
                values = values * sign
            elif first == "feet" and field in ("down", "normal"):
                values = values[:, self._pair_legs(name.split(".")[1])]
                values = values * _LOCAL_SIGN if field == "normal" else values
            elif first == "feet" and field == "tilt":
                values = values * _ROTATION_SIGN
            elif first in ("looks", "leans"):
                values = values * (_LOCAL_SIGN if first == "looks" else np.array([-1.0, 1.0]))
            else:
                continue
            mirrored[name] = arrays[name].copy()
            mirrored[name][own] = values
        return mirrored

    @cached_property
    def _bodies(self) -> CacheBodies:
        return CacheBodies(self.manifest, self.read_static())

    def _pair_legs(self, key: str) -> NDArray[np.intp]:
        """Return, for each leg of a body, the number of the opposite leg. `key`: the key of the body."""
        number = next(k for k, entry in enumerate(self.manifest.species) if entry.name == find_species_of_key(key))
        body = self._bodies.body(number, body_index=find_number_of_key(key))
        feet = [body.definition.rig.find_joint(leg.foot) for leg in body.definition.legs]
        poses = body.compute_poses((), 1)
        feet_rest = (
            np.asarray(poses.world_transforms[0, feet, :, 3], np.float64) @ body.definition.compute_base_matrix()[:3, :3].T
        )
        square = ((feet_rest[:, None] - feet_rest[None] * _LOCAL_SIGN) ** 2).sum(axis=2)
        pairs: NDArray[np.intp] = square.argmin(axis=1)
        return pairs
