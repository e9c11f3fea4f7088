"""A cache as a USD stage, in the scene's units and axes.

`time_samples`: agents by id at any time, even between frames, with velocities that lead to the next frame. `instancers`: a
species as a point instancer, with a bank of poses (`pose_bank`) as prototypes. `skeletons`: a species as one instance of a
UsdSkel definition (`definitions`) per agent. `xforms`: a species as keyframes of one object per agent. `world`: meshes, items,
fields and the camera; `materials`: their materials. `stage`: the complete stage, frame by frame. Memory does not grow with the
shot, and samples may be spread over files.

USD has other conventions than antdsl: matrices for row vectors, linear colours, focal lengths in tenths of a unit."""
