"""The motion gate: measures the motion in examples and on torture shapes, and compares it with `tests/motion_bounds.txt`.

`python tests/motion_gate.py` runs all rows of the table. `python tests/motion_gate.py battle torture/cube` runs the rows with
names that begin so. It prints the measures of each row, and exits with 1 if one is above its bound by more than chance
explains. A name may also be the path of a scene, which has no bounds. `--record` writes the bounds that have become lower; a
bound is raised only by hand, with a reason. `--cache DIR` measures a cache of the scene of a row instead. `--save DIR` leaves
the caches in a folder. The measures are described in `tests/motion_track.py`."""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from pathlib import Path

import trimesh
from motion_track import MEASURES, MotionRow, measure_cache
from torture_walks import shapes

from antdsl.outputs.recording import begin_recording, record_frames
from antdsl.pipeline import RunChoices, Shot, open_scene
from antdsl.runtime import Options
from antdsl.runtime.moving.contacts.capsules import find_capsule
from antdsl.scene.values import FrameRange

ROOT = Path(__file__).resolve().parent.parent
BOUNDS = ROOT / "tests" / "motion_bounds.txt"
TORTURE = "torture/"
SHAPES = shapes().SHAPES
SHAPE_AGENTS = 100
MAX_SCENE_FRAMES = 240  # of a scene that is not in the table
# Crowds are chaotic: any other bit gives other paths of the same kind. Measures of such runs differ by up to so much.
CHANCE_SHARE = 0.1
CHANCE = MotionRow(
    overlap=2.0, inside=0.5, inside_frames=24, lag=0.5, turn=0.5, turn_max=0.3, step=4.0, zigzag=4.0, zigzags=0.04, spin=2.5,
    stops=3.0, standing=1.5, backward=1.0, slide=0.1,
)  # fmt: skip
NO_BOUNDS = MotionRow(*[math.inf] * len(MEASURES))
CRAWLER = """ant 1
use steering

world { surface shape }

species crawler {
  size      4 mm
  max_speed 30 mm/s
  response  0.2 s
  max_turn  360 deg/s
  start roam
  state roam { steer wander(swing: 50 deg) }
  layers { separate(radius: 1.2 * size) * 0.5; state }
}
"""
SHAPE_SCENE = f"""antdsl: 1
units: mm
up: y
fps: 24
seed: 3
contacts: hard
frames: 1..240
world:
  shape: {{mesh: shape.ply}}
crowd:
  - {{species: crawler, from: crawler.ant, count: {SHAPE_AGENTS}, place: {{on: shape, by: area}}}}
"""


@dataclass(frozen=True)
class Bound:
    """A row of the table: a scene below `examples` or a torture shape, the number of its frames, and its bounds."""

    name: str
    frames: int
    bounds: MotionRow


def read_bounds(path: Path = BOUNDS) -> tuple[Bound, ...]:
    """Return the rows of the table. Raises ValueError if its columns are not the measures."""
    lines = [line.split() for line in path.read_text("utf-8").splitlines() if line.strip() and not line.startswith("#")]
    if lines[0] != ["row", "frames", *MEASURES]:
        raise ValueError(f"the columns of {path} are not row, frames, {', '.join(MEASURES)}")
    return tuple(Bound(name, int(frames), MotionRow(*map(float, values))) for name, frames, *values in lines[1:])


def write_bounds(rows: Sequence[Bound], path: Path = BOUNDS) -> None:
    """Write the table, after the comments that it has."""
    comments = [line for line in path.read_text("utf-8").splitlines() if line.startswith("#")]
    table = [("row", "frames", *MEASURES), *((row.name, str(row.frames), *map(_number, astuple(row.bounds))) for row in rows)]
    width = max(len(row[0]) for row in table)
    lines = [
        " ".join(
            [
                row[0].ljust(width),
                *(word.rjust(max(8, len(MEASURES[k - 1]))) if k else word.rjust(6) for k, word in enumerate(row[1:])),
            ]
        )
        for row in table
    ]
    path.write_text("\n".join([*comments, *lines]) + "\n", encoding="utf-8")


def _number(value: float) -> str:
    return "inf" if math.isinf(value) else f"{value:.10g}"


