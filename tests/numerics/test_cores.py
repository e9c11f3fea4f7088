"""How many threads may run at once."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from antdsl.numerics.processor import host as module


@pytest.fixture
def groups(tmp_path: Path) -> Path:
    """Control groups of both versions: one within another, the outer of which may use more, and one without a limit."""
    files = {
        "cpu.max": "max 100000\n",
        "batch/cpu.max": "350000 100000\n",
        "batch/job/cpu.max": "150000 100000\n",
        "batch/free/cpu.max": "max 100000\n",
        "cpu/cpu.cfs_quota_us": "-1\n",
        "cpu/cpu.cfs_period_us": "100000\n",
        "cpu/job/cpu.cfs_quota_us": "50000\n",
        "cpu/job/cpu.cfs_period_us": "100000\n",
        "odd/cpu.max": "no number\n",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize(
    ("own", "limits"),
    [
        ("0::/\n", []),
        ("0::/batch/job\n", [3.5, 1.5]),
        ("0::/batch/free\n", [3.5]),
        ("0::/batch/gone\n", [3.5]),
        ("0::/../batch/job\n", [3.5, 1.5]),
        ("4:memory:/job\n2:cpuacct:/job\n", []),
        ("4:memory:/\n2:cpu,cpuacct:/job\n0::/\n", [0.5]),
        ("1:cpu:/\n", []),
        ("0::/odd\n", []),
        ("nothing of the kind\n", []),
        ("", []),
    ],
)
def test_limits_of_control_groups_are_read(groups: Path, own: str, limits: list[float]) -> None:
    assert list(module.iterate_core_limits(own, groups)) == limits


@pytest.mark.parametrize(("own", "most"), [("0::/batch/job\n", 2), ("1:cpu:/job\n", 1), ("0::/\n", 64)])
def test_no_more_threads_run_than_a_control_group_has_time_for(
    groups: Path, monkeypatch: pytest.MonkeyPatch, own: str, most: int
) -> None:
    group_file = groups / "own"
    group_file.write_text(own, encoding="utf-8")
    monkeypatch.setattr(module, "PROCESS_CGROUP_FILE", group_file)
    monkeypatch.setattr(module, "CGROUPS_FOLDER", groups)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(64)), raising=False)
    assert module.count_available_cores.__wrapped__() == most


def test_without_control_groups_all_cores_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "PROCESS_CGROUP_FILE", tmp_path / "none")
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 3, 5}, raising=False)
    assert module.count_available_cores.__wrapped__() == 3
