"""Prints a hash of poses, and of shapes that follow them, all made from whole numbers: `python tests/bodies/pose_hash.py`."""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.blending import ADDITIVE_BLEND_MODE, INTERPOLATE_BLEND_MODE, ClipBlendTree, ClipPlayback, blend_poses
from antdsl.bodies.agents.definition import (
    Binding,
    BlendTargets,
    Channel,
    Clip,
    Definition,
    Rig,
    SkinShape,
    SkinWeights,
    TransformGroup,
)
from antdsl.bodies.agents.deformers import deform_binding
from antdsl.bodies.agents.poses import build_clip_table

JOINTS, POINTS, AGENTS = 11, 70, 300


def main() -> None:
    random = np.random.default_rng(17)

    def numbers(*shape: int) -> NDArray[np.float64]:
        """Multiples of 1/64 from -2 to 2."""
        return random.integers(-128, 129, shape) / 64

    names = tuple(f"j{k}" for k in range(JOINTS))
    rest = np.tile(np.eye(4), (JOINTS, 1, 1))
    rest[:, :3] = numbers(JOINTS, 3, 4)
    clips = {}
    for name, count in (("a", 7), ("b", 4)):
        parts = (numbers(count, JOINTS, width).astype(np.float32) for width in (3, 4, 3, 3))
        clips[name] = Clip(name, 24.0, names, *parts, ("jaw",), numbers(count, 1).astype(np.float32))
    share = (random.integers(0, 65, (POINTS, 1)) / 64).astype(np.float32)
    follows = random.integers(0, JOINTS, (POINTS, 2)).astype(np.int32)
    capture = SkinWeights(names, follows, np.concatenate([share, 1 - share], axis=1), np.tile(np.eye(4), (JOINTS, 1, 1)))
    points, others, normals = numbers(3, POINTS, 3).astype(np.float32)
    skin = SkinShape("skin", points, np.zeros((0, 3), np.int32), normals, attributes={"dq": numbers(POINTS).astype(np.float32)},
                 capture=capture, blend=BlendTargets(("other",), ("jaw",)), dual_quaternion_blend="dq")  # fmt: skip
    shapes = {"skin": skin, "other": SkinShape("other", others, skin.faces, normals[::-1])}
    rig = Rig(names, np.array([-1, *(random.integers(0, k) for k in range(1, JOINTS))], np.int32), rest, (Channel("jaw"),))
    definition = Definition("made", rig, shapes, clips=clips, groups={"some": TransformGroup("some", (("j2", 0.5), ("j3", 1.0)))})
    tree = ClipBlendTree(
        (1, 1, 2), ("", "some", ""), (ADDITIVE_BLEND_MODE, INTERPOLATE_BLEND_MODE, INTERPOLATE_BLEND_MODE), (-1, 0, 0)
    )
    times = random.integers(-500, 500, (AGENTS, 3)) / 256
    playing = ClipPlayback.make_with_shared_tree(
        tree, random.integers(-1, 2, (AGENTS, 3)).astype(np.int32), times, np.abs(numbers(AGENTS, 3)).astype(np.float32)
    )
    poses = blend_poses(build_clip_table(definition), definition.groups, playing, needs_local=True)
    digest = hashlib.sha256()
    for array in (poses.world_transforms, poses.local_transforms, poses.channels):
        assert array is not None and np.isfinite(array).all()
        digest.update(array.tobytes())
    for binding in (Binding("j4", "skin"), Binding("", "skin", deformer="blendshape+dualquatblendskinning")):
        deformed = deform_binding(definition, binding, poses)
        assert deformed.normals is not None and np.isfinite(deformed.points).all()
        digest.update(deformed.points.tobytes() + deformed.normals.tobytes())
    print(digest.hexdigest())


if __name__ == "__main__":
    main()
