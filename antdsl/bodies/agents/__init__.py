"""Agent definitions: the data that all agents of one kind share, so that a body can be posed and drawn.

A `Definition` has a `Rig` (a tree of joints with a rest pose, and channels) and a library of `Shape`s. Its `Layer`s bind shapes
to joints. It also has `Clip`s, `TransformGroup`s and metadata. It is read from its JSON documents, glTF or USD. The values of
each agent (its clips with times and weights, and the resulting poses) are in arrays over all agents. There are no objects per
agent, and none per joint of an agent.

From played clips to drawn shapes: `poses` arranges the clips of a definition in a table and samples them. `blending` combines the
samples to poses by trees of layers. `deformers` deforms shapes by these poses (`skinning`, `blend_shapes`). All of these use the
operations in `affine`, which have the same bits on every processor.

Matrices take column vectors: `world = parent_world @ local`, `point = matrix @ (x, y, z, 1)`. Quaternions are x, y, z, w.
"""
