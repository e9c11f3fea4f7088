"""A set of another department, twice: as USD in centimetres, Z-up, with nested and moving transforms, instances and references;
and baked by hand to OBJ in millimetres, Y-up. `python tests/usd_sets.py FOLDER` writes both.

The baked one goes no way through USD: its places are computed here with plain sums."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import meshes
import numpy as np

FRAMES = range(1, 41)
STONES = [  # in the set's own cm: x, y, turn about z in degrees, scale
    (-9.0, -6.0, 20.0, 1.0), (7.5, -8.0, 75.0, 0.8), (-4.0, 9.0, 140.0, 1.2), (10.0, 6.0, 10.0, 0.9), (1.5, -12.0, 200.0, 0.7),
]  # fmt: skip
SHIFT, TURN = np.array([2.0, -1.5, 0.5]), 15.0  # of the whole set, cm and degrees about z
CONTROL = np.array([(-14, -3, 2), (-8, 5, 2), (-4, -6, 2), (0, 1, 2), (4, 8, 2), (9, -4, 2), (14, 2, 2)], np.float32)  # cm
FOOD = np.array([(-12, 3, 1), (13, -3, 1)], np.float32)

PROGRAM = """ant 1
use steering
world {
  surface ground
  obstacle stones
  obstacle roller
  curve way
  items food { load = 0 }
}
species walker {
  size 5 mm
  max_speed 40 mm/s
  response 0.1 s
  start stroll
  state stroll amber { steer wander(); when nearest(food, within: 30 mm) -> eat }
  state eat green { steer arrive(nearest(food)); when after 1 s -> stroll }
  layers {
    avoid(stones, feelers: 3, spread: 35 deg, reach: 2 * size)
    avoid(roller, feelers: 3, spread: 35 deg, reach: 2 * size)
    separate(radius: size)
    follow(way, within: 15 mm)
    state
  }
}
"""
HEAD = "antdsl: 1\nunits: mm\nup: y\nfps: 24\nframes: 1..40\nseed: 3\nworld:\n"
CROWD = "crowd:\n  - {species: walker, from: walker.ant, count: 60, place: {on: ground}}\n"
FROM_USD = (
    HEAD
    + """  ground: {usd: assets:set/set.usda, prim: /set/land/ground}
  stones: {usd: assets:set/set.usda, prim: /set/stones}
  roller: {usd: assets:set/set.usda, prim: /set/path/roller}
  way: {usd: assets:set/set.usda, prim: /set/way}
  food: {usd: assets:set/set.usda, prim: /set/food, each: {load: 5}}
"""
    + CROWD
    + "camera: {usd: assets:set/set.usda, prim: /shot/camera}\n"
)


def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Of the ground over the set's plane, all in cm."""
    return 0.8 * np.sin(x / 3.7) * np.cos(y / 4.1)


def ground() -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) in cm with z up, and quads (m, 4) seen from above."""
    line = np.linspace(-20, 20, 41)
    x, y = (a.ravel() for a in np.meshgrid(line, line, indexing="ij"))
    i, j = (a.ravel() for a in np.meshgrid(np.arange(40), np.arange(40), indexing="ij"))
    a = i * 41 + j
    return np.stack([x, y, height(x, y)], axis=1).astype(np.float32), np.stack([a, a + 41, a + 42, a + 1], axis=1)


def stone() -> tuple[np.ndarray, np.ndarray]:
    """A knobbly ball about the origin, 2 cm in radius, in its own y-up space."""
    points, faces = meshes.ball(2.0, rings=10)
    points = points * (1 + 0.12 * np.sin(3 * points[:, :1]) * np.cos(2 * points[:, 2:]))
    return points.astype(np.float32), faces


def roller(frame: float) -> tuple[np.ndarray, float]:
    """Where the rolling ball is in the set (cm), and how far it has turned about y (degrees)."""
    share = (frame - 1) / 39
    return np.array([-10.0 + 16.0 * share, 2.5, 1.0]), 200.0 * share


def rotation_about(axis: int, degrees: float) -> np.ndarray:
    """A turn as a matrix (3, 3) for columns."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    b, d = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[b, b], matrix[b, d], matrix[d, b], matrix[d, d] = c, -s, s, c
    return matrix


UPRIGHT = rotation_about(0, 90.0)  # y up to z up


def baked(points: np.ndarray) -> np.ndarray:
    """Points of the set, cm and z up in the set's own space, in mm and y up in the world."""
    world = points.astype(np.float64) @ rotation_about(2, TURN).T + SHIFT
    return np.stack([world[:, 0], world[:, 2], -world[:, 1]], axis=1) * 10


def stone_places() -> list[tuple[np.ndarray, np.ndarray, float]]:
    """For each stone its turn (3, 3) from its own y-up space, its place in the set and its size; sunk to the middle."""
    placements = []
    for x, y, turn, scale in STONES:
        at = np.array([x, y, float(height(np.array(x), np.array(y)))], np.float32).astype(np.float64)
        placements.append((rotation_about(2, turn) @ UPRIGHT, at, float(np.float32(scale))))
    return placements


