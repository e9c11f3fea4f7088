"""Surfaces of heights: 16-bit images and arrays as ground, vertex by vertex, and what is no such file."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from antdsl import limits
from antdsl.cli import app
from antdsl.pipeline import Shot, open_scene
from antdsl.reader.images import read_image
from antdsl.reader.protocol import ReaderMessage
from antdsl.runtime import Options, bind, step
from antdsl.scene.geometry.heights import compute_sampling_deviation, make_height_surface, read_heights
from antdsl.scene.geometry.mesh_text import MeshError

PROGRAM = "ant 1\nuse steering\nworld { surface arena; map damp }\nspecies a { state w { steer wander() } }\n"
RNG = np.random.default_rng(5)
SAMPLES = RNG.integers(0, 65536, (5, 9)).astype(np.uint16)


def image(samples: np.ndarray, form: str) -> bytes:
    to = io.BytesIO()
    Image.fromarray(samples).save(to, form)
    return to.getvalue()


def npz(**arrays: np.ndarray) -> bytes:
    to = io.BytesIO()
    np.savez(to, **arrays)
    return to.getvalue()


def opened(folder: Path, name: str, data: bytes, keys: str = "", scene: str = "") -> tuple[Shot | None, str]:
    (folder / "a.ant").write_text(PROGRAM)
    (folder / name).write_bytes(data)
    (folder / "p.npz").write_bytes(npz(damp=SAMPLES.ravel() / 65535))
    (folder / "scene.yaml").write_text(
        f"antdsl: 1\nframes: 1..4\n{scene}world:\n"
        f"  arena: {{height: {name}, extent: [80 mm, 40], scale: 12 mm{keys}}}\n  damp: {{painted: p.npz}}\n"
        "crowd: [{species: a, from: a.ant, count: 20, place: {on: arena, density: damp}}]\n"
    )
    shot, report = open_scene(folder / "scene.yaml")
    return shot, " ".join(f"{d.code} {d.message} {d.help}" for d in report.sort_by_place())


def test_an_image_without_all_its_strips_is_an_error(tmp_path: Path) -> None:
    """A TIFF file that says it has more rows than its strips: Pillow would fill them with zeros."""
    data = image(SAMPLES, "TIFF")
    length = struct.pack("<HHII", 257, 4, 1, len(SAMPLES))  # the tag ImageLength, one number of 32 bits
    assert data.count(length) == 1
    shot, messages = opened(tmp_path, "h.tif", data.replace(length, struct.pack("<HHII", 257, 4, 1, 80)))
    assert (
        shot is None
        and "bad-mesh" in messages
        and "parts of the image are missing" in messages
        and "export the image again" in messages
    )


@pytest.mark.parametrize(("name", "form"), [("h.png", "PNG"), ("h.tif", "TIFF"), ("h.tiff", "TIFF")])
def test_vertices_are_the_samples_of_an_image(name: str, form: str, tmp_path: Path) -> None:
    shot, messages = opened(tmp_path, name, image(SAMPLES, form), ", offset: -3 mm")
    assert shot is not None, messages
    mesh = shot.setting.surfaces["arena"]
    grid = mesh.vertices.reshape(5, 9, 3)
    assert (grid[..., 1] == -3.0 + 12.0 * (SAMPLES / 65535)).all()
    assert (grid[:, 0, 0] == -40).all() and (grid[:, -1, 0] == 40).all()  # columns along +x, rows along +z
    assert (
        (grid[0, :, 2] == -20).all() and (grid[-1, :, 2] == 20).all() and np.diff(grid[0, :, 0]) == pytest.approx(np.full(8, 10))
    )
    corners = mesh.vertices[mesh.faces]
    assert len(mesh.faces) == 64 and (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 1] > 0).all()


def test_arrays_layers_places_and_axes(tmp_path: Path) -> None:
    volume = RNG.normal(0, 1, (3, 5, 9)).astype(np.float32)
    data = npz(snow=volume, rock=volume[0].astype(np.float64))
    shot, messages = opened(tmp_path, "h.npz", data, ", array: snow, layer: 2, at: [1, 2, 3]", "up: z\nunits: cm\n")
    assert shot is not None, messages
    grid = shot.setting.surfaces["arena"].vertices.reshape(5, 9, 3)
    assert grid[..., 2] == pytest.approx(30 + 12.0 * volume[2].astype(np.float64), abs=1e-9)
    assert (grid[0, 0, 0], grid[0, 0, 1]) == (10 - 40, 20 + 200)  # seen from above the first row is the upper one: +y
    assert opened(tmp_path, "h.npz", npz(only=volume[1]))[0] is not None


def test_agents_walk_on_it_by_a_painted_map_and_info_tells_of_its_patches(tmp_path: Path) -> None:
    shot, messages = opened(tmp_path, "h.png", image(SAMPLES // 16, "PNG"))
    assert shot is not None, messages
    world = bind(shot.plan, shot.setting, Options(backend="numpy"))
    for _ in range(3):
        step(world)
    assert len(world) == 20 and (world.populations["a"].footing.mesh == 0).all()
    run = CliRunner()
    result = run.invoke(app, ["run", str(tmp_path / "scene.yaml"), "--out", str(tmp_path / "c"), "--backend", "numpy", "-q"])
    assert result.exit_code == 0, result.output
    y = 12.0 * (SAMPLES // 16 / 65535)
    most = max(abs(y[i, j] - y[i, j + 1] - y[i + 1, j] + y[i + 1, j + 1]) for i in range(4) for j in range(8)) / 4
    assert f"at most {most:.3g} mm off the bilinear surface" in run.invoke(app, ["info", str(tmp_path / "c")]).output


def test_the_deviation_is_the_largest_that_is_found_by_looking() -> None:
    heights = RNG.normal(0, 3, (4, 6))
    vertices, faces = make_height_surface(heights, (5.0, 3.0))
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, 5, 101), np.linspace(0, 3, 61)))
    i, j = np.minimum(v.astype(int), 2), np.minimum(u.astype(int), 4)
    a, b = u - j, v - i
    patch = (1 - a) * ((1 - b) * heights[i, j] + b * heights[i + 1, j])
    patch += a * ((1 - b) * heights[i, j + 1] + b * heights[i + 1, j + 1])
    face = faces.reshape(3, 5, 2, 3)[i, j, np.where(b >= a, 0, 1)]
    p = vertices[face]
    weights = np.linalg.solve(
        np.stack([p[..., 0], p[..., 2], np.ones(p.shape[:2])], axis=1),
        np.stack([u - 2.5, v - 1.5, np.ones(len(u))], axis=1)[..., None],
    )[..., 0]
    flat = (weights * p[..., 1]).sum(axis=1)
    assert np.abs(flat - patch).max() == pytest.approx(compute_sampling_deviation(heights), rel=1e-3)


@pytest.mark.parametrize(
    ("name", "data", "extra", "words"),
    [
        ("h.png", image(SAMPLES.astype(np.uint8), "PNG"), "", "grey with 16 bits"),
        ("h.png", image(np.zeros((4, 4, 3), np.uint8), "PNG"), "", "one channel"),
        ("h.png", image(SAMPLES, "PNG")[:80], "", "cannot be read"),
        ("h.png", image(SAMPLES, "TIFF"), "", "cannot be read as PNG"),
        ("h.png", image(SAMPLES[:1], "PNG"), "", "two of each"),
        ("h.png", image(SAMPLES, "PNG"), ", layer: 1", "leave `layer` out"),
        ("h.exr", b"x", "", "not one of .png"),
        ("h.npz", npz(a=SAMPLES, b=SAMPLES), "", "`array: …`"),
        ("h.npz", npz(a=SAMPLES), ", array: b", "no array `b`"),
        ("h.npz", npz(a=np.zeros((2, 3, 4))), "", "`layer: 0`"),
        ("h.npz", npz(a=np.zeros((2, 3, 4))), ", layer: 2", "from 0 to 1"),
        ("h.npz", npz(a=np.full((3, 3), np.nan)), "", "not a finite number"),
        ("h.npz", npz(a=np.zeros(9)), "", "rows and columns"),
        ("h.npz", b"PK nothing", "", "damaged"),
    ],
)
def test_what_is_no_height_is_reported_at_its_place(name: str, data: bytes, extra: str, words: str, tmp_path: Path) -> None:
    shot, messages = opened(tmp_path, name, data, extra)
    assert shot is None and "bad-mesh" in messages and words in messages, messages


def test_a_large_image_is_refused_by_its_header(monkeypatch: pytest.MonkeyPatch) -> None:
    data = image(SAMPLES, "PNG")
    monkeypatch.setattr(limits, "MAX_MESH_FACES", 60)
    with pytest.raises(MeshError, match="more than 60 faces"):
        read_heights(data, "h.png")
    monkeypatch.setattr(Image.Image, "load", lambda *_: pytest.fail("decoded"))
    said = {"format": "PNG", "modes": ["I;16"], "pixels": SAMPLES.size - 1}
    document, arrays = read_image(ReaderMessage(said, {"data": np.frombuffer(data, np.uint8)}))
    assert (document["rows"], document["columns"]) == SAMPLES.shape and not arrays


def test_only_surfaces_are_made_of_heights(tmp_path: Path) -> None:
    (tmp_path / "a.ant").write_text("ant 1\nworld { obstacle arena }\nspecies a { state w { when age > 1 s -> w } }\n")
    (tmp_path / "h.png").write_bytes(image(SAMPLES, "PNG"))
    text = "antdsl: 1\nworld: {arena: {height: h.png, extent: [1, 1], scale: 1}}\ncrowd: [{species: a, from: a.ant, count: 1}]\n"
    (tmp_path / "scene.yaml").write_text(text)
    shot, report = open_scene(tmp_path / "scene.yaml")
    assert shot is None and report.sort_by_place()
