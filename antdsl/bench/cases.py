"""CASES: what is measured, by name. Scenes are those of the examples, which ship, or written by `programs`."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from antdsl.bench import programs
from antdsl.diagnostics import Report
from antdsl.resources import example_file

if TYPE_CHECKING:
    from antdsl.pipeline import Shot

FRAMES = 100_000  # of a shot that is measured: more than anybody asks for
FEW = 2_000  # foraging ants up to which the small scene is taken


class NoCase(Exception):
    """A scene that cannot be opened, or not with so many agents; `report` has the findings, the message the rest."""

    def __init__(self, message: str, report: Report | None = None) -> None:
        super().__init__(message)
        self.report = report or Report()


@dataclass(frozen=True, slots=True)
class Case:
    """`make` gives the shot with so many agents (None: as many as it has). `agents`: the numbers of its table, none where it has
    one size; `quick`: those of the first look. `bare`: takes from the shot what bare steps do without. `bound`: the frame written
    by hand does the same work. `sight` (mm): within which neighbours are counted. `told`: what others have reported."""

    name: str
    about: str
    make: Callable[[int | None], Shot]
    agents: tuple[int, ...] = ()
    quick: tuple[int, ...] = ()
    bare: Callable[[Shot], Shot] = lambda shot: shot
    bound: bool = False
    sight: float = 0.0
    told: str = ""


def opened(path: Path, agents: int | None, *, frames: int = FRAMES) -> Shot:
    """A scene's shot, its world scaled for another number of agents. Raises NoCase."""
    from antdsl.bench.scaling import scaled
    from antdsl.pipeline import Choices, open_scene
    from antdsl.scene.values import parse_frames

    shot, report = open_scene(path, Choices(frames=parse_frames(f"1..{frames}")))
    if shot is None:
        raise NoCase(f"`{path}` cannot be opened", report)
    if agents is None or agents == sum(crowd.count for crowd in shot.setting.crowds):
        return shot
    try:
        return replace(shot, setting=scaled(shot.setting, agents))
    except ValueError as why:
        raise NoCase(f"`{path.name}` cannot have {agents:,} agents: {why}") from None


def _written(texts: Mapping[str, str]) -> Shot:
    """A shot of texts: `scene.yaml` and what it names."""
    with tempfile.TemporaryDirectory() as folder:
        for name, text in texts.items():
            Path(folder, name).write_text(text, encoding="utf-8")
        return opened(Path(folder, "scene.yaml"), None)


def _example(name: str) -> Callable[[int | None], Shot]:
    return lambda agents: opened(example_file(name), agents)


def _foraging(agents: int | None) -> Shot:
    small = agents is not None and agents <= FEW
    return opened(example_file("foraging/scene.yaml" if small else "foraging/many.yaml"), agents)


def _without_contacts(shot: Shot) -> Shot:
    """As the frame that is written by hand, which has none."""
    return replace(shot, setting=replace(shot.setting, contacts="off"))


def _boids(agents: int | None) -> Shot:
    count = agents or 15_000
    scene = programs.plane_scene("boid", count, programs.seen_radius(count))
    return _written({"scene.yaml": scene, "boid.ant": programs.BOIDS})


def _crowd(agents: int | None) -> Shot:
    count = agents or 15_000
    scene = programs.plane_scene("person", count, programs.seen_radius(count, programs.PERSON_SIGHT))
    return _written({"scene.yaml": scene, "person.ant": programs.CROWD})


def _trails(agents: int | None) -> Shot:
    texts = {"scene.yaml": programs.trails_scene(agents or 15_000), "ant.ant": programs.TRAILS}
    return _written({**texts, "ground.ply": programs.flat_ground(1_000.0)})


def _cluster(agents: int | None) -> Shot:
    from antdsl.bench.scaling import gathered

    shot = _boids(agents)
    return replace(shot, setting=gathered(shot.setting, 0.1))


def _node(agents: int | None) -> Shot:
    count = agents or 500
    return _written({"scene.yaml": programs.plane_scene("ant", count, 70.0 * (count / 500) ** 0.5), "ant.ant": programs.NODE})