def write_obj(path: Path, points: np.ndarray, faces: np.ndarray) -> None:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
    lines += ["f " + " ".join(str(corner + 1) for corner in face) for face in faces.tolist()]
    path.write_text("\n".join(lines) + "\n")


def bake(folder: Path) -> Path:
    """The set by hand; gives its scene."""
    folder.mkdir(parents=True, exist_ok=True)
    points, quads = ground()
    write_obj(folder / "ground.obj", baked(points), quads)
    points, faces = stone()
    point_sets = [baked((points.astype(np.float64) * scale) @ turn.T + at) for turn, at, scale in stone_places()]
    write_obj(
        folder / "stones.obj",
        np.concatenate(point_sets),
        np.concatenate([faces + k * len(points) for k in range(len(point_sets))]),
    )
    for frame in FRAMES:
        at, turn = roller(frame)
        write_obj(
            folder / f"roller.{frame:04d}.obj",
            baked(points.astype(np.float64) @ (rotation_about(1, turn) @ UPRIGHT).T * 0.75 + at),
            faces,
        )
    (folder / "way.json").write_text(json.dumps(baked(bezier(CONTROL.astype(np.float64))).tolist()))
    food = [
        f"    food_{k}: {{at: [{x!r}, {y!r}, {z!r}], radius: 6, load: {load}}}"
        for k, ((x, y, z), load) in enumerate(zip(baked(FOOD).tolist(), (3, 4), strict=True))
    ]
    scene = HEAD + "  ground: {mesh: ground.obj}\n  stones: {mesh: stones.obj}\n  roller: {mesh: roller.####.obj}\n"
    (folder / "scene.yaml").write_text(scene + "  way: {curve: way.json}\n  food:\n" + "\n".join(food) + "\n" + CROWD)
    (folder / "walker.ant").write_text(PROGRAM)
    return folder / "scene.yaml"


def bezier(control: np.ndarray) -> np.ndarray:
    """Sixteen points a piece, by de Casteljau's halving of straight lines."""
    curve_points = []
    for start in range(0, len(control) - 1, 3):
        for t in np.arange(16) / 16:
            line = control[start : start + 4]
            while len(line) > 1:
                line = line[:-1] * (1 - t) + line[1:] * t
            curve_points.append(line[0])
    return np.array([*curve_points, control[-1]])


