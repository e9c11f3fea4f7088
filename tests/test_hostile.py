"""Files of strangers and their verdicts, from the tables below `cases/hostile`: each is accepted, or refused with a place, within
seconds and without a traceback."""

from __future__ import annotations

from pathlib import Path
from time import process_time

import pytest
from cases.hostile import meshes, numbers, runs, usd, volumes
from cases.hostile.rows import PROJECT, Row

from antdsl.pipeline import check_path, open_scene, simulate
from antdsl.runtime import FaultStop

SECONDS = 10.0  # of CPU that one row may take, a busy machine or not
TABLES = {"meshes": meshes.ROWS, "usd": usd.ROWS, "volumes": volumes.ROWS, "numbers": numbers.ROWS, "runs": runs.ROWS}


def project(folder: Path, row: Row) -> Path:
    for name, data in {**PROJECT, **row.files}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data if isinstance(data, bytes) else data())
    for name, (old, new) in row.edits.items():
        text = (folder / name).read_text()
        assert old in text, row.name
        (folder / name).write_text(text.replace(old, new))
    if row.make is not None:
        row.make(folder)
    return folder / "scene.yaml"


@pytest.mark.parametrize("row", [pytest.param(row, id=f"{table}: {row.name}") for table, rows in TABLES.items() for row in rows])
def test_the_verdict_on_a_file(row: Row, tmp_path: Path) -> None:
    scene, began = project(tmp_path, row), process_time()
    _, report = check_path(scene)
    found = [d for d in report.sorted() if d.code == row.verdict]
    told = [f"{d.severity} {d.code}: {d.message}" for d in report.sorted()]
    if not row.verdict:
        assert not told, told
    else:
        assert found and any(row.words in d.message or (row.words in str(d.help)) for d in found), told
        assert all(d.span is not None and d.span.source.path.endswith((".ant", ".yaml")) for d in found), "it has a place"
        assert all(text.isprintable() for d in found for text in (d.message, d.help or ""))
    if report.ok and row.frames:
        shot, report = open_scene(scene)
        assert shot is not None, told
        try:
            for number, world in enumerate(simulate(shot), 1):
                if number == row.frames:
                    break
            assert not row.faults and all(len(p) >= 0 for p in world.populations.values())
        except FaultStop as why:
            assert row.faults, str(why)
            assert ".ant:" in str(why), "it has a place"
    else:
        assert report.ok or row.verdict
    assert process_time() - began < SECONDS