def _valley(agents: int | None) -> Shot:
    return opened(_valley_file(agents), None)


def _valley_file(agents: int | None) -> Path:
    names = {None: "five_hundred", 500: "five_hundred", 15_000: "many"}
    if agents not in names:
        raise NoCase(f"the valley has 500 ants or 15,000, not {agents:,}")
    return example_file(f"thesis/{names[agents]}.yaml")


def _valley_of_meshes(agents: int | None) -> Shot:
    """The valley with its hill as a mesh that nobody digs."""
    folder = example_file("thesis/base.yaml").parent
    texts = {"scene.yaml": _valley_file(agents).read_text(encoding="utf-8")}
    texts["base.yaml"] = (folder / "base.yaml").read_text(encoding="utf-8")
    for name in ("scene.yaml", "base.yaml"):
        texts[name] = "".join(f"{line}\n" for line in _without_voxels(texts[name]))
    program = (folder / "ant.ant").read_text(encoding="utf-8")
    program = program[: program.index("\nspec ")].replace("  solid    hill", "  surface  hill")
    texts["ant.ant"] = "".join(f"{line}\n" for line in program.splitlines() if not line.lstrip().startswith("carve "))
    with tempfile.TemporaryDirectory() as place:
        for each in folder.iterdir():
            if each.suffix in (".ply", ".json"):
                Path(place, each.name).write_bytes(each.read_bytes())
        for name, text in texts.items():
            Path(place, name).write_text(text, encoding="utf-8")
        return opened(Path(place, "scene.yaml"), None)


def _without_voxels(text: str) -> list[str]:
    import re

    return [re.sub(r",\s*voxel: [^,}]*", "", line) for line in text.splitlines()]


_FORAGING = (125, 1_000, 15_000, 100_000, 1_000_000)
CASES: Mapping[str, Case] = {
    case.name: case
    for case in (
        Case(
            "foraging",
            "ants that search, carry and lay scent on hills",
            _foraging,
            _FORAGING,
            (1_000, 15_000),
            _without_contacts,
            bound=True,
        ),
        Case(
            "boids",
            "three rules on a plane, about 9 neighbours each",
            _boids,
            (1_000, 15_000, 100_000),
            (1_000, 15_000),
            sight=programs.SIGHT,
        ),
        Case("trails", "ants by two scents on flat ground, as on a grid", _trails, (1_000, 15_000, 100_000)),
        Case(
            "crowd",
            "people who walk round each other on a plane, about 9 neighbours each",
            _crowd,
            (1_000, 15_000, 100_000),
            sight=programs.PERSON_SIGHT,
        ),
        Case("cluster", "the boids, all within a tenth of the area", _cluster, (1_000, 15_000), sight=programs.SIGHT),
        Case("flocking", "boids on a wavy ground with states", _example("flocking/scene.yaml"), (400, 15_000), sight=25.0),
        Case("tunnel", "scouts dig through a hill, others follow", _example("tunnel/scene.yaml")),
        Case("moods", "roaches with several machines of states", _example("moods/scene.yaml"), (200, 15_000)),
        Case("anthill", "builders dig a nest out of a block", _example("anthill/scene.yaml")),
        Case(
            "node",
            "500 points that wander and keep apart: the work of one node",
            _node,
            (500,),
            told="Houdini: 58.8 frames a second in VEX, 3.98 in Python",
        ),
        Case(
            "valley",
            "the thesis' ants, the hill as a volume",
            _valley,
            (500, 15_000),
            told="the thesis: 9 frames a second with 500, 3 with 15,000",
        ),
        Case(
            "valley_of_meshes",
            "the same, the hill as a mesh that is not dug",
            _valley_of_meshes,
            (500, 15_000),
            told="the thesis: about 5 frames a second more without the volume",
        ),
    )
}


def case_of(name: str) -> Case:
    """A case by its name, or one for a scene's path."""
    return CASES.get(name) or Case(name, "a scene", lambda agents: opened(Path(name), agents))
