"""Random differences between bodies, drawn from each agent's id: scales of parts and colours of materials, within the ranges of a
definition."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.affine import Floats
from antdsl.bodies.agents.definition import Rig, TransformGroup, Variation
from antdsl.bodies.agents.poses import ClipTable, WorldPoses
from antdsl.numerics.randomness import draw_uniform


@dataclass(frozen=True, slots=True, eq=False)
class VariationDraws:
    """The sources of random differences between the bodies of n agents: their ids int64[n], the scene's seed, and the species."""

    ids: NDArray[np.int64]
    seed: int = 0
    species: str = ""

    def draw(self, property_name: str) -> Floats:
        """Return a random number from 0 to 1 for each agent, float32[n], which never changes for an agent.

        `property_name`: the property that varies; each property has independent random numbers."""
        return draw_uniform(self.seed, 0, self.species, f"variation {property_name}", 0, self.ids)


def scale_groups(
    table: ClipTable, poses: WorldPoses, variation: Variation, groups: Mapping[str, TransformGroup], draws: VariationDraws | None
) -> WorldPoses:
    """Return the poses with each transform group scaled by the agent's random scale for this group.

    Each uppermost joint of a group is scaled about its own position, together with all joints below it. The weight of this joint
    in the group determines how much of the scale is applied."""
    if draws is None or not variation.scales or not len(draws.ids):
        return poses
    world = np.array(poses.world_transforms, np.float32)
    for name in variation.scales:
        size = draw_group_scale(variation, name, draws)
        for joint, weight in iterate_scale_pivots(table.rig, groups[name]):
            below = table.rig.find_descendants(joint)
            factor = (1 + np.float32(weight) * (size - 1))[:, None, None]
            pivot = world[:, joint, :, 3].copy()
            for each in below:
                world[:, each, :, :3] *= factor
                world[:, each, :, 3] = pivot + (world[:, each, :, 3] - pivot) * factor[:, 0]
    return WorldPoses(world, None, poses.channels)


def draw_group_scale(variation: Variation, group: str, draws: VariationDraws) -> Floats:
    """Return the random scale of a transform group for each agent, float32[n]."""
    low, high = variation.scales[group]
    return np.float32(low) + np.float32(high - low) * draws.draw(f"scale {group}")


def iterate_scale_pivots(rig: Rig, group: TransformGroup) -> Iterator[tuple[int, float]]:
    """Yield the index and the weight of each uppermost joint of a transform group. When the group is scaled, these joints stay
    in place."""
    members = {rig.find_joint(member): weight for member, weight in group.members}
    for joint, weight in members.items():
        if not any(
            joint in rig.find_descendants(other) for other in members if other != joint
        ):  # otherwise scaled with the ancestor
            yield joint, weight


def draw_colour_path_positions(variation: Variation, material: str, draws: VariationDraws) -> Floats:
    """Return the position of each agent's colour in a material's list of colours, float32[n]. 0 is the first colour, 1 the
    second, and 0.5 the mean of both."""
    return draws.draw(f"material {material}") * np.float32(len(variation.materials[material]) - 1)


def compute_vertex_colours(
    variation: Variation, draws: VariationDraws | None, material: NDArray[np.str_], base_colours: Floats
) -> Floats:
    """Return the linear colours of v vertices: float32[n, v, 3], or [1, v, 3] if they cannot differ between agents."""
    varied = [name for name in variation.materials if (material == name).any()]
    if draws is None or not varied:
        return base_colours[None]
    colours = np.repeat(base_colours[None], len(draws.ids), axis=0)
    for name in varied:
        key_colours = np.array(variation.materials[name], np.float32)
        at = draw_colour_path_positions(variation, name, draws)
        first = np.minimum(at.astype(np.intp), len(key_colours) - 2)
        share = (at - first.astype(np.float32))[:, None]
        colours[:, material == name] = (key_colours[first] + (key_colours[first + 1] - key_colours[first]) * share)[:, None]
    return colours
