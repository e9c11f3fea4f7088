"""Which faces may cut each other is found among faces of very different sizes too, without looking at all pairs."""

from __future__ import annotations

import numpy as np
import pytest

from antdsl.casting import rasterise
from antdsl.ground.mesh import self_cuts
from tests.meshes import terrain


def mixed(count: int, seed: int) -> np.ndarray:
    """Corners of triangles, some a thousand times as large as others."""
    rng = np.random.default_rng(seed)
    size = 10 ** rng.uniform(-1, 2, (count, 1, 1))
    return rng.uniform(0, 100, (count, 1, 3)) + rng.normal(size=(count, 3, 3)) * size


@pytest.mark.parametrize("seed", [1, 2])
def test_faces_of_all_sizes_are_cut_by_those_that_are_found_among_all_pairs(seed: int, monkeypatch: pytest.MonkeyPatch):
    corners, names = mixed(400, seed), np.arange(1200, dtype=np.int32).reshape(-1, 3)
    cuts = self_cuts.find_self_intersections(corners, names, np.zeros(400, np.int32), 1e-9)
    monkeypatch.setattr(self_cuts, "_iterate_overlapping_pairs", lambda *_: iter([np.triu_indices(400, 1)]))
    all_of_them = self_cuts.find_self_intersections(corners, names, np.zeros(400, np.int32), 1e-9)
    assert len(cuts.cutting_faces) > 400
    assert np.array_equal(cuts.cut_starts, all_of_them.cut_starts) and np.array_equal(
        cuts.cutting_faces, all_of_them.cutting_faces
    )


@pytest.mark.parametrize("large", [[[0, 5, 0], [4e6, 5, 3.6e6], [0, 5, 4e6]], [[0, 5, 0], [4e6, 5, 3.6e6], [0, 5, 2]]])
def test_one_large_face_among_small_ones_costs_little(large: list[list[float]], monkeypatch: pytest.MonkeyPatch):
    vertices, faces = terrain(400, 40)
    corners = np.concatenate([vertices[faces], np.array([large], float)])
    parts, looked = [], []
    real, paired = rasterise._find_cells_by_box, self_cuts._iterate_pairs_in_cells
    monkeypatch.setattr(rasterise, "_find_cells_by_box", lambda tri, *rest: parts.append(len(tri)) or real(tri, *rest))

    def pairing(*args):
        for pair in paired(*args):
            looked.append(len(pair[0]))
            yield pair

    monkeypatch.setattr(self_cuts, "_iterate_pairs_in_cells", pairing)
    names = np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3)
    self_cuts.find_self_intersections(corners, names, np.zeros(len(corners), np.int32), 1e-6)
    assert len(corners) <= sum(parts) <= 10 * len(corners)
    assert sum(looked) <= 100 * len(corners)
