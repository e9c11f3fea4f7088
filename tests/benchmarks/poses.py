"""World transforms of a crowd that blends two clips an agent, beside the same written by hand for this alone.

`python tests/benchmarks/poses.py` prints, for agents of 20 joints with and without scales, milliseconds of one frame by the
clock and of processor time, on one thread and on two, and the ratio of processor time to two bounds measured in turn in the same
run, with where it lies with 95 %. Both bounds know that there are two clips, no groups, no layers and no channels, and check
nothing: `by arrays` is straight-line NumPy over the same parts of the crowd, which reads and writes as much; `by loops` is one
kernel compiled by numba, an agent at a time, which may contract and reorder (fastmath). `--shapes` also deforms a shape of 200
points for each agent, by each deformer."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from antdsl.bench.ratios import MIN_PAIRS, compute_bootstrap_interval, measure_in_turn
from antdsl.bodies.agents.blending import ClipBlendTree, ClipPlayback, blend_poses
from antdsl.bodies.agents.definition import Binding, Clip, Definition, Rig, SkinShape, SkinWeights
from antdsl.bodies.agents.deformers import DEFORMER_BY_NAME, deform_binding
from antdsl.bodies.agents.poses import ClipTable, build_clip_table

Floats = NDArray[np.float32]
JOINTS = 20
PART = (1 << 15) // JOINTS  # agents worked on at once, as in `blending`


def insect(scales: bool) -> Definition:
    """A rig of 20 joints: a trunk of two, and six chains of three from it; a walk and a run of random poses."""
    random = np.random.default_rng(1)
    names = tuple(f"j{k}" for k in range(JOINTS))
    parents = np.array([-1, 0, *(k - 6 if k >= 8 else 1 for k in range(2, JOINTS))], np.int32)
    clips = {}
    for name, samples in (("walk", 25), ("run", 17)):
        rotation = random.normal((0, 0, 0, 4), size=(samples, JOINTS, 4))
        rotation /= np.linalg.norm(rotation, axis=2, keepdims=True)
        scale = random.uniform(0.9, 1.1, (samples, JOINTS, 3)) if scales else np.ones((samples, JOINTS, 3))
        clips[name] = Clip(name, 24.0, names, random.normal(size=(samples, JOINTS, 3)).astype(np.float32),
                           rotation.astype(np.float32), scale.astype(np.float32))  # fmt: skip
    return Definition("insect", Rig(names, parents, np.tile(np.eye(4), (JOINTS, 1, 1))), clips=clips)


def crowd(agents: int) -> ClipPlayback:
    """Agents that walk and run at once, each at its own time and with its own weights."""
    random = np.random.default_rng(2)
    clips = np.tile(np.array([[0, 1]], np.int32), (agents, 1))
    return ClipPlayback.make_with_shared_tree(
        ClipBlendTree.build_flat(2),
        clips,
        random.uniform(0, 10, (agents, 2)),
        random.uniform(0.1, 1, (agents, 2)).astype(np.float32),
    )


def by_arrays(table: ClipTable, playing: ClipPlayback, world: Floats) -> None:
    """World transforms [3, 4, J, n] in straight-line NumPy."""
    samples, levels, width = table.sample_rows, table.depth_levels, 10 if table.has_scale else 7
    one, two = np.float32(1), np.float32(2)
    for a in range(0, len(playing.tree_indices), PART):
        b = min(a + PART, len(playing.tree_indices))
        weight = playing.weights[a:b].T / playing.weights[a:b].sum(axis=1)
        poses = []
        for slot in (0, 1):
            clip = playing.clips[a:b, slot] + 1
            turn = table.sample_counts[clip] - 1
            at = playing.times[a:b, slot] * table.rates[clip] % turn
            row = at.astype(np.int64)
            share = (at - row).astype(np.float32)[:, None]
            row += table.first_sample_rows[clip]
            now, then = samples.take(row, axis=0), samples.take(row + 1, axis=0)
            then -= now
            then *= share
            now += then
            pose = np.empty(now.shape[::-1], np.float32)
            pose[:] = now.T
            pose = pose.reshape(width, JOINTS, b - a)
            q = pose[3:7]
            q /= np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
            poses.append(pose)
        first, second = poses
        near = first[3:7] * second[3:7]
        side = np.where(near[0] + near[1] + near[2] + near[3] < 0, -weight[1], weight[1])
        first *= weight[0]
        second[:3] *= weight[1]
        second[7:] *= weight[1]
        second[3:7] *= side
        first += second
        q = first[3:7]
        q /= np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
        x, y, z, w = q
        x2, y2, z2 = x * two, y * two, z * two
        xx, yy, zz, xy, xz, yz, wx, wy, wz = x * x2, y * y2, z * z2, x * y2, x * z2, y * z2, w * x2, w * y2, w * z2
        local = np.empty((3, 4, JOINTS, b - a), np.float32)
        local[0, 0], local[0, 1], local[0, 2] = one - (yy + zz), xy - wz, xz + wy
        local[1, 0], local[1, 1], local[1, 2] = xy + wz, one - (xx + zz), yz - wx
        local[2, 0], local[2, 1], local[2, 2] = xz - wy, yz + wx, one - (xx + yy)
        local[:, 3] = first[:3]
        if table.has_scale:
            local[:, :3] *= first[7:]
        placed = np.empty_like(local)
        for begin, end, parents in levels:
            own = local[:, :, begin:end]
            if not len(parents):
                placed[:, :, begin:end] = own
                continue
            above = placed[:, :, parents]
            for r in range(3):
                for c in range(4):
                    placed[r, c, begin:end] = above[r, 0] * own[0, c] + above[r, 1] * own[1, c] + above[r, 2] * own[2, c]
                placed[r, 3, begin:end] += above[r, 3]
        world[:, :, :, a:b] = placed


@njit(cache=True, fastmath=True)
def _by_loops(samples, first, counts, rates, clips, times, weights, parents, scaled, world):  # type: ignore[no-untyped-def]
    n, joints = len(clips), len(parents)
    pose = np.empty((10, joints), np.float32)
    for i in range(n):
        total = weights[i, 0] + weights[i, 1]
        for slot in range(2):
            clip = clips[i, slot] + 1
            turn = counts[clip] - 1
            at = times[i, slot] * rates[clip]
            at -= np.floor(at / turn) * turn
            row = int(at)
            share = np.float32(at - row)
            now, then = samples[first[clip] + row], samples[first[clip] + row + 1]
            weight = weights[i, slot] / total
            for j in range(joints):
                q0, q1 = now[3 * joints + j], now[4 * joints + j]
                q2, q3 = now[5 * joints + j], now[6 * joints + j]
                q0 += (then[3 * joints + j] - q0) * share
                q1 += (then[4 * joints + j] - q1) * share
                q2 += (then[5 * joints + j] - q2) * share
                q3 += (then[6 * joints + j] - q3) * share
                by = weight / np.sqrt(q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
                if slot == 0:
                    for k in range(3):
                        pose[k, j] = pose[7 + k, j] = np.float32(0)
                    pose[3, j] = pose[4, j] = pose[5, j] = pose[6, j] = np.float32(0)
                elif q0 * pose[3, j] + q1 * pose[4, j] + q2 * pose[5, j] + q3 * pose[6, j] < 0:
                    by = -by
                pose[3, j] += q0 * by
                pose[4, j] += q1 * by
                pose[5, j] += q2 * by
                pose[6, j] += q3 * by
            for k in range(3):
                for j in range(joints):
                    c = k * joints + j
                    pose[k, j] += (now[c] + (then[c] - now[c]) * share) * weight
            if scaled:
                for k in range(3):
                    for j in range(joints):
                        c = (7 + k) * joints + j
                        pose[7 + k, j] += (now[c] + (then[c] - now[c]) * share) * weight
        for j in range(joints):
            x, y, z, w = pose[3, j], pose[4, j], pose[5, j], pose[6, j]
            by = np.float32(1) / np.sqrt(x * x + y * y + z * z + w * w)
            x, y, z, w = x * by, y * by, z * by, w * by
            sx = sy = sz = np.float32(1)
            if scaled:
                sx, sy, sz = pose[7, j], pose[8, j], pose[9, j]
            two, one = np.float32(2), np.float32(1)
            a00, a01, a02 = (one - two * (y * y + z * z)) * sx, two * (x * y - w * z) * sy, two * (x * z + w * y) * sz
            a10, a11, a12 = two * (x * y + w * z) * sx, (one - two * (x * x + z * z)) * sy, two * (y * z - w * x) * sz
            a20, a21, a22 = two * (x * z - w * y) * sx, two * (y * z + w * x) * sy, (one - two * (x * x + y * y)) * sz
            t0, t1, t2 = pose[0, j], pose[1, j], pose[2, j]
            up = parents[j]
            for r in range(3):
                if up < 0:
                    u0, u1, u2, u3 = np.float32(r == 0), np.float32(r == 1), np.float32(r == 2), np.float32(0)
                else:
                    u0, u1, u2, u3 = world[i, up, r, 0], world[i, up, r, 1], world[i, up, r, 2], world[i, up, r, 3]
                world[i, j, r, 0] = u0 * a00 + u1 * a10 + u2 * a20
                world[i, j, r, 1] = u0 * a01 + u1 * a11 + u2 * a21
                world[i, j, r, 2] = u0 * a02 + u1 * a12 + u2 * a22
                world[i, j, r, 3] = u0 * t0 + u1 * t1 + u2 * t2 + u3


def by_loops(table: ClipTable, playing: ClipPlayback, world: Floats) -> None:
    """World transforms [n, J, 3, 4], joints in the order of the rig, which is that of the table here."""
    parents = np.asarray(table.rig.parents, np.int64)
    _by_loops(
        table.sample_rows,
        table.first_sample_rows,
        table.sample_counts,
        table.rates,
        playing.clips,
        playing.times,
        playing.weights,
        parents,
        table.has_scale,
        world,
    )


def milliseconds(work: Callable[[], object], count: int) -> tuple[float, float]:
    """The least of some runs by the clock and of processor time."""
    times = []
    for _ in range(count):
        clock, processor = time.perf_counter(), time.process_time()
        work()
        times.append((1e3 * (time.perf_counter() - clock), 1e3 * (time.process_time() - processor)))
    return min(each[0] for each in times), min(each[1] for each in times)


def measure(agents: int, scales: bool, turns: int) -> None:
    """One table: what a frame takes, and how it is to the bounds, after comparing what they give."""
    table, playing = build_clip_table(insect(scales)), crowd(agents)
    arrays, loops = np.empty((3, 4, JOINTS, agents), np.float32), np.empty((agents, JOINTS, 3, 4), np.float32)
    runners: list[Callable[[], object]] = [
        lambda: blend_poses(table, {}, playing), lambda: by_arrays(table, playing, arrays),
        lambda: by_loops(table, playing, loops)
    ]  # fmt: skip
    for runner in runners:
        runner()
    world = blend_poses(table, {}, playing).world_transforms
    assert np.allclose(arrays.transpose(3, 2, 0, 1), world, atol=1e-4) and np.allclose(loops, world, atol=1e-4)

    def cost(runner: int) -> float:
        begin = time.process_time()
        runners[runner]()
        return time.process_time() - begin

    print(f"{agents} agents of {JOINTS} joints, two clips each, {'with' if scales else 'without'} scales: ms of a frame")
    rows: Sequence[tuple[str, Callable[[], object]]] = (
        ("poses, 1 thread", runners[0]), ("poses, 2 threads", lambda: blend_poses(table, {}, playing, threads=2)),
        ("by arrays", runners[1]), ("by loops", runners[2]),
    )  # fmt: skip
    for name, work in rows:
        clock, processor = milliseconds(work, turns)
        print(f"  {name:18} {clock:7.1f} by the clock {processor:7.1f} of processors")
    costs = measure_in_turn(cost, len(runners), turns)
    for number, name in ((1, "by arrays"), (2, "by loops")):
        print(f"  ratio to {name}: {compute_bootstrap_interval([each[0] / each[number] for each in costs])}")


def shapes(agents: int) -> None:
    """What deforming a shape of 200 points, each of which follows two joints, takes for all agents."""
    random = np.random.default_rng(3)
    definition = insect(scales=False)
    points, normals = random.normal(size=(2, 200, 3)).astype(np.float32)
    capture = SkinWeights(
        definition.rig.names, random.integers(0, JOINTS, (200, 2)).astype(np.int32), np.full((200, 2), 0.5, np.float32),
                      np.tile(np.eye(4), (JOINTS, 1, 1)))  # fmt: skip
    between = {"dq": random.uniform(size=200).astype(np.float32)}
    faces = np.zeros((0, 3), np.int32)
    skin = SkinShape("skin", points, faces, normals, attributes=between, capture=capture, dual_quaternion_blend="dq")
    definition = replace(definition, shapes={"skin": skin})
    poses = blend_poses(build_clip_table(definition), {}, crowd(agents))
    print(f"200 points and normals, two joints each, for {agents} agents: ms")
    for name in ("", *(each for each in DEFORMER_BY_NAME if each != "blendshape")):
        clock, processor = milliseconds(
            lambda name=name: deform_binding(definition, Binding("j1", "skin", deformer=name), poses), 3
        )  # type: ignore[misc]
        print(f"  {name or 'static':22} {clock:8.1f} by the clock {processor:8.1f} of processors")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--agents", type=int, default=15_000)
    parser.add_argument("--turns", type=int, default=MIN_PAIRS)
    parser.add_argument("--shapes", action="store_true")
    options = parser.parse_args()
    for scales in (False, True):
        measure(options.agents, scales, options.turns)
    if options.shapes:
        shapes(options.agents)


if __name__ == "__main__":
    main()
