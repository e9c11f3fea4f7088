"""Keeps bodies outside the ground, obstacles and solids.

`clear_steps` runs the stages of a substep. `body_tables` builds its inputs, and `clearance_kernels` contains its loops.
`body_paths`, `body_lifts` and `walls_ahead` measure the ground along the path. `obstacle_clearance` computes lower bounds of
the distance from obstacles, and packs the obstacles' faces. `solid_clearance` shifts bodies in worlds with solids, and
`mesh_clearance` out of faces. `bodies_inside` and `head_clearance` find bodies and heads that are inside the ground."""
