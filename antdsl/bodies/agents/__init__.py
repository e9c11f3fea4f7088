"""Agent definitions: what all agents of one kind share, so that a body can be posed and drawn.

A `Definition` is a `Rig` (a tree of joints with a rest pose, and channels), a library of `Shape`s, `Layer`s that bind shapes to
joints, `Clip`s, `TransformGroup`s and metadata. It is read from its JSON documents, glTF or USD, and shared by all agents of a
kind. The values of each agent (its clips with times and weights, and the resulting poses) are in arrays over all agents: no
object per agent, and none per joint of an agent.

From what agents play to what is drawn: `poses` lays out the clips of a definition and samples them; `blending` makes poses by
trees of layers of these samples; `deformers` moves shapes by them (`skinning`, `blend_shapes`).
All of it is made of the operations in `affine`, which have the same bits everywhere.

Matrices take column vectors: `world = parent_world @ local`, `point = matrix @ (x, y, z, 1)`. Quaternions are x, y, z, w.
"""
