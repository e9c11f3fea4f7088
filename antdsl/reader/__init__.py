"""Reads foreign formats that C and C++ libraries parse, in a separate, confined process.

The process receives a request (`send_request` in `client`), and returns plain values and arrays. READER_FUNCTIONS lists all
requests.

- `protocol`: the messages
- `child`: the program of the process
- `sandbox`: the confinement of the process
- `private_folder`: the folder of files that the process may open

Nothing that the process returns is trusted: the file that it has read may control the process. A requester checks each count,
shape, type and index of an answer before use."""

from __future__ import annotations

from typing import Final

# Kind of request: the module and the function that answer it in the child. These modules are in higher layers, so they are only
# named here; the child imports them.
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
# Modules that the child imports before the first request of a format, while the parent process does other work.
PRELOADED_MODULES: Final = {"usd": ("antdsl.scene.geometry.usd.child.requests", "pxr.Usd", "pxr.UsdGeom")}
