"""Flows and maps as scenes write them: what is read from files, and messages about what does not fit."""

from __future__ import annotations

from pathlib import Path

import meshes
import numpy as np
import pytest
import trimesh

from antdsl.cli.commands.new import build_ground_ply
from antdsl.diagnostics import Report
from antdsl.outputs.cache.cache_reader import open_cache
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.pictures import Camera, render_frame
from antdsl.outputs.recording import begin_recording, record_frames
from antdsl.pipeline import RunChoices, Shot, open_scene, simulate
from antdsl.runtime import Options, state_hash
from antdsl.scene.setting import BorderFlowData, PaintedValues, SolvedFlowData, SpreadFlowData

PROGRAM = """ant 1
use steering
world { surface ground; items nest; curve way; flow drift; map damp }
species ant {
  wet = 0
  start go
  state go { steer along(drift) + wander() * 0.3; wet = damp }
}
"""
SCENE = """antdsl: 1
frames: 1..3
world:
  ground: {mesh: ground.ply}
  nest: {home: {at: [10, 0, 10], on: ground, radius: 5 mm}}
  way: {curve: way.json}
  drift: {tangent: way, radius: 40 mm}
  damp: {painted: damp.npz}
crowd:
  - {species: ant, from: ant.ant, count: 5, place: {on: ground}}
"""
POINTS = 81  # of the ground
DRIFT = "{tangent: way, radius: 40 mm}"
DAMP = "{painted: damp.npz}"


def ply(vertices: np.ndarray, faces: np.ndarray, columns: dict[str, np.ndarray], text: bool = False) -> bytes:
    """A mesh with attributes on its vertices."""
    kinds = {name: "uchar" if values.dtype == np.uint8 else "float" for name, values in columns.items()}
    head = ["ply", f"format {'ascii' if text else 'binary_little_endian'} 1.0", f"element vertex {len(vertices)}"]
    head += [f"property float {axis}" for axis in "xyz"] + [f"property {kind} {name}" for name, kind in kinds.items()]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    begin = "\n".join(head).encode()
    if text:
        rows = [" ".join(f"{v:.9g}" for v in row) for row in np.column_stack([vertices, *columns.values()])]
        return begin + "\n".join([*rows, *(f"3 {a} {b} {c}" for a, b, c in faces), ""]).encode()
    kind = [(axis, "<f4") for axis in "xyz"] + [(name, "u1" if kinds[name] == "uchar" else "<f4") for name in columns]
    body = np.zeros(len(vertices), kind)
    for k, axis in enumerate("xyz"):
        body[axis] = vertices[:, k]
    for name, values in columns.items():
        body[name] = values
    corners = np.zeros(len(faces), [("n", "u1"), ("v", "<i4", 3)])
    corners["n"], corners["v"] = 3, faces
    return begin + body.tobytes() + corners.tobytes()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "ant.ant").write_text(PROGRAM)
    (tmp_path / "ground.ply").write_bytes(build_ground_ply(9))
    (tmp_path / "way.json").write_text("[[0, 0, 0], [50, 0, 0]]")
    np.savez(tmp_path / "damp.npz", damp=np.linspace(0, 1, POINTS), comb=np.ones((POINTS, 3)), short=np.ones(7))
    return tmp_path


def opened(folder: Path, scene: str = SCENE, **choices: object) -> tuple[Shot | None, Report]:
    (folder / "scene.yaml").write_text(scene)
    return open_scene(folder / "scene.yaml", RunChoices(**choices))  # type: ignore[arg-type]


def drift(folder: Path, text: str) -> object:
    """The flow that a scene gives, which must run as well."""
    shot, report = opened(folder, SCENE.replace("{tangent: way, radius: 40 mm}", text))
    assert shot is not None, report.errors
    assert len([0 for _ in simulate(shot)]) == 3
    return shot.setting.flows["drift"]


