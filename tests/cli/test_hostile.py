"""Files of strangers and their verdicts, from the tables below `cases/hostile`: each is accepted, or refused with a place, within
seconds and without a traceback."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import islice
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import pytest
from cases.hostile import meshes, numbers, runs, scenes, text, usd, volumes
from cases.hostile.rows import PROJECT, Row
from reliability import ROWS, TESTS

from antdsl import limits
from antdsl.diagnostics import Diagnostic
from antdsl.pipeline import check_path, open_scene, simulate
from antdsl.reader import client
from antdsl.runtime import FaultStop

SECONDS = 10.0  # of CPU that one row may take, a busy machine or not
TABLES = {table.__name__.rpartition(".")[2]: table.ROWS for table in (text, scenes, meshes, usd, volumes, numbers, runs)}


def project(folder: Path, row: Row) -> Path:
    folder.mkdir(exist_ok=True)
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


def _has_location(finding: Diagnostic) -> bool:
    """Whether a finding says where: at a span, or by the name of a file that is no text."""
    if finding.span is None:
        return ".ant`" in finding.message or ".yaml`" in finding.message
    return finding.span.source.path.endswith((".ant", ".yaml"))


def rows(tables: Mapping[str, Sequence[Row]]) -> list[Any]:
    return [pytest.param(row, id=f"{table}: {row.name}") for table, table_rows in tables.items() for row in table_rows]


@pytest.mark.parametrize("row", rows(TABLES))
def test_hostile_files_give_the_expected_result(row: Row, tmp_path: Path) -> None:
    scene, began = project(tmp_path, row), process_time()
    _, report = check_path(scene)
    matches = [d for d in report.sort_by_place() if d.code == row.verdict]
    messages = [f"{d.severity} {d.code}: {d.message}" for d in report.sort_by_place()]
    if not row.verdict:
        assert report.ok and (row.warned or not messages), messages
    else:
        assert matches and any(row.words in d.message or (row.words in str(d.help)) for d in matches), messages
        assert all(_has_location(d) for d in matches)
        assert all(text.isprintable() for d in matches for text in (d.message, d.help or ""))
    if report.ok and row.frames:
        shot, report = open_scene(scene)
        assert shot is not None, messages
        try:
            world = list(islice(simulate(shot), row.frames))[-1]
            assert not row.faults
            for name, population in world.populations.items():
                own = [population.now[a.name] for a in shot.program.species[name].attributes if a.name in population.now]
                assert all(np.isfinite(a).all() for a in (population.position, *own) if a.dtype.kind == "f")
        except FaultStop as why:
            assert row.faults, str(why)
            assert ".ant:" in str(why), "it has a place"
    else:
        assert report.ok or row.verdict
    assert process_time() - began < SECONDS


@pytest.mark.slow
@pytest.mark.parametrize("row", rows({"usd": usd.SLOW}))
def test_slow_usd_files_are_stopped(row: Row, tmp_path: Path) -> None:
    test_hostile_files_give_the_expected_result(row, tmp_path)


def test_slow_usd_files_are_stopped_at_the_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same with less CPU time, of which starting the reader takes a part."""
    monkeypatch.setattr(limits, "READER_BASE_CPU_SECONDS", 1)
    monkeypatch.setattr(client, "_file_reader", client.FileReader())
    row = next(each for each in usd.SLOW if "2^23" in each.name)
    test_hostile_files_give_the_expected_result(row, tmp_path)


def test_every_listed_bad_input_has_a_test() -> None:
    """The list finds its tests by their names: who renames a test renames it there too."""
    named = {row.name.split()[0] for table in TABLES.values() for row in table}
    assert len(ROWS) == 117
    for id, row in ROWS.items():
        assert row.tests or id in named, f"{id} has no test"
        for test in row.tests:
            file, _, function = test.partition("[")[0].partition("::")
            text = (TESTS / file).read_text(encoding="utf-8")
            assert not function or re.search(rf"^(async )?def {function}\(", text, re.MULTILINE), f"{id}: there is no {test}"
