"""Walking over triangles: footings are (mesh, face, weights), and a step is a straight line that unfolds across edges.

`topology` prepares the triangles (frames of faces, links across edges, sides that can be walked on). `self_cuts` locates where a
mesh cuts itself. `surface` is the interface: it places footings and moves them, by `walk_events`, which runs the loops of `walk`.
A step consists of `stretches`, each across one face. `surroundings` tests for obstacles (other surfaces, and continuations beyond
a border, through the tree of `boxes`), and `crossings` for cuts by the same piece. `surface_clearance` and `creases` identify
agents that can meet nothing and need no test."""
