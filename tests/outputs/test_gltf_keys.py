"""Keys of a glTF file: thinned and shared, with joints within the tolerance, as an independent reader decodes them."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from commands import run
from scipy.spatial.transform import Rotation, Slerp
from test_usd_crowds import recorded

from antdsl.outputs.cache.cache_reader import Cache
from antdsl.outputs.exports.gltf_export import GltfOptions, export_gltf
from antdsl.outputs.exports.gltf_keys import AgentRows
from antdsl.outputs.exports.poses_export import make_pose_arrays
from antdsl.outputs.gallery import Gallery
from tests.gltf_scene import Scene

FORAGING = Path(__file__).parents[2] / "examples" / "foraging"
AGENTS, FRAMES = 6, 60
JOINTS = ("root", "head", "gaster_tip", "club_l", "mandible_r", "tibia_l1", "tarsus_r1", "claw_l2", "claw_r3", "femur_l3")


@pytest.fixture(scope="module")
def ants(tmp_path_factory: pytest.TempPathFactory) -> Cache:
    """Ants on their feet around a source: some of them take a crumb."""
    folder = tmp_path_factory.mktemp("ants")
    for path in filter(Path.is_file, FORAGING.iterdir()):
        shutil.copy(path, folder / path.name)
    crowd = f"count: {AGENTS}, place: {{on: ground, around: apple, radius: 30 mm}}"
    text = (folder / "scene.yaml").read_text().replace("count: 500, place: {on: ground, around: home, radius: 70 mm}", crowd)
    assert crowd in text
    (folder / "scene.yaml").write_text(text)
    return recorded(folder, FRAMES)


def written(cache: Cache, path: Path, **options: float) -> Scene:
    export_gltf(Gallery(cache), cache.frames(), path, GltfOptions(**options))
    scene = Scene(path.read_bytes())
    scene.check()
    return scene


def measure_errors(cache: Cache, scene: Scene, frame: int) -> np.ndarray:
    """Distances of ten joints of each agent from their poses, in body lengths."""
    nodes, world = scene.tree["nodes"], scene.at((frame - 1) / 24)[0]
    errors = []
    for crowd in Gallery(cache).make_picture(frame).crowds:
        poses, rig = make_pose_arrays(crowd), crowd.body.definition.rig
        expected = poses["place"][:, None] @ poses["world"].astype(float)
        for row, one in enumerate(poses["id"].tolist()):
            joints, waiting = {}, [next(n for n, node in enumerate(nodes) if node.get("extras", {}).get("id") == one)]
            while waiting:
                number = waiting.pop()
                joints[nodes[number]["name"]] = number
                waiting += nodes[number].get("children", [])
            for name in JOINTS:
                offset = world[joints[name]][:3, 3] * 1000 - expected[row, rig.find_joint(name), :3, 3]
                errors.append(np.linalg.norm(offset) / crowd.scale[row])
    return np.array(errors)


@pytest.mark.parametrize("tolerance", [0.0, 0.0003, GltfOptions().tolerance, 0.02])
def test_joints_are_within_the_tolerance(ants: Cache, tmp_path: Path, tolerance: float) -> None:
    scene = written(ants, tmp_path / "ants.glb", tolerance=tolerance)
    errors = np.concatenate([measure_errors(ants, scene, frame) for frame in (1, 22, 39, FRAMES)])
    assert len(errors) == 4 * AGENTS * len(JOINTS)
    assert errors.max() <= max(tolerance, 1e-5)
    assert tolerance < 0.02 or errors.max() > 0.001, "the tolerance is used"
    assert scene.tree["extras"] == {"first_frame": 1, "last_frame": FRAMES, "fps": 24, "tolerance": tolerance}
    kinds = {scene.tree["accessors"][s["output"]]["componentType"] for s in scene.tree["animations"][0]["samplers"]}
    assert (5122 in kinds) == (tolerance > 0.001), "short rotations where the tolerance covers their rounding"


def test_nothing_is_written_twice(ants: Cache, tmp_path: Path) -> None:
    scene, exact = (written(ants, tmp_path / f"{each}.glb", tolerance=each) for each in (0.005, 0.0))
    tree = scene.tree
    contents = [
        (entry["type"], entry["componentType"], tree["bufferViews"][entry["bufferView"]].get("target"), scene.array(n).tobytes())
        for n, entry in enumerate(tree["accessors"])
    ]
    assert len(set(contents)) == len(contents)
    samplers = tree["animations"][0]["samplers"]
    outputs, times = {each["output"] for each in samplers}, {each["input"] for each in samplers}
    assert len(outputs) <= 36 * AGENTS and len(times) <= 16
    assert len(tree["skins"]) <= 2 * AGENTS and len({each["inverseBindMatrices"] for each in tree["skins"]}) <= 2
    size, exact_size = (
        sum(each.array(s[part]).size for s in each.tree["animations"][0]["samplers"] for part in ("input", "output"))
        for each in (scene, exact)
    )
    assert size < 0.4 * exact_size and len(outputs) < 0.35 * len(exact.tree["accessors"])


def test_agents_have_their_id_species_and_states(ants: Cache, tmp_path: Path) -> None:
    tree = written(ants, tmp_path / "ants.glb").tree
    agents = {node["extras"]["id"]: node for node in tree["nodes"] if "extras" in node}
    assert sorted(agents) == list(range(AGENTS)), "one node for each, whatever layers it wears"
    names = [state.name for state in ants.manifest.species[0].machines[0].states]
    changes = 0
    for frame in ants.frames():
        arrays = ants.frame(frame)
        for one, state in zip(arrays["id"].tolist(), arrays["state"].tolist(), strict=True):
            entries = [each for each in agents[one]["extras"]["states"] if each["frame"] <= frame]
            assert entries[-1]["state"] == names[state] and agents[one]["name"] == f"forager_{one}"
            assert agents[one]["extras"]["species"] == "forager"
            changes += entries[-1]["frame"] == frame > 1
    assert changes > 2


def test_a_load_is_there_in_the_frames_in_which_it_is_worn(ants: Cache, tmp_path: Path) -> None:
    scene = written(ants, tmp_path / "ants.glb")
    numbers = {node["name"]: n for n, node in enumerate(scene.tree["nodes"])}
    counts_by_worn = {True: 0, False: 0}
    for frame in range(1, FRAMES + 1, 9):
        worn = {one for crowd in Gallery(ants).make_picture(frame).crowds if crowd.body.layers for one in crowd.ids.tolist()}
        points = scene.at((frame - 1) / 24)[1]
        for one in range(AGENTS):
            assert np.ptp(points[numbers[f"forager_{one}_ant"]], axis=0).max() > 1e-3
            if f"forager_{one}_crumb" in numbers:
                assert (np.ptp(points[numbers[f"forager_{one}_crumb"]], axis=0).max() > 1e-4) == (one in worn)
                counts_by_worn[one in worn] += 1
            else:
                assert one not in worn
    assert min(counts_by_worn.values()) > 1


def test_keys_are_as_far_apart_as_the_tolerance_permits() -> None:
    counts = np.array([1, 2, 40, 65, 30, 50])
    starts = np.concatenate([[0], np.cumsum(counts)])
    frames = np.concatenate([np.cumsum(np.random.default_rng(k).integers(1, 4, n)) for k, n in enumerate(counts)])
    rows, tolerances = AgentRows(frames, starts), np.array([0.1, 0.01, 0.01, 0.05, 0.001, 0.2])
    angles = np.concatenate(
        [0.01 * k * np.sin(frames[s : s + n] / (4 * k + 3)) for k, (s, n) in enumerate(zip(starts[:-1], counts, strict=True))]
    )
    angles *= 40
    moves = np.stack([angles, np.cos(angles), 0 * angles], axis=1)
    turns = Rotation.from_rotvec(angles[:, None] * (0.6, 0, 0.8)).as_quat()
    steps = set()
    for values in (moves, turns):
        for agent, step in enumerate(rows.choose_steps(values, tolerances).tolist()):
            own, at = (each[starts[agent] : starts[agent + 1]] for each in (values, frames))
            assert (step == 0) == (measure_key_error(own, at, np.array([0])) <= tolerances[agent])
            if step:
                keys = rows.list_keys(agent, step) - starts[agent]
                assert keys[0] == 0 and keys[-1] == len(own) - 1
                assert measure_key_error(own, at, keys) <= tolerances[agent] + 1e-12
                coarser = rows.list_keys(agent, 2 * step) - starts[agent]
                assert len(coarser) == len(keys) or measure_key_error(own, at, coarser) > tolerances[agent]
            steps.add(step)
    assert {0, 1, 2, 4} <= steps


def measure_key_error(values: np.ndarray, times: np.ndarray, keys: np.ndarray) -> float:
    """The largest distance of values from those between some of them."""
    if len(keys) == 1:
        expected = np.broadcast_to(values[keys], values.shape)
    elif values.shape[1] == 4:
        expected = Slerp(times[keys], Rotation.from_quat(values[keys]))(times).as_quat()
    else:
        expected = np.stack([np.interp(times, times[keys], column) for column in values[keys].T], axis=1)
    if values.shape[1] == 4:
        expected = expected * np.where((expected * values).sum(axis=1, keepdims=True) < 0, -1, 1)
    return float(np.linalg.norm(expected - values, axis=1).max())


@pytest.mark.parametrize(
    ("to", "tolerance", "said"),
    [
        ("a.glb", "0.5", "write `0.5%`"),
        ("a.glb", "11%", "from 0% to 10%"),
        ("a.glb", "-1%", "write `0.5%`"),
        ("a.glb", "low", "write `0.5%`"),
        ("a.csv", "1%", "`.glb` as `skinned` does"),
    ],
)
def test_a_wrong_tolerance_says_what_to_write(tmp_path: Path, to: str, tolerance: str, said: str) -> None:
    result = run("export", ".", "--to", to, "--tolerance", tolerance, cwd=tmp_path)
    assert result.returncode == 2 and said in " ".join(result.stderr.split()), result.stderr
