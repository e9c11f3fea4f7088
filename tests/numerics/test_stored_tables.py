"""Tables of meshes stored from run to run: the same bits as those computed, and nothing is read that is not what was written."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from antdsl.casting.distance_grid import DistanceGrid
from antdsl.casting.faces import TriangleFaces
from antdsl.casting.rays import RayScene
from antdsl.casting.triangle_grid import TriangleGrid
from antdsl.fields.cells import SurfaceCells
from antdsl.ground.mesh.creases import SlopeMap, find_inner_creases
from antdsl.ground.mesh.surface_clearance import PieceClearances
from antdsl.ground.mesh.topology import MeshTopology, build_topology
from antdsl.ground.moving import MovingGround
from antdsl.machine_code import signing
from antdsl.numerics import stored_tables
from antdsl.numerics.stored_tables import MIN_STORED_SIZE, TABLE_STORE, get_or_compute
from antdsl.scene.geometry.closed_meshes import count_border_edges
from antdsl.scene.setting import MeshData

Mesh = tuple[NDArray[np.float64], NDArray[np.int32]]
pytestmark = pytest.mark.skipif(signing.get_signer(create=True) is None, reason="this user can have no private key")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty store."""
    monkeypatch.setenv(TABLE_STORE.variable, str(tmp_path / "tables"))
    stored_tables.reset_store()
    yield tmp_path / "tables"
    stored_tables.reset_store()


def hills(rows: int, high: float = 6.0) -> Mesh:
    """A sheet of 2 · rows² faces, and a plate over a part of it."""
    along = np.linspace(-200.0, 200.0, rows + 1)
    x, z = (each.ravel() for each in np.meshgrid(along, along, indexing="ij"))
    i = (np.arange(rows)[:, None] * (rows + 1) + np.arange(rows)).ravel()
    sheet = np.concatenate([np.stack([i, i + 1, i + rows + 1], 1), np.stack([i + 1, i + rows + 2, i + rows + 1], 1)])
    ground = np.stack([x, high * np.sin(x / 25.0) * np.cos(z / 31.0), z], axis=1)
    plate = np.array([[-30.0, 9.0, -30.0], [30.0, 9.0, -30.0], [30.0, 9.0, 30.0], [-30.0, 9.0, 30.0]])
    faces = np.concatenate([sheet, np.array([[0, 1, 2], [0, 2, 3]]) + len(ground)])
    return np.concatenate([ground, plate]), faces.astype(np.int32)


def topology(mesh: Mesh) -> MeshTopology:
    return build_topology(*mesh, np.zeros(len(mesh[1]), np.int32), 400.0)


def arrays(mesh: Mesh) -> list[NDArray[np.generic]]:
    """All that is stored of a mesh, computed or not."""
    table, corners = topology(mesh), mesh[0][mesh[1]]
    grid = TriangleGrid.from_faces(TriangleFaces(corners), np.zeros(3))
    assert grid is not None
    cells = SurfaceCells([mesh], 3.0)
    plain = [getattr(table, each.name) for each in fields(table) if each.name != "cuts"]
    rise_map, parts = (
        SlopeMap(corners, table, [], find_inner_creases(table, corners)),
        PieceClearances(corners, table.piece, table.cuts.is_cut, mesh[0].min(axis=0), 0.0).get_face_parts(9.0),
    )
    other = [
        table.cuts.cut_starts,
        table.cuts.cutting_faces,
        rise_map._face_clearances,
        rise_map._crease_map._get_cells_within(4),
        DistanceGrid(corners)._cell_bounds,
    ]
    other += [
        parts.first_parts,
        parts.parts_per_edge,
        parts.clearances,
        cells.get_nearest_cells(7),
        np.array(count_border_edges(MeshData(*mesh))),
    ]
    return [np.asarray(each) for each in [*plain, *other, *grid.tables, cells._keys, cells.position, cells.normal]]


def same(one: list[NDArray[np.generic]], other: list[NDArray[np.generic]]) -> bool:
    return len(one) == len(other) and all(
        a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes() for a, b in zip(one, other, strict=True)
    )


