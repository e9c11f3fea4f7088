"""The request that defines a sweep, with its design and its variations.

The sweep's folder stores the request as JSON, so that the sweep can be resumed without repeating its options."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from antdsl import limits
from antdsl.atomic_write import write_atomically
from antdsl.safe_read import read_size_limited
from antdsl.sweeps.designs import DESIGNS, ChosenPoints
from antdsl.sweeps.factors import Factor
from antdsl.sweeps.jobs import SceneVariation
from antdsl.sweeps.sensitivity import FactorEffect, find_effects
from antdsl.sweeps.table import MeasureStatistics

REQUEST_FILE_NAME = "asked.json"


@dataclass(frozen=True, slots=True)
class SweepStudy:
    """A sweep to run: its points, its scenes and its variations. A variation combines a scene with the values of a point. All
    variations are different."""

    chosen_points: ChosenPoints
    scenes: tuple[Path, ...]
    variations: tuple[SceneVariation, ...]

    @property
    def range_factors(self) -> tuple[Factor, ...]:
        """Return the factors that have a range of values instead of single values."""
        return tuple(factor for factor in self.chosen_points.factors if not factor.levels)

    @property
    def unit_by_factor(self) -> dict[str, str]:
        """Return the units of the factors that have a range, by the names of these factors."""
        return {factor.name: factor.unit for factor in self.range_factors}

    def find_effects(self, table: Sequence[MeasureStatistics], measures: Sequence[str]) -> tuple[list[FactorEffect], list[str]]:
        """Return the effect of each factor on each measure, and a note for each measure for which the effects are unknown. Both
        results are empty if the design has no analysis."""
        design, shares = self.chosen_points.design, self.chosen_points.shares
        if design.analysis is None or shares is None:
            return [], []
        labels = {(v.scene, *v.params.values()): v.label for v in self.variations}
        scenes = {str(scene): [labels[(scene, *point.values())] for point in self.chosen_points.points] for scene in self.scenes}
        medians = {(row.label, row.measure): row.median for row in table}
        return find_effects(design.analysis, [f.name for f in self.chosen_points.factors], shares, scenes, medians, measures)


class NoStoredSweepError(Exception):
    """Error for a folder that contains no sweep to continue. The message gives the reason."""


class SweepRequest(BaseModel):
    """The command-line arguments of a sweep. They define which runs exist, which of them count in the table, and what the table
    shows."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)

    scenes: list[str] = Field(min_length=1, max_length=limits.MAX_SWEEP_POINTS)
    vary: list[str] = []
    design: str = "grid"
    points: int | None = Field(default=None, ge=2, le=1_000_000)
    design_seed: int = Field(default=1, ge=1, le=2**31 - 1)
    seeds: str = "5"
    frames: str | None = None
    until: str | None = None
    show: list[str] = []
    until_known: list[str] = []
    root: list[str] = []

    @field_validator("design")
    @classmethod
    def _check_design(cls, word: str) -> str:
        if all(word != design.name for design in DESIGNS):
            raise ValueError(f"there is no design `{word}`")
        return word

    @field_validator("scenes", "root")
    @classmethod
    def _check_paths(cls, words: list[str]) -> list[str]:
        if any("\0" in word for word in words):
            raise ValueError("a path cannot contain a null character")
        return words

    def write_request(self, folder: Path) -> None:
        """Write the request into a folder. Paths are stored relative to the folder, so that everything can be moved together."""
        portable_request = self.model_copy(
            update={
                "scenes": [_make_relative_path(path, folder) for path in self.scenes],
                "root": self._make_roots_relative(folder),
            }
        )
        write_atomically(folder / REQUEST_FILE_NAME, (portable_request.model_dump_json(indent=1) + "\n").encode())

    def _make_roots_relative(self, folder: Path) -> list[str]:
        return [
            f"{name}={_make_relative_path(path.strip(), folder)}" for name, _, path in (word.partition("=") for word in self.root)
        ]


def read_request(folder: Path) -> SweepRequest:
    """Return the request that is stored in a folder, with paths relative to the working directory. Raises NoStoredSweepError if
    there is none."""
    try:
        request = SweepRequest.model_validate_json(read_size_limited(folder / REQUEST_FILE_NAME, limits.MIB))
    except OSError:
        raise NoStoredSweepError(f"`{folder}` has no sweep to continue") from None
    except ValidationError:
        raise NoStoredSweepError(f"`{folder / REQUEST_FILE_NAME}` is damaged") from None
    roots = [f"{name}={_resolve_path(path, folder)}" for name, _, path in (word.partition("=") for word in request.root)]
    changed: dict[str, Any] = {"scenes": [_resolve_path(path, folder) for path in request.scenes], "root": roots}
    return request.model_copy(update=changed)


def _make_relative_path(path: str, folder: Path) -> str:
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:  # on another drive
        return os.path.abspath(path)


def _resolve_path(path: str, folder: Path) -> str:
    return os.path.relpath(folder / path) if not os.path.isabs(path) else path
