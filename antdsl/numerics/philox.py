"""Constants of Philox4x32-10 (Salmon et al. 2011, table 2), and what words become floats by."""

from __future__ import annotations

import numpy as np

M0, M1 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
W0, W1 = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
LOW = np.uint64(0xFFFFFFFF)
HALF = np.uint64(32)
ROUNDS = 10
UNIT = np.float32(2.0**-24)
SPREAD = np.uint64(0x9E3779B1)  # moves the high half of an id to other counters; odd, so no two ids of one half meet
