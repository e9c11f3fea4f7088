"""Agent definitions: the data that all agents of one kind share, from which their bodies are posed and drawn.

A `Definition` has a `Rig` (a tree of joints with a rest pose, and channels) and a library of `Shape`s. Its `Layer`s bind shapes
to joints. It also has `Clip`s, `TransformGroup`s and metadata. It is read from JSON documents, glTF or USD. The values of each
agent (its clips with times and weights, and the resulting poses) are stored in arrays over all agents. There is no object per
agent or per joint.

From played clips to drawn shapes: `poses` arranges the clips of a definition in a table and samples them. `blending` mixes the
samples into poses, following a tree of layers. `deformers` deforms shapes by these poses (`skinning`, `blend_shapes`). All of
these use the operations in `affine`, which give the same bits on every processor.

Matrices take column vectors: `world = parent_world @ local`, `point = matrix @ (x, y, z, 1)`. Quaternions are x, y, z, w.
"""
