"""Joints and channels of agents as NPZ: local and world transforms of each agent in each frame, and its channel values.

For each species K. A species with several bodies has the arrays for each of them, `SPECIES#0`, `SPECIES#1` and so on:

    K.id int64[r]                        the agent of each row
    K.rows int64[F + 1]                  frame k has the rows `rows[k]:rows[k + 1]`
    K.place float64[r, 4, 4]             from the space of the body to the scene, relative to the scene's zero point
    K.world float32[r, J, 4, 4]          of each joint, in the space of the body
    K.local float32[r, J, 4, 4]          of each joint, in the space of its parent
    K.channels float32[r, C]             channel values

For all species:

    frames int64[F]                      the frame numbers
    about uint8                          a JSON text: the joints, their parents and the channels of each body"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.atomic_write import write_atomically
from antdsl.bodies.agents.definition import Definition
from antdsl.bodies.agents.poses import to_square_matrices
from antdsl.bodies.body import build_rotation_matrices
from antdsl.bodies.posed_body import PosedBody
from antdsl.outputs.cache.npz import encode_npz
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.numbered_files import ExportUnavailable
from antdsl.outputs.pictures.model import Crowd, Picture

_MAX_FILE_BYTES = 2 * limits.GIB
FEWER_AGENTS_ADVICE = "choose fewer with `--ids 0..20` or `--frames A..B`"


@dataclass(slots=True)
class _PoseRows:
    """The rows of all agents with one body. `counts`: the number of rows in each frame. `arrays`: by name, one array per
    frame."""

    body: Definition
    counts: list[int] = field(default_factory=list)
    arrays: dict[str, list[NDArray[Any]]] = field(default_factory=dict)


NO_AGENTS_MESSAGE = "these frames have no agents"


def export_poses(gallery: Gallery, frames: Iterable[int], path: Path) -> list[str]:
    """Write the joint transforms and the channel values of each agent.

    Raises ExportUnavailable if the data exceeds the memory limit, CacheError for a damaged frame, OSError if writing fails."""
    frames = list(frames)
    rows_by_body: dict[str, _PoseRows] = {}
    size = 0
    for number, frame in enumerate(frames):
        for (_, key, _), crowd, worn in list_crowds_by_body(gallery.make_picture(frame)):
            rows = rows_by_body.setdefault(key, _PoseRows(worn.definition))
            rows.counts += [0] * (number + 1 - len(rows.counts))
            rows.counts[number] += len(crowd.position)
            size += len(crowd.position) * (len(worn.definition.rig.names) * 128 + 200)
            if size > _MAX_FILE_BYTES:
                raise ExportUnavailable(
                    f"the poses of these agents and frames take more than {_MAX_FILE_BYTES >> 30} GiB", FEWER_AGENTS_ADVICE
                )
            arrays = make_pose_arrays(crowd)
            arrays["place"][:, :3, 3] += gallery.origin
            for name, array in arrays.items():
                rows.arrays.setdefault(name, []).append(array)
    arrays = {"frames": np.array(frames, np.int64)}
    description = {}
    for name, rows in rows_by_body.items():
        counts = rows.counts + [0] * (len(frames) - len(rows.counts))
        arrays[f"{name}.rows"] = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        arrays |= {f"{name}.{key}": np.concatenate(parts) for key, parts in rows.arrays.items()}
        rig = rows.body.rig
        description[name] = {
            "joints": rig.names,
            "parents": rig.parents.tolist(),
            "channels": [each.name for each in rig.channels],
        }
    arrays["about"] = np.frombuffer(json.dumps(description).encode("ascii"), np.uint8)
    write_atomically(path, encode_npz(arrays))
    return [] if rows_by_body else [NO_AGENTS_MESSAGE]


# A species, the key of one of its bodies, and the layers that agents wear in addition to the body's own.
BodyKey = tuple[str, str, tuple[str, ...]]


def list_crowds_by_body(picture: Picture) -> list[tuple[BodyKey, Crowd, PosedBody]]:
    """Return the non-empty crowds of a picture, as (key of species, body and layers; crowd; body)."""
    return [
        ((crowd.species, crowd.body_key or crowd.species, crowd.body.layers), crowd, crowd.body)
        for crowd in picture.crowds
        if len(crowd.position)
    ]


def compute_placements(crowd: Crowd, body: Definition) -> NDArray[np.float64]:
    """Return matrices float64[n, 4, 4], one per agent, that transform the space of the body to the scene, relative to the scene's
    origin."""
    matrices = np.tile(np.eye(4), (len(crowd.position), 1, 1))
    matrices[:, :3, :3] = build_rotation_matrices(np.asarray(crowd.orient, np.float64)) * np.asarray(crowd.scale)[:, None, None]
    matrices[:, :3] = matrices[:, :3] @ body.compute_base_matrix()
    matrices[:, :3, 3] += crowd.position
    return matrices


def make_pose_arrays(crowd: Crowd) -> dict[str, NDArray[Any]]:
    """Return the arrays of a crowd by name: ids, placement matrices, joint transforms, and channels of the agents."""
    poses = crowd.compute_poses(needs_local=True)
    assert poses.local_transforms is not None and crowd.ids is not None
    return {
        "id": np.asarray(crowd.ids, np.int64), "place": compute_placements(crowd, crowd.body.definition),
        "world": to_square_matrices(poses.world_transforms), "local": to_square_matrices(poses.local_transforms),
        "channels": np.ascontiguousarray(poses.channels),
    }  # fmt: skip
