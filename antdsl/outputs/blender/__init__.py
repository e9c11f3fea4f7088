"""Frames of a cache, rendered with Cycles, the path tracer of Blender.

`requests`: the light and the cameras of the frames in the units and axes of Blender, and the rest of a request.
`rendering`: writes the frames as USD into a temporary folder, starts a Python that has `bpy`, and yields the pictures.
`cycles_script`: what runs in that Python. It opens the USD file, sets light and camera, and renders.

Blender runs in a child process, because it contains another USD and may end without an exception. Its own import of lights is not
used: Blender 4.5 does not convert the radius of a lamp and ignores a sky of one colour."""
