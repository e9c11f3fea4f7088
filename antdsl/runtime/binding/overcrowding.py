"""Crowd lines with a place that has no space for all their agents."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class OvercrowdedLine:
    """A crowd line (number `group`) of the scene without space for all its agents at its place. `fitting_count`: how many of its
    `count` agents have space. `radius` (mm): least and greatest. `fits_by_area`: `by: area` would fit all. `covered_area`,
    `available_area` (mm²): the area that all agents would cover, and the available area (None if unknown). `sufficient_radius`
    (mm): for a place with a radius, the radius with space for all; None if there is none."""

    group: int
    species: str
    count: int
    fitting_count: int
    radius: tuple[float, float]
    covered_area: float
    available_area: float | None
    sufficient_radius: float | None
    fits_by_area: bool
