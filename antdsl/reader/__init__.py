"""The reader: a separate, confined process that reads foreign file formats with C and C++ libraries.

The process receives requests (`send_request` in `client`) and returns plain values and arrays. READER_FUNCTIONS lists the kinds
of requests.

- `protocol`: the messages between both processes
- `child`: the program that the process runs
- `sandbox`: the confinement of the process
- `private_folder`: the folder for files that the process may open

The answers are not trusted, because a malicious file may control the process. The requester checks each count, shape, type and
index of an answer before use."""

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
