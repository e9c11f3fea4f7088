"""What a step can be done again from: a run with checkpoints. A cache is one, a session under way has others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from antdsl.explain.opening import ExplainError
from antdsl.outputs.cache.cache_reader import Cache, CacheError
from antdsl.outputs.cache.cache_writer import read_checkpoint
from antdsl.pipeline import Shot
from antdsl.runtime import CheckpointError, Options, World, bind, restore, state_hash


class History(Protocol):
    """A run of one shot, kept so that it can be gone through again."""

    @property
    def shot(self) -> Shot: ...

    def points(self) -> Sequence[int]:
        """The frames that have a checkpoint, in order."""

    def world(self, point: int) -> World | None:
        """A world of its own as it was at a checkpoint; None where that is damaged."""

    def hash(self, frame: int) -> str | None:
        """The hash of the state at a frame, where it is known."""

    def before_step(self, world: World) -> None:
        """Do to a world what was done to the run from outside before the step that comes."""

    def missing(self, frame: int) -> ExplainError:
        """What to say where no good checkpoint leads up to a frame."""

    def differs(self, frame: int) -> ExplainError:
        """What to say where a frame comes out otherwise than it was."""


@dataclass(frozen=True, slots=True, eq=False)
class CacheHistory:
    """The run that a cache was written by; `shot` is what it was made from."""

    cache: Cache
    shot: Shot
    threads: int
    hashes: dict[int, str]

    @classmethod
    def of(cls, cache: Cache, shot: Shot, threads: int = 1) -> CacheHistory:
        return cls(cache, shot, threads, cache.hashes())

    def points(self) -> Sequence[int]:
        return self.cache.checkpoints()

    def world(self, point: int) -> World | None:
        try:
            arrays, _ = read_checkpoint(self.cache, point)
            world = bind(self.shot.plan, self.shot.setting, Options(threads=self.threads, on_fault="quarantine"))
            restore(world, arrays)
        except (CacheError, CheckpointError):
            return None
        return world if state_hash(world) == self.hash(point) else None

    def hash(self, frame: int) -> str | None:
        return self.hashes.get(frame)

    def before_step(self, world: World) -> None:
        """Nobody changes the run of a cache on its way."""

    def missing(self, frame: int) -> ExplainError:
        what = "no good checkpoint" if any(point <= frame for point in self.points()) else "no checkpoint"
        words = f"`{self.cache.folder}` has {what} up to frame {frame}"
        return ExplainError(words, "run the scene again: each run writes checkpoints")

    def differs(self, frame: int) -> ExplainError:
        return ExplainError(
            f"frame {frame} comes out otherwise than `{self.cache.folder}` has it",
            "it was written by another version, or by `antdsl test` with a spec's own settings: run the scene again",
        )