def test_every_form_of_a_flow(folder: Path) -> None:
    flow = drift(folder, "{tangent: way, radius: 4 cm, falloff: linear, strength: -0.5, cell: 3 mm, on: ground, gather: 2}")
    assert (
        isinstance(flow, SpreadFlowData)
        and flow.direction == "tangent"
        and flow.target.is_line
        and flow.target.positions.shape == (2, 3)
    )
    assert (flow.radius, flow.falloff, flow.strength, flow.cell, flow.surfaces) == (40, "linear", -0.5, 3, ("ground",))
    assert flow.gather == 2
    flow = drift(folder, "{tangent: way.json}")
    assert isinstance(flow, SpreadFlowData) and flow.radius is None and flow.target.is_line
    flow = drift(folder, "{toward: home, radius: 30}")
    assert (
        isinstance(flow, SpreadFlowData) and flow.direction == "toward" and flow.target.positions[0, [0, 2]].tolist() == [10, 10]
    )
    assert flow.target.radii.tolist() == [5]
    flow = drift(folder, "{away: [1 cm, 0, -5]}")
    assert isinstance(flow, SpreadFlowData) and flow.target.positions.tolist() == [[10, 0, -5]] and not flow.target.is_line
    flow = drift(folder, "{border: ground, within: 20 mm}")
    assert (
        isinstance(flow, BorderFlowData) and flow.surfaces == ("ground",) and flow.max_distance == 20 and flow.falloff == "linear"
    )
    flow = drift(folder, "{solved: nest, slope: 2, room: 5 mm, maps: {damp: 4}, crowding: 1.5, every: 2 step, cell: 30 mm}")
    assert isinstance(flow, SolvedFlowData) and flow.maps == {"damp": 4} and flow.interval == pytest.approx(2 / 24)
    assert (flow.slope, flow.clearance, flow.crowding) == (2, 5, 1.5)
    flow = drift(folder, "{painted: damp.npz, attribute: comb, strength: 0.25}")
    assert isinstance(flow, PaintedValues) and flow.surface == "ground" and np.allclose(flow.values, 0.25)


def test_the_file_of_a_flow_is_an_input_of_the_cache(folder: Path) -> None:
    original, _ = opened(folder)
    np.savez(folder / "damp.npz", damp=np.zeros(POINTS))
    edited, _ = opened(folder)
    assert original is not None and edited is not None
    assert original.inputs["damp.npz"] != edited.inputs["damp.npz"]
    changed, _ = opened(folder, SCENE.replace("40 mm", "41 mm"))
    assert changed is not None and changed.inputs["scene"] != edited.inputs["scene"]


@pytest.mark.parametrize("text", [False, True])
def test_attributes_of_ply_files_turn_with_their_mesh(folder: Path, text: bool) -> None:
    vertices, faces = meshes.grid(100.0, 6)
    vertices = np.concatenate([[[9.0, 9, 9]], vertices])  # of no face: it is left out, and what is painted on it
    n = len(vertices)
    columns = {"wind_x": np.zeros(n), "wind_y": np.zeros(n), "wind_z": np.full(n, 0.5), "moss": vertices[:, 0] / 50}
    columns["damp"] = np.full(n, 51, np.uint8) if not text else np.full(n, 0.2)
    columns["wind_z"][0] = 7
    (folder / "ground.ply").write_bytes(ply(vertices, faces + 1, columns, text))
    if not text:
        assert set(trimesh.load(folder / "ground.ply").metadata["_ply_raw"]["vertex"]["data"].dtype.names) >= {"wind_z", "moss"}
    scene = SCENE.replace("{tangent: way, radius: 40 mm}", "{painted: ground.ply, attribute: wind}")
    scene = scene.replace("{painted: damp.npz}", "{painted: ground.ply}")
    scene = scene.replace("ground.ply}\n  nest", "ground.ply, up: z, rotate: [90, 0, 90], scale: -1}\n  nest").replace(
        "on: ground, ", ""
    )
    shot, report = opened(folder, scene)
    assert shot is not None, report.errors
    flow, damp = shot.setting.flows["drift"], shot.setting.maps["damp"]
    assert isinstance(flow, PaintedValues) and flow.values.shape == (n - 1, 3)
    # z of a file with z as its up is the scene's y; turned about x to z, then about z it stays; the mirror turns it back
    assert np.allclose(flow.values, [[0, 0, -0.5]]) and np.allclose(damp.values, 0.2)
    shot, report = opened(folder, scene.replace("attribute: wind", "attribute: [wind_z, wind_x, moss]"))
    assert shot is not None, report.errors


