"""Agents are sorted into cells by any number of threads as by one, and as NumPy sorts them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from antdsl.bench.cases import find_case
from antdsl.machine_code import llvm_compiler
from antdsl.numerics import parallel
from antdsl.runtime import Options, bind
from antdsl.runtime.backends.native.search import search_grids
from antdsl.runtime.world import AXES
from antdsl.senses import cell_order

pytestmark = pytest.mark.skipif(not llvm_compiler.is_available(), reason="no machine code here")
COUNT = 9_003


def test_parts_are_sorted_as_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "count_available_cores", lambda: 8)
    monkeypatch.setattr(cell_order, "count_available_cores", lambda: 8)
    shot = find_case("boids").make_shot(COUNT)
    world = bind(shot.plan, shot.setting, Options())
    (crowd,) = world.populations.values()
    place = [np.random.default_rng(k).choice([0.0, 1.0, 2.5, 40.0], COUNT) for k in range(3)]  # many in one cell, most in none
    for axis, each in zip(AXES, place, strict=True):
        crowd.start[f"position.{axis}"][:] = each
    table_sets: list[dict[str, NDArray[Any]]] = []
    for threads in (1, 2, 3, 7):
        cell_grids = search_grids.SearchGrids()
        for cell in (2.0, 9.0, 1.0, 2.0):  # fewer cells and more
            cell_grids.begin_step()
            tables = cell_grids.build_tables(SimpleNamespace(options=SimpleNamespace(threads=threads)), crowd, cell)  # type: ignore[arg-type]
            cells = int(np.prod(tables["whole"][3:6]))  # type: ignore[index]
            names = ("x", "y", "z", "places", "at")
            own = {name: np.array(tables[name][:COUNT]) for name in names}  # type: ignore[index]
            table_sets.append(own | {"starts": np.array(tables["starts"][: cells + 1])})  # type: ignore[index]
    for k, own in enumerate(table_sets):
        assert all(np.array_equal(array, table_sets[k % 4][name]) for name, array in own.items())
        rows = own["places"][:, 3].view(np.int32)
        assert np.array_equal(own["at"][rows], np.arange(COUNT))
        assert all(np.array_equal(own[axis], each[rows].astype(np.float32)) for axis, each in zip(AXES, place, strict=True))
        starts = own["starts"]
        assert starts[0] == 0 and starts[-1] == COUNT and (np.diff(starts) >= 0).all()
        cells = np.searchsorted(starts, np.arange(COUNT), side="right")
        assert (np.diff(rows)[np.diff(cells) == 0] > 0).all()  # those of a cell in the order of their rows
