"""A design and the variations that are run of it: what was asked, to be held against what came out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from antdsl.sweep.designs import Chosen
from antdsl.sweep.factors import Factor
from antdsl.sweep.jobs import Variation
from antdsl.sweep.sensitivity import Effect, effects
from antdsl.sweep.table import Row


@dataclass(frozen=True, slots=True)
class Study:
    """`variations`: every scene with every point once."""

    chosen: Chosen
    scenes: tuple[Path, ...]
    variations: tuple[Variation, ...]

    @property
    def ranges(self) -> tuple[Factor, ...]:
        """The factors that take all values between two."""
        return tuple(factor for factor in self.chosen.factors if not factor.levels)

    @property
    def units(self) -> dict[str, str]:
        """The units of the ranges, by name."""
        return {factor.name: factor.unit for factor in self.ranges}

    def effects(self, table: Sequence[Row], measures: Sequence[str]) -> tuple[list[Effect], list[str]]:
        """How much each factor matters to these measures, and notes on those of which that is not known. Nothing where the design
        is not made for it."""
        design, shares = self.chosen.design, self.chosen.shares
        if design.analysis is None or shares is None:
            return [], []
        labels = {(v.scene, *v.params.values()): v.label for v in self.variations}
        scenes = {str(scene): [labels[(scene, *point.values())] for point in self.chosen.points] for scene in self.scenes}
        medians = {(row.label, row.measure): row.median for row in table}
        return effects(design.analysis, [f.name for f in self.chosen.factors], shares, scenes, medians, measures)
