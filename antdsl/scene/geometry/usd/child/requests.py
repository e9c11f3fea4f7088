"""What the reader answers about what is at a prim of a USD stage: arrays and texts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from antdsl.reader.protocol import pack_texts
from antdsl.scene.geometry.usd.child import stage as stages
from antdsl.scene.geometry.usd.child.camera import camera_arrays
from antdsl.scene.geometry.usd.child.curves import curve_places
from antdsl.scene.geometry.usd.child.guard import Answer, guarded
from antdsl.scene.geometry.usd.child.meshes import joined_mesh
from antdsl.scene.geometry.usd.child.points import point_arrays

if TYPE_CHECKING:
    from antdsl.reader.protocol import Message


@guarded
def open_stage(request: Message) -> Answer:
    """Nothing but whether the stage can be opened."""
    stages.open_stage(request)
    return {}, {}


@guarded
def read_mesh(request: Message) -> Answer:
    """`vertices`, `faces`, `moves:…` where the mesh moves, `value:N` for the Nth of `primvars`; `passed_over`."""
    names = [str(name) for name in request.document["primvars"]]
    found = joined_mesh(stages.open_stage(request), names)
    moves = {f"moves:{name}": array for name, array in (found.moves or {}).items()}
    values = {f"value:{number}": found.values[name] for number, name in enumerate(names)}
    return {"passed_over": found.passed_over}, {"vertices": found.vertices, "faces": found.faces} | moves | values


@guarded
def read_points(request: Message) -> Answer:
    """`names`, `places`, `radius`, `ahead`; `value:N` and `text:N` for the Nth of `values` and `texts`; `unit`."""
    found = point_arrays(stages.open_stage(request), request.document["of_kind"])
    arrays = {"places": found.places, "radius": found.radius, "ahead": found.ahead}
    arrays |= {f"value:{number}": array for number, array in enumerate(found.values.values())}
    for number, texts in enumerate(found.texts.values()):
        arrays |= pack_texts(f"text:{number}", texts)
    arrays |= pack_texts("names", found.names)
    return {"unit": found.unit, "values": list(found.values), "texts": list(found.texts)}, arrays


@guarded
def read_curve(request: Message) -> Answer:
    """`places`."""
    return {}, {"places": curve_places(stages.open_stage(request))}


@guarded
def read_camera(request: Message) -> Answer:
    """`at`, `look_at`, `up` and `focal`."""
    return {}, camera_arrays(stages.open_stage(request))
