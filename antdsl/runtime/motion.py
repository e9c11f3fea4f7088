"""Does it look alive? Measures of motion over a run (decision 31): numbers that are right and ants that twitch are a failure.

Nothing here acts on the agents, and nothing is part of the state.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime import vectors as vec
from antdsl.runtime.senses.neighbours import CellGrid

if TYPE_CHECKING:
    from antdsl.runtime.world import Population, World

_BINS = 1800  # of turns, 0.1 degree each; of overlaps, 1/1800 each
_WINDOW = 2.0  # s over which a way is called straight or circling
_CIRCLING = 0.15  # net way of a whole window at most this share of the way walked
_MOVED = 3.0  # body lengths walked in a window, to have a way at all
_WISH = 0.2  # a push that is meant
_STILL = 0.03  # of max_speed: standing
_COUNTS = ("turns", "overlaps", "standing", "wishing", "ways", "circling", "straightness", "steps")
_WAYS = ("ids", "start", "path", "age")


@dataclass(slots=True, eq=False)
class Window:
    """Ways of one species since the window began, by id."""

    ids: NDArray[np.int64]
    start: NDArray[np.float64]
    path: NDArray[np.float64]
    age: NDArray[np.int64]


@dataclass(slots=True, eq=False)
class Motion:
    """Counts so far."""

    turns: NDArray[np.int64] = field(default_factory=lambda: np.zeros(_BINS + 1, np.int64))
    overlaps: NDArray[np.int64] = field(default_factory=lambda: np.zeros(_BINS + 1, np.int64))
    standing: int = 0
    wishing: int = 0
    ways: int = 0
    circling: int = 0
    straightness: float = 0.0
    steps: int = 0
    windows: dict[str, Window] = field(default_factory=dict)

    def reset(self) -> None:
        """Begin anew, say after a preroll."""
        fresh = Motion()
        for name in (*_COUNTS, "windows"):
            setattr(self, name, getattr(fresh, name))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All counts by name, for a checkpoint."""
        found = {name: np.array(getattr(self, name)) for name in _COUNTS}
        for species, window in self.windows.items():
            found |= {f"window.{species}.{name}": np.array(getattr(window, name)) for name in _WAYS}
        return found

    @classmethod
    def of(cls, arrays: dict[str, NDArray[Any]]) -> Motion:
        """From the arrays of a checkpoint; what is missing begins anew."""
        motion = cls()
        for name in _COUNTS:
            if name in arrays:
                value = arrays[name]
                setattr(motion, name, value.copy() if value.ndim else value.item())
        for species in sorted({name.split(".", 1)[1].rsplit(".", 1)[0] for name in arrays if name.startswith("window.")}):
            motion.windows[species] = Window(*(arrays[f"window.{species}.{name}"].copy() for name in _WAYS))
        return motion

    def observe(self, world: World) -> None:
        """Count one step; called after the move, before it is committed."""
        second = max(1, round(1.0 / world.dt))
        for population in world.populations.values():
            if len(population):
                self._step(world, population)
                if self.steps % second == 0:
                    self._overlap(population)
        self.steps += 1

    def _step(self, world: World, population: Population) -> None:
        now, start = population.now, population.start
        chord = vec.length(tuple(now[f"heading.{a}"] - start[f"heading.{a}"] for a in "xyz"))  # type: ignore[arg-type]
        angle = np.degrees(2 * np.arcsin(np.minimum(chord * np.float32(0.5), 1)))
        self.turns += np.bincount((angle * np.float32(_BINS / 180)).astype(np.int64), minlength=_BINS + 1)[: _BINS + 1]
        speed = vec.length(tuple(now[f"velocity.{a}"] for a in "xyz"))  # type: ignore[arg-type]
        wish = vec.length(tuple(now[f"push.{a}"] for a in "xyz")) > _WISH  # type: ignore[arg-type]
        self.wishing += len(population)
        self.standing += int(np.count_nonzero(wish & (speed < now["max_speed"] * np.float32(_STILL))))
        window = self._window(population)
        window.path += speed * world.dt
        window.age += 1
        done = np.flatnonzero(window.age >= max(1, round(_WINDOW / world.dt)))
        if len(done):
            net = np.sqrt(((population.position[done] - window.start[done]) ** 2).sum(axis=1))
            path = window.path[done]
            walked = path > _MOVED * now["size"][done]
            share = np.minimum(net[walked] / path[walked], 1.0)
            self.ways += len(share)
            self.circling += int(np.count_nonzero(share < _CIRCLING))
            self.straightness += float(share.sum())
            window.start[done], window.path[done], window.age[done] = population.position[done], 0.0, 0

    def _window(self, population: Population) -> Window:
        """The window of a species, its rows brought into those of the agents."""
        known = self.windows.get(population.name)
        ids = population.ids
        if known is not None and (known.ids is ids or np.array_equal(known.ids, ids)):
            return known
        n = len(ids)
        fresh = Window(ids, population.position.copy(), np.zeros(n), np.zeros(n, np.int64))
        if known is not None and len(known.ids):
            order = np.argsort(known.ids)
            at = order[np.minimum(np.searchsorted(known.ids, ids, sorter=order), len(order) - 1)]
            same = known.ids[at] == ids
            for name in ("start", "path", "age"):
                getattr(fresh, name)[same] = getattr(known, name)[at[same]]
        self.windows[population.name] = fresh
        return fresh

    def _overlap(self, population: Population) -> None:
        """How far agents stand inside each other: 0 apart, 1 in one place; the worst neighbour of each counts."""
        radius = population.now["radius"]
        widest = float(radius.max(initial=0.0))
        if not np.isfinite(widest) or widest <= 0:
            return
        x, y, z = (population.now[f"position.{a}"] for a in "xyz")
        found = CellGrid(x, y, z, population.ids, 2 * widest).pairs(None, 2 * widest)
        room = np.maximum(radius[found.i] + radius[found.j], np.float32(1e-9))
        worst = np.zeros(len(population), np.float32)
        np.maximum.at(worst, found.i, np.clip(1 - found.distance / room, 0, 1))
        self.overlaps += np.bincount((worst * _BINS).astype(np.int64), minlength=_BINS + 1)

    def summary(self) -> dict[str, float]:
        """turn_p99 (degrees a step), circling, standing (shares), overlap_p99 (0 apart .. 1 in one place), straightness."""
        return {
            "turn_p99": _percentile(self.turns) * 180.0,
            "circling": self.circling / max(1, self.ways),
            "standing": self.standing / max(1, self.wishing),
            "overlap_p99": _percentile(self.overlaps),
            "straightness": self.straightness / max(1, self.ways),
        }


def _percentile(counts: NDArray[Any]) -> float:
    """The 99th percentile of a histogram over 0 .. 1."""
    total = int(counts.sum())
    return float(np.searchsorted(np.cumsum(counts), 0.99 * total)) / _BINS if total else 0.0
