"""Bodies that differ by each agent's id: their parts as large, and their materials of the colours, that a definition allows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.affine import Floats
from antdsl.bodies.agents.clip_table import ClipTable
from antdsl.bodies.agents.layer import TransformGroup
from antdsl.bodies.agents.poses import Poses
from antdsl.bodies.agents.variation import Variation
from antdsl.numerics.randomness import uniform


@dataclass(frozen=True, slots=True, eq=False)
class Draws:
    """By what the bodies of n agents differ: their ids int64[n], the scene's seed and the species."""

    ids: NDArray[np.int64]
    seed: int = 0
    species: str = ""

    def rows(self, chosen: NDArray[np.intp] | NDArray[np.bool_]) -> Draws:
        """The same of some agents."""
        return Draws(self.ids[chosen], self.seed, self.species)

    def of(self, what: str) -> Floats:
        """A number from 0 to 1 for each, the same for its whole life: float32[n]."""
        return uniform(self.seed, 0, self.species, f"variation {what}", 0, self.ids)


def with_scales(
    table: ClipTable, poses: Poses, variation: Variation, groups: Mapping[str, TransformGroup], draws: Draws | None
) -> Poses:
    """Poses in which each transform group is as large as its agent has it: its uppermost joints, with all that hangs on them, are
    scaled about their own places, by their weights' shares."""
    if draws is None or not variation.scales or not len(draws.ids):
        return poses
    world = np.array(poses.world, np.float32)
    for name, (low, high) in variation.scales.items():
        size = np.float32(low) + np.float32(high - low) * draws.of(f"scale {name}")
        members = {table.rig.joint(member): weight for member, weight in groups[name].members}
        for joint, weight in members.items():
            below = table.rig.below(joint)
            if any(joint in table.rig.below(other) for other in members if other != joint):
                continue  # it is scaled with the one that it hangs on
            factor = (1 + np.float32(weight) * (size - 1))[:, None, None]
            pivot = world[:, joint, :, 3].copy()
            for each in below:
                world[:, each, :, :3] *= factor
                world[:, each, :, 3] = pivot + (world[:, each, :, 3] - pivot) * factor[:, 0]
    return Poses(world, None, poses.channels)


def colours_of(variation: Variation, draws: Draws | None, material: NDArray[np.str_], own: Floats) -> Floats:
    """Linear colours float32[n, v, 3] of vertices whose `material` [v] may be another for each agent, or [1, v, 3] where none is.
    `own` [v, 3]: as the definition has them."""
    varied = [name for name in variation.materials if (material == name).any()]
    if draws is None or not varied:
        return own[None]
    found = np.repeat(own[None], len(draws.ids), axis=0)
    for name in varied:
        given = np.array(variation.materials[name], np.float32)
        at = draws.of(f"material {name}") * np.float32(len(given) - 1)
        first = np.minimum(at.astype(np.intp), len(given) - 2)
        share = (at - first.astype(np.float32))[:, None]
        found[:, material == name] = (given[first] + (given[first + 1] - given[first]) * share)[:, None]
    return found
