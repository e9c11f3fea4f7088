"""Places of the crowd that have no room for all who begin there."""

from __future__ import annotations

import math

from antdsl.diagnostics import Report
from antdsl.runtime.world import World
from antdsl.scene import Scene
from antdsl.scene.staging.item_placement import beside


def crowding(scene: Scene, world: World) -> Report:
    """Warnings for lines of the crowd whose place had no room for all when the world was bound, each at the line's place. Of one
    that lies beside all surfaces was told before."""
    report, setting = Report(), world.setting
    for line in world.crowded:
        if beside(setting.crowds[line.group].place, setting.surfaces, setting.solids, scene.model.up):
            continue
        low, high = (f"{radius:.3g}" for radius in line.radius)
        wide = f"{low} mm" if low == high else f"{low} to {high} mm"
        cover = f"{line.cover:,.0f} mm²" if line.area is None else f"{line.cover:,.0f} of {line.area:,.0f} mm²"
        words = f"only {line.fit:,} of {line.count:,} `{line.species}` find room where they begin"
        place = scene.model.crowd[line.group].place
        words += f": with a radius of {wide} {'or half of `apart` ' if place.apart is not None else ''}they cover {cover}"
        help = "write a smaller `count`, or a smaller `radius` in the program"
        if place.apart is not None:
            help = "write a smaller `count`, a larger place, or a shorter length for `apart`"
        elif line.larger is not None:
            larger = f"`radius: {_rounded_up(line.larger / scene.model.unit_mm)} {scene.model.units}`"
            help = f"write {larger}, a smaller `count`, or a smaller `radius` in the program"
        elif line.sides:
            help = "cover its sides and its underside too with `by: area`, or write a smaller `count`"
        elif place.inside is not None or place.density is not None:
            help = "write a larger place, a smaller `count`, or a smaller `radius` in the program"
        report.warning("no-room", words, scene.span("crowd", line.group, "place"), help)
    return report


def _rounded_up(value: float) -> str:
    """To two digits."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.ceil(value / step) * step:g}"
