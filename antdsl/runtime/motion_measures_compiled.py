"""The measures of a step as one pass over the agents: the same operations in the same order as `motion_measures`, the same bits."""

# The annotations are for readers: `@kernel` reads the source, `njit` the first call.
from __future__ import annotations

from typing import Any

import numpy as np

from antdsl.numerics.kernel_cache import njit


@njit(inline="always")
def _length(x, y, z):  # type: ignore[no-untyped-def]
    return np.sqrt((x * x + y * y) + z * z)


@njit(inline="always")
def _bin(half, least, first):  # type: ignore[no-untyped-def]
    """The last bin whose least half chord is no more than this one's; `first`: where to begin to look, by its size."""
    k = first[np.int64(half * np.float32(4096.0))]
    while half >= least[k + 1]:
        k += 1
    return k


@njit(cache=True, nogil=True, error_model="numpy")
def counted(
    now: Any, start: Any, speeds: Any, ways: Any, histograms: Any, bins: Any, numbers: Any, shares: Any, found: Any
) -> int:
    """Adds one step of agents to the measures; gives the number of shares written.

    now, start: position, heading and up, nine arrays float32[n] each; speeds: velocity, push, max_speed, size, eight of them;
    ways: place float64[n,3], start of the way float64[n,3], its length float64[n], age int64[n]; histograms: turns and tilts
    int64; bins: least half chord of each, float32, and where to begin; numbers: of a step in s, a push that is meant, the share
    of speed that is standing float32, steps of a window, the way in body lengths that counts; shares float64[n]: straightness of
    ways that have ended; found float64[5]: greatest half chord of a tilt, greatest share of a step, who stands, zeros before."""
    px, py, pz, hx, hy, hz, ux, uy, uz = now
    qx, qy, qz, gx, gy, gz, wx, wy, wz = start
    vx, vy, vz, ax, ay, az, fastest, size = speeds
    place, began, path, age = ways
    turns, tilts = histograms
    least, first = bins
    dt, wish, still, steps, far = numbers
    one, none = np.float32(1.0), np.float32(0.0)
    tilt, share, standing, ended = none, none, 0, 0
    for i in range(path.size):
        half = min(_length(hx[i] - gx[i], hy[i] - gy[i], hz[i] - gz[i]) * np.float32(0.5), one)
        turns[_bin(half, least, first)] += 1
        half = min(_length(ux[i] - wx[i], uy[i] - wy[i], uz[i] - wz[i]) * np.float32(0.5), one)
        tilts[_bin(half, least, first)] += 1
        tilt = max(tilt, half)
        longest = fastest[i] * dt
        if longest > none:
            gone = _length(px[i] - qx[i], py[i] - qy[i], pz[i] - qz[i]) / longest
            if gone > share:
                share = gone
        speed = _length(vx[i], vy[i], vz[i])
        if _length(ax[i], ay[i], az[i]) > wish and speed < fastest[i] * still:
            standing += 1
        path[i] += np.float64(speed * dt)
        age[i] += 1
        if age[i] >= steps:
            if path[i] > np.float64(far * size[i]):
                x, y, z = place[i, 0] - began[i, 0], place[i, 1] - began[i, 1], place[i, 2] - began[i, 2]
                shares[ended] = min(_length(x, y, z) / path[i], 1.0)
                ended += 1
            began[i, 0], began[i, 1], began[i, 2] = place[i, 0], place[i, 1], place[i, 2]
            path[i], age[i] = 0.0, 0
    found[0], found[1], found[2] = np.float64(tilt), np.float64(share), np.float64(standing)
    return ended
