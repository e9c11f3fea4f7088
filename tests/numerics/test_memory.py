"""What memory is available: the system's, and what control groups leave of it."""

from __future__ import annotations

from pathlib import Path

import pytest

import antdsl.numerics.processor.host as module

MIB = 1 << 20


@pytest.fixture
def groups(tmp_path: Path) -> Path:
    """Control groups of both versions, with a limit each."""
    texts = {
        "job/memory.max": f"{100 * MIB}\n", "job/memory.current": f"{60 * MIB}\n",
        "job/memory.stat": f"anon 1\nactive_file {MIB}\ninactive_file {4 * MIB}\n",
        "memory.max": "max\n", "memory.current": "1\n", "memory.stat": "anon 1\n",
        "memory/old/memory.limit_in_bytes": f"{10 * MIB}", "memory/old/memory.usage_in_bytes": f"{20 * MIB}",
        "memory/old/memory.stat": "cache 1\n",
    }  # fmt: skip
    for name, text in texts.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


@pytest.mark.parametrize(
    ("own", "bytes"),
    [("0::/job\n", [45 * MIB]), ("0::/\n", []), ("3:memory:/old\n", [0]), ("2:cpu:/job\n", []), ("nothing\n", []), ("", [])],
)
def test_memory_limits_of_control_groups_are_read(groups: Path, own: str, bytes: list[int]) -> None:
    assert list(module.iterate_free_group_memory(own, groups)) == bytes


def test_the_lowest_memory_limit_counts(groups: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own, system = groups / "own", groups / "meminfo"
    own.write_text("0::/job\n")
    system.write_text("MemTotal: 900 kB\nMemAvailable:   20480 kB\n")
    monkeypatch.setattr(module, "PROCESS_CGROUP_FILE", own)
    monkeypatch.setattr(module, "CGROUPS_FOLDER", groups)
    monkeypatch.setattr(module, "_MEMINFO_FILE", system)
    assert module.measure_available_memory() == 20 * MIB
    system.write_text("MemTotal: 900 kB\n")
    assert module.measure_available_memory() == 45 * MIB
    own.unlink()
    assert module.measure_available_memory() is None
