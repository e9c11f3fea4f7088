"""Walking over triangles: footings are (mesh, face, weights), and a step is a straight line that unfolds across edges.

`topology` prepares the triangles (frames of faces, links across edges, which sides can be walked on), `self_cuts` finds where a
mesh cuts itself. `surface` is the door: it places footings and moves them. `walk` does a step in array passes, `walk_events` with
`walk_compiled` does the same bits in compiled loops. What may stand in the way is asked of `surroundings` (other surfaces and
continuations beyond a border, through the tree of `boxes`) and of `crossings` (cuts by the own piece). `clearances` and `creases`
say who can meet nothing and need not look."""
