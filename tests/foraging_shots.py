"""The foraging example as worlds for tests: opened once, then changed in crowd, rate or parameters; and runs that are watched."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.rays import RayScene
from antdsl.pipeline import RunChoices, Shot, open_scene
from antdsl.runtime import Options, World, bind, step
from antdsl.scene.setting import WorldSetting

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "foraging"
STATES = ("search", "turn_home", "approach", "carry", "set_out", "follow_trail")
APPLE = (120.0, 0.0, 90.0)


@cache
def shot(scene: Path = EXAMPLE / "scene.yaml") -> Shot:
    """A scene, ready to be bound."""
    opened, report = open_scene(scene, RunChoices())
    assert opened is not None and report.ok, [d.message for d in report.sort_by_place()]
    return opened


def setting(
    count: int | None = None,
    around: tuple[float, float, float] | None = None,
    radius: float | None = None,
    fps: int = 24,
    substeps: int = 1,
    load: float | None = None,
    scene: Path = EXAMPLE / "scene.yaml",
    **params: float,
) -> WorldSetting:
    """The example's setting with another crowd, rate, load of all food or parameters (base units)."""
    base_setting = shot(scene).setting
    crowd = base_setting.crowds[0]
    place = dataclasses.replace(crowd.place, disc_centre=around or crowd.place.disc_centre, radius=radius or crowd.place.radius)
    crowd = dataclasses.replace(crowd, count=crowd.count if count is None else count, place=place)
    items = dict(base_setting.items)
    if load is not None:
        items["food"] = tuple(dataclasses.replace(item, attributes={**item.attributes, "load": load}) for item in items["food"])
    values = {**base_setting.params, **{f"forager.{name}": value for name, value in params.items()}}
    return dataclasses.replace(
        base_setting, crowds=(crowd, *base_setting.crowds[1:]), fps=Fraction(fps), substeps=substeps, items=items, params=values
    )


def world(options: Options | None = None, scene: Path = EXAMPLE / "scene.yaml", **changes: Any) -> World:
    """The example's world at its first frame."""
    return bind(shot(scene).plan, setting(scene=scene, **changes), options)


def crumbs(world: World) -> tuple[float, float, float]:
    """Left in the sources, under way, in the nest."""
    carried = float(world.populations["forager"].now["load"].astype(np.float64).sum())
    return float(world.items["food"].amounts["load"].sum()), carried, float(world.items["nest"].amounts["load"].sum())


def counts(world: World) -> NDArray[np.int64]:
    """How many are in each of STATES."""
    foragers = world.populations["forager"]
    assert foragers.plan.machines[0].states == STATES
    return np.bincount(foragers.now["main.state"], minlength=len(STATES))


def concentration(world: World) -> float:
    """Share of all scent that lies in the strongest 5 % of the cells. Of those cells, that is, on which anybody has walked."""
    held = np.sort(world.fields["trail"].amounts)[::-1]
    walked = int(np.count_nonzero(held))
    return float(held[: max(1, walked // 20)].sum() / held.sum())


@dataclass(slots=True)
class Watched:
    """What was seen of a run, a value a frame."""

    world: World
    crumbs: list[tuple[float, float, float]] = field(default_factory=list)
    surface_error: float = 0.0  # in body lengths
    in_stones: float = 0.0  # mm that an agent's centre was inside a stone
    concentration: list[float] = field(default_factory=list)

    @property
    def delivered(self) -> list[float]:
        return [nest for _, _, nest in self.crumbs]


def watch(world: World, frames: int, every: int = 24) -> Watched:
    """Run, and look at crumbs and surface at every frame, at scent and stones at every so many. Motion counts from the third
    second on: agents did not choose their first positions."""
    record = Watched(world)
    mesh = world.setting.obstacles["stones"]
    stones = RayScene(mesh.vertices, mesh.faces)
    for frame in range(frames + 1):
        if frame:
            step(world)
        if frame == 48:
            world.motion.reset_step_measures()
        record.crumbs.append(crumbs(world))
        record.surface_error = max(record.surface_error, surface_error(world))
        if frame and frame % every == 0:
            record.concentration.append(concentration(world))
            gap, _ = stones.measure_signed_distances(*world.populations["forager"].position.T, max_distance=np.inf)
            record.in_stones = max(record.in_stones, float(-gap.min()))
    return record


def surface_error(world: World) -> float:
    """How far the farthest agent, as in the file, is off the triangle that it stands on, in body lengths."""
    foragers = world.populations["forager"]
    away = foragers.position.astype(np.float32) - world.ground.position(foragers.footing)
    return float((np.linalg.norm(away, axis=1) / foragers.now["size"]).max())


def motion(world: World, **bounds: float) -> None:
    """Assert that each measure of motion is at most its bound; `straightness` at least."""
    summary = world.motion.summarise()
    for name, bound in bounds.items():
        good = summary[name] >= bound if name == "straightness" else summary[name] <= bound
        assert good, (name, summary[name], bound)


def by_id(world: World, names: Sequence[str] | None = None, species: str = "forager") -> dict[str, NDArray[Any]]:
    """Registers of a species in the order of ids, for comparing bit for bit; those that belong to one step only are left out."""
    population = world.populations[species]
    order = population.get_rows_by_id()
    column_names = names or [name for name, register in population.plan.registers.items() if register.role != "temp"]
    columns = {name: population.now[name][order].copy() for name in column_names}
    return columns | {"ids": population.ids[order], "exact position": population.position[order]}
