"""What a scene says that its things look like in pictures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

from antdsl.outputs.cache.manifest import Look
from antdsl.scene.model import HeightThing, MeshThing, SceneModel, UsdThing


def looks_of(model: SceneModel) -> Mapping[str, Look | Mapping[str, Look]]:
    """By name, the look of each mesh, and of all items from a USD file; of items with entries of their own by the name of
    each."""
    found: dict[str, Look | Mapping[str, Look]] = {}
    for name, thing in model.world.items():
        if isinstance(thing, dict):
            own = {item: cast(Look, placed.look) for item, placed in thing.items() if placed.look is not None}
            found |= {name: own} if own else {}
        elif isinstance(thing, MeshThing | HeightThing | UsdThing) and thing.look is not None:
            found[name] = cast(Look, thing.look)
    return found
