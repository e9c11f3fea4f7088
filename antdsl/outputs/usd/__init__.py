"""A cache as a USD stage, in the scene's units and axes.

`moments` reads agents by id at any time, also between frames, with velocities that lead to the next frame. `instancers` writes a
species as a point instancer with a bank of poses (`bank`) as prototypes, `skeletons` as an instance of one UsdSkel definition
(`definitions`) for each agent, `xforms` as keyframes of objects. `world` writes meshes, items, fields and the camera, `materials`
their materials. `stage` combines them frame by frame, so that memory does not grow with the shot, and spreads the samples over
files. USD has its own conventions: matrices for row vectors, linear colours, focal lengths in tenths of a unit."""
