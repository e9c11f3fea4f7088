"""Events out of a cache: what two frames tell of, and what frames have of their own, against what agents did."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from antdsl.bodies.body import rotate_vectors
from antdsl.outputs.cache.cache_reader import Cache, open_cache
from antdsl.outputs.gallery import Gallery
from tests.commands import run
from tests.gltf_scene import Scene

BUG = """ant 1
use steering
world { surface ground }
species bug {
  size 6 mm
  cries = 0
  heard = 0
  start go
  on bang { heard += 1 }
  state go {
    steer wander(swing: 90 deg)
    when chance 40 %/s -> cry { cries += 1 }
    when age > 0.5 s and id > 15 -> gone
  }
  state cry { enter { emit bang(within: 20 mm); spawn bug }; wear load; when after 0.2 s -> go }
  state gone { enter { emit farewell; die } }
  layers { state }
}
species mite { size 3 mm; start still; state still { steer halt() }; layers { state } }
"""
SCENE = """antdsl: 1
units: cm
frames: 3..26
world: {ground: {mesh: ground.obj}}
crowd:
  - {species: bug, from: bug.ant, count: 24, place: {on: ground}}
  - {species: mite, from: bug.ant, count: 30, place: {on: ground}}
contacts: soft
output: {attributes: [P, v, orient, id, pscale, Cd, state, cries], events: [contact, emit], checkpoint: 8}
"""


def ran(folder: Path, out: str, *words: str) -> Cache:
    process = run("run", "scene.yaml", "--out", out, "-q", *words, cwd=folder)
    assert process.returncode == 0, process.stderr
    return open_cache(folder / out)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Cache:
    folder = tmp_path_factory.mktemp("events")
    (folder / "bug.ant").write_text(BUG)
    (folder / "scene.yaml").write_text(SCENE)
    (folder / "ground.obj").write_text("v -3 0 -3\nv 3 1 -3\nv 3 0 3\nv -3 -1 3\nf 1 4 3\nf 1 3 2\n")
    return ran(folder, "cache", "--backend", "numpy")


def rows(cache: Cache, *words: str) -> list[dict[str, Any]]:
    path = cache.folder.parent / "events.csv"
    process = run("export", str(cache.folder), "--to", str(path), "--as", "events", *words, cwd=path.parent)
    assert process.returncode == 0 and "note" not in process.stdout, process.stderr
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def test_births_deaths_and_changes_are_those_of_the_frames(cache: Cache) -> None:
    table, counts = rows(cache), {"birth": 0, "death": 0, "state": 0}
    assert [int(row["frame"]) for row in table] == sorted(int(row["frame"]) for row in table)
    states = [state.name for state in cache.manifest.species[0].machines[0].states]
    for frame in range(4, 27):
        previous_frame, now = cache.frame(frame - 1), cache.frame(frame)
        previous_rows, current_rows = (
            dict(zip(a["id"][a["species"] == 0].tolist(), np.flatnonzero(a["species"] == 0).tolist(), strict=True))
                     for a in (previous_frame, now))  # fmt: skip
        event_rows = {kind: {int(r["id"]): r for r in table if int(r["frame"]) == frame and r["kind"] == kind} for kind in counts}
        assert set(event_rows["birth"]) == set(current_rows) - set(previous_rows) and set(event_rows["death"]) == set(
            previous_rows
        ) - set(current_rows)
        changed = {
            one
            for one in set(previous_rows) & set(current_rows)
            if previous_frame["state"][previous_rows[one]] != now["state"][current_rows[one]]
        }
        assert set(event_rows["state"]) == changed
        for one, row in event_rows["state"].items():
            assert row["what"] == states[now["state"][current_rows[one]]] and row["species"] == "bug"
        for kind, arrays, where in (("birth", now, current_rows), ("death", previous_frame, previous_rows)):
            for one, row in event_rows[kind].items():
                assert np.allclose([float(row[axis]) for axis in "xyz"], arrays["P"][where[one]], atol=1e-5)
                assert float(row["ny"]) > 0.9
                counts[kind] += 1
        counts["state"] += len(changed)
    assert min(counts.values()) > 3


def test_a_landing_foot_is_recorded_with_its_leg_and_place(cache: Cache) -> None:
    table = [row for row in rows(cache) if row["kind"] == "footfall" and row["species"] == "bug"]
    legs = [leg.name for leg in Gallery(cache).load_body(0).definition.legs]
    assert len(legs) == 6 and {row["what"] for row in table} == set(legs)
    landing_count = 0
    for frame in (5, 6, 7, 8, 16):
        previous_frame, now = cache.frame(frame - 1), cache.frame(frame)
        ids = [arrays["id"][arrays["species"] == 0].tolist() for arrays in (previous_frame, now)]
        event_rows = {(int(row["id"]), row["what"]): row for row in table if int(row["frame"]) == frame}
        landed = {
            (one, legs[leg])
            for one in set(ids[0]) & set(ids[1])
            for leg in range(6)
            if not previous_frame["feet.bug.down"][ids[0].index(one), leg] and now["feet.bug.down"][ids[1].index(one), leg]
        }
        assert landed == set(event_rows)
        landing_count += len(landed)
        for (one, leg), row in event_rows.items():
            place = now["feet.bug.P"][ids[1].index(one), legs.index(leg)]
            assert np.allclose([float(row[axis]) for axis in "xyz"], place, atol=1e-6)
    assert landing_count > 20


def test_ants_on_their_feet_and_with_their_loads_are_the_same_in_gltf(cache: Cache, tmp_path: Path) -> None:
    words = ("--ids", "0..9", "--frames", "10..16", "--tolerance", "0%")
    process = run("export", str(cache.folder), "--to", "ants.glb", *words, cwd=tmp_path)
    assert process.returncode == 0, process.stderr
    scene = Scene((tmp_path / "ants.glb").read_bytes())
    scene.check()
    names, worn = [node["name"] for node in scene.tree["nodes"]], set()
    for frame in (10, 14):
        _, points = scene.at((frame - 10) / 24)
        for crowd in Gallery(cache).make_picture(frame).crowds:
            assert crowd.body is not None and crowd.ids is not None and crowd.feet is not None
            if crowd.species != "bug":
                continue
            chosen = np.flatnonzero(crowd.ids < 10)
            drawn = crowd.pose_vertices(crowd.body, chosen)[0].astype(float)
            expected = (
                rotate_vectors(crowd.orient[chosen], drawn) * crowd.scale[chosen, None, None] + crowd.position[chosen, None]
            )
            for row, one in enumerate(crowd.ids[chosen].tolist()):
                own = [points[k] for k, name in enumerate(names) if name.startswith(f"bug_{one}_") and k in points]
                visible_points = np.concatenate(
                    [each for each in own if np.ptp(each, axis=0).max() > 1e-6]
                )  # who is hidden is tiny
                off = np.abs(visible_points[:, None] - expected[row][None] / 100).max(axis=2).min(axis=1)
                assert off.max() < 1e-6, "metres; an ant is 6e-3 long"
            worn |= {crowd.body.layers} if len(chosen) else set()
    assert worn == {(), ("load",)}


def test_emit_events_have_the_place_of_their_agent(cache: Cache) -> None:
    assert cache.manifest.events == ("bang", "farewell")
    bangs, farewells = 0, set()
    for frame in range(4, 27):
        previous_frame, now = cache.frame(frame - 1), cache.frame(frame)
        of = {name: now[f"events.emit.{name}"] for name in ("id", "event", "P", "N", "species")}
        assert not of["species"].any() and np.allclose(np.linalg.norm(of["N"], axis=1), 1, atol=1e-6)
        bugs = previous_frame["species"] == 0
        where = dict(zip(previous_frame["id"][bugs].tolist(), previous_frame["P"][bugs], strict=True))
        for one, event, place in zip(of["id"].tolist(), of["event"].tolist(), of["P"], strict=True):
            assert np.allclose(place, where[one], atol=1e-5), "where it was when the step began"
            bangs += event == 0
            if event == 1:
                farewells.add(one)
    deaths = {int(row["id"]) for row in rows(cache) if row["kind"] == "death"}
    assert bangs > 3 and farewells == deaths and farewells


def test_contacts_are_bodies_in_each_other(cache: Cache) -> None:
    pairs = 0
    for frame in (3, 12, 26):
        arrays = cache.frame(frame)
        of = {name.removeprefix("events.contact."): a for name, a in arrays.items() if name.startswith("events.contact.")}
        key = arrays["species"].astype(int) * 10_000 + arrays["id"]
        place = dict(zip(key.tolist(), zip(arrays["P"], arrays["pscale"], strict=True), strict=True))
        mine, theirs = (of[s].astype(int) * 10_000 + of[i] for s, i in (("species", "id"), ("other_species", "other")))
        assert (mine < theirs).all() and len(set(zip(mine.tolist(), theirs.tolist(), strict=True))) == len(mine)
        for a, b, where, depth, normal in zip(mine.tolist(), theirs.tolist(), of["P"], of["depth"], of["N"], strict=True):
            (pa, sa), (pb, sb) = place[a], place[b]
            assert 0 < depth < (sa + sb) / 2 and np.linalg.norm(pa - pb) < (sa + sb) / 2 + 1e-3
            assert max(np.linalg.norm(where - pa), np.linalg.norm(where - pb)) < 0.8 * max(sa, sb)
            assert np.linalg.norm(normal) == pytest.approx(1, abs=1e-5)
        pairs += len(mine)
    assert pairs > 5


def test_a_contact_is_recorded_when_it_begins(cache: Cache) -> None:
    contact_rows = [row for row in rows(cache) if row["kind"] == "contact"]
    pairs = set()
    for row in contact_rows:
        pair = (row["species"], row["id"], row["other_species"], row["other"])
        frame = int(row["frame"])
        names = [entry.name for entry in cache.manifest.species]
        if frame > 3:
            arrays = cache.frame(frame - 1)
            of = [arrays[f"events.contact.{name}"].tolist() for name in ("species", "id", "other_species", "other")]
            assert pair not in {(names[s], str(i), names[t], str(j)) for s, i, t, j in zip(*of, strict=True)}
        pairs.add(pair)
    assert len(pairs) > 3


def test_arrays_are_the_same_events(cache: Cache, tmp_path: Path) -> None:
    process = run("export", str(cache.folder), "--to", str(tmp_path / "e.npz"), "--as", "events", "--ids", "0..20", cwd=tmp_path)
    assert process.returncode == 0, process.stderr
    table = rows(cache, "--ids", "0..20")
    with np.load(tmp_path / "e.npz") as archive:
        for kind in ("birth", "death", "state", "footfall", "emit", "contact"):
            mine = [row for row in table if row["kind"] == kind]
            assert archive[f"{kind}.id"].tolist() == [int(row["id"]) for row in mine]
            assert archive[f"{kind}.frame"].tolist() == [int(row["frame"]) for row in mine]
            assert np.allclose(archive[f"{kind}.P"], [[float(row[axis]) for axis in "xyz"] for row in mine] or np.zeros((0, 3)))
        assert archive["death.id"].max() <= 20


def test_a_run_that_goes_on_has_the_same_events_and_all_backends_do(cache: Cache) -> None:
    folder = cache.folder.parent
    ran(folder, "again", "--backend", "numpy", "--frames", "3..14")
    (folder / "scene.yaml").write_text(SCENE)
    ran(folder, "again", "--backend", "numpy", "--resume")
    other = ran(folder, "reference", "--backend", "reference", "--frames", "3..9")
    for each in (open_cache(folder / "again"), other):
        for frame in each.frames():
            mine, theirs = cache.frame(frame), each.frame(frame)
            assert set(mine) == set(theirs)
            for name in mine:
                assert np.array_equal(mine[name], theirs[name], equal_nan=mine[name].dtype.kind == "f"), (frame, name)


def test_unknown_event_kinds_are_reported_at_their_place(cache: Cache) -> None:
    folder = cache.folder.parent
    (folder / "wrong.yaml").write_text(SCENE.replace("[contact, emit]", "[contact, emits]"))
    process = run("check", "wrong.yaml", cwd=folder)
    assert process.returncode == 1 and "emits" in process.stdout + process.stderr and "`emit`" in process.stdout + process.stderr
    assert json.loads((cache.folder / "manifest.json").read_text())["events"] == ["bang", "farewell"]