def write_usd(root: Path, scene_folder: Path) -> Path:
    """The set as USD below `root`, and the scene that reads it through `--root assets=ROOT`."""
    from pxr import Gf, Sdf, Usd, UsdGeom, Vt

    (root / "set" / "parts").mkdir(parents=True, exist_ok=True)
    part = Usd.Stage.CreateNew(str(root / "set" / "parts" / "stone.usdc"))
    shape = UsdGeom.Xform.Define(part, "/stone")
    points, faces = stone()
    mesh = UsdGeom.Mesh.Define(part, "/stone/shape")
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    mesh.CreateFaceVertexCountsAttr([3] * len(faces))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.ravel().astype(np.int32)))
    mesh.CreateSubdivisionSchemeAttr("catmullClark")
    part.SetDefaultPrim(shape.GetPrim())
    part.Save()

    stage = Usd.Stage.CreateNew(str(root / "set" / "set.usda"))
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    UsdGeom.SetStageUpAxis(stage, "Z")
    stage.SetTimeCodesPerSecond(24)
    set_prim = UsdGeom.Xform.Define(stage, "/set")
    set_prim.AddTranslateOp().Set(Gf.Vec3d(*SHIFT))
    set_prim.AddRotateZOp(UsdGeom.XformOp.PrecisionDouble).Set(TURN)
    # the ground is wound the other way and says so, and lies in a space that is moved and moved back
    land = UsdGeom.Xform.Define(stage, "/set/land")
    land.AddTranslateOp().Set(Gf.Vec3d(1, 2, 3))
    earth = UsdGeom.Mesh.Define(stage, "/set/land/ground")
    earth.AddTranslateOp().Set(Gf.Vec3d(-1, -2, -3))
    points, quads = ground()
    earth.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    earth.CreateFaceVertexCountsAttr([4] * len(quads))
    # the first corner stays the first, so that both are cut along the same diagonal
    turned = np.concatenate([quads[:, :1], quads[:, :0:-1]], axis=1)
    earth.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(turned.ravel().astype(np.int32)))
    earth.CreateOrientationAttr("leftHanded")

    UsdGeom.Xform.Define(stage, "/set/stones")
    placements = stone_places()
    for k, (_, at, scale) in enumerate(placements[:2]):  # native instances
        one = UsdGeom.Xform.Define(stage, f"/set/stones/stone_{k}")
        one.AddTranslateOp().Set(Gf.Vec3d(*at))
        one.AddRotateZOp(UsdGeom.XformOp.PrecisionDouble).Set(STONES[k][2])
        one.AddRotateXOp(UsdGeom.XformOp.PrecisionDouble).Set(90.0)
        one.AddScaleOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Vec3d(scale))
        one.GetPrim().GetReferences().AddReference("./parts/stone.usdc")
        one.GetPrim().SetInstanceable(True)
    strewn = UsdGeom.PointInstancer.Define(stage, "/set/stones/strewn")
    model = stage.OverridePrim("/set/stones/strewn/models/stone")
    model.GetReferences().AddReference("./parts/stone.usdc")
    strewn.CreatePrototypesRel().SetTargets([model.GetPath()])
    strewn.CreateProtoIndicesAttr([0] * (len(placements) - 2) + [0])
    strewn.CreatePositionsAttr([*(Gf.Vec3f(*at) for _, at, _ in placements[2:]), Gf.Vec3f(0, 0, 50)])
    turns = [Gf.Rotation(Gf.Vec3d(1, 0, 0), 90) * Gf.Rotation(Gf.Vec3d(0, 0, 1), STONES[k][2]) for k in range(2, len(placements))]
    quats = [Gf.Quatf(turn.GetQuat()) for turn in turns]
    strewn.CreateOrientationsfAttr([*quats, Gf.Quatf(1)])
    strewn.CreateScalesAttr([*(Gf.Vec3f(scale) for _, _, scale in placements[2:]), Gf.Vec3f(1)])
    strewn.CreateIdsAttr([*range(len(placements) - 2), 99])
    strewn.CreateInvisibleIdsAttr([99])
    hidden = UsdGeom.Mesh.Define(stage, "/set/stones/hidden")
    UsdGeom.Imageable(hidden).MakeInvisible()
    guide = UsdGeom.Mesh.Define(stage, "/set/stones/guide")
    guide.CreatePurposeAttr("guide")
    for extra in (hidden, guide):
        extra.CreatePointsAttr([Gf.Vec3f(0, 0, 0), Gf.Vec3f(9, 0, 9), Gf.Vec3f(0, 9, 9)])
        extra.CreateFaceVertexCountsAttr([3])
        extra.CreateFaceVertexIndicesAttr([0, 1, 2])

    path = UsdGeom.Xform.Define(stage, "/set/path")
    ball = UsdGeom.Xform.Define(stage, "/set/path/roller")
    move, spin = path.AddTranslateOp(), ball.AddRotateYOp(UsdGeom.XformOp.PrecisionDouble)
    ball.AddRotateXOp(UsdGeom.XformOp.PrecisionDouble).Set(90.0)
    ball.AddScaleOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Vec3d(0.75))
    for frame in (FRAMES[0], FRAMES[-1]):  # what lies between is interpolated
        at, turn = roller(frame)
        move.Set(Gf.Vec3d(*at), frame)
        spin.Set(turn, frame)
    ball.GetPrim().GetReferences().AddReference("./parts/stone.usdc")

    path_curve = UsdGeom.BasisCurves.Define(stage, "/set/way")
    path_curve.CreateTypeAttr("cubic")
    path_curve.CreateBasisAttr("bezier")
    path_curve.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(CONTROL))
    path_curve.CreateCurveVertexCountsAttr([len(CONTROL)])
    food = UsdGeom.Points.Define(stage, "/set/food")
    food.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(FOOD))
    food.CreateWidthsAttr([1.2, 1.2])
    UsdGeom.PrimvarsAPI(food).CreatePrimvar("load", Sdf.ValueTypeNames.FloatArray, "vertex").Set([3.0, 4.0])

    camera = UsdGeom.Camera.Define(stage, "/shot/camera")
    camera.CreateFocalLengthAttr(35.0)
    camera.CreateHorizontalApertureAttr(36.0)
    camera.CreateFocusDistanceAttr(30.0)
    camera.AddRotateXOp().Set(45.0)
    pan = camera.AddTranslateOp(opSuffix="pan")
    pan.Set(Gf.Vec3d(-5, 0, 40), FRAMES[0])
    pan.Set(Gf.Vec3d(5, 0, 40), FRAMES[-1])
    stage.Save()
    scene_folder.mkdir(parents=True, exist_ok=True)
    (scene_folder / "scene.yaml").write_text(FROM_USD)
    (scene_folder / "walker.ant").write_text(PROGRAM)
    return scene_folder / "scene.yaml"


def main() -> None:
    folder = Path(sys.argv[1])
    scene = write_usd(folder / "assets", folder / "usd")
    print(f"antdsl run {scene} --root assets={folder / 'assets'}")
    print(f"antdsl run {bake(folder / 'baked')}")


if __name__ == "__main__":
    main()
