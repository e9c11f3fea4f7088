"""Walking over triangles. A footing is a mesh, a face and its weights. A step is a straight line that is unfolded across edges.

- `topology`: tables of the triangles: frames of faces, links across edges, sides between which agents can walk
- `self_cuts`: pairs of faces at which a mesh cuts itself
- `surface`: the interface, which places and moves footings
- `walk_events`, `walk`: the loops that move all agents
- `stretches`: the parts of a step, each across one face
- `surroundings`: tests for obstacles (other surfaces) and for continuations beyond a border, with the tree of `boxes`
- `crossings`: where the piece that an agent walks on cuts itself
- `surface_clearance`, `creases`: find agents that are too far from other surfaces to need a test"""
