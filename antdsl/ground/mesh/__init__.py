"""Walking over triangles: footings are (mesh, face, weights), and a step is a straight line that unfolds across edges.

- `topology`: tables of the triangles (frames of faces, links across edges, sides that can be walked on)
- `self_cuts`: pairs of faces at which a mesh cuts itself
- `surface`: the interface; it places footings and moves them, by `walk_events`, which runs the loops of `walk`
- `stretches`: the parts of a step, each across one face
- `surroundings`: tests for obstacles (other surfaces) and for continuations beyond a border, with the tree of `boxes`
- `crossings`: where the piece that an agent walks on cuts itself
- `surface_clearance`, `creases`: find agents that are too far from other surfaces to need a test"""
