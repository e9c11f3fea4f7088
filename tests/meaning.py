"""From a program to what its agents have become: run on both backends in several ways, all of which must agree to the bit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from plan_text import WORLD, plan_of

from antdsl.passes import optimise_plan
from antdsl.plan import ir
from antdsl.runtime import CrowdData, ItemData, Options, PlacementData, World, WorldSetting, bind, state_hash, step

OPTION_SETS = (
    Options(backend="numpy"),
    Options(chunk=7, threads=2, shuffle_rows=3, backend="numpy"),
    Options(backend="reference"),
    Options(backend="reference", shuffle_rows=1),
)
FAST = OPTION_SETS[:2]  # for many agents: the reference takes its time
Points = Sequence[tuple[float, float]]


def crowd(count: int = 1, species: str = "a", at: Points | None = None, radius: float = 0.0, group: int = 0) -> CrowdData:
    """Agents on the plane: at points (x, z), or in a disc about the origin."""
    if at is None:
        return CrowdData(species, count, PlacementData(disc_centre=(0.0, 0.0, 0.0), radius=radius), group)
    return CrowdData(species, len(at), PlacementData(points=np.array([(x, 0.0, z) for x, z in at])), group)


def item(name: str, x: float, z: float, radius: float = 1.0, **attributes: float) -> ItemData:
    return ItemData(name, (x, 0.0, z), radius, attributes)


class RunHistory:
    """What one run showed: `[name]` is a register of the species by id at the end, `at(…)` at a frame."""

    def __init__(self, species: str) -> None:
        self.species = species
        self.frames: list[dict[str, dict[str, np.ndarray]]] = []
        self.world: World

    def take(self, world: World) -> None:
        self.world = world
        frame = {}
        for name, population in world.populations.items():
            rows = population.get_rows_by_id()
            frame[name] = {register: array[rows].copy() for register, array in population.now.items()}
            frame[name]["id"] = population.ids[rows].copy()
        self.frames.append(frame)

    def at(self, name: str, frame: int, species: str | None = None) -> list[Any]:
        return self.frames[frame][species or self.species][name].tolist()

    def __getitem__(self, name: str) -> list[Any]:
        return self.at(name, -1)

    def every(self, name: str, number: int = 0) -> list[Any]:
        """A register of the agent with a row number (in order of ids), frame by frame."""
        return [frame[self.species][name].tolist()[number] for frame in self.frames]

    def states(self, number: int = 0, machine: str = "main") -> list[str]:
        names = next(m.states for m in self.world.plan.species[self.species].machines if m.name == machine)
        return [names[k] for k in self.every(f"{machine}.state", number)]

    def amounts(self, items: str, attribute: str = "load") -> list[float]:
        return self.world.items[items].amounts[attribute].tolist()


def played(
    plan: ir.Plan, setting: WorldSetting, steps: int, species: str = "a", option_sets: Sequence[Options] = OPTION_SETS,
    each: Callable[[World], None] | None = None,
) -> RunHistory:  # fmt: skip
    """Run a plan in several ways; the hashes of all frames must be the same. `each` looks at every frame of the first way."""
    history = RunHistory(species)
    first: list[str] = []
    for options in option_sets:
        world = bind(plan, setting, options)
        hashes = [state_hash(world)]
        if options is option_sets[0]:
            history.take(world)
        for _ in range(steps):
            step(world)
            hashes.append(state_hash(world))
            if options is option_sets[0]:
                history.take(world)
                if each is not None:
                    each(world)
        first = first or hashes
        differing = [k for k, (one, other) in enumerate(zip(first, hashes, strict=True)) if one != other]
        assert not differing, f"{options} differs at frame {differing[0]}"
    return history


def play(
    text: str, *crowds: CrowdData, steps: int = 1, world: str = WORLD, species: str = "a", fps: int = 10,
    option_sets: Sequence[Options] = OPTION_SETS, each: Callable[[World], None] | None = None,
    orders: Mapping[str, Sequence[str]] | None = None, **setting_arguments: Any,
) -> RunHistory:  # fmt: skip
    """Run a program on the endless plane, ten frames a second, by default with one agent of the species `a`."""
    plan = optimise_plan(plan_of(text, world, **({} if orders is None else {"orders": orders})))
    setting = WorldSetting(fps=Fraction(fps), crowds=crowds or (crowd(),), **setting_arguments)
    return played(plan, setting, steps, species, option_sets, each)
