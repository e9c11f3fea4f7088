"""Crowd lines that have more agents than fit into their place."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class OvercrowdedCrowd:
    """A crowd line of the scene with more agents than fit into its place. `crowd_index`: the number of the line.

    `fitting_count`: how many of its `count` agents fit. `radius` (mm): the least and the greatest radius of its agents.
    `covered_area`, `available_area` (mm²): the area that all agents would cover, and the area of the place (None if unknown).
    `sufficient_radius` (mm): a radius of the place with which all agents would fit; None if there is none. `fits_available_area`:
    whether all agents would have space with `by: area`."""

    crowd_index: int
    species: str
    count: int
    fitting_count: int
    radius: tuple[float, float]
    covered_area: float
    available_area: float | None
    sufficient_radius: float | None
    fits_available_area: bool
