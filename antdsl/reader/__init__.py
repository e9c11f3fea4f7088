"""Foreign formats that C and C++ libraries parse are read in a separate, confined process.

A request goes in (`ask` in `client`), plain values and arrays come out. `protocol` defines the messages, `child` is the program
of the process, `sandbox` confines it, and `private_folder` holds the files that it may open. READERS lists all requests.

Nothing that the process returns is trusted: it may be under the control of the file that it read. A requester checks each count,
shape, type and index of an answer before it uses them."""

from __future__ import annotations

from typing import Final

# Kind of request: the module and the function that answer it in the child. The modules are in higher rooms, so they are named
# here and imported by the child alone.
READER_FUNCTIONS: Final = {
    "usd-layer": ("antdsl.scene.geometry.usd.child.stage", "read_layer"),
    "usd-stage": ("antdsl.scene.geometry.usd.child.requests", "open_stage"),
    "usd-mesh": ("antdsl.scene.geometry.usd.child.requests", "read_mesh"),
    "usd-points": ("antdsl.scene.geometry.usd.child.requests", "read_points"),
    "usd-curve": ("antdsl.scene.geometry.usd.child.requests", "read_curve"),
    "usd-camera": ("antdsl.scene.geometry.usd.child.requests", "read_camera"),
    "usd-body": ("antdsl.bodies.files.usd_body", "read_body"),
    "image": ("antdsl.reader.images", "read_image"),
}
# Modules that the child imports before the first request of a format, while the other process does something else.
PRELOADED_MODULES: Final = {"usd": ("antdsl.scene.geometry.usd.child.requests", "pxr.Usd", "pxr.UsdGeom")}
