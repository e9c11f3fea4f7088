"""Walking over triangles: footings are (mesh, face, weights), and a step is a straight line that unfolds across edges.

`topology` prepares the triangles (frames of faces, links across edges, which sides can be walked on), `self_cuts` finds where a
mesh cuts itself. `surface` is the door: it places footings and moves them, by `walk_events`, which runs the loops of `walk`. A
step is made of `stretches`, each across one face. What may stand in the way is asked of `surroundings` (other surfaces and
continuations beyond a border, through the tree of `boxes`) and of `crossings` (cuts by the own piece). `surface_clearance` and
`creases` say who can meet nothing and need not look."""
