"""The measures of a step as one pass over the agents: the operations of `motion_measures` in the same order, the same bits."""

import numpy as np

from antdsl.machine_code.kernels import F32, F64, I64, Array1, Array2, Strided2, independent, inlined, kernel, scratch
from antdsl.numerics.parts_compiled import own

_Vector = tuple[Array1[F32], Array1[F32], Array1[F32]]
_PART = 512  # agents, of whom the numbers are worked out before they are counted


@inlined
def _length(x, y, z):  # type: ignore[no-untyped-def]
    return np.sqrt((x * x + y * y) + z * z)


@inlined
def _between(a, b, i):  # type: ignore[no-untyped-def]
    return _length(a[0][i] - b[0][i], a[1][i] - b[1][i], a[2][i] - b[2][i])


@inlined
def _count(half, least, first, bins, part):  # type: ignore[no-untyped-def]
    """The last bin whose least half chord is no more than this one's; `first`: where to begin to look, by its size."""
    k = first[np.int64(half * np.float32(4096.0))]
    k += 1 if half >= least[k + 1] else 0  # seldom more, so that what follows is foretold
    while half >= least[k + 1]:
        k += 1
    bins[part, k] += 1


@kernel
def counted(
    position: _Vector,
    heading: _Vector,
    up: _Vector,
    position_before: _Vector,
    heading_before: _Vector,
    up_before: _Vector,
    velocity: _Vector,
    push: _Vector,
    fastest: Array1[F32],
    size: Array1[F32],
    place: Strided2[F64],
    began: Strided2[F64],
    path: Array1[F64],
    age: Array1[I64],
    turns: Array2[I64],
    tilts: Array2[I64],
    several: I64,
    count: I64,
    least: Array1[F32],
    first: Array1[I64],
    straight: Array1[F64],
    dt: F32,
    wish: F32,
    still: F32,
    far: F32,
    steps: I64,
    begin: I64,
    end: I64,
) -> tuple[int, int, int, float, float]:
    """Adds one step of agents from `begin` to before `end` of a `count` to the measures: to the bins of turns and tilts, of which
    each of `several` parts has a row of its own, and to `path` and `age` of the ways that they `began`. Gives `begin`; how many
    ways have ended, whose straightness is written to `straight` from there on; how many stand; the greatest half chord of a tilt,
    and the greatest share of the longest step.

    `fastest` (mm/s) and `size` (mm) of each; `least` half chord of each bin, and the `first` to look at. `dt` s; `wish`: the
    least push that is meant; `still`: the share of speed that is standing; a way ends after `steps` and counts when it is `far`
    body lengths long."""
    ended, standing, part = 0, 0, own(begin, count, several)
    tilted, longest = np.float32(0.0), np.float32(0.0)
    turn, tilt, share, speed = scratch(_PART, F32), scratch(_PART, F32), scratch(_PART, F32), scratch(_PART, F32)
    wanted = scratch(_PART, F32)
    for low in range(begin, end, 512):
        high = min(low + _PART, end)
        for i in independent(low, high):
            turn[i - low] = _between(heading, heading_before, i) * np.float32(0.5)
        for i in independent(low, high):
            tilt[i - low] = _between(up, up_before, i) * np.float32(0.5)
        for i in independent(low, high):
            share[i - low] = _between(position, position_before, i) / (fastest[i] * dt)
        for i in independent(low, high):
            speed[i - low] = _length(velocity[0][i], velocity[1][i], velocity[2][i])
        for i in independent(low, high):
            wanted[i - low] = _length(push[0][i], push[1][i], push[2][i])
        for i in range(low, high):
            at = i - low
            _count(min(turn[at], np.float32(1.0)), least, first, turns, part)
            half = min(tilt[at], np.float32(1.0))
            _count(half, least, first, tilts, part)
            tilted = max(tilted, half)
            if fastest[i] * dt > np.float32(0.0) and share[at] > longest:
                longest = share[at]
            standing += 1 if wanted[at] > wish and speed[at] < fastest[i] * still else 0
            path[i] += np.float64(speed[at] * dt)
            age[i] += 1
            if age[i] >= steps:
                if path[i] > np.float64(far * size[i]):
                    net = _length(place[i, 0] - began[i, 0], place[i, 1] - began[i, 1], place[i, 2] - began[i, 2])
                    straight[begin + ended] = min(net / path[i], 1.0)
                    ended += 1
                for k in range(3):
                    began[i, k] = place[i, k]
                path[i] = 0.0
                age[i] = 0
    return begin, ended, standing, np.float64(tilted), np.float64(longest)