@pytest.mark.parametrize(
    ("old", "new", "code", "words"),
    [
        ("{tangent: way, ", "{tangnt: way, ", "wrong-value", "did you mean `tangent`?"),
        (DRIFT, "{slope: 2}", "wrong-value", "no key defines the kind of this thing | add one of `mesh`"),
        ("{tangent: way, ", "{tangent: wy, ", "unknown-thing", "did you mean `way`?"),
        ("{tangent: way, ", "{tangent: nest, ", "unknown-thing", "no curve is named `nest`"),
        ("{tangent: way, ", "{toward: hom, ", "unknown-thing", "did you mean `home`?"),
        ("{tangent: way, ", "{toward: wy.json, ", "no-such-file", "did you mean `way.json`?"),
        ("{tangent: way, ", "{toward: ground.ply, ", "bad-points", "is not JSON"),
        ("{tangent: way, ", "{toward: ../way.json, ", "bad-path", "leaves its folder"),
        ("radius: 40 mm", "radius: 40 s", "wrong-value", "`40 s` is not a length"),
        ("radius: 40 mm", "raduis: 40 mm", "unknown-key", "did you mean `radius`?"),
        ("radius: 40 mm", "falloff: soft", "wrong-value", "none of `none`"),
        ("radius: 40 mm", "strength: 2", "wrong-value", "not between -1 and 1"),
        ("radius: 40 mm", "gather: 1", "missing-key", "add `radius: 50 mm`"),
        ("radius: 40 mm", "on: grund", "unknown-thing", "did you mean `ground`?"),
        (DRIFT, "{border: ground}", "missing-key", "`drift` has no `within`"),
        (DRIFT, "{border: nest, within: 5 mm}", "unknown-thing", "no surface is named `nest`"),
        ("{home: {at: [10, 0, 10], on: ground, radius: 5 mm}}\n  way: {curve: way.json}\n  drift: {tangent: way, radius: 40 mm}",
         "{}\n  way: {curve: way.json}\n  drift: {solved: nest}", "missing-thing", "`nest` has no items"),
        (DRIFT, "{solved: nest, maps: {dam: 2}}", "unknown-thing", "did you mean `damp`?"),
        (DRIFT, "{solved: nest, every: 1 s}", "wrong-value", "add `crowding: 2`"),
        (DRIFT, "{curve: way.json}", "wrong-kind", "`drift` is a flow in the program"),
        (DRIFT, "{painted: damp.npz}", "bad-paint", "the file has `damp`, `comb`, `short`"),
        (DRIFT, "{painted: damp.npz, attribute: damp}", "bad-paint", "needs (n, 3)"),
        (DRIFT, "{painted: ground.ply, attribute: wind}", "bad-paint", "has no three attributes `wind`"),
        (DAMP, "{tangent: way}", "wrong-kind", "`damp` is a map in the program"),
        (DAMP, "{painted: damp.npz, attribute: short}", "bad-paint", "has 7 values, and `ground` has 81 vertices"),
        (DAMP, "{painted: damp.npz, attribute: comb}", "bad-paint", "needs (n,)"),
        (DAMP, "{painted: ground.ply}", "bad-paint", "the file has `x`, `y`, `z`"),
        (DAMP, "{painted: way.json}", "bad-paint", "neither a .ply nor an .npz"),
        ("place: {on: ground}", "place: {density: dmp}", "unknown-thing", "did you mean `damp`?"),
        ("place: {on: ground}", "place: {density: damp, radius: 5 mm}", "wrong-value", "by `density` or by `radius`, not both"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_reported_at_its_place(folder: Path, old: str, new: str, code: str, words: str) -> None:
    assert old in SCENE
    _, report = opened(folder, SCENE.replace(old, new))
    assert [d.code for d in report.errors] == [code], report.errors
    error = report.errors[0]
    assert words in f"{error.message} | {error.help}", error
    assert error.span is not None
    line, _ = error.span.source.find_line_column(error.span.start)
    assert new.splitlines()[-1] in error.span.source.line_text(line), error.span.source.line_text(line)


def test_paint_that_is_no_paint(folder: Path) -> None:
    np.savez(folder / "damp.npz", damp=np.full(POINTS, np.nan))
    assert [d.message for d in opened(folder)[1].errors] == ["`damp.npz` has a value (number 0) that is not finite"]
    np.savez(folder / "damp.npz", damp=np.full(POINTS, 1e300))
    assert [d.message for d in opened(folder)[1].errors] == ["`damp.npz` has a value (number 0) that is too large to store"]
    np.savez_compressed(folder / "damp.npz", damp=np.zeros(POINTS))
    assert "uncompressed" in str(opened(folder)[1].errors[0].help)
    np.savez(folder / "damp.npz", damp=np.array([{"a": 1}], dtype=object), allow_pickle=True)
    assert [d.code for d in opened(folder)[1].errors] == ["bad-paint"]
    (folder / "damp.npz").write_bytes((folder / "ground.ply").read_bytes())
    assert [d.code for d in opened(folder)[1].errors] == ["bad-paint"]
    np.savez(folder / "damp.npz", damp=-np.ones(POINTS))
    report = opened(folder, SCENE.replace("{on: ground}", "{density: damp}"))[1]
    assert "0 everywhere" in report.errors[0].message
    body = (folder / "ground.ply").read_bytes()
    (folder / "cut.ply").write_bytes(body[: len(body) // 2])
    report = opened(folder, SCENE.replace("damp.npz", "cut.ply"))[1]
    assert [d.code for d in report.errors] == ["bad-paint"]


def test_a_program_without_a_surface_has_nowhere_to_paint(folder: Path) -> None:
    (folder / "ant.ant").write_text(
        "ant 1\nuse steering\nworld { flow drift }\nspecies ant { state go { steer along(drift) } }\n"
    )
    scene = "antdsl: 1\nframes: 1..3\nworld: {drift: DRIFT}\ncrowd:\n  - {species: ant, from: ant.ant, count: 5}\n"
    shot, report = opened(folder, scene.replace("DRIFT", "{away: [0, 0, 0], radius: 300 mm}"))
    assert shot is not None, report.errors
    assert len([0 for _ in simulate(shot)]) == 3
    assert [d.code for d in opened(folder, scene.replace("DRIFT", "{solved: [0, 0, 0]}"))[1].errors] == ["missing-thing"]


def test_too_many_points_are_reported_before_anything_is_allocated(folder: Path) -> None:
    from antdsl.runtime import BindError, bind

    shot, report = opened(folder, SCENE.replace("radius: 40 mm", "cell: 0.001 mm"))
    assert shot is not None, report.errors
    with pytest.raises(BindError) as caught:
        bind(shot.plan, shot.setting)
    assert [d.code for d in caught.value.report.errors] == ["flow-too-fine"]


def test_a_run_that_is_continued_between_two_looks_at_the_crowd_goes_on_the_same(folder: Path) -> None:
    text = SCENE.replace(DRIFT, "{solved: nest, crowding: 3, every: 4 step, cell: 30 mm}").replace("1..3", "1..11")
    shot, report = opened(folder, text)
    assert shot is not None, report.errors
    complete_hashes = {world.frame: state_hash(world) for world in simulate(shot)}
    recording = begin_recording(shot, folder / "out", Options(), resume=False, force=False)
    for state in record_frames(recording):
        state.stop_requested = state.frame == 7  # the crowd was looked at two frames ago
    going_on = begin_recording(shot, folder / "out", Options(), resume=True, force=False)
    assert going_on.resumed_from == 7
    assert [state.frame for state in record_frames(going_on)] == [8, 9, 10, 11]
    assert open_cache(folder / "out").read_state_hashes() == complete_hashes


def test_arrows_of_a_flow_are_stored_in_the_cache_and_drawn(folder: Path) -> None:
    shot, report = opened(folder, SCENE.replace(DRIFT, "{toward: [0, 0, 0]}"))
    assert shot is not None, report.errors
    for _ in record_frames(begin_recording(shot, folder / "out", Options(), resume=False, force=False)):
        pass
    gallery = Gallery(open_cache(folder / "out"))
    (flow,) = gallery.flows
    far = np.linalg.norm(flow.position, axis=1) > 10
    place, direction = flow.position[far][:, [0, 2]], flow.displacement[far][:, [0, 2]]
    cosine = -(place * direction).sum(axis=1) / np.linalg.norm(place, axis=1) / np.linalg.norm(direction, axis=1)
    assert flow.name == "drift" and far.sum() > 40 and cosine.min() > 0.9
    picture, above = gallery.make_picture(1), Camera((0, 300, 1), (0, 0, 0))
    plain, drawn = (render_frame(picture, above, 160, 90, show=show).astype(int) for show in ((), ("flow",)))
    assert (np.abs(plain - drawn).max(axis=2) > 20).sum() > 100
