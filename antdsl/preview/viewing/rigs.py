"""The bodies of species: skinned meshes with the samples of the clips that are played, for the page to pose."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.clip_table import ClipTable, clip_table
from antdsl.bodies.agents.definition import Definition
from antdsl.bodies.agents.leg_ik import BENDING, Legs
from antdsl.bodies.posed_body import PosedBody
from antdsl.outputs.cache.clip_arrays import playing
from antdsl.preview.binary_packets import pack
from antdsl.preview.viewing.bodies import body_of_species
from antdsl.preview.viewing.seen import Packets, Seen

Arrays = dict[str, NDArray[Any]]
Plays = tuple[tuple[str, str], ...]  # names of clips and of transform groups


class Rigs:
    """The slots `rig:SPECIES`: again where the body of a species, or what it plays, has become another one."""

    def __init__(self) -> None:
        self._given: dict[str, tuple[Definition, Plays, tuple[str, ...]]] = {}

    def packets(self, seen: Seen) -> Packets:
        for name, population in seen.world.populations.items():
            plays = tuple((clip.name, clip.on) for clip in population.plan.clips)
            made = body_of_species(seen.shot, name), plays, tuple(playing(population))
            known = self._given.get(name)
            if known is None or known[0] is not made[0] or known[1:] != made[1:]:
                self._given[name] = made
                yield f"rig:{name}", rig_packet(name, *made)


def rig_packet(species: str, definition: Definition, plays: Plays, machines: tuple[str, ...]) -> bytes:
    """The packet of a species: its clips, and its mesh as crowds and as those who are near have it. `idle`: the number of the
    clip that lies below all others and the seconds that it takes; none where there is no such clip."""
    arrays, header = _rig(definition, plays)
    return pack(f"rig:{species}", arrays, machines=list(machines), **header)


@lru_cache(maxsize=8)
def posed_body(definition: Definition, plays: Plays) -> PosedBody:
    """A body that plays some clips, made once."""
    return PosedBody(definition, plays)


@lru_cache(maxsize=8)
def _rig(definition: Definition, plays: Plays) -> tuple[Arrays, dict[str, Any]]:
    body, table = posed_body(definition, plays), clip_table(definition)
    idle = definition.clips.get(definition.idle)
    arrays = _clips(table, definition, plays if idle is None else (*plays, (definition.idle, "")))
    arrays |= _legs(body.legs, table)
    for level, each in (("low", body.coarse), ("fine", body.fine)):
        arrays |= {f"{level}/{name}": array for name, array in _mesh(each, table).items()}
    return arrays, {
        "joints": len(table.order), "texels": _texels(table), "length": float(definition.length),
        "base": [round(float(x), 9) for x in definition.base()[:3].reshape(-1)], "bending": BENDING,
        "idle": [] if idle is None or idle.duration <= 0 else [len(plays), idle.duration],
    }  # fmt: skip


def _texels(table: ClipTable) -> int:
    """Of four numbers each, that a joint has in a sample: translation, rotation, and scale and shear where there are any."""
    return 2 + table.scaled + table.sheared


def _clips(table: ClipTable, definition: Definition, plays: Plays) -> Arrays:
    """`sample` float32[R, J, texels, 4], the rest pose first; `parent` int32[J], joints by their depth; `clip` int32[P, 4]: the
    first sample, how many, whether it loops, its transform group; first -1 for a clip that the body does not have. `group`
    float32[G, J]: weights of joints, first those of the whole rig."""
    joints, kept, clips = len(table.order), [np.array([0])], []
    groups = ["", *sorted({on for _, on in plays} - {""})]
    count = 1
    for name, on in plays:
        if name not in table.names:
            clips.append((-1, 1, 0, 0))
            continue
        number = table.number(name) + 1
        first, length = int(table.first[number]), int(table.counts[number])
        kept.append(np.arange(first, first + length))
        clips.append((count, length, int(table.loops[number]), groups.index(on)))
        count += length
    rows = table.samples[np.concatenate(kept)]
    sample = np.zeros((len(rows), joints, _texels(table), 4), np.float32)
    at = 0
    for texel, width in enumerate((3, 4, *([3] if table.scaled else []), *([3] if table.sheared else []))):
        part = rows[:, at : at + width * joints].reshape(len(rows), width, joints)
        sample[:, :, texel, :width] = part.transpose(0, 2, 1)
        at += width * joints
    place = _depths(table)
    parents = np.asarray(table.rig.parents)[table.order]
    ones = np.ones(joints, np.float32)
    weights = [ones if not name else table.weights(definition.groups[name])[0] for name in groups]
    return {
        "sample": sample,
        "parent": np.where(parents >= 0, place[parents], -1).astype(np.int32),
        "clip": np.array(clips, np.int32).reshape(-1, 4),
        "group": np.stack(weights).astype(np.float32),
    }


def _depths(table: ClipTable) -> NDArray[np.int32]:
    """The place of each joint of the rig among joints by their depth."""
    place = np.empty(len(table.order), np.int32)
    place[table.order] = np.arange(len(table.order))
    return place


def _legs(legs: Legs | None, table: ClipTable) -> Arrays:
    """`leg` float32[L, 2, 4]: hip, knee and foot, joints by depth, and the axis about which a straight knee bends."""
    if legs is None:
        return {}
    found, place = np.zeros((legs.count, 2, 4), np.float32), _depths(table)
    found[:, 0, :3] = [place[[each.upper, each.lower, each.foot]] for each in legs.chains]
    found[:, 1, :3] = legs.straight_axes()
    return {"leg": found}


def _parts(legs: Legs | None, joints: int) -> NDArray[np.int32]:
    """Of each joint of the rig the part of a leg that it is: three times the leg and 1 thigh, 2 shank, 3 foot; 0 of none."""
    found = np.zeros(joints, np.int32)
    for number, each in enumerate(legs.chains if legs is not None else ()):
        for piece, those in enumerate((each.thigh, each.shank, each.sole), 1):
            found[those] = 3 * number + piece
    return found


def _mesh(body: PosedBody, table: ClipTable) -> Arrays:
    """`position` and `normal` float32[v, 3] in the rest pose, `face` uint32[m, 3], `colour` uint8[v, 4] (linear colours as square
    roots, and how much of the agent's own), `bone` uint8 or uint16[v, 4], `weight` uint8[v, 4]; `joint` int32[B] by depth and
    `inverse` float32[B, 3, 4] of the bones."""
    mesh = body.mesh
    place = np.append(_depths(table), -1)  # of a bone without a joint: -1
    colour = np.sqrt(np.clip(np.column_stack([body.own, np.square(body.tint)]), 0, 1))
    return {
        "position": mesh.points,
        "normal": np.round(mesh.normals * 127).astype(np.int8),
        "face": body.faces.astype(np.uint32),
        "colour": np.round(colour * 255).astype(np.uint8),
        "bone": mesh.bones.astype(np.uint16),
        "weight": mesh.weights,
        "joint": place[mesh.joint].astype(np.int32),
        "part": np.append(_parts(body.legs, len(table.order)), 0)[mesh.joint].astype(np.int32),
        "inverse": mesh.inverse,
    }
