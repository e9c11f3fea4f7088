"""A cache as a USD stage, in the scene's units and axes.

`moments` reads frames and what lies between them: agents by id at any time, with velocities that lead to the next frame.
`instancers` writes a species as a point instancer whose prototypes are a bank of poses (`bank`), `skeletons` as an instance of
one UsdSkel definition (`definitions`) for each agent, `xforms` as keyframes of objects; `world` writes meshes, items, fields and
the camera, `materials` what all of them are made of. `stage` puts it together, frame by frame, so that memory does not grow with
the shot, and spreads the samples over files. USD has its own ways: matrices for row vectors, colours linear, focal
lengths in tenths of a unit."""
