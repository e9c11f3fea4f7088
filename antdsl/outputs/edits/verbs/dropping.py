"""The edit `drop`, which puts agents on other ground."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from pydantic import Field

from antdsl.outputs.cache.cache_reader import Arrays
from antdsl.outputs.cache.frame_agents import make_agent_keys
from antdsl.outputs.cache.manifest import Manifest, MeshEntry
from antdsl.outputs.edits.edit_layer import AgentsLine, EditFile, EditInputs, EditLayer
from antdsl.outputs.edits.grounding import Grounds, move_on_ground
from antdsl.outputs.edits.verbs.agent_moves import make_moves
from antdsl.outputs.edits.verbs.placing import REQUIRED_ARRAYS
from antdsl.outputs.edits.verbs.terrain import Ground
from antdsl.program.tables.things import MESH_GROUND_KIND
from antdsl.scene.notes.selectors import Selector
from antdsl.scene.thing_models import UP_VECTORS
from antdsl.scene.values import SceneWord


class DropLine(AgentsLine):
    """Puts agents onto a mesh of the cache or of a file: on the first ground below them, or above them if there is none."""

    verb = "drop"
    agents: Selector = Field(alias="drop")
    onto: SceneWord

    def list_files(self, manifest: Manifest) -> tuple[EditFile, ...]:
        """Return the file that the line names as mesh, unless the cache has a mesh of this name."""
        return () if _find_mesh(self, manifest) else (EditFile("onto", self.onto, "mesh"),)


def _find_mesh(line: DropLine, manifest: Manifest) -> MeshEntry | None:
    """Return the manifest's entry for the mesh that the line names. None if the line names a file."""
    return next((mesh for mesh in manifest.meshes if mesh.name == line.onto and not mesh.row.is_dug), None)


@dataclass(frozen=True, eq=False)
class DropLayer(EditLayer):
    """A view of a cache in which some agents are on other ground. A mesh from a file becomes a mesh of the cache."""

    line: DropLine
    required_arrays = REQUIRED_ARRAYS

    @classmethod
    def change_manifest(cls, manifest: Manifest, line: Any, inputs: EditInputs) -> Manifest:
        """Return the manifest with the mesh from the file, if the line names a file."""
        if _find_mesh(line, manifest):
            return manifest
        entry = MeshEntry(name=_make_name(line.onto, manifest), kind=MESH_GROUND_KIND)
        return manifest.model_copy(update={"meshes": (*manifest.meshes, entry)})

    @cached_property
    def _mesh_name(self) -> str:
        """Return the name of the mesh in the cache."""
        known = _find_mesh(self.line, self.source.manifest)
        return known.name if known else self.manifest.meshes[-1].name

    def read_static(self) -> Arrays:
        """Return the arrays that apply to all frames, including the mesh from the file."""
        arrays = self.source.read_static()
        if _find_mesh(self.line, self.source.manifest):
            return arrays
        parts = {part: self.inputs.arrays[f"{self.line.onto}.{part}"] for part in ("vertices", "faces")}
        vertices = np.asarray(parts["vertices"], np.float64) - self.manifest.origin
        return {
            **arrays,
            f"mesh.{self._mesh_name}.vertices": vertices,
            f"mesh.{self._mesh_name}.faces": parts["faces"].astype(np.int32),
        }

    def pass_inputs(self) -> EditInputs:
        """Return the inputs for the next edit. Their ground is the mesh."""
        return replace(self.inputs, ground=Ground(self))

    @cached_property
    def _target_ground(self) -> Ground:
        """Return the ground onto which the agents are dropped."""
        entry = next(mesh for mesh in self.manifest.meshes if mesh.name == self._mesh_name)
        return Ground(self, (entry,))

    def change_frame(self, number: int, arrays: Arrays) -> Arrays:
        """Return a frame in which the selected agents are on the other ground."""
        rows = np.flatnonzero(self.selection.find(make_agent_keys(arrays)))
        new = self._target_ground.at(number)
        old = (self.inputs.ground.at(number) if self.inputs.ground else None) or new
        if not len(rows) or new is None or old is None:
            return arrays
        moves = make_moves(rows, np.asarray(arrays["P"], np.float64)[rows])
        return move_on_ground(arrays, self.manifest, moves, Grounds(old, new, -np.array(UP_VECTORS[self.manifest.up])))


def _make_name(path: str, manifest: Manifest) -> str:
    """Return a name for the mesh from a file, which no mesh of the cache has."""
    stem = re.sub(r"[^A-Za-z0-9_]", "_", path.rpartition("/")[2].rpartition(".")[0]) or "mesh"
    names = {mesh.name for mesh in manifest.meshes}
    return next(name for k in range(len(names) + 1) if (name := f"{stem}_{k}" if k else stem) not in names)
