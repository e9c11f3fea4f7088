"""Frames of a cache, rendered with Cycles, the path tracer of Blender.

`requests`: builds a request, with light and cameras in the units and axes of Blender. `rendering`: writes the frames as USD into
a temporary folder, starts a Python that has `bpy`, and yields the pictures. `cycles_script`: the script that this Python runs. It
opens the USD file, sets light and camera, and renders.

Blender runs in a child process, because it contains a different version of USD and may crash. Blender's import of lights is not
used, because Blender 4.5 does not convert the radius of a lamp and ignores a sky of one colour."""
