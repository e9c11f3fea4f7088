"""Changes of the number of agents in a setting, at the same density or in one dense cluster."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from antdsl.scene.setting import PointMm, WorldSetting


def scale_setting(setting: WorldSetting, agents: int) -> WorldSetting:
    """Return a setting with `agents` agents in total, at the same density as in `setting`.

    The world is scaled about its origin: meshes, positions of items and crowds, and curves. The sizes of agents, items and field
    cells, and the radii of behaviours, are not scaled.

    Raises ValueError for a world with solids, flows, maps or moving things.
    """
    if (
        setting.solids
        or setting.flows
        or setting.maps
        or any((setting.motion.meshes, setting.motion.items, setting.motion.curves))
    ):
        raise ValueError("only worlds with fixed meshes, items and curves can be scaled, without solids, flows and maps")
    previous_count = sum(crowd.count for crowd in setting.crowds)
    by = (agents / previous_count) ** 0.5

    def scale_point(place: PointMm) -> PointMm:
        return (place[0] * by, place[1] * by, place[2] * by)

    crowds, passed = [], 0
    for crowd in setting.crowds:
        first = round(passed * agents / previous_count)  # of all that come before, so that what rounding leaves does not add up
        passed += crowd.count
        count = round(passed * agents / previous_count) - first
        at = crowd.place
        radius = None if at.radius is None else at.radius * by
        points = None if at.points is None else at.points * by
        around, inside = (None if place is None else scale_point(place) for place in (at.disc_centre, at.ray_origin))
        place = replace(at, disc_centre=around, ray_origin=inside, radius=radius, points=points)
        crowds.append(replace(crowd, count=count, place=place))
    items = {
        name: tuple(replace(item, position=scale_point(item.position)) for item in those) for name, those in setting.items.items()
    }
    surfaces, obstacles = (
        {name: replace(mesh, vertices=mesh.vertices * by) for name, mesh in meshes.items()}
        for meshes in (setting.surfaces, setting.obstacles)
    )
    curves = {name: np.asarray(curve) * by for name, curve in setting.curves.items()}
    return replace(setting, crowds=tuple(crowds), surfaces=surfaces, obstacles=obstacles, items=items, curves=curves)


def compress_crowds(setting: WorldSetting, area_share: float) -> WorldSetting:
    """Return a setting in which each crowd is compressed around its centre. Crowds without a radius do not change. `area_share`:
    the new area as a fraction of the old one, 0 to 1."""
    crowds = tuple(
        replace(crowd, place=replace(crowd.place, radius=crowd.place.radius * area_share**0.5)) if crowd.place.radius else crowd
        for crowd in setting.crowds
    )
    return replace(setting, crowds=crowds)