def test_stored_tables_have_the_bits_of_computed_ones(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = hills(75)
    assert len(mesh[1]) >= MIN_STORED_SIZE
    begin = stored_tables.count_computed_tables()
    monkeypatch.setenv(TABLE_STORE.variable, "")
    stored_tables.reset_store()
    computed = arrays(mesh)
    assert stored_tables.count_computed_tables() == begin + 9 and not folder.exists()
    monkeypatch.setenv(TABLE_STORE.variable, str(folder))
    stored_tables.reset_store()
    assert same(arrays(mesh), computed) and stored_tables.count_computed_tables() == begin + 18
    stored_tables.reset_store()
    assert same(arrays(mesh), computed) and stored_tables.count_computed_tables() == begin + 18
    assert len(list(folder.iterdir())) == 9


def test_stored_arrays_belong_to_the_caller(folder: Path) -> None:
    mesh = hills(75)
    expected_normals = topology(mesh).normal.copy()
    for _ in range(2):
        table = topology(mesh)
        table.normal[:] = 7.0
    assert (topology(mesh).normal == expected_normals).all()


def test_small_meshes_are_not_stored(folder: Path) -> None:
    begin = stored_tables.count_computed_tables()
    for _ in range(2):
        topology(hills(20))
    assert stored_tables.count_computed_tables() == begin + 2 and not folder.exists()


@pytest.mark.parametrize("harm", ["a bit", "short", "empty", "long", "of another key", "a link"])
def test_damaged_tables_are_computed_again(folder: Path, harm: str, tmp_path: Path) -> None:
    mesh, begin = hills(75), stored_tables.count_computed_tables()
    table = topology(mesh)
    (file,) = folder.iterdir()
    original = data = file.read_bytes()
    if harm == "a bit":
        data = data[:-9] + bytes([data[-9] ^ 1]) + data[-8:]
    elif harm in ("short", "empty", "long"):
        data = {"short": data[:-64], "empty": b"", "long": data + bytes(64)}[harm]
    elif harm == "of another key":
        topology(hills(76))
        data = next(each for each in folder.iterdir() if each != file).read_bytes()
        begin += 1
    file.unlink()
    if harm == "a link":
        (tmp_path / "elsewhere").write_bytes(original)
        file.symlink_to(tmp_path / "elsewhere")
    else:
        file.write_bytes(data)
    stored_tables.reset_store()
    again = topology(mesh)
    assert stored_tables.count_computed_tables() == begin + 2
    assert again.link.tobytes() == table.link.tobytes() and again.smooth.tobytes() == table.smooth.tobytes()
    assert file.read_bytes() == original and not file.is_symlink()


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\n",
        b"[]\nmore",
        b'[["link", "|O", [2]]]\n' + bytes(128),
        b'[["link", "<f8", [-1]]]\n' + bytes(128),
        b'[["link", "<f8", ["x"]]]\n' + bytes(128),
        b'[["link", "<i8", [1000000]]]\n' + bytes(128),
        b"{1: 2}\n",
    ],
)
def test_signed_nonsense_is_not_used(folder: Path, data: bytes) -> None:
    inputs = (np.arange(4.0), 2.0)
    computed_arrays = {"link": np.arange(7)}
    stored_tables._open_store_once().store_bytes(stored_tables._compute_key("some", inputs), data)
    begin = stored_tables.count_computed_tables()
    assert get_or_compute("some", MIN_STORED_SIZE, inputs, lambda: computed_arrays)["link"] is computed_arrays["link"]
    assert get_or_compute("some", MIN_STORED_SIZE, inputs, dict)["link"].tolist() == list(range(7))
    assert stored_tables.count_computed_tables() == begin + 1


def test_table_keys_contain_all_inputs(monkeypatch: pytest.MonkeyPatch) -> None:
    key = stored_tables._compute_key
    one = np.arange(6.0)
    keys = {
        key("some", (one, 1.0)),
        key("other", (one, 1.0)),
        key("some", (one, 1.5)),
        key("some", (one, 1.0, "x")),
        key("some", (one.reshape(2, 3), 1.0)),
        key("some", (one.astype(np.float32), 1.0)),
        key("some", (-one, 1.0)),
    }
    assert len(keys) == 7 and key("some", (one.copy(), 1.0)) in keys
    monkeypatch.setattr(stored_tables, "_hash_sources", lambda: "others")
    assert key("some", (one, 1.0)) not in keys


def test_table_keys_contain_the_sources_of_all_computing_packages() -> None:
    named = {path.relative_to(Path(stored_tables.__file__).parents[1]).as_posix() for path in stored_tables._list_modules()}
    for module in ("ground/mesh/self_cuts.py", "casting/rasterise.py", "scene/geometry/live_faces.py", "fields/block_index.py"):
        assert module in named
    assert "numerics/stored_tables.py" in named and "machine_code/llvm_compiler.py" in named


def test_tables_of_moving_meshes_are_not_stored(folder: Path) -> None:
    vertices, faces = hills(75)
    ground = MovingGround({"deck": (vertices, faces)}, ["deck"])
    begin = len(list(folder.iterdir()))
    for frame in range(3):
        ground.set_mesh_vertices({"deck": vertices + np.array([0.0, frame + 1.0, 0.0])})
        scene, _ = ground._get_ray_scene(None)
        assert scene.find_hits_along_step(np.array([[0.0, 40.0 + frame, 0.0]]), np.array([[0.0, -60.0, 0.0]]))[0].size == 1
    assert len(list(folder.iterdir())) == begin
    brief = RayScene(vertices, faces, is_short_lived=True)
    brief.measure_clearance(*np.zeros((3, 4), np.float32))
    assert len(list(folder.iterdir())) == begin
    RayScene(vertices, faces).measure_clearance(*np.zeros((3, 4), np.float32))
    assert len(list(folder.iterdir())) == begin + 1
