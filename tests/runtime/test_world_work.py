"""Estimates of the work of a world: exact where it can be counted, saturated where it is endless, and nothing is allocated."""

from __future__ import annotations

import numpy as np
import pytest

from antdsl import limits
from antdsl.runtime.binding.work_estimates import WorkEstimate, estimate_world_work
from antdsl.scene.setting import CrowdData, FlowTarget, MeshData, SolidData, SolvedFlowData, SpreadFlowData, WorldSetting

SQUARE = MeshData(np.array([[0, 0, 0], [100, 0, 0], [100, 0, 100], [0, 0, 100.0]]), np.array([[0, 2, 1], [0, 3, 2]], np.int32))
TARGET = FlowTarget(np.zeros((1, 3)), np.zeros(1))


def test_faces_cells_and_agents_are_counted() -> None:
    setting = WorldSetting(surfaces={"ground": SQUARE}, crowds=(CrowdData("ant", 7), CrowdData("ant", 5, line_index=1)))
    work_items = estimate_world_work(setting, {"trail": (("ground",), 2.0)}, {"ant": 40})
    assert work_items[0][:3] == ("surface ground", 2, "faces")
    assert work_items[1][:3] == ("field trail", 2500, "cells at least")
    assert work_items[2] == WorkEstimate("species ant", 12, "agents", 12 * (2 * 40 + 600))


@pytest.mark.parametrize("edge", [1e-9, 5e-324, 1e-150])
def test_endless_work_is_a_number(edge: float) -> None:
    setting = WorldSetting(
        surfaces={"ground": SQUARE},
        solids={"hill": SolidData(SQUARE, edge)},
        flows={"home": SolvedFlowData(TARGET, cell=edge), "near": SpreadFlowData("toward", TARGET, radius=edge)},
    )
    with np.errstate(all="ignore"):
        work_items = estimate_world_work(setting, {"trail": (("ground",), edge)}, {})
    for work in work_items:
        assert 0 <= work.part_count <= 2**62 and 0 <= work.bytes <= 2**62
    home, near = work_items[-2:]
    assert home.unit_name == near.unit_name == "points at most"
    assert 1_000_000 < home.part_count <= limits.MAX_FLOW_POINTS and near.part_count <= 200_000  # which has no `cell`


def test_a_world_of_nothing_needs_nothing() -> None:
    assert estimate_world_work(WorldSetting(), {}, {}) == []
