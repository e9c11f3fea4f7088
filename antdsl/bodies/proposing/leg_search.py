"""Finds legs: chains of joints that begin at the trunk and end where the body touches the ground."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.definition import Rig
from antdsl.bodies.proposing.joint_motion import BodyPoints

Floats = NDArray[np.float64]
_CONTACT_HEIGHT = 0.05  # share of the body's height; points up to this height touch the ground
_MIN_CONTACT_POINTS = 3  # minimum number of points of a joint that touches the ground
# share of the body's height; a higher joint with points on the ground is a knee, and a joint below it the foot
_ANKLE_HEIGHT = 0.2
_MIN_BONE_SHARE = 0.15  # share of the leg length; a shorter first bone belongs to the trunk, such as a collar bone or a coxa
_MIN_LEG_HEIGHT = 0.15  # share of the body's height; a lower chain lies on the ground and is not a leg
_MIN_SOLE_SHARE = 0.1  # share of the leg's height; a foot that touches the ground over a shorter distance has a point, not a sole
_MAX_SOLE_LEGS = 4  # animals with more legs stand on claws, which hold at any angle


@dataclass(frozen=True, slots=True, eq=False)
class LegCandidate:
    """A possible leg: its joints, given by their indices, and the points of its sole.

    `chain`: all joints from the trunk to the foot.
    `ankle`: the joint about which the sole turns, or -1 if the foot has no sole.
    `ball`: the joint of the toes if the toes touch the ground separately from the foot, else `foot`.
    `soles`: for each part of the sole, the joint that it follows and its position in the space of that joint, float64[3]."""

    upper: int
    lower: int
    foot: int
    chain: tuple[int, ...]
    soles: tuple[tuple[int, Floats], ...]
    ankle: int = -1
    ball: int = -1


@dataclass(frozen=True, slots=True, eq=False)
class LegSearchResult:
    """The legs of a body, and the reasons why other parts that touch the ground are not legs.

    `feet`: all chains that touch the ground, including those that are not legs; the motion of their soles shows gaits.
    `ground_height`: the position of the ground along the body's up axis.
    `body_height`: the height of the body along this axis."""

    legs: tuple[LegCandidate, ...]
    feet: tuple[LegCandidate, ...]
    reasons: tuple[str, ...]
    ground_height: float
    body_height: float


def find_legs(rig: Rig, points: BodyPoints, worlds: NDArray[np.float32], up: Floats) -> LegSearchResult:
    """Return the legs of a body in its standing pose. `worlds`: the world matrices of its joints in this pose, [J, 3, 4]. `up`:
    a unit vector."""
    heights = points.positions @ up
    if not len(heights):
        return LegSearchResult((), (), ("the file has no points",), 0.0, 0.0)
    ground, height = float(heights.min()), max(float(np.ptp(heights)), 1e-9)
    low = heights < ground + _CONTACT_HEIGHT * height
    counts = np.bincount(points.joint_indices[low & (points.joint_indices >= 0)], minlength=len(rig.names))
    touching = [joint for joint in range(len(rig.names)) if counts[joint] >= _MIN_CONTACT_POINTS]
    groups = _group_by_branch(rig, touching)
    positions = worlds[:, :, 3].astype(np.float64)
    legs: list[LegCandidate] = []
    feet: list[LegCandidate] = []
    reasons: list[str] = []
    for chain_start, every in groups.items():
        contacts = [each for each in every if positions[each] @ up < ground + _ANKLE_HEIGHT * height] or every[-1:]
        soles = tuple(_find_sole(joint, points, low, worlds) for joint in contacts)
        path = _find_joint_path(rig, chain_start, contacts[0])
        name = rig.names[contacts[0]]
        feet.append(LegCandidate(path[0], path[0], contacts[0], tuple(path), soles))
        rise = float((positions[chain_start] - positions[contacts[0]]) @ up)
        if len(path) < 3:
            reasons.append(f"`{name}` touches the ground, but has no hip and knee above it, so it is not a leg")
            continue
        if rise < _MIN_LEG_HEIGHT * height:
            reasons.append(f"`{name}` touches the ground, but its chain of joints lies on the ground, so it is not a leg")
            continue
        upper, lower = _find_hip_and_knee(path, positions)
        below = path[path.index(lower) + 1 :]
        has_sole = len(groups) <= _MAX_SOLE_LEGS and _measure_sole(rig, contacts[0], points, low, up) >= _MIN_SOLE_SHARE * rise
        ankle = next(joint for joint in below if positions[joint] @ up < ground + _ANKLE_HEIGHT * height or joint == below[-1])
        ball = next((joint for joint in contacts[1:] if is_below(rig, joint, contacts[0])), contacts[0])
        legs.append(LegCandidate(upper, lower, contacts[0], tuple(path), soles, ankle if has_sole else -1, ball))
        feet[-1] = legs[-1]
    if not groups:
        reasons.append("no joint moves the points that touch the ground")
    return LegSearchResult(tuple(legs), tuple(feet), tuple(reasons), ground, height)


def _group_by_branch(rig: Rig, contact_joints: list[int]) -> dict[int, list[int]]:
    """Group the joints that touch the ground by chain. The key of a group is the first joint of its chain. Each group is sorted
    from the trunk outward.

    A chain begins just below the nearest ancestor from which several branches reach the ground."""
    below = {joint: {each for each in contact_joints if joint in _list_ancestors(rig, each)} for joint in range(len(rig.names))}
    groups: dict[int, list[int]] = {}
    for contact in contact_joints:
        path = _list_ancestors(rig, contact)  # from the contact to the root
        start = path[0]
        for inner, outer in pairwise(path):
            own = below[inner]
            others = [each for each in below[outer] - own if each != outer]
            if others and not _is_one_chain(rig, own | set(others)):
                break
            start = outer
        groups.setdefault(start, []).append(contact)
    for contacts in groups.values():
        contacts.sort(key=lambda joint: len(_list_ancestors(rig, joint)))
    return groups


def _is_one_chain(rig: Rig, joints: set[int]) -> bool:
    """Return whether one of the joints is an ancestor of all others, as an ankle is of its toes."""
    top = min(joints, key=lambda joint: len(_list_ancestors(rig, joint)))
    return all(top in _list_ancestors(rig, joint) for joint in joints)


def _list_ancestors(rig: Rig, joint: int) -> list[int]:
    """Return a joint and all its ancestors, up to the root."""
    path = [joint]
    while rig.parents[path[-1]] >= 0:
        path.append(int(rig.parents[path[-1]]))
    return path


def is_below(rig: Rig, joint: int, top: int) -> bool:
    """Return whether a joint is `top` or a descendant of it."""
    return top in _list_ancestors(rig, joint)


def _find_joint_path(rig: Rig, start: int, end: int) -> list[int]:
    """Return the joints from `start` down to `end`."""
    path = _list_ancestors(rig, end)
    return path[: path.index(start) + 1][::-1]


def _find_hip_and_knee(path: list[int], positions: Floats) -> tuple[int, int]:
    """Return the hip joint and the knee joint of a chain of at least three joints.

    The knee is the joint for which the sum of two lengths is greatest: its distance from the line between hip and foot, and the
    length of the shorter bone. So both bones have a useful length."""
    bones = [float(np.linalg.norm(positions[b] - positions[a])) for a, b in pairwise(path)]
    first, total = 0, max(sum(bones), 1e-12)
    while len(path) - first > 3 and bones[first] < _MIN_BONE_SHARE * total:
        first += 1
    hip, foot = positions[path[first]], positions[path[-1]]
    line = foot - hip
    line /= max(float(np.linalg.norm(line)), 1e-12)

    def rate_joint(joint: int) -> float:
        away = positions[joint] - hip
        off = float(np.linalg.norm(away - line * (away @ line)))
        shorter = min(float(np.linalg.norm(away)), float(np.linalg.norm(foot - positions[joint])))
        return shorter + off

    return path[first], max(path[first + 1 : -1], key=rate_joint)


def _measure_sole(rig: Rig, foot: int, points: BodyPoints, low: NDArray[np.bool_], up: Floats) -> float:
    """Return the largest horizontal extent of those points of a foot that are on the ground. `low`: which points are on the
    ground.

    The extent is measured along the coordinate axes of the definition's space."""
    below = [joint for joint in range(len(rig.names)) if is_below(rig, joint, foot)]
    place = points.positions[low & np.isin(points.joint_indices, below)]
    return float(np.ptp(place - np.outer(place @ up, up), axis=0).max(initial=0.0)) if len(place) else 0.0


def _find_sole(joint: int, points: BodyPoints, low: NDArray[np.bool_], worlds: NDArray[np.float32]) -> tuple[int, Floats]:
    """Return `joint`, and the mean position of its points on the ground, in the space of this joint."""
    middle = points.positions[low & (points.joint_indices == joint)].mean(axis=0)
    matrix = worlds[joint].astype(np.float64)
    return joint, np.linalg.lstsq(matrix[:, :3], middle - matrix[:, 3], rcond=None)[0]