def round_up(value: float) -> float:
    """Return the least number of three significant digits that is not below a measure."""
    if value <= 0 or not math.isfinite(value):
        return max(value, 0.0)
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return round(math.ceil(value / unit * (1 - 1e-12)) * unit, 12)


def open_row(row: Bound, folder: Path) -> Shot:
    """Return the shot of a row with a checkpoint at every frame. Files of a torture shape are written into the folder."""
    if row.name.startswith(TORTURE) and (shape := row.name.removeprefix(TORTURE)) in SHAPES:
        vertices, faces = SHAPES[shape]()
        trimesh.Trimesh(vertices, faces, process=False).export(folder / "shape.ply", vertex_normal=False)
        scene = folder / "scene.yaml"
        for name, text in (("crawler.ant", CRAWLER), (scene.name, SHAPE_SCENE)):
            (folder / name).write_text(text, encoding="utf-8")
    else:
        scene = Path(row.name) if row.name.endswith(".yaml") else ROOT / "examples" / f"{row.name}.yaml"
    shot, report = open_scene(scene)
    if shot is None:
        sys.exit(str(report))
    first = shot.frames.first
    shot, report = open_scene(scene, RunChoices(frames=FrameRange(first, min(shot.frames.last, first + row.frames - 1))))
    assert shot is not None, report
    output = shot.scene.model.output.model_copy(update={"checkpoint": 1})
    return replace(shot, scene=shot.scene.replace_values(output=output))


def measure_row(row: Bound, cache: Path | None = None, saved: Path | None = None) -> MotionRow:
    """Return the measures of a row, from a new cache or from the one given. `saved`: the folder for a new cache."""
    with tempfile.TemporaryDirectory() as folder:
        shot = open_row(row, Path(folder))
        recording = begin_recording(shot, saved or Path(folder) / "cache", Options(threads=1), resume=False, force=True)
        capsules = {name: find_capsule(recording.world, name) for name in recording.world.populations}
        if cache is None:
            for _ in record_frames(recording):
                pass
        return measure_cache(cache or recording.folder, capsules)


def broken_bounds(row: Bound, measured: MotionRow) -> Iterator[str]:
    """Yield a message for each measure of a row above its bound, by more than chance explains."""
    columns = zip(MEASURES, astuple(measured), astuple(row.bounds), astuple(CHANCE), strict=True)
    for name, value, bound, chance in columns:
        if value > bound * (1 + CHANCE_SHARE) + chance:
            yield f"{row.name}: {name} is {value:.4g}, above its bound of {bound:.4g}"


def lower_bounds(row: Bound, measured: MotionRow) -> Bound:
    """Return a row with the bounds that the measures allow."""
    pairs = zip(astuple(row.bounds), astuple(measured), strict=True)
    return replace(row, bounds=MotionRow(*(min(bound, round_up(value)) for bound, value in pairs)))


def print_row(name: str, values: Mapping[str, float]) -> None:
    words = [f"{value:{max(6, len(measure))}.2f}" for measure, value in values.items()]
    print(f"{name:26}", *words, flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--record", action="store_true")
    parser.add_argument("--cache", type=Path)
    parser.add_argument("--save", type=Path)
    options = parser.parse_args()
    rows = list(read_bounds())
    scenes = [Bound(name, MAX_SCENE_FRAMES, NO_BOUNDS) for name in options.names if name.endswith(".yaml")]
    chosen = [row for row in rows if not options.names or row.name.startswith(tuple(options.names))] + scenes
    if options.cache is not None and len(chosen) != 1:
        parser.error("--cache needs one row")
    messages: list[str] = []
    print(f"{'row':26}", *(name.rjust(6) for name in MEASURES))
    for row in chosen:
        saved = options.save / row.name.lstrip("/") if options.save is not None else None
        measured = measure_row(row, options.cache, saved)
        print_row(row.name, dict(zip(MEASURES, astuple(measured), strict=True)))
        messages += broken_bounds(row, measured)
        if options.record and row in rows:
            rows[rows.index(row)] = lower_bounds(row, measured)
            write_bounds(rows)
    print(*messages, sep="\n")
    return 1 if messages else 0


if __name__ == "__main__":
    sys.exit(main())
